"""Verdicts on all values of two numbers, against roots of NumPy on grids, and a closed form."""

from collections import Counter
from fractions import Fraction
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from campaign import many
from flint import arb, arb_poly, fmpq

from jaxstab.conventions import Verdict
from jaxstab.exact.ranges import Range, _clearance, stable_over
from jaxstab.model.balls import Factored


class Family:
    """p(z) with random coefficients that are polynomials in 1/(1 + a) and b."""

    def __init__(self, rng: np.random.Generator) -> None:
        pairs, powers = int(rng.integers(1, 4)), rng.integers(1, 4, 2)
        roots = rng.uniform(0.2, 0.98, pairs) * np.exp(1j * rng.uniform(0.0, np.pi, pairs))
        middle = np.real(np.poly([*roots, *roots.conj()])[::-1])
        spread = 10 ** rng.uniform(-3.0, -0.5)
        self.parts = spread * rng.standard_normal((*(powers + 1), len(middle)))
        self.parts[..., -1] = 0.0  # it is monic
        self.parts[0, 0] = middle
        self.ends = [(float(rng.uniform(0.05, 0.5)), float(rng.uniform(0.5, 1.0))) for _ in "ab"]

    def verdict(self) -> Verdict:
        degrees = [size - 1 for size in self.parts.shape[:2]]
        first = Range(*self.ends[0], degrees[0], lambda a: 1 / (1 + a))
        return stable_over(self.balls, first, Range(*self.ends[1], degrees[1]))

    def balls(self, *pair: float) -> Factored:
        a, b = (fmpq(*Fraction(value).as_integer_ratio()) for value in pair)
        total = arb_poly([])
        for i, j in np.ndindex(self.parts.shape[:2]):
            total += arb_poly(self.parts[i, j].tolist()) * arb((1 / (1 + a)) ** i * b**j)
        return Factored(total)

    def largest_radius(self, count: int) -> float:
        def radius(a: float, b: float) -> float:
            ways: Any = ((1.0 / (1.0 + a)) ** np.arange(9), b ** np.arange(9))
            ways = [way[:size] for way, size in zip(ways, self.parts.shape, strict=False)]
            return float(np.abs(np.roots(np.einsum("i,j,ijk", *ways, self.parts)[::-1])).max())

        first, second = (np.linspace(*ends, count).tolist() for ends in self.ends)
        return max(radius(a, b) for a in first for b in second)


def judged(count: int) -> Counter[Verdict]:
    found = Counter[Verdict]()
    for seed in range(count):
        family = Family(np.random.default_rng([6, seed]))
        verdict, largest = family.verdict(), family.largest_radius(13)
        found[verdict] += 1
        assert verdict != Verdict.STABLE or largest < 1.0, seed
        assert verdict != Verdict.UNSTABLE or max(largest, family.largest_radius(61)) > 0.999, seed
    return found


def test_verdicts_over_rectangles_are_those_of_roots() -> None:
    found = judged(12)
    assert min(found[Verdict.STABLE], found[Verdict.UNSTABLE]) >= 3


@pytest.mark.campaign
def test_verdicts_over_many_rectangles_are_those_of_roots() -> None:
    found = judged(count := many(400, small=40))
    assert found[Verdict.UNDECIDED] <= 0.02 * count


def test_the_clearance_is_a_polynomial_in_the_coefficients() -> None:
    """a^(d+1) times the products of 1 - z_i^2 and of 1 - z_i z_l, by roots that are chosen."""
    rng = np.random.default_rng(61)
    for degree in range(1, 9):
        pairs = rng.uniform(0.1, 0.95, degree // 2) * np.exp(1j * rng.uniform(0, 3, degree // 2))
        roots = [*pairs, *pairs.conj(), *rng.uniform(-0.9, 0.9, degree % 2)]
        falling = 1.25 * np.real(np.poly(roots))
        known = 1.25 ** (degree + 1) * np.prod([1.0 - z**2 for z in roots])
        known *= np.prod([1.0 - z * w for z, w in combinations(roots, 2)])
        found = _clearance(Factored(arb_poly(falling[::-1].tolist())))
        assert found is not None
        assert float(found.mid()) == pytest.approx(known.real, rel=1e-9)


@pytest.mark.parametrize("side", [1.0 - 1e-6, 1.0 + 1e-6])
def test_the_corner_of_a_triangle_is_met(side: float) -> None:
    """z^2 + a z + b: stable where |a| < 1 + b and |b| < 1."""

    def p(a: float, b: float) -> Factored:
        return Factored(arb_poly([b, a, 1]))

    verdict = stable_over(p, Range(0.25, 1.5 * side), Range(0.5, 0.75))
    assert verdict == (Verdict.STABLE if side < 1.0 else Verdict.UNSTABLE)


@pytest.mark.parametrize("is_first", [True, False])
@pytest.mark.parametrize("most", [1749, 1751])
def test_a_root_outside_of_all_corners_and_nodes_is_found(is_first: bool, most: int) -> None:
    """z^2 + a z + 3/4, a from 0 up and back: 7/4 - a may be negative next to one place alone."""

    def p(*pair: float) -> Factored:
        t = fmpq(*Fraction(pair[0] if is_first else pair[1]).as_integer_ratio()) - 1
        return Factored(arb_poly([arb(0.75), arb(fmpq(most, 1000) * 4 * t * (1 - t)), arb(1)]))

    axes = (Range(1.0, 1.9, 2), Range(1.0, 1.0))[:: 1 if is_first else -1]
    assert stable_over(p, *axes) == (Verdict.STABLE if most < 1750 else Verdict.UNSTABLE)


def test_a_range_as_narrow_as_rounding_is_proved() -> None:
    """z^2 + a z + b at |a| < 1 + b."""

    def p(a: float, b: float) -> Factored:
        return Factored(arb_poly([b, a, 1]))

    a, b = Range(1.0, float(np.nextafter(1.0, 2.0)), 3), Range(0.5, 0.5)
    assert stable_over(p, a, b) == Verdict.STABLE


@pytest.mark.parametrize("is_first", [True, False])
def test_a_loop_beyond_a_range_as_narrow_as_rounding_says_nothing(is_first: bool) -> None:
    """z^2 + a z + b is stable for a < 1 + b: nodes stand at up to a millionth beyond a."""

    def p(*pair: float) -> Factored:
        return Factored(arb_poly([5e-7, pair[0 if is_first else 1], 1]))

    axes = (Range(1.0, float(np.nextafter(1.0, 2.0)), 3), Range(0.5, 0.5))[:: 1 if is_first else -1]
    assert stable_over(p, *axes) == Verdict.UNDECIDED


@pytest.mark.parametrize(("degree", "expected"), [(61, Verdict.STABLE), (63, Verdict.UNDECIDED)])
def test_a_polynomial_that_takes_too_long_is_left_open(degree: int, expected: Verdict) -> None:
    """z^n + a/10: half of the work is for values, half for coefficients on the axis."""

    def p(a: float, _: float) -> Factored:
        return Factored(arb_poly([arb(a) / 10, *[0] * (degree - 1), 1]))

    assert stable_over(p, Range(0.5, 1.0, 2), Range(1.0, 1.0)) == expected
