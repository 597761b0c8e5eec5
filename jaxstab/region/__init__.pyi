from .corners import Branch as Branch
from .curve import boundary_curve as boundary_curve
from .curve import minus_line as minus_line
from .curve import plus_line as plus_line
from .region import region_outline as region_outline
from .region import stable_region as stable_region
from .stable_set import RegionStatus as RegionStatus
from .stable_set import StableRegion as StableRegion

__all__: list[str]
