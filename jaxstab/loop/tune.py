"""The walls of a loop that come to rest fastest, in SI units."""

from typing import Literal, NamedTuple

import numpy as np

from jaxstab.arrays import Numbers
from jaxstab.loop.calm import Chatter, fastest_calm_wall
from jaxstab.model import LoopParameters
from jaxstab.model.filters import given_filters
from jaxstab.motion.settling import Excitation, checked_level
from jaxstab.numbers import checked_number, checked_word
from jaxstab.tuning import TuningStatus
from jaxstab.tuning.gains import shortest_settling, smallest_radius_damping
from jaxstab.tuning.loops import DeviceLoop, MassLoop, TunedLoop


class OptimalWall(NamedTuple):
    """The best wall in SI units, and what exactly these gains achieve.

    ``radius`` is the spectral radius of exactly these gains, proved to within ``radius_error``.
    ``chatter`` is how far an encoder can drive the position, in m, proved, if one is given.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> best = loop.tune("radius")
        >>> print(f"K = {best.stiffness:.0f} N/m, B = {best.damping:.1f} N s/m, {best.status.name}")
        K = 7297 N/m, B = 40.1 N s/m, TRIPLE_ROOT
    """

    stiffness: float
    damping: float
    radius: float
    radius_error: float
    settling_time: float
    status: TuningStatus
    chatter: float = np.nan


def optimal_wall(
    loop: LoopParameters,
    goal: Literal["radius", "settling"],
    stiffness: float | None,
    level: float,
    excitation: Excitation,
    chatter: Chatter | None,
) -> OptimalWall:
    """Return the wall that comes to rest fastest: ``HapticLoop.tune``."""
    checked_word("goal", goal, ("radius", "settling"))
    level = checked_level(level, excitation)
    alpha = None if stiffness is None else loop.alpha(checked_number("stiffness", stiffness))
    tuned = _tuned(loop)
    if goal == "settling":
        best = shortest_settling(tuned, alpha, level, excitation)
    elif alpha is None:
        best = tuned.smallest_radius()
    else:
        best = smallest_radius_damping(tuned, alpha)
    wall, status = (float(best.alpha), float(best.beta)), TuningStatus(int(best.status))

    def radii(alphas: Numbers, betas: Numbers) -> np.ndarray:
        return np.asarray(tuned.spectral_radius(alphas, betas).value)

    def settling(alphas: Numbers, betas: Numbers) -> np.ndarray:
        return np.asarray(tuned.settling(alphas, betas, level, excitation).value)

    reached = np.nan if chatter is None else float(chatter.of(loop, *wall))
    is_stable = status != TuningStatus.NO_STABLE_GAINS
    if chatter is not None and is_stable and not reached <= chatter.limit:
        objective = radii if goal == "radius" else settling
        wall, reached, status = fastest_calm_wall(loop, objective, chatter, alpha)
    if status == TuningStatus.NOT_CALM:
        return OptimalWall(np.nan, np.nan, np.nan, np.inf, np.inf, status)
    radius = tuned.spectral_radius(*wall)
    return OptimalWall(
        loop.stiffness(wall[0]),
        loop.damping(wall[1]),
        float(radius.value),
        float(radius.error),
        float(settling(*wall)) * loop.sample_time,
        status,
        reached,
    )


def _tuned(loop: LoopParameters) -> TunedLoop:
    loop = loop.in_floats()
    sampled = loop.sampled
    if sampled is not None:
        return DeviceLoop.of(sampled, given_filters(loop.velocity, loop.position))
    gamma, delta, delay = loop.slice.values()
    return MassLoop.of((gamma, delta, delay), given_filters(**loop.filters))


def checked_chatter(encoder: float | None, limit: float | None) -> Chatter | None:
    """Return the limit on what an encoder may do, if an encoder is given.

    Raises:
        TypeError: a limit is given without an encoder, or a value is not one number.
        ValueError: a value is not positive and finite.
    """
    if encoder is None:
        if limit is not None:
            raise TypeError(f"chatter is {limit!r} without encoder; give its resolution in m.")
        return None
    encoder = checked_number("encoder", encoder, 0.0, is_open=True, unit="m")
    if limit is None:
        return Chatter(encoder)
    return Chatter(encoder, checked_number("chatter", limit, 0.0, is_open=True, unit="m"))
