"""Limits in SI units and distances: the counter-examples that searches of fixed angles missed."""

import sys
from dataclasses import replace
from subprocess import run
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mpmath import mp, mpf

import jaxstab
from jaxstab import Filter, HapticLoop, Velocity, Verdict
from jaxstab.exact.line import Interval, LineStatus, StableLine
from jaxstab.loop.region import reached_interval
from jaxstab.model import by_name
from jaxstab.region import Branch, RegionStatus, StableRegion, boundary_curve, stable_region
from jaxstab.region import region as region_of_slices
from tests.truth import loop as truth
from tests.truth.filtered import FilteredLoop, average, difference
from tests.truth.random_loops import DeviceLoop


def loop_of(
    gamma: float, delta: float, delay: float, velocity: Velocity | None = None
) -> HapticLoop:
    """A loop of which K = alpha and B = beta."""
    plant = {"device_mass": 1.0, "device_damping": delta, "hand_stiffness": gamma}
    return HapticLoop(**plant, sample_time=1.0, delay=delay, velocity=velocity)


def is_stable(alpha: float, beta: float, loop: HapticLoop) -> bool:
    lower, upper = truth.spectral_radius(alpha, beta, loop.gamma, loop.delta, loop.delay_samples)
    assert (lower > 1.0) != (upper < 1.0)
    return bool(upper < 1.0)


def test_the_largest_damping_is_not_missed_between_two_angles() -> None:
    loop = loop_of(10.157332213034863, 0.00267301090318457, 15.788241242160241)
    assert is_stable(-9.74824021756067, 4.853085545023148, loop)
    region = loop.region()
    assert region.status == RegionStatus.COMPLETE
    at_stiffness, damping = region.region.max_beta
    assert damping == pytest.approx(5.0573, abs=5e-5)
    for share, stable in ((1 - 1e-6, True), (1 + 1e-6, False)):
        # Next to the corner the stable set is thin: a little to the right of alpha = -gamma.
        walls = at_stiffness + np.geomspace(1e-9, 1e-3, 13)
        assert any(is_stable(float(a), damping * share, loop) for a in walls) == stable


def held(rng: np.random.Generator, samples: int) -> HapticLoop:
    """A device in a hand with stiffness and damping, and the difference over some samples."""
    return HapticLoop(
        device_mass=float(rng.uniform(0.05, 0.5)),
        device_damping=0.1,
        hand_damping=float(10 ** rng.uniform(0.0, 1.5)),
        hand_stiffness=float(10 ** rng.uniform(1.0, 3.5)),
        sample_time=1e-3,
        delay=float(rng.choice([0.0, 1.0, rng.uniform(0.1, 2.9)])) * 1e-3,
        velocity=Velocity.difference(samples),
    )


@pytest.mark.parametrize("samples", [1, 3, pytest.param(20, marks=pytest.mark.campaign)])
def test_no_wall_without_negative_gains_exceeds_the_limits(samples: int) -> None:
    """The stable set of a held device extends to negative gains; larger ones are stable there."""
    rng, on_axes = np.random.default_rng(37), np.zeros(2, int)
    shares = np.linspace(0.0, 1.0, 60)
    for _ in range(6):
        loop = held(rng, samples)
        limits = loop.limits()
        exact = FilteredLoop(**loop.slice, velocity=difference(samples), position=average(1))
        balls = exact.balls(400)

        def is_stable(stiffness: float, damping: float) -> bool:
            return balls.is_stable(loop.alpha(stiffness), loop.beta(damping))  # noqa: B023

        for share, stable in ((1.0 - 1e-9, True), (1.0 + 1e-9, False)):
            assert is_stable(share * limits.stiffness, limits.at_damping) == stable
            assert is_stable(limits.at_stiffness, share * limits.damping) == stable
        on_axes += [limits.at_damping == 0.0, limits.at_stiffness == 0.0]
        # Verdicts are proved: beyond a limit no wall of a grid is stable but on islands.
        stiffer = limits.stiffness * (1.0 + 1e-6 + shares), limits.damping * shares[:, None]
        damped = limits.stiffness * shares, limits.damping * (1.0 + 1e-6 + shares[:, None])
        for walls in (stiffer, damped):
            is_wall = loop.verdict(*walls) == Verdict.STABLE
            assert not np.any(
                is_wall & ~np.any([i.contains(*walls) for i in loop.region().islands], 0)
            )
    assert ((on_axes > 0) == [samples == 20, True]).all()


