from . import build as build
from . import spec as spec
from .build import build_atlas as build_atlas
from .query import Atlas as Atlas
from .query import AtlasAnswer as AtlasAnswer
from .query import LoopAtlas as LoopAtlas
from .query import QueryStatus as QueryStatus
from .query import open_atlas as open_atlas
from .spec import AtlasSpec as AtlasSpec
from .spec import FieldSpec as FieldSpec
from .table import AlphaLimits as AlphaLimits

__all__: list[str]
