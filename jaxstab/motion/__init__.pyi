from .amplitude import Amplitude as Amplitude
from .amplitude import AmplitudeStatus as AmplitudeStatus
from .amplitude import amplitude as amplitude
from .response import Oscillation as Oscillation
from .response import Response as Response
from .response import dominant_mode as dominant_mode
from .response import simulate as simulate
from .settling import Settling as Settling
from .settling import SettlingStatus as SettlingStatus
from .settling import settling_samples as settling_samples

__all__: list[str]
