"""Delays that move: proofs for every sequence, against simulations that share no code with them."""

from collections.abc import Iterator
from functools import cache
from itertools import product
from math import inf
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from campaign import first
from jaxtyping import Float64

from benchmarks import jitter as campaign
from jaxstab import Device, Filter, Hand, HandRange, HapticLoop, Mode, Velocity, Verdict
from jaxstab.exact.turns import segments_of
from jaxstab.loop.hands import HandFamily
from jaxstab.loop.jitter import Delays, Jitter
from jaxstab.model.device.parts import working_precision
from jaxstab.model.device.sampling import late_cosines, one_sample
from tests.truth.late_energy import late_energy
from tests.truth.moving import LOST, Moving, growth

T = 1e-3
AT = {"sample_time": T, "delay": 0.5e-3}
LIGHT = {"device_mass": 0.1, "device_damping": 0.05, "sample_time": T}
OMEGA = {"device_mass": 0.25, "device_damping": 0.1, "sample_time": T}
ARM = Hand.mass_spring_damper(mass=1.0, damping=5.0, stiffness=300.0)
FREE = Device.mass_spring_damper(0.25, damping=0.1)
DEVICES = {
    "free mass without a damper": Device.mass_spring_damper(0.25),
    "free mass": FREE,
    "mass on a spring": Device.mass_spring_damper(0.25, damping=0.1, stiffness=40.0),
    "grip and actuator": FREE.with_actuator(200.0).held_by(
        ARM.with_grip(stiffness=2000.0, damping=4.0)
    ),
    "fast actuator": FREE.with_actuator(5000.0),
    "mode": Device.modes([Mode(frequency=80.0, damping_ratio=0.01, modal_mass=0.5)], mass=0.25),
}


def few_and_campaign(*few: str) -> Iterator[Any]:
    """Names of devices: a few, and the others as a campaign."""
    yield from few
    yield from (pytest.param(x, marks=pytest.mark.campaign) for x in DEVICES if x not in few)


TOPPLING = Device.transfer_function([1.0], [0.1, 0.0, -1000.0])


def window(samples: int, delay: float = 0.0) -> HapticLoop:
    return HapticLoop(**OMEGA, delay=delay, velocity=Velocity.difference(samples=samples))


def moving(mass: float, damping: float, samples: int = 1, smoothing: float = 0.0) -> Moving:
    return Moving((1.0,), (mass, damping, 0.0), T, samples, smoothing)


# ------------------------------------------------------------------------------ lemma J1's parts
JITTERS = [(0.0, 1.0), (0.0, 0.4), (0.3, 0.7), (0.8, 0.4), (0.95, 0.1), (1.5, 1.7), (0.25, 3.0)]


def true_response(name: str, theta: float, delay: float, jitter: float) -> float:
    parts = _floats(DEVICES[name], True), _floats(DEVICES[name])
    return late_energy(*parts, T, theta, delay, jitter)


@pytest.mark.parametrize(("delay", "jitter_of"), first(JITTERS, 2))
@pytest.mark.parametrize("name", DEVICES)
def test_the_response_to_late_forces_is_that_of_the_device_in_continuous_time(
    name: str, delay: float, jitter_of: float
) -> None:
    with working_precision(256):
        late = late_cosines(DEVICES[name], T, delay, jitter_of)
        device = one_sample(DEVICES[name], T)
    first, *others = (float(c.mid()) for c in late)
    below = [float(c.mid()) for c in device.of_samples(None)[1].coeffs()][::-1]
    for theta in (0.05, 0.5, 1.5, 2.5, 3.1):
        size = abs(np.polyval(below, np.exp(1j * theta))) ** 2
        true = true_response(name, theta, delay, jitter_of) * size
        value = first + 2.0 * sum(c * np.cos(k * theta) for k, c in enumerate(others, start=1))
        assert value == pytest.approx(true, rel=1e-6, abs=1e-13 * abs(first))


def _floats(device: Device, is_above: bool = False) -> list[float]:
    from jaxstab.model.device.parts import balls_of, working_precision

    with working_precision(256):
        part = device.compliance()[0 if is_above else 1]
        return [float(ball.mid()) for ball in balls_of(part)][::-1]


