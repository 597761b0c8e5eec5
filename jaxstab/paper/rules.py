"""The paper's plant and its simple rules: the linear condition, and passive walls.

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
from math import floor, pi
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.arrays import Array, Numbers, float_arrays
from jaxstab.model import checked_delay, checked_delta, checked_gain, checked_gamma, require_x64
from jaxstab.model.plant import PlantCoefficients, plant_pairs, wall_grid
from jaxstab.numbers import checked_number, require_together
from jaxstab.region.closed_form import slice_coefficients


def plant_coefficients(
    *, gamma: Numbers, delta: Numbers, delay: Numbers = 0.0
) -> PlantCoefficients:
    """Discretise mass, spring and damper behind a zero-order hold and the fraction of a delay.

    Args and Raises: see ``jaxstab.conventions``.

    Returns:
        PlantCoefficients of float64 arrays of the broadcast shape, differentiable to any order in
        gamma and delta. Over gamma <= 40, delta <= 10 each field is the correctly rounded value,
        or within 3 ulp of it where it nearly vanishes (d1 at gamma = (pi/2)^2, N(z) at
        gamma = (2 pi)^2, both at delta = 0); values below 1e-300 may be flushed to zero.

    Source: eqs. (2)-(6) and (9) of Hulin, Preusche, Hirzinger (2008), rewritten; for a fractional
    delay the modified z-transform.

    Example:
        >>> free = jaxstab.paper.plant_coefficients(gamma=0.0, delta=0.0)
        >>> float(free.n1)  # N(z) = (z + 1)/2 without hand
        0.5
    """
    require_x64(gamma, delta)
    delay = checked_delay(delay)
    fraction = delay - np.floor(delay)
    pairs = plant_pairs(checked_gamma(gamma), checked_delta(delta), fraction)
    return PlantCoefficients(*(pair.rounded() for pair in pairs))


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
    require_together(alpha=alpha, beta=beta, gamma=gamma, delta=delta, delay=delay)
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
    require_together(beta=beta, gamma=gamma, delta=delta, delay=delay, radius=radius)
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
    require_together(beta=beta, gamma=gamma, delta=delta, delay=delay, radius=radius)
    with np.errstate(all="ignore"):  # infinite where N(-radius) = 0
        return _line(beta, *slice_coefficients(gamma, delta, delay, radius).minus_line)


def _line(beta: Numbers, offset: Array, slope: Array) -> Array:
    (damping,) = float_arrays(checked_gain("beta", beta))
    with np.errstate(all="ignore"):
        return offset - damping * slope


# Passive regions.

Points = Float64[np.ndarray, "points 2"]


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
        from jaxstab.exact.margins import is_passive

        grid = wall_grid(alpha=alpha, beta=beta)
        walls = grid.reshape(-1, 2)
        inside = (walls[:, 0] >= 0.0) & (self.delta > 0.0)
        # Some angle refutes most walls, and the polygon holds most others, for the set is convex.
        inside[inside] = _most_needed(walls[inside], self.delay) <= self.delta
        index = np.flatnonzero(inside)
        for number in index[~self._holds(walls[index])].tolist():
            own = walls[number].tolist()
            inside[number] = is_passive(own[0], own[1], self.delta, self.delay)
        return inside.reshape(grid.shape[:-1])

    def _holds(self, walls: Points) -> Bool[np.ndarray, " points"]:
        """True well within the outline."""
        holds = np.full(len(walls), len(self.outline) > 0)
        for start, end in zip(self.outline, np.roll(self.outline, -1, axis=0), strict=True):
            edge, away = end - start, walls - start
            products = edge * away[:, ::-1] * [1.0, -1.0]
            holds &= np.sum(products, axis=1) > 1e-14 * np.sum(np.abs(products), axis=1)
        return holds


def passive_region(
    *, delta: int | float, delay: int | float = 0.0, tolerance: int | float = 1e-4
) -> PassiveRegion:
    """The set of walls that are passive whatever the mass, stiffness and hand.

    A passive wall is stable with every passive environment, so the region lies in every robustly
    stable region of this damping and delay.

    Args:
        delta, delay: see ``jaxstab.conventions``.
        tolerance: the bulge of the region beyond the chords of its outline, times delta; at least
            1e-8.

    Raises: see ``jaxstab.conventions``; TypeError also for an array.

    Example:
        >>> region = passive_region(delta=0.7)
        >>> region.contains([1.3, 1.5], 0.0).tolist()
        [True, False]

    Source: eq. (28) of Hulin, Preusche, Hirzinger (2008) at d = 0; Colgate and Schenkel (1997) for
    whole delays; for fractional ones the Hermitian form of lemma C6 in docs/proofs.md.
    """
    require_together(delta=delta, delay=delay)
    delta = checked_number("delta", checked_delta(delta))
    delay = checked_number("delay", checked_delay(delay))
    tolerance = checked_number("tolerance", tolerance, 1e-8)
    if delta == 0.0:
        return PassiveRegion(delta, delay, tolerance, np.zeros((0, 2)))
    first = np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 1.0]])  # the ends of an edge, and beyond it
    points = _boundary_points(first, delay)
    is_open = np.ones(len(points) - 1, bool)
    while is_open.any():
        chords = np.flatnonzero(is_open)
        start, end = points[chords], points[chords + 1]
        # Over the middle of a chord a convex arc is at least half as high as anywhere.
        between = _boundary_points(0.5 * (start + end), delay)
        chord, away = end - start, between - start
        across = np.abs(chord[:, 0] * away[:, 1] - chord[:, 1] * away[:, 0])
        bulges = across > 0.5 * tolerance * np.hypot(*chord.T)
        is_open[chords] = bulges
        indices = chords[bulges] + 1
        points = np.insert(points, indices, between[bulges], axis=0)
        is_open = np.insert(is_open, indices, True)
    outline = [_pulled_in(vertex, delta, delay) for vertex in (delta * points).tolist()]
    return PassiveRegion(delta, delay, tolerance, np.array(outline))


def _boundary_points(directions: Points, delay: float) -> Points:
    """Return the boundary points of the region of delta = 1 in these directions from the origin."""
    sections = 45  # of the interval of a largest value, by the golden ratio
    angles = _angles(delay)
    seen = _needed(directions.T[:, :, None], angles, delay)
    beside = np.pad(seen, ((0, 0), (1, 1)), constant_values=-np.inf)
    owner, at = np.nonzero((seen >= beside[:, :-2]) & (seen >= beside[:, 2:]))
    low, high = angles[np.maximum(at - 1, 0)], angles[np.minimum(at + 1, len(angles) - 1)]
    own = directions[owner].T
    for _ in range(sections):
        share = 0.381966 * (high - low)
        is_left = _needed(own, low + share, delay) > _needed(own, high - share, delay)
        low, high = np.where(is_left, low, low + share), np.where(is_left, high - share, high)
    need = np.max(seen, axis=1)
    np.maximum.at(need, owner, _needed(own, 0.5 * (low + high), delay))
    points: Points = directions / need[:, None]
    return points


def _pulled_in(wall: list[float], delta: float, delay: float) -> list[float]:
    """Return a wall that is proved passive, next to one of the boundary, towards no gains."""
    from jaxstab.exact.margins import is_passive

    share = 1e-12
    while True:
        alpha, beta = (gain * (1.0 - min(share, 1.0)) for gain in wall)
        if is_passive(alpha, beta, delta, delay):
            return [alpha, beta]
        share *= 16.0


def _most_needed(walls: Points, delay: float) -> Float64[np.ndarray, " points"]:
    """Return the largest damping that walls need at some angles."""
    at_once = 1 << 18  # needs that are held in memory
    angles = _angles(delay)
    parts = np.array_split(walls, 1 + len(walls) * angles.size // at_once)
    return np.concatenate(
        [np.max(_needed(part.T[:, :, None], angles, delay), axis=1) for part in parts]
    )


def _angles(delay: float) -> Float64[np.ndarray, " angle"]:
    per_term = 16  # angles of a series, for each of its terms
    return np.linspace(1e-12, pi, per_term * (floor(delay) + 2))


def _needed(walls: Any, theta: np.ndarray, delay: float) -> np.ndarray:
    """Return the damping that walls (alpha, beta) need at theta: the larger eigenvalue."""
    whole = floor(delay)
    fraction, half, (alpha, beta) = delay - whole, 0.5 * theta, walls

    def lagged(k: int) -> np.ndarray:
        lag = np.sin((2 * k + 1) * half) / (2 * np.sin(half))
        return alpha * lag - beta * np.cos((k + 1) * theta)

    real = (1 - fraction) * lagged(whole) + fraction * lagged(whole + 1)
    wall = alpha**2 + 4 * beta * (alpha + beta) * np.sin(half) ** 2
    need: np.ndarray = 0.5 * (real + np.sqrt(real**2 + fraction * (1 - fraction) * wall))
    return need
