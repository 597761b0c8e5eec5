"""Contacts as they are felt: one-sided walls, friction, encoders, saturation. Simulated."""

from jaxstab.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