def test_at_each_time_of_a_sample_few_changes_are_late() -> None:
    random = np.random.default_rng(1)
    parts, samples = 40, 60
    for _ in range(30):
        most = int(random.integers(0, 5 * parts))
        force = np.cumsum(random.standard_normal(samples))
        delays = random.integers(0, most + 1, samples) if most else np.zeros(samples, int)
        if random.random() < 0.5:  # the worst: always the oldest, forces that grow alike
            delays[:], force = most, np.arange(1.0, samples + 1.0)
        changes = np.sum(np.diff(force, prepend=0.0) ** 2)
        energies = np.zeros(parts)
        for now in range(samples * parts):
            arrived = np.flatnonzero(np.arange(samples) * parts + delays <= now)
            late = force[arrived[-1]] if arrived.size else 0.0
            energies[now % parts] += (late - force[now // parts]) ** 2
        late_changes = most // parts + (np.arange(parts) < most % parts)
        assert np.all(energies <= late_changes**2 * changes * (1.0 + 1e-9))
        if most and np.all(delays == most):
            assert np.all(energies >= 0.6 * late_changes**2 * (samples - 5))


@pytest.mark.parametrize("name", [*few_and_campaign("mode")])
def test_walls_are_proved_as_far_as_the_inequality_of_the_held_device_holds(name: str) -> None:
    """The device in continuous time, by its aliases; V and P as they are defined."""
    delay, most = 0.3, 0.7
    low_passes = Filter.low_pass(200.0), Filter.low_pass(300.0)
    loop = HapticLoop(
        device=DEVICES[name],
        sample_time=T,
        delay=delay * T,
        velocity=Velocity.difference(samples=5) * low_passes[0],
        position=low_passes[1],
    )
    parts = above, below = _floats(DEVICES[name], True), _floats(DEVICES[name])
    q, p = (np.exp(-2.0 * np.pi * cutoff * T) for cutoff in (200.0, 300.0))
    energy = cache(lambda angle: late_energy(*parts, T, angle, delay, most, turns=100))

    def shares(theta: Float64[np.ndarray, " angle"], wall: tuple[float, float]) -> np.ndarray:
        """The left-hand side of the inequality over the right-hand side."""
        z = np.exp(1j * theta)
        s = 1j * (theta[:, None] + 2.0 * np.pi * np.arange(-200, 201)) / T
        hold = (1.0 - np.exp(-s * T)) / (s * T) * np.exp(-s * delay * T)
        response = np.sum(np.polyval(above, s) / np.polyval(below, s) * hold, axis=1)
        velocity = (1.0 - z**-5) / (5 * T) * (1.0 - q) * z / (z - q)
        controller = wall[0] * (1.0 - p) * z / (z - p) + wall[1] * velocity
        late = np.array([*map(energy, theta.tolist())])
        loss = late * np.abs((z - 1.0) * controller) ** 2
        return loss / np.abs(1.0 + response * controller) ** 2

    limits, found = loop.limits(), set()
    for share in (0.1, 0.5, 0.8, 0.95):
        wall = share * limits.stiffness, 0.8 * limits.at_damping
        theta, step = np.geomspace(1e-3, np.pi, 80), 0.06
        for _ in range(3):
            values = shares(theta, wall)
            worst, at = np.max(values), float(theta[np.argmax(values)])
            theta, step = at * (1.0 + step * np.linspace(-1.0, 1.0, 21)), 0.1 * step
        if loop.verdict(*wall) == Verdict.STABLE and abs(worst - 1.0) > 0.03:
            moving = Jitter.from_loop(loop, (delay * T, (delay + most) * T))
            assert moving.is_proved(*wall) == (worst < 1.0), (share, worst)
            found.add(worst < 1.0)
    assert True in found


# -------------------------------------------------------------------------- verdicts, from outside
@pytest.mark.campaign
@pytest.mark.parametrize(
    ("loop", "truth", "delays", "walls"),
    [
        (HapticLoop(**LIGHT), moving(0.1, 0.05), (0.0, 1.0), [(5900.0, 10.0), (13700.0, 40.0)]),
        (HapticLoop(**LIGHT), moving(0.1, 0.05), (0.0, 0.375), [(10300.0, 10.0), (23000.0, 80.0)]),
        (window(20), moving(0.25, 0.1, 20), (0.75, 1.25), [(1450.0, 5.0), (1835.0, 12.8)]),
        (window(5), moving(0.25, 0.1, 5), (0.875, 1.25), [(8900.0, 50.0), (3400.0, 86.0)]),
        (window(20), moving(0.25, 0.1, 20), (1.0, 2.0), [(1132.0, 5.0), (1455.0, 12.8)]),
    ],
    ids=["one sample", "a part", "window of 20", "window of 5", "window of 20, one sample"],
)
def test_walls_that_are_proved_survive_attacks(
    loop: HapticLoop, truth: Moving, delays: tuple[float, float], walls: list[tuple[float, float]]
) -> None:
    low, high = (delay * T for delay in delays)
    for wall in walls:
        assert loop.verdict(*wall, delays=(low, high)) == Verdict.STABLE
        random = np.random.default_rng(4)
        ends = round(8 * delays[0]), round(8 * delays[1])
        turns = [random.integers(ends[0], ends[1] + 1, 12) for _ in range(8)]
        turns += [np.where(np.arange(n) < k, *ends) for n in (2, 3, 6, 12) for k in range(1, n)]
        sequences = np.array([np.tile(turn, 1200 // len(turn)) for turn in turns])
        assert np.all(growth(truth.positions(*wall, sequences), 12) < 1.0)


def test_a_wall_that_grows_is_found_proved_and_replayed() -> None:
    loop, wall = HapticLoop(**LIGHT), (6669.1, 71.60)
    assert loop.verdict(*wall, delays=(0.0, T)) == Verdict.UNSTABLE
    worst = loop.worst_delays(*wall, delays=(0.0, T))
    assert worst.is_proved
    assert worst.growth == pytest.approx(1.0091580212, abs=1e-9)
    parts = np.round(8 * np.array(worst.delays) / T).astype(int)
    run = moving(0.1, 0.05).positions(*wall, np.tile(parts, (1, 600)))
    assert growth(run, len(parts))[0] == pytest.approx(worst.growth, abs=1e-6)
    motion = loop.simulate(*wall, delays=worst.delays, samples=2000, initial_position=1e-3)
    assert np.abs(motion.position).max() > 10.0
    for delay in np.linspace(0.0, T, 5):
        constant = loop.simulate(*wall, delays=[delay], samples=2000, initial_position=1e-3)
        assert np.abs(constant.position[1000:]).max() < 1e-3


@pytest.mark.campaign
@pytest.mark.parametrize("name", ["grip and actuator", "mode"])
def test_limits_of_general_devices_survive_attacks_and_what_is_unstable_grows(name: str) -> None:
    loop = HapticLoop(device=DEVICES[name], velocity=Velocity.difference(samples=4), **AT)
    above, below = tuple(_floats(DEVICES[name], True)), tuple(_floats(DEVICES[name]))
    case = campaign.Case(loop, Moving(above, below, T, 4), 4, 12, 0)
    limits = loop.limits(delays=case.delays)
    wall = limits.stiffness, limits.damping
    assert campaign.attacked(case, wall, np.random.default_rng(7))[0] < 1.0
    wall = 1.05 * limits.unstable_stiffness, limits.damping
    worst = loop.worst_delays(*wall, delays=case.delays)
    assert worst.is_proved
    grown = campaign.replayed(case, wall, worst.delays)
    assert grown == pytest.approx(worst.growth, abs=1e-4)
    assert grown > 1.0


def test_the_stiffest_walls_of_some_dampings_are_proved_and_hardly_stiffer_ones_are_not() -> None:
    for loop, delays in ((window(5, 0.8 * T), (0.8, 1.2)), (HapticLoop(**LIGHT), (0.0, 1.0))):
        moving = Jitter.from_loop(loop, (delays[0] * T, delays[1] * T))
        proved, unstable = moving.stiffest_walls()
        assert len(proved) > 12
        assert all(moving.is_proved(*wall) for wall in proved)
        assert np.mean([moving.is_proved(1.04 * k, b) for k, b in proved]) < 0.1
        assert np.all(moving.verdict(*unstable.T) == Verdict.UNSTABLE)
    none = HapticLoop(device=TOPPLING, sample_time=T, delay=20 * T)
    nothing = Jitter.from_loop(none, (20 * T, 21 * T)).stiffest_walls()
    assert [len(walls) for walls in nothing] == [0, 0]


def test_a_range_of_one_delay_has_the_limits_of_that_delay() -> None:
    loop = HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=T, delay=T)
    exact, moving = loop.limits(), loop.limits(delays=(T, T))
    assert 0.995 * exact.stiffness < moving.stiffness < exact.stiffness < moving.unstable_stiffness


def test_attacks_notice_a_jitter_that_is_too_small(monkeypatch: pytest.MonkeyPatch) -> None:
    case = campaign.Case(HapticLoop(**LIGHT), moving(0.1, 0.05), 0, 8, 0)
    wall = 6669.1, 71.60
    attack = campaign.attacked(case, wall, np.random.default_rng(0))
    assert attack[0] > 1.005
    monkeypatch.setattr(Delays, "jitter", 0.1)
    assert case.loop.verdict(*wall, delays=(0.0, T)) == Verdict.STABLE  # as it must not be


@pytest.mark.campaign
def test_no_proved_wall_grows_and_every_sequence_that_is_found_does(tmp_path: Path) -> None:
    assert campaign.main(small=True, points=None, folder=tmp_path) == 0


def test_the_stiffest_proved_wall_is_proved_and_next_to_one_that_is_not() -> None:
    loop, delays = window(20, 0.8 * T), (0.8 * T, 1.2 * T)
    for other, range_ in ((HapticLoop(**LIGHT), (0.0, T)), (window(5), (0.0, 0.5 * T))):
        found = other.limits(delays=range_)
        assert other.verdict(found.stiffness, found.damping, delays=range_) == Verdict.STABLE
    limits = loop.limits(delays=delays)
    assert loop.verdict(limits.stiffness, limits.damping, delays=delays) == Verdict.STABLE
    assert limits.stiffness == pytest.approx(1883.0, rel=1e-3)  # by a scan of float64
    stiff, damped = 1.002 * limits.stiffness, np.linspace(2.0, 40.0, 60)
    assert not np.any(loop.verdict(stiff, damped, delays=delays) == Verdict.STABLE)
    unstable = loop.verdict(limits.unstable_stiffness, limits.damping, delays=delays)
    assert unstable == Verdict.UNSTABLE
    assert limits.unstable_stiffness < 1.1 * limits.stiffness
    none = HapticLoop(device=TOPPLING, sample_time=T, delay=20 * T)
    assert "no wall was found" in repr(none.limits(delays=(20 * T, 21 * T)))


def test_lost_samples_count_as_delay() -> None:
    loop, wall = window(20, delay=T), (1200.0, 10.0)
    assert loop.verdict(*wall, delays=(T, T), lost=0) == Verdict.STABLE
    assert loop.verdict(*wall, delays=(T, T), lost=1) == Verdict.STABLE
    assert loop.verdict(*wall, delays=(T, T), lost=1) == loop.verdict(*wall, delays=(T, 2 * T))
    stiff = (1700.0, 12.0)
    assert loop.verdict(*stiff, delays=(T, T)) == Verdict.STABLE
    worst = loop.worst_delays(*stiff, delays=(T, T), lost=2)
    assert worst.is_proved
    assert inf in worst.delays
    turn = np.array([LOST if one == inf else 8 for one in worst.delays])
    run = moving(0.25, 0.1, 20).positions(*stiff, np.tile(turn, (1, 4000 // len(turn))))
    assert growth(run, len(turn))[0] == pytest.approx(worst.growth, abs=1e-4)
    assert growth(run, len(turn))[0] > 1.0


def test_constant_delays_are_judged_as_before() -> None:
    random = np.random.default_rng(5)
    for _ in range(6):
        delay = float(random.uniform(0.0, 3.0)) * T
        loop = window(int(random.integers(1, 12)), delay)
        stiffness, damping = random.uniform(0.0, 8000.0, 40), random.uniform(0.0, 60.0, 40)
        moved = loop.verdict(stiffness, damping, delays=(delay, delay))
        assert np.array_equal(moved, loop.verdict(stiffness, damping))


def test_no_wall_is_proved_that_a_constant_delay_of_the_range_makes_unstable() -> None:
    grid = np.meshgrid(np.linspace(0.0, 16000.0, 20), np.linspace(0.5, 100.0, 20))
    codes = HapticLoop(**LIGHT).verdict(*grid, delays=(0.0, T))
    for delay in np.linspace(0.0, T, 7):
        constant = HapticLoop(**LIGHT, delay=delay).verdict(*grid)
        assert not np.any((codes == Verdict.STABLE) & (constant == Verdict.UNSTABLE))
    assert np.count_nonzero(codes == Verdict.STABLE) > 100


# --------------------------------------------------------------------------------------- hands
HANDS = HandRange(mass=(0.0, 0.5), stiffness=(0.0, 300.0), damping=(0.5, 5.0))


@pytest.mark.campaign
def test_a_limit_for_all_hands_is_proved_and_survives_attacks() -> None:
    loop, delays = window(20), (0.75 * T, 1.25 * T)
    limit = loop.robust_limit(HANDS, delays=delays)
    assert limit.is_proved
    assert 0.9 < limit.stiffness / limit.limit < 1.0
    wall, random = (limit.stiffness, limit.damping), np.random.default_rng(9)
    assert loop.worst_hand(HANDS, *wall, delays=delays).verdict == Verdict.STABLE
    turns = np.array([random.integers(6, 11, 12) for _ in range(20)] + [np.tile([6, 10], 6)])
    for corner in product(*vars(HANDS).values()):
        mass, stiffness, damping = corner
        held = Moving((1.0,), (0.25 + mass, 0.1 + damping, stiffness), T, 20)
        assert np.all(growth(held.positions(*wall, np.tile(turns, (1, 200))), 12) < 1.0)
    stiff = loop.worst_hand(HANDS, 1.1 * limit.limit, limit.damping, delays=delays)
    assert stiff.verdict == Verdict.UNSTABLE


def test_a_limit_for_all_hands_is_found_where_constant_delays_allow_much_more() -> None:
    loop, hands = HapticLoop(**LIGHT), HandRange(damping=(0.1, 1.0))
    limit = loop.robust_limit(hands, delays=(0.0, T))
    assert limit.is_proved
    assert 10000.0 < limit.stiffness < loop.limits(delays=(0.0, T)).stiffness * 1.1
    worst = loop.worst_hand(hands, limit.stiffness, limit.damping, delays=(0.0, T))
    assert worst.verdict == Verdict.STABLE


def test_boxes_of_hands_keep_the_distance_of_moving_delays_themselves() -> None:
    """Sampled hands are judged apart, so that only the boxes say what is proved between them."""
    device = Device.mass_spring_damper(0.1, damping=0.05)
    moving, hands = {"delays": (0.0, 0.5 * T), "lost": 3}, HandRange(damping=(0.1, 1.0))
    lowest = HapticLoop(device_mass=0.1, device_damping=0.15, sample_time=T)
    limits = lowest.limits(**moving)
    loops = HandFamily(HapticLoop(sample_time=T, device=device), hands, **moving)
    wall = 1.05 * limits.stiffness, limits.damping
    assert lowest.verdict(*wall) == Verdict.STABLE
    assert lowest.verdict(*wall, **moving) == Verdict.UNDECIDED
    assert len(loops.unproved(wall)) > 0
    assert len(loops.unproved((0.95 * limits.stiffness, limits.damping))) == 0


def test_hands_and_masses_with_lost_samples_need_more_distance() -> None:
    loop, hands = HapticLoop(**LIGHT), HandRange(damping=(0.1, 1.0))
    moving = {"mass": (0.09, 0.11), "delays": (0.0, 0.5 * T)}
    assert loop.worst_hand(hands, 4000.0, 15.0, **moving).verdict == Verdict.STABLE
    assert loop.worst_hand(hands, 4000.0, 15.0, **moving, lost=3).verdict != Verdict.STABLE
    assert loop.worst_hand(hands, 8000.0, 15.0, **moving, lost=3).verdict == Verdict.UNSTABLE
    with pytest.raises(TypeError, match="its lowest and its highest value"):
        loop.worst_hand(HandRange(), 4000.0, 15.0, lost=1)


# ------------------------------------------------------------------------------------- margins
def test_the_margin_is_proved_and_no_larger_than_that_of_a_constant_delay() -> None:
    for loop in (HapticLoop(**LIGHT), window(20, T), HapticLoop(device=DEVICES["mode"], **AT)):
        for wall in ((300.0, 3.0), (900.0, 8.0))[: 1 + (loop.device is None)]:
            margin = float(loop.jitter_margin(*wall))
            low = float(loop.delay)
            assert 0.0 < margin <= float(loop.margins(*wall).extra_delay) * (1.0 + 1e-9)
            proved = loop.verdict(*wall, delays=(low, low + margin * (1.0 - 1e-12)))
            assert proved == Verdict.STABLE
            beyond = loop.verdict(*wall, delays=(low, low + 1.01 * margin))
            assert beyond != Verdict.STABLE


def test_the_margin_of_every_hand_is_proved_and_next_to_that_of_the_worst() -> None:
    loop, hands, masses = HapticLoop(**LIGHT), HandRange(damping=(0.1, 1.0)), (0.09, 0.11)
    margin = loop.jitter_margin([4000.0, 1e6], 15.0, hands=hands, mass=masses)
    assert margin.shape == (2,)
    assert margin[1] == 0.0
    worst = loop.worst_hand(hands, 4000.0, 15.0, mass=masses, delays=(0.0, float(margin[0])))
    assert worst.verdict == Verdict.STABLE
    each = [
        HapticLoop(device_mass=mass, device_damping=0.05 + damping, sample_time=T).jitter_margin(
            4000.0, 15.0
        )
        for mass, damping in product(masses, hands.damping)
    ]
    assert 0.95 * min(each) < margin[0] <= min(each)
    assert loop.jitter_margin(0.0, 0.0, hands=HandRange(stiffness=(1.0, 9.0))) == inf
    with pytest.raises(TypeError, match=r"mass is \(0.09, 0.11\) without hands; give hands="):
        loop.jitter_margin(4000.0, 15.0, mass=masses)


def test_the_margin_of_a_window_of_200_samples_is_found_and_survives_attacks() -> None:
    loop, wall = window(200), (33.0, 0.0)
    margin = float(loop.jitter_margin(*wall))
    assert margin > 2e-3
    late, random = int(8 * margin / T), np.random.default_rng(12)
    turns = [random.integers(0, late + 1, 12) for _ in range(10)]
    turns += [np.where(np.arange(12) % n < 1, 0, late) for n in (2, 3, 4, 6, 12)]
    sequences = np.array([np.tile(turn, 200) for turn in turns])
    assert np.all(growth(moving(0.25, 0.1, 200).positions(*wall, sequences), 12) < 1.0)
    assert loop.verdict(*wall, delays=(0.0, 1.001 * margin)) != Verdict.STABLE


def test_margins_of_walls_that_are_none() -> None:
    spring = HapticLoop(device=Device.mass_spring_damper(0.25, damping=0.5, stiffness=40.0), **AT)
    margins = spring.jitter_margin([0.0, 1e6], [0.0, 1.0])
    assert margins.tolist() == [inf, 0.0]


# ---------------------------------------------------------------------------------- simulations
@pytest.mark.parametrize("options", [{}, {"between": 3}, {"unilateral": True}])
@pytest.mark.parametrize("delay", [0.0, 0.3, 1.0, 1.7])
def test_delays_in_turn_that_are_alike_move_as_a_constant_delay(
    delay: float, options: dict[str, bool | int]
) -> None:
    pushed = {"samples": 200, "initial_velocity": 0.1, "force": 0.5, **options}
    filtered = Velocity.difference(samples=3) * Filter.low_pass(100.0)
    loops = [
        HapticLoop(**LIGHT, delay=delay * T, velocity=filtered),
        HapticLoop(device=DEVICES["grip and actuator"], sample_time=T, delay=delay * T),
    ]
    for loop in loops:
        one = loop.simulate([800.0, 900.0], 5.0, **pushed)
        other = loop.simulate([800.0, 900.0], 5.0, delays=[delay * T] * 3, **pushed)
        for a, b in zip(one, other, strict=True):
            assert np.allclose(a, b, rtol=0.0, atol=1e-11 * np.abs(a).max())


def test_a_simulated_sequence_is_that_of_an_independent_one() -> None:
    random = np.random.default_rng(6)
    parts = random.integers(0, 25, 40)
    parts[[3, 17]] = LOST
    delays = np.where(parts == LOST, inf, parts * (T / 8))
    truth = moving(0.25, 0.1, 4)
    states = truth.positions(700.0, 5.0, np.tile(parts, (1, 5)), seed=1)[0]
    # The same motion as the sum of two that begin with a position and with a velocity.
    loop = window(4)
    given = {"delays": delays, "samples": 200}
    moved = loop.simulate(700.0, 5.0, initial_velocity=1.0, **given).position
    other = _velocity_start(truth, parts)
    assert np.allclose(moved, other, rtol=0.0, atol=1e-10 * np.abs(other).max())
    assert np.abs(states).max() > 0.0


def _velocity_start(truth: Moving, parts: np.ndarray) -> Float64[np.ndarray, " sample"]:
    """The motion from a unit velocity, from two random starts whose positions cancel."""
    wall, sequence = (700.0, 5.0), np.tile(parts, (1, 5))
    runs = [truth.positions(*wall, sequence, seed=seed, rest=True)[0] for seed in (1, 2)]
    mixed = runs[0] / runs[0][0] - runs[1] / runs[1][0]
    return mixed / _first_velocity(mixed)


def _first_velocity(mixed: np.ndarray) -> float:
    decay = 0.1 / 0.25
    return float(mixed[1] * decay / (1.0 - np.exp(-decay * T)))


def test_segments_are_those_of_the_newest_sample() -> None:
    assert segments_of([1.0, 1.0, 1.0, 0.0])[3] == ((0, 0.0, 1.0),)
    assert segments_of([0.5]) == [((1, 0.0, 0.5), (0, 0.5, 1.0))]
    turn = [0.25, 2.75, inf]
    for k, segments in enumerate(segments_of(turn)):
        for age, start, end in segments:
            middle = k + 30 + 0.5 * (start + end)
            arrived = [j for j in range(60) if j + turn[j % 3] <= middle]
            assert max(arrived) == k + 30 - age
        assert segments[0][1] == 0.0
        assert segments[-1][2] == 1.0


# --------------------------------------------------------------------------------------- refusals
@pytest.mark.parametrize(
    ("delays", "lost", "error", "words"),
    [
        ((1e-3, 0.0), 0, ValueError, "the shortest one first"),
        ((-1e-3, 0.0), 0, ValueError, "delays is -0.001"),
        ((0.0, 0.6), 0, ValueError, "500 samples"),
        ((0.0, 0.499), 2, ValueError, "500 samples in all"),
        ((0.0,), 0, TypeError, "its lowest and its highest value"),
        (1e-3, 0, TypeError, "its lowest and its highest value"),
        ((0.0, np.nan), 0, ValueError, "delays is nan"),
        ((0.0, 1e-3), -1, ValueError, "lost is -1"),
        ((0.0, 1e-3), 1.5, TypeError, "lost is 1.5"),
        (None, 1, TypeError, "its lowest and its highest value"),
    ],
)
def test_ranges_that_are_none_are_refused(
    delays: object, lost: object, error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words):
        Jitter.from_loop(window(5), delays, lost)


def test_traced_gains_are_refused() -> None:
    loop, moving_delays = window(5), {"delays": (0.0, 1e-3)}
    for ask in (
        lambda gain: loop.verdict(gain, 1.0, **moving_delays),
        lambda gain: loop.jitter_margin(gain, 1.0),
        lambda gain: loop.simulate(gain, 1.0, force=1.0, delays=[0.0]).position,
    ):
        with pytest.raises(TypeError, match="outside of jit"):
            jax.jit(ask)(100.0)
    made = jax.jit(lambda mass: HapticLoop(**LIGHT | {"device_mass": mass}).jitter_margin(1.0, 1.0))
    with pytest.raises(TypeError, match="the loop is traced; give one of concrete numbers"):
        made(0.1)


@pytest.mark.parametrize("delays", [[], [inf], [-1e-3], [np.nan], [0.6]])
def test_sequences_that_are_none_are_refused(delays: list[float]) -> None:
    with pytest.raises((TypeError, ValueError), match=r"delays? "):
        window(5).simulate(100.0, 1.0, initial_velocity=0.1, delays=delays)
