from .gains import OptimalWall as OptimalWall
from .gains import least_radius_damping as least_radius_damping
from .gains import least_settling as least_settling
from .gains import optimal_gains as optimal_gains
from .grid import sweep as sweep
from .oscillation import Oscillation as Oscillation
from .oscillation import dominant_mode as dominant_mode
from .oscillation import dominant_oscillation as dominant_oscillation
from .response import Response as Response
from .response import simulate as simulate
from .schur_cohn import verdict as verdict
from .settling import Settling as Settling
from .settling import SettlingStatus as SettlingStatus
from .settling import settling_samples as settling_samples
from .settling import settling_time as settling_time
from .spectrum import SpectralRadius as SpectralRadius
from .spectrum import closed_loop_poles as closed_loop_poles
from .spectrum import is_stable as is_stable
from .spectrum import spectral_radius as spectral_radius
from .tuning import OptimalGains as OptimalGains
from .tuning import TuningStatus as TuningStatus
from .tuning import least_radius as least_radius

__all__: list[str]
