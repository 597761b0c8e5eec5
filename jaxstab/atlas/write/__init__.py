"""Builds, workers, tiles, merge and verification."""
