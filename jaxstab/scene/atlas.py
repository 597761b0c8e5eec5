"""An atlas for the device, the hands and the delays of a scene: its specification, its answers."""

from collections.abc import Mapping
from itertools import product
from typing import Any

import numpy as np

from jaxstab.atlas import Atlas, AtlasSpec
from jaxstab.loop import Gains
from jaxstab.scene.answers import blocks_of
from jaxstab.scene.loops import corners_of, loop_of_member, with_tolerances
from jaxstab.scene.scene import Scene
from jaxstab.shown import printable


def atlas_spec(scene: Scene) -> AtlasSpec:
    """The specification of an atlas for all loops of a scene's ranges.

    Gamma and delta have their extremes at the corners of the ranges of mass and hand, for they are
    monotone in each.
    """
    loops = [loop_of_member(scene, member) for member in corners_of(scene)]
    if loops[0].body is None:
        raise TypeError(
            "an atlas covers devices that are one mass with their hand; leave out device.modes, "
            "device.actuator and hand.grip."
        )
    shortest, *_, longest = sorted(float(loop.delay_samples) for loop in 2 * loops)
    delay_nodes = 8  # to a sample, along a range of delays
    count = int(delay_nodes * (longest - shortest)) + 2
    return AtlasSpec(
        gamma=_nodes([loop.gamma for loop in loops]),
        delta=_nodes([loop.delta for loop in loops]),
        delay=np.unique(np.linspace(shortest, longest, count)).tolist(),
        **loops[0].filters,
    )


def ask_atlas(
    scene: Scene, atlas: Atlas, walls: Mapping[str, Gains]
) -> tuple[dict[str, str], list[dict[str, Any]]]:
    """Answers of ``Atlas.query`` about walls, for the loop at each corner of a scene's ranges.

    Returns the units of what varies, by its name, and a row for each wall and corner.
    """
    si, moved = scene.units, scene.units.moved
    units = {
        "stiffness": si.stiffness,
        "damping": si.damping,
        moved: si.kilogram,
        f"hand_{moved}": si.kilogram,
        "hand_stiffness": si.stiffness,
        "hand_damping": si.damping,
        "delay": "s",
    }
    corners = corners_of(scene)
    views = [atlas.for_loop(loop_of_member(scene, corner)) for corner in corners]
    rows = []
    for (name, gains), (corner, view) in product(walls.items(), zip(corners, views, strict=True)):
        hand, answer = corner.hand, view.query(*gains)
        varied = corner.mass, hand.mass, hand.stiffness, hand.damping, corner.delay
        row = dict(zip(units, (*gains, *varied), strict=True))
        codes = {"verdict": answer.verdict.item(), "status": answer.status.item()}
        rows.append({"wall": name} | row | codes)
    return units, rows


def spec_text(scene: Scene, name: str) -> str:
    """The text of a scene's specification, which begins with a description."""
    text = atlas_spec(scene).to_toml()
    blocks = blocks_of(with_tolerances(scene))
    lines = [name, *(f"{block}: {words}" for block, words in blocks.items())]
    # A control character would end the comment.
    return "".join(f"# {printable(line)}\n" for line in lines) + "\n" + text


def _nodes(values: list[float]) -> list[float]:
    low, high = min(values), max(values)
    nodes: list[float] = [low] if low == high else [low, 0.5 * (low + high), high]
    return nodes
