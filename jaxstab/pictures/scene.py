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

from jaxstab.criteria import passive_region
from jaxstab.model import HapticLoop
from jaxstab.motion import settling_time, simulate
from jaxstab.pictures.paper import BLACK, BLUE, GREEN, ORANGE, RED, SKY
from jaxstab.region import WallLimits, damping_limits, stiffness_limits, wall_limits
from jaxstab.scene.answers import corner_loops, hands_of, loop_of
from jaxstab.scene.scene import Scene
from jaxstab.tuning import optimal_gains

_ROWS = 400
_CORNER = 1e-6  # of all rows: how far the outer ones are inside
_EDGE = 1e-6  # of the largest stiffness: how near to the corner the least damping is taken
_FEWEST, _MOST = 100, 2000  # samples of a response
_BAND = 0.02
_GONE = 5.0  # final positions: an unstable response is drawn no further
_HEIGHT = 4.6  # inches
_WIDTH, _ZOOM_WIDTH, _RESPONSE_WIDTH = 6.4, 3.6, 4.8
_SEEN = 0.05  # of the region, in K or in B: what is smaller is enlarged
_ZOOMS = 3  # towards the rows of B in which walls are stable for all hands
_COLUMNS = 64  # of the map of settling times, and rows
_ROUND = np.outer(10.0 ** np.arange(-3, 8), [1.0, 2.0, 5.0]).ravel()  # ms
_LONGEST = 50.0  # of the shortest settling time: the slowest line that is drawn
_HORIZON = 4096  # samples
_MARK = 14.0  # pixels: a wall's mark
_LIFTS = (0, 10, -10, 20, -20, 32, -32, 44, -44)  # points: how far names are moved up

