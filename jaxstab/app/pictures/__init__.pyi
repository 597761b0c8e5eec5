from . import plane as plane
from . import scene as scene

__all__: list[str]
