"""Lemmas V7, B3 and B23 against balls: is a bound of the package ever smaller than the error?

    python -m benchmarks lemmas             10,000 polynomials and 10,000 boxes
    python -m benchmarks lemmas --small     a hundredth of them

Plants, polynomials and g are computed again in python-flint's balls, by matrix exponentials in
state space; nothing of the package enters them. Half of the loops are ordinary, half lie where the
bounds are nearest to what they bound: next to the limits of gamma and delta, to critical damping,
to the zeros of N at gamma = (2 pi k)^2, and to whole delays. The slack is a bound over the error
that it bounds; a slack below 1 refutes the lemma. Boxes of B3 come close to 1: its terms are sharp.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import flint
import numpy as np

from benchmarks.truth.balls import ExactPlant
from jaxstab.model import DoubleDouble
from jaxstab.point import verdicts
from jaxstab.proofs.exclusion import Loops, Models, expanded, terms
from jaxstab.proofs.plant import quick_plant
from jaxstab.rounding import PAIR_UNIT, UNIT

_BITS = 700
_POINTS = 6  # of each box, its corners mostly
_TINY = 1e-300  # an error below it counts as none


class Finding(NamedTuple):
    """A bound beside the error that it bounds, and the loop where that was."""

    lemma: str
    bound: float
    error: float
    loop: tuple[float, ...]

    @property
    def slack(self) -> float:
        return self.bound / self.error if self.error > _TINY else math.inf


def main(small: bool) -> int:
    """Print the least slack of each bound, and return 1 if one is below 1."""
    count = 100 if small else 10_000
    rng = np.random.default_rng(20081012)
    least: dict[str, Finding] = {}
    wrong = 0
    for number in range(count):
        for check in (polynomial, _quick_plant, _box):
            for found in check(rng, number % 2 == 1):
                wrong += not found.slack >= 1.0
                if found.lemma not in least or not found.slack >= least[found.lemma].slack:
                    least[found.lemma] = found
    for found in sorted(least.values()):
        print(f"{found.lemma:44} least slack {found.slack:12.8g}  at {found.loop}")
    print(f"{count} loops of each lemma, {wrong} bounds smaller than the error")
    return int(wrong > 0)


# ------------------------------------------------------------------------------------ loops, drawn


def hand(rng: np.random.Generator, hostile: bool) -> tuple[float, float, float]:
    """Draw gamma, delta and the fraction of a delay."""
    gamma = _chosen(rng, 0.0, 10.0 ** rng.uniform(-12.0, 4.0), rng.uniform(0.0, 45.0))
    delta = _chosen(rng, 0.0, 10.0 ** rng.uniform(-12.0, 3.0), rng.uniform(0.0, 11.0))
    if hostile:
        close = 1.0 + rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-17.0, -1.0)
        zero = (2.0 * math.pi * rng.integers(1, 16)) ** 2
        delta = _chosen(rng, delta, 0.0, 10.0 ** rng.uniform(-18.0, -3.0), 10.0, 1e3)
        limits = 40.0, 36.0, math.nextafter(36.0, 40.0), 1e4, zero
        gamma = _chosen(rng, gamma, 0.25 * delta**2, *limits) * close
    fraction = _chosen(rng, 0.0, 0.0, rng.uniform())
    if hostile and rng.random() < 0.3:
        tiny = 10.0 ** rng.uniform(-16.0, -1.0)
        fraction = _chosen(rng, tiny, 1.0 - tiny)
    return float(min(gamma, 1e4)), float(min(delta, 1e3)), min(fraction, math.nextafter(1.0, 0.0))


def _chosen(rng: np.random.Generator, *values: float) -> float:
    return float(values[rng.integers(len(values))])


def _wall(rng: np.random.Generator) -> tuple[float, float]:
    size = 10.0 ** rng.uniform(-4.0, 2.0, 2)
    return tuple((size * rng.choice([-1.0, 1.0, 1.0], 2)).tolist())


# --------------------------------------------------------------------------------------- lemma V7


def plant_findings(gamma: float, delta: float, fraction: float) -> Iterator[Finding]:
    """Compare the plant's pairs with balls."""
    loop = gamma, delta, fraction
    is_fractional = fraction > 0.0
    plant = verdicts.pair_plant(gamma, delta, fraction, is_fractional=is_fractional)
    error, size = float(plant.error), float(plant.size)
    with flint.ctx.workprec(_BITS):
        true = ExactPlant.of(gamma, delta, fraction, _BITS)
        n = [true.n0, true.n1, true.n2] if is_fractional else [true.n1, true.n2]
        pairs = list(plant.stiff)[-len(n) :]
        difference = true.n2 - true.n1 + true.n0
        yield _finding("V7 D", error, [plant.d1, plant.d0], [true.d1, true.d0], loop, max)
        yield _finding("V7 N", error * size, pairs, n, loop, max)
        yield _finding("V7 N(-1)", error * size, [plant.difference], [difference], loop)


