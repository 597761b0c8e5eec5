"""An atlas for the device, the hands and the delays of a scene: its specification, its answers."""

from collections.abc import Mapping
from dataclasses import replace
from math import ceil, floor
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas import Atlas, AtlasAnswer, AtlasSpec, FittedAxis
from jaxstab.atlas.plan import extents_of
from jaxstab.loop import Gains, HapticLoop
from jaxstab.scene.answers import basis_of
from jaxstab.scene.loops import Member, corners_of, loop_of_member, ranges_of, walls_of
from jaxstab.scene.scene import Scene, range_in_words
from jaxstab.shown import printable

Outside = Literal["error", "undecided"]

_NODES = {"gamma": 5, "delta": 9}  # along a range
_DELAY_CELLS = 32  # to a sample, along a range of delays
_MOST_LIMIT_CELLS = 2048  # where walls are far beyond the stable set
_ASIDE = 1e-9  # of walls: so far beyond them axes end


def atlas_spec(scene: Scene) -> AtlasSpec:
    """The specification of an atlas for all loops of a scene's ranges.

    Gamma and delta have their extremes at the corners of the ranges of mass and hand, for they are
    monotone in each. Alpha and beta are laid around the stable set and the scene's walls.
    """
    loops = [loop_of_member(scene, member) for member in corners_of(scene)]
    if loops[0].body is None:
        raise TypeError(
            "an atlas covers devices that are one mass with their hand; leave out device.modes, "
            "device.actuator and hand.grip."
        )
    delays = sorted({float(loop.delay_samples) for loop in loops})
    shortest, longest = delays[0], delays[-1]
    whole = map(float, range(floor(shortest) + 1, ceil(longest)))
    spec = AtlasSpec(
        gamma=_nodes("gamma", [loop.gamma for loop in loops]),
        delta=_nodes("delta", [loop.delta for loop in loops]),
        delay=sorted({shortest, longest, *whole}),
        delay_cells=_DELAY_CELLS if shortest < longest else 0,
        products=("verdict", "alpha_limits"),
        **loops[0].filters,
    )
    return _around(spec, loops, list(walls_of(scene).values()))


def _around(spec: AtlasSpec, loops: list[HapticLoop], walls: list[Gains]) -> AtlasSpec:
    """A specification whose axes extend beyond walls, with cells as fine as before."""
    if not walls:
        return spec
    stiffness, damping = (np.array(gains) for gains in zip(*walls, strict=True))
    alpha = np.array([loop.alpha(stiffness) for loop in loops])
    beta = np.array([loop.beta(damping) for loop in loops])
    ends = extents_of(spec).ends
    highest, lowest_beta, highest_beta = (
        float(end) for end in (ends[:, 0].min(), ends[:, 1].max(), ends[:, 2].min())
    )
    axes = (
        _beyond("alpha", spec, alpha, (-min(loop.gamma for loop in loops), highest)),
        _beyond("beta", spec, beta, (lowest_beta, highest_beta)),
    )
    width = np.ptp([*beta.flat, lowest_beta, highest_beta]) / (highest_beta - lowest_beta)
    cells = min(ceil(spec.limit_cells * width), max(_MOST_LIMIT_CELLS, spec.limit_cells))
    return replace(spec, alpha=axes[0], beta=axes[1], limit_cells=cells)


def _beyond(
    name: str, spec: AtlasSpec, gains: NDArray[np.float64], ends: tuple[float, float]
) -> FittedAxis:
    """An axis that extends beyond gains, where these are beyond the stable set."""
    axis: FittedAxis = getattr(spec, name)
    low, high = float(np.min(gains)), float(np.max(gains))
    aside = _ASIDE * max(abs(low), abs(high))
    return replace(
        axis,
        least=low - aside if low < ends[0] else None,
        most=high + aside if high > ends[1] else None,
    )


class AskedWall(NamedTuple):
    """The answer of an atlas about a wall at a corner of a scene's ranges."""

    name: str
    gains: Gains
    member: Member
    answer: AtlasAnswer


def ask_atlas(
    scene: Scene, atlas: Atlas, walls: Mapping[str, Gains], outside: Outside, *, exact: bool
) -> list[AskedWall]:
    """Answers of ``Atlas.query`` about walls, for the loop at each corner of a scene's ranges."""
    corners = corners_of(scene)
    views = [atlas.for_loop(loop_of_member(scene, corner)) for corner in corners]
    return [
        AskedWall(name, gains, corner, view.query(*gains, outside, exact=exact))
        for name, gains in walls.items()
        for corner, view in zip(corners, views, strict=True)
    ]


def spec_text(scene: Scene, name: str) -> str:
    """The text of a scene's specification, which begins with a description."""
    text = atlas_spec(scene).to_toml()
    units, basis = scene.units, basis_of(scene)
    mass, hand_mass, stiffness, damping, delay = (range_in_words(ends) for ends in ranges_of(scene))
    lines = [
        f"{name}",
        f"{units.moved} of the device: {mass} {units.kilogram}",
        f"damping of the device: {scene.device.damping:g} {units.damping}",
        f"hand: {hand_mass} {units.kilogram}, {stiffness} {units.stiffness}, "
        f"{damping} {units.damping}",
        f"sample time: {scene.controller.sample_time:g} s; delay: {delay} s",
        f"velocity: {basis.velocity}",
        *([] if basis.position is None else [f"position: {basis.position}"]),
    ]
    # A control character would end the comment.
    return "".join(f"# {printable(line)}\n" for line in lines) + "\n" + text


def _nodes(name: str, values: list[float]) -> list[float]:
    low, high = min(values), max(values)
    nodes: list[float] = [low] if low == high else np.linspace(low, high, _NODES[name]).tolist()
    return nodes
