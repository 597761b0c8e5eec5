"""Everything that is asked about one loop, proved in balls of python-flint."""
