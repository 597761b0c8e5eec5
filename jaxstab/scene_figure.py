"""A picture of a scene: what is stable in the plane of K and B, its walls, and how they respond."""

from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from jaxstab.boundary import damping_limits, passive_region, stiffness_limits, wall_limits
from jaxstab.front import corner_loops, hands_of, loop_of
from jaxstab.model import HapticLoop
from jaxstab.paper import BLACK, BLUE, GREEN, ORANGE, RED, SKY
from jaxstab.scene import Scene
from jaxstab.stability import optimal_gains, simulate

_ROWS = 400
_EDGE = 1e-6  # of the largest stiffness: how near to the corner the least damping is taken
_FEWEST, _MOST = 100, 4000  # samples of a response
_BAND = 0.02
_GONE = 5.0  # final positions: an unstable response is drawn no further
_HEIGHT = 4.6  # inches
_LOWEST = " (hand at its lowest values)"

Floats = NDArray[np.float64]


class _Look(NamedTuple):
    """How a wall of a verdict is drawn: told apart by colour and by form."""

    colour: str
    marker: str
    line: str


_LOOKS = {
    "stable": _Look(BLUE, "o", "-"),
    "unstable": _Look(RED, "X", ":"),
    "undecided": _Look(BLACK, "s", "--"),
}


def scene_figure(scene: Scene, checked: dict[str, Any] | None = None) -> Figure:
    """Draw the stable region in the plane of K and B, in SI units, and the walls in it.

    Args:
        scene: the scene.
        checked: what ``check`` found for its walls. Then the walls are drawn, with their responses
            to a step of force in a second panel.

    Raises:
        ValueError: no wall is stable, there is nothing to draw.
        RuntimeError: JAX's x64 mode is off.

    Source: sec. V to VIII of Hulin, Preusche, Hirzinger (2008).
    """
    loop = loop_of(scene)
    figure = Figure(figsize=(6.4 if checked is None else 11.2, _HEIGHT))
    figure.set_layout_engine("constrained")
    panels = figure.subplots(1, 1 if checked is None else 2, squeeze=False)[0]
    _draw_region(panels[0], scene, loop)
    if checked is not None:
        _draw_walls(panels[0], checked)
        _draw_responses(panels[1], loop, checked)
        panels[1].set_title(
            "a constant push, and the band of 2 %" + (_LOWEST if hands_of(scene) else "")
        )
    handles, labels = panels[0].get_legend_handles_labels()
    columns = 2 if checked is None else 4
    figure.legend(
        handles, labels, fontsize=8, frameon=False, ncols=columns, loc="outside lower center"
    )
    return figure


