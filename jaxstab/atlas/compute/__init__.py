"""What is computed for an atlas, and where."""
