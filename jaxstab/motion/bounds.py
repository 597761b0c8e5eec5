"""Proved bounds of motion: settling, and what an encoder, an amplifier and friction can cause.

Settling. The deviation from rest is the response of a wall, h = num(z)/p(z); all of its samples
from some time on are bounded by lemma E4 of docs/proofs.md, and those before are looked at.

Amplitudes. The encoder's rounding e makes the loop see x + e, the amplifier's rounding adds to the
force, and friction pushes the device. Only the size of the three is known. Let two equal loops be
started and pushed alike, one of them disturbed by |e_k| <= q. They differ by h_0 e_k + h_1 e_(k-1)
+ ..., h the response to an error of 1 at one sample: by at most q (|h_0| + |h_1| + ...), and some e
comes as close to that as one likes. An encoder that rounds to the nearest multiple of its
resolution is wrong by at most half of it; so is a rounded force. The effects of several
disturbances add up.

The sums are those of lemma E4. Position and velocity between samples are bounded from the ends of
pieces of the sample, with their second derivatives (lemma M9 of docs/proofs.md).
"""

from collections.abc import Callable, Mapping, Sequence
from decimal import ROUND_CEILING
from typing import Any, NamedTuple, TypeVar, get_args

import numpy as np
from jaxtyping import Float64, Int8

from jaxstab.arrays import Array, Numbers, float_arrays, is_traced, named, namespace
from jaxstab.batches import asked_of_lanes
from jaxstab.conventions import HORIZON, Excitation, Status, Verdict
from jaxstab.exact.response import Causes, disturbed_responses, settled_after
from jaxstab.model import LoopParameters, checked_delay, checked_gain
from jaxstab.model.device.mechanics import Between, between_samples
from jaxstab.model.filters import Filter, Velocity, given_filters
from jaxstab.model.loop import unit_loops
from jaxstab.model.plant import checked_delta, checked_gamma
from jaxstab.motion.response import Column, Controller, answer_text, controller_for, deviations
from jaxstab.numbers import checked, checked_count, checked_number, checked_word, require_together
from jaxstab.point.verdicts import linear_verdict
from jaxstab.rounding import RAISED


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


# --------------------------------------------------------------------------------------- amplitudes
Kind = TypeVar("Kind", bound="Amplitude")


class AmplitudeStatus(Status):
    """The status of amplitudes; small integers, so that arrays store int8.

    Example:
        >>> jaxstab.results.AmplitudeStatus(1).words
        'proved: no such disturbance drives the loop further'
    """

    NOT_COMPUTED = 0, "not computed"
    PROVED = 1, "proved: no such disturbance drives the loop further"
    NOT_PROVED = 2, "no bound is proved: the loop is unstable, or too close to the boundary"


class Amplitude(NamedTuple):
    """The largest distances of a disturbed loop from its undisturbed motion.

    All are infinite where nothing is proved. Position, velocity and force (of the wall) hold at all
    times; ``force_per_count`` is the jump of the computed force at one count of the encoder.

    Example:
        >>> bounds = jaxstab.amplitude(0.1, 0.4, gamma=0.0, delta=0.001, delay=0.0, encoder=1.0)
        >>> round(float(bounds.position), 2), bounds.status
        (1.03, <AmplitudeStatus.PROVED: 1>)
    """

    position: Float64[Array, "*grid"]
    velocity: Float64[Array, "*grid"]
    force: Float64[Array, "*grid"]
    force_per_count: Float64[Array, "*grid"]
    status: Int8[Array, "*grid"]

    def __repr__(self) -> str:
        return answer_text("Amplitude", self[:4], _COLUMNS, self.status, AmplitudeStatus)


class WallAmplitude(Amplitude):
    """The same in m, m/s and N."""

    def __repr__(self) -> str:
        return answer_text("Amplitude", self[:4], _SI_COLUMNS, self.status, AmplitudeStatus)


_COLUMNS = [
    Column(name.replace("_", " "), rounding=ROUND_CEILING) for name in Amplitude._fields[:4]
]

_UNITS = {"position": ("um", 10**6), "velocity": ("mm/s", 1000)}  # the others are in N
_SI_COLUMNS = [
    Column(column.label, *_UNITS.get(column.label, ("N", 1)), ROUND_CEILING) for column in _COLUMNS
]


