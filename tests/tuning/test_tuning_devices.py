"""The best walls of general devices, against polynomials of certified balls and brute force."""

from typing import Any

import numpy as np
import pytest

from jaxstab import Device, HapticLoop, Velocity
from jaxstab.loop import tune
from jaxstab.results import TuningStatus
from tests.truth import devices, filtered
from tests.truth.descents import radii
from tests.truth.random_loops import device_of

PERIOD = 1e-3
WINDOW = Velocity.difference(samples=5)

ARM = (1.0, 5.0, 300.0, (4.0, 2000.0))  # mass, damping, stiffness, grip
_PLAIN, _FIVE = filtered.difference(1), filtered.difference(5)
CASES: dict[str, tuple[devices.Drawn, dict[str, Any], Any]] = {
    "grip": (devices.Drawn(0.25, 0.1, [], ARM, None, PERIOD, 1.5), {}, _PLAIN),
    "mode and motor": (
        devices.Drawn(0.25, 0.1, [(80.0, 0.02, 0.5)], None, 200.0, PERIOD, 1.0),
        {"velocity": WINDOW},
        _FIVE,
    ),
}


def loop_of(case: str) -> HapticLoop:
    drawn, fields, _ = CASES[case]
    delay = drawn.delay * PERIOD
    return HapticLoop(device=device_of(drawn), sample_time=PERIOD, delay=delay, **fields)


def polynomials(case: str) -> np.ndarray:
    """Return p without a wall, and what 1 N/m and 1 N s/m add."""
    drawn, _, velocity = CASES[case]
    rest = PERIOD, drawn.delay, velocity, filtered.average(1)
    loop = devices.DeviceLoop(drawn.mechanism.system(), *rest).balls()
    base, stiffness, damping = (
        np.array([float(c.mid()) for c in loop.polynomial(*wall)])
        for wall in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
    )
    return np.stack([base, stiffness - base, damping - base])


def walls_inside(loop: HapticLoop, count: int) -> np.ndarray:
    main = loop.region().main
    assert main is not None
    low, high = main.outline.min(axis=0), main.outline.max(axis=0)
    walls = np.random.default_rng(5).uniform(low, high, (count, 2))
    return walls[np.asarray(main.contains(*walls.T))]


@pytest.mark.parametrize("case", CASES)
def test_no_wall_of_the_region_decays_faster(case: str) -> None:
    loop = loop_of(case)
    best = loop.tune("radius")
    truth = polynomials(case)
    reached = radii(truth, np.array([[best.stiffness, best.damping]])).item()
    assert reached == pytest.approx(best.radius, rel=1e-4)
    walls = walls_inside(loop, 4000)
    assert len(walls) > 1000
    assert radii(truth, walls).min() > best.radius - best.radius_error
    near = (
        np.array([best.stiffness, best.damping]) * (1.0 + 0.02 * np.sin(np.arange(200.0)))[:, None]
    )
    assert radii(truth, near).min() > best.radius * (1.0 - 1e-5)


@pytest.mark.parametrize("case", CASES)
def test_the_best_damping_of_a_stiffness_is_that_of_a_scan(case: str) -> None:
    best = loop_of(case).tune("radius", stiffness=300.0)
    assert best.stiffness == 300.0
    dampings = np.linspace(0.0, 60.0, 3001)
    values = radii(polynomials(case), np.stack([np.full(3001, 300.0), dampings], axis=1))
    assert best.radius <= values.min() + 1e-12
    assert best.radius == pytest.approx(values.min(), abs=1e-4)


@pytest.mark.campaign
@pytest.mark.parametrize("excitation", ["force", "impact"])
@pytest.mark.parametrize("case", CASES)
def test_no_wall_of_the_region_settles_much_faster(case: str, excitation: Any) -> None:
    """A wall may settle a little faster that rings on for very long; those are not taken."""
    loop = loop_of(case)
    best = loop.tune("settling", excitation=excitation)
    proved = loop.settling_time(best.stiffness, best.damping, excitation=excitation)
    assert best.settling_time == float(proved.value)
    walls = walls_inside(loop, 400)
    others = np.asarray(loop.settling_time(*walls.T, excitation=excitation).value)
    decays = np.asarray(loop.spectral_radius(*walls.T).value) < 1.0 - (1.0 - best.radius) / 16.0
    assert np.nanmin(others[decays]) >= best.settling_time


def test_both_goals_share_the_search_for_the_smallest_radius(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked, search = [], tune.smallest_radius
    monkeypatch.setattr(
        tune, "smallest_radius", lambda *given: asked.append(given[1]) or search(*given)
    )
    loop = HapticLoop(device_mass=0.251, device_damping=0.1, sample_time=PERIOD, velocity=WINDOW)
    settling, radius = loop.tune("settling"), loop.tune("radius")
    damped = loop.tune("radius", stiffness=radius.stiffness)
    assert settling.settling_time < radius.settling_time
    assert radius.radius <= min(settling.radius, damped.radius) * (1.0 + 1e-9)
    assert asked == [None, loop.alpha(radius.stiffness)]


@pytest.mark.campaign
def test_a_ringing_mode_is_not_taken_for_settled() -> None:
    """On the boundary this device stays within 2 % and rings for ever."""
    loop = loop_of("mode and motor")
    best = loop.tune("settling")
    assert best.status == TuningStatus.SCANNED
    assert np.isfinite(best.settling_time)
    assert best.radius < 1.0 - 1e-5


def test_a_device_that_does_not_give_way_is_refused_in_a_sentence() -> None:
    washed = Device.transfer_function([1.0, 0.0], [1.0, 2.0, 5.0])
    with pytest.raises(ValueError, match="zero DC gain") as caught:
        HapticLoop(device=washed, sample_time=PERIOD).tune()
    assert "\n" not in str(caught.value)


def test_a_device_that_is_stable_in_an_island_alone_is_tuned_there() -> None:
    """As the same mass by its numbers is: walls of the island decay, too (0.560 s before)."""
    window = {"sample_time": 1e-3, "velocity": Velocity.difference(samples=20)}
    device = Device.transfer_function([1.0], [0.25, 0.1, 0.0])
    general = HapticLoop(device=device, **window).tune("settling", stiffness=29_000.0)
    mass = HapticLoop(device_mass=0.25, device_damping=0.1, **window)
    assert general.status == TuningStatus.ISLAND
    assert general.settling_time == mass.tune("settling", stiffness=29_000.0).settling_time == 0.559
