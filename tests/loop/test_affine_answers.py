"""Margins, tuning, motion, pictures and batches of any two gains, against recursions.

The recursions of ``affine_kinds`` share nothing with p(z): their matrices give poles, polynomials
and growth.
"""

import itertools
from fractions import Fraction

import mpmath
import numpy as np
import pytest
from campaign import first, many, some
from scipy.signal import cont2discrete, lfilter

import jaxstab
from jaxstab import Verdict
from jaxstab.results import RegionStatus, TuningStatus
from tests.truth import recursions
from tests.truth.affine_kinds import KINDS, Case, coupled, is_stable_exactly, judged, judged_regions

OF_GAINS = [kind for kind in KINDS if kind != "wall"]
REST = [kind for kind in OF_GAINS if kind != "kp-ki"]


def drawn(kind: str, count: int, seed: int = 1) -> list[Case]:
    """Loops of which some gains are stable."""
    rng, found = np.random.default_rng([seed, list(KINDS).index(kind)]), []
    while len(found) < count:
        case = KINDS[kind](rng)
        if count > 10 or case.loop.region().components:
            found.append(case)
    return found


def radius(case: Case, *gains: float) -> float:
    return float(np.abs(np.linalg.eigvals(case.matrix(*gains))).max())


def stable_gains(case: Case) -> dict[str, float]:
    """Gains well inside of the stable set."""
    region = case.loop.region().reachable
    middle = region.outline.mean(axis=0)
    inside = [middle, *(0.5 * (middle + point) for point in region.outline[::40])]
    for point in inside:
        pair = [float(x) for x in case.loop._chart.gains(*point)]
        gains = dict(zip(case.gains, pair, strict=True))
        if case.loop.verdict(**gains) == Verdict.STABLE and radius(case, *pair) < 0.9999:
            return gains
    return {}


@pytest.mark.parametrize("kind", first(OF_GAINS, 3))
def test_margins_end_where_recursions_lose_stability(kind: str) -> None:
    ways = {"first_factors": (1, 0), "second_factors": (0, 1), "both_factors": (1, 1)}
    compared = 0
    for case in drawn(kind, 6):
        gains = stable_gains(case)
        if not gains:
            continue
        margins = case.loop.margins(**gains)
        pair = np.array(list(gains.values()))
        assert margins.verdict == Verdict.STABLE
        for name, way in ways.items():
            for factor, beyond in zip(getattr(margins, name), (0.999, 1.001), strict=True):
                if not 0.0 < factor < np.inf:
                    continue
                for side, is_inside in ((1.0 / beyond, True), (beyond, False)):
                    changed = np.where(way, pair * factor * side, pair)
                    found = radius(case, *changed.tolist())
                    if abs(found - 1.0) > 1e-7:
                        assert (found < 1.0) == is_inside, (kind, name, gains)
                        compared += 1
    assert compared > 8


def test_margins_of_a_simulator_are_those_in_closed_form() -> None:
    loop = jaxstab.simulated_pd(0.1, step=2e-3, substeps=4)  # kp < 2 kd/(3 h), kd + kp h/2 < 25
    margins = loop.margins(kp=500.0, kd=10.0)
    assert margins.first == pytest.approx([0.0, 10000.0 / 3.0], abs=1e-9)
    assert margins.second == pytest.approx([1.5, 24.5])
    assert margins.both_factors == pytest.approx([0.0, 25.0 / 10.5])
    grid = loop.margins(kp=[500.0, 1e5], kd=[[10.0], [5.0]])
    assert grid.verdict.shape == (2, 2)
    assert np.all(np.isnan(grid.first[:, 1]))
    assert grid.both_factors[0, 0] == pytest.approx(margins.both_factors)
    assert "and 4 more" in repr(loop.margins(kp=np.linspace(1.0, 900.0, 12), kd=10.0))
    held = jaxstab.simulated_pd(0.1, step=2e-3, damping=0.5, stiffness=20.0)
    assert held.margins(kp=0.0, kd=0.0).first == pytest.approx([-20.0, 99480.0])


