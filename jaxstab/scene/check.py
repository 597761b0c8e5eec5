"""The walls of a scene: verdict, margins, radius, settling and chatter, with proofs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR
from math import inf, isinf, nan
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float64

from jaxstab.batches import by_kind
from jaxstab.conventions import Verdict
from jaxstab.loop import Gains, HapticLoop
from jaxstab.loop.together import (
    Rendered,
    amplitudes,
    boundary_distances,
    oscillations,
    settling_times,
    spectral_radii,
    verdicts,
    wall_margins,
)
from jaxstab.motion import Settling as MotionSettling
from jaxstab.motion import SettlingStatus
from jaxstab.numbers import without_noise
from jaxstab.ranges.margins import MOST_DELAY
from jaxstab.scene.answers import (
    Answer,
    Basis,
    Bound,
    Damping,
    DampingLimits,
    Frequency,
    Number,
    Quantity,
    Stiffness,
    StiffnessLimits,
    Time,
)
from jaxstab.scene.basis import basis_of
from jaxstab.scene.hands import HeldBy, WorstHeld, worst_held
from jaxstab.scene.loops import corner_loops, hands_of, loop_of, walls_of
from jaxstab.scene.scene import Scene

_HORIZON = 2**17  # samples within which settling is looked for
_LEVELS = 0.02, 0.05


Values = Float64[np.ndarray, " hand"]
LargestNumber = Annotated[float, Quantity(rounding=ROUND_FLOOR)]
Amplitude = Annotated[float, Quantity("m", 3, ROUND_CEILING, "not proved")]
SettlingTime = Annotated[float, Quantity("s", infinite="never")]
SpareTime = Annotated[float, Quantity("s", 4, ROUND_FLOOR, "more than is searched")]
SpareGain = Annotated[float, Quantity("", 4, ROUND_FLOOR, "any")]


@dataclass(frozen=True)
class Margins(Answer):
    """How far each quantity may change alone: the least over some hands."""

    is_part = True
    absent = "none is proved"

    stiffness_gain: SpareGain
    damping_gain: SpareGain
    stiffness_limits: StiffnessLimits
    damping_limits: DampingLimits
    extra_delay: SpareTime
    delay_searched: Time | None
    margins_are: str | None


@dataclass(frozen=True)
class NoMargins(Margins):
    """The margins of a wall that is not stable."""

    absent = "none: the wall is not stable"


@dataclass(frozen=True)
class Distance(Answer):
    """The distance to the edge of stability in units of alpha and beta."""

    is_part = True
    absent = "not known"

    distance_to_boundary: LargestNumber


@dataclass(frozen=True)
class Radius(Answer):
    """The spectral radius and the bound of its error."""

    is_part = True

    spectral_radius: Number
    radius_error: Bound


@dataclass(frozen=True)
class Settling(Answer):
    """The settling times; NaN where they are not proved, infinite for an unstable wall."""

    is_part = True
    absent = "not proved"

    settling_time_2_percent: SettlingTime
    settling_time_5_percent: SettlingTime
    settling_status: SettlingStatus


@dataclass(frozen=True)
class Oscillation(Answer):
    """The slowest mode."""

    is_part = True

    damping_ratio: Number
    frequency: Frequency


@dataclass(frozen=True)
class Chatter(Answer):
    """How far the encoder's rounding can drive position and force at all times, at most."""

    is_part = True

    chatter_at_most: Amplitude
    force_chatter_at_most: Annotated[float, Quantity("N", 3, ROUND_CEILING, "not proved")]
    force_per_count: Annotated[float, Quantity("N", 3)]
    chatter_is: str | None


@dataclass(frozen=True)
class WallCheck(Answer):
    """What is known of a wall, and the measures that are wanted, at the worst hand."""

    stiffness: Stiffness
    damping: Damping
    verdict: Verdict
    hands_are: str | None
    worst_hand: HeldBy | None
    margins: Margins | None = None
    distance: Distance | None = None
    radius: Radius | None = None
    settling: Settling | None = None
    oscillation: Oscillation | None = None
    chatter: Chatter | None = None


