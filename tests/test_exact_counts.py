"""How much work answers in balls take: what asks for too many bits or steps is right, but slow.

Counted are the calls that code of ``jaxstab/exact/`` makes, of its own functions and of flint's.
Hardly any number decides there that was rounded to float64, so the counts are the same on other
machines but for a few. A count that is clearly less may have lost a part of a proof; if it has not,
the number here may be lowered.
"""

import gc
import sys
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from types import FrameType
from typing import Any

import flint
import numpy as np
import pytest

from jaxstab import Device, Filter, Hand, HapticLoop, Mode, Velocity, exact
from jaxstab.exact.boundary import (
    ScaledLoop,
    curve_around,
    curve_parts,
    others_inside,
    root_lines,
    undamped_modes,
)
from jaxstab.exact.circle import zeros
from jaxstab.exact.line import stable_line
from jaxstab.exact.margins import delay_margin, is_passive
from jaxstab.exact.response import disturbed_responses, motion_settled_after, settled_after
from jaxstab.exact.roots import Axis, poles, spectral_radius, stable_over, wall_verdict
from jaxstab.exact.turns import PeriodicLoop, is_growing
from jaxstab.model.balls import Factored, ball_loop, ball_triple
from jaxstab.model.device.parts import decided
from jaxstab.model.device.sampling import one_sample
from jaxstab.model.loop import unit_loop

ROOM = str(Path(exact.__file__).parent)


@cache
def remembering() -> list[Any]:
    """The functions that remember answers in balls."""
    found = (thing for thing in gc.get_objects() if type(thing) is type(remembering))
    rooms = "jaxstab.exact.", "jaxstab.model.device.parts"
    return [thing for thing in found if thing.__module__.startswith(rooms)]


def calls(question: Callable[[], Any]) -> int:
    """How often code of the room calls a function, or flint; nothing is remembered."""
    count = 0
    for function in remembering():
        function.cache_clear()

    def counted(frame: FrameType, event: str, _: Any) -> None:
        nonlocal count
        code = frame.f_code
        # Versions of Python differ in how they enter generators and lists.
        is_call = event == "c_call" or (event == "call" and code.co_name[0] != "<")
        count += is_call and code.co_filename.startswith(ROOM)

    before = sys.getprofile()
    sys.setprofile(counted)
    try:
        question()
    finally:
        sys.setprofile(before)
    return count


def of_loop(**numbers: Any) -> HapticLoop:
    return HapticLoop(device_mass=0.1234, sample_time=1e-3, **numbers)


WINDOW = {"velocity": Velocity.difference(samples=9)}
LONG = {"velocity": Velocity.difference(samples=57), "delay": 2.3e-3}
SLOW = {"velocity": Velocity.low_pass(30.0), "position": Filter.low_pass(150.0, order=2)}
LATE = of_loop(device_damping=0.51, delay=1.3e-3)
FREE = of_loop(device_damping=0.52, **WINDOW)
FILTERED = of_loop(device_damping=0.53, delay=1e-3, **SLOW)
FAR = of_loop(device_damping=0.54, **LONG)
UNDAMPED = of_loop(device_damping=0.0, hand_stiffness=211.0, delay=1e-3)
PEDAL = of_loop(device_damping=0.0, hand_stiffness=213.0, velocity=Velocity.difference(samples=4))
HELD = HapticLoop(
    device=Device.modes(
        [Mode(frequency=81.0, damping_ratio=0.02, modal_mass=0.4)], mass=0.25, damping=0.5
    ).held_by(Hand.mass_spring_damper(0.1, stiffness=300.0, damping=2.0)),
    sample_time=1e-3,
    delay=1.7e-3,
)
STRONG = of_loop(device_damping=2.01, hand_stiffness=501.0, hand_damping=10.1)
CRITICAL = unit_loop(0.0625**2, 0.125, 0.0, None, None)
TURN = [0.3, 2.6, 1.1]  # samples
TWICE = of_loop(device_damping=0.56, hand_stiffness=9.0, velocity=Velocity.low_pass(30.0, order=2))
EQUAL = of_loop(device_damping=0.55, velocity=Velocity.low_pass(30.0, order=4))


def triple_of(loop: HapticLoop) -> partial[Any]:
    return partial(ball_triple, loop)


def margin_of_delay(loop: HapticLoop, wall: tuple[float, float]) -> Any:
    sample = partial(one_sample, loop.held_device, loop.sample_time)
    return delay_margin(partial(ball_loop, loop), sample, float(loop.delay_samples), wall)


def turned(orders: dict[int, float], constant: float = 0.0) -> Callable[[], Any]:
    """The zeros of a constant and of multiples of cos(n theta)."""

    def question() -> Any:
        sums = [flint.arb(orders.get(n, 0.0)) for n in range(max(orders) + 1)]
        sums[0] = sums[0] + constant
        return zeros(sums, is_last_try=flint.ctx.prec >= 512)

    return lambda: decided(question)


def triangle(a: float, b: float) -> Factored:
    """z^2 + a z + b: stable where |a| < 1 + b and |b| < 1."""
    return Factored(flint.arb_poly([b, a, 1]))


def bent(a: float, b: float) -> Factored:
    """The same with 4 (a - 1) (2 - a) + b in place of a: next to the limit in the middle."""
    x = flint.arb(a)
    return Factored(flint.arb_poly([b, 1.4999 * 4 * (x - 1) * (2 - x), 1]))


