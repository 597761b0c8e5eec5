"""The two real equations for a pair of roots on the unit circle, in a form quick to compute.

With z = e^(i theta), m = floor(delay) + 1 and the notation of ``jaxstab.region.curve``,

    g = p(z) / z^(m + 2) = D/z + z^-m (N/z) H,      H = alpha + beta (1 - 1/z).

g is continuous in all six variables, in the delay too. Re g and Im g / sin(theta) are even and
2 pi-periodic in theta, so the equations Re g = 0, Im g / sin(theta) = 0 of a pair of roots go on
smoothly to theta = 0 and pi, where the pair meets a real root.
"""

from functools import partial
from math import pi
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import PI_REST, Array, Numbers, namespace, repeat
from jaxstab.model import by_name, plant_coefficients
from jaxstab.region.curve import SliceCoefficients

_DOUBLINGS = 12  # enough for the stiffest and most damped hands
_TERMS = 12  # enough for a time in which the plant moves by 1/4
_LOST = 16 * np.finfo(np.float64).eps
"""More than each of n2, n1, n0 and d0 of a quick plant has lost; d1 loses more for a stiff hand."""


class Motion(NamedTuple):
    """Position and velocity after a unit step of force on the plant at rest.

    The velocity is the plant's response h to an impulse, the position its integral.
    """

    position: Float64[Array, "*grid"]
    velocity: Float64[Array, "*grid"]


def motion(gamma: Array, delta: Array, time: Array) -> Motion:
    """Sum a Taylor series for a small time and double that time: sums keep their accuracy."""
    xp = namespace(gamma, delta, time)
    doublings = _doublings(gamma, delta) if xp is np else _DOUBLINGS
    short = time * 2.0**-doublings
    before, term = xp.zeros_like(short), 0.5 * short**2
    position, moment = term, 2.0 * term
    for k in range(2, _TERMS):
        following = -(delta * short * term + gamma * short**2 * before / k) / (k + 1)
        before, term = term, following
        position, moment = position + term, moment + (k + 1) * term

    def doubled(half: Motion) -> Motion:
        p, v = half
        return Motion(2 * p - gamma * p**2 + v**2, 2 * v - delta * v**2 - 2 * gamma * p * v)

    start = Motion(position, moment / xp.where(short == 0.0, 1.0, short))
    if xp is not np:
        return repeat(_DOUBLINGS, doubled, start)
    moved = start
    for count in range(int(np.max(doublings, initial=0.0))):
        moved = Motion(*map(partial(np.where, count < doublings), doubled(moved), moved))
    return moved


def _doublings(gamma: Array, delta: Array) -> Array:
    """Return how often to double the time in which a plant moves by no more than about 1/4."""
    rates = 4.0 * (np.sqrt(np.abs(gamma)) + np.abs(delta))
    return np.ceil(np.log2(np.fmax(np.fmin(rates, 2.0**_DOUBLINGS), 1.0)))  # whatever is NaN


class QuickPlant(NamedTuple):
    """D(z) = z^2 + d1 z + d0 and N(z) = n2 z^2 + n1 z + n0, with some slopes, in plain float64.

    ``impulse`` and ``kept`` are position and velocity one sample after an impulse, ``early`` and
    ``late`` the slopes by the delay: n2 loses early, n0 gains late, n1 the rest. ``d_error`` and
    ``n_error`` bound the errors of D and N on the circle, beyond a few roundings of their terms.
    """

    d1: Float64[Array, "*grid"]
    d0: Float64[Array, "*grid"]
    n2: Float64[Array, "*grid"]
    n1: Float64[Array, "*grid"]
    n0: Float64[Array, "*grid"]
    sum: Float64[Array, "*grid"]
    impulse: Float64[Array, "*grid"]
    kept: Float64[Array, "*grid"]
    early: Float64[Array, "*grid"]
    late: Float64[Array, "*grid"]
    d_error: Float64[Array, "*grid"]
    n_error: Float64[Array, "*grid"]


