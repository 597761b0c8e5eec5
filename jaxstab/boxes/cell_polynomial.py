"""The characteristic polynomial over cells of (alpha, beta, gamma, delta, delay), to second order.

p is affine in alpha and beta and in the plant's coefficients. Products of a wall with a quadratic
term of the plant are of third order; they are kept as terms of their own as long as coefficients of
p are only added up: in powers of z - c they cancel. Lemma B18 of docs/proofs.md.
"""

from functools import reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.boxes.circle import motion
from jaxstab.boxes.plant import BENDS, ROUNDING, UNDERFLOW, HandBoxes
from jaxstab.boxes.quadratics import PLACES, TERMS, Array, Quadratic
from jaxstab.model.filters import Filters
from jaxstab.model.linear_loop import loop_factors
from jaxstab.model.plant import pairs_error, plant_coefficients
from jaxstab.model.transfer import UNIT
from jaxstab.model.transfer import product as polynomial_product

_HAND = (2, 3, 4)  # gamma, delta and delay among the variables
_PAIRS = [(i, j) for i in _HAND for j in _HAND if i <= j]
_CUBES = {
    (wall, *pair): TERMS + n
    for n, (wall, pair) in enumerate((wall, pair) for wall in (0, 1) for pair in _PAIRS)
}
_ALL_TERMS = TERMS + len(_CUBES)
_EPS = np.finfo(np.float64).eps
_CLIPPED = (
    4e-9  # of the slopes: cells reach so much of themselves beyond their ends, but not below 0
)

# Bounds of third derivatives by gamma and by delta; of the delay's slope by gamma twice, by gamma
# and delta, by delta twice; and of the delay's second derivative by gamma and delta: lemma B18.
_THIRD = {
    "d1": (1 / 60, 1.0),
    "d0": (0.0, 1.0),
    "n2": (1 / 6720, 1 / 20),
    "n1": (1 / 3360, 1 / 4),
    "n0": (1 / 6720, 1 / 5),
}
_SLOPE_BENDS = (1 / 60, 1 / 12, 1 / 3)


class WallBoxes(NamedTuple):
    """Boxes of alpha and beta: middles and half-widths."""

    alpha: Array
    beta: Array
    half_alpha: Array
    half_beta: Array

    def some(self, cells: NDArray[np.intp]) -> "WallBoxes":
        """Return chosen boxes."""
        return WallBoxes(*(values[cells] for values in self))


class CellPolynomial(NamedTuple):
    """A monic polynomial over cells, highest power first.

    Attributes:
        terms: of each coefficient, (coefficient, term, cell): those of ``Quadratic``, then the
            products of a wall and two variables of the plant.
        rest: bound of what these leave, (coefficient, cell).
    """

    terms: Array
    rest: Array

    @property
    def degree(self) -> int:
        """The degree."""
        return len(self.terms) - 1

    def some(self, cells: NDArray[np.intp]) -> "CellPolynomial":
        """Return the polynomials of chosen cells."""
        return CellPolynomial(self.terms[..., cells], self.rest[:, cells])

    def coefficient(self, number: int) -> Quadratic:
        """Return a coefficient as a quadratic."""
        return self._quadratic(self.terms[number], self.rest[number])

    def coefficients(self) -> list[Quadratic]:
        """Return all coefficients as quadratics."""
        return [self.coefficient(number) for number in range(self.degree + 1)]

    def shifted(self, to: Array) -> "CellPolynomial":
        """Return the polynomial in powers of z - to, a number for each cell."""
        terms, rest = self.terms.copy(), self.rest.copy()
        size = np.abs(terms).sum(axis=1)
        for last in range(self.degree, 0, -1):
            for number in range(1, last + 1):
                terms[number] += terms[number - 1] * to
                rest[number] += rest[number - 1] * np.abs(to)
                size[number] += size[number - 1] * np.abs(to)
        return CellPolynomial(terms, rest + 2.0 * self.degree * _EPS * size)

    def by_powers_of(self, factor: list[Array]) -> list[list[Quadratic]]:
        """Return c_0, c_1 ... of lower degree than a monic f with p = c_0 + c_1 f + c_2 f^2 + ...

        Args:
            factor: the coefficients of f after the first, highest power first, numbers.
        """
        parts, left, k = [], self, len(factor)
        while left.degree >= k:
            left, low = left._divided(factor)
            parts.append([low.coefficient(number) for number in range(k)])
        zero = Quadratic.constant(np.zeros(self.rest.shape[1]))
        rows = left.coefficients()
        return [*parts, [zero] * (k - len(rows)) + rows]

    def _divided(self, factor: list[Array]) -> "tuple[CellPolynomial, CellPolynomial]":
        terms, rest = self.terms.copy(), self.rest.copy()
        quotient = self.degree + 1 - len(factor)
        for number in range(quotient):
            lost = rest[number] + 4.0 * _EPS * np.abs(terms[number]).sum(axis=0)
            for step, value in enumerate(factor, number + 1):
                terms[step] -= terms[number] * value
                rest[step] += lost * np.abs(value) + 2.0 * _EPS * np.abs(terms[step]).sum(axis=0)
        low = CellPolynomial(terms[quotient:], rest[quotient:])
        return CellPolynomial(terms[:quotient], rest[:quotient]), low

    @staticmethod
    def _quadratic(terms: Array, rest: Array) -> Quadratic:
        lost = np.abs(terms[TERMS:]).sum(axis=0) + 16.0 * _EPS * np.abs(terms).sum(axis=0)
        return Quadratic(terms[:TERMS], rest + lost)


