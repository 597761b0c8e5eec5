"""Walls that are stable in each loop of a list, against certified roots and each loop's region."""

import jax
import numpy as np
import pytest
from matplotlib.path import Path

from benchmarks.truth import devices, filtered
from benchmarks.truth.random_loops import device_of
from jaxstab import HapticLoop, Velocity, common_region
from jaxstab.results import RobustStatus

PERIOD = 1e-3
ARM = (1.0, 5.0, 300.0, (4.0, 2000.0))  # mass, damping, stiffness, grip
DRAWN = [
    devices.Drawn(0.25, 0.1, [], None, None, PERIOD, 1.0),
    devices.Drawn(0.25, 0.1, [], ARM, None, PERIOD, 1.0),
    devices.Drawn(0.25, 0.1, [(80.0, 0.02, 0.5)], None, 400.0, PERIOD, 1.5),
]
LOOPS = [
    HapticLoop(
        device=device_of(drawn),
        sample_time=PERIOD,
        delay=drawn.delay * PERIOD,
        velocity=Velocity.difference(samples=5),
    )
    for drawn in DRAWN
]


@pytest.mark.campaign
def test_every_wall_of_the_polygon_is_stable_in_every_loop(rng: np.random.Generator) -> None:
    common = common_region(LOOPS)
    assert common.status == RobustStatus.PROVED
    middle = common.outline.mean(axis=0)
    walls = common.outline[rng.integers(len(common.outline), size=40)]
    walls = middle + (walls - middle) * np.array([1.0, 0.5] * 20)[:, None]
    rest = filtered.difference(5), filtered.average(1)
    for drawn in DRAWN:
        truth = devices.DeviceLoop(drawn.mechanism.system(), PERIOD, drawn.delay, *rest).balls()
        assert all(truth.is_stable(*map(float, wall)) for wall in walls)
    assert common.contains(*walls.T).all()
    assert common.stiffest.stiffness < min(loop.limits().stiffness for loop in LOOPS)


def test_the_polygon_leaves_out_little_more_than_the_tolerance(rng: np.random.Generator) -> None:
    common = common_region(LOOPS, tolerance=0.01)
    low, high = common.outline.min(axis=0), common.outline.max(axis=0)
    walls = rng.uniform(low - 0.1 * (high - low), high + 0.1 * (high - low), (2000, 2))
    stable = np.all([np.asarray(loop.region().contains(*walls.T)) for loop in LOOPS], axis=0)
    inside = Path(common.outline).contains_points(walls)
    assert not np.any(inside & ~stable)
    assert np.sum(inside) > (1.0 - 5.0 * common.tolerance) * np.sum(stable)
    np.testing.assert_array_equal(common.contains(*walls.T), stable)


def test_the_stiffest_common_wall_has_a_damping_of_at_least_0() -> None:
    """Two damped hands: the polygon is stiffest at B < 0, the answer where it crosses B = 0."""
    loops = [
        HapticLoop(
            device_mass=0.1, device_damping=0.1, hand_damping=damping, hand_stiffness=200.0,
            sample_time=1e-3, delay=1e-3, velocity=Velocity.difference(samples=20),
        )
        for damping in (9.0, 9.5)
    ]  # fmt: skip
    common = common_region(loops)
    stiffness, damping = common.stiffest
    highest = common.outline[np.argmax(common.outline[:, 0])]
    assert highest[0] > stiffness
    assert highest[1] < 0.0
    assert damping == 0.0
    assert stiffness == pytest.approx(min(loop.limits().stiffness for loop in loops), rel=0.03)
    walls = np.linspace(0.0, 2.0 * stiffness, 4001)
    inside = Path(common.outline).contains_points(np.stack([walls, 0.0 * walls], axis=-1))
    assert abs(walls[inside].max() - stiffness) <= 1e-3 * stiffness


def test_one_loop_of_one_mass_has_its_own_region() -> None:
    loop = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3, delay=0.5e-3)
    common = common_region([loop], tolerance=1e-3)
    assert common.status == RobustStatus.PROVED
    assert common.stiffest.stiffness == pytest.approx(loop.limits().stiffness, rel=0.02)


def test_loops_without_a_common_wall_are_told() -> None:
    """Beyond the Nyquist frequency the stiffness must be negative, of a free mass positive."""
    free = HapticLoop(device_mass=1.0, device_damping=0.0, sample_time=1.0)
    stiff = HapticLoop(device_mass=1.0, device_damping=0.0, hand_stiffness=12.0, sample_time=1.0)
    common = common_region([free, stiff])
    assert common.status == RobustStatus.EMPTY
    assert not len(common.outline)
    assert np.isnan(common.stiffest.stiffness)


def test_what_is_no_list_of_loops_is_refused() -> None:
    with pytest.raises(TypeError, match="loops has 3; give a HapticLoop for each"):
        common_region([3])  # type: ignore[list-item]
    with pytest.raises(TypeError, match="loops is 3; give a list of HapticLoop"):
        common_region(3)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="loops is empty"):
        common_region([])
    with pytest.raises(ValueError, match="tolerance"):
        common_region(LOOPS, tolerance=0.5)
    with pytest.raises(TypeError, match="traced"):
        jax.jit(lambda loop: common_region([loop]).tolerance)(
            HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        )
