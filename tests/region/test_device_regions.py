"""Regions of general devices: against certified verdicts next to their outlines and far away."""

from dataclasses import replace

import numpy as np
import pytest

import benchmarks.loops
import jaxstab
from jaxstab import Device, Filter, Hand, HapticLoop, Mode, Velocity, Verdict
from jaxstab.exact import LineStatus
from jaxstab.exact.boundary import ScaledLoop
from jaxstab.model import LoopParameters, by_name
from jaxstab.model.filters import Filters
from jaxstab.point.verdicts import linear_verdict
from jaxstab.region.region import region_of as region_of_balls
from jaxstab.region.stable_set import RegionStatus, StableRegion
from tests.truth import filtered, random_loops
from tests.truth.random_loops import DeviceLoop, MassLoop

ARM = Hand.mass_spring_damper(mass=1.0, damping=5.0, stiffness=300.0)
MODE = Mode(frequency=80.0, damping_ratio=0.01, modal_mass=0.5)
DEVICES = {
    "a mass": Device.mass_spring_damper(0.25, damping=0.1),
    "a mode": Device.modes([MODE], mass=0.25, damping=0.1),
    "a grip": Device.mass_spring_damper(0.25, damping=0.1).held_by(
        ARM.with_grip(stiffness=2000.0, damping=4.0)
    ),
    "an actuator": Device.mass_spring_damper(0.25, damping=0.1).with_actuator(60.0),
    "all": Device.modes([MODE], mass=0.25)
    .with_actuator(300.0)
    .held_by(ARM.with_grip(stiffness=2e3, damping=4.0)),
    "an unstable device": Device.transfer_function([1.0], [0.25, 0.1, -3.0]),
    "a damper": Device.transfer_function([1.0], [2.0, 0.0]),
}
PERIOD = 1e-3
FILTERS: dict[str, Filters] = {
    "one sample": (Velocity(), Filter()),
    "window": (Velocity.difference(samples=6), Filter()),
    "low passes": (Velocity.low_pass(80.0), Filter.low_pass(300.0)),
}


def loop_of(device: Device, delay: float, filters: Filters) -> LoopParameters:
    given = dict(zip(("velocity", "position"), filters, strict=True))
    return LoopParameters(device=device, sample_time=PERIOD, delay=delay * PERIOD, **given)


def region_of(loop: LoopParameters) -> StableRegion:
    """In the units of the loop."""
    return region_of_balls(ScaledLoop(loop, (loop.stiffness(1.0), loop.damping(1.0))), 1e-6)


def points_around(region: StableRegion, rng: np.random.Generator) -> np.ndarray:
    """Points next to the outline, on either side of it, next to corners, and anywhere."""
    points = []
    for component in region.components:
        vertices, extent = component.points, np.ptp(component.points, axis=0)
        index = rng.integers(0, len(vertices) - 1, 60)
        along = (vertices[index + 1] - vertices[index]) / extent
        across = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]
        away = rng.choice([-1.0, 1.0], 60) * 10.0 ** rng.uniform(-5.0, -2.0, 60)
        middle = 0.5 * (vertices[index] + vertices[index + 1])
        points.append(middle + across * away[:, None] * extent)
        corners = component.corners
        points.append(
            np.repeat(corners, 5, axis=0) + rng.normal(size=(5 * len(corners), 2)) * 1e-4 * extent
        )
    extent = np.ptp(region.points, axis=0)
    points.append(rng.uniform(-1.0, 2.0, (100, 2)) * extent + region.points.min(axis=0))
    return np.concatenate(points)


def assert_region_holds(loop: LoopParameters, region: StableRegion) -> None:
    points = points_around(region, np.random.default_rng(len(region.points)))
    codes = linear_verdict(*points.T, loop.linear)
    inside = region.contains(*points.T)
    assert not np.any((codes == Verdict.STABLE) & ~inside)
    assert not np.any((codes == Verdict.UNSTABLE) & inside)