def _draw_region(panel: Axes, scene: Scene, loop: HapticLoop) -> None:
    best = wall_limits(loop)
    if not isfinite(best.stiffness):
        raise ValueError("no wall is stable for this scene; there is nothing to draw.")
    edge = -loop.hand_stiffness + _EDGE * (best.stiffness + loop.hand_stiffness)
    least = float(damping_limits(loop, edge)[0])
    rows = np.linspace(least, best.damping, _ROWS + 2)[1:-1]
    low, high = stiffness_limits(loop, rows).T
    panel.fill_betweenx(rows, low, high, color=SKY, alpha=0.35, lw=0, label="stable")
    panel.plot(np.append(low, high[::-1]), np.append(rows, rows[::-1]), color=BLUE, lw=1.2)
    hands = hands_of(scene)
    if hands:
        limits = np.stack([stiffness_limits(one, rows) for one in corner_loops(loop, hands)])
        low, high = limits[..., 0].max(axis=0), limits[..., 1].min(axis=0)
        low, high = np.where(low < high, [low, high], np.nan)
        panel.fill_betweenx(
            rows,
            low,
            high,
            facecolor="none",
            edgecolor=BLUE,
            hatch="///",
            lw=0.6,
            label="for all hands of the range's corners",
        )
    own = loop.device_damping * loop.sample_time / loop.mass
    passive = passive_region(own, loop.delay_samples).outline
    if len(passive):
        corners = loop.stiffness(passive[:, 0]), loop.damping(passive[:, 1])
        panel.fill(*corners, facecolor=GREEN, edgecolor=GREEN, alpha=0.6, label="passive")
    window = (min(0.0, -loop.hand_stiffness) - 0.04 * best.stiffness, 1.12 * best.stiffness)
    span = best.damping - least
    panel.set(xlim=window, ylim=(least - 0.06 * span, best.damping + 0.06 * span))
    damping = np.array(panel.get_ylim())
    lag = loop.delay + 0.5 * loop.sample_time
    linear = (damping + loop.device_damping + loop.hand_damping) / lag
    panel.plot(linear, damping, "--", color=RED, lw=1.4, label="linear rule")
    panel.plot(
        best.stiffness,
        best.at_damping,
        ">",
        color=ORANGE,
        ms=9,
        mec=BLACK,
        label=f"stiffest: {best.stiffness:,.0f} N/m, {best.at_damping:.1f} N s/m",
    )
    fastest = optimal_gains(loop, "radius")
    panel.plot(
        fastest.stiffness,
        fastest.damping,
        "*",
        color=ORANGE,
        ms=12,
        mec=BLACK,
        label=f"fastest: {fastest.stiffness:,.0f} N/m, {fastest.damping:.1f} N s/m",
    )
    panel.set(xlabel="stiffness K (N/m)", ylabel="damping B (N s/m)")
    panel.set_title("stable walls" + (_LOWEST if hands else ""))


def _draw_walls(panel: Axes, checked: dict[str, Any]) -> None:
    stiffest = max(wall["stiffness"] for wall in checked.values())
    widest = max(wall["damping"] for wall in checked.values())
    panel.set_xlim(right=max(panel.get_xlim()[1], 1.1 * stiffest))
    panel.set_ylim(top=max(panel.get_ylim()[1], 1.1 * widest))
    middle = np.mean([wall["damping"] for wall in checked.values()])
    named: set[str] = set()
    for name, wall in checked.items():
        verdict, place = wall["verdict"], (wall["stiffness"], wall["damping"])
        look = _LOOKS[verdict]
        label = "" if verdict in named else f"wall, {verdict}"
        named.add(verdict)
        panel.plot(
            *place, look.marker, color=look.colour, ms=9, mec=BLACK, ls="", zorder=5, label=label
        )
        is_left = place[0] < 0.6 * panel.get_xlim()[1]
        panel.annotate(
            name,
            place,
            xytext=(8 if is_left else -8, 7 if place[1] >= middle else -12),  # names apart
            textcoords="offset points",
            ha="left" if is_left else "right",
            fontsize=9,
            zorder=6,
            bbox={"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.75},
        )


def _draw_responses(panel: Axes, loop: HapticLoop, checked: dict[str, Any]) -> None:
    """Draw the response to a step of force, relative to the final displacement."""
    times = [wall.get("settling_time_2_percent", np.inf) for wall in checked.values()]
    settled = [time for time in times if isfinite(time)] or [0.0]
    longest = min(1.2 * max(settled), 6.0 * min(settled))
    samples = int(np.clip(longest / loop.sample_time, _FEWEST, _MOST))
    for name, wall in checked.items():
        gains = wall["stiffness"], wall["damping"]
        response = simulate(loop, *gains, samples=samples, force=1.0)
        relative = np.asarray(response.position) * (gains[0] + loop.hand_stiffness)
        gone = np.logical_or.accumulate(np.abs(relative) > _GONE)
        shown = np.where(gone, np.nan, relative)
        panel.plot(np.asarray(response.time), shown, _LOOKS[wall["verdict"]].line, label=name)
    panel.axhspan(1.0 - _BAND, 1.0 + _BAND, color=BLACK, alpha=0.12, lw=0)
    panel.set(xlim=(0.0, samples * loop.sample_time), ylim=(-0.3, 2.3))
    panel.set(xlabel="time (s)", ylabel="position / final position")
    panel.legend(fontsize=8, frameon=True)
