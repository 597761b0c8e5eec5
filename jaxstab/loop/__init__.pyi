from .contact import Contact as Contact
from .contact import ContactKind as ContactKind
from .contact import contact_map as contact_map
from .hands import WorstHand as WorstHand
from .jitter import MovingLimits as MovingLimits
from .jitter import WorstDelays as WorstDelays
from .loop import HapticLoop as HapticLoop
from .many import ManyLimits as ManyLimits
from .many import ManyRegions as ManyRegions
from .many import limits_of as limits_of
from .many import regions_of as regions_of
from .margins import Margins as Margins
from .margins import margins as margins
from .region import Gains as Gains
from .region import WallLimits as WallLimits
from .region import WallRegion as WallRegion
from .tune import OptimalWall as OptimalWall
from .tune_for_all import CommonWall as CommonWall
from .tune_for_all import tune_for_all as tune_for_all

__all__: list[str]
