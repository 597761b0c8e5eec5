"""Proof that no root crosses the unit circle anywhere in a cell of the grid.

A cell is a box in (alpha, beta, gamma, delta) at one delay.

With n = floor(delay) and the plant's D and N for the fraction of the delay,

    F = p(z) / z^(n+3) = D(z)/z + W(z) L,     W = N(z) z^-(n+2),  L = alpha + beta s,  s = 1 - 1/z.

If F has no zero on the circle z = e^(i th) for any parameters in the cell, the number of roots
inside is one number for the whole cell (zero exclusion). Around the value F_c at the centre of the
cell, the half-widths h move F by h_alpha W + h_beta W s (up to signs) and by what the plant moves,

    |D - D_c| + |N - N_c| sup |L|.

Zero is excluded when in some direction F_c is farther from zero than all of that is wide. Three
directions are tried: F_c itself, and the normals to W and to W s, across which the largest part of
the motion is not seen. Between its samples a function f of th stays within (step^2 / 8) sup |f''|
of its chord; |L|, |s| and |z - 1| are monotonic.

How far the plant can move. Let h(t) be the impulse response of x'' + delta x' + gamma x = u. For
gamma, delta >= 0 its energy h'^2 + gamma h^2 does not grow, so |h'| <= 1 and |h(t)| <= t. Then

    d1      changes with gamma by -h(1) and with delta by h'(1): both at most 1 in size;
    D(1)    changes with gamma by h(1) and with delta by h'(1) - e^-delta, which is minus the
            integral of gamma e^(-delta (1 - s)) h(s) over (0, 1): at most 1 and gamma / 2;
    N       has as coefficients integrals of h(s) and of e^(-delta (1 - s)) h(s) over parts of
            (0, 1) that do not overlap. As h changes with gamma by -h*h, at most s^3 / 6, and with
            delta by -h*h', at most s^2 / 2, they change by at most h_gamma / 12 + h_delta / 2
            together;

and D - D_c = (d1 - d1_c)(z - 1) + D(1) - D_c(1).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float64

from jaxstab.model import PlantCoefficients, plant_coefficients, require_x64

_INTERVALS = 256
_BATCH = 256  # cells of one call
_ROUNDING = 1e-12  # of the largest term; the sums below lose about a hundred roundings of 1.1e-16


class Intervals(NamedTuple):
    """Intervals along an axis."""

    centre: Array
    half_width: Array

    @classmethod
    def between(cls, ends: Float64[np.ndarray, "*interval 2"]) -> "Intervals":
        """Return the intervals between lower and upper ends."""
        lower, upper = np.moveaxis(ends, -1, 0)
        centre = (lower + upper) / 2
        half_width = np.maximum(upper - centre, centre - lower)
        return cls(jnp.asarray(centre), jnp.asarray(half_width))


def cells_without_crossing(
    alpha: Float64[np.ndarray, "cell 2"],
    beta: Float64[np.ndarray, "cell 2"],
    gamma: Float64[np.ndarray, "2"],
    delta: Float64[np.ndarray, "2"],
    delay: float,
) -> Bool[np.ndarray, " cell"]:
    """Say for which cells it is proved that no root lies on the unit circle.

    Args:
        alpha: lower and upper end of each cell.
        beta: lower and upper end of each cell.
        gamma: lower and upper end of all cells in gamma, >= 0.
        delta: lower and upper end of all cells in delta, >= 0.
        delay: time delay in samples, >= 0, whole or fractional.

    Returns:
        True where the number of unstable roots is the same in the whole closed cell.

    Raises:
        RuntimeError: JAX's x64 mode is off.
        ValueError: gamma, delta or delay is outside the range of the model.

    Source: zero exclusion on eq. (9); the bounds are derived in the heading of this file.
    """
    require_x64()
    stiffness, damping = Intervals.between(gamma), Intervals.between(delta)
    plant = plant_coefficients(stiffness.centre, damping.centre, delay)
    motion = plant_motion(stiffness, damping)
    whole_delay = jnp.floor(jnp.asarray(delay))
    count = len(alpha)
    proved = np.zeros(count, bool)
    for start in range(0, count, _BATCH):  # all of one shape, compiled once
        some = np.arange(start, start + _BATCH) % count
        cells = Intervals.between(alpha[some, None]), Intervals.between(beta[some, None])
        part = np.asarray(_without_crossing(*cells, plant, motion, whole_delay))
        proved[start : start + _BATCH] = part[: count - start]
    return proved


class PlantMotion(NamedTuple):
    """How far the plant's coefficients can be from those at the centre of the cell."""

    d1: Array
    den_at_one: Array
    numerator: Array  # the sum over n2, n1, n0


def plant_motion(gamma: Intervals, delta: Intervals) -> PlantMotion:
    """Return the bounds that are derived in the heading of this file, for one cell."""
    h_gamma, h_delta = gamma.half_width, delta.half_width
    largest_gamma = gamma.centre + h_gamma
    return PlantMotion(
        d1=h_gamma + h_delta,
        den_at_one=h_gamma + 0.5 * largest_gamma * h_delta,
        numerator=h_gamma / 12.0 + 0.5 * h_delta,
    )


