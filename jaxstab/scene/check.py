"""The walls of a scene: verdict, margins, radius, settling and chatter, with proofs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR
from math import inf, isinf, nan
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float64

from jaxstab.conventions import Verdict
from jaxstab.loop import Gains, HapticLoop
from jaxstab.model import by_name
from jaxstab.motion import Settling as MotionSettling
from jaxstab.motion import SettlingStatus
from jaxstab.motion.settling import settling_at_levels
from jaxstab.numbers import without_noise
from jaxstab.ranges import HandRange, margins
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
from jaxstab.scene.hands import HeldBy, worst_held
from jaxstab.scene.loops import corner_loops, hands_of, loop_of, walls_of
from jaxstab.scene.scene import Scene

_HORIZON = 2**17  # samples within which settling is looked for
_LEVELS = 0.02, 0.05


Ends = Float64[np.ndarray, "wall hand 2"]
Spare = Float64[np.ndarray, "3 wall hand"]
_Known = tuple[Verdict, HapticLoop, HeldBy | None, str | None]
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

    basis: Basis | None
    walls: dict[str, WallCheck]

    @property
    def all_stable(self) -> bool:
        """Whether every wall is stable, by proof."""
        return all(wall.verdict == Verdict.STABLE for wall in self.walls.values())


def check_walls(scene: Scene) -> Check:
    """Return for each wall its verdict and the measures that are wanted, at the worst hand.

    Raises:
        ValueError: there is no wall, or a quantity is out of range.
    """
    scene.require_walls()
    hands, walls = hands_of(scene), walls_of(scene)
    loops = list(dict.fromkeys([loop_of(scene), *(corner_loops(scene) if hands else [])]))
    gains = list(walls.values())
    wanted = "margins" in scene.wanted.measures
    margins = _margins(loops, gains) if wanted else [None] * len(gains)
    known = _known(scene, hands, loops[0], gains)
    measured = _measured(scene, loops, gains, [loop for _, loop, *_ in known])
    answers = [_wall_check(*parts) for parts in zip(gains, known, margins, measured, strict=True)]
    return Check(basis_of(scene), dict(zip(walls, answers, strict=True)))


def _known(
    scene: Scene, hands: HandRange | None, loop: HapticLoop, walls: list[Gains]
) -> Sequence[_Known]:
    """Return the fields of ``WorstHeld``; for the loop itself where no hand varies."""
    if hands:
        return worst_held(scene, hands, walls)
    return [(Verdict(int(code)), loop, None, None) for code in loop.verdict(*np.array(walls).T)]


def _wall_check(
    gains: Gains, known: _Known, margins: Margins | None, measured: dict[str, Any]
) -> WallCheck:
    code, _, hand, tried = known
    if code == Verdict.UNSTABLE and margins is not None:
        margins = NoMargins(**vars(margins))
    return WallCheck(*gains, code, tried, hand, margins, **measured)


def _measured(
    scene: Scene, loops: list[HapticLoop], walls: list[Gains], worst: list[HapticLoop]
) -> list[dict[str, Any]]:
    """Return the measures of each wall that are wanted; walls of one worst loop are asked at once.

    The loops are those of the corners of the hands' range.
    """
    wanted, encoder = scene.wanted.measures, scene.device.encoder
    answers: list[dict[str, Any]] = [{} for _ in walls]
    for loop in dict.fromkeys(worst):
        numbers = [number for number, other in enumerate(worst) if other == loop]
        some = [walls[number] for number in numbers]
        for name, measure in _MEASURES.items():
            if name in wanted:
                for number, answer in zip(numbers, measure(loop, some), strict=True):
                    answers[number][name] = answer
    if "settling" in wanted:
        for own, settling in zip(answers, _settlings(worst, walls), strict=True):
            own["settling"] = settling
    if encoder is not None and "chatter" in wanted:
        for own, gains, loop in zip(answers, walls, worst, strict=True):
            held = list(dict.fromkeys([*loops, loop]))
            own["chatter"] = _chatter(held, gains, encoder.resolution)
    return answers


def _margins(loops: list[HapticLoop], walls: list[Gains]) -> list[Margins]:
    """Return the least margins of each wall over some loops of one sample time and delay."""
    stiffness, damping, spare = _margins_of(loops, walls)
    period = loops[0].sample_time
    words = f"the least of {len(loops)} hands" if len(loops) > 1 else None
    answers = []
    for number in range(len(walls)):
        # NaN, of a hand with which the wall is not stable, goes through.
        stiffer, damper, extra_delay = (float(least) for least in spare[:, number].min(axis=1))
        answers.append(
            Margins(
                stiffer,
                damper,
                _common(stiffness[number]),
                _common(damping[number]),
                extra_delay,
                MOST_DELAY * period if isinf(extra_delay) else None,
                words,
            )
        )
    return answers


def _margins_of(loops: list[HapticLoop], walls: list[Gains]) -> tuple[Ends, Ends, Spare]:
    """Return the limits of K and of B, and factors of K, of B, and extra delays, in SI units."""
    stiffness, damping = np.array(walls).T
    if loops[0].body is None:
        single = [loop.margins(stiffness, damping) for loop in loops]
        spare = [(one.stiffness_gain, one.damping_gain, one.extra_delay) for one in single]
        return (
            np.stack([one.stiffness for one in single], axis=1),
            np.stack([one.damping for one in single], axis=1),
            np.stack(spare, axis=2),
        )
    alpha, beta = (
        np.stack([unit(gains) for unit in units], axis=1)
        for gains, units in (
            (stiffness, [loop.alpha for loop in loops]),
            (damping, [loop.beta for loop in loops]),
        )
    )
    found = margins(
        alpha,
        beta,
        **by_name(*np.array([[*loop.slice.values()] for loop in loops]).T),
        **loops[0].filters,
    )
    mass, period = np.array([[loop.mass] for loop in loops]), loops[0].sample_time
    delay = period * np.asarray(found.extra_delay)
    return (
        np.asarray(found.stiffness) * mass / period**2,
        np.asarray(found.damping) * mass / period,
        np.stack([found.stiffness_gain, found.damping_gain, delay]),
    )


def _common(limits: Float64[np.ndarray, "hand 2"]) -> tuple[float, float]:
    """Return the interval that is in all intervals; an end that is 0 but for rounding is 0."""
    low, high = limits[:, 0].max(), limits[:, 1].min()
    return float(without_noise(low, high - low)), float(without_noise(high, high - low))


def _distances(loop: HapticLoop, walls: list[Gains]) -> list[Distance]:
    return [Distance(float(away)) for away in loop.boundary_distance(*np.array(walls).T)]


def _radii(loop: HapticLoop, walls: list[Gains]) -> list[Radius]:
    found = loop.spectral_radius(*np.array(walls).T)
    return [Radius(float(one), float(bound)) for one, bound in zip(*found[:2], strict=True)]


def _settlings(loops: list[HapticLoop], walls: list[Gains]) -> list[Settling]:
    """Return the settling of each wall in a loop of its own; all loops have one sample time."""
    pairs = list(zip(loops, walls, strict=True))
    if loops[0].body is None:
        both = [
            [loop.settling_time(*gains, level=level, horizon=_HORIZON) for loop, gains in pairs]
            for level in _LEVELS
        ]
    else:
        points = [
            (loop.alpha(wall[0]), loop.beta(wall[1]), *loop.slice.values()) for loop, wall in pairs
        ]
        alpha, beta, gamma, delta, delay = np.array(points).T
        filters = loops[0].filters
        found = settling_at_levels(
            alpha, beta, gamma, delta, delay, _LEVELS, horizon=_HORIZON, **filters
        )
        period = loops[0].sample_time
        both = [
            [MotionSettling(count * period, code) for count, code in zip(*one, strict=True)]
            for one in found
        ]
    return [
        Settling(settled(two), settled(five), SettlingStatus(int(two.status)))
        for two, five in zip(*both, strict=True)
    ]


def settled(found: MotionSettling) -> float:
    """Return a settling time in s; infinite for an unstable loop, NaN where none is proved."""
    status = int(found.status)
    if status == SettlingStatus.SETTLED:
        return float(found.value)
    return inf if status == SettlingStatus.UNSTABLE else nan


def _oscillations(loop: HapticLoop, walls: list[Gains]) -> list[Oscillation]:
    mode = loop.oscillation(*np.array(walls).T)
    return [Oscillation(float(one), float(rate)) for one, rate in zip(*mode, strict=True)]


_MEASURES: dict[str, Callable[[HapticLoop, list[Gains]], Sequence[Answer]]] = {
    "distance": _distances,
    "radius": _radii,
    "oscillation": _oscillations,
}


def _chatter(loops: list[HapticLoop], gains: Gains, resolution: float) -> Chatter:
    """Return the largest amplitudes over some loops."""
    found = [loop.amplitude(*gains, encoder=resolution) for loop in loops]
    position = max(float(one.position) for one in found)
    force = max(float(one.force) for one in found)
    hands = f", the largest of {len(loops)} hands" if len(loops) > 1 else ""
    words = None if isinf(position) else f"proved{hands}"
    return Chatter(position, force, float(found[0].force_per_count), words)