CASES: dict[str, tuple[Callable[[], Any], int]] = {
    "verdict": (lambda: wall_verdict(triple_of(LATE), 8123.0, 21.0), 10),
    "verdict, long": (lambda: wall_verdict(triple_of(FAR), 130.0, 2.1), 67),
    "verdict of an unstable wall": (lambda: wall_verdict(triple_of(FILTERED), 8125.0, 22.0), 11),
    "radius": (lambda: spectral_radius(triple_of(FREE), 811.0, 5.1), 19),
    "radius of poles that coincide": (lambda: spectral_radius(triple_of(EQUAL), 811.0, 0.0), 671),
    "poles": (lambda: poles(triple_of(FILTERED), 812.0, 5.2), 33),
    "row": (lambda: stable_line(triple_of(LATE), (0.0, 21.0), (1.0, 0.0)), 201),
    "row of a window": (lambda: stable_line(triple_of(FREE), (0.0, 5.1), (1.0, 0.0)), 256),
    "column of a long window": (
        lambda: stable_line(triple_of(FAR), (99.0, 0.0), (0.0, 1.0)),
        1_187,
    ),
    "row of an undamped hand": (lambda: stable_line(triple_of(PEDAL), (0.0, 5.1), (1.0, 0.0)), 178),
    "ray of a device": (lambda: stable_line(triple_of(HELD), (0.0, 0.0), (1.0, 0.01)), 244),
    "zeros": (turned({7: 1.0}, 0.25), 97),
    "zeros of degree 36": (turned({36: 1.0}, 0.25), 385),
    "many zeros": (turned({37: 1.0, 3: 0.2}, 0.25), 10_158),
    "zeros that nearly coincide": (turned({5: 1.0}, -1.0 + 2.0**-50), 109),
    "double zeros": (turned({2: 1.0}, 1.0), 7_019),
    "triple zeros": (turned({3: 0.75, 9: 0.25}), 14_273),
    "margin of the delay": (lambda: margin_of_delay(LATE, (3123.0, 11.0)), 5_778),
    "margin of the delay of a window": (lambda: margin_of_delay(FREE, (512.0, 5.0)), 7_014),
    "margin of the delay of a device": (lambda: margin_of_delay(HELD, (513.0, 1.1)), 5_980),
    "any delay": (lambda: margin_of_delay(STRONG, (5.1, 0.01)), 520),
    "small gain": (lambda: LATE.verdict(1001.0, 11.0, delays=(0.0, 1.1e-3)), 62),
    "jitter": (lambda: FREE.jitter_margin(101.0, 5.3), 3_000),
    "worst delays": (lambda: LATE.worst_delays(5901.0, 24.0, delays=(0.0, 1.9e-3)), 3_669),
    "turns": (lambda: is_growing(PeriodicLoop.from_loop(LATE, 4123.0, 13.0), TURN), 73),
    "passivity": (lambda: is_passive(0.31, 0.12, 0.57, 1.3), 44),
    "frequency": (lambda: FILTERED.frequency_margins(301.0, 4.1), 7_052),
    "frequency of a device": (lambda: HELD.frequency_margins(301.0, 1.1), 12_050),
    "amplitude": (lambda: disturbed_responses(LATE, 812.0, 11.0, (True, True, True)), 295),
    "amplitude of poles that coincide": (
        lambda: disturbed_responses(EQUAL, 99.0, 0.0, (True, False, True)),
        138,
    ),
    "amplitude of poles that nearly coincide": (
        lambda: disturbed_responses(TWICE, 0.0, 3e-37, (True, False, False)),
        228,
    ),
    "amplitude of an unstable wall": (
        lambda: disturbed_responses(LATE, 8125.0, 22.0, (True, False, False)),
        137,
    ),
    "settling": (lambda: settled_after(FILTERED, 303.0, 4.2, "force", 0.02, 5000), 134),
    "settling of a device": (lambda: settled_after(HELD, 304.0, 1.2, "impact", 0.02, 5000), 146),
    "settling of poles that coincide": (
        lambda: settled_after(CRITICAL, 0.0, 0.0, "force", 0.02, 1000),
        220,
    ),
    "motion of two gains": (
        lambda: motion_settled_after(triple_of(FREE), 305.0, 4.4, 0.01, 5000),
        159,
    ),
    "rectangle": (lambda: stable_over(triangle, Axis(0.5, 1.24), Axis(0.25, 0.75)), 177),
    "rectangle of a bent edge": (lambda: stable_over(bent, Axis(1.0, 1.9, 2), Axis(0.5, 0.6)), 370),
    "rectangle beyond it": (lambda: stable_over(triangle, Axis(0.5, 1.26), Axis(0.25, 0.75)), 122),
    "rectangle of many powers": (
        lambda: stable_over(triangle, Axis(0.5, 1.1, 3), Axis(0.25, 0.75, 2)),
        636,
    ),
    "parts of a curve": (lambda: curve_parts(ScaledLoop(FAR, (1.0, 1.0))), 549),
    "series of a curve": (
        lambda: curve_around(ScaledLoop(FREE, (1.0, 1.0)), [(0.31, 1e-20), (2.9, 0.0)]),
        582,
    ),
    "undamped modes": (
        lambda: undamped_modes(ScaledLoop(UNDAMPED, (1.0, 1.0)), np.array([0.99 + 0.01j]), 1e9),
        42,
    ),
    "lines of a root": (lambda: root_lines(ScaledLoop(PEDAL, (1.0, 1.0))), 268),
    "others inside": (
        lambda: others_inside(
            ScaledLoop(FILTERED, (1.0, 1.0)), np.linspace(0.1, 3.0, 7), np.zeros(7)
        ),
        69,
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_answers_in_balls_take_few_calls(case: str) -> None:
    question, most = CASES[case]
    count = calls(question)
    assert 0.98 * most <= count <= most