class _Circle(NamedTuple):
    """The upper half circle, sampled, for one slice of cells; F = plant + W alpha + W s beta."""

    plant: Array
    wall: Array  # W
    slope: Array  # s
    plant_moves: Array  # per interval between samples, as the rest
    bend: Array  # step^2 / 8
    curvature: Array  # sup |f''| of the plant part, of W and of W s


@jax.jit
def _without_crossing(
    alpha: Intervals,
    beta: Intervals,
    plant: PlantCoefficients,
    motion: PlantMotion,
    whole_delay: Array,
) -> Array:
    circle = _circle(plant, motion, whole_delay)
    steepness = _largest_at_ends(jnp.abs(circle.wall)) + circle.bend * circle.curvature[1]
    gain = alpha.centre + beta.centre * circle.slope
    gain_moves = _size(alpha.half_width + beta.half_width * circle.slope[1:])
    value = circle.plant + circle.wall * gain
    clear = _distance_to_chord(value[:, :-1], value[:, 1:]) - steepness * gain_moves
    for along in _directions(circle):
        clear = jnp.maximum(clear, along.clearance(alpha, beta))
    bent = jnp.stack(jnp.broadcast_arrays(1.0, jnp.abs(alpha.centre), jnp.abs(beta.centre)))
    curvature = jnp.tensordot(circle.curvature, bent, 1)
    moves = circle.plant_moves + motion.numerator * (_largest_at_ends(_size(gain)) + gain_moves)
    scale = 4.0 + plant.sum * (jnp.abs(alpha.centre) + 2.0 * jnp.abs(beta.centre))
    return jnp.all(clear - circle.bend * curvature - moves > _ROUNDING * scale, axis=1)


def _circle(plant: PlantCoefficients, motion: PlantMotion, whole_delay: Array) -> _Circle:
    # Small steps near z = 1, where F is as small as alpha + gamma.
    angle = jnp.asarray(np.pi * (np.arange(_INTERVALS + 1) / _INTERVALS) ** 1.5)
    z = jnp.exp(1j * angle)
    powers = whole_delay + jnp.arange(4.0)  # of 1/z in W and W s
    sizes = jnp.abs(jnp.stack([plant.n2, plant.n1, plant.n0]))
    of_wall, of_delayed_wall = sizes @ powers[:-1] ** 2, sizes @ powers[1:] ** 2
    return _Circle(
        plant=z + plant.d1 + plant.d0 / z,
        wall=(plant.n2 * z + plant.n1 + plant.n0 / z) * z ** (-whole_delay - 1.0),
        slope=1.0 - 1.0 / z,
        plant_moves=(motion.d1 * jnp.abs(z - 1.0) + motion.den_at_one)[1:],
        bend=jnp.diff(angle) ** 2 / 8.0,
        curvature=jnp.stack([1.0 + plant.d0, of_wall, of_wall + of_delayed_wall]),
    )


class _Direction(NamedTuple):
    """A direction per interval, and what of F is seen along it at the two ends of the interval."""

    plant: Array  # (2, interval)
    alpha: Array
    beta: Array
    alpha_moves: Array  # the largest in each interval
    beta_moves: Array

    def clearance(self, alpha: Intervals, beta: Intervals) -> Array:
        """Return how far F_c is from zero along this direction, less what the gains move it."""
        start, end = (
            self.plant[side] + self.alpha[side] * alpha.centre + self.beta[side] * beta.centre
            for side in (0, 1)
        )
        clear = jnp.maximum(jnp.minimum(start, end), -jnp.maximum(start, end))
        return clear - (alpha.half_width * self.alpha_moves + beta.half_width * self.beta_moves)


def _directions(circle: _Circle) -> tuple[_Direction, ...]:
    """Return the normals to W and to W s."""
    parts = (circle.plant, circle.wall, circle.wall * circle.slope)

    def seen_across(part: Array) -> _Direction:
        middle = part[:-1] + part[1:]
        size = _size(middle)
        normal = 1j * middle / jnp.where(size > 0.0, size, 1.0)
        ends = [jnp.stack([(normal.conj() * side).real for side in (f[:-1], f[1:])]) for f in parts]
        moves = [
            jnp.max(jnp.abs(seen), axis=0) + circle.bend * bent
            for seen, bent in zip(ends[1:], circle.curvature[1:], strict=True)
        ]
        return _Direction(*ends, *moves)

    return seen_across(parts[1]), seen_across(parts[2])


def _distance_to_chord(start: Array, end: Array) -> Array:
    """Return the distance of the straight line between two complex numbers from zero."""
    step = end - start
    length_squared = step.real**2 + step.imag**2
    along = -(start.real * step.real + start.imag * step.imag)
    part = jnp.clip(along / jnp.where(length_squared > 0.0, length_squared, 1.0), 0.0, 1.0)
    return _size(start + part * step)


def _size(value: Array) -> Array:
    # |z| without the care for overflow that makes jnp.abs slow
    return jnp.sqrt(value.real**2 + value.imag**2)


def _largest_at_ends(samples: Array) -> Array:
    return jnp.maximum(samples[..., :-1], samples[..., 1:])
