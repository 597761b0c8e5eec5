"""A scene in SI units, and what it allows."""
