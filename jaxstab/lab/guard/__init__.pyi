from .build import CELLS as CELLS
from .build import CONSTANT_CELLS as CONSTANT_CELLS
from .build import build_guard as build_guard
from .build import plan_guard as plan_guard
from .guard import LARGEST_HEADER as LARGEST_HEADER
from .guard import Guard as Guard
from .guard import checked_name as checked_name

__all__: list[str]
