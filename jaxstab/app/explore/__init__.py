"""One self-contained page that draws the stable walls of a scene while sliders move it."""

import json
from importlib.resources import files
from math import isfinite
from typing import Any

from jaxstab.answers import Units
from jaxstab.app.scene import Scene
from jaxstab.app.scene.answers import delay_notes
from jaxstab.app.scene.loops import hands_of, is_one_mass, loop_of, wall_region, walls_of
from jaxstab.app.scene.scene import (
    FINGER,
    ContactTable,
    HandTable,
    VelocityTable,
    presets,
    values_in,
)
from jaxstab.model.filter_tables import NO_FILTER
from jaxstab.model.filters import Velocity, exact_chain, rounded

SCRIPTS = (
    *("plant", "polynomial", "loop", "region", "wall", "contact", "rules", "state"),
    *("picture", "controls", "words", "page"),
)
"""The page's scripts, in their order; those of the first line need no page."""


def explorer_page(scene: Scene, title: str = "") -> str:
    """A self-contained page of HTML that begins with a scene, at the lowest values of its ranges.

    Of a range of delays it takes the longest one, as a constant delay.

    ValueError: a quantity is out of range, or the page cannot compute the scene: it has a filter of
    the position, a device that is not one mass, or more than 200 samples of delay.
    """
    _refuse_others(scene)
    is_range = scene.hand is not None and scene.hand.varies
    initial = {
        "state": _state(scene),
        "units": {
            units.name.lower(): {"stiffness": units.stiffness, "damping": units.damping}
            for units in Units
        },
        "software": _software(),
        "hands": {"lowest": _hand(scene, 0), "highest": _hand(scene, 1)} if is_range else None,
        "notes": _notes(scene, title),
    }
    text = json.dumps(initial, allow_nan=False)
    parts = {
        "/*STYLE*/": _text("page.css"),
        "/*SCRIPT*/": "\n".join(map(script, SCRIPTS)),
        "/*INITIAL*/": text.replace("<", "\\u003c"),  # nothing in it ends the script
    }
    page = _text("page.html")
    for marker, part in parts.items():
        page = page.replace(marker, part)
    return page


def script(name: str) -> str:
    """Return one of the page's scripts."""
    return _text(f"{name}.js")


def _text(name: str) -> str:
    return files("jaxstab.app.explore").joinpath(name).read_text(encoding="utf-8")


def _refuse_others(scene: Scene) -> None:
    longest_delay = 200.0  # samples
    remedy = "leave it out, or draw the scene with jaxstab limits --plot."
    if scene.controller.position is not None:
        raise ValueError(
            "controller.position is given, but the explorer knows of no filter of the position; "
            f"{remedy}"
        )
    if not is_one_mass(scene):
        raise ValueError(
            "the device has a mode, an actuator or a grip, but the explorer knows of devices and "
            f"hands of one mass only; {remedy}"
        )
    if scene.controller.samples > longest_delay:
        raise ValueError(
            f"the delay is {scene.controller.samples:g} samples, and the explorer computes at most "
            f"{longest_delay:g}; draw the scene with jaxstab limits --plot."
        )


def _state(scene: Scene) -> dict[str, Any]:
    loop, device, (push, speed) = loop_of(scene.at_longest_delay), scene.device, scene.start
    limits = wall_region(loop).limits()
    # The first wall shown: half as stiff as the stiffest, if any is stable.
    shown = (0.5 * limits.stiffness, limits.at_damping) if isfinite(limits.stiffness) else (0, 0)
    stiffness, damping = (float(f"{gain:.2g}") for gain in shown)
    return {
        "mass": device.effective_mass[0],
        "damping": device.effective_damping,
        **_hand(scene, 0),
        "period": scene.controller.sample_time,
        "delay": loop.delay_samples,
        **_estimator(scene.controller.velocity, scene.controller.sample_time),
        "cursorStiffness": stiffness,
        "cursorDamping": damping,
        "motion": scene.units.name.lower(),
        "view": "near",
        "contact": "on" if scene.contact and push else "off",
        "friction": device.friction,
        "push": push or FINGER[scene.units][0],  # an ordinary one where there is none
        "speed": speed,
        "encoder": device.encoder.resolution if device.encoder else 0.0,
        "walls": [
            {"name": name, "stiffness": wall.stiffness, "damping": wall.damping}
            for name, wall in walls_of(scene).items()
        ],
    }


def _hand(scene: Scene, end: int) -> dict[str, float]:
    """Return the hand at the lowest (0) or highest (1) ends of its range."""
    names, hand = ("handMass", "handStiffness", "handDamping"), scene.hand or HandTable()
    return {name: ends[end] for name, ends in zip(names, hand.ranges, strict=True)}


def _estimator(table: VelocityTable | None, period: float) -> dict[str, Any]:
    window = None if table is None else table.window
    samples = None if table is None else table.window_samples
    length = samples or (1 if window is None else max(1, round(window / period)))
    given = {key: getattr(table, key, None) or usual for key, usual in NO_FILTER.items()}
    if table is not None and table.is_other_estimator:
        length, given = 1, {**NO_FILTER, **_coefficients(table.as_velocity(), period)}
    return {"window": length, **given}


def _coefficients(velocity: Velocity, period: float) -> dict[str, list[float]]:
    """Return V(z) in 1/s by its coefficients, highest power of z first."""
    above, below = exact_chain(velocity.filter.checked(period).sections)
    sides = (rounded(above - above.left_shift(1)) / period).tolist(), rounded(below).tolist()
    length = max(map(len, sides))
    numerator, denominator = ([*side, *[0.0] * (length - len(side))] for side in sides)
    return {"numerator": numerator, "denominator": denominator}


def _software() -> list[dict[str, Any]]:
    """Return the velocity estimators of software, as far as their makers document them."""
    keys = ("window", *NO_FILTER)
    estimators = {name: values_in(own, keys) for name, own in presets("software").items()}
    plain: list[dict[str, Any]] = [{"title": "the difference over one sample, as in the paper"}]
    return plain + [{"title": name, **values} for name, values in estimators.items() if values]


def _notes(scene: Scene, title: str) -> list[str]:
    """Notes on the numbers that the page begins with."""
    notes = [f"{note.capitalize()}." for note in delay_notes(scene)]
    notes += [f"It begins with {title}."] if title else []
    if hands_of(scene) is not None:
        notes.append("The scene has ranges: the page begins with their lowest values.")
    if scene.controller.velocity is None:
        notes.append("The scene names no estimator: the difference over one sample is assumed.")
    if scene.controller.velocity is not None and scene.controller.velocity.is_other_estimator:
        notes.append("Its estimator keeps its coefficients where the sampling period changes.")
    given, device, controller = scene.contact, scene.device, scene.controller
    ignored = {  # that only Python simulates: the page pushes against a one-sided wall
        "device.static_friction": device.static_friction is not None,
        "controller.max_force": controller.max_force is not None,
        "controller.force_step": controller.force_step > 0.0,
        "contact.one_sided": given and not given.one_sided,
        "contact.gate": given and given.gate != ContactTable.gate,
        "contact.duration": given and given.duration != ContactTable.duration,
    }
    names = ", ".join(name for name, is_given in ignored.items() if is_given)
    if given and names:
        notes.append(f"Simulated contacts on this page ignore {names} of the scene.")
    return notes
