"""Linear devices and hands in SI units, exactly, and what a hold and a delay make of them."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
