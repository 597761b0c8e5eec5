"""The certified verdict and the certified bound of a radius, against certified roots."""

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from campaign import first
from mpmath import mp, mpf

import jaxstab
from benchmarks.hard_loops import points_near_the_boundary, random_plants
from jaxstab import (
    Device,
    Filter,
    HapticLoop,
    Mode,
    Velocity,
    Verdict,
    characteristic_polynomial,
    verdict,
)
from jaxstab.arrays import rounded_reciprocal
from jaxstab.batches import compiled
from jaxstab.point import verdicts
from jaxstab.point.radius import radius_error
from jaxstab.rounding import UNIT
from tests.truth import loop as truth
from tests.truth.balls import ExactPlant, moduli

DELAYS = (0.0, 0.25, 1.0, 1.5, 2.0, 2.75, 5.0, 7.3, 8.0, 20.0, 33.0, 59.5, 60.0)
POINTS = {True: 2000, False: 200}  # of short delays, of long ones
PER_PLANT = 200
HAPTIC = {"gamma": 1e-3, "delta": 0.015}
DELAY_OF_MANY = np.array([0.0, 0.5, 1.0, 3.25, 14.0])


@pytest.mark.parametrize(
    "delay",
    first(DELAYS, 4),
)
def test_no_verdict_is_wrong_however_close_to_the_boundary(
    delay: float, rng: np.random.Generator
) -> None:
    for gamma, delta in random_plants(rng, POINTS[delay < 10] // PER_PLANT):
        plant = ExactPlant.of(gamma, delta, delay)
        alpha, beta = points_near_the_boundary(rng, gamma, delta, delay, PER_PLANT)
        quick = np.asarray(verdict(alpha, beta, gamma=gamma, delta=delta, delay=delay))
        exact = np.asarray(
            verdict(alpha, beta, gamma=gamma, delta=delta, delay=delay, resolve="exact")
        )
        for a, b, *codes in zip(alpha, beta, quick, exact, strict=True):
            true = plant.code(a, b, gamma, delay)
            assert set(codes) <= {true, Verdict.UNDECIDED}, (a, b, gamma, delta, delay, codes, true)


@pytest.mark.parametrize("gamma", [0.0, 1e-310])
@pytest.mark.campaign
@pytest.mark.parametrize("alpha", [5e-324, 1e-310, -1e-309])
def test_tiny_numbers_that_xla_takes_for_0_are_undecided(alpha: float, gamma: float) -> None:
    """XLA said of 1e-310, which is stable, that p(1) is 0: UNSTABLE."""
    plant: dict[str, Any] = {"gamma": gamma, "delta": 0.01, "delay": 1.0}
    true = Verdict.STABLE if alpha > 0 else Verdict.UNSTABLE
    assert verdict(alpha, 0.1, **plant) == true
    grid = np.full(1 << 18, alpha)
    assert set(np.unique(verdict(grid, 0.1, **plant))) <= {true, Verdict.UNDECIDED}
    traced = jax.jit(lambda a: verdict(a, 0.1, **plant))
    for many in (verdict(jnp.asarray(grid), 0.1, **plant), traced(jnp.full(3, alpha))):
        assert np.all(np.asarray(many) == Verdict.UNDECIDED)


def test_reciprocals_are_right_to_two_roundings(rng: np.random.Generator) -> None:
    x = 2.0 ** rng.uniform(-960.0, 960.0, 3000)
    for number, inverse in zip(x.tolist(), rounded_reciprocal(jnp.array(x)).tolist(), strict=True):
        assert abs(Fraction(number) * Fraction(inverse) - 1) <= 2.000001 * Fraction(UNIT)


def test_the_reciprocal_of_what_is_out_of_range_is_nan_in_jax() -> None:
    out_of_range = jnp.array([0.0, 5e-324, 2.0**-961, 2.0**961, 1.7e308, np.inf, np.nan])
    assert jnp.all(jnp.isnan(rounded_reciprocal(out_of_range)))


@pytest.mark.parametrize(("delay", "band"), [(0.0, 1e-13), (1.0, 1e-12), (5.0, 1e-11)])
def test_the_undecided_band_is_narrow_and_closes_when_resolved(
    delay: float, band: float, rng: np.random.Generator
) -> None:
    # On the curve that bounds the stable set of a PHANToM-like device with a hand.
    thetas = rng.uniform(0.1, 0.8, 40) / (delay + 1)
    edge = [truth.boundary_point(theta, delay=delay, **HAPTIC) for theta in thetas]
    alpha, beta = np.array(edge, float).T
    for distance, resolve, share in ((band, None, 0.1), (1e-14, "exact", 0.0)):
        both = np.stack([alpha * (1 - distance), alpha * (1 + distance)])
        codes = np.asarray(verdict(both, beta, **HAPTIC, delay=delay, resolve=resolve))
        assert np.mean(codes == Verdict.UNDECIDED) <= share
    assert np.all(codes[0] != codes[1])


def test_the_undamped_free_device_without_delay_has_the_known_stable_set(
    rng: np.random.Generator,
) -> None:
    # 0 < alpha < 2 beta (2 - beta) / (beta + 2), 0 < beta < 2 for the rational numbers given.
    beta = rng.uniform(0, 2, 400)
    distance = 10 ** rng.uniform(-17, -1, 400) * rng.choice([-1, 1], 400)
    alpha = 2 * beta * (2 - beta) / (beta + 2) * (1 + distance)
    codes = np.asarray(verdict(alpha, beta, gamma=0.0, delta=0.0, delay=0.0, resolve="exact"))
    for a, b, code in zip(alpha, beta, codes, strict=True):
        a, b = Fraction(a), Fraction(b)
        limit = 2 * b * (2 - b) / (b + 2)
        assert code == (
            Verdict.UNDECIDED if a == limit else Verdict.STABLE if a < limit else Verdict.UNSTABLE
        )


@pytest.mark.parametrize("resolve", [None, "exact"])
@pytest.mark.parametrize("filters", [{}, {"velocity": Velocity.difference(samples=4)}])
def test_a_root_at_one_is_not_inside(resolve: str | None, filters: dict[str, Any]) -> None:
    """p(1) is (alpha + gamma) N(1), exactly 0 on this line."""
    loop = {"gamma": 1e-3, "delta": 0.015, "delay": DELAY_OF_MANY[:, None]}
    codes = verdict(-1e-3, np.linspace(0.1, 0.5, 9), **loop, resolve=resolve, **filters)
    assert np.all(codes == Verdict.UNSTABLE)
    beside = np.nextafter(-1e-3, [-1.0, 0.0])
    assert verdict(beside[0], 0.1, **loop, resolve=resolve, **filters).tolist() == [[2]] * 5
    assert Verdict.UNSTABLE not in verdict(beside[1], 1e-2, **loop, resolve=resolve)


def test_nothing_holds_a_free_device_without_a_spring() -> None:
    mode = Mode(frequency=80.0, damping_ratio=0.02, modal_mass=0.5)
    for device in (Device.mass_spring_damper(0.25, damping=0.1), Device.modes([mode], mass=0.25)):
        loop = HapticLoop(device=device, sample_time=1e-3, position=Filter.low_pass(150.0))
        assert loop.verdict([0.0, 100.0], 5.0).tolist() == [Verdict.UNSTABLE, Verdict.STABLE]


@pytest.mark.parametrize("delay", [0.0, 2.5, 40.0])
@pytest.mark.parametrize("gains", [(1e150, 0.1), (-1e150, 0.1), (0.1, 1e150), (1e150, -1e150)])
def test_enormous_gains_are_unstable(gains: tuple[float, float], delay: float) -> None:
    assert verdict(*gains, gamma=1e-3, delta=0.015, delay=delay) == Verdict.UNSTABLE


@pytest.mark.parametrize("window", [None, 30])
@pytest.mark.parametrize("delay", [20.0, 50.5, 200.0])
def test_gains_far_above_all_limits_are_decided_at_long_delays(
    delay: float, window: int | None, rng: np.random.Generator
) -> None:
    """Factors of 1 + |K| add up there; roots outside by the turns of p(z) on the circle."""
    alpha, beta = 10.0 ** rng.uniform(-6.0, 3.0, 300), 10.0 ** rng.uniform(-4.0, 3.0, 300)
    filters = {} if window is None else {"velocity": Velocity.difference(samples=window)}
    codes = verdict(alpha, beta, **HAPTIC, delay=delay, **filters)
    falling = characteristic_polynomial(alpha, beta, **HAPTIC, delay=delay, **filters)
    around = (np.fft.rfft(row, 1 << 16) for row in falling)  # p(z) / z^n
    turns = np.array([np.angle(values[1:] * values[:-1].conj()).sum() for values in around])
    expected = np.where(np.round(-turns / np.pi) > 0.0, Verdict.UNSTABLE, Verdict.STABLE)
    assert np.mean(expected == Verdict.UNSTABLE) > 0.8
    np.testing.assert_array_equal(codes, expected)


@pytest.mark.parametrize("way", ["NumPy", "a program", "arrays of JAX"])
def test_every_delay_of_an_array_gets_the_verdict_of_its_own(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, way: str
) -> None:
    alpha, beta = rng.uniform(-0.01, 0.2, (7, 1, 1)), rng.uniform(0, 1, (11, 1))
    monkeypatch.setattr(verdicts, "pays", lambda *_: way == "a program")
    own = map(jnp.asarray, (alpha, beta)) if way == "arrays of JAX" else (alpha, beta)
    codes = verdict(*own, **HAPTIC, delay=DELAY_OF_MANY)
    assert codes.shape == (7, 11, 5)
    assert codes.dtype == jnp.int8
    for place, delay in enumerate(DELAY_OF_MANY):
        alone = verdict(alpha, beta, **HAPTIC, delay=delay)[..., 0]
        np.testing.assert_array_equal(codes[..., place], alone)


def test_the_verdict_of_a_large_grid_is_that_of_its_points(rng: np.random.Generator) -> None:
    alpha, beta = rng.uniform(-0.01, 0.05, (150, 1)), rng.uniform(0, 0.5, (1, 70))
    grid = np.asarray(verdict(alpha, beta, **HAPTIC, delay=4.0))
    some = rng.integers(0, (150, 70), (50, 2))
    points = verdict(alpha[some[:, 0], 0], beta[0, some[:, 1]], **HAPTIC, delay=4.0)
    np.testing.assert_array_equal(grid[some[:, 0], some[:, 1]], points)


@pytest.mark.campaign
@pytest.mark.parametrize("delay", [1.0, 14.5])
def test_the_verdict_of_a_large_grid_is_the_same_on_one_core_and_on_three(
    delay: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Long delays have a program without a loop for many points."""
    alpha, beta = np.linspace(0.0, 1.0, 71) / (1.0 + delay) ** 2, np.linspace(0.0, 1.0, 53)[:, None]
    points = {"gamma": 1e-3, "delta": np.array([0.015, 0.2])[:, None, None], "delay": delay}
    alone = verdict(alpha, beta, **points)
    monkeypatch.setattr("jaxstab.batches._FOR_A_CORE", 10)
    monkeypatch.setattr("jaxstab.batches._cores", lambda: 3)
    for kernel in ("_short_codes", "_long_codes"):
        many = compiled(
            static=["degree"] * (kernel == "_short_codes"), many=10, pointwise=True, wide=True
        )
        plain = getattr(verdicts, kernel).__wrapped__
        monkeypatch.setattr(verdicts, kernel, many(plain))
    np.testing.assert_array_equal(verdict(alpha, beta, **points), alone)


@pytest.mark.parametrize("transform", first([jax.jit, jax.vmap], 1))
def test_the_verdict_goes_through_jit_and_vmap(transform: Callable[..., Callable]) -> None:
    alpha, beta = jnp.array([0.02, 0.3]), jnp.array([0.2, 0.2])
    codes = transform(lambda a, b: verdict(a, b, gamma=1e-3, delta=0.015, delay=1.0))(alpha, beta)
    np.testing.assert_array_equal(codes, [Verdict.STABLE, Verdict.UNSTABLE])


def test_the_verdict_of_numbers_may_be_asked_for_inside_of_jit() -> None:
    assert (
        jax.jit(lambda: verdict(0.02, 0.2, gamma=1e-3, delta=0.015, delay=1.0))() == Verdict.STABLE
    )


@pytest.mark.parametrize("array", [np.asarray, jnp.asarray])
def test_a_code_in_an_array_of_one_number_is_that_verdict(array: Callable[..., Any]) -> None:
    assert Verdict(array(2, np.int8)) is Verdict.UNSTABLE
    with pytest.raises(ValueError, match="7 is not a valid Verdict"):
        Verdict(array(7, np.int8))


@pytest.mark.parametrize(("wall", "stable"), [((1000.0, 10.0), True), ((1e6, 10.0), False)])
def test_a_verdict_is_true_where_stability_is_proved_and_nowhere_else(
    wall: tuple[float, float], *, stable: bool
) -> None:
    """As in ``if loop.verdict(K, B): send()``: the answers about one point are members."""
    loop = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
    point = {"gamma": loop.gamma, "delta": loop.delta, "delay": loop.delay_samples}
    alpha, beta = loop.alpha(wall[0]), loop.beta(wall[1])
    pd = jaxstab.simulated_pd(0.1, step=1e-3)
    with_hands = jaxstab.robust_region(gamma=(0.0, 1e-3), delta=(0.015, 0.015), delay=0.0)
    atlas = jaxstab.open_atlas("data/golden/atlas-v5.h5")
    verdicts = [
        loop.verdict(*wall),
        verdict(alpha, beta, **point),
        loop.margins(*wall).verdict,
        loop.frequency_margins(*wall).verdict,
        pd.verdict(kp=wall[0], kd=wall[1]),
        pd.margins(kp=wall[0], kd=wall[1]).verdict,
        loop.worst_hand(jaxstab.HandRange(stiffness=(0.0, 10.0)), *wall).verdict,
        loop.verdict(*wall, delays=(0.0, 1e-4)),
        with_hands.verdict(alpha, beta),
        atlas.query(alpha, beta, gamma=5e-4, delta=0.015, delay=0.0).verdict,
        jaxstab.is_schur([1.0, 0.5 if stable else 1.5]),
    ]
    assert all(isinstance(found, Verdict) for found in verdicts)
    assert [bool(found) for found in verdicts] == [stable] * len(verdicts)


def test_no_other_verdict_is_true() -> None:
    assert [code for code in Verdict if code] == [Verdict.STABLE]


def test_kernels_are_chosen_by_the_degree(monkeypatch: pytest.MonkeyPatch) -> None:
    """XLA compiles each degree up to 26, and one loop for all others."""
    for name in ("_untiled_codes", "_short_codes", "_long_codes"):
        monkeypatch.setattr(verdicts, name, lambda *_, name=name, **__: name.split("_")[1])
    chosen = {"untiled": [3, 4], "short": [5, 12, 13, 26], "long": [27, 300]}
    for name, degrees in chosen.items():
        for degree in degrees:
            form = verdicts.Form(degree - 3, is_fractional=False)
            assert verdicts._float_codes((np.zeros(3),) * 3, form) == name


@pytest.mark.parametrize("damping", [0.0, 1e-3])
@pytest.mark.parametrize("share", [0.8, 1.25])
def test_a_plant_is_lost_where_n_at_1_nearly_vanishes(share: float, damping: float) -> None:
    """At gamma = (2 pi)^2 without damping N(1) = D(1)/gamma is 0; below 2^-25 it is lost."""
    off = mp.sqrt(share * (2 * mp.pi) ** 2 * mpf(2) ** -25 - mpf(damping) ** 2 / 4)
    gamma = float((2 * mp.pi + off) ** 2 + mpf(damping) ** 2 / 4)
    assert float(truth.plant(gamma, damping).sum) == pytest.approx(share * 2.0**-25, rel=1e-2)
    assert verdicts.is_plant_lost(gamma, damping) == (share < 1.0)


def test_an_unknown_way_to_resolve_is_refused() -> None:
    with pytest.raises(ValueError, match=r"resolve is 'more'; give \"exact\" or None\."):
        verdict(0.1, 0.2, gamma=1e-3, delta=0.015, delay=1.0, resolve="more")


@pytest.mark.parametrize(
    ("delay", "typical"),
    [(0.0, 2e-13), (0.5, 2e-13), (1.0, 2e-13), (4.5, 1e-12), (8.0, 1e-12), (20.0, 1e-11)],
)
def test_the_bound_of_a_radius_holds_and_is_narrow(
    delay: float, typical: float, rng: np.random.Generator
) -> None:
    gamma, delta, count = 1e-3, 0.015, 60
    alpha = rng.uniform(-0.01, 0.3, count) / (1 + delay) ** 2
    beta = rng.uniform(0, 1, count) / (1 + delay)
    plant = ExactPlant.of(gamma, delta, delay)
    roots = [moduli(plant.polynomial(*p, delay), 400) for p in zip(alpha, beta, strict=True)]
    largest = [max(map(float, some)) for some in roots]
    coefficients = characteristic_polynomial(alpha, beta, gamma=gamma, delta=delta, delay=delay)
    for off in (0.0, 1e-9, -1e-5):
        radius = np.array(largest) * (1 + off)
        error = radius_error(coefficients, radius)
        assert np.all(error >= np.abs(radius - largest) - np.spacing(radius))
        assert np.median(error) <= typical + 5 * abs(off)


def test_the_bound_of_a_radius_holds_at_a_triple_root() -> None:
    # gamma = delta = 0: r = 4^(1/3) - 1, alpha = 6 r^2 - 2, beta = 2 r^3 has a triple root.
    root = mp.cbrt(4) - 1
    alpha, beta = float(6 * root**2 - 2), float(2 * root**3)
    lower, upper = truth.spectral_radius(alpha, beta, 0, 0, 0)
    coefficients = characteristic_polynomial(alpha, beta, gamma=0.0, delta=0.0, delay=0.0)
    for radius in (float(root), float(upper), float(root) * (1 + 1e-7)):
        error = float(radius_error(coefficients, np.asarray(radius)))
        assert max(abs(lower - radius), abs(upper - radius)) <= error < 1e-3


@pytest.mark.parametrize("middle", [0.0, 0.5])
def test_the_bound_of_a_radius_follows_coefficients_in_the_middle(middle: float) -> None:
    """Where there are none, steps go over both ends alone."""
    coefficients = np.array([1.0, -0.2, *[0.0] * 8, middle, *[0.0] * 8, 0.1, -0.3])
    roots = mp.polyroots(coefficients[::-1].tolist(), maxsteps=500, extraprec=400, asc=True)
    largest = float(max(map(abs, roots)))
    error = radius_error(coefficients, np.asarray(largest * (1.0 + 1e-9)))
    assert 1e-9 * largest <= error < 1e-8
