"""The wall that is fastest at worst over the device's mass, the hands and the delay of a scene.

Settling times over ranges are not proved: loops at the corners of the ranges decide, others between
them are tried, and the slowest of those joins the corners. What is printed is the slowest of all.
"""

from dataclasses import dataclass
from math import sqrt

import numpy as np

from jaxstab.loop import Gains, tune_for_all
from jaxstab.loop.common_wall import settling_times
from jaxstab.scene.answers import Answer, Damping, Mass, Stiffness, Time, rounded_gain
from jaxstab.scene.check import SettlingTime
from jaxstab.scene.hands import HeldBy
from jaxstab.scene.members import Member, corners_of, loop_of_member, member_of, ranges_of
from jaxstab.scene.scene import Scene
from jaxstab.tuning import TuningStatus

_BETWEEN = 100  # loops between the corners that are tried
_ROUNDS = 3  # in which the slowest of them joins the corners
_SEED = 20081120


@dataclass(frozen=True)
class SlowestLoop(Answer):
    """The loop of the ranges in which a wall takes longest."""

    mass: Mass
    delay: Time
    hand: HeldBy | None


@dataclass(frozen=True)
class WallOverRanges(Answer):
    """The wall whose longest settling time over the ranges is the least that was found."""

    absent = "not proved"

    stiffness: Stiffness | None
    damping: Damping | None
    settling_time_at_worst: SettlingTime | None
    fastest_wall_at_worst: SettlingTime | None
    slowest: SlowestLoop | None
    certainty: str


def tune_over_ranges(scene: Scene, fastest: Gains | None) -> WallOverRanges | None:
    """Return the wall that is fastest at worst; None where the scene has no range.

    Args:
        scene: the scene.
        fastest: the wall that is fastest for the lowest hand, for comparison, if there is one.
    """
    ranges = ranges_of(scene)
    if all(low == high for low, high in ranges):
        return None
    corners = corners_of(scene)
    loops = [loop_of_member(scene, member) for member in corners]
    among = [*corners, *_between(ranges)]
    every = [*loops, *(loop_of_member(scene, member) for member in among[len(corners) :])]
    for _ in range(_ROUNDS):
        wall = tune_for_all(loops)
        if wall.status == TuningStatus.NO_STABLE_GAINS:
            words = "no wall was found that settles in all of these loops"
            return WallOverRanges(None, None, None, None, None, words)
        rounded = Gains(rounded_gain(wall.stiffness), rounded_gain(wall.damping))
        times = settling_times(every, *rounded)
        slowest = int(np.argmax(times))
        if times[slowest] <= wall.settling_time or every[slowest] in loops:
            break
        loops.append(every[slowest])
    member = among[slowest]
    return WallOverRanges(
        *rounded,
        float(times[slowest]),
        None if fastest is None else float(settling_times(every, *fastest).max()),
        SlowestLoop(member.mass, member.delay, HeldBy(*member.hand) if scene.hand else None),
        f"the slowest of {len(every)} loops that were tried, {len(corners)} of them corners of the "
        "ranges: nothing is proved of others",
    )


def _between(ranges: list[tuple[float, float]]) -> list[Member]:
    """Return random members, and the one in the middle; stiffness evenly in frequency."""
    rng = np.random.default_rng(_SEED)
    shares = np.concatenate([np.full((1, len(ranges)), 0.5), rng.random((_BETWEEN, len(ranges)))])
    low, high = np.array(ranges).T
    values = low + shares * (high - low)
    roots = sqrt(low[2]) + shares[:, 2] * (sqrt(high[2]) - sqrt(low[2]))
    values[:, 2] = np.clip(roots**2, low[2], high[2])
    return [member_of(row) for row in values.tolist()]