Floats = NDArray[np.float64]
Ends = tuple[float, float]


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

    What is too small to be seen beside it, of the walls that are passive or stable for all hands,
    is enlarged in a panel of its own.

    Args:
        scene: the scene.
        checked: what ``check`` found for its walls. Then the walls are drawn, with their responses
            to a step of force in a panel of its own.

    Raises:
        ValueError: no wall is stable, there is nothing to draw.
        RuntimeError: JAX's x64 mode is off.

    Source: sec. V to VIII of Hulin, Preusche, Hirzinger (2008).
    """
    loop = loop_of(scene)
    best = wall_limits(loop)
    if not isfinite(best.stiffness):
        raise ValueError("no wall is stable for this scene; there is nothing to draw.")
    dampings = (_least_damping(loop, best), best.damping)
    parts = [part for part in (_common(scene, loop), _passive(loop)) if len(part.outline)]
    span = np.array([best.stiffness + loop.hand_stiffness, dampings[1] - dampings[0]])
    small = [part.outline for part in parts if (np.ptp(part.outline, axis=0) < _SEEN * span).any()]

    widths = [_WIDTH] + [_ZOOM_WIDTH] * bool(small) + [_RESPONSE_WIDTH] * (checked is not None)
    figure = Figure(figsize=(sum(widths), _HEIGHT))
    figure.set_layout_engine("constrained")
    panels = figure.subplots(1, len(widths), squeeze=False, width_ratios=widths)[0]
    walls = list((checked or {}).values())
    stiffest = max([best.stiffness, *(wall["stiffness"] for wall in walls)])
    highest = max([best.damping, *(wall["damping"] for wall in walls)])
    _set_window(panels[0], (min(0.0, -loop.hand_stiffness), stiffest), (dampings[0], highest))
    _draw_stable(panels[0], loop, dampings)
    _draw_settling(panels[0], loop, dampings, best.stiffness)
    _draw_best(panels[0], loop, best)
    panels[0].set_title("stable walls, and how long they take to settle")
    planes = [panels[0]]
    if small:
        _draw_enlarged(panels[1], loop, np.concatenate(small), dampings)
        planes.append(panels[1])
    for panel in planes:
        _draw_parts(panel, loop, parts)
        if checked is not None:
            _draw_walls(panel, checked)
    if checked is not None:
        _draw_responses(panels[-1], loop, checked)
        panels[-1].set_title("a constant push, and the band of 2 %")
    if hands_of(scene):
        figure.suptitle(
            "region, settling and fastest wall: hand at its lowest values"
            + ("; responses: worst hand of each wall" if checked else ""),
            fontsize=9,
        )
    handles, labels = panels[0].get_legend_handles_labels()
    columns = 2 if len(widths) == 1 else 4
    figure.legend(
        handles, labels, fontsize=8, frameon=False, ncols=columns, loc="outside lower center"
    )
    if checked is not None:
        figure.draw_without_rendering()  # places are known only now
        for panel in planes:
            _name_walls(panel, checked)
    return figure


class _Part(NamedTuple):
    """A part of the stable walls, and how it is drawn."""

    outline: Floats  # (K, B) by rows
    look: dict[str, Any]


def _common(scene: Scene, loop: HapticLoop) -> _Part:
    """Return the walls that are stable for the hands at all corners of the range, if it is one."""
    hands = hands_of(scene)
    outline = _common_outline(corner_loops(loop, hands)) if hands else np.zeros((0, 2))
    most = np.max(outline[:, 0], initial=0.0)
    label = f"for all corners of the hands' range: up to {most:,.0f} N/m"
    look = {"facecolor": "none", "edgecolor": BLUE, "hatch": "///", "lw": 0.6, "label": label}
    return _Part(outline, look)


def _common_outline(loops: list[HapticLoop]) -> Floats:
    """Return the walls that are stable for each of some loops, row by row of B."""
    limits = [wall_limits(loop) for loop in loops]
    low = max(map(_least_damping, loops, limits))
    high = min(limit.damping for limit in limits)
    for _ in range(_ZOOMS):  # the rows that meet may be few of those tried
        if not low < high:
            return np.zeros((0, 2))
        rows = _rows(low, high)
        ends = np.stack([stiffness_limits(loop, rows) for loop in loops])
        left, right = ends[..., 0].max(axis=0), ends[..., 1].min(axis=0)
        met = np.flatnonzero(left < right)
        if not len(met):
            return np.zeros((0, 2))
        if len(met) == _ROWS:
            break
        low, high = rows[max(met[0] - 1, 0)], rows[min(met[-1] + 1, _ROWS - 1)]
    left, right, rows = left[met], right[met], rows[met]
    return np.column_stack([np.append(left, right[::-1]), np.append(rows, rows[::-1])])


def _rows(low: float, high: float) -> Floats:
    """Return values of B, the outer ones close to the ends, where corners are."""
    rows: Floats = np.linspace(low, high, _ROWS)
    rows[[0, -1]] = low + _CORNER * (high - low), high - _CORNER * (high - low)
    return rows


def _passive(loop: HapticLoop) -> _Part:
    own = loop.device_damping * loop.sample_time / loop.mass
    corners = passive_region(own, loop.delay_samples).outline
    outline = np.column_stack([loop.stiffness(corners[:, 0]), loop.damping(corners[:, 1])])
    label = f"passive: up to {np.max(outline[:, 0], initial=0.0):,.0f} N/m"
    return _Part(outline, {"facecolor": GREEN, "edgecolor": GREEN, "alpha": 0.6, "label": label})


def _least_damping(loop: HapticLoop, best: WallLimits) -> float:
    edge = -loop.hand_stiffness + _EDGE * (best.stiffness + loop.hand_stiffness)
    return float(damping_limits(loop, edge)[0])


def _set_window(panel: Axes, stiffnesses: Ends, dampings: Ends) -> None:
    """Show these values of K and B, and a little more, whatever is drawn."""
    for ends, margins, set_limits in (
        (stiffnesses, (0.04, 0.12), panel.set_xlim),
        (dampings, (0.06, 0.06), panel.set_ylim),
    ):
        span = ends[1] - ends[0]
        set_limits(ends[0] - margins[0] * span, ends[1] + margins[1] * span)
    panel.set(xlabel="stiffness K (N/m)", ylabel="damping B (N s/m)")


def _draw_stable(panel: Axes, loop: HapticLoop, dampings: Ends) -> None:
    """Draw what is stable between two values of B."""
    rows = _rows(*dampings)
    low, high = stiffness_limits(loop, rows).T
    panel.fill_betweenx(rows, low, high, color=SKY, alpha=0.35, lw=0, label="stable")
    panel.plot(np.append(low, high[::-1]), np.append(rows, rows[::-1]), color=BLUE, lw=1.2)


def _draw_enlarged(panel: Axes, loop: HapticLoop, corners: Floats, dampings: Ends) -> None:
    """Draw what is stable around some points, for dampings of the whole region."""
    _set_window(panel, *zip(corners.min(axis=0), corners.max(axis=0), strict=True))
    low, high = panel.get_ylim()
    beyond = high + 0.1 * (high - low)  # no line where only the panel ends
    _draw_stable(panel, loop, (max(low, dampings[0]), min(beyond, dampings[1])))
    panel.locator_params(axis="x", nbins=5)
    panel.set_title("enlarged")


def _draw_parts(panel: Axes, loop: HapticLoop, parts: list[_Part]) -> None:
    """Draw parts of the stable walls, and the linear rule."""
    for part in parts:
        panel.fill(*part.outline.T, **part.look)
    damping = np.array(panel.get_ylim())
    lag = loop.delay + 0.5 * loop.sample_time
    linear = (damping + loop.device_damping + loop.hand_damping) / lag
    panel.plot(linear, damping, "--", color=RED, lw=1.4, label="linear rule")


def _draw_best(panel: Axes, loop: HapticLoop, best: WallLimits) -> None:
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
    for verdict, look in _LOOKS.items():
        walls = [wall for wall in checked.values() if wall["verdict"] == verdict]
        if walls:
            panel.plot(
                [wall["stiffness"] for wall in walls],
                [wall["damping"] for wall in walls],
                look.marker,
                color=look.colour,
                ms=9,
                mec=BLACK,
                ls="",
                zorder=5,
                label=f"wall, {verdict}",
            )


def _name_walls(panel: Axes, checked: dict[str, Any]) -> None:
    """Write the name of each wall beside it, where no other name or mark is."""
    lines = [line for line in panel.get_lines() if line.get_marker() != "None"]
    marks = np.concatenate([panel.transData.transform(line.get_xydata()) for line in lines])
    taken = [Bbox.from_bounds(x - _MARK / 2, y - _MARK / 2, _MARK, _MARK) for x, y in marks]
    for name, wall in checked.items():
        place = (wall["stiffness"], wall["damping"])
        if not panel.bbox.contains(*panel.transData.transform(place)):
            continue
        text = panel.annotate(
            name,
            place,
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
