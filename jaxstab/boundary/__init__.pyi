from .curve import boundary_curve as boundary_curve
from .curve import minus_line as minus_line
from .curve import plus_line as plus_line

__all__: list[str]
