"""Guards of devices with modes, actuators and grips: what a header lets through is stable."""

import re
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaign import many
from commands import run
from mpmath import mp, mpc, mpf
from programs_in_c import STRICT, compiled, rows_of

import jaxstab
import jaxstab.lab.guard.build
from jaxstab import (
    Device,
    Hand,
    HandRange,
    HapticLoop,
    Mode,
    Velocity,
    Verdict,
    build_guard,
)
from jaxstab.boxes import plant
from jaxstab.boxes.enclosures import HAND, THETA, ParameterBoxes
from jaxstab.boxes.plant import (
    _FAST,
    Arms,
    DeviceBoxes,
    Extent,
    FirstRow,
    HeldDevice,
    with_parts,
)
from jaxstab.boxes.search import paved
from jaxstab.lab.guard.guard import Grid, grid_boxes, interpolated
from jaxstab.model.device.parts import balls_of, working_precision
from jaxstab.results import Guard
from tests.truth.devices import DeviceLoop, Mechanism
from tests.truth.devices import mode as true_mode
from tests.truth.filtered import average, difference
from tests.truth.late_energy import late_energy

ROOT = Path(__file__).resolve().parents[3]
PERIOD = 1e-3
MODE = Mode(frequency=80.0, damping_ratio=0.02, modal_mass=0.8)
GRIP = 2000.0, 4.0  # N/m, N s/m
HANDS = HandRange(mass=(0.0, 0.3), stiffness=(0.0, 200.0), damping=(0.5, 4.0))
ARM = Hand.mass_spring_damper(0.1, damping=1.0, stiffness=100.0).with_grip(
    stiffness=GRIP[0], damping=GRIP[1]
)
DEVICE = Device.modes([MODE], mass=0.25, damping=0.5).with_actuator(300.0).held_by(ARM)
WINDOW = Velocity.difference(samples=4)
LOOP = HapticLoop(device=DEVICE, sample_time=PERIOD, delay=1e-3, velocity=WINDOW)
MASSES, DELAYS = (0.245, 0.255), (0.95e-3, 1.05e-3)
BOXES, CALLS, GUARDS = (
    many(100, small=2),
    many(20_000, small=400),
    many(40, small=2),
)  # of the campaign


AXES = "mass", "delay", "damping", *HAND, THETA


def boxes_at(center: np.ndarray, half: np.ndarray) -> ParameterBoxes:
    """Boxes along all axes of a guard."""
    return ParameterBoxes(AXES, center, half, np.zeros(center.shape[1], int))


def with_hand(loop: HapticLoop, mass: float, delay: float, arm: Arms) -> HapticLoop:
    """The loop of another mass, delay and arm, behind the same grip."""
    return replace(loop, device=with_parts(loop.device, mass, arm), delay=delay)


# ---------------------------------------------------------------------------------------- boxes


def drawn_loop(rng: np.random.Generator) -> tuple[HapticLoop, HandRange, Grid]:
    """A loop, its hands and a grid at random; some have light masses, stiff grips or fast modes."""
    mass = 10 ** rng.uniform(-2.0, 0.3)
    modes = [
        Mode(
            frequency=float(rng.choice([rng.uniform(20, 200), rng.uniform(400, 520)])),
            damping_ratio=10 ** rng.uniform(-3, -1),
            modal_mass=mass * rng.uniform(0.5, 5.0) * float(rng.choice([1, 1, 1, -1])) * 2,
        )
        for _ in range(int(rng.integers(0, 3)))
    ]
    damping = float(rng.choice([0.0, rng.uniform(0, 2)]))
    device = Device.modes(modes, mass=mass, damping=damping) if modes else None
    device = device or Device.mass_spring_damper(
        mass, damping=damping, stiffness=float(rng.choice([0.0, 300.0]))
    )
    if rng.random() < 0.5:
        device = device.with_actuator(rng.uniform(30, 800))
    hand = Hand.mass_spring_damper(0.1, damping=1.0, stiffness=100.0)
    is_free = any(mode.modal_mass < 0.0 for mode in modes)  # no hand holds such a device
    hand = Hand.mass_spring_damper() if is_free else hand
    if rng.random() < 0.6:
        hand = hand.with_grip(
            stiffness=10 ** rng.uniform(2, 5), damping=float(rng.choice([0.0, rng.uniform(0, 30)]))
        )
    low, high = np.array([0.0, 0.0, 0.3]), np.array([0.5, 500.0, 8.0])
    ends = np.sort(rng.uniform(low, high, (2, 3)), axis=0) * (not is_free)
    velocity = [None, Velocity.difference(samples=5), Velocity.low_pass(60.0)][rng.integers(3)]
    filters = {
        "velocity": velocity,
        "position": [None, jaxstab.Filter.low_pass(150.0)][rng.integers(2)],
    }
    loop = HapticLoop(device=device.held_by(hand), sample_time=PERIOD, **filters)
    delay = rng.uniform(0.0, 2.5)
    cells = 1, 1, 4
    grid = Grid(
        np.linspace(mass, mass * rng.uniform(1.02, 1.4), cells[0] + 1),
        np.linspace(delay, delay + rng.uniform(0.05, 1.2), cells[1] + 1),
        rng.uniform(0.1, 1.0, (2, 2)) * mass / PERIOD,
        rng.uniform(0.0, 0.3, (2, 2, 5)) * mass / PERIOD**2,
    )
    ranges = dict(zip(("mass", "stiffness", "damping"), map(tuple, ends.T.tolist()), strict=True))
    return loop, HandRange(**ranges), grid