def cell_polynomial(
    walls: WallBoxes,
    hands: HandBoxes,
    delay: float,
    half_delay: float,
    filters: Filters | None = None,
) -> CellPolynomial:
    """Enclose the characteristic polynomial over cells.

    Args:
        walls: boxes of alpha and beta.
        hands: boxes of gamma in [0, 1e4] and delta in [0, 1e3], one for each of those.
        delay: the middle delay t_d/T >= 0 in samples.
        half_delay: how far the delay is from this at most, between two whole samples.
        filters: velocity estimator and position filter, in units of one sample.

    Returns:
        p of eq. (9), times a power of z.

    Raises:
        ValueError: gamma, delta or delay is outside the range of the model.
    """
    plant = _plants(hands, delay, half_delay)
    base, stiffness, damping = _multipliers(int(delay) + 1, filters)
    degree = base.size + 1
    cells = walls.alpha.size
    terms, rest = np.zeros((degree + 1, _ALL_TERMS, cells)), np.zeros((degree + 1, cells))
    terms[: base.size, 0] += base[:, None]
    for step, name in ((1, "d1"), (2, "d0")):
        part = plant[name]
        terms[step : step + base.size, :TERMS] += base[:, None, None] * part.terms
        rest[step : step + base.size] += np.abs(base)[:, None] * part.rest
    length = max(stiffness.size, damping.size)
    gains = np.stack([np.append(np.zeros(length - g.size), g) for g in (stiffness, damping)])
    first = degree - (length + 1)  # of N times the wall
    for power, (by_alpha, by_beta) in enumerate(gains.T.tolist()):
        wall = by_alpha * walls.alpha + by_beta * walls.beta
        halves = by_alpha * walls.half_alpha, by_beta * walls.half_beta
        for step, name in enumerate(("n2", "n1", "n0")):
            _add_product(terms, rest, first + power + step, plant[name], wall, halves)
    size = np.abs(terms).sum(axis=1)
    return CellPolynomial(terms, rest + 8.0 * length * _EPS * (size + size.max(axis=0)))


def _add_product(
    terms: Array, rest: Array, row: int, part: Quadratic, wall: Array, halves: tuple[Array, Array]
) -> None:
    """Add the product of a coefficient of N, without walls, with an affine function of a wall."""
    terms[row, :TERMS] += part.terms * wall
    size = np.abs(wall)
    for variable, half in enumerate(halves):
        terms[row, 1 + variable] += part.middle * half
        for other in _HAND:
            terms[row, PLACES[variable, other]] += part.terms[1 + other] * half
        for pair in _PAIRS:
            terms[row, _CUBES[(variable, *pair)]] += part.terms[PLACES[pair]] * half
        size = size + np.abs(half)
    rest[row] += (part.rest + 8.0 * _EPS * part.size) * size


def _multipliers(lag: int, filters: Filters | None) -> list[Array]:
    """Return what delay, estimator and filter multiply D, alpha N and beta N by, in powers of z."""
    velocity, position = UNIT, UNIT
    if filters:
        velocity, position = filters[0].filter.transfer(), filters[1].transfer()
    powers, factors = loop_factors(lag, velocity, position)
    return [
        np.array([float(c.rounded()) for c in reduce(polynomial_product, each)] + [0.0] * power)
        for power, each in zip(powers, factors, strict=True)
    ]


