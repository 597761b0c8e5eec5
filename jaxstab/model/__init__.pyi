from .double_double import DoubleDouble as DoubleDouble
from .parameters import HapticLoop as HapticLoop
from .parameters import require_x64 as require_x64
from .plant import PlantCoefficients as PlantCoefficients
from .plant import plant_coefficients as plant_coefficients
from .polynomial import characteristic_polynomial as characteristic_polynomial
from .polynomial import companion_matrix as companion_matrix

__all__: list[str]
