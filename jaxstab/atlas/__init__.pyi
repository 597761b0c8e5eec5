from .atlas import Atlas as Atlas
from .atlas import AtlasAnswer as AtlasAnswer
from .atlas import LargestStiffness as LargestStiffness
from .atlas import LoopAtlas as LoopAtlas
from .atlas import QueryStatus as QueryStatus
from .atlas import open_atlas as open_atlas
from .lookup import AlphaLimits as AlphaLimits
from .lookup import MaxAlpha as MaxAlpha
from .plan import Plan as Plan
from .plan import plan_atlas as plan_atlas
from .products.slices import AtlasOutline as AtlasOutline
from .spec import AtlasSpec as AtlasSpec
from .spec import FittedAxis as FittedAxis
from .write.build import build_atlas as build_atlas
from .write.resolution import Resolution as Resolution
from .write.resolution import ResolutionPlan as ResolutionPlan
from .write.resolution import plan_resolution as plan_resolution

__all__: list[str]
