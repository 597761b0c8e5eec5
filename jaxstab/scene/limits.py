"""What a scene allows: the largest stiffness and damping, beside the simple rules."""

from dataclasses import dataclass

from jaxstab.criteria import linear_alpha_limit, passive_region
from jaxstab.loop import HapticLoop, WallRegion
from jaxstab.ranges import HandRange
from jaxstab.scene.answers import (
    Answer,
    Damping,
    DampingLimits,
    LargestDamping,
    LargestStiffness,
    Mass,
    Stiffness,
    StiffnessBound,
    StiffnessLimits,
)
from jaxstab.scene.loops import hands_of, loop_of, wall_region, walls_of
from jaxstab.scene.scene import Scene

LOWEST_HAND = "at its lowest values, where nothing else is said"


@dataclass(frozen=True)
class StiffestWall(Answer):
    """The largest stable stiffness, and where it is reached."""

    largest_stiffness: LargestStiffness
    at_damping: Damping


@dataclass(frozen=True)
class MostDampedWall(Answer):
    """The largest stable damping, and where it is reached."""

    largest_damping: LargestDamping
    at_stiffness: Stiffness


@dataclass(frozen=True)
class StiffnessesAtDamping(Answer):
    """The stable stiffnesses at a damping, and the largest one of the linear rule."""

    at_damping: Damping
    stiffness_limits: StiffnessLimits
    linear_rule_stiffness: LargestStiffness


@dataclass(frozen=True)
class DampingsAtStiffness(Answer):
    """The stable dampings at a stiffness."""

    at_stiffness: Stiffness
    damping_limits: DampingLimits


@dataclass(frozen=True)
class AroundWall(DampingsAtStiffness, StiffnessesAtDamping):
    """The stable stiffnesses at the damping of a wall, and the dampings at its stiffness."""


@dataclass(frozen=True)
class HeldBy(Answer):
    """A hand."""

    mass: Mass
    stiffness: Stiffness
    damping: Damping


@dataclass(frozen=True)
class AllHands(Answer):
    """A wall for all hands of a range, nearly the stiffest, and a proved bound of all."""

    largest_stiffness: LargestStiffness
    at_damping: Damping
    certainty: str
    none_is_stiffer_than: StiffnessBound
    worst_hand: HeldBy


@dataclass(frozen=True)
class Limits(Answer):
    """What a scene allows, with the hand at its lowest values."""

    best: StiffestWall
    most_damped: MostDampedWall
    passive: StiffestWall
    linear_rule: StiffestWall | None
    at_given_damping: StiffnessesAtDamping | None
    at_given_stiffness: DampingsAtStiffness | None
    walls: dict[str, AroundWall]
    hand: str | None
    all_hands: AllHands | None


def scene_limits(scene: Scene) -> Limits:
    """Return the largest stiffness and damping, the linear rule, the passive limit, all hands.

    Raises:
        ValueError: a quantity is out of range, or the stable region is not resolved.
    """
    loop, wanted, hands = loop_of(scene), scene.wanted, hands_of(scene)
    region = wall_region(loop)
    stiffest, most_damped = region.stiffest, region.most_damped
    damping, stiffness = wanted.at_damping, wanted.at_stiffness
    is_empty = region.is_empty
    return Limits(
        best=StiffestWall(*stiffest),
        most_damped=MostDampedWall(most_damped.damping, most_damped.stiffness),
        passive=_passive(loop),
        linear_rule=None if is_empty else _linear_rule(loop, stiffest.damping),
        at_given_damping=None if damping is None else _at_damping(loop, region, damping),
        at_given_stiffness=None if stiffness is None else _at_stiffness(region, stiffness),
        walls={
            f"wall {name}": _around(loop, region, *gains) for name, gains in walls_of(scene).items()
        },
        hand=LOWEST_HAND if hands else None,
        all_hands=_for_all(loop, hands) if hands else None,
    )


def held_by(loop: HapticLoop) -> HeldBy:
    """Return the hand of a loop."""
    return HeldBy(loop.hand_mass, loop.hand_stiffness, loop.hand_damping)


def _passive(loop: HapticLoop) -> StiffestWall:
    own = loop.device_damping * loop.sample_time / loop.mass
    alpha, beta = passive_region(own, loop.delay_samples).max_alpha
    return StiffestWall(float(loop.stiffness(alpha)), float(loop.damping(beta)))


def _linear_rule(loop: HapticLoop, damping: float) -> StiffestWall:
    limit = linear_alpha_limit(loop.beta(damping), loop.delta, loop.delay_samples)
    return StiffestWall(loop.stiffness(float(limit)), damping)


def _at_damping(loop: HapticLoop, region: WallRegion, damping: float) -> StiffnessesAtDamping:
    low, high = region.stiffness_limits(damping).tolist()
    rule = _linear_rule(loop, damping).largest_stiffness
    return StiffnessesAtDamping(damping, (low, high), rule)


def _at_stiffness(region: WallRegion, stiffness: float) -> DampingsAtStiffness:
    low, high = region.damping_limits(stiffness).tolist()
    return DampingsAtStiffness(stiffness, (low, high))


def _around(loop: HapticLoop, region: WallRegion, stiffness: float, damping: float) -> AroundWall:
    return AroundWall(
        **vars(_at_damping(loop, region, damping)), **vars(_at_stiffness(region, stiffness))
    )


def _for_all(loop: HapticLoop, hands: HandRange) -> AllHands:
    found = loop.robust_limit(hands)
    return AllHands(
        largest_stiffness=found.stiffness,
        at_damping=found.damping,
        certainty="proved for every hand" if found.is_proved else "not proved",
        none_is_stiffer_than=found.limit,
        worst_hand=held_by(found.loop),
    )
