"""The simple rules beside the exact boundary: the linear condition, and passive walls.

The linear condition replaces sampling and hold by a delay of half a sample, so the loop has the
effective delay t_r = t_d + T/2, in samples 1/2 + delay.

A passive wall may be touched by any passive hand, whatever the mass and stiffness. A wall behind
a sampler, a delay d = n + f and a zero-order hold is passive together with the physical damping
delta when, for every theta in [0, pi],

    delta > R + f (1 - f) |H|^2 / (4 delta),            H = alpha + beta (1 - e^(-i theta))
    R = (1 - f) R_n + f R_(n+1),        R_k = alpha sin((k + 1/2) theta) / (2 sin(theta/2))
                                              - beta cos((k + 1) theta)

For a whole delay, f = 0, this is Colgate's condition, the paper's (28) at d = 0. For a fraction the
sampler folds frequencies that the hold releases with different phases: the damper must outweigh the
larger eigenvalue of a Hermitian form of rank two, which is the condition above. (Colgate's formula
with a fractional delay errs to either side.) For each theta the condition describes a convex set
that grows in proportion to delta, so the passive region is convex and grows likewise.

A wall of negative stiffness is not passive at rest, hence alpha >= 0. Proof: lemma C6 of
docs/proofs.md.
"""

from dataclasses import dataclass, field
from math import floor, pi, sqrt
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.arrays import Array, Numbers, float_arrays, joined
from jaxstab.model import checked_delay, checked_delta, checked_gain, checked_gamma, require_x64
from jaxstab.numbers import checked_number
from jaxstab.region.closed_form import slice_coefficients
from jaxstab.rounding import EPS


def linear_alpha_limit(beta: Numbers, *, delta: Numbers, delay: Numbers) -> Float64[Array, "*grid"]:
    """Largest alpha for which the linear condition promises stability.

    Args and Raises: see ``jaxstab.conventions``.

    Source: eqs. (22) and (23) of Hulin, Preusche, Hirzinger (2008).

    Example:
        >>> round(float(jaxstab.paper.linear_alpha_limit(0.2, delta=0.015, delay=1.0)), 9)
        0.143333333
    """
    _, beta, _, delta, lag = checked_loop(0.0, beta, 0.0, delta, delay)
    return (beta + delta) / lag


def linear_condition(
    alpha: Numbers, beta: Numbers, *, gamma: Numbers, delta: Numbers, delay: Numbers
) -> Bool[Array, "*grid"]:
    """True where the linear condition holds: alpha > -gamma and beta + delta > alpha t_r.

    t_r = 1/2 + delay. The condition neither implies stability nor follows from it;
    ``linear_validity`` says up to which stiffness it is close to the exact boundary.

    Args and Raises: see ``jaxstab.conventions``.

    Source: eqs. (19), (22) and (23) of Hulin, Preusche, Hirzinger (2008).

    Example:
        >>> bool(jaxstab.paper.linear_condition(0.1, 0.2, gamma=0.0, delta=0.015, delay=1.0))
        True
    """
    alpha, beta, gamma, delta, lag = checked_loop(alpha, beta, gamma, delta, delay)
    return (alpha > -gamma) & (beta + delta > alpha * lag)


def linear_error(
    alpha: Numbers, beta: Numbers, *, gamma: Numbers, delta: Numbers, delay: Numbers
) -> Float64[Array, "*grid"]:
    """Signed error (alpha_lin - alpha) / (alpha + gamma) at a point of the exact boundary.

    Eq. (24) is its absolute value. It is positive where the linear condition promises more
    stiffness than is stable, negative where it promises less, infinite or NaN at alpha = -gamma.

    Args and Raises: see ``jaxstab.conventions``.

    Source: eq. (24) of Hulin, Preusche, Hirzinger (2008).

    Example:
        >>> alpha, beta = jaxstab.boundary_curve(0.2, gamma=0.0, delta=0.0, delay=0.0)
        >>> error = jaxstab.paper.linear_error(alpha, beta, gamma=0.0, delta=0.0, delay=0.0)
        >>> round(float(error), 4)
        0.0203
    """
    alpha, beta, gamma, delta, lag = checked_loop(alpha, beta, gamma, delta, delay)
    with np.errstate(all="ignore"):
        return ((beta + delta) / lag - alpha) / (alpha + gamma)


def checked_loop(
    alpha: Numbers, beta: Numbers, gamma: Numbers, delta: Numbers, delay: Numbers
) -> list[Array]:
    """Return the checked parameters as float64 arrays, with the effective delay for the delay."""
    require_x64(alpha, beta, gamma, delta, delay)
    return float_arrays(
        checked_gain("alpha", alpha),
        checked_gain("beta", beta),
        checked_gamma(gamma),
        checked_delta(delta),
        checked_delay(delay) + 0.5,
    )