def _plants(hands: HandBoxes, delay: float, half_delay: float) -> dict[str, Quadratic]:
    """Enclose the plant's coefficients of each cell; cells share few boxes of hands."""
    boxes, number = np.unique(np.stack(hands), axis=1, return_inverse=True)
    known = _plant(HandBoxes(*boxes), delay, half_delay)
    number = number.ravel()
    return {name: Quadratic(q.terms[:, number], q.rest[number]) for name, q in known.items()}


def _plant(hands: HandBoxes, delay: float, half_delay: float) -> dict[str, Quadratic]:
    """Enclose the plant's coefficients: parabolas through three points, and what these leave."""
    h_gamma, h_delta = hands.half_gamma, hands.half_delta
    still = np.zeros_like(h_gamma)
    gamma = np.maximum(hands.gamma + np.stack([still, -h_gamma, h_gamma, still, still]), 0.0)
    delta = np.maximum(hands.delta + np.stack([still, still, still, -h_delta, h_delta]), 0.0)
    values = plant_coefficients(gamma=gamma, delta=delta, delay=delay)
    moves = _delay_moves(gamma, delta, delay) if half_delay else {}
    highest = gamma.max(axis=0), delta.max(axis=0)
    # More than a rounding is lost of N where it nearly vanishes, and of D where it decays.
    lost = 8.0 * np.asarray(pairs_error(*highest))
    size_n = np.sqrt(np.max(np.asarray(values.sum), axis=0))
    plant = {}
    for name, (third_gamma, third_delta) in _THIRD.items():
        at = np.asarray(getattr(values, name))
        terms = np.zeros((TERMS, h_gamma.size))
        terms[0] = at[0]
        for variable, below, above in ((2, at[1], at[2]), (3, at[3], at[4])):
            terms[1 + variable] = 0.5 * (above - below)
            terms[PLACES[variable, variable]] = 0.5 * (above + below) - at[0]
        # A parabola through -1, 0 and 1 leaves |third derivative| x (1 - x^2)/6 at most.
        rest = BENDS[name].mixed * h_gamma * h_delta
        rest += 0.0642 * (third_gamma * h_gamma**3 + third_delta * h_delta**3)
        rest += lost * (1.0 if name in ("d1", "d0") else size_n) + UNDERFLOW
        rest += ROUNDING * (np.max(np.abs(at), axis=0) + half_delay)
        if name in moves:
            _add_moves(terms, moves[name], half_delay)
            rest += _rest_of_delay(name, hands, highest, half_delay)
        plant[name] = Quadratic(terms, rest + _CLIPPED * np.abs(terms[1:]).sum(axis=0))
    return plant


def _add_moves(terms: Array, moves: Array, half: float) -> None:
    slope, twice = moves
    terms[5] = slope[0] * half
    terms[PLACES[4, 4]] = twice[0] * half**2
    terms[PLACES[2, 4]] = 0.5 * (slope[2] - slope[1]) * half
    terms[PLACES[3, 4]] = 0.5 * (slope[4] - slope[3]) * half


def _rest_of_delay(name: str, hands: HandBoxes, highest: tuple[Array, Array], half: float) -> Array:
    """Bound what the terms of the delay leave: lemma B18."""
    h_gamma, h_delta, delta = hands.half_gamma, hands.half_delta, highest[1]
    twice, mixed, delta_twice = _SLOPE_BENDS
    slope = twice * h_gamma**2 + mixed * h_gamma * h_delta + delta_twice * h_delta**2
    of_n2 = 0.5 * h_gamma + h_delta
    of_n0 = (0.5 + delta / 6.0) * h_gamma + (2.0 + 0.5 * delta) * h_delta
    bend = {"n2": of_n2, "n0": of_n0, "n1": of_n2 + of_n0}[name]
    third = BENDS[name].delay_thrice * (highest[0] + highest[1]) / 6.0
    times = 2.0 if name == "n1" else 1.0
    return half * times * slope + 0.5 * half**2 * bend + half**3 * third


def _delay_moves(gamma: Array, delta: Array, delay: float) -> dict[str, Array]:
    """Return first and half of the second derivatives of N by the delay; those of D are 0 (B16)."""
    part = delay - np.floor(delay)
    went, early = motion(gamma, delta, np.full_like(gamma, 1.0 - part))
    gone, velocity = motion(gamma, delta, np.full_like(gamma, part))
    fading = np.exp(-delta * (1.0 - part))
    n2 = np.stack([-early, 0.5 * (1.0 - delta * early - gamma * went)])
    n0 = fading * np.stack([velocity, 0.5 * (1.0 - gamma * gone)])
    return {"n2": n2, "n1": -n2 - n0, "n0": n0}
