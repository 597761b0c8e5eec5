"""Bounds of errors in the steps of Schur and Cohn, and of distances to roots: each is attained.

Lemmas V3, V4 and R1 of docs/proofs.md. A polynomial is moved by as much as a bound
allows, in the direction that is worst for it; half of the bound would then be wrong.
"""

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from itertools import combinations, pairwise
from typing import Any

import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from campaign import first

from jaxstab.point import dominance, fields, schur_cohn
from jaxstab.point.fields import _bound, poles_outside
from jaxstab.point.schur_cohn import Chain, Ends, _State, _step, zeros_outside
from jaxstab.rounding import UNIT
from tests.truth import loop as truth

MOVE = 2.0**-20
CIRCLED = 0.0, 0.5, 1.0, 3.0, 12.0, 30.0  # delays
NEAR = [(1, 1e-6), (-1, 1e-6), (1, 1e-9), (-1, 1e-9), (1, 1e-12), (-1, 1e-12), (1, 1e-15)]


def state(falling: list[float], error: float) -> _State:
    falling = np.array(falling)
    truth = np.array(True)
    return _State(falling, falling[::-1].copy(), np.array(error), truth, truth, ~truth)


@pytest.mark.parametrize("place", range(4))
@pytest.mark.parametrize("last", [0.5, -0.75, 1.5])
def test_an_error_of_a_coefficient_grows_by_one_and_the_ratio(place: int, last: float) -> None:
    """Lemma V3, of polynomials without a special form."""
    falling = [1.0, 0.25, -0.5, 0.125, last]
    after = schur_cohn._dense_step(state(falling, MOVE), unit=UNIT)
    moved = [Fraction(c) for c in falling]
    moved[place + 1 if place == 3 else place] += Fraction(MOVE)
    ratio = Fraction(last)
    exact = [a - ratio * b for a, b in zip(moved, moved[::-1], strict=True)]
    error = sum(abs(a - Fraction(float(b))) for a, b in zip(exact, after.falling, strict=True))
    assert error <= after.error
    if place != 2:  # the middle one meets itself
        assert after.error <= error * (1 + Fraction(1, 10**6))
    assert after.inside == (abs(last) < 1.0)


@pytest.mark.parametrize("share", [0.99, 1.01])
def test_the_first_last_coefficient_above_the_leading_one_has_a_root_outside(share: float) -> None:
    """Lemma V4, if it is so beyond the errors of both, and no |K| before was above 1."""
    above = 2.0**-10
    falling = [1.0, 0.25, -0.5, 0.125, -1.0 - above]
    begun = state(falling, share * above)
    assert schur_cohn._dense_step(begun, unit=UNIT).outside == (share < 1.0)
    later = replace(begun, inside=np.array(False))
    assert not schur_cohn._dense_step(later, unit=UNIT).outside
    errors = {"head_error": np.array(0.5 * share * above), "error": np.array(0.5 * share * above)}
    sparse = Chain(0.5, (0.25, 0.5), (1.0 + above, -0.5, 0.25), **errors, outside=False)
    assert _step(sparse, UNIT).outside == (share < 1.0)
    assert not _step(replace(sparse, inside=np.array(False)), UNIT).outside


def chain(moves: dict[str, float]) -> Chain:
    """u = 1, 0.25, 0.5 and v = 0.75, -0.5, 0.25, moved."""
    u = [1.0 + moves.get("u2", 0.0) + moves.get("gap", 0.0), 0.25, 0.5]
    return Chain(
        gap=0.5 + moves.get("gap", 0.0),
        head=(u[1] + moves.get("u1", 0.0), u[2] + moves.get("u2", 0.0)),
        tail=(0.75, -0.5, 0.25 + moves.get("v2", 0.0)),
        head_error=np.array(abs(moves.get("u1", 0.0)) + 2.0 * abs(moves.get("u2", 0.0))),
        error=np.array(abs(moves.get("gap", 0.0)) + abs(moves.get("v2", 0.0))),
    )


