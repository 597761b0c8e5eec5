"""Proved amplitudes: how far an encoder, an amplifier and friction can drive the loop.

The encoder's rounding e makes the loop see x + e, the amplifier's rounding adds to the force, and
friction pushes the device. Only the size of the three is known. The response of a linear loop to
any such disturbance is at most the sum of the moduli of its impulse response, and some disturbance
comes as close to that bound as one likes (lemma M6).
"""

from decimal import ROUND_CEILING
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int8

from jaxstab.arrays import Array, Numbers, float_arrays, is_traced, named, namespace
from jaxstab.batches import on_host
from jaxstab.conventions import Status
from jaxstab.model import checked_delay, checked_gain, require_x64
from jaxstab.model.filters import Filter, Velocity, given_filters
from jaxstab.model.parameters import checked_delta, checked_gamma
from jaxstab.motion.disturbed import Causes, Gains, drag, gains_of_disturbances, path, throw
from jaxstab.motion.response import propagator
from jaxstab.motion.shown import Column, answer_text
from jaxstab.motion.state_space import DIFFERENCE, POSITION, bank_for
from jaxstab.numbers import checked

_SAFETY = 1.0 + 2.0**-40  # on sums of a few bounds


class AmplitudeStatus(Status):
    """What is known about amplitudes; small integers, so that arrays store int8.

    Example:
        >>> jaxstab.AmplitudeStatus(1).words
        'proved: no such disturbance drives the loop further'
    """

    NOT_COMPUTED = 0, "not computed"
    PROVED = 1, "proved: no such disturbance drives the loop further"
    NOT_PROVED = 2, "no bound is proved: the loop is unstable, or too close to the boundary"


class Amplitude(NamedTuple):
    """The most by which disturbances can drive a loop away from its undisturbed motion.

    All are infinite where nothing is proved.

    Attributes:
        position: of the device, at all times.
        velocity: of the device, at all times.
        force: of the wall, at all times.
        force_per_count: how much the computed force jumps when the encoder moves on by one count.
        status: an AmplitudeStatus.

    Example:
        >>> found = jaxstab.amplitude(0.1, 0.4, gamma=0.0, delta=0.001, delay=0.0, encoder=1.0)
        >>> round(float(found.position), 2), found.status
        (1.03, <AmplitudeStatus.PROVED: 1>)
    """

    position: Float64[Array, "*grid"]
    velocity: Float64[Array, "*grid"]
    force: Float64[Array, "*grid"]
    force_per_count: Float64[Array, "*grid"]
    status: Int8[Array, "*grid"]

    def __repr__(self) -> str:
        """Return the bounds of one loop, rounded up, or a summary of many."""
        return answer_text("Amplitude", self[:4], _COLUMNS, self.status, AmplitudeStatus)


class WallAmplitude(Amplitude):
    """The same in m, m/s and N.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> loop.amplitude(1000.0, 20.0, encoder=1e-5)
        Amplitude: position 6.276 um, velocity 2.126 mm/s, force 0.2434 N, force per count 0.21 N
        (proved)
    """

    def __repr__(self) -> str:
        """Return the bounds with their units."""
        return answer_text("Amplitude", self[:4], _SI_COLUMNS, self.status, AmplitudeStatus)


