from .grid import sweep as sweep
from .poles import closed_loop_poles as closed_loop_poles
from .radius.door import SpectralRadius as SpectralRadius
from .radius.door import spectral_radius as spectral_radius
from .verdict.door import is_stable as is_stable
from .verdict.door import verdict as verdict

__all__: list[str]