@pytest.mark.parametrize("kind", first(OF_GAINS, 3))
def test_no_gains_that_recursions_try_decay_faster_than_the_best(kind: str) -> None:
    rng = np.random.default_rng(2)
    for case in drawn(kind, 2, seed=3):
        best = case.loop.tune()
        if best.status == TuningStatus.NO_STABLE_GAINS:
            continue
        pair = np.array(list(best.gains.values()))
        assert np.all(pair >= 0.0)
        assert radius(case, *pair.tolist()) == pytest.approx(best.radius, abs=2e-3)
        region = case.loop.region().reachable
        low, high = np.maximum([region.outline.min(axis=0), region.outline.max(axis=0)], 0.0)
        for share in rng.uniform(0.0, 1.0, (80, 2)):
            gains = [float(x) for x in case.loop._chart.gains(*(low + share * (high - low)))]
            if min(gains) > 0.0 and region.contains(**dict(zip(case.gains, gains, strict=True))):
                assert radius(case, *gains) > best.radius - 1e-6


def test_tuning_does_not_depend_on_units() -> None:
    """One loop in SI and in units of its own: the same radius, and gains in proportion."""
    found = []
    for environment, period in ((1.0, 1.0), (1e6, 1e-4), (1e5, 1e-5)):
        best = jaxstab.admittance(
            environment, sample_time=period, delay_samples=10, rule="backward",
            stiffness=environment, robot=jaxstab.Filter.average(samples=4),
        ).tune()  # fmt: skip
        gains = best.gains["mass"] / period**2, best.gains["damping"] / period
        found.append((best.radius, *(gain / environment for gain in gains)))
    assert found[1] == pytest.approx(found[0], rel=1e-4)
    assert found[2] == pytest.approx(found[0], rel=1e-4)
    assert found[0][0] < 0.9  # 0.9915 and 0.9990 were reached in SI


def test_tuning_of_a_simulated_joint_is_deadbeat() -> None:
    best = jaxstab.simulated_pd(0.1, step=2e-3).tune()  # a = b = 1: p = z^2
    assert best.gains["kp"] == pytest.approx(25000.0, rel=1e-3)
    assert best.gains["kd"] == pytest.approx(50.0, rel=1e-3)
    assert best.radius < 1e-3


@pytest.mark.parametrize("kind", first(OF_GAINS, 3))
def test_simulations_are_those_of_the_recursion_s_polynomial(kind: str) -> None:
    for case in drawn(kind, 3, seed=5):
        gains = stable_gains(case)
        if not gains:
            continue
        samples = case.loop.simulate(samples=60, **gains)
        unit = np.zeros(60)
        unit[0] = 1.0
        truth = lfilter([1.0], np.poly(case.matrix(*gains.values())).real, unit)
        assert np.allclose(samples, truth, rtol=1e-5, atol=1e-5 * np.abs(truth).max())


@pytest.mark.parametrize("kind", first(OF_GAINS, 3))
def test_motions_settle_where_recursions_do(kind: str) -> None:
    count, compared = 4000, 0
    for case in drawn(kind, 3, seed=5):
        gains = stable_gains(case)
        if not gains or radius(case, *gains.values()) > 0.995:
            continue
        unit = np.zeros(count)
        unit[0] = 1.0
        motion = np.abs(lfilter([1.0], np.poly(case.matrix(*gains.values())).real, unit))
        truth = np.flatnonzero(motion > 0.02 * motion.max())[-1] + 1
        settling = case.loop.settling_time(**gains)
        assert int(settling.status) == 1  # settled, and proved to stay so
        assert abs(round(float(settling.value) / case.loop.sample_time) - truth) <= 1
        compared += 1
    assert compared or kind != "simulator"


