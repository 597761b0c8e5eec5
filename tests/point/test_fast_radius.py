"""The spectral radius without eigenvalues: converged, honest, seldom left to the eigenvalues."""

import csv
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from campaign import first, some
from mpmath import mp, mpf

import jaxstab
from jaxstab.conventions import RadiusStatus
from jaxstab.model import by_name
from jaxstab.point import dominance as dominance
from jaxstab.point import dominance as fast_radius
from jaxstab.point import radius as door
from jaxstab.point import traced_radius as power_iteration
from jaxstab.point.dominance import PlantPoints
from jaxstab.point.poles import Complex
from jaxstab.point.verdicts import float_plant
from tests.truth import loop as truth

REFERENCE = Path(__file__).parents[2] / "data" / "reference"
LONG_DELAY = 33.5
DELAYS = [0.0, 0.5, 2.0, LONG_DELAY, 12.0, 1.0, 3.7, 5.0, 20.0, 60.0]  # four degrees are shared


def first_and_campaign(values: Sequence[Any], count: int) -> list[Any]:
    """The first values, and the rest for the campaign: XLA compiles for each delay."""
    return first([(value,) for value in [*values[:count], *some(values[count:], 2)]], count)


def anchors(fact: str) -> list[tuple[float, ...]]:
    """(gamma, delta, delay, radius, alpha, beta) of one kind of distinguished gains."""
    lines = (REFERENCE / "anchors.tsv").read_text().splitlines()
    rows = csv.DictReader((line for line in lines if line[0] != "#"), delimiter="\t")
    columns = ("gamma", "delta", "delay", "radius", "alpha", "beta")
    return [tuple(float(row[name]) for name in columns) for row in rows if row["fact"] == fact]


