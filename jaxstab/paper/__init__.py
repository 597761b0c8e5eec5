"""The paper's own: the linear rule and its validity, passivity, facts of its figures.

Hulin, Preusche, Hirzinger: Stability Boundary for Haptic Rendering (IROS 2008).
"""

from jaxstab.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
