"""The spectral radius with a proved bound."""