def test_one_gain_is_answered_without_a_region(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each end is where the radius of mpmath passes 1, and no region is asked for."""
    loops = [held(rng, 1) for _ in range(6)]
    tops = [loop.limits().damping for loop in loops]
    monkeypatch.setattr("jaxstab.loop.loop.region_of_loop", None)
    for loop, top in zip(loops, tops, strict=True):
        wall = [0.0, float(rng.uniform(0.05, 0.9)) * top]
        for axis, limits in ((0, loop.stiffness_limits), (1, loop.damping_limits)):
            low, high = limits(wall[1 - axis])
            for end, other in ((low, high), (high, low)):
                for share, stable in ((-1e-9, True), (1e-9, False)):
                    wall[axis] = float(end + share * (end - other))
                    assert is_stable(loop.alpha(wall[0]), loop.beta(wall[1]), loop) == stable
            wall[axis] = 0.5 * float(high)
        assert np.isnan(loop.stiffness_limits(10.0 * top)).all()


def test_walls_of_an_island_are_not_reached_by_small_gains() -> None:
    """The main component lies in K < 0.0082 N/m and B > -0.0005 N s/m: its limits are not there."""
    loop = loop_of(0.0, 0.0004, 1.0, Velocity.difference(samples=20))
    ((_, high),) = loop.stiffness_intervals(-0.4).intervals
    assert loop.region().islands[0].contains(0.99 * high.value, -0.4)
    assert np.isnan(loop.stiffness_limits(-0.4)).all()
    assert np.isnan(loop.damping_limits(0.07)).all()


def test_of_two_intervals_that_the_region_joins_the_farther_one_is_the_answer() -> None:
    loop = DeviceLoop.drawn(np.random.default_rng([5, 6])).loop
    near, far = loop.stiffness_intervals(34.0).intervals
    assert near.low.value == 0.0
    assert near.high.value < far.low.value
    wanted = [end.value for end in far]
    assert loop.stiffness_limits(34.0) == pytest.approx(wanted, rel=1e-9)
    # At a stiffness of the farther one small gains do not come along the row.
    assert reached_interval(loop, "stiffness", 610000.0) is None


def test_a_row_is_reached_only_if_all_walls_next_to_no_stiffness_are_stable(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    loop = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
    assert reached_interval(loop, "damping", 20.0) == pytest.approx([0.0, 35324.95892], abs=1e-5)
    column = loop.damping_intervals(0.0)
    ((low, high),) = column.intervals
    for ends in ((low._replace(value=1.0), high), (low, high._replace(value=15.0))):
        short = column._replace(intervals=(Interval(*ends),))
        monkeypatch.setattr("jaxstab.loop.region._without_stiffness", lambda _, own=short: own)
        assert reached_interval(loop, "damping", 20.0) is None
        assert reached_interval(loop, "stiffness", 20000.0) is None


def test_a_line_that_balls_leave_open_tells_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    loop = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
    nothing = StableLine((), (), 0, 0.0, LineStatus.UNDECIDED, 192)
    monkeypatch.setattr(HapticLoop, "_line", lambda *_, **__: nothing)
    assert reached_interval(loop, "damping", 20.0) is None


def test_the_largest_damping_on_the_line_of_a_real_root_is_where_that_crosses_the_axis() -> None:
    """Without delay a stiff hand is stable up to a root at -1: alpha + 2 beta = w(-1)."""
    loop = loop_of(4.0, 2.0, 0.0)
    base, damping = (
        np.polyval(jaxstab.model.characteristic_polynomial(*wall, **loop.slice), -1.0)
        for wall in ((0.0, 0.0), (0.0, 1.0))
    )
    limits = loop.limits()
    assert limits.at_stiffness == 0.0
    assert limits.damping == pytest.approx(base / (base - damping), rel=1e-12)


def test_a_limit_without_damping_that_is_small_beside_the_region_is_right() -> None:
    slow = Velocity.difference(samples=1) * Filter.butterworth(cutoff=0.003673671000105174, order=3)
    body = {"device_mass": 1.0, "device_damping": 2.5185587900846804e-09}
    loop = HapticLoop(
        **body, hand_stiffness=1.5748095492260936, sample_time=1.0, delay=2.0, velocity=slow
    )
    limits = loop.limits()
    assert limits.at_damping == 0.0
    verdicts = loop.verdict(limits.stiffness * np.array([1.0 - 1e-12, 1.0 + 1e-12]), 0.0)
    assert verdicts.tolist() == [Verdict.STABLE, Verdict.UNSTABLE]


def test_an_island_of_negative_damping_has_no_stiffest_wall_but_limits() -> None:
    window = Velocity.difference(samples=20)
    omega = {"device_mass": 0.25, "device_damping": 0.1, "sample_time": 1e-3, "delay": 1e-3}
    loop = HapticLoop(**omega, velocity=window)
    for island, limits in zip(loop.region().islands, loop.limits().islands, strict=True):
        low, high = island.outline.min(axis=0), island.outline.max(axis=0)
        assert high[1] < 0.0 < low[0]
        assert np.isnan(island.stiffest).all()
        assert np.isnan(island.most_damped).all()
        assert (limits.stiffness, limits.damping) == pytest.approx(tuple(high), rel=1e-12)


@pytest.mark.parametrize("damping", [1e-10, 1e-8, 1e-5])
def test_gains_far_below_the_size_of_the_region_are_limits(damping: float) -> None:
    """A spring with hardly a damper, late: walls with K, B < 0 damp it; by roots of 50 digits."""
    numbers = {"device_damping": damping, "hand_stiffness": 1.0, "sample_time": 1.0, "delay": 2.0}
    limits = HapticLoop(device_mass=1.0, **numbers).limits()
    assert limits.is_reachable

    def radius(stiffness: float, share: float) -> mpf:
        wall = mpf(stiffness) * share, mpf(limits.damping) * share * (stiffness == 0.0)
        with mp.workdps(50):
            p = truth.polynomial(*wall, 1.0, damping, 2.0)
            return max(map(abs, mp.polyroots(p[::-1], maxsteps=200, extraprec=300, asc=True)))

    for stiffness in (limits.stiffness, 0.0):
        assert radius(stiffness, 1.0 - 1e-6) < 1 < radius(stiffness, 1.0 + 1e-6)
    assert limits.at_damping == limits.at_stiffness == 0.0


def test_without_walls_of_positive_gains_there_are_no_limits() -> None:
    """Sec. VIII of the paper: with such a hand all stable walls have K <= 0."""
    loop = loop_of(np.pi**2 / 4, 0.0, 0.0)
    limits = loop.limits()
    assert np.isnan(limits[:4]).all()
    assert repr(limits).endswith("no gains with K >= 0 and B >= 0 are stable")
    assert float(loop.region().region.max_alpha[0]) <= 1e-12


def test_thin_intervals_of_damping_are_found() -> None:
    loop = loop_of(2.891596916647083e-05, 0.0012064263375737682, 14.225407632632395)
    stiffness = 0.0024356861671512276
    low, high = loop.damping_limits(stiffness)
    width = high - low
    assert 0.0608 < low < high < 0.06125
    for damping, stable in (
        (low - 0.01 * width, False),
        (low + 0.01 * width, True),
        (high - 0.01 * width, True),
        (high + 0.01 * width, False),
    ):
        assert is_stable(stiffness, float(damping), loop) == stable


def test_a_region_that_is_not_resolved_says_so_and_gives_no_numbers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(region_of_slices, "_contradictions", lambda *_: None)
    loop = loop_of(0.3974111395517997, 0.039837948153417437, 2.2049574518921172)
    best = loop.limits()
    assert best.status == RegionStatus.UNRESOLVED
    assert np.isnan(best[:4]).all()
    assert np.isnan(loop.boundary_distance(30.0, 0.1))


def test_a_stiff_hand_at_a_long_delay_has_the_limits_that_verdicts_have() -> None:
    window = Velocity.difference(1) * Filter.average(5)
    loop = loop_of(39.74111395517997, 0.039837948153417437, 22.204957451892117, velocity=window)
    best = loop.limits()
    assert best.status == RegionStatus.COMPLETE
    beside = np.array([1.0 - 1e-7, 1.0 + 1e-7])
    of_stiffness = loop.verdict(best.stiffness * beside, best.at_damping)
    of_damping = loop.verdict(best.at_stiffness, best.damping * beside)
    for codes in (of_stiffness, of_damping):
        assert codes.tolist() == [Verdict.STABLE, Verdict.UNSTABLE]


@pytest.mark.campaign
def test_a_slice_that_float64_does_not_resolve_is_drawn_in_double_double() -> None:
    loop = loop_of(9.86962156939937, 0.0, 12.857742738867492)
    region = loop.region()
    assert region.status == RegionStatus.COMPLETE
    assert region.contains(-3.735280306113643, 1.86764828052154)
    corners = np.asarray(region.outline)
    assert len(region.components) == 1
    middle = np.mean(corners, axis=0)
    for share, code in ((0.999, Verdict.STABLE), (1.001, Verdict.UNSTABLE)):
        codes = loop.verdict(*(middle + share * (corners - middle)).T)
        assert set(np.unique(codes)) <= {code, Verdict.UNDECIDED}
        assert np.mean(codes == code) > 0.9


def dense_boundary(
    region: StableRegion, place: tuple[float, ...], radius: float = 1.0
) -> np.ndarray:
    """Short chords (n, 2, 2) of the region's boundary: of its straight edges, and of the curve."""
    shares = np.linspace(0, 1, 65)
    begin, end = region.outline.angles[: len(region.branch), :, None].swapaxes(0, 1)
    theta = begin + shares * (end - begin)
    curve = np.stack(boundary_curve(theta, **by_name(*place), radius=radius), axis=-1)
    here, there = region.points[:-1, None], region.points[1:, None]
    lines = here + shares[:, None] * (there - here)
    on_curve = (region.branch == Branch.CURVE)[:, None, None]
    points = np.where(on_curve, curve, lines)[region.branch >= 0]
    return np.stack([points[:, :-1], points[:, 1:]], axis=2).reshape(-1, 2, 2)


def distance_to(chords: np.ndarray, point: np.ndarray) -> float:
    here, along = chords[:, 0], chords[:, 1] - chords[:, 0]
    share = np.sum((point - here) * along, axis=1) / np.maximum(np.sum(along**2, axis=1), 1e-300)
    return float(np.hypot(*(here + np.clip(share, 0, 1)[:, None] * along - point).T).min())


SHARP = (88.19443994045147, 0.4993197713896914, 0.5537552816061377), 0.8161400066925342


def test_the_distance_next_to_a_sharp_turn_is_that_to_the_curve() -> None:
    place, radius = SHARP
    point = np.array([72.49673704316012, -31.60018426249376])
    region = stable_region(**by_name(*place), radius=radius)
    assert abs(region.distance(*point)) == pytest.approx(6.341586827520546e-4, rel=1e-9)
    assert distance_to(dense_boundary(region, place, radius), point) == pytest.approx(
        6.3416e-4, rel=1e-3
    )


SLICES = [
    SHARP,
    ((39.799975315059754, 0.4533140420022334, 4.0), 1.0),
    ((3.4221236931311325, 9.11095313928446, 6.351107263508205), 1.0),
    ((1e-3, 0.015, 1.0), 1.0),
    ((0.1, 0.05, 12.0), 0.97),
    ((11.523438187710303, 0.40536209838398013, 1.0), 1.0),
]


@pytest.mark.parametrize(("place", "radius"), SLICES)
def test_distances_are_those_to_dense_points_of_the_boundary(
    place: tuple[float, ...], radius: float, rng: np.random.Generator
) -> None:
    region = stable_region(**by_name(*place), radius=radius)
    low, high = region.points.min(axis=0), region.points.max(axis=0)
    size = high - low
    anywhere = rng.uniform(low - 0.3 * size, high + 0.3 * size, (6, 2))
    close = region.points[rng.integers(0, len(region.points), 6)] + 1e-3 * size * rng.normal(
        size=(6, 2)
    )
    boundary = dense_boundary(region, place, radius)
    for point in np.concatenate([anywhere, close]):
        distance = abs(float(region.distance(*point)))
        dense = distance_to(boundary, point)
        assert distance == pytest.approx(dense, abs=1e-8 * np.hypot(*size))


def test_the_distance_of_an_unstable_wall_is_the_way_to_the_stable_ones() -> None:
    """A pair of roots crosses the circle 0.000255 away, but others stay outside there."""
    place = (11.405564355911224, 1.5592429629386233e-06, 8.243292912477305)
    wall = np.array([12.273777225929214, -5.663227002875532])
    distance = float(loop_of(*place).boundary_distance(*wall))
    boundary = dense_boundary(stable_region(**by_name(*place)), place)
    assert distance == pytest.approx(-distance_to(boundary, wall), rel=1e-4)
    theta = np.linspace(0, np.pi, 200_001)[1:-1]
    curve = np.stack(boundary_curve(theta, **by_name(*place)), axis=-1)
    away = np.hypot(*(curve - wall).T)
    assert away.min() < 1e-3
    assert not is_stable(*curve[np.argmin(away)] * (1 - 1e-6), loop_of(*place))


def test_limits_of_a_loop_are_differentiable_in_the_wall() -> None:
    loop = loop_of(0.05, 0.1, 1.0)
    slope = jax.grad(lambda damping: loop.stiffness_limits(damping)[1])(0.3)
    ahead, behind = (loop.stiffness_limits(0.3 + h)[1] for h in (1e-6, -1e-6))
    assert float(slope) == pytest.approx((ahead - behind) / 2e-6, rel=1e-6)


def test_a_loop_given_for_numbers_is_answered_in_one_sentence() -> None:
    with pytest.raises(TypeError, match=r"^stable_region takes [^\n]*loop\.gamma[^\n]*\.$"):
        stable_region(loop_of(0.1, 0.1, 0.0))


@pytest.mark.campaign
@pytest.mark.parametrize("samples", [1, 4])
def test_gains_of_jax_are_answered_on_the_host_with_slopes(samples: int) -> None:
    """Limits on the curve and on both lines, distances to each of them, inside and outside."""
    loop = replace(loop_of(0.05, 0.1, 1.0), velocity=Velocity.difference(samples=samples))
    region = loop.region()
    (low, high), (least, most) = np.array([region.outline.min(0), region.outline.max(0)]).T
    shares = jnp.linspace(0.07, 0.93, 9)
    questions: list[tuple[Any, Any]] = [
        (loop.stiffness_limits, (least + shares * (most - least),)),
        (loop.damping_limits, (low + shares * (high - low),)),
        (loop.boundary_distance, (low + shares * (high - low), least + shares[::-1] * most)),
    ]
    for function, gains in questions:
        plain = function(*map(np.asarray, gains))
        np.testing.assert_array_equal(jax.jit(function)(*gains), plain)
        np.testing.assert_array_equal(jax.vmap(function)(*gains), plain)
        for which, gain in enumerate(gains):
            step = 1e-6 * (jnp.abs(gain).max() + 0.0 * gain)
            ends = [
                function(*(np.asarray(x + sign * step * (k == which)) for k, x in enumerate(gains)))
                for sign in (1.0, -1.0)
            ]
            divisor = np.asarray(2.0 * step)[(...,) + (None,) * (plain.ndim - 1)]
            unit = (jnp.ones_like(x) * (k == which) for k, x in enumerate(gains))
            slopes = jax.jvp(function, gains, tuple(unit))[1]
            size = np.abs(slopes).max()
            np.testing.assert_allclose(slopes, (ends[0] - ends[1]) / divisor, atol=1e-5 * size)
    inside = region.contains(*questions[2][1])
    assert isinstance(inside, jax.Array)
    np.testing.assert_array_equal(inside, region.contains(*map(np.asarray, questions[2][1])))


def test_a_traced_slice_is_sent_to_regions_of() -> None:
    with pytest.raises(TypeError, match=r"^stable_region [^\n]*call regions_of\."):
        jax.jit(lambda gamma: stable_region(gamma=gamma, delta=0.1, delay=1.0).max_alpha)(0.1)
    assert (
        stable_region(gamma=jnp.asarray(0.1), delta=0.1, delay=1.0).status == RegionStatus.COMPLETE
    )


def test_limits_that_jax_computed_are_printed_as_others_are() -> None:
    limits = HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3).limits()
    assert repr(jax.tree.map(jnp.asarray, limits)) == repr(limits)


