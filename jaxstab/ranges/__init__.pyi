from .box import RobustLimit as RobustLimit
from .box import RobustStatus as RobustStatus
from .hands import HandRange as HandRange
from .hands import WorstHand as WorstHand
from .hands import worst_hand as worst_hand
from .margins import Margins as Margins
from .margins import WallMargins as WallMargins
from .margins import in_si_units as in_si_units
from .margins import loop_margins as loop_margins
from .margins import margins as margins
from .robust import RobustRegion as RobustRegion
from .robust import robust_limit as robust_limit
from .robust import robust_region as robust_region

__all__: list[str]