def polynomial(rng: np.random.Generator, hostile: bool) -> Iterator[Finding]:
    """Compare the coefficients of a polynomial, and p(-1), with balls."""
    gamma, delta, fraction = hand(rng, hostile)
    alpha, beta = _wall(rng)
    yield from plant_findings(gamma, delta, fraction)
    is_fractional = fraction > 0.0
    degree = 3 + is_fractional
    loop = (alpha, beta, gamma, delta, fraction)
    with flint.ctx.workprec(_BITS):
        true = ExactPlant.of(gamma, delta, fraction, _BITS)
        a, b = flint.arb(alpha), flint.arb(beta)
        n = [true.n0, true.n1, true.n2] if is_fractional else [true.n1, true.n2]
        shifted = [flint.arb(0), *n], [*n, flint.arb(0)]
        tail = [(a + b) * up - b * down for up, down in zip(*shifted, strict=True)]
        difference = true.n2 - true.n1 + true.n0
        d_minus = 1 - true.d1 + true.d0
        for words, unit, make in (
            ("float64", UNIT, verdicts.float_plant),
            ("pairs", PAIR_UNIT, verdicts.pair_plant),
        ):
            plant = make(gamma, delta, fraction, is_fractional=is_fractional)
            gains = (alpha, beta) if unit == UNIT else map(DoubleDouble.from_value, (alpha, beta))
            alpha_, beta_ = gains
            chain = verdicts._closed_loop(alpha_, beta_, plant, unit)
            got, exact = [chain.gap, *chain.tail], [1 - true.d0, *tail]
            yield _finding(f"V7 tail, {words}", float(chain.error), got, exact, loop)
            heads = [chain.head[0], chain.head[1], chain.head[1]], [true.d1, true.d0, true.d0]
            yield _finding(f"V7 head, {words}", float(chain.head_error), *heads, loop)
            ends = verdicts._ends(alpha_, beta_, gamma, plant, unit, degree)
            at_end = d_minus - (a + 2 * b) * difference * (-1) ** (degree - len(plant.stiff))
            # Its sign counts, so that it may be rounded to float64.
            off = _distance(ends.at_minus_one, at_end) - UNIT * abs(float(ends.at_minus_one))
            yield Finding(f"V7 p(-1), {words}", float(ends.at_minus_one_error), off, loop)


def _finding(
    lemma: str, bound: float, got: list, true: list, loop: tuple[float, ...], of: type = sum
) -> Finding:
    errors = [_distance(one, other) for one, other in zip(got, true, strict=True)]
    return Finding(lemma, bound, of(errors), loop)


def _distance(number: object, true: flint.arb) -> float:
    """Return the largest that the distance may be."""
    parts = (number.hi, number.lo) if isinstance(number, DoubleDouble) else (number,)
    return float(abs(sum((flint.arb(float(part)) for part in parts), flint.arb(0)) - true).upper())


# -------------------------------------------------------------------------------- lemmas B3, B23