def test_long_delays_are_answered_or_refused() -> None:
    region = stable_region(gamma=1e-3, delta=0.015, delay=100.0)
    assert region.status == RegionStatus.COMPLETE
    alpha, beta = map(float, region.max_alpha)
    place = (1e-3, 0.015, 100.0)
    assert jaxstab.verdict(alpha - 1e-7, beta, **by_name(*place)) == Verdict.STABLE
    assert jaxstab.verdict(alpha + 1e-7, beta, **by_name(*place)) == Verdict.UNSTABLE
    with pytest.raises(ValueError, match=r"^delay is 2000\.0; [^\n]*500 samples\.$"):
        stable_region(gamma=1e-3, delta=0.015, delay=2000.0)


def test_corners_on_a_line_have_its_alpha_and_no_negative_zeros() -> None:
    region = stable_region(gamma=0.0, delta=0.0, delay=0.0)
    for numbers in (region.points, region.corners, region.max_alpha, region.max_beta):
        assert not np.any(np.signbit(numbers) & (numbers == 0.0))
    assert region.max_beta[0] == 0.0
    for gamma in (1e-3, 0.3):
        corners = stable_region(gamma=gamma, delta=0.1, delay=1.5).corners
        np.testing.assert_array_equal(corners[:, 0], -gamma)