# The loop as a third-order model in continuous time, and its condition of Routh and Hurwitz.
def routh_hurwitz_condition(
    alpha: Numbers, beta: Numbers, *, gamma: Numbers, delta: Numbers, delay: Numbers
) -> Bool[Array, "*grid"]:
    """True where the third-order model of the loop is stable.

    The model is continuous in time, with the effective delay t_r = 1/2 + delay as a first-order
    lag. The linear condition is this one without the term delta t_r (beta + delta + gamma t_r).

    Args and Raises: see ``jaxstab.conventions``.

    Source: eqs. (17)-(21) of Hulin, Preusche, Hirzinger (2008).

    Example:
        >>> bool(jaxstab.paper.routh_hurwitz_condition(0.1, 0.2, gamma=0.0, delta=0.015, delay=1.0))
        True
    """
    alpha, beta, gamma, delta, lag = checked_loop(alpha, beta, gamma, delta, delay)
    damped = beta + delta + gamma * lag > 0
    stiff = alpha + gamma > 0
    fast = delta * lag * (beta + delta + gamma * lag) + (beta + delta - alpha * lag) > 0
    return damped & stiff & fast


# The straight lines of the plane (alpha, beta) on which a real root lies at z = 1 or z = -1.


def plus_line(
    beta: Numbers, *, gamma: Numbers, delta: Numbers, delay: Numbers, radius: Numbers = 1.0
) -> Float64[Array, "*grid"]:
    """The alpha that puts a real root at z = +radius; for radius 1 it is -gamma.

    Args:
        beta, gamma, delta, delay: see ``jaxstab.conventions``.
        radius: modulus of the root in (0, 1].

    Returns:
        alpha of the broadcast shape; infinite where N(radius) = 0.

    Raises: see ``jaxstab.conventions``.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) at z = radius.

    Example:
        >>> float(jaxstab.paper.plus_line(0.5, gamma=0.001, delta=0.015, delay=0.0))
        -0.001
    """
    require_x64(beta, gamma, delta, radius)
    return _line(beta, *slice_coefficients(gamma, delta, delay, radius).plus_line)


def minus_line(
    beta: Numbers, *, gamma: Numbers, delta: Numbers, delay: Numbers, radius: Numbers = 1.0
) -> Float64[Array, "*grid"]:
    """The alpha that puts a real root at z = -radius.

    Infinite where N(-radius) = 0 (delta = 0 and a whole delay); arguments, errors and source as
    ``plus_line``. Raises: see there.

    Example:
        >>> round(float(jaxstab.paper.minus_line(0.5, gamma=0.0, delta=0.015, delay=0.0)), 4)
        1599.036
    """
    require_x64(beta, gamma, delta, radius)
    with np.errstate(all="ignore"):  # infinite where N(-radius) = 0
        return _line(beta, *slice_coefficients(gamma, delta, delay, radius).minus_line)


def _line(beta: Numbers, offset: Array, slope: Array) -> Array:
    (damping,) = float_arrays(checked_gain("beta", beta))
    with np.errstate(all="ignore"):
        return offset - damping * slope


# Proved facts about cosine series f(theta) = sum_k c_k cos(k theta) on [0, pi].
#
# Criteria that hold "for all frequencies" are such series. They are bounded between samples by
#
#     |f(theta) - f(t) - f'(t) (theta - t)| <= M (theta - t)^2 / 2,      M = sum_k k^2 |c_k|,
#
# so a sample decides for its neighbourhood, and where it cannot decide more samples are taken.
# Series that are sums of the same few series are evaluated as such: ``weights @ basis``.

Coefficients = Float64[np.ndarray, "batch term"]

Values = Float64[np.ndarray, " batch"]

_LARGEST_GAP = 1e-13  # of the sizes: how far the bound of a largest value may lie above it
_AT_ONCE = 1 << 18  # cells, and terms at angles, that are held in memory


class LargestValue(NamedTuple):
    """A value that each series takes, its angle, and a proved upper bound of all values."""

    value: Values
    theta: Values
    bound: Values


