"""What a scene allows, how its walls do, the best walls and the design: in SI units, for JSON.

Every answer is a dictionary of numbers, words and dictionaries. Where the hand is a range, numbers
are for its lowest ends unless they say otherwise.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from math import inf, isfinite, isinf
from typing import Any

import numpy as np

from jaxstab.conventions import Verdict
from jaxstab.criteria import linear_alpha_limit, passive_region
from jaxstab.model import HapticLoop
from jaxstab.model.parameters import DELTA_LIMIT, GAMMA_LIMIT
from jaxstab.motion import SettlingStatus, dominant_oscillation, settling_time
from jaxstab.point import spectral_radius, verdict
from jaxstab.ranges import HandRange, margins, robust_limit, worst_hand
from jaxstab.ranges.margins import MOST_DELAY
from jaxstab.region import boundary_distance, damping_limits, stiffness_limits, wall_limits
from jaxstab.region.limits import stiffest_wall
from jaxstab.scene.scene import Hand, Scene, Wall
from jaxstab.tuning import optimal_gains

_LOWEST = {"hand": "at its lowest values, where nothing else is said"}
_AGREEMENT = 1e-8  # relative, of a designed sample time or delay
_HORIZON = 2**17  # samples within which settling is looked for
_MOST_SAMPLES = 256.0  # of delay, looked at in a design
_FACTOR = 1024.0  # how much longer or shorter a sample time is looked for
_LEAST = 1e-3  # of a sample: smaller delays count as none at first


def loop_of(scene: Scene) -> HapticLoop:
    """Return the loop of a scene with the hand at the lowest ends of its range.

    Raises:
        ValueError: a quantity is out of range.
    """
    hand = scene.hand or Hand()
    _check_scale(scene)
    return HapticLoop(
        device_mass=scene.device.mass,
        device_damping=scene.device.damping,
        sample_time=scene.controller.sample_time,
        hand_mass=hand.mass[0],
        hand_damping=hand.damping[0],
        hand_stiffness=hand.stiffness[0],
        delay=scene.controller.time_delay,
    )


def _check_scale(scene: Scene) -> None:
    """Refuse hands and dampers that the model cannot compute, in the words of a scene."""
    hand, period = scene.hand or Hand(), scene.controller.sample_time
    per_speed = period / (scene.device.mass + hand.mass[0])
    damping = scene.device.damping + hand.damping[1]
    for words, value, most in (
        ("hand.stiffness T^2/mass", hand.stiffness[1] * period * per_speed, GAMMA_LIMIT),
        ("damping T/mass of device and hand", damping * per_speed, DELTA_LIMIT),
    ):
        if not value <= most:
            raise ValueError(
                f"{words} is {value:g}, where T is the sample_time, and at most {most:g} can be "
                "computed; check the units."
            )


def hands_of(scene: Scene) -> HandRange | None:
    """Return the range of hands, or None where there is one hand at most."""
    hand = scene.hand
    return HandRange(hand.mass, hand.stiffness, hand.damping) if hand and hand.varies else None


def limits(scene: Scene) -> dict[str, Any]:
    """Return the largest stiffness and damping, the linear rule, the passive limit, all hands.

    Raises:
        ValueError: a quantity is out of range.
        RuntimeError: JAX's x64 mode is off.
    """
    loop, wanted = loop_of(scene), scene.wanted
    best = wall_limits(loop)
    own = loop.device_damping * loop.sample_time / loop.mass
    passive = passive_region(own, loop.delay_samples).max_alpha
    answer: dict[str, Any] = {
        "best": {"largest_stiffness": best.stiffness, "at_damping": best.at_damping},
        "most_damped": {"largest_damping": best.damping, "at_stiffness": best.at_stiffness},
        "passive": {
            "largest_stiffness": float(loop.stiffness(passive[0])),
            "at_damping": float(loop.damping(passive[1])),
        },
    }
    if isfinite(best.at_damping):
        answer["linear_rule"] = _linear_rule(loop, best.at_damping)
    if wanted.at_damping is not None:
        answer["at_given_damping"] = _at_damping(loop, wanted.at_damping)
    if wanted.at_stiffness is not None:
        answer["at_given_stiffness"] = _at_stiffness(loop, wanted.at_stiffness)
    for name, wall in scene.walls.items():
        answer[f"wall {name}"] = _at_damping(loop, wall.damping) | _at_stiffness(
            loop, wall.stiffness
        )
    hands = hands_of(scene)
    if hands:
        answer |= _LOWEST
        found = robust_limit(loop, hands)
        answer["all_hands"] = {
            "largest_stiffness": found.stiffness,
            "at_damping": found.damping,
            "certainty": "proved for every hand" if found.is_proved else "not proved",
            "sampled_hands_allow_stiffness": found.limit,
            "worst_hand": _hand(found.loop),
        }
    return answer


def check(scene: Scene) -> dict[str, Any]:
    """Return for each wall its verdict and the measures that are wanted, at the worst hand.

    Raises:
        ValueError: there is no wall, or a quantity is out of range.
        RuntimeError: JAX's x64 mode is off.
    """
    scene.require_walls()
    return {name: _checked(scene, wall) for name, wall in scene.walls.items()}


def all_stable(checked: dict[str, Any]) -> bool:
    """Whether ``check`` found every wall stable, by proof."""
    return all(wall["verdict"] == Verdict.STABLE.name.lower() for wall in checked.values())


def tune(scene: Scene) -> dict[str, Any]:
    """Return the walls that come to rest fastest, and the best damping at the stiffnesses given.

    Raises:
        ValueError: a quantity is out of range.
        RuntimeError: JAX's x64 mode is off.
    """
    loop = loop_of(scene)
    stiffest, _ = stiffest_wall(loop)
    answer = {
        "least_radius": _best(scene, loop, "radius", stiffest),
        "least_settling": _best(scene, loop, "settling", stiffest),
    }
    given = {f"wall {name}": wall.stiffness for name, wall in scene.walls.items()}
    if scene.wanted.at_stiffness is not None:
        given["at_given_stiffness"] = scene.wanted.at_stiffness
    for name, stiffness in given.items():
        answer[name] = _best(scene, loop, "settling", stiffest, stiffness)
    return answer | (_LOWEST if hands_of(scene) else {})


def design(scene: Scene) -> dict[str, Any]:
    """Return the largest sample time, and the largest delay, that allow the wanted stiffness.

    A delay given in samples grows with the sample time. The damping is the one that allows most.

    Raises:
        ValueError: no stiffness is wanted, or a quantity is out of range.
        RuntimeError: JAX's x64 mode is off.
    """
    stiffness = scene.wanted.stiffness
    if stiffness is None:
        raise ValueError("wanted.stiffness is missing; give the stiffness to design for in N/m.")
    loop = loop_of(scene)
    in_samples = scene.controller.delay_samples

    def sampled(period: float) -> HapticLoop:
        delay = loop.delay if in_samples is None else in_samples * period
        return replace(loop, sample_time=period, delay=delay)

    def delayed(delay: float) -> HapticLoop:
        return replace(loop, delay=delay)

    period = _largest(
        lambda value: stiffest_wall(sampled(value))[0] / stiffness - 1.0,
        loop.sample_time,
        max(loop.sample_time / _FACTOR, loop.delay / _MOST_SAMPLES if in_samples is None else 0.0),
        loop.sample_time * _FACTOR,
    )
    delay = _largest(
        lambda value: stiffest_wall(delayed(value))[0] / stiffness - 1.0,
        loop.sample_time,
        0.0,
        _MOST_SAMPLES * loop.sample_time,
    )
    answer: dict[str, Any] = {
        "stiffness": stiffness,
        "now_allowed_stiffness": stiffest_wall(loop)[0],
    }
    answer["sample_time"] = {"largest_sample_time": period}
    if period is not None and isfinite(period):
        answer["sample_time"] |= {"at_damping": stiffest_wall(sampled(period))[1]}
    answer["delay"] = {"largest_delay": delay}
    if delay is not None and isfinite(delay):
        answer["delay"] |= {"at_damping": stiffest_wall(delayed(delay))[1]}
    return answer | (_LOWEST if hands_of(scene) else {})


def _linear_rule(loop: HapticLoop, damping: float) -> dict[str, float]:
    limit = linear_alpha_limit(loop.beta(damping), loop.delta, loop.delay_samples)
    return {"largest_stiffness": loop.stiffness(float(limit)), "at_damping": damping}


def _at_damping(loop: HapticLoop, damping: float) -> dict[str, Any]:
    return {
        "at_damping": damping,
        "stiffness_limits": stiffness_limits(loop, damping).tolist(),
        "linear_rule_stiffness": _linear_rule(loop, damping)["largest_stiffness"],
    }


def _at_stiffness(loop: HapticLoop, stiffness: float) -> dict[str, Any]:
    return {
        "at_stiffness": stiffness,
        "damping_limits": damping_limits(loop, stiffness).tolist(),
    }


def _checked(scene: Scene, wall: Wall) -> dict[str, Any]:
    loop, hands, wanted = loop_of(scene), hands_of(scene), scene.wanted.measures
    gains = (wall.stiffness, wall.damping)
    answer: dict[str, Any] = {"stiffness": gains[0], "damping": gains[1]}
    loops = [loop]
    if hands:
        worst = worst_hand(loop, hands, *gains)
        loop = worst.loop
        loops = list({loop, *corner_loops(loop, hands)})
        answer |= {"verdict": worst.verdict.name.lower(), "worst_hand": _hand(loop)}
    else:
        answer["verdict"] = _verdict(loop, *gains).name.lower()
    measures: dict[str, Callable[..., dict[str, Any]]] = {
        "margins": lambda _, *gains: _margins(loops, *gains),
        "distance": lambda *at: {"distance_to_boundary": float(boundary_distance(*at))},
        "radius": _radius,
        "settling": _settling,
        "oscillation": _oscillation,
    }
    for name, measure in measures.items():
        if name in wanted:
            answer |= measure(loop, *gains)
    return answer


def corner_loops(loop: HapticLoop, hands: HandRange) -> list[HapticLoop]:
    """Return the loop with each hand at the corners of a range.

    Raises:
        ValueError: a quantity is out of range.
    """
    return [
        replace(loop, hand_mass=mass, hand_stiffness=stiffness, hand_damping=damping)
        for mass, stiffness, damping in product(*(sorted(set(ends)) for ends in hands))
    ]


def _verdict(loop: HapticLoop, stiffness: float, damping: float) -> Verdict:
    return Verdict(int(verdict(*_point(loop, stiffness, damping))))


def _point(loop: HapticLoop, stiffness: float, damping: float) -> tuple[float, ...]:
    gains = (loop.alpha(stiffness), loop.beta(damping))
    return (*gains, loop.gamma, loop.delta, loop.delay_samples)


def _margins(loops: list[HapticLoop], stiffness: float, damping: float) -> dict[str, Any]:
    """Return the least margins over some loops."""
    found = [margins(loop, stiffness, damping) for loop in loops]
    ranges = np.array([np.append(one.stiffness, one.damping) for one in found])  # NaN: unstable
    lowest, highest = ranges.max(axis=0).tolist(), ranges.min(axis=0).tolist()
    rest = np.array([[one.stiffness_gain, one.damping_gain, one.extra_delay] for one in found])
    stiffness_gain, damping_gain, extra_delay = rest.min(axis=0).tolist()
    answer: dict[str, Any] = {
        "stiffness_gain": stiffness_gain,
        "damping_gain": damping_gain,
        "stiffness_limits": [lowest[0], highest[1]],
        "damping_limits": [lowest[2], highest[3]],
        "extra_delay": extra_delay,
    }
    if isinf(extra_delay):
        answer["delay_searched"] = MOST_DELAY * loops[0].sample_time
    if len(loops) > 1:
        answer["margins_are"] = f"the least of {len(loops)} hands"
    return answer


def _radius(loop: HapticLoop, stiffness: float, damping: float) -> dict[str, Any]:
    found = spectral_radius(*_point(loop, stiffness, damping))
    return {"spectral_radius": float(found.value), "radius_error": float(found.error)}


def _settling(loop: HapticLoop, stiffness: float, damping: float) -> dict[str, Any]:
    answer: dict[str, Any] = {}
    for percent in (2, 5):
        found = settling_time(loop, stiffness, damping, percent / 100.0, horizon=_HORIZON)
        answer[f"settling_time_{percent}_percent"] = float(found.value)
    return answer | {"settling_status": SettlingStatus(int(found.status)).words}


def _oscillation(loop: HapticLoop, stiffness: float, damping: float) -> dict[str, Any]:
    mode = dominant_oscillation(loop, stiffness, damping)
    return {"damping_ratio": float(mode.damping_ratio), "frequency": float(mode.frequency)}


def _hand(loop: HapticLoop) -> dict[str, float]:
    return {
        "mass": loop.hand_mass,
        "stiffness": loop.hand_stiffness,
        "damping": loop.hand_damping,
    }


def _best(
    scene: Scene, loop: HapticLoop, goal: Any, stiffest: float, stiffness: float | None = None
) -> dict[str, Any]:
    best = optimal_gains(loop, goal, stiffness=stiffness)
    answer = {
        "stiffness": best.stiffness,
        "damping": best.damping,
        "spectral_radius": best.radius,
        "settling_time_2_percent": best.settling_time,
        "share_of_largest": best.stiffness / stiffest,
        "status": best.status.words,
    }
    hands = hands_of(scene)
    if hands and isfinite(best.settling_time):
        worst = worst_hand(loop, hands, best.stiffness, best.damping)
        answer["for_all_hands"] = worst.verdict.name.lower()
    return answer


def _largest(
    spare: Callable[[float], float], start: float, lowest: float, highest: float
) -> float | None:
    """Return the largest value with something to spare, of a function that falls.

    Infinite where ``highest`` leaves some, None where ``lowest`` leaves none.
    """
    low = high = start
    at_low = at_high = spare(start)
    while at_high >= 0.0:
        if high >= highest:
            return inf
        low, at_low, high = high, at_high, min(2.0 * high, highest)
        at_high = spare(high)
    while not at_low >= 0.0:
        if low <= lowest:
            return None
        high, at_high, low = low, at_low, max(0.5 * low, lowest)
        low = lowest if low < _LEAST * start else low
        at_low = spare(low)
    # False position; the weight of an end that stays twice is halved (Illinois).
    last = 0
    while high - low > _AGREEMENT * high:
        share = at_low / (at_low - at_high) if isfinite(at_high) else 0.5
        middle = low + min(max(share, _AGREEMENT / 4), 1.0 - _AGREEMENT / 4) * (high - low)
        at_middle = spare(middle)
        if at_middle >= 0.0:
            low, at_low, at_high = middle, at_middle, at_high * (0.5 if last == 1 else 1.0)
            last = 1
        else:
            high, at_high, at_low = middle, at_middle, at_low * (0.5 if last == -1 else 1.0)
            last = -1
    return low
