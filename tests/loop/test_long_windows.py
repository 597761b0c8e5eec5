"""Windows of 42 to 200 samples: margins, settling times and hands against balls and lfilter.

A window of 20 ms is that of the preset of Force Dimension.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
import pytest

from jaxstab import HandRange, HapticLoop, Velocity, Verdict
from jaxstab.results import SettlingStatus
from tests.truth import filtered
from tests.truth.balls import BallLoop
from tests.truth.march import difference_taps, march_through_filters

HANDS = HandRange(mass=(0.0, 0.3), damping=(1.0, 4.0), stiffness=(0.0, 300.0))
LEVEL = 0.02
SHORT = 1e-8  # of the way: rounding at degree 200, 5.5e-9 at most here; never beyond the end
CAMPAIGN = pytest.mark.campaign


class Case(NamedTuple):
    """A window, a delay in samples, the rate in Hz, a stiffness and a damping."""

    samples: int
    delay: float
    rate: float
    wall: tuple[float, float]

    @property
    def loop(self) -> HapticLoop:
        return HapticLoop(
            device_mass=0.25,
            device_damping=0.5,
            sample_time=1.0 / self.rate,
            delay=self.delay / self.rate,
            velocity=Velocity.difference(samples=self.samples),
        )

    def balls(self, loop: HapticLoop, later: float = 0.0) -> BallLoop:
        """The truth of a loop, its delay so many samples longer."""
        plant = loop.gamma, loop.delta, self.delay + later
        both = filtered.difference(self.samples), filtered.average(1)
        return filtered.FilteredLoop(*plant, *both).balls(600)

    def is_stable(self, loop: HapticLoop, wall: tuple[float, float]) -> bool | None:
        return self.balls(loop).is_stable(loop.alpha(wall[0]), loop.beta(wall[1]))


SHORTER = Case(80, 1.0, 4000.0, (1500.0, 7.0))  # 20 ms
LONGEST = Case(200, 1.0, 10_000.0, (2000.0, 4.0))  # 20 ms
CASES = [
    SHORTER,
    LONGEST,
    *(
        pytest.param(case, marks=CAMPAIGN)
        for case in (
            Case(42, 0.0, 2000.0, (800.0, 6.0)),
            Case(60, 2.5, 3000.0, (1200.0, 20.0)),
            Case(100, 0.3, 5000.0, (500.0, 15.0)),
            Case(150, 3.0, 8000.0, (2500.0, 8.0)),
            Case(200, 1.5, 5000.0, (600.0, 6.0)),
        )
    ),
]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_margins_with_long_windows_end_where_balls_say(case: Case) -> None:
    loop, (stiffness, damping) = case.loop, case.wall
    found = loop.margins(*case.wall)
    assert found.verdict == Verdict.STABLE
    for share, truth in ((1.0 - 1e-12, True), (1.0 + SHORT, False)):
        for end in map(float, found.stiffness):
            moved = stiffness + share * (end - stiffness), damping
            assert case.is_stable(loop, moved) is truth
        for end in map(float, found.damping):
            moved = stiffness, damping + share * (end - damping)
            assert case.is_stable(loop, moved) is truth
    gains = loop.alpha(stiffness), loop.beta(damping)
    extra = float(found.extra_delay) * case.rate
    for share, truth in ((0.5, True), (1.0 - 1e-8, True), (1.0 + 1e-8, False)):
        assert case.balls(loop, share * extra).is_stable(*gains) is truth


@pytest.mark.parametrize("excitation", ["force", pytest.param("impact", marks=CAMPAIGN)])
@pytest.mark.parametrize("case", CASES, ids=str)
def test_settling_with_long_windows_is_that_of_lfilter(case: Case, excitation: str) -> None:
    loop = case.loop
    found = loop.settling_time(*case.wall, excitation=excitation, level=LEVEL)
    assert int(found.status) == SettlingStatus.SETTLED
    plant = loop.gamma, loop.delta, case.delay
    gains = loop.alpha(case.wall[0]), loop.beta(case.wall[1])
    count = round(float(found.value) * case.rate)
    is_push = excitation == "force"
    states, _ = march_through_filters(
        plant,
        gains,
        [difference_taps(case.samples)],
        [],
        2 * count + 100,
        push=gains[0] + plant[0] if is_push else 0.0,
        start=(0.0, 0.0 if is_push else 1.0),
    )
    away = np.abs(states[:, 0] - (1.0 if is_push else 0.0))
    away /= 1.0 if is_push else away.max()
    assert np.flatnonzero(away > LEVEL)[-1] + 1 == count


@pytest.mark.parametrize(
    "case", [SHORTER, *CASES[2:-1], pytest.param(LONGEST, marks=CAMPAIGN)], ids=str
)
def test_hands_with_long_windows_are_those_of_balls(case: Case) -> None:
    loop = case.loop
    ranges = HANDS.mass, HANDS.damping, HANDS.stiffness
    rng = np.random.default_rng(case.samples)
    arms = [*product(*ranges), *zip(*(rng.uniform(*ends, 4) for ends in ranges), strict=True)]
    loops = [
        HapticLoop(
            device_mass=0.25,
            device_damping=0.5,
            sample_time=loop.sample_time,
            **dict(zip(("hand_mass", "hand_damping", "hand_stiffness"), arm, strict=True)),
            delay=loop.delay,
            velocity=loop.velocity,
        )
        for arm in arms
    ]
    proved = loop.worst_hand(HANDS, *case.wall)
    assert proved.verdict == Verdict.STABLE
    assert all(case.is_stable(one, case.wall) for one in loops)
    beyond = 1.01 * float(loops[0].stiffness_limits(case.wall[1])[1]), case.wall[1]
    assert case.is_stable(loops[0], beyond) is False
    refuted = loop.worst_hand(HANDS, *beyond)
    assert refuted.verdict == Verdict.UNSTABLE
    for worst, wall in ((proved, case.wall), (refuted, beyond)):
        gains = worst.loop.alpha(wall[0]), worst.loop.beta(wall[1])
        balls = case.balls(worst.loop)
        assert balls.is_stable(*gains, worst.radius + 1e-10) is True
        assert balls.is_stable(*gains, worst.radius - 1e-10) is False