def accurate_plant(
    gamma: Float64[np.ndarray, " loop"],
    delta: Float64[np.ndarray, " loop"],
    delay: Float64[np.ndarray, " loop"],
) -> QuickPlant:
    """Return the sampled plants of loops to full precision; equal plants are computed once."""
    hands = np.stack([gamma, delta, delay - np.floor(delay)], axis=-1)
    hands, number = np.unique(hands, axis=0, return_inverse=True)
    alone = len(hands) == 1
    # Single ones are remembered.
    exact = plant_coefficients(**by_name(*hands[0] if alone else hands.T))
    plant = quick_plant(*hands.T)._replace(
        d1=exact.d1, d0=exact.d0, n2=exact.n2, n1=exact.n1, n0=exact.n0, sum=exact.sum
    )
    zero = np.zeros(len(hands))
    plant = plant._replace(d_error=zero, n_error=zero)
    return QuickPlant(*(np.broadcast_to(part, len(hands))[number.ravel()] for part in plant))


def quick_plant(gamma: Array, delta: Array, delay: Array) -> QuickPlant:
    """Return the sampled plant, good to about 1e-14 of one."""
    xp = namespace(gamma, delta, delay)
    rest_of_sample = xp.floor(delay) + 1.0 - delay
    times = xp.stack(xp.broadcast_arrays(xp.ones_like(gamma + delta), rest_of_sample))
    full, held = map(Motion, *motion(gamma, delta, times))
    kept = 1.0 - delta * full.velocity - gamma * full.position
    total = full.position + full.velocity**2 - kept * full.position
    later = full.position - held.position
    n2, early = held
    n1 = later + full.velocity * early - kept * n2
    n0 = full.velocity * (full.velocity - early) - kept * later
    late = full.velocity * (1.0 - gamma * n2) - early * (1.0 - gamma * full.position)
    d1, d0 = gamma * full.position - 1.0 - kept, xp.exp(-delta)
    slopes = (full.velocity, kept, early, late)
    errors = (_LOST * (2.0 + xp.sqrt(abs(gamma))), xp.full_like(n1, 4.0 * _LOST))
    return QuickPlant(d1, d0, n2, n1, n0, total, *slopes, *errors)


def quick_slice(gamma: Array, delta: Array, delay: Array) -> SliceCoefficients:
    """Return the slice for radius 1 in plain float64: quick to compile and to differentiate.

    Good to about 1e-14 of one, where ``slice_coefficients`` gives each value digits of its own.
    """
    xp = namespace(gamma, delta, delay)
    plant = quick_plant(gamma, delta, delay)
    one = xp.ones_like(plant.d0)
    return SliceCoefficients(
        radius=one,
        turns=xp.floor(delay) + 1.0,
        gain=one,
        ratio=gamma,
        kappa=1.0 + plant.d0,
        eps=-xp.expm1(-delta),
        sigma=plant.n2 + plant.n0,
        nu=plant.n2 - plant.n0,
        den_plus=gamma * plant.sum,
        den_minus=1.0 - plant.d1 + plant.d0,
        num_plus=plant.sum,
        num_minus=plant.n2 - plant.n1 + plant.n0,
    )


def circle_equations(
    c: SliceCoefficients, alpha: Numbers, beta: Numbers, theta: Array
) -> tuple[Array, Array]:
    """Return Re g and Im g / sin(theta); differentiable, and smooth in theta at 0 and pi."""
    xp = namespace(c, alpha, beta, theta)
    upper = theta > pi / 2
    folded = xp.where(upper, (pi - theta) + PI_REST, theta)
    sine, is_end = xp.sin(folded), folded == 0.0
    turn = xp.where(upper, 1.0 - 2.0 * (c.turns % 2.0), 1.0)
    cosine_m = turn * xp.cos(c.turns * folded)
    ratio = xp.where(
        is_end, c.turns, xp.sin(c.turns * folded) / xp.where(is_end, 1.0, sine)
    )  # sin(m theta) / sin(theta)
    ratio_m = xp.where(upper, -turn, 1.0) * ratio
    near, far = 2.0 * xp.sin(0.5 * folded) ** 2, 2.0 * xp.cos(0.5 * folded) ** 2
    h, rest = xp.where(upper, far, near), xp.where(upper, near, far)  # 1 -+ cos(theta)
    d = xp.where(upper, c.kappa * rest - c.den_minus, c.den_plus - c.kappa * h)
    q = xp.where(upper, c.sigma * rest - c.num_minus, c.num_plus - c.sigma * h)
    wall = alpha + beta * h
    # (N/z) H = push + i sin(theta) turned
    push = q * wall - c.nu * beta * sine**2
    turned = q * beta + c.nu * wall
    real = d + cosine_m * push + ratio_m * sine**2 * turned
    imaginary = c.eps + cosine_m * turned - ratio_m * push
    return real, imaginary