def _quick_plant(rng: np.random.Generator, hostile: bool) -> Iterator[Finding]:
    gamma, delta, fraction = hand(rng, hostile)
    quick = quick_plant(*(np.array([value]) for value in (gamma, delta, fraction)))
    loop = (gamma, delta, fraction)
    with flint.ctx.workprec(_BITS):
        true = ExactPlant.of(gamma, delta, fraction, _BITS)
        d1, d0, n2, n1, n0 = true[:5]
        got = [part[0] for part in (quick.d1, quick.d0, quick.n2, quick.n1, quick.n0)]
        yield _finding("B23 D", float(quick.d_error[0]), got[:2], [d1, d0], loop)
        yield _finding("B23 N", float(quick.n_error[0]), got[2:], [n2, n1, n0], loop)


def _box(rng: np.random.Generator, hostile: bool) -> Iterator[Finding]:
    gamma, delta, fraction = hand(rng, hostile)
    alpha, beta = _wall(rng)
    whole = float(rng.integers(0, 4) if rng.random() < 0.7 else rng.integers(0, 31))
    theta = _chosen(rng, rng.uniform(0.0, math.pi), 0.0, math.pi, 10.0 ** rng.uniform(-9.0, 0.0))
    center = np.array([alpha, beta, gamma, delta, whole + fraction, theta])
    size = 10.0 ** rng.uniform(-14.0 if hostile else -5.0, 0.0)
    spread = 10.0 ** rng.uniform(-3.0, 0.0, 6) * (rng.random(6) < 0.7)
    scale = np.array([abs(alpha) + 1e-3, abs(beta) + 1e-3, gamma + 1.0, delta + 1.0, 1.0, 1.0])
    radius = size * spread * scale
    g = expanded(*terms(Loops(*center[:, None]), Loops(*radius[:, None])))
    rest = float(g.rest[0])
    worst, where = 0.0, center
    for number in range(_POINTS):
        way = rng.choice([-1.0, 1.0], 6) if number else np.zeros(6)
        if number > 3:
            way = rng.uniform(-1.0, 1.0, 6)
        point = center + way * radius
        point[2:5] = np.maximum(point[2:5], 0.0)
        if point[2] > 1e4 or point[3] > 1e3:
            continue
        moves = [flint.arb(x) - flint.arb(c) for x, c in zip(point, center, strict=True)]
        if any(abs(m) > flint.arb(r) for m, r in zip(moves, radius, strict=True)):
            point = np.where(way * radius == 0.0, center, center + way * radius * (1.0 - 1e-3))
            point = np.where(np.abs(point - center) > radius, center, point)
            point[2:5] = np.maximum(point[2:5], 0.0)
        error = _off_expansion(g, center, radius, point)
        if error > worst:
            worst, where = error, point
    kind = "wide boxes" if size > 1e-5 else "tiny boxes: rounding"
    yield Finding(f"B3 {kind}", rest, worst, (*center.tolist(), *radius.tolist(), *where.tolist()))


def _off_expansion(g: Models, center: np.ndarray, radius: np.ndarray, point: np.ndarray) -> float:
    with flint.ctx.workprec(_BITS):
        model = flint.acb(*_parts(g.value[0]))
        for move, x, c, r in zip(g.moves[:, 0], point, center, radius, strict=True):
            if r > 0.0:
                share = (flint.arb(float(x)) - flint.arb(float(c))) / flint.arb(float(r))
                model += flint.acb(*_parts(move)) * share
        return float(abs(true_g(*map(float, point)) - model).upper())


def true_g(
    alpha: float, beta: float, gamma: float, delta: float, delay: float, theta: float
) -> flint.acb:
    """g(theta) = p(z) / z^(m + 2), z = e^(i theta), m = floor(delay) + 1, in a ball."""
    plant = ExactPlant.of(gamma, delta, delay, _BITS)
    z = flint.acb(0, theta).exp()
    turns = math.floor(delay) + 1
    numerator = plant.n2 * z + plant.n1 + plant.n0 / z
    return z + plant.d1 + plant.d0 / z + z**-turns * numerator * (alpha + beta * (1 - 1 / z))


def _parts(number: complex) -> tuple[float, float]:
    return float(number.real), float(number.imag)