def test_regions_and_limits_do_not_import_jax() -> None:
    program = (
        "import sys, numpy as np, jaxstab\n"
        "loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)\n"
        "region = jaxstab.stable_region(gamma=1e-3, delta=0.015, delay=1.5)\n"
        "region.area, region.contains(0.1, [0.2, 0.3]), region.distance(0.1, 0.2)\n"
        "region.alpha_limits(0.3), region.beta_limits(0.1), region.rows_are_intervals\n"
        "loop.limits(), loop.stiffness_limits(np.arange(9.0))\n"
        "loop.boundary_distance(10.0, 1.0), jaxstab.boundary_curve(1.0, **loop.slice)\n"
        "assert 'jax' not in sys.modules\n"
    )
    run([sys.executable, "-c", program], check=True, timeout=60)


@pytest.mark.parametrize(
    "ask",
    [
        lambda delay: jaxstab.verdict(0.1, 0.1, gamma=0.0, delta=0.0, delay=delay),
        lambda delay: jaxstab.margins(0.1, 0.1, gamma=0.0, delta=0.0, delay=delay),
        *(
            pytest.param(ask, marks=pytest.mark.campaign)
            for ask in (
                lambda delay: jaxstab.spectral_radius(0.1, 0.1, gamma=0.0, delta=0.0, delay=delay),
                lambda delay: stable_region(gamma=0.0, delta=0.0, delay=delay),
            )
        ),
        lambda delay: HapticLoop(
            device_mass=0.1, device_damping=0.1, sample_time=1e-3, delay=1e-3 * delay
        ),
    ],
)
def test_delays_have_one_limit(ask: Any) -> None:
    """Above 1,020 samples float64 overflows."""
    assert ask(500.0) is not None
    for delay in (500.5, 5000.0):
        with pytest.raises(ValueError, match="500") as caught:
            ask(delay)
        assert "\n" not in str(caught.value)


