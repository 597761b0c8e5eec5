"""The curve that is evaluated in double-double, with the angles that float64 misses. NumPy only."""

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.model.double_double import DoubleDouble
from jaxstab.region.exact_points import Pairs, determinants
from jaxstab.region.filtered_curve import FilteredCurve
from jaxstab.region.roots import bracketed_root
from jaxstab.region.stretches import standing_for, stretches_around, true_angles

_SEARCHED = np.concatenate(  # angles between which poles are looked for, on each half
    [np.geomspace(1e-7, 0.1, 240, endpoint=False), np.linspace(0.1, 0.5 * np.pi, 400)]
)
_SAME = 1e-5  # of angles that float64 finds, too
_CLOSEST = 1e-9  # what counts as the distance of a pole on the circle

Angles = Float64[np.ndarray, " _"]


def in_pairs(curve: FilteredCurve, pairs: Pairs, centers: DoubleDouble) -> FilteredCurve:
    """Return a curve as it is evaluated in double-double.

    Args:
        curve: as it is evaluated in float64.
        pairs: the parts of p(z), as ``exact_points`` takes them.
        centers: angles around which the curve is drawn out.
    """
    lines = [line.angle + side * line.half_width for line in curve.lines for side in (-1.0, 1.0)]
    stretches = stretches_around(centers, np.array(lines))
    even = np.concatenate([_SEARCHED, np.pi - _SEARCHED])
    outside = ~np.any([one.holds(even) for one in stretches], axis=0) if stretches else slice(None)
    angles = np.unique(np.concatenate([even[outside], *(one.scan for one in stretches)]))

    def both(theta: Angles) -> Float64[np.ndarray, "2 angle"]:
        return determinants(pairs, true_angles(stretches, theta, np.zeros_like(theta))[0])

    def value(number: np.ndarray, theta: Angles) -> Angles:
        chosen: Angles = np.choose(number, both(theta))
        return chosen

    values = both(angles)
    number, index = np.nonzero(np.diff(np.sign(values), axis=1))
    ends = values[number, index], values[number, index + 1]
    roots = bracketed_root(value, number, angles[index], angles[index + 1], ends)
    real, steep = (roots[number == k] for k in range(2))
    poles, lone, resonances = (
        standing_for(stretches, DoubleDouble.of(one))
        for one in (curve.poles[0], curve.steep, curve.resonances[0])
    )
    is_pole, is_steep = _are_apart(poles, real), _are_apart(lone, steep)
    distances = np.concatenate([curve.poles[1, is_pole], np.full(len(real), _CLOSEST)])
    return curve._replace(
        poles=np.stack([np.concatenate([poles[is_pole], real]), distances]),
        steep=np.concatenate([lone[is_steep], steep]),
        resonances=np.stack([resonances, curve.resonances[1]]),
        stretches=stretches,
        pairs=pairs,
        is_exact=True,
    )


def _are_apart(angles: Angles, others: Angles) -> Bool[np.ndarray, " _"]:
    """Return which angles are no others that rounding has moved."""
    gaps = np.abs(angles[:, None] - others)
    apart: np.ndarray = np.all(gaps > _SAME * angles[:, None], axis=1)
    return apart
