"""Roots on the unit circle: the two real equations for them, and the proof that a box has none.

With z = e^(i theta), m = floor(delay) + 1 and the notation of ``curve``,

    g = p(z) / z^(m + 2) = D/z + z^-m (N/z) H,      H = alpha + beta (1 - 1/z).

g is continuous in all six variables, in the delay too. Re g and Im g / sin(theta) are even and
2 pi-periodic in theta, so the equations Re g = 0, Im g / sin(theta) = 0 of a pair of roots go on
smoothly to theta = 0 and pi, where the pair meets a real root.
"""

from math import pi
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Bool, Complex128, Float64

from jaxstab.model import plant_coefficients
from jaxstab.region.curve import SliceCoefficients

Reals = Float64[np.ndarray, " boxes"]

_PI_REST = 1.2246467991473532e-16  # pi minus the float64 next to it
_DIRECTIONS = np.exp(1j * np.pi * np.arange(16) / 8)  # of half-planes that may separate g from 0
_SMALL_BATCH, _BATCH = 64, 2048  # few sizes: each is compiled
_DOUBLINGS = 12
_TERMS = 12


class Loops(NamedTuple):
    """Loops and an angle each: the five parameters in their order, then theta."""

    alpha: Reals
    beta: Reals
    gamma: Reals
    delta: Reals
    delay: Reals
    theta: Reals


class _Motion(NamedTuple):
    """Position and velocity after a unit step of force on the plant at rest."""

    position: Array
    velocity: Array


def quick_slice(gamma: Array, delta: Array, delay: Array) -> SliceCoefficients:
    """Return the slice for radius 1 in plain float64: quick to compile and to differentiate.

    Good to about 1e-14 of one, where ``slice_coefficients`` gives each value digits of its own.
    """
    turns = jnp.floor(delay) + 1.0
    full = _motion(gamma, delta, jnp.ones_like(delay))
    early = _motion(gamma, delta, turns - delay)
    kept = 1.0 - delta * full.velocity - gamma * full.position  # velocity left of a unit one
    total = full.position + full.velocity**2 - kept * full.position
    later = full.position - early.position
    n2 = early.position
    n1 = later + full.velocity * early.velocity - kept * n2
    n0 = full.velocity * (full.velocity - early.velocity) - kept * later
    d1, d0 = gamma * full.position - 1.0 - kept, jnp.exp(-delta)
    one = jnp.ones_like(d0)
    return SliceCoefficients(
        radius=one,
        turns=turns,
        gain=one,
        ratio=gamma,
        kappa=1.0 + d0,
        eps=-jnp.expm1(-delta),
        sigma=n2 + n0,
        nu=n2 - n0,
        den_plus=gamma * total,
        den_minus=1.0 - d1 + d0,
        num_plus=total,
        num_minus=n2 - n1 + n0,
    )


def _motion(gamma: Array, delta: Array, time: Array) -> _Motion:
    """Sum a Taylor series for a small time and double that time: sums keep their accuracy."""
    short = time * 2.0**-_DOUBLINGS
    before, term = jnp.zeros_like(short), 0.5 * short**2
    position, moment = term, 2.0 * term
    for k in range(2, _TERMS):
        following = -(delta * short * term + gamma * short**2 * before / k) / (k + 1)
        before, term = term, following
        position, moment = position + term, moment + (k + 1) * term
    start = _Motion(position, moment / jnp.where(short == 0.0, 1.0, short))

    def doubled(_: Array, half: _Motion) -> _Motion:
        p, v = half
        return _Motion(2 * p - gamma * p**2 + v**2, 2 * v - delta * v**2 - 2 * gamma * p * v)

    motion: _Motion = lax.fori_loop(0, _DOUBLINGS, doubled, start)
    return motion


class Exclusion(NamedTuple):
    """Whether a box is proved free of roots on the circle, and how steep g is in each variable."""

    free: Bool[np.ndarray, " boxes"]
    slopes: Float64[np.ndarray, "6 boxes"]


