from .amplitudes import Amplitude as Amplitude
from .amplitudes import AmplitudeStatus as AmplitudeStatus
from .amplitudes import amplitude as amplitude
from .oscillation import Oscillation as Oscillation
from .oscillation import dominant_mode as dominant_mode
from .response import Response as Response
from .response import simulate as simulate
from .settling import Settling as Settling
from .settling import SettlingStatus as SettlingStatus
from .settling import settling_samples as settling_samples

__all__: list[str]