@pytest.mark.parametrize("name", ["gap", "u1", "u2", "v2"])
def test_an_error_of_head_or_tail_grows_as_lemma_v3_says(name: str) -> None:
    """The same K is used; the error of u2 is counted twice, that of u0 - u2 with the tail."""
    start, ratio = chain({}), Fraction(0.75)
    moved = chain({name: MOVE})
    bound = _step(moved, UNIT)

    def exact(given: Chain) -> tuple[list[Fraction], list[Fraction]]:
        gap, (u1, u2) = Fraction(given.gap), map(Fraction, given.head)
        v0, v1, v2 = map(Fraction, given.tail)
        tail = [v1 - ratio * u1, v2 - ratio * u2, Fraction(0)]
        return [u1 - ratio * v1, 2 * (u2 - ratio * v2)], [gap - ratio * (v0 - v2), *tail]

    changes = [
        sum(abs(a - b) for a, b in zip(before, after, strict=True))
        for before, after in zip(exact(start), exact(moved), strict=True)
    ]
    bounds = bound.head_error, bound.error
    for change, most in zip(changes, bounds, strict=True):
        assert change <= most
    attained = [change for change, most in zip(changes, bounds, strict=True) if change > most / 2]
    assert attained


def test_a_step_is_that_of_schur_and_cohn_in_fractions() -> None:
    """p -> (p - K z^m p*) / z, for a degree at which head and tail are apart."""
    start = chain({})
    after = _step(start, UNIT)
    head, tail = [1.0, *start.head], list(start.tail)
    m = 12
    falling = [*map(Fraction, head), *[Fraction(0)] * (m + 1 - 6), *map(Fraction, tail[::-1])]
    ratio = falling[-1] / falling[0]
    lowered = [a - ratio * b for a, b in zip(falling, falling[::-1], strict=True)]
    assert lowered.pop() == 0
    assert [lowered[1], lowered[2]] == [Fraction(float(x)) for x in after.head[:2]]
    assert lowered[0] - lowered[2] == Fraction(float(after.gap))
    assert lowered[::-1][:3] == [*(Fraction(float(x)) for x in after.tail), Fraction(0)]


# ----------------------------------------------------------------------------- dominance (lemma R1)


@pytest.mark.parametrize("array", first([np.asarray, jnp.asarray], 1))
@pytest.mark.parametrize("zeros", [0, 9])
@pytest.mark.parametrize("dominant", [[0.75], [-1.25], [0.75 * np.exp(1.1j)], [1.5j]])
def test_a_pole_is_dominant_beside_those_that_are_a_little_smaller(
    array: Callable[..., Any], zeros: int, dominant: list[complex]
) -> None:
    """Another one, or a pair, is well inside of the circle, or between it and the pole."""
    z = array(np.array(dominant) + 0j)
    for others in ([-np.sign(np.real(dominant[0])) or 1.0], [np.exp(2.0j), np.exp(-2.0j)]):
        for share, is_proved in [(1.0 - 2.0**-16, True), (1.0 - 2.0**-18, False), (1.1, False)]:
            conjugates = [*dominant, *np.conj(dominant)] if np.imag(dominant[0]) else dominant
            roots = [*conjugates, *share * abs(dominant[0]) * np.array(others), *[0.0] * zeros]
            columns = [array(np.array([c.real])) for c in np.poly(roots) + 0j]
            bound = np.asarray(_bound(columns, array(np.array([1e-15])), z))[0]
            assert np.isfinite(bound) == is_proved
            assert bound < 1e-12 or not is_proved


