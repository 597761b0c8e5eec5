"""The stable set of a loop with any plant, estimator and filter."""

import numpy as np

from jaxstab.model.linear_loop import SampledPlant
from jaxstab.model.transfer import Transfer
from jaxstab.region.curve import filtered_coefficients
from jaxstab.region.region import region_of
from jaxstab.region.stable_set import StableRegion


def linear_region(
    plant: SampledPlant, velocity: Transfer, position: Transfer, tolerance: float
) -> StableRegion:
    """Return the set of all stable (alpha, beta) of a loop.

    Args:
        plant: of one number each.
        velocity: T V(z) less its factor (1 - 1/z).
        position: P(z).
        tolerance: largest distance between the polygon and the boundary, as a share of the region's
            diameter, > 1e-10.

    Raises:
        ValueError: the plant does not give way to a constant force, N(1) = 0, by which the curve is
            divided near z = 1.
    """
    if float(plant.at_one[0].value.hi) == 0.0:
        raise ValueError(
            "the device does not give way to a constant force: its transfer function in s is 0 at "
            "s = 0. It has no region and no limits here; ask for verdicts, radii, poles or margins."
        )
    with np.errstate(all="ignore"):
        c = filtered_coefficients(plant, velocity, position)
        system = plant, velocity, position
        return region_of(c, float(plant.lag), tolerance, may_be_empty=True, system=system)
