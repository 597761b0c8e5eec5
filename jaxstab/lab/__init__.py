"""What may change for ten years without touching a lemma: rooms that the core knows nothing of.

Each can be deleted, and the rest works on: who asks a room says ``lab.study.quantiles``, and it is
imported when it is asked.
"""

from jaxstab.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