@pytest.mark.parametrize("pole", [0.5, -0.5, 2.0])
def test_an_error_of_the_coefficients_may_be_what_parts_the_circle_from_the_pole(
    pole: float,
) -> None:
    """Over r^2 a larger error moves the pole of z (z - a) to the circle of radius r."""
    radius = abs(pole) * (1.0 - fields._BESIDE)
    least = fields._BESIDE * min(1.0, radius**2)
    columns = [np.full(2, c) for c in (1.0, -pole, 0.0)]
    z = fields.Complex(np.full(2, pole), np.zeros(2))
    error = least * np.array([0.998, 1.01])
    proved = fields._is_dominant(columns, error, z, np.full(2, abs(pole)), np.zeros(2))
    assert proved.tolist() == [True, False]


def test_a_pole_is_as_near_as_the_circle_and_real_or_one_of_a_pair() -> None:
    """Two poles beyond the circle are no proof of one, nor is one of two."""
    pair = [np.full(1, c) for c in (1.0, -1.0, 0.5)]
    alone = [np.full(1, c) for c in (1.0, -0.5, 0.0)]

    def proved(columns: list[np.ndarray], z: complex, distance: float) -> bool:
        point = fields.Complex(np.array([z.real]), np.array([z.imag]))
        bounds = np.array([1e-15]), point, np.array([abs(z)]), np.array([distance])
        return bool(fields._is_dominant(columns, *bounds)[0])

    assert proved(pair, 0.5 + 0.5j, 1e-9)
    assert proved(alone, 0.5 + 0j, 1e-9)
    assert not proved(pair, 0.5**0.5 + 0j, 1e-9)
    assert not proved(alone, 0.5 + 1e-7j, 1e-9)
    assert proved(alone, 0.5 + 0j, 0.4)
    assert not proved(alone, 0.5 + 0j, 0.5)
    assert not proved([*alone[:2], np.full(1, 0.06)], 0.3 + 0j, 0.15)  # poles at 0.3 and 0.2
    close = [np.full(1, c) for c in np.poly([0.5 + 1e-4j, 0.5 - 1e-4j]).real]
    assert proved(close, 0.5 + 1e-4j, 0.9e-4)
    assert not proved(close, 0.5 + 1e-4j, 1.1e-4)


@pytest.mark.parametrize(("outside", "inside"), [(0, 3), (1, 3), (2, 2), (3, 1), (5, 0)])
def test_poles_outside_are_counted_up_to_the_error_that_moves_one(
    outside: int, inside: int
) -> None:
    """Lemma V4 by the roots that were put there; with an error of min |p| nothing is counted."""
    roots = [*np.linspace(1.3, 2.0, outside), *np.linspace(-0.6, 0.45, inside)]
    falling = np.poly(roots)
    circle = np.exp(1j * np.linspace(0.0, np.pi, 2001))
    least = np.abs(np.polyval(falling, circle)).min()
    counts = poles_outside([np.full(3, c) for c in falling], least * np.array([1e-9, 0.01, 1.001]))
    assert counts[0] == outside
    assert counts[1] in (outside, -1)
    assert counts[2] == -1


@pytest.mark.parametrize(("root", "first"), [(0.5, 0), (-0.75, 0), (2.0, 1), (-1.5, 1)])
def test_the_error_of_a_single_pole_may_be_its_distance_from_the_circle(
    root: float, first: int
) -> None:
    distance = abs(abs(root) - 1.0)
    error = distance * np.array([0.999, 1.01])
    assert poles_outside([np.ones(2), np.full(2, -root)], error).tolist() == [first, -1]


# -------------------------------------------------- the count by the verdict's steps (lemma V4)


def sparse(roots: list[float], array: Callable[..., Any], error: float) -> tuple[Any, ...]:
    """A cubic with these roots, as head, tail and values at 1 and -1, whose errors are given."""
    _, u1, u2, v0 = np.poly(roots)
    at_one, at_minus_one = 1.0 + u1 + u2 + v0, 1.0 - u1 + u2 - v0
    numbers = np.stack(np.broadcast_arrays(1.0 - u2, u1, u2, v0, at_one, at_minus_one, error))
    gap, u1, u2, v0, at_one, at_minus_one, error = map(array, numbers[..., None])
    chain = Chain(gap, (u1, u2), (v0,), 0.0 * error, error)
    return chain, Ends(at_one, error, at_minus_one, error), UNIT, 3


