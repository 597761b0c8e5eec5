"""Linear devices and hands in SI units, exact, and their sampled models with hold and delay."""

from jaxstab.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
