"""A picture of a scene: what is stable in the plane of K and B, its walls, and how they respond."""

from decimal import ROUND_FLOOR
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from jaxstab.criteria import passive_region
from jaxstab.loop import HapticLoop, WallRegion
from jaxstab.pictures.shown import draw_islands, draw_linear_rule, draw_stable
from jaxstab.pictures.style import BLACK, BLUE, GREEN, ORANGE, PURPLE
from jaxstab.pictures.walls import draw_responses, draw_walls, name_walls
from jaxstab.scene.answers import Quantity
from jaxstab.scene.basis import basis_of
from jaxstab.scene.check import Check
from jaxstab.scene.hands import at_lowest, common_outline
from jaxstab.scene.loops import corner_loops, hands_of, is_plain, loop_of, reachable, wall_region
from jaxstab.scene.mechanics import Encoder
from jaxstab.scene.scene import Scene
from jaxstab.scene.units import Units
from jaxstab.tuning import TuningStatus

_HEIGHT = 4.6  # inches
_WIDTH, _ZOOM_WIDTH, _RESPONSE_WIDTH = 6.4, 3.6, 4.8
_SEEN = 0.05  # of the region, in K or in B: what is smaller is enlarged
_COLUMNS = 64  # of the map of settling times, and rows
_ROUND = np.outer(10.0 ** np.arange(-3, 8), [1.0, 2.0, 5.0]).ravel()  # ms
_CALM_COLUMNS = 40  # of the map of amplitudes, and rows
_COUNTS = 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0, 20.0  # amplitudes that are drawn
_LONGEST = 50.0  # of the shortest settling time: the slowest line that is drawn
_HORIZON = 4096  # samples
_LARGEST = Quantity("N/m", 4, ROUND_FLOOR)
_STIFFNESS, _DAMPING, _TIME, _LENGTH = (Quantity(unit, 3) for unit in ("N/m", "N s/m", "s", "m"))

Floats = NDArray[np.float64]


def scene_figure(scene: Scene, checked: Check | None = None) -> Figure:
    """Draw the stable region in the plane of K and B, in SI units, and the walls in it.

    What is too small to be seen beside it, of the walls that are passive or stable for all hands,
    is enlarged in a panel of its own.

    Args:
        scene: the scene.
        checked: what ``check_walls`` answers. Then the walls are drawn, with their responses to a
            step of force in a panel of its own.

    Raises:
        ValueError: no wall is stable, there is nothing to draw.

    Source: sec. V to VIII of Hulin, Preusche, Hirzinger (2008).
    """
    loop, walls = loop_of(scene), checked.walls if checked else {}
    everything = wall_region(loop)
    if everything.is_empty:
        raise ValueError("no wall is stable for this scene; there is nothing to draw.")
    region = reachable(everything)
    islands = [island for island in everything.components if island is not region]
    if region is everything:
        islands = []
    parts = [part for part in (_common(scene), _passive(scene, loop)) if len(part.outline)]
    is_small = [(np.ptp(part.outline, axis=0) < _SEEN * np.array(region.extent)) for part in parts]
    small = [part.outline for part, axes in zip(parts, is_small, strict=True) if axes.any()]

    narrow = bool(small) + bool(islands)
    widths = [_WIDTH] + [_ZOOM_WIDTH] * narrow + [_RESPONSE_WIDTH] * (checked is not None)
    figure = Figure(figsize=(sum(widths), _HEIGHT))
    figure.set_layout_engine("constrained")
    panels = figure.subplots(1, len(widths), squeeze=False, width_ratios=widths)[0]
    gains = np.array([(wall.stiffness, wall.damping) for wall in walls.values()]).reshape(-1, 2)
    _set_window(panels[0], np.concatenate([region.outline, gains, np.zeros((1, 2))]))
    _draw_settling(panels[0], loop, region)
    encoder = scene.device.encoder
    if encoder is not None:
        _draw_chatter(panels[0], loop, region, encoder, scene.units)
    _draw_best(panels[0], loop, region, scene.units)
    panels[0].set_title("stable walls, and how long they take to settle")
    planes = [panels[0]]
    if small:
        _set_window(panels[1], np.concatenate(small))
        panels[1].locator_params(axis="x", nbins=5)
        panels[1].set_title("enlarged")
        planes.append(panels[1])
    if islands:
        planes.append(panels[narrow])
        _set_window(panels[narrow], everything.outline)
        panels[narrow].locator_params(axis="x", nbins=4)
        panels[narrow].set_title("all stable walls")
    for panel in planes:
        panel.set_xlabel(f"stiffness K ({scene.units.stiffness})")
        panel.set_ylabel(f"damping B ({scene.units.damping})")
        draw_stable(panel, region)
        draw_islands(panel, islands)
        _draw_parts(panel, loop, parts)
        draw_walls(panel, walls)
    if checked is not None:
        draw_responses(panels[-1], scene, walls)
        panels[-1].set_title("a constant push, and the band of 2 %")
    basis = basis_of(scene)
    remarks = [f"velocity: {basis.velocity}"]
    if basis.mechanics:
        remarks.append(basis.mechanics)
    if basis.postures:
        remarks.append(basis.postures)
    if hands_of(scene):
        remarks.append(
            f"region, settling and fastest wall: hand {at_lowest(scene, '')}"
            + ("; responses: worst hand of each wall" if checked else "")
        )
    figure.suptitle("\n".join(remarks), fontsize=9)
    handles, labels = panels[0].get_legend_handles_labels()
    columns = min(1 + len(widths), 4)
    figure.legend(
        handles, labels, fontsize=8, frameon=False, ncols=columns, loc="outside lower center"
    )
    if walls:
        figure.draw_without_rendering()  # positions are known only now
        for panel in planes:
            name_walls(panel, walls)
    return figure


