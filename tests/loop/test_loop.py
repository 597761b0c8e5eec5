"""The haptic loop in SI units: its answers are those of independent truths, and of its parts."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.linalg import eigvals

import jaxstab
from jaxstab import Filter, HapticLoop, Velocity, Verdict
from jaxstab.model import by_name
from jaxstab.results import RegionStatus
from tests.truth.march import (
    Taps,
    butterworth_taps,
    difference_taps,
    low_pass_taps,
    march_through_filters,
)

OMEGA = HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3, delay=1e-3)
WINDOW = replace(OMEGA, velocity=Velocity.difference(samples=20))
HELD = HapticLoop(
    device_mass=0.2, device_damping=0.1, hand_mass=0.3, hand_damping=3.0, hand_stiffness=150.0,
    sample_time=2e-3, delay=3.5e-3,
)  # fmt: skip

HANDS = jaxstab.HandRange(mass=(0.0, 0.5))
CHAI3D = (5000.0, 30.0)  # the wall of its examples, in N/m and N s/m


def transition(window: int, stiffness: float, damping: float) -> np.ndarray:
    """One sample of OMEGA with a window, from its differential equation: force one sample late."""
    m, b, T = 0.25, 0.1, 1e-3
    decay = np.exp(-b * T / m)
    coast, push = (1.0 - decay) * m / b, (1.0 - decay) / b
    A = np.zeros((window + 3, window + 3))
    A[0, :3] = 1.0, coast, (T - coast) / b
    A[1, 1:3] = decay, push
    A[2, 0] = -(stiffness + damping / (window * T))
    A[2, window + 2] += damping / (window * T)
    A[3, 0] = 1.0
    A[range(4, window + 3), range(3, window + 2)] = 1.0
    return A


def radius(window: int, stiffness: float, damping: float) -> float:
    return float(np.abs(eigvals(transition(window, stiffness, damping))).max())


# --------------------------------------------------------------------------------------- facts


@pytest.mark.parametrize(("window", "limit"), [(1, 36168.3), (15, 3041.3), (20, 2034.6)])
def test_the_largest_stiffness_of_an_omega_like_device(window: int, limit: float) -> None:
    found = replace(OMEGA, velocity=Velocity.difference(samples=window)).limits()
    assert found.stiffness == pytest.approx(limit, abs=0.1)
    assert found.is_reachable
    assert radius(window, found.stiffness * (1 - 1e-6), found.at_damping) < 1.0
    for damping in found.at_damping * np.linspace(0.8, 1.2, 41):
        assert radius(window, found.stiffness * (1 + 1e-6), damping) > 1.0


@pytest.mark.parametrize(("axis", "gain", "most"), [
    (0, 0.0, 2e3), (0, 10.0, 3e3), (0, -118.63, 2.5e4), (1, 1000.0, 60.0), (1, 18800.0, -200.0),
])  # fmt: skip
def test_intervals_of_a_row_are_those_in_which_all_roots_are_inside(
    axis: int, gain: float, most: float
) -> None:
    """Of the loop with a window of 20, whose set has an island at negative dampings."""
    line = (WINDOW.stiffness_intervals, WINDOW.damping_intervals)[axis](gain)
    assert line.status == jaxstab.exact.LineStatus.PROVED

    def is_stable(other: float) -> bool:
        wall = (other, gain) if axis == 0 else (gain, other)
        return radius(20, *wall) < 1.0

    ends = np.array([[low.value, high.value] for low, high in line.intervals]).reshape(-1, 2)
    for other in np.linspace(-0.1 * most, most, 401).tolist():
        is_inside = np.any((ends[:, 0] < other) & (other < ends[:, 1]))
        if np.min(np.abs(ends - other), initial=np.inf) > 1e-6 * abs(most):
            assert is_stable(other) == is_inside
    for low, high in ends:
        step = 1e-6 * (high - low)
        around = [low - step, low + step, high - step, high + step]
        assert [is_stable(other) for other in around] == [False, True, True, False]


def test_the_wall_of_chai3d_is_unstable_with_its_window() -> None:
    found = WINDOW.spectral_radius(*CHAI3D)
    assert WINDOW.verdict(*CHAI3D) == Verdict.UNSTABLE
    assert float(found.value) == pytest.approx(1.0235, abs=5e-5)
    assert abs(float(found.value) - radius(20, *CHAI3D)) < 1e-11
    assert OMEGA.verdict(*CHAI3D) == Verdict.STABLE
    assert OMEGA.margins(*CHAI3D).stiffness_gain == pytest.approx(3.47, abs=5e-3)


def test_islands_are_named_as_not_reachable() -> None:
    loop = replace(WINDOW, delay=0.0)
    region, limits = loop.region(), loop.limits()
    assert region.main is not None
    assert limits.stiffness < 4000.0
    assert limits.is_reachable
    assert len(limits.islands) == len(region.islands) == len(region.components) - 1 == 2
    assert not any(island.is_reachable for island in limits.islands)
    assert region.contains(29000.0, 175.0)
    assert not region.main.contains(29000.0, 175.0)
    assert any(island.contains(29000.0, 175.0) for island in region.islands)
    assert float(loop.spectral_radius(29000.0, 175.0).value) == pytest.approx(0.99459, abs=5e-6)
    assert float(loop.spectral_radius(15000.0, 175.0).value) == pytest.approx(1.03776, abs=5e-6)
    assert np.isnan(loop.stiffness_limits(175.0)).all()  # only an island is there
    low, high = region.islands[0].stiffness_limits(175.0)
    assert np.isnan(low) or (loop.verdict(0.5 * (low + high), 175.0) == Verdict.STABLE)


# ----------------------------------------------------------------- one loop, in SI units and not


def walls_of(loop: HapticLoop, count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(4)
    most = loop.limits()
    return (
        most.stiffness * rng.uniform(-0.1, 1.3, count), most.damping * rng.uniform(-0.1, 1.3, count)
    )  # fmt: skip


@pytest.mark.parametrize("loop", [OMEGA, HELD, replace(HELD, delay=0.0)])
@pytest.mark.parametrize(
    "velocity", [Velocity.difference(samples=1), Velocity.difference(window=1.0), Velocity()]
)
def test_a_window_of_one_sample_is_bit_for_bit_the_plain_loop(
    loop: HapticLoop, velocity: Velocity
) -> None:
    if velocity == Velocity.difference(window=1.0):
        velocity = Velocity.difference(window=loop.sample_time)
    own = replace(loop, velocity=velocity, position=Filter())
    walls = walls_of(loop, 300)
    assert np.array_equal(own.verdict(*walls), loop.verdict(*walls))
    for mine, plain in zip(own.spectral_radius(*walls), loop.spectral_radius(*walls), strict=True):
        assert np.array_equal(mine, plain)
    assert np.array_equal(own.poles(*walls), loop.poles(*walls))
    assert np.array_equal(own.region().outline, loop.region().outline)
    assert own.limits() == loop.limits()


def test_answers_are_those_of_the_five_numbers() -> None:
    stiffness, damping = walls_of(WINDOW, 40)
    five = WINDOW.alpha(stiffness), WINDOW.beta(damping), WINDOW.gamma, WINDOW.delta, 1.0
    own = {"velocity": Velocity.difference(samples=20)}
    assert np.array_equal(
        WINDOW.verdict(stiffness, damping), jaxstab.verdict(**by_name(*five), **own)
    )
    eigenvalues = jaxstab.closed_loop_poles(**by_name(*five), **own)
    poles = np.sort_complex(WINDOW.poles(stiffness, damping).round(9))
    np.testing.assert_allclose(poles, np.sort_complex(eigenvalues.round(9)), atol=2e-9)
    settling = WINDOW.settling_time(stiffness, damping, horizon=4096)
    samples = jaxstab.settling_samples(**by_name(*five), horizon=4096, **own)
    assert np.array_equal(settling.value, samples.value * 1e-3, equal_nan=True)
    mode = WINDOW.oscillation(stiffness, damping)
    plain = jaxstab.dominant_mode(**by_name(*five), **own)
    np.testing.assert_allclose(mode.frequency, plain.frequency / (2e-3 * np.pi), rtol=1e-10)


def test_arrays_broadcast() -> None:
    stiffness, damping = np.linspace(100.0, 3000.0, 4)[:, None], np.linspace(1.0, 20.0, 3)
    assert WINDOW.verdict(stiffness, damping).shape == (4, 3)
    assert WINDOW.spectral_radius(stiffness, damping).value.shape == (4, 3)
    assert OMEGA.margins(stiffness, damping).stiffness.shape == (4, 3, 2)
    assert WINDOW.simulate(stiffness, damping, force=1.0, samples=7).position.shape == (4, 3, 7)
    assert WINDOW.region().contains(stiffness, damping).shape == (4, 3)
    assert WINDOW.stiffness_limits(damping).shape == (3, 2)


@pytest.mark.parametrize("velocity", [None, Velocity.difference(samples=4)])
@pytest.mark.parametrize(
    ("spring", "damping"), [(0.0, 0.1), (0.0, 0.0), (5e-324, 0.1), (700.0, 5.0)]
)
def test_verdicts_of_many_are_those_of_one_or_undecided(
    velocity: Velocity | None, spring: float, damping: float
) -> None:
    """K T^2/m that is 0 in float64, or rounded past -k T^2/m, gave other verdicts."""
    loop = HapticLoop(
        device_mass=0.3, device_damping=damping, hand_stiffness=spring, sample_time=1e-3,
        velocity=velocity,
    )  # fmt: skip
    sizes = [0.0, 5e-324, 2e-319, 1e-310, 1e-300, 1e-100, 1.0, 1e150]
    near = -spring + np.arange(-9.0, 10.0) * np.spacing(spring)
    stiffness, damping_of_wall = (
        np.append(sizes, near)[:, None],
        np.array([-1e-310, 0.0, *sizes[1:]]),
    )
    one = np.array([[loop.verdict(k, b) for b in damping_of_wall] for k in stiffness[:, 0]], int)
    for gains in (stiffness, jnp.asarray(stiffness)):
        many = np.asarray(loop.verdict(gains, damping_of_wall))
        assert np.isin(many[many != one], Verdict.UNDECIDED).all()
        assert np.mean(many == one) > 0.1


@pytest.mark.parametrize(
    "fields",
    [
        {"sample_time": 1e-160, "delay": 0.0},
        {"device_mass": [1.0, 1e305]},
        {"device_mass": 1e-300},
        {"device_mass": [5e-324, 1.0]},  # where K T^2/m overflowed with warnings
    ],
)
def test_loops_whose_units_lose_digits_are_refused(fields: Any) -> None:
    with pytest.raises(ValueError, match=r"sample_time is .* give SI units"):
        replace(OMEGA, **fields)


MANY = replace(WINDOW, device_mass=np.array([[0.2], [0.3]]), delay=[0.0, 1e-3, 1.5e-3])


@pytest.mark.parametrize(
    ("method", "options"),
    [
        ("verdict", {}),
        ("spectral_radius", {}),
        ("poles", {}),
        ("margins", {}),
        ("oscillation", {}),
        ("settling_time", {"level": 0.05}),
        ("amplitude", {"encoder": 1e-5}),
    ],
)
def test_methods_about_walls_broadcast_with_fields_that_are_arrays(
    method: str, options: dict[str, Any]
) -> None:
    stiffness = np.array([500.0, 900.0, 9000.0])
    many = getattr(MANY, method)(stiffness, 5.0, **options)
    columns = many if isinstance(many, tuple) else (many,)
    masses, delays = np.broadcast_arrays(MANY.device_mass, MANY.delay)
    for index in np.ndindex(MANY.shape):
        one = replace(MANY, device_mass=float(masses[index]), delay=float(delays[index]))
        own = getattr(one, method)(stiffness[index[-1]], 5.0, **options)
        for column, value in zip(columns, own if isinstance(own, tuple) else (own,), strict=True):
            if not isinstance(column, np.ndarray):  # names, and what one loop alone has
                continue
            known = np.asarray(value)
            found = column[index][: known.size] if known.ndim else column[index]
            np.testing.assert_allclose(found, known, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize(
    "call",
    [
        lambda loop: loop.region(),
        lambda loop: loop.limits(),
        lambda loop: loop.stiffness_limits(10.0),
        lambda loop: loop.boundary_distance(*CHAI3D),
        lambda loop: loop.tune(),
        lambda loop: loop.worst_hand(HANDS, *CHAI3D),
        lambda loop: loop.robust_limit(HANDS),
        lambda loop: loop.plot(),
        lambda loop: loop.to_control(*CHAI3D),
        lambda loop: loop.jitter_margin(*CHAI3D),
        lambda loop: loop.verdict(*CHAI3D, delays=(0.0, 1e-3)),
        lambda loop: loop.worst_delays(*CHAI3D, delays=(0.0, 1e-3)),
        lambda loop: loop.simulate(*CHAI3D, force=1.0),
        lambda loop: jaxstab.contact(loop, *CHAI3D, push=1.0, friction=0.1),
        lambda loop: jaxstab.contact(loop, [1e3], [10.0], push=1.0, friction=0.1, path=False),
        lambda loop: loop.stiffness_intervals(10.0),
        lambda loop: jaxstab.limits_of([loop]),
        lambda loop: jaxstab.study(loop, walls={"a": CHAI3D}, over={"device_mass": [0.1]}),
        lambda loop: jaxstab.build_guard(loop, HANDS, mass=(0.1, 0.2), delay=(0.0, 1e-3)),
        lambda loop: replace(loop, sample_time=[1e-3, 1e-3, 2e-3]).verdict(*CHAI3D),
    ],
)
def test_what_is_of_one_loop_refuses_arrays_and_names_the_remedy(call: Any) -> None:
    with pytest.raises(TypeError, match=r"one loop is needed here; jaxstab\.limits_of, regions_of"):
        call(MANY)


def test_arrays_as_fields_are_checked_as_numbers_are() -> None:
    with pytest.raises(ValueError, match=r"device_mass \(2,\) and delay \(3,\) do not broadcast"):
        replace(OMEGA, device_mass=[0.1, 0.2], delay=[0.0, 1e-3, 2e-3])
    with pytest.raises(ValueError, match="device_damping is nan; allowed are finite values"):
        replace(OMEGA, device_damping=[0.1, np.nan])
    with pytest.raises(TypeError, match=r"device_mass is .*; give real numbers"):
        replace(OMEGA, device_mass=[[0.1], [0.1, 0.2]])
    with pytest.raises(ValueError, match=r"window is 0.002 s, 6.66667 sampling periods"):
        replace(OMEGA, velocity=Velocity.difference(window=2e-3), sample_time=[1e-3, 0.3e-3])
    assert repr(replace(OMEGA, delay=[0.0, 1e-3])).endswith("delay=array([0.   , 0.001]))")


GIVEN: dict[str, Any] = {"stiffness": [1.0, 2.0], "damping": [1.0, 2.0, 3.0]}
TOGETHER: dict[str, Callable[[], Any]] = {
    "verdict": lambda: OMEGA.verdict(**GIVEN),
    "settling": lambda: OMEGA.settling_time(**GIVEN),
    "motion": lambda: OMEGA.simulate(**GIVEN, force=1.0),
    "amplitude": lambda: OMEGA.amplitude(**GIVEN, encoder=1e-5),
    "margins": lambda: OMEGA.margins(**GIVEN),
    "frequency": lambda: OMEGA.frequency_margins(**GIVEN),
    "contact": lambda: jaxstab.contact(OMEGA, **GIVEN, push=1.0, path=False),
    "distance": lambda: OMEGA.region().distance(**GIVEN),
}


@pytest.mark.parametrize("ask", TOGETHER.values(), ids=TOGETHER)
def test_gains_that_do_not_broadcast_are_named(ask: Callable[[], Any]) -> None:
    with pytest.raises(ValueError, match=r"stiffness \(2,\) and damping \(3,\) do not broad"):
        ask()


@pytest.mark.parametrize(
    "function",
    [jaxstab.verdict, jaxstab.spectral_radius, jaxstab.closed_loop_poles, jaxstab.settling_samples],
)
def test_numbers_that_do_not_broadcast_are_named(function: Callable[..., Any]) -> None:
    with pytest.raises(ValueError, match=r"shapes beta \(2,\) and delay \(3,\) do not broadcast;"):
        function(0.1, [0.1, 0.2], gamma=0.0, delta=0.1, delay=[0.0, 1.0, 2.0])


@pytest.mark.campaign
def test_the_dense_case_goes_through_jit_and_vmap() -> None:
    stiffness, damping = (jax.numpy.asarray(gains) for gains in walls_of(WINDOW, 50))
    plain = WINDOW.verdict(np.asarray(stiffness), np.asarray(damping))
    compiled = jax.jit(WINDOW.verdict)(stiffness, damping)
    mapped = jax.jit(jax.vmap(WINDOW.verdict))(stiffness, damping)
    assert isinstance(compiled, jax.Array)
    decided = np.asarray(compiled) != Verdict.UNDECIDED
    assert decided.mean() > 0.9
    np.testing.assert_array_equal(np.asarray(compiled)[decided], plain[decided])
    np.testing.assert_array_equal(mapped, compiled)


# ------------------------------------------------------------------- units of filters, and motion

SI_FILTERS: dict[str, tuple[dict[str, Any], list[Taps], list[Taps]]] = {
    "window in s": ({"velocity": Velocity.difference(window=0.02)}, [difference_taps(10)], []),
    "low pass in Hz": (
        {"velocity": Velocity.low_pass(40.0, order=2), "position": Filter.low_pass(150.0)},
        [difference_taps(1), low_pass_taps(0.08), low_pass_taps(0.08)],
        [low_pass_taps(0.3)],
    ),
    "Butterworth in Hz": (
        {"velocity": Velocity.butterworth(50.0, order=3)},
        [difference_taps(1), *butterworth_taps(0.1, 3)],
        [],
    ),
    "exponential": (
        {"velocity": Velocity.exponential(0.25)},
        [difference_taps(1), ([0.25, 0.0], [1.0, -0.75])],
        [],
    ),
    "transfer function in 1/s": (
        {"velocity": Velocity.transfer_function([375.0, -250.0, -125.0], [1.0, -0.5, 0.0])},
        [([0.75, -0.5, -0.25], [1.0, -0.5, 0.0])],
        [],
    ),
}


@pytest.mark.parametrize("case", SI_FILTERS)
def test_a_simulated_loop_moves_as_lfilter_has_it(case: str) -> None:
    filters, velocity, position = SI_FILTERS[case]
    loop = replace(HELD, **filters)  # T = 2 ms
    wall = (400.0, 4.0)
    response = loop.simulate(*wall, samples=300, initial_velocity=0.1)
    states, _ = march_through_filters(
        tuple(loop.slice.values()), (loop.alpha(wall[0]), loop.beta(wall[1])),
        velocity, position, 300,
        start=(0.0, 0.1 * loop.sample_time),
    )  # fmt: skip
    size = np.abs(states[:, 0]).max()
    np.testing.assert_allclose(response.position, states[:, 0], atol=1e-10 * size)
    decay = np.abs(states[150:, 0]).max() / np.abs(states[:150, 0]).max()
    assert (decay < 1.0) == bool(loop.verdict(*wall) == Verdict.STABLE)


# --------------------------------------------------------------------------- islands and regions


def test_a_region_is_asked_in_si_units() -> None:
    region, whole = HELD.region(), jaxstab.stable_region(**HELD.slice)
    scale = np.array([HELD.stiffness(1.0), HELD.damping(1.0)])
    assert region.status == RegionStatus.COMPLETE
    np.testing.assert_array_equal(region.outline, region.region.points * scale)
    np.testing.assert_allclose(region.corners, whole.corners * scale, rtol=1e-12)
    assert region.area == pytest.approx(float(whole.area) * scale.prod(), rel=1e-14)
    assert region.components == [region]
    assert region.main is region
    assert region.islands == []
    low, high = region.stiffness_limits(region.stiffest.damping * 0.5)
    assert region.contains(0.5 * (low + high), region.stiffest.damping * 0.5)
    assert not region.contains(high * (1 + 1e-9), region.stiffest.damping * 0.5)
    at_most = region.stiffness_limits(region.stiffest.damping)[1]
    np.testing.assert_allclose(at_most, region.stiffest.stiffness)
    assert region.distance(*np.array(region.stiffest) / 2) > 0.0
    assert HELD.region() is region  # remembered


def test_a_coarser_outline_has_fewer_points_and_the_same_limits() -> None:
    coarse = HELD.region(tolerance=1e-3)
    assert len(coarse.outline) < len(HELD.region().outline)
    np.testing.assert_allclose(coarse.stiffest, HELD.region().stiffest, rtol=1e-9)


# ------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("filters", "message"),
    [
        ({"velocity": Velocity.difference(window=15.5e-3)}, r"0.015 s \(15 .* 0.016 s \(16"),
        (
            {"velocity": Velocity.butterworth(600.0, order=2)},
            "below half of the sampling rate, 500 Hz",
        ),
        ({"position": Filter.low_pass(1e9)}, "closer to 1 / period"),
        ({"position": Filter.low_pass(10.0, order=40) * Filter.low_pass(10.0)}, "order 41"),
    ],
)
def test_a_filter_that_does_not_go_with_the_period_is_refused_at_birth(
    filters: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        replace(OMEGA, **filters)
    assert "\n" not in str(caught.value)


def test_what_is_no_estimator_is_refused() -> None:
    with pytest.raises(TypeError, match="velocity"):
        replace(OMEGA, velocity=20)
    with pytest.raises(TypeError, match="position"):
        replace(OMEGA, position=Velocity.difference(samples=20))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: OMEGA.verdict(np.nan, 1.0), "stiffness is nan"),
        (lambda: OMEGA.poles(1.0, np.inf), "damping is inf"),
        (lambda: OMEGA.region().contains(1.0, np.nan), "damping is nan"),
        (lambda: replace(OMEGA, delay=0.6).limits(), "500 samples"),
    ],
)
def test_bad_gains_are_refused(call: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()


def test_beyond_the_wall_nothing_is_positional() -> None:
    with pytest.raises(TypeError, match=r"^HapticLoop\."):
        HapticLoop(0.25, 0.1, 1e-3)  # type: ignore[misc]
    with pytest.raises(TypeError):
        OMEGA.settling_time(1000.0, 10.0, 0.05)  # type: ignore[misc]
    with pytest.raises(TypeError):
        OMEGA.simulate(1000.0, 10.0, 100)  # type: ignore[misc]


def test_functions_of_five_numbers_name_the_method() -> None:
    with pytest.raises(TypeError, match=r"loop.region\(\)"):
        jaxstab.stable_region(OMEGA)
    with pytest.raises(TypeError, match=r"loop.margins\(K, B\)"):
        jaxstab.margins(OMEGA, 1000.0, gamma=0.0, delta=0.0, delay=1.0)


@pytest.mark.parametrize("tolerance", [0.0, -1.0, np.nan, 1e-10])
def test_a_tolerance_that_no_outline_keeps_is_refused(tolerance: float) -> None:
    with pytest.raises(ValueError, match=f"tolerance is {tolerance}; allowed are finite values"):
        WINDOW.region(tolerance=tolerance)


@pytest.mark.campaign
def test_float32_of_jax_is_computed_in_float64() -> None:
    """Formed in float32, K T^2/m is that of another wall, and its proof that of another loop."""
    mass, damping = np.float32(0.3), np.float32(20.0)

    def of(number: Any) -> HapticLoop:
        return HapticLoop(device_mass=number, device_damping=0.1, sample_time=1e-3, delay=1e-3)

    plain = of(float(mass))
    limit = np.float32(plain.stiffness_limits(float(damping))[1])
    stiffness = limit * (1.0 + np.arange(-8.0, 9.0) * 6e-8).astype(np.float32)
    walls = stiffness.astype(np.float64), float(damping)
    expected, radius = plain.verdict(*walls), plain.spectral_radius(*walls)
    assert {int(code) for code in expected} == {Verdict.STABLE, Verdict.UNSTABLE}
    given = jnp.asarray(mass), jnp.asarray(stiffness), jnp.asarray(damping)
    for ask in (lambda f: f(*given), lambda f: jax.jit(f)(*given)):
        codes = ask(lambda m, K, B: of(m).verdict(K, B))
        assert not np.any((codes != expected) & (codes != Verdict.UNDECIDED))
        found = ask(lambda m, K, B: of(m).spectral_radius(K, B))
        assert np.all(abs(found.value - radius.value) <= found.error + radius.error)
    rounded = jax.tree.map(jnp.float32, plain)
    same = jax.tree.map(lambda number: float(np.float32(number)), plain)
    narrow = jax.jit(lambda loop, K, B: loop.spectral_radius(K, B))(rounded, *given[1:])
    wide = same.spectral_radius(*walls)
    assert np.all(abs(narrow.value - wide.value) <= narrow.error + wide.error)
    limits = of(given[0]).limits().stiffness
    np.testing.assert_allclose(limits, plain.limits().stiffness, rtol=1e-14)
    response = of(given[0]).simulate(given[1], given[2], force=1.0).position
    np.testing.assert_allclose(
        response, plain.simulate(*walls, force=1.0).position, rtol=0, atol=1e-12
    )