def circle_equations(
    c: SliceCoefficients, alpha: Array, beta: Array, theta: Array
) -> tuple[Array, Array]:
    """Return Re g and Im g / sin(theta); differentiable, and smooth in theta at 0 and pi."""
    upper = theta > pi / 2
    folded = jnp.where(upper, (pi - theta) + _PI_REST, theta)
    sine, at_end = jnp.sin(folded), folded == 0.0
    turn = jnp.where(upper, 1.0 - 2.0 * (c.turns % 2.0), 1.0)
    cosine_m = turn * jnp.cos(c.turns * folded)
    ratio = jnp.where(
        at_end, c.turns, jnp.sin(c.turns * folded) / jnp.where(at_end, 1.0, sine)
    )  # sin(m theta) / sin(theta)
    ratio_m = jnp.where(upper, -turn, 1.0) * ratio
    near, far = 2.0 * jnp.sin(0.5 * folded) ** 2, 2.0 * jnp.cos(0.5 * folded) ** 2
    h, rest = jnp.where(upper, far, near), jnp.where(upper, near, far)  # 1 -+ cos(theta)
    d = jnp.where(upper, c.kappa * rest - c.den_minus, c.den_plus - c.kappa * h)
    q = jnp.where(upper, c.sigma * rest - c.num_minus, c.num_plus - c.sigma * h)
    wall = alpha + beta * h
    # (N/z) H = push + i sin(theta) turned
    push = q * wall - c.nu * beta * sine**2
    turned = q * beta + c.nu * wall
    real = d + cosine_m * push + ratio_m * sine**2 * turned
    imaginary = c.eps + cosine_m * turned - ratio_m * push
    return real, imaginary


def exclude(center: Loops, radius: Loops) -> Exclusion:
    """Prove that no loop of a box center +- radius has a root on the circle at the box's angles.

    g is expanded at the center. For the plant's response h(t) to an impulse, |h(t)| <= t and
    |h'(t)| <= 1 whatever gamma, delta >= 0. The derivatives of the plant are convolutions of h and
    h', so this bounds every remainder. A box is free when all of g lies in one open half-plane.

    Boxes may extend to negative gamma, delta or delay; nothing is proved about these parts.
    """
    expansion = _expand(center)
    remainder, slopes = _remainders(expansion, center, radius)
    value, linear = expansion.value, expansion.linear
    ways = np.concatenate([np.broadcast_to(_DIRECTIONS[:, None], (16, len(value))), [_unit(value)]])
    reach = np.sum(np.abs((ways.conj()[:, None] * linear).real) * np.stack(radius), axis=1)
    clear = (ways.conj() * value).real - reach - remainder
    return Exclusion(np.any(clear > 0, axis=0), np.abs(linear) + slopes)


def exclude_any_delay(center: Loops, radius: Loops) -> Exclusion:
    """Prove the same as ``exclude`` for these delays and all that are whole samples longer.

    A box is free when nowhere in it |D/z| = |(N/z) H|: then no phase z^-m brings the two to cancel.
    """
    expansion = _expand(center)
    remainder, slopes = _remainders(expansion, center, radius)
    forced = expansion.value - expansion.free
    slope = np.abs(expansion.linear)
    slope[5] = np.abs(expansion.free_theta) + np.abs(expansion.linear[5] - expansion.free_theta)
    apart = np.abs(np.abs(expansion.free) - np.abs(forced))
    clear = apart - np.sum(slope * np.stack(radius), axis=0) - remainder
    return Exclusion(clear > 0, slope + slopes)


class _Expansion(NamedTuple):
    """g and its derivatives at the center; those of D/z only, with respect to gamma and delta."""

    value: Complex128[np.ndarray, " boxes"]
    free: Complex128[np.ndarray, " boxes"]  # D/z
    free_theta: Complex128[np.ndarray, " boxes"]
    linear: Complex128[np.ndarray, "6 boxes"]
    wall: Complex128[np.ndarray, " boxes"]  # H
    slope: Complex128[np.ndarray, " boxes"]  # 1 - 1/z
    total: Reals  # sum of the coefficients of N without their signs
    turns: Reals  # m


def _expand(center: Loops) -> _Expansion:
    alpha, beta, gamma, delta, delay, theta = center
    whole = np.floor(delay)
    fraction, turns = delay - whole, whole + 1.0
    d1, d0, n2, n1, n0 = _plants(gamma, delta, fraction)
    z = np.exp(1j * theta)
    slope = 1.0 - 1.0 / z
    wall = alpha + beta * slope
    back = z**-turns
    force = back * (n2 * z + n1 + n0 / z)  # N / z^(m + 1)
    force_theta = 1j * back * ((1 - turns) * n2 * z - turns * n1 - (turns + 1) * n0 / z)
    early = _impulse_response(gamma, delta, 1.0 - fraction)  # -dn2/ddelay
    late = np.exp(delta * (fraction - 1.0)) * _impulse_response(gamma, delta, fraction)
    force_delay = back * (late * (1.0 / z - 1.0) - early * (z - 1.0))
    impulse = _impulse_response(gamma, delta, np.ones_like(delta))
    free, free_theta = z + d1 + d0 / z, 1j * (z - d0 / z)
    linear = np.stack(
        [
            force,
            force * slope,
            impulse + 0j,
            -0.5 * d1 - 0.5 * delta * impulse - d0 / z,
            force_delay * wall,
            free_theta + force_theta * wall + force * beta * 1j / z,
        ]
    )
    return _Expansion(
        free + force * wall,
        free,
        free_theta,
        linear,
        wall,
        slope,
        np.abs(n2) + np.abs(n1) + np.abs(n0),
        turns,
    )