@pytest.mark.parametrize("delay", [0.0, 1.5])
@pytest.mark.parametrize("filters", FILTERS)
@pytest.mark.parametrize("device", DEVICES)
def test_regions_against_certified_verdicts(device: str, filters: str, delay: float) -> None:
    loop = loop_of(DEVICES[device], delay, FILTERS[filters])
    region = region_of(loop)
    assert region.status == RegionStatus.COMPLETE
    assert_region_holds(loop, region)


@pytest.mark.parametrize("delay", [0.0, 0.3, 4.0])
def test_a_mass_has_the_region_of_five_numbers(delay: float) -> None:
    device = Device.mass_spring_damper(0.25, damping=2.0).held_by(ARM)
    slice_ = 300.0 * PERIOD**2 / 1.25, 7.0 * PERIOD / 1.25, delay
    loop = loop_of(device, delay, FILTERS["one sample"])
    region = region_of_balls(ScaledLoop(loop, (1000.0, 0.5)), 1e-6)  # any units
    expected = jaxstab.stable_region(**by_name(*slice_))
    units = 1000.0 * PERIOD**2 / 1.25, 0.5 * PERIOD / 1.25
    assert float(region.area) * units[0] * units[1] == pytest.approx(float(expected.area), 1e-12)
    for one, other in (
        (region.max_alpha, expected.max_alpha),
        (region.max_beta, expected.max_beta),
    ):
        np.testing.assert_allclose(one * units, other, 1e-6)
    points = expected.corners / units
    assert np.max(np.min(np.hypot(*(region.corners[:, None] - points).T), axis=0)) < 1e-11