@pytest.mark.campaign
def test_the_longest_loop_has_verdicts() -> None:
    """The longest delay and windows; with all poles of filters the degree stays below 1024."""
    modes = [
        jaxstab.Mode(frequency=50.0 + 5.0 * k, damping_ratio=0.1, modal_mass=1.0) for k in range(3)
    ]
    parts = {"device": jaxstab.Device.modes(modes), "sample_time": 1e-3, "delay": 0.4995}
    windows = Velocity.difference(200), Filter.average(200)
    loop = HapticLoop(**parts, velocity=windows[0], position=windows[1])
    assert loop.linear.degree == 706
    assert loop.verdict([1.0, 1e9], [0.01, 1e6]).tolist() == [Verdict.STABLE, Verdict.UNSTABLE]
    poles = Filter.low_pass(100.0, order=40)
    loop = HapticLoop(**parts, velocity=windows[0] * poles, position=windows[1] * poles)
    assert loop.linear.degree < 1024
    assert loop.verdict(1.0, 0.01) in (Verdict.STABLE, Verdict.UNDECIDED)


@pytest.mark.parametrize("mass", [0.1, 1.7])
def test_arrays_of_gains_have_the_limits_of_single_ones_next_to_0(mass: float) -> None:
    """Without damping and delay walls are stable for B > K T/2, but for terms of K T^2/m."""
    loop = HapticLoop(device_mass=mass, device_damping=0.0, sample_time=1e-3)
    low, stiffness = 0.5e-3, np.array([1e-6, 1e-5, 1e-4, 1e-3])
    np.testing.assert_allclose(loop.damping_limits(stiffness)[:, 0], low * stiffness, rtol=1e-7)
    intervals = loop.region().damping_intervals(stiffness)
    np.testing.assert_allclose(intervals[:, 0, 0], low * stiffness, rtol=1e-7)
    for each in stiffness.tolist():
        np.testing.assert_allclose(loop.damping_limits(each)[0], low * each, rtol=1e-7)
    nothing = np.array([0.0])
    assert np.isnan(loop.stiffness_limits(0.0)).all()
    assert np.isnan(loop.stiffness_limits(nothing)).all()
    assert np.isnan(loop.region().stiffness_intervals(nothing)).all()
    tiny = 1e-9  # of a damper allows K up to 2 B/T
    np.testing.assert_allclose(loop.stiffness_limits(np.array([[tiny]])), [[[0.0, tiny / low]]])


@pytest.mark.parametrize("delay", [0.0, 0.4e-3, 1.5e-3])
def test_an_end_that_is_0_is_0_however_it_is_asked_for(delay: float) -> None:
    loop = HapticLoop(
        device_mass=1.23, device_damping=0.0, hand_stiffness=586.3, sample_time=1e-3, delay=delay
    )
    assert loop.damping_limits(0.0)[0] == loop.damping_limits(np.array([0.0]))[0, 0] == 0.0
    assert loop.damping_limits(1e-3)[0] == loop.damping_limits(np.array([1e-3]))[0, 0] > 0.0
