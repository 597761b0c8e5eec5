from .answers import Answer as Answer
from .answers import Basis as Basis
from .answers import basis_of as basis_of
from .check import Check as Check
from .check import WallCheck as WallCheck
from .check import check_walls as check_walls
from .contact import Contacts as Contacts
from .contact import simulate_contacts as simulate_contacts
from .example import EXAMPLE as EXAMPLE
from .example import explain_model as explain_model
from .limits import Limits as Limits
from .limits import LimitsOverDelays as LimitsOverDelays
from .limits import scene_limits as scene_limits
from .loops import corner_loops as corner_loops
from .loops import hands_of as hands_of
from .loops import loop_of as loop_of
from .loops import wall_region as wall_region
from .scene import Scene as Scene
from .tune import BestWall as BestWall
from .tune import Design as Design
from .tune import DesignStatus as DesignStatus
from .tune import Tuned as Tuned
from .tune import design_loop as design_loop
from .tune import tune_walls as tune_walls

__all__: list[str]
