"""Settling of the sampled loop in the time domain, with the tail proved.

The deviation from rest is the response of a wall, h = num(z)/p(z); all of its samples from some
time on are bounded by lemma E4 of docs/proofs.md, and those before are looked at.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, get_args

import numpy as np
from jaxtyping import Float64, Int8

from jaxstab.arrays import Array, Numbers, float_arrays, named, namespace
from jaxstab.batches import asked_of_lanes
from jaxstab.conventions import HORIZON, Excitation, Status, Verdict
from jaxstab.exact.response import settled_after
from jaxstab.model import LoopParameters, checked_delay, checked_gain
from jaxstab.model.filters import Filter, Velocity
from jaxstab.model.loop import unit_loops
from jaxstab.model.plant import checked_delta, checked_gamma
from jaxstab.motion.response import Column, answer_text, deviations
from jaxstab.numbers import checked_count, checked_number, checked_word, require_together
from jaxstab.point.verdicts import linear_verdict


class SettlingStatus(Status):
    """The status of the settling of a loop; small integers, so that arrays store int8.

    Example:
        >>> jaxstab.results.SettlingStatus(1).words
        'settled, and proved to stay so'
    """

    NOT_COMPUTED = 0, "not computed"
    SETTLED = 1, "settled, and proved to stay so"
    UNSTABLE = 2, "the loop is unstable and never settles"
    NOT_SETTLED = 3, "not proved to settle within the horizon"


class Settling(NamedTuple):
    """A settling time and its status.

    It is finite for SETTLED, infinite for UNSTABLE, and NaN where neither could be proved.

    Example:
        >>> jaxstab.settling_samples(0.1, 0.5, gamma=0.0, delta=0.015, delay=0.0)
        Settling: 15 samples (settled)
    """

    value: Float64[Array, "*grid"]
    status: Int8[Array, "*grid"]

    def __repr__(self) -> str:
        columns = [Column("", "samples")]
        return answer_text("Settling", self[:1], columns, self.status, SettlingStatus)


class SettlingTime(Settling):
    """A settling time in s.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> loop.settling_time([1000.0, 1e6], 20.0).status.tolist()
        [1, 2]
    """

    def __repr__(self) -> str:
        columns = [Column("", "ms", 1000)]
        return answer_text("Settling", self[:1], columns, self.status, SettlingStatus)


def settling_samples(
    alpha: Numbers,
    beta: Numbers,
    *,
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    level: float = 0.02,
    excitation: Excitation = "force",
    horizon: int = HORIZON,
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> Settling:
    """Count the samples until the position stays within a tolerance of its final value.

    The answer is the first sample from which on every sampled position is within the tolerance. It
    is a whole number taken from the motion itself, unlike an estimate from the spectral radius. The
    motion between samples is not considered. There are two excitations:

    - "force": the hand begins to push with a constant force at sample 0, on a device at rest. The
      tolerance is level times the final displacement F/(K + k), with K P(1) for K if a position
      filter has a gain other than 1. This is the settling time of a step response.
    - "impact": the device hits the wall with some velocity at sample 0, and nothing else pushes it.
      The tolerance is level times the largest sampled excursion, around 0. Device and hand arrive
      as a whole. Where masses are not known (``HapticLoop.simulate``) the device is at rest until a
      blow at the handle; if its compliance has one degree more in the denominator, the blow moves
      it at once, and the estimator sees that jump.

    Args:
        alpha, beta, gamma, delta, delay, velocity, position: see ``jaxstab.conventions``.
        level: the tolerance, between 0 and 1; 0.02 is the usual one.
        excitation: "force" or "impact".
        horizon: samples; a loop that is not proved to have settled by then is given up.

    Returns:
        Settling with ``value`` in samples and ``status``, a SettlingStatus. The count is proved for
        the loop of the numbers as float64 holds them.

    Raises: see ``jaxstab.conventions``; filters and the horizon must be concrete.

    Source: the loop of eqs. (1)-(5); 2 % settling is what later papers of the same authors use;
    lemma E4 of docs/proofs.md.

    Example:
        >>> int(jaxstab.settling_samples(0.1, 0.5, gamma=0.0, delta=0.015, delay=0.0).value)
        15
    """
    require_together(alpha=alpha, beta=beta, gamma=gamma, delta=delta, delay=delay)
    gains = float_arrays(checked_gain("alpha", alpha), checked_gain("beta", beta))
    lanes = *gains, *float_arrays(checked_gamma(gamma), checked_delta(delta)), checked_delay(delay)

    return _settled(unit_loops(velocity, position), lanes, level, excitation, horizon)


def loop_settling_samples(
    loop: LoopParameters,
    stiffness: Numbers,
    damping: Numbers,
    *,
    level: float = 0.02,
    excitation: Excitation = "force",
    horizon: int = HORIZON,
) -> Settling:
    """Count the samples until a loop in plain numbers is settled; see ``settling_samples``.

    All is in SI units. The hand acts at the handle, behind the actuators. ValueError also if the
    device has zero DC gain.
    """
    require_together(stiffness=stiffness, damping=damping)
    gains = float_arrays(checked_gain("stiffness", stiffness), checked_gain("damping", damping))

    return _settled(lambda: loop, gains, level, excitation, horizon)


def likely_settling(
    loop: LoopParameters,
    stiffness: Numbers,
    damping: Numbers,
    *,
    level: float = 0.02,
    excitation: Excitation = "force",
    horizon: int,
) -> Float64[np.ndarray, "*grid"]:
    """The settling times of many walls of a loop in s, to search and draw with: not proved.

    They are those of the motion in float64 up to the horizon; NaN where that says too little.
    """
    gains = np.broadcast_arrays(*float_arrays(stiffness, damping))
    walls = np.array([np.ravel(gain) for gain in gains])
    codes = linear_verdict(loop.alpha(walls[0]), loop.beta(walls[1]), loop.linear)
    samples, stable = np.full(walls.shape[1], np.nan), np.flatnonzero(codes != Verdict.UNSTABLE)
    alive = walls[0, stable], walls[1, stable]
    for own, deviation in deviations(loop, *alive, excitation, horizon):
        size = np.abs(deviation)
        with np.errstate(all="ignore"):  # unstable walls overflow
            peak = size.max(axis=1, keepdims=True) if excitation == "impact" else 1.0
            outside = ~(size <= level * peak)
        since = np.where(outside.any(axis=1), horizon - np.argmax(outside[:, ::-1], axis=1), 0)
        samples[stable[own]] = np.where(since <= 0.75 * horizon, since, np.nan)
    return samples.reshape(gains[0].shape) * loop.sample_time


def _settled(
    loop_of: Callable[..., LoopParameters | None],
    lanes: Sequence[Array],
    level: float,
    excitation: Excitation,
    horizon: int,
) -> Settling:
    """The settling of walls, two gains and the numbers of a loop each."""
    level = checked_level(level, excitation)
    checked_count("horizon", horizon, 1)

    def ask(loop: LoopParameters, stiffness: float, damping: float) -> float:
        return settled_after(loop, stiffness, damping, excitation, level, horizon)

    (samples,) = asked_of_lanes(ask, loop_of, lanes, 1, is_count=True)
    return settled_answer(samples)


def settled_answer(samples: Array) -> Settling:
    """Settling times, infinite of unstable loops and NaN where not proved, with their status."""
    xp = namespace(samples)
    unsettled = xp.where(xp.isnan(samples), SettlingStatus.NOT_SETTLED, SettlingStatus.UNSTABLE)
    status = xp.where(xp.isfinite(samples), SettlingStatus.SETTLED, unsettled)
    return Settling(samples, named(status.astype(np.int8), SettlingStatus))


def checked_level(level: Any, excitation: str) -> float:
    """The level; ValueError for a bad level or excitation."""
    checked_word("excitation", excitation, get_args(Excitation))
    level = checked_number("level", level, 0.0, 1.0, is_open=True)
    if level == 1.0:
        raise ValueError("level is 1.0; give a number below 1, such as 0.02.")
    return level
