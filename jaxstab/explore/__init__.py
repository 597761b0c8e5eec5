"""A page that draws the stable walls of a scene in any browser, without a network."""

from jaxstab.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