@dataclass(frozen=True)
class Check(Answer):
    """What is known of each wall, by its name."""

    inputs: Basis | None
    walls: dict[str, WallCheck]

    @property
    def all_stable(self) -> bool:
        """Whether every wall is stable, by proof."""
        return all(wall.verdict == Verdict.STABLE for wall in self.walls.values())


@dataclass(frozen=True)
class _Wall:
    """A wall of a scene, the loops with the hands at the corners of its range, and the worst."""

    scene: Scene
    gains: Gains
    loops: list[HapticLoop]
    known: WorstHeld

    @property
    def at_worst(self) -> Rendered:
        """The wall in the loop with the worst hand."""
        return Rendered(self.known.loop, self.gains)

    def wants(self, measure: str) -> bool:
        """Return whether a measure is wanted, and can be taken."""
        wanted = measure in self.scene.wanted.measures
        return wanted and (measure != "chatter" or self.scene.device.encoder is not None)


def check_walls(scene: Scene) -> Check:
    """Return for each wall its verdict and the measures that are wanted, at the worst hand.

    Raises:
        ValueError: there is no wall, or a quantity is out of range.
    """
    (check,) = check_scenes([scene])
    return check


def check_scenes(scenes: Sequence[Scene]) -> list[Check]:
    """Return ``check_walls`` of each scene; the walls of all are asked about together.

    Raises:
        ValueError: as ``check_walls`` of one of them.
    """
    walls = _walls_of(scenes)
    measured: list[dict[str, Any]] = [{} for _ in walls]
    for name, measure in _MEASURES.items():
        numbers = [number for number, wall in enumerate(walls) if wall.wants(name)]
        if numbers:
            answers = measure([walls[number] for number in numbers])
            for number, answer in zip(numbers, answers, strict=True):
                measured[number][name] = answer
    checked = (_wall_check(*both) for both in zip(walls, measured, strict=True))
    return [Check(basis_of(one), {name: next(checked) for name in one.walls}) for one in scenes]


def _walls_of(scenes: Sequence[Scene]) -> list[_Wall]:
    asked: list[tuple[Scene, Gains, list[HapticLoop]]] = []
    for scene in scenes:
        scene.require_walls()
        corners = corner_loops(scene) if hands_of(scene) else []
        loops = list(dict.fromkeys([loop_of(scene), *corners]))
        asked += [(scene, gains, loops) for gains in walls_of(scene).values()]
    has_hands = [hands_of(scene) is not None for scene, *_ in asked]
    known = by_kind(asked, has_hands, _known)
    return [_Wall(*wall, held) for wall, held in zip(asked, known, strict=True)]


def _known(walls: Sequence[tuple[Scene, Gains, list[HapticLoop]]]) -> list[WorstHeld]:
    """Return what is known of each wall at the worst hand, or in the loop itself if none varies."""
    if hands_of(walls[0][0]):
        return worst_held([(scene, gains) for scene, gains, _ in walls])
    codes = verdicts([Rendered(loops[0], gains) for _, gains, loops in walls])
    return [
        WorstHeld(Verdict(int(code)), loops[0], None, None)
        for code, (*_, loops) in zip(codes, walls, strict=True)
    ]


def _wall_check(wall: _Wall, measures: dict[str, Any]) -> WallCheck:
    verdict, _, hand, tried = wall.known
    return WallCheck(*wall.gains, verdict, tried, hand, **measures)


