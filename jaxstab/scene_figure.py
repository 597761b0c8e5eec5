"""A picture of a scene: what is stable in the plane of K and B, its walls, and how they respond."""

from dataclasses import replace
from itertools import product
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from jaxstab.boundary import damping_limits, passive_region, stiffness_limits, wall_limits
from jaxstab.front import corner_loops, hands_of, loop_of
from jaxstab.model import HapticLoop
from jaxstab.paper import BLACK, BLUE, GREEN, ORANGE, RED, SKY
from jaxstab.scene import Scene
from jaxstab.stability import optimal_gains, settling_time, simulate

_ROWS = 400
_EDGE = 1e-6  # of the largest stiffness: how near to the corner the least damping is taken
_FEWEST, _MOST = 100, 2000  # samples of a response
_BAND = 0.02
_GONE = 5.0  # final positions: an unstable response is drawn no further
_HEIGHT = 4.6  # inches
_COLUMNS = 64  # of the map of settling times, and rows
_ROUND = np.outer(10.0 ** np.arange(-3, 8), [1.0, 2.0, 5.0]).ravel()  # ms
_LONGEST = 50.0  # of the shortest settling time: the slowest line that is drawn
_HORIZON = 4096  # samples
_MARK = 14.0  # pixels: a wall's mark
_LIFTS = (0, 10, -10, 20, -20, 32, -32, 44, -44)  # points: how far names are moved up

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
        panels[1].set_title("a constant push, and the band of 2 %")
    if hands_of(scene):
        figure.suptitle(
            "region, settling and fastest wall: hand at its lowest values"
            + ("; responses: worst hand of each wall" if checked else ""),
            fontsize=9,
        )
    handles, labels = panels[0].get_legend_handles_labels()
    columns = 2 if checked is None else 4
    figure.legend(
        handles, labels, fontsize=8, frameon=False, ncols=columns, loc="outside lower center"
    )
    if checked is not None:
        _name_walls(figure, panels[0], checked)
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
        _draw_common_region(panel, corner_loops(loop, hands))
    _draw_settling(panel, loop, (least, best.damping), best.stiffness)
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
    fastest = optimal_gains(loop, "settling")
    panel.plot(
        fastest.stiffness,
        fastest.damping,
        "*",
        color=ORANGE,
        ms=12,
        mec=BLACK,
        label=f"fastest: {fastest.stiffness:,.0f} N/m, {fastest.damping:.1f} N s/m, "
        f"settles in {1e3 * fastest.settling_time:.3g} ms",
    )
    panel.set(xlabel="stiffness K (N/m)", ylabel="damping B (N s/m)")
    panel.set_title("stable walls, and how long they take to settle")


def _draw_common_region(panel: Axes, loops: list[HapticLoop]) -> None:
    """Draw the walls that are stable for each of some loops."""
    spans = []
    for loop in loops:
        best = wall_limits(loop)
        edge = -loop.hand_stiffness + _EDGE * (best.stiffness + loop.hand_stiffness)
        spans.append((float(damping_limits(loop, edge)[0]), best.damping))
    lowest, highest = np.max(spans, axis=0)[0], np.min(spans, axis=0)[1]
    if not lowest < highest:
        return
    rows = np.linspace(lowest, highest, _ROWS + 2)[1:-1]
    limits = np.stack([stiffness_limits(loop, rows) for loop in loops])
    low, high = limits[..., 0].max(axis=0), limits[..., 1].min(axis=0)
    low, high = np.where(low < high, [low, high], np.nan)
    if np.isnan(high).all():
        return
    label = f"for all corners of the hands' range: up to {np.nanmax(high):,.0f} N/m"
    panel.fill_betweenx(
        rows, low, high, facecolor="none", edgecolor=BLUE, hatch="///", lw=0.6, label=label
    )


