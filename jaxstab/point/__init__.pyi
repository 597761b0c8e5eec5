from .grid import sweep as sweep
from .poles import closed_loop_poles as closed_loop_poles
from .radius import SpectralRadius as SpectralRadius
from .radius import spectral_radius as spectral_radius
from .verdicts import is_stable as is_stable
from .verdicts import verdict as verdict

__all__: list[str]
