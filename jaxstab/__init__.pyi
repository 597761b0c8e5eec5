from .atlas import Atlas as Atlas
from .atlas import AtlasAnswer as AtlasAnswer
from .atlas import AtlasSpec as AtlasSpec
from .atlas import FittedAxis as FittedAxis
from .atlas import QueryStatus as QueryStatus
from .atlas import build_atlas as build_atlas
from .atlas import open_atlas as open_atlas
from .conventions import AXES as AXES
from .conventions import NOT_COMPUTED as NOT_COMPUTED
from .conventions import STABLE as STABLE
from .conventions import UNDECIDED as UNDECIDED
from .conventions import UNSTABLE as UNSTABLE
from .conventions import RadiusStatus as RadiusStatus
from .conventions import Verdict as Verdict
from .model import HapticLoop as HapticLoop
from .model import PlantCoefficients as PlantCoefficients
from .model import characteristic_polynomial as characteristic_polynomial
from .model import companion_matrix as companion_matrix
from .model import plant_coefficients as plant_coefficients
from .stability import Oscillation as Oscillation
from .stability import Response as Response
from .stability import Settling as Settling
from .stability import SettlingStatus as SettlingStatus
from .stability import SpectralRadius as SpectralRadius
from .stability import closed_loop_poles as closed_loop_poles
from .stability import dominant_mode as dominant_mode
from .stability import dominant_oscillation as dominant_oscillation
from .stability import is_stable as is_stable
from .stability import settling_samples as settling_samples
from .stability import settling_time as settling_time
from .stability import simulate as simulate
from .stability import spectral_radius as spectral_radius
from .stability import sweep as sweep
from .stability import verdict as verdict

__version__: str
__all__: list[str]
