from .poles import closed_loop_poles as closed_loop_poles
from .poles import evaluate_grid as evaluate_grid
from .radius import SpectralRadius as SpectralRadius
from .radius import spectral_radius as spectral_radius
from .verdicts import verdict as verdict

__all__: list[str]