def amplitude(
    alpha: Numbers,
    beta: Numbers,
    *,
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    encoder: Numbers = 0.0,
    force_step: Numbers = 0.0,
    friction: Numbers = 0.0,
    noise: Numbers = 0.0,
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> Amplitude:
    """Bound the effect of a quantised encoder, a quantised force, friction and noise on a loop.

    The loop is compared with the same loop without any of these, started and pushed alike. The
    answer bounds the distance of the two, at all times and not only at the samples. As the
    undisturbed loop comes to rest under a constant push, this bounds the chatter that the hand
    feels in the long run. It holds while the hand is in the wall. Where it is infinite, nothing is
    proved.

    Friction is treated as any force that is never larger than the given one; that it only brakes is
    not used.

    Args:
        alpha, beta, gamma, delta, delay, velocity, position: see ``jaxstab.conventions``.
        encoder: resolution of the encoder, which rounds to the nearest multiple, >= 0, in any unit
            of length U.
        force_step: resolution of the force, which is rounded to the nearest multiple, >= 0, in m
            U/T^2.
        friction: largest Coulomb friction of the device, >= 0, in m U/T^2; it may change at any
            time, between samples too.
        noise: largest error of the sampled position, beside that of the resolution, >= 0, in U.

    Returns:
        Amplitude in U, U/T and m U/T^2. The proof holds for the gains, the plant and the filter
        coefficients as float64 holds them; rounding and the tails of all sums are bounded. It is
        differentiable in the disturbances only.

    Raises: see ``jaxstab.conventions``; ValueError also if nothing disturbs the loop, or JAX
    differentiates by gains or plant.

    Source: the l1 norm of a linear system (Vidyasagar 1986) for the loop of eqs. (1)-(5); lemmas E4
    and M9 of docs/proofs.md.

    Example:
        >>> bounds = jaxstab.amplitude(0.1, 0.4, gamma=0.0, delta=0.001, delay=0.0, encoder=1.0)
        >>> round(float(bounds.position), 2)
        1.03
    """
    sizes = {"encoder": encoder, "force_step": force_step, "friction": friction, "noise": noise}
    require_together(alpha=alpha, beta=beta, gamma=gamma, delta=delta, delay=delay, **sizes)
    gains = float_arrays(checked_gain("alpha", alpha), checked_gain("beta", beta))
    lanes = *gains, *float_arrays(checked_gamma(gamma), checked_delta(delta)), checked_delay(delay)
    loop_of = unit_loops(velocity, position)
    controller = controller_for(given_filters(velocity, position))
    return _answered(Amplitude, loop_of, lanes, sizes, gains, controller)


def _answered(
    kind: type[Kind],
    loop_of: Callable[..., LoopParameters | None],
    lanes: Sequence[Array],
    given: Mapping[str, Numbers],
    gains: Sequence[Array],
    controller: Controller,
) -> Kind:
    """The sums of the bounds of all causes, infinite where one is not proved.

    ValueError if the sizes that are given are all 0.
    """
    sizes = float_arrays(*(checked(name, value, 0.0) for name, value in given.items()))
    if not any(is_traced(size) or np.any(size) for size in sizes):
        raise ValueError(f"{', '.join(given)} are all 0; give what disturbs the loop.")
    resolution, step, rubbing, extra = sizes
    encoder, force, friction, noise = (is_traced(x) or bool(np.any(x)) for x in sizes)
    causes = encoder or noise, force, friction  # that are present
    sizes = [0.5 * resolution + extra, 0.5 * step, rubbing]

    def ask(loop: LoopParameters, stiffness: float, damping: float) -> np.ndarray:
        return _bounds(loop, stiffness, damping, causes).ravel()

    bounds = asked_of_lanes(ask, loop_of, lanes, 9, is_count=False)
    xp = namespace(bounds, sizes, gains)
    is_proved = xp.isfinite(sum(bounds[::3]))
    totals = []
    for of_causes in (bounds[::3], bounds[1::3], bounds[2::3]):  # of position, velocity, force
        finite = (xp.where(is_proved, bound, 0.0) for bound in of_causes)
        total = RAISED * sum(a * b for a, b in zip(sizes, finite, strict=True))
        totals.append(xp.where(is_proved, total, xp.inf))
    status = xp.where(is_proved, AmplitudeStatus.PROVED, AmplitudeStatus.NOT_PROVED)
    filtered, difference, _ = controller.step(1.0, controller.at_rest(0.0))
    per_count = resolution * abs(gains[0] * filtered + gains[1] * difference)
    answers = kind(*xp.broadcast_arrays(*totals, per_count, status.astype(np.int8)))
    return answers._replace(status=named(answers.status, AmplitudeStatus))


def loop_amplitude(
    loop: LoopParameters, stiffness: Numbers, damping: Numbers, sizes: Mapping[str, Numbers]
) -> WallAmplitude:
    """Bound what disturbances do to a loop in plain numbers; see ``HapticLoop.amplitude``.

    ``sizes`` are those of encoder, force_step, friction and noise, in this order. Friction acts at
    the handle, behind the actuators; an amplifier's steps come before them. ValueError also if the
    device has zero DC gain.
    """
    require_together(stiffness=stiffness, damping=damping, **sizes)
    gains = float_arrays(checked_gain("stiffness", stiffness), checked_gain("damping", damping))
    controller = controller_for(given_filters(**loop.filters))
    samples = gains[0], gains[1] / loop.sample_time
    return _answered(WallAmplitude, lambda: loop, gains, sizes, samples, controller)


def _bounds(
    loop: LoopParameters, stiffness: float, damping: float, causes: Causes
) -> Float64[np.ndarray, "cause 3"]:
    """Bounds of position, velocity and force for each cause of size 1, where it is present."""
    found = disturbed_responses(loop, stiffness, damping, causes)
    bounds = np.zeros((3, 3))
    if found is None:
        return bounds + np.inf
    period = float(loop.sample_time)
    between = between_samples(loop.held_device, period, loop.delay_samples % 1.0)
    errors = sum(causes[:2])
    inputs = np.eye(len(found.head))
    if causes[2]:
        states = inputs[:, errors:]
        blows = np.concatenate([end @ states.T for end in between.blows])
        inputs = np.concatenate([inputs[:errors], blows, states.T])
    sums = found.sums(between.rows, inputs).T
    present = [cause for cause, is_present in enumerate(causes[:2]) if is_present]
    for column, cause in enumerate(present):
        bounds[cause] = _at_all_times(sums[:, column], between)
    if causes[2]:
        totals = _of_friction(sums[:, errors:], between)
        bounds[2] = _at_all_times(totals, between) + np.array([*between.path, 0.0])
    return bounds / [1.0, period, 1.0]


def _at_all_times(
    totals: Float64[np.ndarray, " row"], between: Between
) -> Float64[np.ndarray, "3"]:
    """Return bounds at all times by those at the ends of pieces, without friction's last share."""
    ends = totals[between.ends].reshape(-1, 2, 2, 2)  # piece, end, derivatives, which
    states = totals[between.states]  # and the acting force, which the arriving one does not pass
    states = np.append(states, states[-1])
    bent = 0.5 * between.half[:, None] ** 2
    most = ends.max(axis=1)
    curved = most[:, 1] + bent * (between.remainder @ states)
    bounds = (most[:, 0] + bent * curved).max(axis=0)
    return RAISED * np.array([*bounds, states[-1]])


def _of_friction(
    sums: Float64[np.ndarray, "row input"], between: Between
) -> Float64[np.ndarray, " row"]:
    """Return the integrals over all times of what unit blows do, at most."""
    ends = between.blows.shape[1]
    half = between.blow_half
    values, curves, states = sums[:, :ends], sums[:, ends : 2 * ends], sums[:, 2 * ends :]
    bent = (2.0 * half) ** 3 / 12.0
    total = half * (values[:, :-1] + values[:, 1:]).sum(axis=-1)
    total = total + bent * (curves[:, :-1] + curves[:, 1:]).sum(axis=-1)
    total = total + bent * 0.5 * half**2 * (states * between.blow_remainder).sum(axis=-1)
    return np.asarray(RAISED * total)