def _margins(walls: Sequence[_Wall]) -> list[Margins]:
    """Return the least margins of each wall over its loops."""
    found = wall_margins([Rendered(loop, wall.gains) for wall in walls for loop in wall.loops])
    spare = np.array([found.stiffness_gain, found.damping_gain, found.extra_delay])
    answers, first = [], 0
    for wall in walls:
        own = slice(first, first + len(wall.loops))
        # NaN, of a hand with which the wall is not stable, goes through.
        stiffer, damper, extra_delay = spare[:, own].min(axis=1).tolist()
        searched = MOST_DELAY * wall.loops[0].sample_time if isinf(extra_delay) else None
        words = f"the least of {len(wall.loops)} hands" if len(wall.loops) > 1 else None
        limits = _common(found.stiffness[own]), _common(found.damping[own])
        kind = NoMargins if wall.known.verdict == Verdict.UNSTABLE else Margins
        answers.append(kind(stiffer, damper, *limits, extra_delay, searched, words))
        first = own.stop
    return answers


def _common(limits: Float64[np.ndarray, "hand 2"]) -> tuple[float, float]:
    """Return the interval that is in all intervals; an end that is 0 but for rounding is 0."""
    low, high = limits[:, 0].max(), limits[:, 1].min()
    return float(without_noise(low, high - low)), float(without_noise(high, high - low))


def _distances(walls: Sequence[_Wall]) -> list[Distance]:
    found = boundary_distances([wall.at_worst for wall in walls])
    return [Distance(away) for away in found.tolist()]


def _radii(walls: Sequence[_Wall]) -> list[Radius]:
    value, error, _ = spectral_radii([wall.at_worst for wall in walls])
    return [Radius(*both) for both in zip(value.tolist(), error.tolist(), strict=True)]


def _settlings(walls: Sequence[_Wall]) -> list[Settling]:
    found = settling_times([wall.at_worst for wall in walls], _LEVELS, _HORIZON)
    two, five = ([MotionSettling(*own) for own in zip(*one, strict=True)] for one in found)
    return [
        Settling(settled(one), settled(other), SettlingStatus(int(one.status)))
        for one, other in zip(two, five, strict=True)
    ]


def settled(found: MotionSettling) -> float:
    """Return a settling time in s; infinite for an unstable loop, NaN where none is proved."""
    status = int(found.status)
    if status == SettlingStatus.SETTLED:
        return float(found.value)
    return inf if status == SettlingStatus.UNSTABLE else nan


def _oscillations(walls: Sequence[_Wall]) -> list[Oscillation]:
    ratio, frequency = oscillations([wall.at_worst for wall in walls])
    return [Oscillation(*both) for both in zip(ratio.tolist(), frequency.tolist(), strict=True)]


def _chatters(walls: Sequence[_Wall]) -> list[Chatter]:
    """Return the largest amplitudes of each wall over its loops and the one with the worst hand."""
    held = [list(dict.fromkeys([*wall.loops, wall.known.loop])) for wall in walls]
    encoders = [wall.scene.device.encoder for wall in walls]
    steps = [one.resolution for one in encoders if one is not None]  # all, as they are wanted
    counts = [len(loops) for loops in held]
    rendered = [
        Rendered(loop, wall.gains)
        for wall, loops in zip(walls, held, strict=True)
        for loop in loops
    ]
    found = amplitudes(rendered, np.repeat(steps, counts))
    ends = np.cumsum(counts)[:-1]
    columns = (np.split(one, ends) for one in (found.position, found.force, found.force_per_count))
    return [_chatter(*own) for own in zip(*columns, strict=True)]


def _chatter(position: Values, force: Values, force_per_count: Values) -> Chatter:
    hands = f", the largest of {len(position)} hands" if len(position) > 1 else ""
    most = float(position.max())
    words = None if isinf(most) else f"proved{hands}"
    return Chatter(most, float(force.max()), float(force_per_count[0]), words)


_MEASURES: dict[str, Callable[[Sequence[_Wall]], Sequence[Answer]]] = {
    "margins": _margins,
    "distance": _distances,
    "radius": _radii,
    "settling": _settlings,
    "oscillation": _oscillations,
    "chatter": _chatters,
}