def test_a_device_that_a_constant_force_does_not_move_has_no_region() -> None:
    device = Device.transfer_function([1.0, 0.0], [1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match="zero DC gain"):
        region_of(loop_of(device, 0.0, FILTERS["one sample"]))


def test_a_mode_that_walls_hardly_move_cuts_off_a_corner() -> None:
    """Beside it a wall has the radius 1 + 9.9e-13."""
    modes = [
        (6.434856867099245, 0.0, 0.185851300358204),
        (6.8454108056371155, 0.0, 0.00017206764337745456),
        (35.425800263063394, 0.0, -0.35165856556613656),
        (495.96120348419333, 1.3410551101434005e-16, -0.004604768915219972),
    ]
    hand = Hand.mass_spring_damper(mass=0.0013168208326164396, damping=0.0001345506538537253)
    device = replace(  # a hand from encoder to motor, which held_by refuses
        Device.modes([Mode(frequency=f, damping_ratio=zeta, modal_mass=m) for f, zeta, m in modes]),
        hands=(hand.with_grip(stiffness=0.027979514545729837),),
    )
    period = 0.007057003603128702
    loop = HapticLoop(
        device=device,
        sample_time=period,
        delay=1e-9 * period,
        velocity=Velocity.exponential(0.09665424011450707),
    )
    wall = 1.6343307107025126e-06, -1.1664718984884663e-07
    assert loop.verdict(*wall) == Verdict.UNSTABLE
    assert loop.region().status == RegionStatus.COMPLETE
    assert not loop.region().contains(*wall)


@pytest.mark.campaign
@pytest.mark.parametrize("number", [22, 25])
def test_regions_of_modes_that_walls_hardly_move_are_right(number: int) -> None:
    """Beside a corner walls have radii of 1 + 1e-20, and others are stable."""
    rng = np.random.default_rng([20121120, number])
    tally = benchmarks.loops.region(DeviceLoop.hardly_moved(rng), rng)
    assert (tally.wrong, tally.open) == (0, 0)


@pytest.mark.parametrize(
    "number",
    [
        123,
        329,
        *(pytest.param(n, marks=pytest.mark.campaign) for n in (19, 39, 215, 601, 734, 893)),
    ],
)
def test_the_curve_is_followed_while_it_passes_a_mode(number: int) -> None:
    """Within 1e-12 radians it passes all gains. The regions of 123 and 19 lacked stable walls, that
    of 215 held unstable ones, and those of 329 and 39 were EMPTY; that of 893 was known to 1e-9. Of
    601 an edge begins at an angle in float64 and ends at the next one.
    """
    rng = np.random.default_rng([20121120, number])
    tally = benchmarks.loops.region(DeviceLoop.hardly_moved(rng), rng)
    assert (tally.wrong, tally.open) == (0, 0)


def test_arcs_that_rounding_makes_do_not_multiply() -> None:
    """Slow filters: each scan found five times as many arcs as the one before, until memory ended.

    Both sides of the limit are judged by certified roots.
    """
    drawn = DeviceLoop.drawn(np.random.default_rng([20261126, 13021]))
    loop, region = drawn.loop, drawn.loop.region()
    assert region.status == RegionStatus.COMPLETE
    limits = region.limits()
    beta = loop.beta(limits.at_damping)
    for share, is_stable in ((1.0 - 1e-6, True), (1.0 + 1e-6, False)):
        alpha = loop.alpha(share * limits.stiffness)
        assert drawn.balls.is_stable(float(alpha), float(beta)) is is_stable


def test_an_arc_that_is_one_point_is_looked_at_in_balls() -> None:
    """Of an undamped hand and a slow filter: float64 found one arc, at B = -6e6, of no length."""
    cutoff = 0.004512871953230884
    slow = filtered.times(filtered.difference(1), filtered.butterworth(cutoff, order=6))
    velocity = Velocity.difference(samples=1) * Filter.butterworth(cutoff, order=6)
    drawn = MassLoop(
        (5.126865874651953, 0.0, 1.0),
        random_loops.Filters(velocity, Filter(), (slow, filtered.average(1))),
    )
    tally = benchmarks.loops.region(drawn, np.random.default_rng(1))
    assert (tally.wrong, tally.open) == (0, 0)


def test_rows_where_several_roots_leave_the_circle_are_right() -> None:
    """A free device with a mode, neither damped: at K = B = 0 four roots are on the circle."""
    loop = DeviceLoop.drawn(np.random.default_rng([20121120, 1814]))
    beta = np.geomspace(1e-9, 1e-6, 40)
    alpha = np.outer([0.9, 1.1, 1.8], 0.28822 * beta)  # the boundary runs straight there
    beta = np.broadcast_to(beta, alpha.shape)
    truth = [loop.balls.is_stable(*wall) for wall in zip(alpha.ravel(), beta.ravel(), strict=True)]
    assert loop.region().contains(alpha, beta).ravel().tolist() == truth
    assert 0.2 < np.mean(np.array(truth)) < 0.5


def test_a_region_that_is_small_beside_its_units_is_right_at_its_edge() -> None:
    """Of a heavy mode that walls hardly move: float64 has 1e-7 of the region's size left."""
    loop = DeviceLoop.drawn(np.random.default_rng([20121120, 3977]))
    walls = [(5.1340083706774335e-08, -1.6237927167061268e-06)]
    walls += [(2.7555553677657516e-14, -9.225851199260192e-13)]
    truth = [loop.balls.is_stable(*wall) for wall in walls]
    assert loop.region().contains(*np.transpose(walls)).tolist() == truth == [False, True]


@pytest.mark.parametrize("halves", [1.0, 2.0, 3.0])
def test_a_mode_that_swings_between_the_samples_is_refused(halves: float) -> None:
    """One that is damped, or another sample time, is not: its roots are told apart."""
    period = 2.0**-10

    def loop(ratio: float, sample_time: float) -> jaxstab.HapticLoop:
        mode = jaxstab.Mode(frequency=512.0 * halves, damping_ratio=ratio, modal_mass=0.5)
        device = jaxstab.Device.modes([mode], mass=0.2, damping=0.5)
        return jaxstab.HapticLoop(device=device, sample_time=sample_time)

    for ask in (
        lambda own: own.verdict(100.0, 1.0),
        lambda own: own.intervals(damping=1.0),
        lambda own: own.limits(),
    ):
        with pytest.raises(ValueError, match="it swings between the samples, where no gain damps"):
            ask(loop(0.0, period))
    assert loop(0.02, period).intervals(damping=1.0).status == LineStatus.PROVED
    assert loop(0.0, 1.01 * period).intervals(damping=1.0).status == LineStatus.PROVED