def true_value(loop: HapticLoop, wall: tuple[float, float], theta: float) -> mpc:
    """The polynomial of the loop over that without a wall, by balls and mpmath."""
    parts = loop.linear[:3]
    z = mp.expj(mpf(theta))
    base, stiffness, damping = (
        mp.polyval([mpf(float(c.hi)) + mpf(float(c.lo)) for c in part[::-1]], z, asc=True)
        for part in parts
    )
    alpha, beta = loop.alpha(wall[0]), loop.beta(wall[1])
    return 1 + (alpha * stiffness + beta * damping) / base


def distance_kept(own: HapticLoop, value: complex, theta: float, jitter: float) -> float:
    """How far 1 + G H, a value, has to be from 0 for every sequence of delays (lemma J1)."""
    if not jitter:
        return 0.0
    assert own.device is not None
    with working_precision(256):
        parts = [[float(c.mid()) for c in balls_of(part)][::-1] for part in own.device.compliance()]
    s = 1j * (theta + 2.0 * np.pi * np.arange(-4000, 4001))
    hold = (1.0 - np.exp(-1j * theta)) / s * np.exp(-s * own.delay / PERIOD)
    gain = abs(np.sum(np.polyval(parts[0], s / PERIOD) / np.polyval(parts[1], s / PERIOD) * hold))
    energy = late_energy(*parts, PERIOD, theta, own.delay / PERIOD, jitter)
    return float(np.sqrt(energy) * abs(value - 1.0) / gain * 2.0 * np.sin(0.5 * theta))


def moving_grid(grid: Grid, rng: np.random.Generator) -> Grid:
    """The same walls for a delay that moves from the shortest one on."""
    jitter = float(rng.choice([0.1, 0.4, 1.0, 1.5]))
    return grid._replace(delay=grid.delay[[0, 0]], jitter=jitter)


