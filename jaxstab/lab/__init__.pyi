from . import contact as contact
from . import guard as guard
from . import identify as identify
from . import joints as joints
from . import study as study

__all__: list[str]