@pytest.mark.parametrize("array", [np.asarray, jnp.asarray])
def test_the_balance_of_roots_is_that_of_every_choice(array: Callable[..., Any]) -> None:
    """Real roots and pairs inside and outside, so that |K| is below 1 or above, of either sign."""
    reals, pairs = [0.2, -0.6, 0.85, 1.2, -1.4, 2.5], [0.3 + 0.5j, 0.7 + 0.9j, -1.1 + 0.2j]
    chosen: list[list[Any]] = [list(three) for three in combinations(reals, 3)]
    chosen += [[real, pair, pair.conjugate()] for real in reals for pair in pairs]
    for roots in chosen:
        outside = sum(abs(root) > 1.0 for root in roots)
        assert zeros_outside(*sparse(np.array(roots), array, 1e-13)).tolist() == [outside]


def test_roots_are_counted_up_to_the_error_that_moves_one() -> None:
    """The root of z^2 (z - a) nearest to the circle moves onto it by an error of its distance."""
    for root in (0.75, -0.5, 1.5, -2.0):
        distance = abs(abs(root) - 1.0)
        known = zeros_outside(*sparse([0.0, 0.0, root], np.asarray, 0.01 * distance))
        unknown = zeros_outside(*sparse([0.0, 0.0, root], np.asarray, 1.001 * distance))
        assert known.tolist() == [abs(root) > 1.0]
        assert np.isnan(unknown).all()


def test_signs_that_underflow_count_nothing() -> None:
    chain, ends, unit, degree = sparse([0.5, 0.25, -0.5], np.asarray, 1e-15)
    tiny = ends._replace(at_one=np.array([5e-324]), at_one_error=0.0)
    lifted = chain.__class__(
        chain.gap, chain.head, (np.array([0.9]),), chain.head_error, chain.error
    )
    assert np.isnan(zeros_outside(lifted, tiny, unit, degree)).all()


@pytest.mark.parametrize(
    ("array", "delay"),
    [
        *((np.asarray, delay) for delay in CIRCLED),
        *(pytest.param(jnp.asarray, delay, marks=pytest.mark.campaign) for delay in CIRCLED),
    ],
)
def test_roots_outside_of_any_circle_are_counted(array: Callable[..., Any], delay: float) -> None:
    """Loops of the paper on circles between their roots, and next to one of them, by 40 digits."""
    rng = np.random.default_rng(int(10 * delay))
    degree, is_counted = 3 + int(np.ceil(delay)), 0
    for _ in range(3):
        gamma, delta = 10.0 ** rng.uniform(-6.0, -0.5, 2)
        scale = 1.0 / (1.0 + delay) ** 2
        alpha, beta = rng.uniform(-0.3, 1.5) * scale, rng.uniform(-0.2, 2.2) / (1.0 + delay)
        moduli = sorted(abs(root) for root in truth.roots(alpha, beta, gamma, delta, delay))
        near = [float(m * (1 + sign * off)) for m in moduli[-3:] for sign, off in NEAR]
        radii = np.array([float(mpmath.sqrt(a * b)) for a, b in pairwise(moduli[-4:])] + near)
        loop = dominance.loop_of([array([x]) for x in (alpha, beta, gamma, delta)], delay)
        chain, ends = dominance._circle(array(radii - 1.0), array(1e-14), loop, degree)
        counts = zeros_outside(chain, ends, UNIT, degree)
        exact = [sum(m > 1 + mpmath.mpf(float(t)) for m in moduli) for t in radii - 1.0]
        for count, outside in zip(counts.tolist(), exact, strict=True):
            assert np.isnan(count) or count == outside
        is_counted += int(np.sum(np.isfinite(counts)))
    assert is_counted > 3 * 3


# --------------------------------------------------------------- distances to roots (lemma R1)