def test_walls_and_other_gains_share_their_methods() -> None:
    wall = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
    named = {"stiffness": 1000.0, "damping": 10.0}
    for method in ("spectral_radius", "poles", "oscillation", "frequency_margins"):
        places = getattr(wall, method)(1000.0, 10.0)
        assert str(getattr(wall, method)(**named)) == str(places)
        assert str(getattr(wall, method)(1000.0, damping=10.0)) == str(places)
    assert wall.intervals(damping=20.0) == wall.stiffness_intervals(20.0)
    assert np.array_equal(wall.boundary(), wall.region().outline)
    assert wall.region().contains(**named)
    with pytest.raises(TypeError, match="give both stiffness and damping"):
        wall.poles(1.0, 2.0, 3.0)
    loop = jaxstab.simulated_pd(0.1, step=2e-3)
    with pytest.raises(TypeError, match="one without a name, one without a name; give both kp"):
        loop.spectral_radius(1000.0, 20.0)
    gains = {"kp": 5000.0, "kd": 5.0}  # p = (z - 1)^2 + a z + b (z - 1)
    root = np.roots([1.0, -2.0 + 0.2 + 0.1, 1.0 - 0.1])[0]
    mode = loop.oscillation(**gains)
    assert mode.frequency == pytest.approx(abs(np.angle(root)) / (2.0 * np.pi * 2e-3), rel=1e-12)
    decay = -np.log(abs(root))
    assert mode.damping_ratio == pytest.approx(decay / np.hypot(decay, np.angle(root)), rel=1e-9)


def test_simulations_broadcast_and_are_differentiable() -> None:
    jax = pytest.importorskip("jax")
    loop = jaxstab.simulated_pd(0.1, step=2e-3)
    grid = loop.simulate(samples=30, kp=[[100.0], [1e3]], kd=[5.0, 10.0, 20.0])
    assert grid.shape == (2, 3, 30)
    alone = loop.simulate(samples=30, kp=1e3, kd=20.0)
    assert np.array_equal(grid[1, 2], alone)
    with jax.enable_x64():
        last = jax.jit(lambda kp: loop.simulate(samples=30, kp=kp, kd=20.0)[-1])
        assert last(1e3) == pytest.approx(alone[-1], rel=1e-12)
        slope = jax.grad(last)(1e3)
    sides = [loop.simulate(samples=30, kp=1e3 + step, kd=20.0)[-1] for step in (-1e-2, 1e-2)]
    assert slope == pytest.approx((sides[1] - sides[0]) / 2e-2, rel=1e-6)
    with pytest.raises(ValueError, match="samples is 0"):
        loop.simulate(samples=0, kp=1.0, kd=1.0)


