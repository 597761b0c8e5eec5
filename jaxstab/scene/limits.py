"""The limits of a scene: the largest stiffness and damping, beside the simple rules."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from math import isfinite, nan
from typing import Any

import numpy as np

from jaxstab import paper
from jaxstab.conventions import Verdict
from jaxstab.exact import LineStatus, StableLine
from jaxstab.exact.line import End
from jaxstab.loop import Gains, HapticLoop, WallLimits, WallRegion
from jaxstab.model import Velocity
from jaxstab.region import RegionStatus
from jaxstab.scene.answers import (
    Answer,
    Basis,
    DampingLimits,
    GivenDamping,
    GivenStiffness,
    LargestDamping,
    LargestStiffness,
    Number,
    Quantity,
    Stiffness,
    StiffnessLimits,
    basis_of,
    printed_wall,
)
from jaxstab.scene.loops import (
    BUT_FOR_DRIFT,
    Floats,
    StiffestWall,
    WallVerdict,
    at_lowest,
    delays_of,
    hands_of,
    is_plain,
    limit_for_all,
    loop_of,
    loops_over_delays,
    verdict_with_drift,
    wall_for_all,
    wall_region,
    walls_of,
    with_safety,
    worst_on,
)
from jaxstab.scene.scene import Scene
from jaxstab.shown import table_text

_SEE_BELOW = " (all hands: see below)"


@dataclass(frozen=True)
class MostDampedWall(Answer):
    """The largest stable damping, and where it is reached."""

    largest_damping: LargestDamping
    at_stiffness: Stiffness


@dataclass(frozen=True)
class AroundWall(Answer):
    """The stable stiffnesses at the damping of a wall, or the dampings at its stiffness, or both.

    Of several intervals the one that holds small gains, or the wall, comes first; unstable gains
    lie between it and the others. ``linear_rule_stiffness`` is the largest one of the linear rule,
    ``exception`` says that the wall is not stable, or not proved, for other hands of the scene.
    """

    at_damping: GivenDamping | None = None
    stiffness_limits: StiffnessLimits | None = None
    other_stiffnesses: dict[str, StiffnessLimits] = field(default_factory=dict)
    linear_rule_stiffness: LargestStiffness | None = None
    at_stiffness: GivenStiffness | None = None
    damping_limits: DampingLimits | None = None
    other_dampings: dict[str, DampingLimits] = field(default_factory=dict)
    verdict: str | None = None
    exception: str | None = None

    @property
    def is_within(self) -> bool:
        """True if the wall is within the limits of the hand at its lowest values."""
        low, high = self.stiffness_limits or (nan, nan)
        return low < (self.at_stiffness or 0.0) < high

    @property
    def is_stable(self) -> bool:
        """True if the wall is stable for every hand, but for a position that drifts."""
        return (self.is_within or self.verdict is not None) and self.exception is None


@dataclass(frozen=True)
class Limits(Answer):
    """The limits of a scene, with the hand at its lowest values; ``all_hands`` has all of them.

    Over a range of delays that are constant the best wall, the only limit, is for all hands.
    """

    inputs: Basis
    safety: Number | None
    hand: str | None
    best: StiffestWall
    most_damped: MostDampedWall | None = None
    reached: str | None = None
    islands: dict[str, StiffestWall] = field(default_factory=dict)
    passive: StiffestWall | None = None
    linear_rule: StiffestWall | None = None
    windows: dict[str, StiffestWall] = field(default_factory=dict)
    at_given_damping: AroundWall | None = None
    at_given_stiffness: AroundWall | None = None
    walls: Mapping[str, AroundWall | WallVerdict] = field(default_factory=dict)
    all_hands: StiffestWall | None = None

    @property
    def all_stable(self) -> bool:
        """True if there are stable walls, one proved for all hands, and all of the scene are."""
        every = self.all_hands or self.best, *self.walls.values()
        return all(wall.is_stable for wall in every)


def brief(answer: Limits, *, islands: bool = False) -> str:
    """Return the estimator, the delay, the largest stiffness and each wall, one on each line."""
    lines, said = answer.inputs.facts(), {path: words for path, _, words in answer.leaves()}

    def limit(key: str, *more: str | None) -> str:
        stiffness, damping = said[f"{key}.largest_stiffness"], said[f"{key}.at_damping"]
        if stiffness == Quantity.absent:
            return "no stable wall"
        return ", ".join([f"{stiffness} at {damping}", *filter(None, more)])

    if answer.safety is not None:
        lines["safety factor"] = f"{said['safety']}, applied to every limit"
    hand = answer.hand and f"hand {answer.hand.removesuffix(_SEE_BELOW)}"
    lines["largest stiffness"] = limit("best", said.get("best.certainty"), hand)
    if answer.all_hands:
        lines["for all hands"] = limit("all_hands", said["all_hands.certainty"])
    if "reached" in said:
        lines["note"] = said["reached"]
    for gain, fixed in (("stiffness", "damping"), ("damping", "stiffness")):
        key = f"at_given_{fixed}"
        if f"{key}.at_{fixed}" in said:
            place, others = said[f"{key}.at_{fixed}"], others_in_words(f"{key}.other_{gain}", said)
            lines[f"stable {gain}"] = f"{said[f'{key}.{gain}_limits_low']} at {place}{others}"
    for name, wall in answer.walls.items():
        lines[f"wall {name}"] = _wall_text(wall, f"walls.{name}", said)
    for name, island in answer.islands.items():
        if islands:
            lines[f"island {name}"] = limit(f"islands.{name}", island.reached)
        elif island.largest_stiffness > 0.0 and island.at_damping >= 0.0:
            lines["islands"] = "stable walls that are not connected to zero gains: see --islands"
    return table_text([*lines.items()])


def _wall_text(wall: WallVerdict | AroundWall, key: str, said: dict[str, str]) -> str:
    """Return the gains of a wall, and its verdict or the stiffness limits at its damping."""
    if isinstance(wall, WallVerdict):
        names = (f"{key}.{name}" for name in ("verdict", "worst_delays"))
        words = ", ".join(said[name] for name in names if name in said)
        return f"{said[f'{key}.stiffness']} at {said[f'{key}.damping']}, {words}"
    limits, place = said[f"{key}.stiffness_limits_low"], "within" if wall.is_within else "outside"
    gains = f"{said[f'{key}.at_stiffness']} at {said[f'{key}.at_damping']}"
    exception = f"; {wall.exception}" if wall.exception else ""
    if wall.verdict is not None:
        return f"{gains}, {wall.verdict}{exception}"
    if limits != Quantity.absent:
        others = others_in_words(f"{key}.other_stiffness", said)
        return f"{gains}, {place} the stable range of {limits}{others}{exception}"
    return f"{gains}, where no stiffness is stable"


def others_in_words(key: str, said: Mapping[str, str]) -> str:
    """The further intervals of a row, each after a comma."""
    ends = (words for path, words in said.items() if path.startswith(key) and "_low" in path)
    return "".join(f", also {words}" for words in ends)


def stable_in_words(
    name: str, own: str, place: str, ends: str | None, said: Mapping[str, str]
) -> str:
    """The stable values of a gain at a value of the other one, or that there are none."""
    if ends is None:
        return f"{name} is not resolved at {place}"
    every = f"{name} from {ends}{others_in_words(f'other_{own}', said)}"
    return f"{every if ' to ' in ends else f'no {name}'} at {place}"


def scene_limits(scene: Scene) -> Limits:
    """The largest stiffness and damping, the linear rule, the passive limit, all hands.

    Where a safety is wanted, all limits are multiplied by it, towards small gains, and islands,
    which have no such side, are left out. The linear rule and the passive limit are those of the
    difference over one sample, and left out for others.
    """
    if not scene.controller.has_one_delay:
        return _over_delays(scene)
    loop, wanted = loop_of(scene), scene.wanted
    region, safety = wall_region(loop), scene.wanted.safety or 1.0
    limits = region.limits()
    damping, stiffness = wanted.at_damping, wanted.at_stiffness
    rows = _Rows(loop, region, safety)
    has_rules, islands = is_plain(loop), () if wanted.safety else limits.islands
    is_any_stable = isfinite(limits.stiffness)  # with K >= 0 and B >= 0
    isolated = "isolated: not connected to zero gains"
    return Limits(
        inputs=basis_of(scene),
        safety=wanted.safety,
        hand=at_lowest(scene, _SEE_BELOW),
        best=StiffestWall(*rows.stiffest(limits.stiffness, limits.at_damping)),
        most_damped=MostDampedWall(*rows.most_damped(limits.damping, limits.at_stiffness)),
        reached=None if limits.is_reachable or region.is_empty else "small gains are not stable",
        islands=numbered(
            StiffestWall(*rows.stiffest(*own[:2]), *rows.most_damped(*own[2:4]), isolated)
            for own in islands
        ),
        passive=_passive(rows) if has_rules else None,
        linear_rule=(_linear_rule(rows, limits) if has_rules and is_any_stable else None),
        windows=_other_windows(loop, safety) if scene.controller.velocity is None else {},
        at_given_damping=None if damping is None else AroundWall(**rows.at_damping(damping)),
        at_given_stiffness=(
            None if stiffness is None else AroundWall(**rows.at_stiffness(stiffness))
        ),
        walls={name: _around(scene, rows, wall) for name, wall in walls_of(scene).items()},
        all_hands=limit_for_all(scene, safety),
    )


def _around(scene: Scene, rows: "_Rows", wall: Gains) -> AroundWall:
    """The limits around a wall; other hands are asked only where it is stable at the lowest."""
    found = rows.around(*wall)
    if not found.is_stable or hands_of(scene) is None:
        return found
    ((worst, _),) = worst_on(scene, [wall])
    if worst.is_stable:
        return found
    words = "not proved for every hand"
    if worst.verdict == Verdict.UNSTABLE:
        words = "unstable for some hand: see jaxstab check"
    return replace(found, exception=words)


def _over_delays(scene: Scene) -> Limits:
    """Return the stiffest wall that is proved for a range of delays, and the verdicts on walls."""
    wanted, loops, controller = scene.wanted, loops_over_delays(scene), scene.controller
    walls = walls_of(scene)
    for name in ("at_damping", "at_stiffness"):
        if getattr(wanted, name) is not None:
            raise ValueError(
                f"wanted.{name} is {getattr(wanted, name):g} beside a range of delays; leave it "
                "out, or give one delay."
            )
    unstable, safety, every = None, wanted.safety or 1.0, "constant delay"
    if controller.moves:
        delays, every = delays_of(scene), "sequence of delays"
        moving = loops[0].limits(delays=controller.delays, lost=controller.lost_samples)
        unstable, found = moving.unstable_stiffness, Gains(moving.stiffness, moving.damping)

        def is_proved_wall(stiffness: float, damping: float) -> bool:
            return bool(loops[0].verdict(stiffness, damping, **delays) == Verdict.STABLE)

        best, is_proved = with_safety(found, found.stiffness > 0.0, safety, is_proved_wall)
    else:
        best, is_proved, _ = wall_for_all(scene, safety)
        every = "hand and constant delay" if hands_of(scene) else every
    tried = "not proved" if best.stiffness > 0.0 else "no wall was found"
    return Limits(
        inputs=basis_of(scene),
        safety=wanted.safety,
        hand=at_lowest(scene, _SEE_BELOW) if controller.moves else None,
        best=StiffestWall(
            *best,
            certainty=f"proved for every {every}" if is_proved else tried,
            proved_unstable_at=unstable,
        ),
        walls={
            name: verdict
            for name, (verdict, _) in zip(walls, worst_on(scene, [*walls.values()]), strict=True)
        },
        all_hands=limit_for_all(scene, safety) if controller.moves else None,
    )


@dataclass(frozen=True)
class _Rows:
    """The limits of the walls of a region at given gains, times a factor of safety."""

    loop: HapticLoop
    region: WallRegion
    safety: float

    def stiffest(self, stiffness: float, damping: float) -> tuple[float, float]:
        """Return a largest stiffness times the safety as it is printed, NaN if not stable."""
        return self._printed(stiffness, damping, self.region.stiffness_intervals, Gains)

    def most_damped(self, damping: float, stiffness: float) -> tuple[float, float]:
        """Return a largest damping times the safety as it is printed, and its stiffness."""
        rows = self.region.damping_intervals
        return self._printed(damping, stiffness, rows, lambda b, k: Gains(k, b))

    def _printed(self, limit: float, other: float, rows: Any, wall: Any) -> tuple[float, float]:
        scaled = self.safety * limit
        is_inside = self.safety == 1.0 or self.region.reachable.contains(*wall(scaled, other))
        return printed_wall(
            scaled if is_inside else nan,
            other,
            lambda *gains: self.is_stable(*wall(*gains)),
            lambda beside: rows(np.array([beside]))[0],
        )

    def is_stable(self, stiffness: float, damping: float) -> bool:
        """True if a wall is stable; of one without a spring, a very soft one."""
        soft = 0.0 if self.region.is_empty else 1e-6 * self.region.extent.stiffness
        return bool(self.loop.verdict(stiffness or soft, damping) == Verdict.STABLE)

    def at_damping(self, damping: float, stiffness: float = nan) -> dict[str, Any]:
        """Return the stable stiffnesses at a damping: first those around one, or small ones."""
        line = self.loop.stiffness_intervals(damping)
        first, *others = stable_intervals(line, self.safety, stiffness)
        return {
            "at_damping": damping,
            "stiffness_limits": first,
            "other_stiffnesses": numbered(others),
            "linear_rule_stiffness": self.linear_rule(damping) if is_plain(self.loop) else None,
        }

    def at_stiffness(self, stiffness: float, damping: float = nan) -> dict[str, Any]:
        """Return the stable dampings at a stiffness: first those around one, or small ones."""
        line = self.loop.damping_intervals(stiffness)
        first, *others = stable_intervals(line, self.safety, damping)
        names = "at_stiffness", "damping_limits", "other_dampings"
        return dict(zip(names, (stiffness, first, numbered(others)), strict=True))

    def around(self, stiffness: float, damping: float) -> AroundWall:
        """Return both, and the verdict where nothing holds the position."""
        found = self.at_damping(damping, stiffness) | self.at_stiffness(stiffness, damping)
        code = verdict_with_drift(self.loop, Gains(stiffness, damping))
        return AroundWall(**found, verdict=BUT_FOR_DRIFT if code == BUT_FOR_DRIFT else None)

    def linear_rule(self, damping: float) -> float:
        """Return the largest stiffness of the linear rule at a damping."""
        loop = self.loop
        limit = paper.linear_alpha_limit(
            loop.beta(damping), delta=loop.delta, delay=loop.delay_samples
        )
        return self.safety * loop.stiffness(float(limit))


def numbered(values: Iterable[Any]) -> dict[str, Any]:
    """Return values by their numbers, from 1 on."""
    return {str(number): value for number, value in enumerate(values, 1)}


def stable_intervals(line: StableLine, safety: float, value: float) -> list[tuple[float, float]]:
    """Return the intervals of a line, times the safety: that of a value comes first.

    Else that of small gains does, or the farthest. ValueError where they are not proved.
    """
    if line.status != LineStatus.PROVED:
        raise ValueError(
            "the intervals of stable gains were not resolved; change one value a little."
        )
    scaled = [inwards(low, high, safety) for low, high in inner_ends(line)]
    scaled = [(low, high) for low, high in scaled if low <= high] or [(nan, nan)]
    holding = [k for k, (low, high) in enumerate(scaled) if low <= value <= high]
    small = [k for k, (low, high) in enumerate(scaled) if low <= 0.0 < high]
    (first,) = (holding or small or [len(scaled) - 1])[:1]
    return [scaled[first], *scaled[:first], *scaled[first + 1 :]]


def inner_ends(line: StableLine) -> list[tuple[float, float]]:
    """The ends of the intervals of a line, within their errors."""
    return [(_inner(low, 1.0), _inner(high, -1.0)) for low, high in line.intervals]


def _inner(end: End, way: float) -> float:
    """An end, or the next number inside that is proved; 0 where it cannot be told from that."""
    return 0.0 if abs(end.value) <= end.error else end.value + way * end.error


def inwards(low: float, high: float, safety: float) -> tuple[float, float]:
    """Return the limits of an interval, each moved inwards by a factor; NaN where nothing stays."""
    # Limits of one sign are moved away from it: a lower one above 0 is divided by the factor.
    low = low * safety if low < 0.0 else low / safety
    high = high * safety if high > 0.0 else high / safety
    return (low, high) if low <= high else (nan, nan)


def _linear_rule(rows: "_Rows", limits: WallLimits) -> StiffestWall:
    stiffness = rows.linear_rule(limits.at_damping)
    exact, words = rows.safety * limits.stiffness, "an approximation for small gains"
    if exact > 0.0:
        words += f", here {stiffness / exact:.2g} times the exact limit"
    return StiffestWall(stiffness, limits.at_damping, linear_rule_is=words)


def passive_walls(loop: HapticLoop) -> Floats:
    """The outline (K, B) of the walls that are passive with the damping of a loop of one mass."""
    own = loop.device_damping * loop.sample_time / loop.mass
    corners = paper.passive_region(delta=own, delay=loop.delay_samples).outline
    return np.column_stack([loop.stiffness(corners[:, 0]), loop.damping(corners[:, 1])])


def _passive(rows: _Rows) -> StiffestWall:
    walls = passive_walls(rows.loop)
    stiffness, damping = walls[np.argmax(walls[:, 0])].tolist() if len(walls) else (0.0, 0.0)
    return StiffestWall(*printed_wall(rows.safety * stiffness, damping, rows.is_stable))


def _other_windows(loop: HapticLoop, safety: float) -> dict[str, StiffestWall]:
    """The largest stiffness with windows that haptics software uses; unresolved ones left out."""
    answers = {}
    for samples in (10, 20):  # 10 and 20 ms at 1 kHz
        other = replace(loop, velocity=Velocity.difference(samples))
        region = other.region()
        if region.status != RegionStatus.UNRESOLVED:
            stiffest = _Rows(other, region, safety).stiffest(*region.limits()[:2])
            answers[str(samples)] = StiffestWall(*stiffest)
    return answers
