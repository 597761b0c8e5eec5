from .device import Device as Device
from .device import Hand as Hand
from .device import Mode as Mode
from .double_double import DoubleDouble as DoubleDouble
from .filters import Filter as Filter
from .filters import Velocity as Velocity
from .linear_loop import characteristic_polynomial as characteristic_polynomial
from .linear_loop import companion_matrix as companion_matrix
from .linear_loop import polynomial_degree as polynomial_degree
from .loop import LoopParameters as LoopParameters
from .parameters import TracedDelay as TracedDelay
from .parameters import by_name as by_name
from .parameters import checked_delay as checked_delay
from .parameters import checked_delta as checked_delta
from .parameters import checked_gain as checked_gain
from .parameters import checked_gamma as checked_gamma
from .parameters import require_x64 as require_x64
from .plant import PlantCoefficients as PlantCoefficients
from .plant import plant_pairs as plant_pairs

__all__: list[str]
