"""Coefficients of loops with filters, of masses and of devices, lie within their bounds.

The truth: filters in exact numbers, masses in balls, devices by their equations of motion in mpmath
(``tests.truth``).
"""

from fractions import Fraction

import flint
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from campaign import many

from jaxstab.model import DoubleDouble, Filter
from jaxstab.model.double_double import size_sum
from jaxstab.model.linear_loop import LinearLoop, _values_at, filter_factors, filtered_loop
from tests.truth.random_loops import DeviceLoop, MassLoop

MORE = pytest.param(many(1000, 60), marks=pytest.mark.campaign)


def off(pair: DoubleDouble, true: flint.arb | flint.fmpq) -> flint.arb:
    return abs(flint.arb(float(pair.hi)) + flint.arb(float(pair.lo)) - flint.arb(true))


def assert_within_bounds(loop: LinearLoop, truth: tuple[flint.arb_poly, ...], slack: float) -> None:
    degree, common = loop.degree, truth[0].degree() - loop.degree
    rows = zip(loop[:3], truth, loop.errors, *loop[3:5], strict=True)
    for pairs, polynomial, error, at_one, at_minus_one in rows:
        assert all(polynomial[k] == 0 for k in range(common))
        true = [polynomial[common + degree - k] for k in range(degree + 1)]
        size = sum(map(abs, true), flint.arb(0))
        bound = flint.arb(float(error)) + size * slack
        assert sum(map(off, pairs, true), flint.arb(0)) <= bound
        turned = (c * (-1) ** k for k, c in enumerate(true))
        assert off(at_one, sum(true, flint.arb(0))) <= bound
        assert off(at_minus_one, sum(turned, flint.arb(0))) <= bound


@pytest.mark.parametrize("count", [60, MORE])
def test_loops_of_masses_are_within_their_bounds(count: int) -> None:
    """Lemma V7."""
    sharp = []
    for seed in range(count):
        drawn = MassLoop.drawn(np.random.default_rng([52, seed]))
        gamma, delta, delay = drawn.plant
        loop = filtered_loop(gamma, delta, int(delay), delay % 1.0, drawn.filters[:2])
        with flint.ctx.workprec(1400):
            assert_within_bounds(loop, drawn.balls[:3], 1e-100)
        assert bool(loop.is_free) == (gamma == 0.0)
        sharp.append(float(loop.errors[0]) / size_sum(loop.base))
    assert np.median(sharp) < 1e-25


@pytest.mark.parametrize("count", [10, MORE])
def test_loops_of_devices_are_within_their_bounds(count: int) -> None:
    """Lemma V10."""
    for seed in range(count):
        drawn = DeviceLoop.drawn(np.random.default_rng([53, seed]))
        loop = drawn.loop.linear
        assert loop.base[0] == DoubleDouble(1.0, 0.0)
        with flint.ctx.workprec(400):  # its truth has some 60 digits
            assert_within_bounds(loop, drawn.balls[:3], 1e-50)
        for part, error in zip(loop[:3], loop.errors, strict=True):
            assert error <= 2.0**-99 * size_sum(part)


def exact(number: Fraction | int) -> flint.fmpq:
    return flint.fmpq(number.numerator, number.denominator)


def exact_sides(chain: Filter) -> list[flint.fmpq_poly]:
    """Numerator and denominator in 1/z of a chain whose numbers JAX has computed."""
    sides = [flint.fmpq_poly([1]), flint.fmpq_poly([1])]
    for section in chain.sections:
        for stage in section.factors(Fraction(float(section.number))):
            for index, row in enumerate(stage):
                sides[index] *= flint.fmpq_poly(list(map(exact, row)))
    return sides


@pytest.mark.parametrize("count", [10, MORE])
def test_filters_of_jax_are_within_their_bounds(count: int) -> None:
    """Lemma V7: the products of their stages in pairs, against those in exact numbers."""
    for seed in range(count):
        drawn = MassLoop.drawn(np.random.default_rng([54, seed]))
        velocity, position = jax.tree.map(jnp.asarray, drawn.filters[:2])
        made, errors = filter_factors((velocity, position))
        (above_v, below_v), (above_p, below_p) = map(exact_sides, (velocity.filter, position))
        step = above_v - above_v.left_shift(1)
        truth = below_p * below_v, above_p * below_v, step * below_p
        rows = zip(made, truth, errors, *(_values_at(z, made) for z in (1, -1)), strict=True)
        with flint.ctx.workprec(1400):
            for pairs, true, error, at_one, at_minus_one in rows:
                numbers = [true[k] for k in range(len(pairs))]
                assert true.degree() < len(pairs)
                assert sum(map(off, pairs, numbers), flint.arb(0)) <= float(error)
                assert off(at_one, true(1)) <= float(error)
                assert off(at_minus_one, true(-1)) <= float(error)
