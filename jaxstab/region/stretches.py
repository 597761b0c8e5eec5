"""Parts of the angles that are drawn out, for arcs that the curve passes in an instant. NumPy only.

Where slow filters leave next to nothing of the gains, a fast resonance crosses the circle within
1e-9 to 1e-20 radians while the gains run through all of the stable set: no two angles in float64
need lie on such an arc. So around its angle c, known in double-double, an angle t within h of it
stands for c + h sinh(L (t - c)/h) / sinh(L): all distances from 1e-24 on have digits.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.model.double_double import DoubleDouble

_LEAST = 1e-24  # the distance that is drawn out to a share of 1 / L
_WIDEST, _REACH = 0.05, 0.45  # of h: radians, and as a share of the distance to the next angle
_STEPS = 120  # of a scan, to each side

Angles = Float64[np.ndarray, " _"]


class Stretch(NamedTuple):
    """The part of the angles around one."""

    angle: float
    rest: float  # what rounding took from it
    half_width: float

    @property
    def growth(self) -> float:
        """The number L."""
        return float(np.log(2.0 * self.half_width / _LEAST))

    @property
    def scan(self) -> Angles:
        """Angles that look at all distances."""
        return self.angle + self.half_width * np.linspace(-1.0, 1.0, 2 * _STEPS + 1)[1:-1]

    def holds(self, size: Angles) -> Bool[np.ndarray, " _"]:
        """Whether angles between 0 and pi are drawn out."""
        held: np.ndarray = np.abs(size - self.angle) < self.half_width
        return held


def stretches_around(centers: DoubleDouble, others: Angles) -> tuple[Stretch, ...]:
    """Return the stretches around some angles in (0, pi), none of which reaches the others."""
    limits = np.concatenate([centers.hi, others, [0.0, np.pi]])
    stretches = []
    for angle, rest in zip(centers.hi.tolist(), centers.lo.tolist(), strict=True):
        away = np.abs(limits - angle)
        half_width = min(_WIDEST, _REACH * float(np.min(away[away > 0.0])))
        stretches.append(Stretch(angle, rest, half_width))
    return tuple(stretches)


def true_angles(
    stretches: Sequence[Stretch], size: Angles, rest: Angles
) -> tuple[DoubleDouble, Angles]:
    """Return the angles that angles between 0 and pi stand for, and how fast they grow."""
    angles, speed = DoubleDouble.of(size) + rest, np.ones_like(size)
    for one in stretches:
        held = one.holds(size)
        share = one.growth * ((size[held] - one.angle) + rest[held]) / one.half_width
        unit = one.half_width / np.sinh(one.growth)
        moved = DoubleDouble.of(unit * np.sinh(share)) + DoubleDouble.of(one.rest) + one.angle
        angles.hi[held], angles.lo[held] = moved.hi, moved.lo
        speed[held] = unit * np.cosh(share) * one.growth / one.half_width
    return angles, speed


def standing_for(stretches: Sequence[Stretch], angles: DoubleDouble) -> Angles:
    """Return the angles that stand for true ones."""
    size = angles.hi + 0.0
    for one in stretches:
        held = one.holds(size)
        gap = (DoubleDouble(angles.hi[held], angles.lo[held]) - one.angle) - one.rest
        share = np.arcsinh(gap.rounded() * np.sinh(one.growth) / one.half_width) / one.growth
        size[held] = one.angle + one.half_width * share
    return size
