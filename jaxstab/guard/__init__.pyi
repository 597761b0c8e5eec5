from .build import build_guard as build_guard
from .guard import Guard as Guard

__all__: list[str]
