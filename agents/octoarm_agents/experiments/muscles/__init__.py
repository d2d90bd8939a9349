"""What muscles do: the experiment that the paper names next (section 4)."""
