"""Figures: regions, atlases, scenes, the paper's."""

from jaxstab.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
