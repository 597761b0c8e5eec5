"""Certified verdicts."""
