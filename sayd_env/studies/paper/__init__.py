"""What the paper shows, row by row and figure by figure."""
