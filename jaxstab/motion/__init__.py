"""The motion of a loop: response, settling, oscillation."""

from jaxstab.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
