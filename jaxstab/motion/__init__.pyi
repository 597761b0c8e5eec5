from .amplitude import Amplitude as Amplitude
from .amplitude import AmplitudeStatus as AmplitudeStatus
from .amplitude import WallAmplitude as WallAmplitude
from .amplitude import amplitude as amplitude
from .amplitude import loop_amplitude as loop_amplitude
from .response import Oscillation as Oscillation
from .response import Response as Response
from .response import dominant_mode as dominant_mode
from .response import mode_of as mode_of
from .response import simulate as simulate
from .settling import Settling as Settling
from .settling import SettlingStatus as SettlingStatus
from .settling import SettlingTime as SettlingTime
from .settling import loop_settling_samples as loop_settling_samples
from .settling import settling_samples as settling_samples

__all__: list[str]
