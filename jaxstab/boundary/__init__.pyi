from .arcs import Branch as Branch
from .criteria import LinearValidity as LinearValidity
from .criteria import ValidityStatus as ValidityStatus
from .criteria import linear_alpha_limit as linear_alpha_limit
from .criteria import linear_condition as linear_condition
from .criteria import linear_error as linear_error
from .criteria import linear_validity as linear_validity
from .criteria import routh_hurwitz_condition as routh_hurwitz_condition
from .curve import boundary_curve as boundary_curve
from .curve import minus_line as minus_line
from .curve import plus_line as plus_line
from .facts import region_facts as region_facts
from .facts import resolved_region as resolved_region
from .passive import PassiveRegion as PassiveRegion
from .passive import passive_region as passive_region
from .region import RegionStatus as RegionStatus
from .region import StableRegion as StableRegion
from .region import region_outline as region_outline
from .region import stable_region as stable_region
from .robust import RobustRegion as RobustRegion
from .robust import RobustStatus as RobustStatus
from .robust import robust_region as robust_region
from .trace import BoundaryTrace as BoundaryTrace
from .trace import TraceStatus as TraceStatus
from .trace import trace_boundary as trace_boundary

__all__: list[str]
