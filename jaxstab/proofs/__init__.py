"""Proofs for all loops of a box."""
