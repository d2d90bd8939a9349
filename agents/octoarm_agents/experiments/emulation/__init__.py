"""Three systems emulated from the arm's spring lengths: Table 2, Figures 4 and 5 (section 3.1)."""
