"""Guards: what a running loop may render, proved beforehand, as a table for C."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
