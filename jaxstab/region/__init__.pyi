from .closed_form import boundary_curve as boundary_curve
from .passive import PassiveRegion as PassiveRegion
from .pieces import Branch as Branch
from .region import stable_region as stable_region
from .stable_set import RegionStatus as RegionStatus
from .stable_set import StableRegion as StableRegion

__all__: list[str]
