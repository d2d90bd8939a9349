"""Which body? What the paper leaves open, searched, and how much each of it matters."""
