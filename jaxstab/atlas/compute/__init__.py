"""The computations of an atlas, and their plan."""
