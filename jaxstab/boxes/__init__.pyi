from .polygons import RobustRegion as RobustRegion
from .polygons import robust_region as robust_region
from .search import HandRange as HandRange
from .search import RobustLimit as RobustLimit
from .search import RobustStatus as RobustStatus

__all__: list[str]
