"""Guards: walls that are proved stable beforehand, as a table in C for a running loop."""

from jaxstab.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
