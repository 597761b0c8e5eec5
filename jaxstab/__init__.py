"""Stability of haptic rendering loops: poles, verdicts, boundaries and atlases.

Every public name is importable from here and listed in ``__init__.pyi``. The import is lazy: a name
loads what it needs when it is first used, so a program that only queries an atlas never loads JAX.
"""

from jaxstab.lazy import attach_stub

__version__ = "0.3.0"

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
