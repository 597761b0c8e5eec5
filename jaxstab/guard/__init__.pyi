from .build import build_guard as build_guard
from .guard import Guard as Guard
from .header import guard_header as guard_header

__all__: list[str]