def _draw_settling(
    panel: Axes, loop: HapticLoop, dampings: tuple[float, float], stiffest: float
) -> None:
    """Draw lines of equal settling time to 2 %, in ms."""
    stiffness = np.linspace(-loop.hand_stiffness, stiffest, _COLUMNS)
    damping = np.linspace(*dampings, _COLUMNS)
    found = settling_time(loop, stiffness[None, :], damping[:, None], horizon=_HORIZON)
    times = np.where(np.isfinite(found.value), 1e3 * np.asarray(found.value), np.nan)
    if np.isnan(times).all():
        return
    fastest, slowest = float(np.nanmin(times)), float(np.nanmax(times))
    levels = [time for time in _ROUND if fastest < time < min(slowest, _LONGEST * fastest)]
    lines = panel.contour(
        stiffness, damping, times, levels, colors=BLACK, linewidths=0.7, linestyles="dotted"
    )
    panel.clabel(lines, fmt="%g ms", fontsize=7)


def _draw_walls(panel: Axes, checked: dict[str, Any]) -> None:
    stiffest = max(wall["stiffness"] for wall in checked.values())
    widest = max(wall["damping"] for wall in checked.values())
    panel.set_xlim(right=max(panel.get_xlim()[1], 1.1 * stiffest))
    panel.set_ylim(top=max(panel.get_ylim()[1], 1.1 * widest))
    named: set[str] = set()
    for wall in checked.values():
        verdict, place = wall["verdict"], (wall["stiffness"], wall["damping"])
        look = _LOOKS[verdict]
        label = "" if verdict in named else f"wall, {verdict}"
        named.add(verdict)
        panel.plot(
            *place, look.marker, color=look.colour, ms=9, mec=BLACK, ls="", zorder=5, label=label
        )


def _name_walls(figure: Figure, panel: Axes, checked: dict[str, Any]) -> None:
    """Write the name of each wall beside it, where no other name or wall is."""
    figure.draw_without_rendering()  # places are known only now
    lines = [np.asarray(line.get_xydata(), np.float64) for line in panel.get_lines()]
    marks = np.concatenate([points for points in lines if len(points) == 1])
    taken = [
        Bbox.from_bounds(x - _MARK / 2, y - _MARK / 2, _MARK, _MARK)
        for x, y in panel.transData.transform(marks)
    ]
    for name, wall in checked.items():
        text = panel.annotate(
            name,
            (wall["stiffness"], wall["damping"]),
            xytext=(8, 0),
            textcoords="offset points",
            va="center",
            fontsize=9,
            zorder=6,
            bbox={"boxstyle": "round,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.75},
        )
        for across, along in product((1, -1), _LIFTS):
            text.set(ha="left" if across > 0 else "right")
            text.xyann = (8 * across, along)
            box = text.get_window_extent()
            is_inside = panel.bbox.containsx(box.x0) and panel.bbox.containsx(box.x1)
            if is_inside and not box.count_overlaps(taken):
                break
        taken.append(box)


def _draw_responses(panel: Axes, loop: HapticLoop, checked: dict[str, Any]) -> None:
    """Draw the response to a step of force, relative to the final displacement."""
    times = [wall.get("settling_time_2_percent", np.inf) for wall in checked.values()]
    settled = [time for time in times if isfinite(time)] or [0.0]
    longest = min(1.2 * max(settled), 6.0 * min(settled))
    samples = int(np.clip(longest / loop.sample_time, _FEWEST, _MOST))
    for name, wall in checked.items():
        gains = wall["stiffness"], wall["damping"]
        held = {f"hand_{key}": value for key, value in wall.get("worst_hand", {}).items()}
        at_worst = replace(loop, **held)
        response = simulate(at_worst, *gains, samples=samples, force=1.0, between=_MOST // samples)
        relative = np.asarray(response.position) * (gains[0] + at_worst.hand_stiffness)
        gone = np.logical_or.accumulate(np.abs(relative) > _GONE)
        shown = np.where(gone, np.nan, relative)
        panel.plot(np.asarray(response.time), shown, _LOOKS[wall["verdict"]].line, label=name)
    panel.axhspan(1.0 - _BAND, 1.0 + _BAND, color=BLACK, alpha=0.12, lw=0)
    panel.set(xlim=(0.0, samples * loop.sample_time), ylim=(-0.3, 2.3))
    panel.set(xlabel="time (s)", ylabel="position / final position")
    panel.legend(fontsize=8, frameon=True)
