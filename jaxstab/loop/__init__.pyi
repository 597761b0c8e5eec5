from .between import LoopsBetween as LoopsBetween
from .between import WorstLoop as WorstLoop
from .common import CommonRegion as CommonRegion
from .common import CommonWall as CommonWall
from .common import common_region as common_region
from .common import tune_for_all as tune_for_all
from .contact import Contact as Contact
from .contact import ContactKind as ContactKind
from .contact import contact_map as contact_map
from .jitter import MovingLimits as MovingLimits
from .jitter import WorstDelays as WorstDelays
from .loop import HapticLoop as HapticLoop
from .many import ManyLimits as ManyLimits
from .many import ManyRegions as ManyRegions
from .many import limits_of as limits_of
from .many import regions_of as regions_of
from .region import Gains as Gains
from .region import WallLimits as WallLimits
from .region import WallRegion as WallRegion
from .tune import OptimalWall as OptimalWall

__all__: list[str]
