"""Proofs about ranges of loops: one plant in linear models, over boxes of its parameters."""

from jaxstab.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
