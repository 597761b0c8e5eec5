from .radius import OptimalGains as OptimalGains
from .radius import TuningStatus as TuningStatus
from .radius import minimize_radius as minimize_radius
from .settling import minimize_settling as minimize_settling

__all__: list[str]
