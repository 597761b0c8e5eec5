"""Margins, ranges of hands and robust regions, proved over boxes of loops."""

from jaxstab.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