@pytest.mark.parametrize("degree", [2, 3, 5])
def test_of_a_multiple_pole_nothing_is_said(degree: int) -> None:
    columns = [np.array([c]) for c in np.poly([0.5] * degree)]
    assert np.isinf(_bound(columns, np.array([1e-15]), np.array([0.5 + 2.0**-6 + 0j])))[0]


@pytest.mark.parametrize("others", [[0.1], [0.1, -0.2], [0.3, 0.2, -0.1]])
@pytest.mark.parametrize("off", [1e-4, -1e-5, 1e-7])
def test_the_bound_of_a_dominant_pole_holds_its_distance(others: list[float], off: float) -> None:
    """n |p/p'| next to a simple root is n times its distance, and no less."""
    columns = [np.array([c]) for c in np.poly([0.75, *others])]
    bound = _bound(columns, np.array([1e-15]), np.array([0.75 + off + 0j]))[0]
    degree = 1 + len(others)
    assert abs(off) <= bound
    assert bound == pytest.approx(degree * abs(off), rel=0.02, abs=1e-12)


def test_an_error_of_the_coefficients_widens_the_bound_of_a_pole() -> None:
    """The root of z - 0.75 moves by the error."""
    error = np.array([1e-6])
    assert _bound([np.ones(1), np.array([-0.75])], error, np.array([0.75 + 0j]))[
        0
    ] == pytest.approx(1e-6, rel=2e-3)


def test_subsets_of_roots_are_told_apart() -> None:
    """Every choice of three of six roots has as many poles outside as were chosen there."""
    roots = [0.2, -0.6, 0.85, 1.2, -1.4, 2.5]
    for chosen in combinations(roots, 3):
        columns = [np.array([c]) for c in np.poly(chosen)]
        assert poles_outside(columns, np.array([1e-12]))[0] == sum(abs(r) > 1.0 for r in chosen)


@pytest.mark.parametrize("delay", [0.0, 1.0])
@pytest.mark.parametrize("off", [3e-10, -3e-11])
def test_the_distance_of_a_dominant_root_is_little_more_than_what_newton_corrects(
    delay: float, off: float
) -> None:
    """Lemma R1 next to a simple root, of the loop of the paper, by roots of its p(z)."""
    gamma, delta, alpha, beta = 0.02, 0.3, 0.05, 0.1
    with mpmath.workdps(40):
        plant = truth.plant(gamma, delta, 0.0)
        n2, n1 = plant.n2, plant.n1
        d = [1, plant.d1, plant.d0]
        wall = [n2 * (alpha + beta), n1 * (alpha + beta) - n2 * beta, -n1 * beta]
        falling = [*d, *[0] * (1 + int(delay))]
        falling[-3:] = [a + b for a, b in zip(falling[-3:], wall, strict=True)]
        roots = mpmath.polyroots(falling[::-1], maxsteps=200, extraprec=200, asc=True)
        largest = max((r for r in roots if r.imag >= 0), key=abs)
    root = complex(largest) - 1.0 + off
    loop = dominance.loop_of([np.array([x]) for x in (alpha, beta, gamma, delta)], delay)
    degree = 3 + int(delay)
    t = fields.Complex(np.array([root.real]), np.array([root.imag]))
    (bound,) = dominance.with_distance(t, loop, degree)[1]
    apart = 2.0**-25 * min(abs(root), abs(1.0 + root))
    closer = degree / (degree - (degree - 1.0) * degree * abs(off) / apart)
    assert abs(off) <= bound == pytest.approx(closer * abs(off), rel=0.02)
    # The circle is inside of the point before; it has to be near, and the root outside of it.
    for step, is_proved in ((1e-8, True), (-5e-8, False), (2e-6, True), (2e-5, False)):
        before = fields.Complex(t.re - step * np.abs(root) * np.sign(1.0 + t.re), t.im)
        (bound,) = dominance.with_distance(t, loop, degree, before)[1]
        assert np.isfinite(bound) == is_proved
        assert bound >= abs(off)