class _Part(NamedTuple):
    """A part of the stable walls, and how it is drawn."""

    outline: Floats  # (K, B)
    look: dict[str, Any]


def _common(scene: Scene) -> _Part:
    """Return the walls that are stable for the hands at all corners of the range, if it is one."""
    outline = common_outline(corner_loops(scene)) if hands_of(scene) else np.zeros((0, 2))
    label = f"for all corners of the hands' range: {_up_to(outline, scene.units)}"
    look = {"facecolor": "none", "edgecolor": BLUE, "hatch": "///", "lw": 0.6, "label": label}
    return _Part(outline, look)


def _passive(scene: Scene, loop: HapticLoop) -> _Part:
    outline = np.zeros((0, 2))
    if is_plain(loop):  # the theorem is of one mass and one difference
        own = loop.device_damping * loop.sample_time / loop.mass
        corners = passive_region(delta=own, delay=loop.delay_samples).outline
        outline = np.column_stack([loop.stiffness(corners[:, 0]), loop.damping(corners[:, 1])])
    label = f"passive: {_up_to(outline, scene.units)}"
    return _Part(outline, {"facecolor": GREEN, "edgecolor": GREEN, "alpha": 0.6, "label": label})


def _up_to(outline: Floats, units: Units) -> str:
    return f"up to {_LARGEST.words(np.max(outline[:, 0], initial=0.0), units)}"


def _set_window(panel: Axes, points: Floats) -> None:
    """Show some points (K, B), and a little more, whatever is drawn."""
    low, high = points.min(axis=0), points.max(axis=0)
    (left, bottom), (right, top) = (
        low - (0.04, 0.06) * (high - low),
        high + (0.12, 0.06) * (high - low),
    )
    panel.set(xlim=(left, right), ylim=(bottom, top))


def _draw_parts(panel: Axes, loop: HapticLoop, parts: list[_Part]) -> None:
    """Draw parts of the stable walls, and the linear rule, which knows of no filter."""
    for part in parts:
        panel.fill(*part.outline.T, **part.look)
    draw_linear_rule(panel, loop)


def _draw_best(panel: Axes, loop: HapticLoop, region: WallRegion, units: Units) -> None:
    stiffest = f"stiffest: {_LARGEST.words(region.stiffest.stiffness, units)}"
    damping = _DAMPING.words(region.stiffest.damping, units)
    panel.plot(*region.stiffest, ">", color=ORANGE, ms=9, mec=BLACK, label=f"{stiffest}, {damping}")
    fastest = loop.tune("settling")
    if fastest.status == TuningStatus.NO_STABLE_GAINS:
        return
    gains = (
        f"{_STIFFNESS.words(fastest.stiffness, units)}, {_DAMPING.words(fastest.damping, units)}"
    )
    time = _TIME.words(fastest.settling_time)
    panel.plot(
        fastest.stiffness,
        fastest.damping,
        "*",
        color=ORANGE,
        ms=12,
        mec=BLACK,
        label=f"fastest: {gains}, settles in {time}",
    )


def _draw_chatter(
    panel: Axes, loop: HapticLoop, region: WallRegion, encoder: Encoder, units: Units
) -> None:
    """Draw lines of equal bounds of what the encoder's rounding does to the position."""
    resolution = encoder.resolution
    stiffness, damping = _columns_and_rows(region, _CALM_COLUMNS)
    found = loop.amplitude(stiffness[None, :], damping[:, None], encoder=resolution)
    counts = np.where(np.isfinite(found.position), found.position / resolution, np.nan)
    fewest, most = np.nanmin(counts, initial=np.inf), np.nanmax(counts, initial=0.0)
    levels = [count for count in _COUNTS if fewest < count < most]
    if not levels:
        return
    lines = panel.contour(
        stiffness, damping, counts, levels, colors=PURPLE, linewidths=0.7, linestyles="dashed"
    )
    panel.clabel(lines, fmt=lambda count: _LENGTH.words(count * resolution, units), fontsize=7)
    label = f"encoder of {_LENGTH.words(resolution, units)}: chatters by less, proved"
    panel.plot([], [], color=PURPLE, lw=0.7, ls="dashed", label=label)


def _columns_and_rows(region: WallRegion, count: int) -> Floats:
    """Return values of K and of B (2, count) that span the region."""
    return np.linspace(region.outline.min(axis=0), region.outline.max(axis=0), count).T


def _draw_settling(panel: Axes, loop: HapticLoop, region: WallRegion) -> None:
    """Draw lines of equal settling time to 2 %, in ms."""
    stiffness, damping = _columns_and_rows(region, _COLUMNS)
    found = loop.settling_time(stiffness[None, :], damping[:, None], horizon=_HORIZON)
    times = np.where(np.isfinite(found.value), 1e3 * np.asarray(found.value), np.nan)
    if np.isnan(times).all():
        return
    fastest, slowest = float(np.nanmin(times)), float(np.nanmax(times))
    levels = [time for time in _ROUND if fastest < time < min(slowest, _LONGEST * fastest)]
    lines = panel.contour(
        stiffness, damping, times, levels, colors=BLACK, linewidths=0.7, linestyles="dotted"
    )
    panel.clabel(lines, fmt="%g ms", fontsize=7)
