__all__: list[str]
from .answer import AtlasAnswer as AtlasAnswer
from .answer import QueryStatus as QueryStatus
from .build import build_atlas as build_atlas
from .build import write_atlas as write_atlas
from .limits import AlphaLimits as AlphaLimits
from .limits import MaxAlpha as MaxAlpha
from .outline import AtlasOutline as AtlasOutline
from .plan import Plan as Plan
from .plan import plan_atlas as plan_atlas
from .query import Atlas as Atlas
from .query import open_atlas as open_atlas
from .spec import AtlasSpec as AtlasSpec
from .spec import FittedAxis as FittedAxis
from .spec import ToleranceAxis as ToleranceAxis