def largest_value(
    weights: Float64[np.ndarray, "batch part"], basis: Float64[np.ndarray, "part term"]
) -> LargestValue:
    """Return the largest values of series ``weights @ basis`` over [0, pi], by branch and bound.

    The bound is above the value by at most 1e-13 of the sizes |weights| @ |basis|, summed, and the
    rounding of the series.
    """
    cells = 4 * basis.shape[1]
    rows = max(1, _AT_ONCE // cells)
    parts = range(0, len(weights), rows)
    answers = [_largest_value(weights[start : start + rows], basis, cells) for start in parts]
    return joined(answers)


def _largest_value(weights: np.ndarray, basis: np.ndarray, cells: int) -> LargestValue:
    batch = len(weights)
    order = np.arange(basis.shape[1])
    curvature = np.abs(weights @ basis) @ order**2
    sizes = np.abs(weights) @ np.abs(basis)
    gap = _LARGEST_GAP * np.sum(sizes, axis=-1)
    half = pi / (2 * cells)
    owner = np.repeat(np.arange(batch), cells)
    center = np.tile((2 * np.arange(cells) + 1) * half, batch)
    best, angle = np.full(batch, -np.inf), np.zeros(batch)
    while owner.size:
        value, slope = _combined(weights, basis, owner, center)
        climb = np.argsort(value)  # of equal owners the last one written stays
        better = climb[value[climb] > best[owner[climb]]]
        best[owner[better]], angle[owner[better]] = value[better], center[better]
        above = value + np.abs(slope) * half + 0.5 * curvature[owner] * half**2
        is_open = above > best[owner] + gap[owner]
        half /= 2
        owner = np.repeat(owner[is_open], 2)
        center = (center[is_open, None] + np.array([-half, half])).ravel()
    return LargestValue(best, angle, best + gap + _rounding(sizes, len(basis)))


def _combined(
    weights: np.ndarray, basis: np.ndarray, owner: np.ndarray, center: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return values and slopes of series at their centers, of which many have the same."""
    angles, index = np.unique(center, return_inverse=True)
    rows = max(1, _AT_ONCE // basis.shape[1])
    order = np.arange(basis.shape[1])
    table = np.empty((2, len(angles), len(basis)))
    for start in range(0, len(angles), rows):
        block = slice(start, start + rows)
        phase = angles[block, None] * order
        table[0, block] = np.cos(phase) @ basis.T
        table[1, block] = np.sin(phase) @ (-order * basis).T
    value, slope = np.einsum("kij,ij->ki", table[:, index], weights[owner])
    return value, slope


def _rounding(sizes: Coefficients, parts: int) -> Values:
    """Bound the rounding error of a computed value: of the phases and of the sums."""
    order = np.arange(sizes.shape[-1])
    units = order * pi + len(order) + parts + 5
    rounding: Values = EPS * (sizes @ units)
    return rounding


# Passive regions.

Points = Float64[np.ndarray, "points 2"]

Needs = Float64[np.ndarray, " points"]  # dampings

_MARGIN = 1e-12  # by which an outline is pulled in, so that rounding does not spoil its proof
_FIRST_DIRECTIONS = np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 1.0]])  # two ends of an edge, beyond
_CHUNK = 4096  # points tested at once


@dataclass(frozen=True)
class PassiveRegion:
    """The passive walls of one damping and delay: a convex set, part of the plane (alpha, beta).

    ``outline`` holds the vertices, shape (n, 2), counterclockwise, the first one not repeated;
    there is none if delta = 0. Every point of the polygon is proved passive (vertices within 1e-12
    of their size); the region extends at most about ``tolerance`` times delta beyond it.

    Example:
        >>> region = jaxstab.paper.passive_region(delta=1.0)
        >>> region.max_alpha.round(9).tolist(), region.contains([1.0, 2.5], 0.1).tolist()
        ([2.0, 0.0], [True, False])
    """

    delta: float
    delay: float
    tolerance: float
    outline: Points = field(repr=False)

    @property
    def max_alpha(self) -> Float64[np.ndarray, " 2"]:
        """The vertex (alpha, beta) of the largest stiffness; (0, 0) for an empty region."""
        if not len(self.outline):
            return np.zeros(2)
        vertex: Float64[np.ndarray, " 2"] = self.outline[np.argmax(self.outline[:, 0])]
        return vertex

    def contains(self, alpha: Numbers, beta: Numbers) -> Bool[np.ndarray, "*grid"]:
        """True where (alpha, beta) is proved passive; each wall is tested anew."""
        gains = (checked_gain("alpha", alpha), checked_gain("beta", beta))
        grid = np.stack(np.broadcast_arrays(*(np.asarray(g, np.float64) for g in gains)), axis=-1)
        flat = grid.reshape(-1, 2)
        inside = (flat[:, 0] >= 0.0) & (self.delta > 0.0)
        for start in range(0, len(flat), _CHUNK):
            chunk = slice(start, start + _CHUNK)
            points = flat[chunk] / (self.delta or 1.0)
            weights = _weights(points, np.ones(len(points)), self.delay)
            inside[chunk] &= largest_value(weights, _basis(self.delay)).bound < 1
        return inside.reshape(grid.shape[:-1])


def passive_region(
    *, delta: int | float, delay: int | float = 0.0, tolerance: int | float = 1e-4
) -> PassiveRegion:
    """The set of walls that are passive whatever the mass, stiffness and hand.

    A passive wall is stable with every passive environment, so the region lies in every robustly
    stable region of this damping and delay.

    Args:
        delta, delay: see ``jaxstab.conventions``.
        tolerance: how far the region may bulge beyond the chords of its outline, times delta; at
            least 1e-8.

    Raises: see ``jaxstab.conventions``; TypeError also for an array.

    Example:
        >>> region = passive_region(delta=0.7)
        >>> region.contains([1.3, 1.5], 0.0).tolist()
        [True, False]

    Source: eq. (28) of Hulin, Preusche, Hirzinger (2008) at d = 0; Colgate and Schenkel (1997) for
    whole delays; for fractional ones the Hermitian form of lemma C6 in docs/proofs.md.
    """
    require_x64(delta, delay)
    delta = checked_number("delta", checked_delta(delta))
    delay = checked_number("delay", checked_delay(delay))
    tolerance = checked_number("tolerance", tolerance, 1e-8)
    if delta == 0.0:
        return PassiveRegion(delta, delay, tolerance, np.zeros((0, 2)))
    points = _boundary_points(_FIRST_DIRECTIONS, delay)
    is_open = np.ones(len(points) - 1, bool)
    while is_open.any():
        chords = np.flatnonzero(is_open)
        start, end = points[chords], points[chords + 1]
        # Over the middle of a chord a convex arc is at least half as high as anywhere.
        between = _boundary_points(0.5 * (start + end), delay)
        bulges = _distance(between, start, end) > 0.5 * tolerance
        is_open[chords] = bulges
        indices = chords[bulges] + 1
        points = np.insert(points, indices, between[bulges], axis=0)
        is_open = np.insert(is_open, indices, True)
    return PassiveRegion(delta, delay, tolerance, delta * points)


def _boundary_points(directions: Points, delay: float) -> Points:
    """Return the boundary points of the region of delta = 1 in these directions from the origin."""
    directions = directions / np.hypot(*directions.T)[:, None]
    basis, fraction = _basis(delay), delay - floor(delay)
    need = largest_value(directions, basis[:2]).value
    if fraction:
        need = np.maximum(need, 0.5 * sqrt(fraction * (1 - fraction)) * np.abs(directions[:, 0]))
        need = _raised(need, directions, delay)
    points: Points = directions / (need * (1 + _MARGIN))[:, None]
    return points


def _raised(need: Needs, directions: Points, delay: float) -> Needs:
    """Return the damping that all thetas need, from one that a theta needs."""
    # Newton's method, from below on a convex function.
    for _ in range(60):
        theta = largest_value(_weights(directions, need, delay), _basis(delay)).theta
        raised = np.maximum(need, _need_at(theta, directions, delay))
        if np.all(raised <= need * (1 + 1e-15)):
            return raised
        need = raised
    return need


def _need_at(theta: Float64[np.ndarray, " points"], directions: Points, delay: float) -> Needs:
    fraction = delay - floor(delay)
    series = directions @ _basis(delay)[:2]
    real = np.sum(series * np.cos(theta[:, None] * np.arange(series.shape[-1])), axis=-1)
    alpha, beta = directions.T
    wall = alpha**2 + 4 * beta * (alpha + beta) * np.sin(theta / 2) ** 2
    need: Needs = 0.5 * (real + np.sqrt(real**2 + fraction * (1 - fraction) * wall))
    return need


def _basis(delay: float) -> Float64[np.ndarray, "4 term"]:
    """Return R of alpha = 1 and of beta = 1, 1 and cos(theta), as cosine series."""
    whole = floor(delay)
    fraction = delay - whole
    basis = np.zeros((4, whole + 3))
    basis[0, : whole + 2] = [0.5, *[1.0] * whole, fraction]
    basis[1, whole + 1 :] = fraction - 1.0, -fraction
    basis[2, 0] = basis[3, 1] = 1.0
    return basis


def _weights(walls: Points, delta: Needs, delay: float) -> Float64[np.ndarray, "points 4"]:
    """Return R + f (1 - f) |H|^2 / (4 delta) as sums of the basis."""
    fraction = delay - floor(delay)
    alpha, beta = walls.T
    fold = fraction * (1 - fraction) / (4 * delta)
    still, moving = (alpha + beta) ** 2 + beta**2, -2 * beta * (alpha + beta)
    return np.stack([alpha, beta, fold * still, fold * moving], axis=-1)


def _distance(point: Points, start: Points, end: Points) -> Float64[np.ndarray, " points"]:
    chord, away = end - start, point - start
    across = np.abs(chord[:, 0] * away[:, 1] - chord[:, 1] * away[:, 0])
    distance: Float64[np.ndarray, " points"] = across / np.hypot(*chord.T)
    return distance