def assert_boxes_hold(seed: int, boxes: int, *, moves: bool = False) -> tuple[float, int]:
    """Compare boxes with points in them: the largest share of a bound, and how many are free."""
    rng, worst = np.random.default_rng(seed), 0.0
    loop, hands, grid = drawn_loop(rng)
    grid = moving_grid(grid, rng) if moves else grid
    try:
        proof = grid_boxes(loop.device, loop, hands, grid)
    except NotImplementedError:
        return 0.0, 0
    low = np.array([0.0, 0.0, 0.0, *(end for end, _ in vars(hands).values()), 0.0])[:, None]
    high = np.array([1.0, 1.0, 4.0, *(end for _, end in vars(hands).values()), np.pi])[:, None]
    size = 0.5 ** rng.integers(0, 9, (7, boxes))
    size[2] = np.minimum(size[2], 0.25)
    place = np.floor(rng.random((7, boxes)) / size) * size
    place[6, : boxes // 3] = 0.0
    starts, ends = low + (high - low) * place, low + (high - low) * (place + size)
    center, half = 0.5 * (starts + ends), 0.5 * (ends - starts)
    free, _ = proof.judged(boxes_at(center, half))
    device = HeldDevice.from_device(loop.device, PERIOD)
    for box in range(boxes):
        at, by = center[:, box : box + 1], half[:, box : box + 1]
        own_box = boxes_at(at, by)
        is_fast = at[6] + by[6] > _FAST
        models = proof._over(own_box, proof._fast if is_fast else proof._slow)
        is_slow = not is_fast and at[6] <= by[6] and bool(proof._are_slow(own_box)[0])
        for _ in range(3):
            x = rng.choice([-1.0, 1.0, rng.uniform(-1, 1)], 7)
            point = (at + x[:, None] * by)[:, 0]
            point[6] = max(point[6], 1e-6)
            x[6] = (point[6] - at[6, 0]) / by[6, 0]
            mass, delay = (
                float(nodes[0] + share * (nodes[1] - nodes[0]))
                for nodes, share in zip((grid.mass, grid.delay), point, strict=False)
            )
            arm, theta = Arms(*point[3:6].tolist()), float(point[6])
            own = with_hand(loop, mass, delay * PERIOD, arm)
            damping = point[2] / 4 * interpolated(grid.top, point[:2, None])[0]
            alpha = proof._extent(own_box).stiffness  # no less than the limit
            stiffness = float(alpha.centre[0] + alpha.slope[:, 0] @ x) / PERIOD**2
            assert stiffness >= interpolated(grid.limit, point[:3, None])[0] * (1.0 - 1e-12)
            scaled = Arms(arm.mass, arm.stiffness * PERIOD**2, arm.damping * PERIOD)
            below = complex(device.parts(1j * theta, mass, scaled)[1])
            for model, k in zip(models, (0.0, stiffness), strict=True):
                value = complex(true_value(own, (k, float(damping)), theta))
                truth = value * below
                kept = distance_kept(own, value, theta, grid.jitter) * abs(below)
                known = complex(model.centre[0] + model.slope[:, 0] @ x)
                away = abs(truth - known) + kept * (1.0 - 1e-6)
                assert away <= model.rest[0] * (1.0 + 1e-12) + 1e-13 * abs(below)
                assert not is_slow or truth.imag > kept * (1.0 - 1e-6)
                assert not free[box] or abs(truth) > kept * (1.0 - 1e-6)
                worst = max(worst, away / model.rest[0])
    return float(worst), int(free.sum())


def assert_first_rows_hold(seed: int, boxes: int, *, moves: bool = False) -> int:
    """Compare boxes of a first row, whose walls are said to take energy, with loops in them."""
    rng = np.random.default_rng(seed)
    loop, hands, grid = drawn_loop(rng)
    grid = moving_grid(grid, rng) if moves else grid
    grid.limit[:, :, 0] = 0.0
    grid = grid._replace(top=0.2 * grid.top, limit=0.1 * grid.limit)
    try:
        proof = grid_boxes(loop.device, loop, hands, grid)
    except NotImplementedError:
        return 0
    low = np.array([0.0, 0.0, 0.0, *(end for end, _ in vars(hands).values()), 0.0])[:, None]
    high = np.array([1.0, 1.0, 1.0, *(end for _, end in vars(hands).values()), 0.5])[:, None]
    size = 0.5 ** rng.integers(0, 7, (7, boxes))
    size[2] = 1.0
    place = np.floor(rng.random((7, boxes)) / size) * size
    place[6, : boxes // 2] = 0.0
    starts, ends = low + (high - low) * place, low + (high - low) * (place + size)
    center, half = 0.5 * (starts + ends), 0.5 * (ends - starts)
    is_near = center[6] <= half[6]
    rises = np.zeros(boxes, bool)
    boxes_drawn = boxes_at(center, half)
    begins = proof._begin_without_wall(boxes_drawn)
    for which, method in (
        (begins & is_near, proof._grow_slowly),
        (begins & ~is_near, proof._grow),
    ):
        rises[which] = method(boxes_drawn.select(which))[0]
    device, count = HeldDevice.from_device(loop.device, PERIOD), 0
    for box in np.flatnonzero(rises)[:4]:
        for share in (1e-3, 1.0):
            x = rng.choice([-1.0, 1.0, rng.uniform(-1, 1)], 7)
            point = center[:, box] + x * half[:, box]
            point[2], point[6] = share, max(point[6], 1e-4)
            mass, delay = (
                float(nodes[0] + part * (nodes[1] - nodes[0]))
                for nodes, part in zip((grid.mass, grid.delay), point, strict=False)
            )
            arm, theta = Arms(*point[3:6].tolist()), float(point[6])
            own = with_hand(loop, mass, delay * PERIOD, arm)
            damping = point[2] / 4 * interpolated(grid.top, point[:2, None])[0]
            stiffness = float(rng.random() * interpolated(grid.limit, point[:3, None])[0])
            scaled = Arms(arm.mass, arm.stiffness * PERIOD**2, arm.damping * PERIOD)
            above, below = device.parts(1j * theta, mass, scaled)
            value = complex(true_value(own, (stiffness, float(damping)), theta))
            factor = np.conj(complex(above * device.lag(1j * theta))) * complex(below)
            kept = distance_kept(own, value, theta, grid.jitter) * abs(factor)
            assert (value * factor).imag > kept * (1.0 - 1e-6)
            count += 1
    return count


def test_walls_of_a_first_row_take_energy() -> None:
    """Lemma B20, where neither the device nor the hand need be damped, against balls and mpmath."""
    assert sum(assert_first_rows_hold(seed, 200) for seed in range(200, 212)) > 10


FAST = Device.modes([replace(MODE, frequency=1200.0)], mass=0.25, damping=0.5)


@pytest.mark.parametrize("device", [DEVICE, FAST], ids=["actuator and grip", "fast mode"])
def test_what_the_walls_of_a_first_row_add_is_held_by_its_models(
    monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator, device: Device
) -> None:
    """H G conj(N A) D, A of the actuators, per unit of the multiple, by balls and mpmath.

    The aliases of a mode above the sampling rate are followed, even at low frequencies.
    """
    mass, delay, top, limit = (0.24, 0.26), (0.9, 1.1), 50.0, 3000.0
    corners = np.full((2, 2), top), np.broadcast_to([0.0, limit], (2, 2, 2))
    grid = Grid(np.array(mass), np.array(delay), *corners)
    given, rising = [], plant._rising
    monkeypatch.setattr(plant, "_rising", lambda *of: given.append(of[0]) or rising(*of))
    center = rng.uniform([0, 0, 0, 0.0, 0.0, 0.5, 0.1], [1, 1, 1, 0.3, 200.0, 4.0, 0.25], (6, 7)).T
    boxes = boxes_at(center, np.full((7, 6), 1e-6))
    loop = replace(LOOP, device=device)
    grid_boxes(device, loop, HANDS, grid)._grow(boxes)
    (((damper, _), (most, _)),) = given
    held = HeldDevice.from_device(device, PERIOD)
    for box, (heavy, late, _, *arm, theta) in enumerate(center.T.tolist()):
        own_mass, own_delay = mass[0] + 0.02 * heavy, 0.9 + 0.2 * late
        own = with_hand(loop, own_mass, own_delay * PERIOD, Arms(*arm))
        scaled = Arms(arm[0], arm[1] * PERIOD**2, arm[2] * PERIOD)
        above, below = held.parts(1j * theta, own_mass, scaled)
        factor = np.conj(complex(above * held.lag(1j * theta))) * complex(below)
        for model, stiffness in ((damper, 0.0), (most, limit)):
            true = (complex(true_value(own, (stiffness, top), theta)) - 1.0) * factor
            assert abs(complex(model.centre[box]) - true) <= model.rest[box] < 1e-4 * abs(true)


@pytest.mark.parametrize("mass", [0.25, 0.002])
def test_what_aliases_take_from_the_slope_of_slow_boxes_is_nearly_attained(
    monkeypatch: pytest.MonkeyPatch, mass: float
) -> None:
    """|H D R| at the largest angle: R is a sum over aliases, which a quarter of a sample aligns."""
    damping, (top, limit), delay, end = 0.2, (5.0, 300.0), 0.25, 0.02
    device = Device.mass_spring_damper(mass, damping=damping)
    corners = np.full((2, 2), top), np.broadcast_to([0.0, limit], (2, 2, 2))
    grid = Grid(np.array([mass, mass]), np.array([delay, delay]), *corners)
    proof = grid_boxes(device, HapticLoop(device=device, sample_time=PERIOD), HandRange(), grid)
    center, half = np.full((7, 1), 1e-9), np.full((7, 1), 1e-9)
    center[[2, 6]], half[6] = [[1.0], [0.5 * end]], 0.5 * end
    given, rising = [], plant._rising
    monkeypatch.setattr(plant, "_rising", lambda *of: given.append(of[0]) or rising(*of))
    for method in (proof._are_slow, proof._grow_slowly):
        method(boxes_at(center, half))
    turns = np.array([k for k in range(-2000, 2001) if k])
    s, angle = 1j * end, end + 2.0 * np.pi * turns
    of_plant = 1.0 / ((1j * angle) ** 2 * mass + 1j * angle * damping * PERIOD)
    aliases = np.sum(of_plant * np.exp(-2j * np.pi * turns * delay) / angle)
    taken = abs(aliases * (s**2 * mass + s * damping * PERIOD))
    damper = top * PERIOD * (1.0 - np.exp(-s))
    walls = abs(damper), abs(damper + limit * PERIOD**2)
    for rates in given:
        for (_, others), wall in zip(rates, walls, strict=True):
            assert wall * taken <= others[0] <= 2.0 * wall * taken


def test_discs_of_late_forces_are_held_by_boxes() -> None:
    """Lemma J3 against lemma J1, of devices at random: of models, of slow boxes, of first rows."""
    worst = [assert_boxes_hold(seed, 3, moves=True) for seed in range(300, 303)]
    assert sum(count for _, count in worst) > 1
    assert max(share for share, _ in worst) > 0.5
    assert sum(assert_first_rows_hold(seed, 60, moves=True) for seed in range(400, 405)) > 2


@pytest.mark.campaign
def test_many_discs_of_late_forces_are_held_by_boxes() -> None:
    found = [assert_boxes_hold(seed, 20, moves=True) for seed in range(500, 500 + BOXES)]
    assert max(worst for worst, _ in found) > 0.9


def test_boxes_that_hold_a_root_on_the_circle_are_never_free() -> None:
    """Lemma B20 at limits of stability; the slope of F there is no proof away from theta = 0."""
    arm, count = Arms(0.1, 100.0, 1.0), 0
    for seed in range(14):
        loop, hands, grid = drawn_loop(np.random.default_rng(seed))
        if not max(hands.stiffness):  # a device that no arm may hold
            continue
        loop = replace(loop, delay=float(grid.delay[0]) * PERIOD)
        limits = loop.limits()
        wall = limits.stiffness, limits.at_damping
        poles = np.asarray(loop.poles(*wall))
        pole = poles[np.argmin(np.abs(np.abs(poles) - 1.0))]
        assert abs(pole) == pytest.approx(1.0, abs=1e-9)
        mass = grid.mass[0]

        def extent(
            boxes: ParameterBoxes, loop: HapticLoop = loop, wall: Any = wall, mass: float = mass
        ) -> Extent:
            one, own = (
                boxes.constant,
                Arms(arm.mass, arm.stiffness * PERIOD**2, arm.damping * PERIOD),
            )
            walls = one(wall[0] * PERIOD**2), one(wall[1] * PERIOD)
            delay, theta = one(float(loop.delay_samples)), boxes.along(THETA)
            return Extent(one(mass), delay, Arms(*map(one, own)), *walls, theta)

        proof = DeviceBoxes(loop.device, loop, (mass, mass), (arm.stiffness, arm.damping), extent)
        angle, index = np.full((1, 12), abs(np.angle(pole))), np.zeros(12, int)
        narrow = 0.5 ** np.arange(3.0, 15.0)[None]
        at_root = ParameterBoxes((THETA,), angle, narrow, index)
        assert not proof.judged(at_root)[0].any()
        beside = replace(at_root, center=np.clip(angle + 0.05, 0.0, np.pi))  # the narrow ones are
        count += int(proof.judged(beside)[0].sum())
    assert count > 60


@pytest.mark.parametrize(
    ("share", "is_free"), [(0.5, True), (0.99, True), (1.01, False), (1.5, False)]
)
def test_a_stiffness_that_pushes_the_encoder_away_is_free_below_the_root_at_1(
    share: float, is_free: bool
) -> None:
    """Lemma B20 at theta = 0, N(0) < 0: motor and encoder on either side of the handle."""
    arm, mass, damping = Arms(0.1, 1000.0, 30.0), 0.3, 1.0
    mode = Mode(
        frequency=10.0, damping_ratio=1.0, modal_mass=0.05, motor=1.0, encoder=-1.0, handle=0.0
    )
    device = Device.modes([mode], mass=mass, damping=1.0)
    loop = HapticLoop(device=with_parts(device, mass, arm), sample_time=PERIOD)
    limit = arm.stiffness / (arm.stiffness / (0.05 * (20.0 * np.pi) ** 2) - 1.0)
    assert loop.stiffness_intervals(damping).intervals[0].high.value == pytest.approx(limit)

    seen: list[Any] = []

    def extent(boxes: ParameterBoxes) -> Extent:
        middle, by = boxes.ends(THETA)
        seen.extend(zip(middle - by, middle + by, strict=True))
        one = boxes.constant
        in_samples = Arms(*map(one, (arm.mass, arm.stiffness * PERIOD**2, arm.damping * PERIOD)))
        gains = one(share * limit * PERIOD**2), one(damping * PERIOD)
        return Extent(one(mass), one(0.0), in_samples, *gains, boxes.along(THETA))

    def walls(boxes: ParameterBoxes) -> Any:
        raise NotImplementedError

    never = FirstRow(lambda boxes: np.zeros(boxes.index.size, bool), walls)
    boxes = DeviceBoxes(loop.held_device, loop, (mass, mass), (1000.0, 30.0), extent, never)
    assert (paved(boxes.judged, 1, 2.0**-16).boxes.index.size == 0) == is_free
    ends = np.array(sorted({*seen}))
    until = np.maximum.accumulate(ends[:, 1])
    assert ends[0, 0] < 0.0 < np.pi < until[-1]
    assert np.all(ends[1:, 0] < until[:-1] - 1e-14)  # no angle is left between two boxes


def test_a_wide_delay_is_halved_before_what_is_narrow() -> None:
    """Ten samples may turn the force by any angle: then halving all else would never end."""
    top, limit = np.array([[10.0, 2.0], [45.0, 106.0]]), np.full((2, 2, 17), 5000.0)
    grid = Grid(np.array([0.05, 2.0]), np.array([0.2, 10.0]), top, limit)
    center = np.array([0.003, 0.5, 8.0, 0.5, 500.0, 8.0, 0.368])[:, None]
    half = np.array([1e-9, 0.5, 8.0, 3e-8, 4e-3, 1e-5, 1e-8])[:, None]
    free, shares = grid_boxes(LOOP.device, LOOP, HANDS, grid).judged(boxes_at(center, half))
    assert not free.any()
    assert shares[:, 0].argmax() == 1


@pytest.mark.campaign
def test_boxes_hold_the_values_of_their_loops() -> None:
    """Of devices at random, delays over whole samples among them, against balls and mpmath."""
    found = [assert_boxes_hold(seed, 5) for seed in range(6)]
    assert sum(count for _, count in found) > 5


@pytest.mark.campaign
def test_many_boxes_hold_the_values_of_their_loops() -> None:
    found = [assert_boxes_hold(seed, 20) for seed in range(100, 100 + BOXES)]
    assert max(worst for worst, _ in found) > 0.3


# ---------------------------------------------------------------------------------------- guards


@pytest.fixture(scope="module")
def guard() -> Guard:
    return build_guard(LOOP, HANDS, mass=MASSES, delay=DELAYS, cells=(1, 1, 8), constant_delay=True)


@pytest.fixture(scope="module")
def program(guard: Guard, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("guard_of_device")
    (folder / "test_guard.h").write_text(guard.header("test_guard"))
    source = ROOT / "tests" / "guard.c"
    return compiled(source, folder, ["-O2", "-D_POSIX_C_SOURCE=200809L", f"-I{folder}", *STRICT])


def arms_of(hands: HandRange, rng: np.random.Generator, count: int) -> list[Arms]:
    """Arms at random, some of whose numbers are at an end of their range."""
    share = rng.choice([0.0, 1.0, np.nan], (count, 3))
    share = np.where(np.isnan(share), rng.random((count, 3)), share)
    low, high = np.array(list(vars(hands).values())).T
    return [Arms(*one) for one in (low + (high - low) * share).tolist()]


def codes_of(guard: Guard, rows: np.ndarray, seed: int) -> list[int]:
    """Certified verdicts on what calls of C let through, of an arm at random each."""
    arms = arms_of(guard.hands, np.random.default_rng(seed), len(rows))
    return [
        int(with_hand(guard.loop, mass, delay, arm).verdict(max(k, 1e-3), b))
        for (mass, delay, k, b), arm in zip(rows[:, 2:6].tolist(), arms, strict=True)
    ]


def test_what_the_header_lets_through_is_stable(guard: Guard, program: Path) -> None:
    rows = rows_of(program, 100, 1)
    assert set(codes_of(guard, rows, 1)) == {Verdict.STABLE}


@pytest.mark.campaign
def test_what_the_header_lets_through_is_stable_in_many_calls(guard: Guard, program: Path) -> None:
    rows = rows_of(program, CALLS, 2)
    assert set(codes_of(guard, rows, 2)) == {Verdict.STABLE}


def test_certified_roots_of_the_equations_of_motion_agree(guard: Guard, program: Path) -> None:
    rows = rows_of(program, 3, 3)
    hands = replace(guard.hands, mass=(0.01, 0.3))  # the equations divide by the mass
    for row, arm in zip(rows, arms_of(hands, np.random.default_rng(3), 3), strict=True):
        _, _, mass, delay, stiffness, damping = row[:6].tolist()
        body = mpf(mass), mpf(DEVICE.mechanism.damping), mpf(0)
        modes = [body, true_mode(MODE.frequency, MODE.damping_ratio, MODE.modal_mass)]
        hand = arm.mass, arm.damping, arm.stiffness, GRIP[::-1]
        system = Mechanism(modes, [hand], [300.0]).system()
        loop = DeviceLoop(system, PERIOD, delay / PERIOD, difference(4), average(1))
        assert loop.code(max(stiffness, 1e-3), damping) == Verdict.STABLE


def test_filters_are_those_of_the_loop() -> None:
    filters = {"velocity": Velocity.low_pass(60.0), "position": jaxstab.Filter.low_pass(200.0)}
    loop = HapticLoop(device=DEVICE, sample_time=PERIOD, **filters)
    hand = HandRange(mass=(0.1, 0.1), stiffness=(50.0, 60.0), damping=(1.0, 1.0))
    guard = build_guard(
        loop, hand, mass=(0.249, 0.251), delay=(1e-3, 1.02e-3), cells=(1, 1, 8), constant_delay=True
    )
    damping = np.linspace(0.05, 0.95, 19) * guard.grid.top.min()
    limits = guard.largest_stiffness(damping, mass=0.25, delay=1e-3)
    rows = np.column_stack([*np.broadcast_arrays(0.0, 0.0, 0.25, 1e-3, limits, damping)])
    assert set(codes_of(guard, rows[limits > 0.0], 4)) == {Verdict.STABLE}
    assert (
        0.0
        < limits.max()
        <= guard.exact_stiffness(
            damping[None, None], mass=np.array([0.25]), delay=np.array([1e-3])
        ).max()
    )


@pytest.mark.campaign
def test_it_grants_nine_tenths_of_what_is_stable(guard: Guard) -> None:
    assert 0.9 < guard.granted < 1.0


def test_walls_a_little_beyond_the_exact_limit_are_not_stable(guard: Guard) -> None:
    """The limit that the share is of is a limit: some arm is unstable 2 % above it."""
    place = {"mass": np.array([0.25]), "delay": np.array([1e-3])}
    damping = np.array([5.0, 15.0, 25.0])
    exact = guard.exact_stiffness(damping[None, None], **place)[0, 0]
    arms = [
        Arms(*one)
        for one in np.array(np.meshgrid(*vars(guard.hands).values())).reshape(3, -1).T.tolist()
    ]
    for b, k in zip(damping, exact, strict=True):
        above, below = (
            [int(with_hand(LOOP, 0.25, 1e-3, arm).verdict(share * k, b)) for arm in arms]
            for share in (1.02, 0.97)
        )
        assert set(below) == {Verdict.STABLE}
        assert set(above) != {Verdict.STABLE}


def guard_of(seed: int) -> Guard | None:
    """The guard of a device at random, or None where it is refused in one sentence."""
    loop, hands, grid = drawn_loop(np.random.default_rng(seed))
    mass = float(grid.mass[0]), float(grid.mass[0]) * 1.02
    delay = (float(grid.delay[0]) * PERIOD, (float(grid.delay[0]) + 0.1) * PERIOD)
    try:
        return build_guard(
            loop, hands, mass=mass, delay=delay, cells=(1, 1, 8), constant_delay=True
        )
    except (RuntimeError, NotImplementedError) as refusal:
        words = str(refusal)
    assert re.fullmatch(r"[^\n]*\.", words)
    return None


@pytest.mark.campaign
def test_guards_of_random_devices_let_nothing_unstable_through() -> None:
    """Light masses, stiff grips, modes next to half of the sampling rate; some are refused."""
    guards = {seed: guard_of(seed) for seed in range(GUARDS)}
    built = {seed: guard for seed, guard in guards.items() if guard}
    assert built
    for seed, guard in built.items():
        ends = np.array([guard.grid.mass[[0, -1]], guard.grid.delay[[0, -1]]])
        ends[1] *= PERIOD
        rng = np.random.default_rng(seed)
        places = rng.random((300, 2)) * np.ptp(ends, axis=1) + ends[:, 0]
        damping = rng.random(300) * float(guard.grid.top.max())
        limits = guard.largest_stiffness(damping, mass=places[:, 0], delay=places[:, 1])
        rows = np.column_stack([0.0 * places, places, limits, damping])[limits > 0.0]
        assert set(codes_of(guard, rows, seed)) <= {Verdict.STABLE}, seed


# -------------------------------------------------------------------------------------- refusals


def built(device: Device, hands: HandRange = HANDS, **change: Any) -> Guard:
    loop = HapticLoop(device=device, sample_time=PERIOD, delay=1e-3, **change)
    return build_guard(loop, hands, mass=MASSES, delay=DELAYS, cells=(1, 1, 1), constant_delay=True)


@pytest.mark.parametrize(
    ("device", "words"),
    [
        (Device.transfer_function([1.0], [0.25, 0.1, 0.0]), "no mass that could vary"),
        (Device.modes([MODE]), "no mass that could vary"),
        (DEVICE.held_by(ARM), "in one hand"),
        (replace(DEVICE, hands=()).held_by(Hand.transfer_function([1.0, 5.0], [1.0])), "one hand"),
        (
            replace(DEVICE, hands=()).held_by(
                Hand.mass_spring_damper(0.1, damping=1.0).with_grip(stiffness=0.0, damping=4.0)
            ),
            "a grip with a spring",
        ),
    ],
    ids=["transfer function", "no mass", "two hands", "another hand", "a grip without a spring"],
)
def test_other_devices_are_refused(device: Device, words: str) -> None:
    with pytest.raises(NotImplementedError, match=words):
        built(device)


def test_a_mode_with_a_negative_mass_is_refused_beside_a_hand() -> None:
    mode = Mode(frequency=35.0, damping_ratio=0.05, modal_mass=-8e-4)
    loop = HapticLoop(device=Device.modes([mode], mass=8e-4, damping=2e-3), sample_time=1e-3)
    ranges: dict[str, Any] = {"mass": (7e-4, 8e-4), "delay": (1e-3, 1.1e-3)}
    with pytest.raises(ValueError, match=r"modal_mass is -0\.0008 beside a hand"):
        build_guard(loop, HandRange(damping=(0.0, 0.005)), **ranges)


def test_what_nothing_damps_is_refused() -> None:
    arm = Hand.mass_spring_damper(0.1).with_grip(stiffness=2000.0)
    device = Device.mass_spring_damper(0.25, damping=0.5).held_by(arm)
    with pytest.raises(NotImplementedError, match="damp"):
        built(device, HandRange(mass=(0.0, 0.1)))


def test_a_position_filter_without_a_positive_gain_is_refused() -> None:
    for device in (None, DEVICE):
        own = {"device": device} if device else {"device_mass": 0.25, "device_damping": 0.5}
        turned = jaxstab.Filter.transfer_function([-1.0], [1.0])
        loop = HapticLoop(**own, sample_time=PERIOD, position=turned)
        with pytest.raises(ValueError, match="gain"):
            build_guard(loop, HANDS, mass=MASSES, delay=DELAYS, constant_delay=True)


def test_what_is_not_proved_within_the_boxes_is_not_granted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    work = jaxstab.lab.guard.build._OF_DEVICE._replace(most=20_000)
    monkeypatch.setattr(jaxstab.lab.guard.build, "_OF_DEVICE", work)
    guard = build_guard(
        LOOP, HANDS, mass=MASSES, delay=DELAYS, cells=(1, 1, 8), constant_delay=True
    )
    ((first, last),) = guard.rows[0]
    assert 0 < last - first < 8
    damping = np.linspace(0.0, 1.0, 33) * guard.grid.top[0, 0]
    limits = guard.largest_stiffness(damping, mass=MASSES[0], delay=DELAYS[0])
    inside = (np.arange(33) >= 4 * first) & (np.arange(33) <= 4 * last)
    assert not limits[~inside].any()
    assert limits[inside][1:-1].all()
    monkeypatch.setattr(jaxstab.lab.guard.build, "_OF_DEVICE", work._replace(most=1))
    with pytest.raises(RuntimeError, match="no wall was proved stable for every hand"):
        build_guard(LOOP, HANDS, mass=MASSES, delay=DELAYS, cells=(1, 1, 8), constant_delay=True)


def test_a_cell_keeps_its_limit_when_the_next_one_is_lowered_in_vain(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    work = jaxstab.lab.guard.build._OF_DEVICE._replace(most=1000)
    monkeypatch.setattr(jaxstab.lab.guard.build, "_OF_DEVICE", work)
    mode = replace(MODE, damping_ratio=0.01, modal_mass=0.5)
    loop = HapticLoop(device=Device.modes([mode], mass=0.25, damping=0.1), sample_time=PERIOD)
    hands = HandRange(mass=(0.1, 0.3), damping=(2.0, 4.0))
    masses, delays = (0.24, 0.26), (PERIOD, 1.05 * PERIOD)
    guard = build_guard(
        loop, hands, mass=masses, delay=delays, cells=(1, 1, 4), constant_delay=True
    )
    assert guard.rows[0].tolist() == [[0, 2]]  # the last cells of damping are not proved
    damping = 0.5 * guard.grid.top.min()
    limits = [
        with_hand(loop, mass, delay, Arms(moved, 0.0, damper)).stiffness_limits(damping)[1]
        for mass, delay, moved, damper in product(masses, delays, hands.mass, hands.damping)
    ]
    granted = guard.largest_stiffness(damping, mass=np.array(masses)[:, None], delay=delays)
    share = granted / np.reshape(limits, (2, 2, 4)).min(axis=2)
    assert np.all((share > 0.7) & (share < 1.0))


def test_the_command_writes_a_header_of_a_scene_with_modes(tmp_path: Path) -> None:
    scene = tmp_path / "stylus.toml"
    scene.write_text(
        """
        [device]
        mass = 0.25
        damping = 0.5
        actuator.bandwidth = 300.0
        modes = [{frequency = 80.0, damping_ratio = 0.02, modal_mass = 0.8}]
        [hand]
        mass = [0.0, 0.1]
        damping = 1.0
        grip = {stiffness = 2000.0, damping = 4.0}
        [controller]
        sample_time = 0.001
        delay_samples = 1.0
        velocity.window_samples = 4
        """
    )
    words = ["--mass", "0.249:0.251", "--delay", "0.00099:0.00101", "--cells", "1,1,8"]
    answer = run("guard", scene, "-o", tmp_path / "stylus.h", *words)
    assert answer.exit_code == 0, answer.output
    assert "stylus_clamp" in (tmp_path / "stylus.h").read_text()
    assert float(answer.output.split("It grants ")[1].split(" %")[0]) > 90.0
    assert "mode 1: 80 Hz" in answer.output
    assert "grip: 2000 N/m, 4 N s/m" in answer.output
