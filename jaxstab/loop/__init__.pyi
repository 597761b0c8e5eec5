from .loop import HapticLoop as HapticLoop
from .region import Gains as Gains
from .region import WallLimits as WallLimits
from .region import WallRegion as WallRegion
from .tune import OptimalWall as OptimalWall

__all__: list[str]
