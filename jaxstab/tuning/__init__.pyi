from .gains import minimize_radius_damping as minimize_radius_damping
from .gains import minimize_settling as minimize_settling
from .radius import minimize_radius as minimize_radius
from .status import OptimalGains as OptimalGains
from .status import TuningStatus as TuningStatus

__all__: list[str]
