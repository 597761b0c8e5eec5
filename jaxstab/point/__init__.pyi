from .poles import closed_loop_poles as closed_loop_poles
from .poles import evaluate_grid as evaluate_grid
from .poles import linear_poles as linear_poles
from .radius import SpectralRadius as SpectralRadius
from .radius import linear_spectral_radius as linear_spectral_radius
from .radius import spectral_radius as spectral_radius
from .radius import with_status as with_status
from .verdicts import linear_verdict as linear_verdict
from .verdicts import verdict as verdict

__all__: list[str]