@pytest.mark.parametrize("kind", first(OF_GAINS, 3))
def test_points_of_the_boundary_have_a_pole_on_the_circle(kind: str) -> None:
    for case in drawn(kind, 2, seed=6):
        points = case.loop.boundary()
        finite = points[np.all(np.isfinite(points), axis=1)]
        sizes = np.ptp(np.abs(case.loop.region().outline), axis=0)
        assert len(finite) > 0.9 * len(points) or not len(points)
        for pair in finite[:: max(1, len(finite) // 12)].tolist():
            chart = np.array(case.loop._chart.of_gains(*pair))
            if np.all(np.abs(chart) > 1e-3 * sizes):
                assert radius(case, *pair) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("kind", OF_GAINS)
def test_open_loops_close_to_the_poles_of_the_recursion(kind: str) -> None:
    pytest.importorskip("control")
    for case in drawn(kind, 2, seed=8):
        gains = stable_gains(case)
        if not gains:
            continue
        system = case.loop.to_control(**gains)
        assert system.dt == case.loop.sample_time
        closed = np.abs(system.feedback(1).poles()).max()
        assert closed == pytest.approx(radius(case, *gains.values()), abs=1e-5)


@pytest.mark.parametrize("kind", ["kp-ki", "kp-kd"])
def test_open_loops_of_pid_hold_the_given_gain(kind: str) -> None:
    pytest.importorskip("control")
    for case in drawn(kind, 3, seed=8):
        if not (gains := stable_gains(case)):
            continue
        opened = case.matrix(0.0, 0.0, is_open=True)
        closed = case.matrix(*gains.values())
        for z in np.exp(1j * np.array([0.3, 1.0, 2.5])):
            below, whole = (np.linalg.det(z * np.eye(len(m)) - m) for m in (opened, closed))
            assert case.loop.to_control(**gains)(z) == pytest.approx(whole / below - 1.0, rel=1e-6)


def test_no_loop_is_opened_where_gains_take_the_highest_power() -> None:
    pytest.importorskip("control")
    robot = jaxstab.admittance(1e4, sample_time=1e-3, delay_samples=4)
    with pytest.raises(ValueError, match="mass is 0 and damping is 50, where p"):
        robot.to_control(mass=0.0, damping=50.0)


def test_pictures_say_gains_and_units() -> None:
    device = jaxstab.Device.mass_spring_damper(mass=0.25, damping=0.1)
    held = jaxstab.HapticLoop(device=device, sample_time=1e-3, delay=1e-3)
    panel = jaxstab.pid(held, ki=1e5).plot()
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("kp (N/m)", "kd (N s/m)")
    words = [text.get_text() for text in panel.get_legend().get_texts()]
    assert words == [
        "stable, not connected to zero gains",
        "largest: kp = 36068 N/m at kd = 106.51 N s/m",
    ]
    panel = jaxstab.admittance(1e4, sample_time=1e-3, delay_samples=4).plot()
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("1/mass (1/kg)", "damping/mass (1/s)")


# ------------------------------------------------------------------------------------- many loops
@pytest.mark.campaign
@pytest.mark.parametrize("kind", ["kp-ki", *some(REST, 3)])
def test_limits_of_many_loops_are_those_of_each(kind: str) -> None:
    count = {"simulator": 90, "admittance": 12}.get(kind, 66)  # 64 that the program takes, or none
    loops = [case.loop for case in drawn(kind, count, seed=9)]
    limits = jaxstab.limits_of(loops)
    assert kind == "admittance" or not np.all(limits.is_single)
    for k in range(0, count, 11):
        alone = loops[k].limits()
        assert limits.status[k] == alone.status
        assert limits.is_reachable[k] == alone.is_reachable
        own = limits.first[k], limits.second[k], limits.at_second[k], limits.at_first[k]
        values = alone.first, alone.second, alone.at_second, alone.at_first
        assert own[:2] == pytest.approx(values[:2], rel=1e-9, nan_ok=True)
        assert own[2:] == pytest.approx(values[2:], rel=1e-5, abs=1e-6 * max(own), nan_ok=True)


@pytest.mark.campaign
def test_regions_of_many_loops_are_those_of_each() -> None:
    for kind in ("kp-ki", "admittance"):
        loops = [case.loop for case in drawn(kind, 66, seed=10)]
        regions = jaxstab.regions_of(loops)
        for k in range(0, 66, 15):
            main = loops[k].region().main
            if main is None:
                assert np.isnan(regions.area[k])
                continue
            area = float(main.region.area) * np.prod(main.units)
            assert regions.area[k] == pytest.approx(area, rel=1e-5)
            assert regions.outline[k].max(axis=0) == pytest.approx(
                main.outline.max(axis=0), rel=1e-2
            )


def test_small_gains_are_small_in_both() -> None:
    device = jaxstab.Device.mass_spring_damper(mass=0.15, damping=1.5)
    held = jaxstab.HapticLoop(device=device, sample_time=8e-3, delay=56e-3)
    limits = jaxstab.pid(held, ki=0.5).limits()  # unstable below kp = ki m/b
    assert not limits.is_reachable
    assert limits.first > 0.0


@pytest.mark.campaign
def test_a_batch_leaves_out_islands_of_negative_gains() -> None:
    def joint(inertia: float) -> jaxstab.Loop:
        options = {"integrator": "explicit", "outside": True, "substeps": 3, "delay_steps": 80}
        return jaxstab.simulated_pd(inertia, step=2.87e-3, stiffness=3.95, **options)

    loops = [joint(0.0324 * (1.0 + 1e-4 * k)) for k in range(64)]
    limits = jaxstab.limits_of(loops)
    for k in (0, 30, 63):
        assert np.isnan(limits.first[k]) == np.isnan(loops[k].limits().first)
    assert not np.any(limits.first < 0.0)


@pytest.mark.parametrize("integrator", ["implicit-damping", "implicit"])
@pytest.mark.parametrize("damping", [0.0, 0.5])
def test_gains_of_implicit_engines_have_no_largest_value(integrator: str, damping: float) -> None:
    inertia, step = 0.1, 2e-3
    loop = jaxstab.simulated_pd(inertia, step=step, damping=damping, integrator=integrator)
    region, limits = loop.region(), loop.limits()
    assert (limits.first, limits.second) == (np.inf, np.inf)
    assert limits.is_reachable
    assert repr(limits).splitlines()[1:] == [
        "  largest  kp = unlimited",
        "  largest  kd = unlimited",
        "  islands  none found",
    ]
    for kp, kd in 10.0 ** np.random.default_rng(4).uniform(-2.0, 7.0, (200, 2)):
        bound = (4.0 * inertia + 2.0 * (kd + damping) * step) / step**2  # of kp
        is_stable = integrator == "implicit" or kp < bound
        assert region.contains(kp=kp, kd=kd) == is_stable
        assert (loop.verdict(kp=kp, kd=kd) == Verdict.STABLE) == is_stable
    many = jaxstab.limits_of([loop, jaxstab.simulated_pd(inertia, step=step)])
    assert many.first.tolist() == [np.inf, pytest.approx(1e5)]
    best = loop.tune()
    assert best.status == TuningStatus.ENDLESS
    assert best.gains == {"kp": np.inf, "kd": np.inf}


def test_limits_where_gains_move_the_leading_coefficient_are_those_of_a_grid() -> None:
    rng = np.random.default_rng(5)
    compared = 0
    for _ in range(12):
        degree = int(rng.integers(2, 6))
        sides = rng.uniform(-1.0, 1.0, (3, degree + 1)).round(2)
        sides[:, 0] = [1.0, *rng.uniform(0.1, 1.0, 2)]
        sides[0, 1:] *= 0.3
        names = ("base", "first", "second")
        loop = jaxstab.Loop.from_coefficients(
            **dict(zip(names, sides.tolist(), strict=True)), sample_time=1.0
        )
        region, limits = loop.region(), loop.limits()
        a, b = 10.0 ** rng.uniform(-3.0, 3.0, (2, 400))
        roots = [
            np.roots(sides[0] + x * sides[1] + y * sides[2]) for x, y in zip(a, b, strict=True)
        ]
        stable = np.array([np.abs(own).max() < 1.0 for own in roots])
        assert np.array_equal(region.contains(a=a, b=b), stable)
        if not limits.is_reachable:
            continue
        inside = np.asarray((region.main or region).contains(a=a, b=b))
        pairs = (limits[:2], "b", a), (limits[2:4], "a", b)
        for (limit, at), other, own in pairs:
            assert np.all(own[inside] <= limit * (1.0 + 1e-6))
            compared += 1
            if np.isfinite(limit):
                line = loop.intervals(**{other: at})
                ends = [high.value for _, high in line.intervals]  # none at some corners
                assert not ends or pytest.approx(limit) in ends
    assert compared > 10


@pytest.mark.parametrize(
    ("environment", "period", "late", "rule", "least"),
    first(
        [
            (23389.95501664326, 2e-3, 4, "explicit", (0.11633, 76.68)),  # at the tips of tongues
            (324.915, 5e-4, 4, "forward", (1.0459e-4, 0.0)),  # an edge that ends at damping 0
            (372.978, 5e-4, 15, "backward", (0.0, 0.0)),
        ],
        1,
    ),
)
def test_the_least_gains_beside_a_stiff_virtual_spring_are_those_of_recursions(
    environment: float, period: float, late: int, rule: str, least: tuple[float, float]
) -> None:
    given = {"sample_time": period, "delay_samples": late, "stiffness": 2.0 * environment}
    limits = jaxstab.admittance(environment, rule=rule, **given).limits()
    assert (limits.mass, limits.damping) == pytest.approx(least, rel=3e-4)
    wide, near = 10.0 ** np.linspace(-1.0, 1.5, 60), np.linspace(0.99, 1.01, 60)
    of_mass, of_damping = environment * period**2, environment * period
    corners = [
        (of_mass, of_damping, wide),
        (limits.mass or 1e-6 * of_mass, limits.at_damping, near),
        (limits.at_mass, limits.damping or 1e-6 * of_damping, near),
    ]
    for mass, damping, shares in corners:
        places = np.array([(mass * m, damping * d) for m in shares for d in shares])
        steps = [
            recursions.admittance(m, d, environment=environment, rule=rule, **given)
            for m, d in places
        ]
        stable = places[np.abs(np.linalg.eigvals(np.array(steps))).max(axis=-1) < 1.0]
        assert len(stable) > 20
        assert np.all(stable >= [limits.mass, limits.damping])


def test_undamped_devices_that_differ_by_rounding_have_a_region_of_that_size() -> None:
    """Of k/m = 100 but for the last digit: what moves them both is damped by 5e-15 N/m."""
    bodies = [
        (0.11523382810001558, 0.0, 11.523382810001557),
        (8.975307160618526, 0.0, 897.5307160618526),
    ]
    period, delays, window = 0.0024367275909945875, (8.5, 7.0), 3
    loop = jaxstab.coupling(
        *(jaxstab.Device.mass_spring_damper(m, damping=b, stiffness=k) for m, b, k in bodies),
        sample_time=period,
        delays_samples=delays,
        velocity=jaxstab.Velocity.difference(samples=window),
    )
    region = loop.region()
    for gains, is_stable in (((4e-15, 5e-16), True), ((5.2e-15, 6.1e-16), False)):
        with mpmath.workdps(120):
            matrix = coupled(bodies, delays, period, window, *gains, exact=True)
            assert is_stable_exactly(matrix) is is_stable
        assert bool(region.contains(stiffness=gains[0], damping=gains[1])) is is_stable


def test_ki_and_kd_of_a_free_mass_are_a_triangle_with_the_forward_rule() -> None:
    """p = z (z - 1)^3 + c (z + 1)(kp z (z - 1) + ki T z + kd (z - 1)^2/T), c = T^2/(2 m).

    On the circle ki and kd act in phase: a pair stays there at two angles only, sin^2 of whose
    halves are the roots of 8 x^2 - (4 + 2 c kp) x + 2 c kp.
    """
    mass, period, kp = 0.25, 1e-3, 20_000.0
    device = jaxstab.HapticLoop(device_mass=mass, device_damping=0.0, sample_time=period)
    region = jaxstab.pid(device, kp=kp, rule="forward").region()
    c = period**2 / (2.0 * mass)
    x = np.roots([8.0, -4.0 - 2.0 * c * kp, 2.0 * c * kp])
    on_axis = np.sort(period * (4.0 * x - c * kp) / (2.0 * c))
    apex = 2.0 * kp / period, 2.0 * mass / period
    corners = region.corners[np.lexsort(region.corners.T[::-1])]
    assert corners == pytest.approx(np.array([(0.0, on_axis[0]), (0.0, on_axis[1]), apex]))
    assert region.area == pytest.approx(0.5 * apex[0] * np.ptp(on_axis))
    assert len(region.outline) == 4
    most = (6.0 - 4.0 * np.sqrt(2.0)) / c  # the two angles meet
    few, none = (jaxstab.pid(device, kp=kp, rule="forward").region() for kp in (most - 1, most + 1))
    assert (few.status, none.status) == (RegionStatus.COMPLETE, RegionStatus.EMPTY)


@pytest.mark.parametrize("stiffness", [0.235, 1.5, 40.0])
def test_gains_of_a_spring_by_rk4_are_a_triangle_of_which_one_side_is_next_to_level(
    stiffness: float,
) -> None:
    """p = z^2 - trace z + det: p(1), p(-1) and 1 - det are 0 on the sides, in fractions.

    S(-1) is about 1e-12 of R(-1): along that side kp changes by 1e12 times as much as kd.
    """
    inertia, h = Fraction(0.0168), Fraction(1e-3)
    w, units = Fraction(stiffness) / inertia, ((1, 0, 0), (0, 1, 0), (0, 0, 1))

    def after(q: Fraction, v: Fraction, u: Fraction) -> tuple[Fraction, Fraction]:
        slope, total, state = (Fraction(0), Fraction(0)), [Fraction(0)] * 2, (q, v)
        for share, weight in ((0, 1), (h / 2, 2), (h / 2, 2), (h, 1)):
            state = q + share * slope[0], v + share * slope[1]
            slope = state[1], u / inertia - w * state[0]
            total = [x + weight * y for x, y in zip(total, slope, strict=True)]
        return q + h / 6 * total[0], v + h / 6 * total[1]

    (f00, f10), (f01, f11), (g0, g1) = (after(*map(Fraction, unit)) for unit in units)
    trace = f00 + f11, -g0, -g1  # of 1, kp and kd
    det = f00 * f11 - f01 * f10, f01 * g1 - f11 * g0, f10 * g0 - f00 * g1
    parts = list(zip(units[0], trace, det, strict=True))
    sides = [[one + a * t + b * d for one, t, d in parts] for a, b in ((-1, 1), (1, 1), (0, -1))]
    corners = []
    for (a, b, c), (d, e, f) in itertools.combinations(sides, 2):
        below = b * f - c * e
        corners.append((float((c * d - a * f) / below), float((a * e - b * d) / below)))
    loop = jaxstab.simulated_pd(
        float(inertia), step=float(h), stiffness=stiffness, integrator="rk4", outside=True
    )
    region = loop.region()
    assert region.status == RegionStatus.COMPLETE
    found, truth = (sorted(map(tuple, x), key=lambda x: x[1]) for x in (region.corners, corners))
    assert np.array(found) == pytest.approx(np.array(truth), rel=1e-9, abs=1e-6)
    assert loop.limits().first == pytest.approx(max(kp for kp, _ in corners), rel=1e-12)


@pytest.mark.parametrize("rule", ["backward", "forward", "trapezoid"])
@pytest.mark.parametrize("delay", [0.0, 1.3])
def test_without_kp_only_a_part_of_the_line_of_ki_0_bounds_stable_gains(
    rule: str, delay: float
) -> None:
    """Two roots stay at 1 on that line; beside a part of it both go inside.

    The velocity is the difference over a window of 8.
    """
    device = jaxstab.HapticLoop(
        device_mass=0.25,
        device_damping=0.1,
        sample_time=1e-3,
        delay=delay * 1e-3,
        velocity=jaxstab.Velocity.difference(8),
    )
    region = jaxstab.pid(device, kp=0.0, rule=rule).region()
    assert region.status == RegionStatus.COMPLETE
    on_line = region.corners[region.corners[:, 0] == 0.0]
    assert len(on_line) == 2
    rng, held = np.random.default_rng(8), recursions.HeldMass(0.25, 0.1, 0.0, 1e-3, delay)
    size, low = np.ptp(region.outline, axis=0), region.outline.min(axis=0)
    gains = low + size * rng.uniform(-0.2, 1.2, (150, 2))
    middle, half = on_line[:, 1].mean(), 0.5 * np.ptp(on_line[:, 1])
    rows = middle + half * np.linspace(-1.9, 1.9, 10)
    beside = [(side * 1e-4 * size[0], kd) for side in (-1.0, 1.0) for kd in rows]
    for ki, kd in [*gains, *beside]:
        radius = recursions.radius(
            recursions.pid(0.0, ki, kd, held, period=1e-3, rule=rule, window=8)
        )
        if abs(radius - 1.0) > 1e-7:
            assert bool(region.contains(ki=ki, kd=kd)) is bool(radius < 1.0), (ki, kd)


def test_polygons_may_have_islands() -> None:
    """A mass with a mode, sampled by SciPy, a sample late: eigenvalues tell the stable gains."""
    mass, damping, period, kp = 0.2, 0.5, 1e-3, 200.0
    own, rate = 0.003, 2.0 * np.pi * 60.0
    mode = jaxstab.Mode(frequency=60.0, damping_ratio=0.06, modal_mass=own)
    device = jaxstab.Device.modes(mass=mass, damping=damping, modes=mode)
    held = jaxstab.HapticLoop(device=device, sample_time=period, delay=period)
    region = jaxstab.pid(held, kp=kp, rule="forward").region()
    one, other = [mass, damping, 0.0], [own, 2.0 * 0.06 * rate * own, rate**2 * own]
    (above,), below, _ = cont2discrete(
        (np.polyadd(one, other), np.polymul(one, other)), period, "zoh"
    )
    free = np.polymul(below, [1.0, -1.0, 0.0, 0.0])  # the integrator, the delay, the difference

    def radius(ki: float, kd: float) -> float:
        gains = [kp + kd / period, ki * period - kp - 2.0 * kd / period, kd / period]
        return float(np.abs(np.roots(np.polyadd(free, np.polymul(above, gains)))).max())

    assert len(region.components) == 2
    rng, seen = np.random.default_rng(54), set()
    for component in region.components:
        low, high = component.outline.min(axis=0), component.outline.max(axis=0)
        for ki, kd in rng.uniform(
            1.1 * low - 0.1 * high, 1.1 * high - 0.1 * low, (100, 2)
        ).tolist():
            is_stable = bool(region.contains(ki=ki, kd=kd))
            assert is_stable is (radius(ki, kd) < 1.0)
            seen.add(is_stable)
    assert seen == {True, False}


def test_walls_and_other_loops_are_asked_apart() -> None:
    device = jaxstab.Device.mass_spring_damper(mass=0.25, damping=0.1)
    held = jaxstab.HapticLoop(device=device, sample_time=1e-3)
    with pytest.raises(TypeError, match="give a HapticLoop for each"):
        jaxstab.limits_of([held, jaxstab.simulated_pd(0.1, step=1e-3)])  # type: ignore[list-item]


# --------------------------------------------------------------------------------------- campaign
def test_exact_recursions_know_closed_forms() -> None:
    case = KINDS["simulator"](np.random.default_rng(0))
    device = np.array([[2, -1], [1, 0]], object)  # (z - 1)^2
    assert is_stable_exactly(device) is None
    assert is_stable_exactly(np.array([[0.5, 0.0], [0.0, -0.99]], object)) is True
    assert is_stable_exactly(np.array([[0.5, 0.0], [0.0, -1.01]], object)) is False
    assert case.loop.gains[0].name == "kp"


@pytest.mark.parametrize("kind", KINDS)
def test_verdicts_of_random_gains_are_right(kind: str) -> None:
    counts = judged(kind, 6, 256, exactly=3, seed=12)
    assert counts["wrong"] == 0, counts
    assert counts["by eigenvalues"] > 700


@pytest.mark.campaign
@pytest.mark.parametrize("kind", KINDS)
def test_verdicts_of_many_random_gains_are_right(kind: str) -> None:
    counts = judged(kind, many(500, 15), 256, exactly=6)
    assert counts["wrong"] == 0, counts
    assert counts["by eigenvalues"] > 100 * counts["loops"]


@pytest.mark.campaign
@pytest.mark.parametrize("kind", KINDS)
def test_regions_hold_the_gains_of_which_eigenvalues_are_inside(kind: str) -> None:
    counts = judged_regions(kind, loops := many(1430, 12), 200)
    assert counts["wrong"] == 0, counts
    assert counts["UNRESOLVED"] <= 1 + 0.05 * loops
    assert min(counts["stable"], counts["gains"] - counts["stable"]) > 10 * loops
