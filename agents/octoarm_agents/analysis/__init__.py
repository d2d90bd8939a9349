"""What a reservoir can compute: measures of its states and input, and of the arm itself."""