_COLUMNS = [
    Column(name.replace("_", " "), rounding=ROUND_CEILING) for name in Amplitude._fields[:4]
]
_SI_COLUMNS = [
    column._replace(unit=unit, factor=factor)
    for column, unit, factor in zip(
        _COLUMNS, ("um", "mm/s", "N", "N"), (10**6, 1000, 1, 1), strict=True
    )
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
    """Bound what a quantised encoder, a quantised force, friction and noise do to a loop.

    The loop is compared with the same loop without any of these, started and pushed alike. The
    answer bounds how far the two are apart, at all times and not only at the samples. As the
    undisturbed loop comes to rest under a constant push, this bounds the chatter that the hand
    feels in the long run. It holds while the hand is in the wall. Where it is infinite, nothing is
    proved.

    Friction is treated as any force that is never larger than the given one; that it only brakes is
    not used.

    Args:
        alpha: wall stiffness K T^2/m, any shape; like the next four arguments it broadcasts.
        beta: wall damping B T/m.
        gamma: physical stiffness k T^2/m in [0, 1e4].
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, concrete.
        encoder: resolution of the encoder, which rounds to the nearest multiple, >= 0, in any
            unit of length U.
        force_step: resolution of the force, which is rounded to the nearest multiple, >= 0, in
            m U/T^2.
        friction: largest Coulomb friction of the device, >= 0, in m U/T^2; it may change at any
            time, between samples too.
        noise: largest error of the sampled position, beside that of the resolution, >= 0, in U.
        velocity: the velocity estimator in units of one sample; None for the difference over one.
        position: the position filter in units of one sample; None for none.

    Returns:
        Amplitude in U, U/T and m U/T^2. The proof holds for the gains, the plant and the filter
        coefficients as float64 holds them; rounding and the tails of all sums are bounded. It is
        differentiable in the disturbances only.

    Raises:
        ValueError: an argument is outside its range, infinite or NaN, or nothing disturbs the loop;
            or JAX differentiates by gains or plant.
        TypeError: the delay or a filter is traced.
        RuntimeError: JAX arrays are given without x64.

    Source: the l1 norm of a linear system (Vidyasagar 1986) for the loop of eqs. (1)-(5); lemmas M3
    to M8 of docs/proofs.md.

    Example:
        >>> found = jaxstab.amplitude(0.1, 0.4, gamma=0.0, delta=0.001, delay=0.0, encoder=1.0)
        >>> round(float(found.position), 2)
        1.03
    """
    given = {"encoder": encoder, "force_step": force_step, "friction": friction, "noise": noise}
    require_x64(alpha, beta, gamma, delta, *given.values())
    delay = checked_delay(delay)
    filters = given_filters(velocity, position)
    names = tuple(given)
    sizes = float_arrays(*(checked(name, given[name], 0.0) for name in names))
    if not any(is_traced(size) or np.any(size) for size in sizes):
        raise ValueError(f"{', '.join(names)} are all 0; give what disturbs the loop.")
    gains = float_arrays(checked_gain("alpha", alpha), checked_gain("beta", beta))
    gamma, delta = float_arrays(checked_gamma(gamma), checked_delta(delta))
    fraction = delay % 1.0
    moments = np.stack([fraction, np.ones_like(fraction)], axis=-1)
    propagate = propagator(gamma, delta, fraction, moments)
    entries = [propagate[..., 1, row, column] for row in (0, 1) for column in range(4)]
    middle = [propagate[..., 0, 1, column] for column in range(3)]
    xp = namespace(gains, propagate)
    grid = xp.broadcast_shapes(*map(np.shape, gains), propagate.shape[:-3], delay.shape)
    errors, step, rubbing, extra = sizes
    bounds = 0.5 * errors + extra, 0.5 * step, rubbing
    causes = Causes(*(is_traced(size) or bool(np.any(size)) for size in bounds))
    bank = bank_for(filters)
    search = partial(gains_of_disturbances, bank=bank, causes=causes)
    lanes = *gains, *entries, *middle, gamma, delta, np.floor(delay)
    like = (Gains(*[np.float64] * 4),) * 3
    found = on_host(search, *lanes, shape=grid, like=like, is_count=False)
    sampled = Gains(*(_total(bounds, parts) for parts in zip(*found, strict=True)))
    is_proved = xp.isfinite(sum(one.position for one in found))
    bounded = _at_all_times(sampled, rubbing, gamma, delta, fraction)
    status = xp.where(is_proved, AmplitudeStatus.PROVED, AmplitudeStatus.NOT_PROVED)
    x, v, force = (xp.where(is_proved, one, xp.inf) for one in bounded)
    direct = bank.outputs[:, POSITION] + bank.outputs[:, DIFFERENCE]
    per_count = errors * abs(gains[0] * direct[0] + gains[1] * direct[1])
    answers = x, v, force, per_count, status.astype(np.int8)
    complete = Amplitude(*xp.broadcast_arrays(*answers))
    return complete._replace(status=named(complete.status, AmplitudeStatus))


def _total(sizes: tuple[Array, ...], gains: tuple[Array, ...]) -> Array:
    """Return the sum of what all disturbances do, 0 for what is not bounded."""
    xp = namespace(sizes, gains)
    known = [xp.where(xp.isfinite(gain), gain, 0.0) for gain in gains]
    return _SAFETY * sum(size * gain for size, gain in zip(sizes, known, strict=True))


def _at_all_times(
    sampled: Gains, friction: Array, gamma: Array, delta: Array, fraction: Array
) -> tuple[Array, Array, Array]:
    """Return bounds at all times from those at the samples, for T = m = 1 (lemma M8)."""
    xp = namespace(sampled, friction, gamma, delta)
    x, v, force, middle = sampled
    bent, far = drag(gamma, delta), throw(gamma, delta)
    is_late = fraction > 0.0
    acceleration = force * (1.0 + xp.where(is_late, xp.minimum(2.0, bent), 0.0))
    acceleration = acceleration + delta * v + gamma * (x + v)
    acceleration = acceleration + friction * (1.0 + delta + 0.5 * gamma)
    flown = x + far * v + xp.minimum(0.5, far) * (force + friction)
    position = _SAFETY * xp.minimum(x + acceleration / 8.0, flown)
    moved = xp.maximum(v, middle + friction * xp.minimum(fraction, path(delta)))
    held = force + delta * moved + gamma * position
    curved = moved + (held * bent + gamma * moved) / 8.0 + friction * (2.0 + bent) / 4.0
    thrown = v + gamma * far * x + far * force * xp.where(is_late, 3.0, 1.0)
    velocity = _SAFETY * xp.minimum(curved, thrown + friction * path(delta))
    return position, velocity, force