def gains_around_the_stable_set(
    rng: np.random.Generator, delay: float, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Gains of which about half are stable in the haptic range, some negative."""
    alpha = rng.uniform(-0.3, 1.5, count) * 0.7 / (1.0 + delay) ** 2
    return alpha, rng.uniform(-0.2, 2.2, count) / (1.0 + 2.0 * delay)


def assert_honest(radius: jaxstab.results.SpectralRadius, scenes: np.ndarray) -> None:
    for scene, value, error in zip(scenes.T.tolist(), radius.value, radius.error, strict=True):
        lower, upper = truth.spectral_radius(*scene)
        assert upper - mpf(float(error)) <= mpf(float(value)) <= lower + mpf(float(error)), scene


@pytest.fixture(params=first(["NumPy", "XLA"], 1))
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Eigenvalues in NumPy, as for few points, or the programs of XLA that are made for many."""
    if request.param == "XLA":
        monkeypatch.setattr(door, "pays", lambda *_: True)


def assert_honest_and_precise(rng: np.random.Generator, delay: float) -> None:
    count = 60
    alpha, beta = gains_around_the_stable_set(rng, delay, count)
    gamma, delta = rng.uniform(0.0, 2.0, count), rng.uniform(0.0, 0.5, count)
    gamma[::2], delta[::2] = 1e-3, 0.015
    scenes = np.array([alpha, beta, gamma, delta, np.full(count, delay)])
    radius = jaxstab.spectral_radius(alpha, beta, gamma=gamma, delta=delta, delay=delay)
    assert_honest(radius, scenes)
    assert (radius.error < (1e-12 if delay <= 20.0 else 1e-11)).all()


def test_is_honest_and_precise_at_a_long_delay(rng: np.random.Generator) -> None:
    assert_honest_and_precise(rng, LONG_DELAY)


@pytest.mark.usefixtures("way")
class TestFastRadius:
    @pytest.mark.parametrize("delay", first_and_campaign(DELAYS, 2))
    def test_is_honest_and_precise_at_simple_roots(
        self, rng: np.random.Generator, delay: float
    ) -> None:
        assert_honest_and_precise(rng, delay)

    @pytest.mark.campaign
    def test_is_honest_over_the_whole_box(self, rng: np.random.Generator) -> None:
        count = 60
        scenes = np.array(
            [
                rng.choice([-1.0, 1.0], count) * 10.0 ** rng.uniform(-12, 3, count),
                rng.choice([-1.0, 1.0], count) * 10.0 ** rng.uniform(-12, 3, count),
                10.0 ** rng.uniform(-15, 4, count),
                10.0 ** rng.uniform(-15, 3, count),
                rng.choice([0.0, 1.0, 0.5, 5.0], count),
            ]
        )
        assert_honest(jaxstab.spectral_radius(**by_name(*scenes)), scenes)

    @pytest.mark.parametrize("anchor", first_and_campaign(anchors("smallest_radius")[:8], 1))
    def test_is_honest_around_a_triple_root(
        self, rng: np.random.Generator, anchor: tuple[float, ...]
    ) -> None:
        gamma, delta, delay, _, alpha, beta = anchor
        offsets = np.concatenate([[0.0], 10.0 ** rng.uniform(-16, -3, 7)])
        scenes = np.array(
            [
                alpha * (1.0 + offsets),
                beta * (1.0 - offsets),
                *(np.full(8, value) for value in (gamma, delta, delay)),
            ]
        )
        radius = jaxstab.spectral_radius(**by_name(*scenes))
        assert_honest(radius, scenes)
        assert (radius.error < 1e-3).all()

    def test_is_honest_where_real_roots_meet_and_where_two_roots_are_alike(
        self, rng: np.random.Generator
    ) -> None:
        """A real root r and a pair of the same modulus, or twice r, at delay 0, gamma = delta = 0.

        p = z^3 - 2 z^2 + z + ((z + 1) / 2) ((alpha + beta) z - beta) has a root at z = -1 never,
        so two conditions on the roots fix alpha and beta.
        """
        r = rng.uniform(0.3, 0.95, 20)
        # p = (z - r)^2 (z - s): coefficients a2 = -2 + (alpha + beta)/2, a1 = 1 + alpha/2,
        # a0 = -beta/2 give s = (1 - r)^2 ... from a2 - a1 + a0 = -3 (p(-1) = -4).
        s = 4.0 / (1.0 + r) ** 2 - 1.0
        alpha, beta = 2.0 * (r * r + 2.0 * r * s - 1.0), 2.0 * r * r * s
        moved = 1.0 + rng.choice([0.0, 1e-15, 1e-12, 1e-9, 1e-6], 20)
        zeros = np.zeros(20)
        scenes = np.array([alpha * moved, beta, zeros, zeros, zeros])
        assert_honest(jaxstab.spectral_radius(**by_name(*scenes)), scenes)

    @pytest.mark.parametrize("delay", first_and_campaign([1.0, 2.5, 5.0, 20.0], 1))
    def test_knows_the_free_plant_whose_roots_at_zero_are_multiple(self, delay: float) -> None:
        radius = jaxstab.spectral_radius(0.0, 0.0, gamma=0.5, delta=0.2, delay=delay)
        assert abs(mpf(float(radius.value)) - mp.exp(-mpf(0.2) / 2)) <= float(radius.error)
        assert float(radius.error) < 1e-12

    def test_a_slow_loop_keeps_all_digits(self) -> None:
        """Stiffness of 1e-8 moves the roots by 1e-4 from z = 1; eigenvalues lose four digits."""
        scenes = np.array([[1e-8, 1e-8], [2e-4, 1e-4], [0.0, 1e-9], [0.0, 1e-5], [0.0, 2.0]])
        radius = jaxstab.spectral_radius(**by_name(*scenes))
        assert_honest(radius, scenes)
        assert (radius.error < 1e-14).all()

    def test_a_grid_a_list_and_a_single_point_agree(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Blocks of a grid that broadcasts, lists filled up, several delays at once."""
        alpha, beta = np.linspace(0.01, 0.3, 23)[:, None, None], np.linspace(0.1, 0.9, 11)[:, None]
        scene = alpha, beta, 1e-3, 0.015
        listed = jaxstab.spectral_radius(**by_name(*scene, np.array([0.0, 1.0])))
        monkeypatch.setattr(fast_radius, "_LIST", 16)
        monkeypatch.setattr(fast_radius, "_BLOCK", 100)
        for number, delay in enumerate((0.0, 1.0)):
            blocks = jaxstab.spectral_radius(**by_name(*scene, delay))
            assert blocks.value.shape == (23, 11, 1)
            apart = np.abs(blocks.value[..., 0] - listed.value[..., number])
            assert (apart <= blocks.error[..., 0] + listed.error[..., number]).all()

    @pytest.mark.parametrize("delay", first_and_campaign([2.0, 33.5], 1))
    def test_agrees_with_the_eigenvalues_within_the_errors(
        self, rng: np.random.Generator, delay: float
    ) -> None:
        plant = np.full(60, 0.3), np.full(60, 0.1)  # in arrays, as above: it is compiled once
        scene = *gains_around_the_stable_set(rng, delay, 60), *plant, delay
        fast = jaxstab.spectral_radius(**by_name(*scene))
        companion = jaxstab.spectral_radius(**by_name(*scene), method="companion")
        assert (np.abs(fast.value - companion.value) <= fast.error + companion.error).all()
        assert (fast.status == RadiusStatus.PROVED).all()

    def test_arrays_of_jax_give_arrays_of_jax_as_honest(self, rng: np.random.Generator) -> None:
        alpha, beta = gains_around_the_stable_set(rng, 1.0, 40)
        scenes = np.array([alpha, beta, *np.broadcast_to([[0.3], [0.1], [1.0]], (3, 40))])
        gains = jnp.asarray(alpha)[:, None], jnp.asarray(beta)[:, None]
        radius = jaxstab.spectral_radius(*gains, gamma=np.full(1, 0.3), delta=0.1, delay=1.0)
        assert all(isinstance(column, jax.Array) and column.shape == (40, 1) for column in radius)
        assert (np.asarray(radius.error) < 1e-12).all()
        assert_honest(jax.tree.map(np.ravel, radius), scenes)

    def test_gains_beyond_all_float64_can_square_are_answered(self) -> None:
        radius = jaxstab.spectral_radius(
            np.array([1e100, -1e120]), 1.0, gamma=0.1, delta=0.1, delay=0
        )
        assert radius.value.shape == (2,)
        assert ((radius.status == RadiusStatus.PROVED) == np.isfinite(radius.error)).all()


@pytest.mark.campaign
@pytest.mark.parametrize("delay", [1.0, 0.0, 5.0, 60.0])
def test_leaves_less_than_a_permille_to_the_eigenvalues(delay: float) -> None:
    alpha = np.linspace(-0.2, 1.0, 600)[:, None] / (1.0 + delay) ** 2
    beta = np.linspace(-0.2, 2.2, 600) / (1.0 + 2.0 * delay)
    parameters = [alpha, beta, np.asarray(1e-3), np.asarray(0.015)]
    _, error, still_open = fast_radius.fast_radius(parameters, (600, 600), delay)
    assert np.array_equal(still_open, np.flatnonzero(~(error <= fast_radius.TOLERANCE)))
    assert still_open.size < 1e-3 * error.size


@pytest.mark.campaign
@pytest.mark.parametrize("rows", [64, 33])  # whole blocks of neighbours, and not
def test_neighbours_in_a_grid_share_a_guess_and_nothing_else(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, rows: int
) -> None:
    monkeypatch.setattr(dominance, "_LIST", 16)
    monkeypatch.setattr(dominance, "_STEADY", 32)
    alpha, beta = np.linspace(0.01, 0.2, 40), np.linspace(0.1, 0.9, rows)[:, None]
    plant = np.asarray(1e-3), np.asarray(0.015)
    shape = rows, alpha.size
    value, error, _ = dominance.fast_radius([alpha, beta, *plant], shape, 2.0)
    assert dominance._steady_axis([alpha, beta, *plant], shape) == -2
    chosen = rng.integers(0, value.size, 40)
    gains = [gain.flat[chosen] for gain in np.broadcast_arrays(alpha, beta)]
    numbers = (np.full(40, number) for number in (*plant, 2.0))
    radius = jaxstab.results.SpectralRadius(value.flat[chosen], error.flat[chosen], np.int8(1))
    assert_honest(radius, np.array([*gains, *numbers]))
    assert np.mean(error <= dominance.TOLERANCE) > 0.99
    shuffled = rng.permutation(beta)
    uneven = beta + 0.2 * (beta[1] - beta[0]) * rng.random((rows, 1))
    for other in (shuffled, uneven):
        assert dominance._steady_axis([alpha, other, *plant], shape) is None
    again, *_ = dominance.fast_radius([alpha, shuffled, *plant], shape, 2.0)
    assert np.all(np.abs(np.sort(again, axis=0) - np.sort(value, axis=0)) < 1e-11)


@pytest.mark.campaign
@pytest.mark.parametrize("delay", [2.0, 0.5, 8.0])
def test_the_first_try_of_a_dense_grid_leaves_few_points_open(delay: float) -> None:
    """Also next to the end of an axis that does not consist of whole blocks of neighbours."""
    side = 600
    alpha = np.linspace(-0.2, 1.0, side)[:, None] / (1.0 + delay) ** 2
    beta = np.linspace(-0.2, 2.2, side) / (1.0 + 2.0 * delay)
    parameters = [alpha, beta, np.asarray(1e-3), np.asarray(0.015)]
    loop, first = dominance._shared_loop(parameters, delay), dominance._tries(delay)[0]
    _, error = dominance._on_grid(loop, parameters, (side, side), delay, first)
    is_open = ~(error <= dominance.TOLERANCE)
    assert np.mean(is_open) < 0.03
    assert np.mean(is_open[-8:]) < 0.03


@pytest.mark.parametrize("delay", first_and_campaign([60.0, 20.0, 33.5], 1))
def test_a_loop_of_long_steps_has_about_the_dominant_root(
    rng: np.random.Generator, delay: float
) -> None:
    alpha, beta = gains_around_the_stable_set(rng, delay, 200)
    loop = dominance.loop_of([alpha, beta, np.asarray(1e-3), np.asarray(0.015)], delay)
    degree = jaxstab.model.polynomial_degree(delay)
    loop = jax.tree.map(jnp.asarray, loop)
    effort = dominance.Effort(doublings=10, corrections=0, longest_list=1, steps=8)
    guess = np.asarray(dominance.dominant_root(loop, degree=degree, effort=effort))
    poles = jaxstab.closed_loop_poles(alpha, beta, gamma=1e-3, delta=0.015, delay=delay)
    root = poles[:, 0].real - 1.0 + 1j * np.abs(poles[:, 0].imag)
    assert np.mean(np.abs(guess - root) < 0.1 * np.abs(root)) > 0.9


def multiplications(program: Any) -> int:
    """How many a program has; those of the body of a loop are counted once."""
    inner = [
        part for equation in program.eqns for part in jax.tree.leaves([*equation.params.values()])
    ]
    inner = [getattr(part, "jaxpr", part) for part in inner]
    own = sum(equation.primitive.name == "mul" for equation in program.eqns)
    return own + sum(multiplications(part) for part in inner if hasattr(part, "eqns"))


@pytest.mark.parametrize(
    ("delay", "most"),
    [(8.0, [(1240, 465), (65, 1095)]), (20.0, [(535, 1215), (97, 1370), (65, 1370)])],
)
def test_the_programs_of_the_tries_are_short(delay: float, most: list[tuple[int, int]]) -> None:
    """Code without loops is faster, but XLA takes long to compile what has too much of it."""
    loop = dominance.loop_of([np.full(512, x) for x in (0.1, 0.3, 1e-3, 0.015)], delay)
    loop = jax.tree.map(jnp.asarray, loop)
    degree, t = jaxstab.model.polynomial_degree(delay), jnp.zeros(512, complex)
    for effort, bounds in zip(dominance._tries(delay), most, strict=True):
        given = {"degree": degree, "corrections": effort.corrections}
        programs = (
            jax.make_jaxpr(partial(dominance.dominant_root, degree=degree, effort=effort))(loop),
            jax.make_jaxpr(partial(dominance.polished, **given))(t, loop),
        )
        for program, bound in zip(programs, bounds, strict=True):
            assert 0.93 * bound < multiplications(program.jaxpr) <= bound


@pytest.mark.parametrize("delay", [1.0, 20.0, 60.0])
def test_a_thousand_points_that_are_left_open_are_tried_at_once(
    monkeypatch: pytest.MonkeyPatch, delay: float
) -> None:
    tried: list[int] = []

    def try_them(loop: PlantPoints, *_: object) -> tuple[np.ndarray, np.ndarray]:
        tried.append(loop.alpha.size)
        return loop.alpha, loop.beta

    monkeypatch.setattr(dominance, "_tried", try_them)
    given = [np.linspace(0.1, 0.2, 2000), *(np.full(2000, x) for x in (0.3, 1e-3, 0.015))]
    chosen = np.arange(0, 2000, 2)
    for effort in dominance._tries(delay):
        alpha, _ = dominance._try_list(given, (2000,), chosen, delay, effort)
        assert np.array_equal(alpha, given[0][chosen])
    assert len(tried) == len(dominance._tries(delay))


def test_an_unknown_method_is_refused() -> None:
    with pytest.raises(ValueError, match="method is 'slow'"):
        jaxstab.spectral_radius(0.1, 0.1, gamma=0.0, delta=0.0, delay=0, method="slow")


class TestPowerIteration:
    @pytest.mark.parametrize("degree", [5, 9])
    def test_loops_give_the_same_power_as_unrolled_code(
        self, rng: np.random.Generator, degree: int
    ) -> None:
        """z^(8 degree) mod p, against polynomial division in numpy."""
        tail = rng.uniform(-0.5, 0.5, degree)
        tail[3 : degree - 2] = 0.0
        columns = [jnp.asarray([value]) if value else None for value in tail]
        power = np.zeros(8 * degree + 1)
        power[0] = 1.0
        _, remainder = np.polydiv(power, np.concatenate([[1.0], tail[::-1]]))
        exact = np.pad(remainder, (degree - len(remainder), 0))[::-1]
        # The loops square in float32.
        for compute, digits in (
            (power_iteration._power, 1e-12),
            (power_iteration._rolled_power, 1e-5),
        ):
            found = np.concatenate(compute(columns, 3))
            np.testing.assert_allclose(
                found / np.abs(found).sum(), exact / np.abs(exact).sum(), atol=digits
            )

    @pytest.mark.parametrize("compute", [power_iteration._power, power_iteration._rolled_power])
    def test_a_power_forgets_all_but_the_dominant_roots(
        self, compute: Callable[..., list[jax.Array]]
    ) -> None:
        """Also of squarings in float32: at the other roots, z^72 is 1e-12 of what it is at them."""
        roots = np.array([0.9 + 0.2j, 0.9 - 0.2j, *0.62 * np.exp(2j * np.pi * np.arange(7) / 7)])
        coefficients = np.poly(roots).real[:0:-1]
        power = np.concatenate(compute([jnp.asarray([value]) for value in coefficients], 3))
        at_roots = np.abs(np.polyval(power[::-1], roots))
        assert np.max(at_roots[2:]) < 1e-11 * at_roots[0]


class TestDominantRoot:
    def test_a_root_that_is_not_dominant_is_not_proved(self) -> None:
        plant = float_plant(*map(np.asarray, (0.2, 0.1, 0.0)), is_fractional=False)
        loop = PlantPoints(*map(np.asarray, (0.1, 0.3, 0.2)), plant)
        roots = truth.roots(0.1, 0.3, 0.2, 0.1, 0)
        tried = np.array([complex(root) - 1.0 for root in roots if root.imag >= 0])
        _, distances = dominance.with_distance(Complex(tried.real, tried.imag), loop, degree=3)
        assert np.isfinite(distances).tolist() == [True, False]