def _remainders(
    expansion: _Expansion, center: Loops, radius: Loops
) -> tuple[Reals, Float64[np.ndarray, "6 boxes"]]:
    """Bound |g| minus its expansion over the box; also how steep the bound is in each variable."""
    wall, slope, total, turns = expansion[4:]
    steps = np.floor(center.delay + radius.delay) + 2.0  # the largest m + 1
    lag = np.minimum(np.abs(slope) + radius.theta, 2.0)  # the largest |1 - 1/z|
    most_beta = np.abs(center.beta) + radius.beta
    wall_change = radius.alpha + np.abs(slope) * radius.beta
    most_wall = np.abs(wall) + wall_change + np.minimum(radius.theta, 2.0) * most_beta
    hand = (
        most_wall * (radius.gamma / 6 + radius.delta + lag * radius.delay**2)
        + radius.delay * lag * wall_change
        + radius.gamma**2 / 12
        + radius.gamma * radius.delta / 2
        + radius.delta**2
    )
    bend = 1.0 + 0.5 * total * (steps**2 * most_wall + (2 * steps + 1) * most_beta)
    turning = radius.theta * (
        bend * radius.theta
        + radius.delta
        + radius.delay * ((steps * lag + 1) * most_wall + lag * most_beta)
        + total * (steps * wall_change + radius.beta)
    )
    plant_change = radius.gamma / 6 + radius.delta + 2.0 * radius.delay
    rounding = 1e-15 * (turns + 8) * (4 + (total + plant_change) * most_wall)
    slopes = np.zeros((6, len(total)))
    slopes[2:4] = most_wall * np.array([[1 / 6], [1.0]])
    slopes[4] = most_wall * lag * radius.delay
    slopes[5] = bend * radius.theta
    return hand + turning + rounding, slopes


def _unit(value: Complex128[np.ndarray, " boxes"]) -> Complex128[np.ndarray, " boxes"]:
    size = np.abs(value)
    unit: Complex128[np.ndarray, " boxes"] = value / np.where(size > 0, size, 1.0)
    return unit


def _impulse_response(gamma: Reals, delta: Reals, time: Reals) -> Reals:
    """Return h(t) = t e^(-delta t/2) sinh(u)/u, u^2 = (delta^2/4 - gamma) t^2."""
    square = 0.25 * delta**2 - gamma
    u = np.sqrt(np.abs(square)) * time
    real = np.exp(u - 0.5 * delta * time) * _ratio(-np.expm1(-2.0 * u), 2.0 * u)
    oscillating = np.exp(-0.5 * delta * time) * _ratio(np.sin(u), u)
    response: Reals = time * np.where(square > 0, real, oscillating)
    return response


def _ratio(part: Reals, whole: Reals) -> Reals:
    ratio: Reals = np.where(whole == 0.0, 1.0, part / np.where(whole == 0.0, 1.0, whole))
    return ratio


def _plants(
    gamma: Reals, delta: Reals, fraction: Reals
) -> tuple[Reals, Reals, Reals, Reals, Reals]:
    """Return d1, d0, n2, n1, n0, each different plant computed once, in batches of few sizes."""
    scenes, place = np.unique(
        np.stack([gamma, delta, fraction], axis=-1), axis=0, return_inverse=True
    )
    batch = _SMALL_BATCH if len(scenes) <= _SMALL_BATCH else _BATCH
    padded = np.pad(np.maximum(scenes, 0.0), ((0, -len(scenes) % batch), (0, 0)), mode="edge")
    parts = []
    for chunk in padded.reshape(-1, batch, 3):
        plant = plant_coefficients(*chunk.T)
        parts.append(np.stack([plant.d1, plant.d0, plant.n2, plant.n1, plant.n0]))
    d1, d0, n2, n1, n0 = np.concatenate(parts, axis=1)[:, place.ravel()]
    return d1, d0, n2, n1, n0
