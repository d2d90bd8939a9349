"""Episodes to look at: in a window, in the terminal, as a film, in the Rerun viewer."""
