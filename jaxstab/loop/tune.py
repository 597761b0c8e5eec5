"""The walls of a loop that come to rest fastest, in SI units."""

from typing import Literal, NamedTuple

from jaxstab.model import LoopParameters
from jaxstab.motion import settling_samples
from jaxstab.motion.settling import Excitation, checked_level
from jaxstab.numbers import checked_number, checked_word
from jaxstab.point import spectral_radius
from jaxstab.tuning import (
    TuningStatus,
    minimize_radius,
    minimize_radius_damping,
    minimize_settling,
)


class OptimalWall(NamedTuple):
    """The best wall in SI units, and what just these gains reach.

    The spectral radius of the gains as they are given is ``radius``, to ``radius_error``, proved.
    """

    stiffness: float
    damping: float
    radius: float
    radius_error: float
    settling_time: float
    status: TuningStatus


def optimal_wall(
    loop: LoopParameters,
    goal: Literal["radius", "settling"],
    stiffness: float | None,
    level: float,
    excitation: Excitation,
) -> OptimalWall:
    """Return the wall that comes to rest fastest: ``HapticLoop.tune``."""
    checked_word("goal", goal, ("radius", "settling"))
    level = checked_level(level, excitation)
    alpha = None if stiffness is None else loop.alpha(checked_number("stiffness", stiffness))
    filters = loop.filters
    if goal == "settling":
        best = minimize_settling(*loop.slice, level, alpha=alpha, excitation=excitation, **filters)
    elif alpha is None:
        best = minimize_radius(*loop.slice, **filters)
    else:
        best = minimize_radius_damping(alpha, *loop.slice, **filters)
    wall = float(best.alpha), float(best.beta)
    radius = spectral_radius(*wall, *loop.slice, **filters)
    settling = settling_samples(*wall, *loop.slice, level, excitation=excitation, **filters).value
    return OptimalWall(
        loop.stiffness(wall[0]),
        loop.damping(wall[1]),
        float(radius.value),
        float(radius.error),
        float(settling) * loop.sample_time,
        TuningStatus(int(best.status)),
    )
