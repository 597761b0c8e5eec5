"""The walls that come to rest fastest, and the best damping at given stiffnesses."""

from dataclasses import dataclass, replace
from functools import partial
from math import sqrt
from typing import Literal, NamedTuple, TypeVar

import numpy as np

from jaxstab.conventions import Verdict
from jaxstab.loop import Gains, HapticLoop, tune_for_all
from jaxstab.loop.common import settling_times
from jaxstab.ranges import HandRange
from jaxstab.scene.answers import (
    Answer,
    Basis,
    Bound,
    Damping,
    Mass,
    Number,
    Stiffness,
    Time,
    basis_of,
    rounded_gain,
)
from jaxstab.scene.check import Amplitude, HeldBy, SettlingTime, at_lowest, settled, worst_held
from jaxstab.scene.loops import (
    Member,
    corners_of,
    hands_of,
    loop_of,
    loop_of_member,
    member_of,
    ranges_of,
    reachable,
    wall_region,
)
from jaxstab.scene.scene import Scene, Units
from jaxstab.tuning import TuningStatus

# The wall that is fastest at worst over the device's mass, the hands and the delay of a scene.
#
# Settling times over ranges are not proved: loops at the corners of the ranges decide, others
# between them are tried, and the slowest of those joins the corners. What is printed is the slowest
# of all.

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
    """The gains minimising the worst-case settling; None where the scene has no range."""
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


Tuning = TypeVar("Tuning", bound="TunedWall")

_ROUNDED = 1e-4  # of a limit, for gains are rounded


@dataclass(frozen=True)
class TunedWall(Answer):
    """Gains, and the radius and settling time that these gains have."""

    is_part = True
    absent = "not proved"

    stiffness: Stiffness
    damping: Damping
    spectral_radius: Number
    radius_error: Bound
    settling_time_2_percent: SettlingTime
    chatter_at_most: Amplitude | None


@dataclass(frozen=True)
class RoundedWall(TunedWall):
    """The same with the digits of the gains that are printed."""

    is_part = False


@dataclass(frozen=True)
class BestWall(Answer):
    """The best wall, and how it is known. Where none is stable there is only the status.

    Where poles coincide the radius depends on the last digits of the gains. So the
    printed radius is that of the printed gains; JSON has both.
    """

    exact: TunedWall | None
    rounded: RoundedWall | None
    share_of_largest: Number | None
    status: TuningStatus
    for_all_hands: Verdict | str | None

    @property
    def is_stable(self) -> bool:
        """Whether there is such a wall, proved stable for all hands."""
        return self.exact is not None and self.for_all_hands in (None, Verdict.STABLE)

    def lines(self, indent: str = "", units: Units = Units.LINE) -> list[str]:
        """Return the lines of the rounded wall, and the rest."""
        printed = TunedWall(**vars(self.rounded)) if self.rounded else None
        return Answer.lines(replace(self, exact=printed, rounded=None), indent, units)


@dataclass(frozen=True)
class Tuned(Answer):
    """The wall of the smallest radius, of the fastest settling, and the best dampings."""

    inputs: Basis | None
    least_radius: BestWall
    least_settling: BestWall
    walls: dict[str, BestWall]
    at_given_stiffness: BestWall | None
    hand: str | None
    over_ranges: WallOverRanges | None

    @property
    def all_stable(self) -> bool:
        """Whether each wall is found and proved stable; over ranges none is proved."""
        walls = [self.least_radius, self.least_settling, *self.walls.values()]
        walls += [self.at_given_stiffness] if self.at_given_stiffness else []
        return self.over_ranges is None and all(wall.is_stable for wall in walls)


class _Encoder(NamedTuple):
    """The resolution of an encoder, and how far it may drive a wall; None where not given."""

    resolution: float | None
    limit: float | None

    @classmethod
    def from_scene(cls, scene: Scene) -> "_Encoder":
        encoder, limit = scene.device.encoder, scene.wanted.chatter
        return cls(
            None if encoder is None else encoder.resolution,
            None if limit is None else limit * (1.0 - _ROUNDED),
        )


def tune_walls(scene: Scene) -> Tuned:
    """The walls that settle fastest, and the best damping at the stiffnesses given."""
    loop, hands = loop_of(scene), hands_of(scene)
    best = partial(_best, scene, loop, hands, _Encoder.from_scene(scene))
    given, fastest = scene.wanted.at_stiffness, best("settling")
    gains = Gains(fastest.rounded.stiffness, fastest.rounded.damping) if fastest.rounded else None
    return Tuned(
        inputs=basis_of(scene),
        least_radius=best("radius"),
        least_settling=fastest,
        walls={name: best("settling", wall.stiffness) for name, wall in scene.walls.items()},
        at_given_stiffness=None if given is None else best("settling", given),
        hand=at_lowest(scene),
        over_ranges=tune_over_ranges(scene, gains),
    )


def _best(
    scene: Scene,
    loop: HapticLoop,
    hands: HandRange | None,
    encoder: _Encoder,
    goal: Literal["radius", "settling"],
    stiffness: float | None = None,
) -> BestWall:
    limit = encoder.limit
    best = loop.tune(goal, stiffness=stiffness, encoder=encoder.resolution, chatter=limit)
    if best.status in (TuningStatus.NO_STABLE_GAINS, TuningStatus.NOT_CALM):
        return BestWall(None, None, None, best.status, None)
    gains = Gains(best.stiffness, best.damping)
    rounded = Gains(rounded_gain(best.stiffness), rounded_gain(best.damping))
    worst = worst_held(scene, [rounded])[0] if hands else None
    return BestWall(
        _tuned(TunedWall, loop, gains, encoder),
        _tuned(RoundedWall, loop, rounded, encoder),
        best.stiffness / reachable(wall_region(loop)).stiffest.stiffness,
        best.status,
        None if worst is None else worst.tried or worst.verdict,
    )


def _tuned(kind: type[Tuning], loop: HapticLoop, gains: Gains, encoder: _Encoder) -> Tuning:
    radius, resolution = loop.spectral_radius(*gains), encoder.resolution
    chatter = None
    if resolution is not None:
        chatter = float(loop.amplitude(*gains, encoder=resolution).position)
    return kind(
        stiffness=gains.stiffness,
        damping=gains.damping,
        spectral_radius=float(radius.value),
        radius_error=float(radius.error),
        settling_time_2_percent=settled(loop.settling_time(*gains)),
        chatter_at_most=chatter,
    )
