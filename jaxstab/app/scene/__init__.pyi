from . import answers as answers
from . import contact as contact
from . import exports as exports
from . import loops as loops
from . import scene as scene
from . import study as study
from . import tune as tune
from .answers import explain_model as explain_model
from .check import check_walls as check_walls
from .contact import simulate_contacts as simulate_contacts
from .gains import GainScene as GainScene
from .gains import any_scene as any_scene
from .gains import explain_gains as explain_gains
from .limits import scene_limits as scene_limits
from .loops import loop_of as loop_of
from .scene import Scene as Scene
from .tune import Backwards as Backwards
from .tune import DesignStatus as DesignStatus
from .tune import design_loop as design_loop
from .tune import tune_walls as tune_walls

__all__: list[str]
