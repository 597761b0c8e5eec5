from .gains import OptimalWall as OptimalWall
from .gains import least_radius_damping as least_radius_damping
from .gains import least_settling as least_settling
from .gains import optimal_gains as optimal_gains
from .radius import OptimalGains as OptimalGains
from .radius import TuningStatus as TuningStatus
from .radius import least_radius as least_radius

__all__: list[str]
