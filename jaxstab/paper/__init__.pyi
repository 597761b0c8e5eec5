from .facts import LinearValidity as LinearValidity
from .facts import ValidityStatus as ValidityStatus
from .facts import linear_validity as linear_validity
from .passive import passive_region as passive_region
from .rules import linear_alpha_limit as linear_alpha_limit
from .rules import linear_condition as linear_condition
from .rules import linear_error as linear_error
from .rules import minus_line as minus_line
from .rules import plant_coefficients as plant_coefficients
from .rules import plus_line as plus_line
from .rules import routh_hurwitz_condition as routh_hurwitz_condition

__all__: list[str]
