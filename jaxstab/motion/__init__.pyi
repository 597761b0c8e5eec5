from .bounds import Amplitude as Amplitude
from .bounds import AmplitudeStatus as AmplitudeStatus
from .bounds import Settling as Settling
from .bounds import SettlingStatus as SettlingStatus
from .bounds import SettlingTime as SettlingTime
from .bounds import WallAmplitude as WallAmplitude
from .bounds import amplitude as amplitude
from .bounds import loop_amplitude as loop_amplitude
from .bounds import loop_settling_samples as loop_settling_samples
from .bounds import settling_samples as settling_samples
from .response import Oscillation as Oscillation
from .response import Response as Response
from .response import dominant_mode as dominant_mode
from .response import mode_of as mode_of
from .response import simulate as simulate

__all__: list[str]
