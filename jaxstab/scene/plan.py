"""The plan for a scene: what is computed, what is skipped, and why."""

from typing import NamedTuple

from jaxstab.scene.loops import hands_of
from jaxstab.scene.scene import ANSWERS, MEASURES, Scene


class Step(NamedTuple):
    """One thing that a scene may ask for: whether it is computed, and why or why not."""

    what: str
    computed: bool
    why: str


def plan_scene(scene: Scene) -> list[Step]:
    """Return what is computed for a scene and what is skipped."""
    wanted = scene.wanted
    asked = {name: name in wanted.answers for name in ANSWERS}
    reason = {True: "wanted.answers has it", False: "wanted.answers does not have it"}
    steps = [Step(name, asked[name], reason[asked[name]]) for name in ("limits", "tune", "design")]
    for key, what in (("at_damping", "stiffness limits"), ("at_stiffness", "damping limits")):
        given = getattr(wanted, key) is not None
        why = f"wanted.{key} is {'given' if given else 'not given'}"
        steps.append(Step(f"{what} at a given {key[3:]}", given and asked["limits"], why))
    checked = f"for each of {len(scene.walls)} walls" if asked["check"] else reason[False]
    steps.append(Step("certified verdicts", asked["check"], checked))
    for name in MEASURES:
        is_wanted = name in wanted.measures
        why = checked if is_wanted else "wanted.measures does not have it"
        if name == "chatter" and scene.device.encoder is None:
            is_wanted, why = False, "device.encoder is not given"
        steps.append(Step(name, asked["check"] and is_wanted, why))
    varies = hands_of(scene) is not None
    is_over = varies or bool(wanted.mass_tolerance) or bool(wanted.delay_tolerance)
    why = "neither hand nor mass nor a tolerance of mass or delay is a range"
    why = "a hand, the mass or a tolerance is a range" if is_over else why
    steps.append(Step("tune over ranges", is_over and asked["tune"], why))
    why = "the hand or the mass is a range" if varies else "there is one hand at most, and one mass"
    steps.append(Step("worst case over the hands", varies, why))
    steps.append(Step("proof for all hands", varies, why))
    return steps
