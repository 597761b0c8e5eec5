from .compute.plan import Plan as Plan
from .compute.plan import plan_atlas as plan_atlas
from .format.spec import AtlasSpec as AtlasSpec
from .format.spec import FittedAxis as FittedAxis
from .products.limits import AlphaLimits as AlphaLimits
from .products.limits import MaxAlpha as MaxAlpha
from .products.slices import AtlasOutline as AtlasOutline
from .read.atlas import Atlas as Atlas
from .read.atlas import LargestStiffness as LargestStiffness
from .read.atlas import LoopAtlas as LoopAtlas
from .read.atlas import open_atlas as open_atlas
from .read.points import AtlasAnswer as AtlasAnswer
from .read.points import QueryStatus as QueryStatus
from .write.build import build_atlas as build_atlas
from .write.resolution import Resolution as Resolution
from .write.resolution import ResolutionPlan as ResolutionPlan
from .write.resolution import plan_resolution as plan_resolution

__all__: list[str]
