"""Proved amplitudes: the motion that an encoder, an amplifier and friction can cause.

The encoder's rounding e makes the loop see x + e, the amplifier's rounding adds to the force, and
friction pushes the device. Only the size of the three is known. Let two equal loops be started and
pushed alike, one of them disturbed by |e_k| <= q. They differ by h_0 e_k + h_1 e_(k-1) + ..., h the
response to an error of 1 at one sample: by at most q (|h_0| + |h_1| + ...), and some e comes as
close to that as one likes. An encoder that rounds to the nearest multiple of its resolution is
wrong by at most half of it; so is a rounded force. The effects of several disturbances add up.

The sums are those of lemma E4. Position and velocity between samples are bounded from the ends of
pieces of the sample, with their second derivatives (lemma M9 of docs/proofs.md).
"""

from collections.abc import Callable, Mapping, Sequence
from decimal import ROUND_CEILING
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float64, Int8

from jaxstab.arrays import Array, Numbers, float_arrays, is_traced, named, namespace
from jaxstab.batches import asked_of_lanes
from jaxstab.conventions import Status
from jaxstab.exact.response import Causes, disturbed_responses
from jaxstab.model import LoopParameters, checked_delay, checked_gain
from jaxstab.model.device.mechanics import Between, between_samples
from jaxstab.model.filters import Filter, Velocity, given_filters
from jaxstab.model.loop import unit_loops
from jaxstab.model.plant import checked_delta, checked_gamma
from jaxstab.motion.response import Column, Controller, answer_text, controller_for
from jaxstab.numbers import checked, require_together
from jaxstab.rounding import RAISED

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
