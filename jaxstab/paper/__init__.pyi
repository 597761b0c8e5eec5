from .linear import linear_alpha_limit as linear_alpha_limit
from .linear import linear_condition as linear_condition
from .linear import linear_error as linear_error
from .linear import minus_line as minus_line
from .linear import plus_line as plus_line
from .linear import routh_hurwitz_condition as routh_hurwitz_condition
from .passive import PassiveRegion as PassiveRegion
from .passive import passive_region as passive_region
from .validity import LinearValidity as LinearValidity
from .validity import ValidityStatus as ValidityStatus
from .validity import linear_validity as linear_validity

__all__: list[str]
