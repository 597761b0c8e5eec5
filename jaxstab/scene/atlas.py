"""An atlas for the device, the hands and the delays of a scene: its specification, its answers."""

from itertools import product
from typing import Any

import numpy as np

from jaxstab.atlas import Atlas, AtlasSpec
from jaxstab.scene.answers import Inputs, basis_of, blocks_of
from jaxstab.scene.loops import corners_of, loop_of_member, walls_of, with_tolerances
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


def ask_atlas(scene: Scene, atlas: Atlas) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Ask ``Atlas.query`` about the walls of a scene, at each corner of its ranges.

    Returns inputs and units as JSON has them, and a row for each wall and corner.
    """
    scene.require_walls()
    walls, si, moved = walls_of(scene), scene.units, scene.units.moved
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
    stated = Inputs(basis_of(scene)).as_json()
    stated["inputs"] |= {"created_by": atlas.created_by}
    stated["units"] |= units
    return stated, rows


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
