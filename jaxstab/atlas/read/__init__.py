"""Reading and querying an atlas, without JAX."""
