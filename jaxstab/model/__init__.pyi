from .device import Device as Device
from .device import Hand as Hand
from .device import Mode as Mode
from .double_double import DoubleDouble as DoubleDouble
from .filters import Filter as Filter
from .filters import Velocity as Velocity
from .gain import Gain as Gain
from .linear_loop import characteristic_polynomial as characteristic_polynomial
from .linear_loop import companion_matrix as companion_matrix
from .linear_loop import polynomial_degree as polynomial_degree
from .loop import LoopParameters as LoopParameters
from .plant import PlantCoefficients as PlantCoefficients
from .plant import TracedDelay as TracedDelay
from .plant import by_name as by_name
from .plant import checked_delay as checked_delay
from .plant import checked_delta as checked_delta
from .plant import checked_gain as checked_gain
from .plant import checked_gamma as checked_gamma
from .plant import plant_pairs as plant_pairs
from .plant import require_x64 as require_x64

__all__: list[str]
