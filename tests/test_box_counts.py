"""How many boxes proofs take: what is cut badly is still proved, but of more boxes.

The bounds are 1 or 2 % above what is needed. A proof of clearly fewer boxes may have lost a part of
what it has to bound; if it has not, the number here may be lowered.
"""

from collections.abc import Callable
from dataclasses import replace
from math import pi

import numpy as np
import pytest

from jaxstab import (
    Device,
    Filter,
    Hand,
    HandRange,
    HapticLoop,
    Mode,
    Velocity,
    Verdict,
    robust_region,
)
from jaxstab.boxes.enclosures import ParameterBoxes
from jaxstab.boxes.plant import DeviceBoxes
from jaxstab.boxes.search import unproved_members
from jaxstab.guard.build import proved
from jaxstab.guard.guard import Grid
from jaxstab.results import RobustStatus

HANDS = HandRange(mass=(0.0, 0.5), stiffness=(0.0, 300.0), damping=(0.0, 5.0))
DAMPED = HandRange(mass=(0.0, 0.3), stiffness=(0.0, 200.0), damping=(0.5, 4.0))
SPRING = HandRange(stiffness=(0.0, 300.0))
GRIP = Hand.mass_spring_damper(0.1).with_grip(stiffness=2000.0, damping=4.0)
WINDOW = {"velocity": Velocity.difference(samples=20)}
SHORT = {"velocity": Velocity.difference(samples=4)}
SMOOTH = {"velocity": Velocity.low_pass(30.0), "position": Filter.low_pass(150.0)}
MODE = Mode(frequency=80.0, damping_ratio=0.02, modal_mass=0.4)
BENT = replace(MODE, frequency=120.0, damping_ratio=0.05, encoder=0.6, handle=0.3)

MASS = Device.mass_spring_damper(0.25, damping=0.5)
MOTOR = Device.modes([MODE], mass=0.25, damping=0.5).with_actuator(300.0)
HELD = MOTOR.held_by(GRIP)
ARM = Device.modes([BENT], mass=0.25, damping=0.5)
OTHER = Device.transfer_function([1.0, 0.2, 3e4], np.polymul([0.25, 0.1, 0.0], [1.0, 20.0, 1e5]))


@pytest.fixture
def boxes(monkeypatch: pytest.MonkeyPatch) -> Callable[[], int]:
    """The number of boxes that were judged so far."""
    counts, judged = [], DeviceBoxes.judged

    def counting(proof: DeviceBoxes, boxes: ParameterBoxes) -> object:
        counts.append(boxes.index.size)
        return judged(proof, boxes)

    monkeypatch.setattr(DeviceBoxes, "judged", counting)
    return lambda: sum(counts)


def loop_of(device: Device, filters: dict, delay: float = 1e-3) -> HapticLoop:
    return HapticLoop(device=device, sample_time=1e-3, delay=delay, **filters)


@pytest.mark.parametrize(
    ("loop", "hands", "ranges", "wall", "most"),
    [
        (loop_of(MASS, {}), HANDS, {}, (35_800.0, 106.0), 73),
        (loop_of(MASS, {}, 10e-3), HANDS, {}, (1_035.0, 19.6), 115),
        (loop_of(MASS, {}), HANDS, {"mass": (0.2, 0.3)}, (28_700.0, 84.7), 111),
        (loop_of(MASS, {}), HANDS, {"delay": (0.5e-3, 1.5e-3)}, (22_500.0, 86.0), 131),
        (loop_of(MASS, {}), HANDS, {"delays": (0.5e-3, 1e-3)}, (33_000.0, 106.0), 163),
        (loop_of(MASS, WINDOW), HANDS, {}, (1_820.0, 12.3), 63),
        (loop_of(MASS, SMOOTH), HANDS, {}, (5_970.0, 57.7), 59),
        (loop_of(MASS.held_by(GRIP), WINDOW), HANDS, {}, (1_860.0, 12.3), 650),
        (loop_of(MOTOR, SHORT), DAMPED, {}, (3_240.0, 6.3), 295),
        (loop_of(HELD, SHORT), DAMPED, {}, (3_210.0, 6.3), 833),
        (loop_of(HELD, SHORT), DAMPED, {"delays": (0.8e-3, 1e-3)}, (2_900.0, 6.3), 800),
        (loop_of(ARM.held_by(GRIP), SHORT), DAMPED, {}, (14_800.0, 43.8), 1_208),
        (loop_of(OTHER.held_by(GRIP), {}), HANDS, {}, (29_000.0, 92.6), 1_639),
    ],
)
def test_a_wall_next_to_its_limit_takes_few_boxes_for_all_hands(
    boxes: Callable[[], int],
    loop: HapticLoop,
    hands: HandRange,
    ranges: dict,
    wall: tuple[float, float],
    most: int,
) -> None:
    assert loop.worst_hand(hands, *wall, **ranges).verdict == Verdict.STABLE
    assert 0.93 * most < boxes() <= most


@pytest.mark.parametrize(
    ("loop", "hands", "jitter", "top", "most"),
    [
        (loop_of(MASS, {}), SPRING, 0.0, (8_000.0, 40.0), 32),
        (loop_of(MASS, {}), HANDS, 0.0, (8_000.0, 40.0), 124),
        (loop_of(MASS, {}), HANDS, 0.2, (8_000.0, 40.0), 128),
        (loop_of(MASS, SHORT), DAMPED, 0.2, (3_000.0, 40.0), 68),
        (loop_of(MASS, SMOOTH), DAMPED, 0.2, (3_000.0, 40.0), 86),
        (loop_of(MOTOR, {}), DAMPED, 0.1, (2_000.0, 10.0), 304),
        (loop_of(HELD, {}), DAMPED, 0.1, (2_000.0, 10.0), 4_569),
        (loop_of(ARM, {}), DAMPED, 0.1, (2_000.0, 10.0), 576),
        (loop_of(ARM.held_by(GRIP), {}), DAMPED, 0.0, (2_000.0, 10.0), 3_276),
    ],
)
def test_cells_of_a_guard_take_few_boxes(
    loop: HapticLoop,
    hands: HandRange,
    jitter: float,
    top: tuple[float, float],
    most: int,
) -> None:
    """Two cells of damping: the first begins without a wall."""
    delay = np.array([0.9, 0.9 if jitter else 1.1])
    limit = np.broadcast_to(np.array([0.0, 1.0, 0.5]) * top[0], (2, 2, 3))
    grid = Grid(np.array([0.24, 0.26]), delay, np.full((2, 2), top[1]), limit, jitter)
    cells, budget = np.ones((1, 1, 2), bool), (10_000, 20_000)
    is_proved, count = proved(loop, hands, grid, cells, budget, lambda _: None, 0)
    assert is_proved.all()
    assert 0.93 * most < count <= most


def test_a_wall_that_cannot_be_proved_is_given_up_soon(boxes: Callable[[], int]) -> None:
    """A free device without stiffness has a root at 1, in a box that is halved 16 times."""
    loop, fixed = loop_of(MASS, {}), ((0.25, 0.25), (1.0, 1.0))
    left = unproved_members(MASS, loop, HandRange(), *fixed, np.array([[0.0, 5.0]]))
    assert len(left) == 1
    assert 35 < boxes() < 40


def test_the_region_of_figure_10_takes_few_hands_and_boxes(boxes: Callable[[], int]) -> None:
    region = robust_region(gamma=(0.0, pi**2 + 0.25), delta=(1.0, 1.0), delay=1.0)
    assert region.status == RobustStatus.PROVED
    assert (len(region.hands), len(region.outline)) == (17, 258)
    assert 10_500 < boxes() < 10_800
