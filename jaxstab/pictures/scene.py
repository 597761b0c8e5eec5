"""A picture of a scene: the stable set in the plane of K and B, its walls and their responses."""

from collections.abc import Mapping
from dataclasses import replace
from decimal import ROUND_CEILING, ROUND_FLOOR
from itertools import product
from math import isfinite
from textwrap import fill
from typing import Any, NamedTuple

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from jaxstab.conventions import Verdict
from jaxstab.guard import Guard
from jaxstab.loop import HapticLoop, WallRegion
from jaxstab.paper import passive_region
from jaxstab.pictures.contact import scene_contacts
from jaxstab.pictures.style import (
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    RED,
    SKY,
    closed_outline,
    draw_islands,
    draw_linear_rule,
    draw_stable,
    plain,
    plot_moving_region,
)
from jaxstab.scene.answers import Answer, Quantity, basis_of, in_words
from jaxstab.scene.check import (
    Check,
    WallCheck,
    at_lowest,
    check_walls,
    common_outline,
    loops_over_delays,
)
from jaxstab.scene.contact import Contacts
from jaxstab.scene.design import Design, delayed_loop, sampled_loop
from jaxstab.scene.limits import LimitsOverDelays
from jaxstab.scene.loops import (
    OneHand,
    corner_loops,
    hands_of,
    is_plain,
    loop_of,
    reachable,
    wall_region,
)
from jaxstab.scene.scene import Encoder, Scene, Units
from jaxstab.scene.tune import Tuned
from jaxstab.tuning import TuningStatus

# The walls of a scene in its picture: marks by their verdicts, names, and responses.

Walls = Mapping[str, WallCheck]

_FEWEST, _MOST = 100, 2000  # samples of a response
_LEVEL = 0.02
_GONE = 5.0  # final positions: an unstable response is drawn no further
_MARK = 14.0  # pixels: a wall's mark
_LIFTS = (0, 10, -10, 20, -20, 32, -32, 44, -44)  # points: how far names are moved up


class _Look(NamedTuple):
    """How a wall of a verdict is drawn: told apart by colour and by form."""

    colour: str
    marker: str
    line: str


_LOOKS = {
    Verdict.STABLE: _Look(BLUE, "o", "-"),
    Verdict.UNSTABLE: _Look(RED, "X", ":"),
    Verdict.UNDECIDED: _Look(BLACK, "s", "--"),
}


def draw_walls(panel: Axes, checked: Walls) -> None:
    """Draw a mark for each wall, by its verdict."""
    for verdict, look in _LOOKS.items():
        walls = [wall for wall in checked.values() if wall.verdict == verdict]
        if walls:
            panel.plot(
                [wall.stiffness for wall in walls],
                [wall.damping for wall in walls],
                look.marker,
                color=look.colour,
                ms=9,
                mec=BLACK,
                ls="",
                zorder=5,
                label=f"wall, {in_words(verdict)}",
            )


def name_walls(panel: Axes, checked: Walls) -> None:
    """Write the name of each wall beside it, where no other name or mark is."""
    lines = [line for line in panel.get_lines() if line.get_marker() != "None"]
    marks = np.concatenate([panel.transData.transform(line.get_xydata()) for line in lines])
    taken = [Bbox.from_bounds(x - _MARK / 2, y - _MARK / 2, _MARK, _MARK) for x, y in marks]
    for name, wall in checked.items():
        position = (wall.stiffness, wall.damping)
        if not panel.bbox.contains(*panel.transData.transform(position)):
            continue
        text = panel.annotate(
            plain(name),
            position,
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


def draw_responses(panel: Axes, scene: Scene, checked: Walls) -> None:
    """Draw the response to a step of force, relative to the final displacement."""
    period = scene.controller.sample_time
    times = [wall.settling.settling_time_2_percent for wall in checked.values() if wall.settling]
    settled = [time for time in times if isfinite(time)] or [0.0]
    longest = min(1.2 * max(settled), 6.0 * min(settled))
    samples = int(np.clip(longest / period, _FEWEST, _MOST))
    for name, wall in checked.items():
        hand = wall.worst_hand
        held = loop_of(scene, None if hand is None else OneHand(*vars(hand).values()))
        spring = held.device.static_stiffness() if held.device else held.hand_stiffness
        response = held.simulate(
            wall.stiffness, wall.damping, samples=samples, force=1.0, between=_MOST // samples
        )
        relative = np.asarray(response.position) * (wall.stiffness + spring)
        gone = np.logical_or.accumulate(np.abs(relative) > _GONE)
        shown = np.where(gone, np.nan, relative)
        panel.plot(np.asarray(response.time), shown, _LOOKS[wall.verdict].line, label=plain(name))
    panel.axhspan(1.0 - _LEVEL, 1.0 + _LEVEL, color=BLACK, alpha=0.12, lw=0)
    panel.set(xlim=(0.0, samples * period), ylim=(-0.3, 2.3))
    panel.set(xlabel="time (s)", ylabel="position / final position")
    panel.legend(fontsize=8, frameon=True)


_HEIGHT = 4.6  # inches
_WIDTH, _ZOOM_WIDTH, _RESPONSE_WIDTH = 6.4, 3.6, 4.8
_SEEN = 0.05  # of the region, in K or in B: smaller sets are enlarged
_COLUMNS = 64  # of the map of settling times, and rows
_ROUND = np.outer(10.0 ** np.arange(-3, 8), [1.0, 2.0, 5.0]).ravel()  # ms
_CALM_COLUMNS = 40  # of the map of amplitudes, and rows
_COUNTS = 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0, 20.0  # amplitudes that are drawn
_LONGEST = 50.0  # of the shortest settling time: the slowest line that is drawn
_HORIZON = 4096  # samples
_LETTERS = 14.0  # of a remark, per inch
_LARGEST = Quantity("N/m", 4, ROUND_FLOOR)
_BOUND = Quantity("N/m", 4, ROUND_CEILING)
_LARGEST_TIME = Quantity("s", 4, ROUND_FLOOR)
_STIFFNESS, _DAMPING, _TIME, _LENGTH = (Quantity(unit, 3) for unit in ("N/m", "N s/m", "s", "m"))

Floats = NDArray[np.float64]


def scene_figure(scene: Scene, answer: Answer | None = None) -> Figure:
    """The stable region in the plane of K and B, in SI units, the scene's walls and an answer.

    Passive walls, or walls stable for all hands, that are too small to be seen are enlarged in a
    separate panel. Of ``check_walls`` the walls' step responses are drawn in a separate panel, of
    ``scene_limits`` the bound for all hands, of ``tune_walls`` the best walls, and of
    ``design_loop`` the wanted stiffness and the regions that just allow it. For a delay that moves
    it has the walls that are proved for every sequence. Of ``simulate_contacts`` it is the map of
    simulated contacts. ValueError: no wall is stable.
    """
    if isinstance(answer, Contacts):
        return scene_contacts(scene)
    checked = answer if isinstance(answer, Check) else None
    walls = _judged(scene, answer)
    if scene.controller.moves:
        return _moving_figure(scene, walls)
    loop = loop_of(scene)
    everything = wall_region(loop)
    if everything.is_empty:
        raise ValueError("no wall is stable for this scene; there is nothing to draw.")
    region = reachable(everything)
    islands = [island for island in everything.components if island is not region]
    if region is everything:
        islands = []
    parts = [part for part in (_common(scene, answer), _passive(scene, loop)) if len(part.outline)]
    is_small = [(np.ptp(part.outline, axis=0) < _SEEN * np.array(region.extent)) for part in parts]
    small = [part.outline for part, axes in zip(parts, is_small, strict=True) if axes.any()]

    narrow = bool(small) + bool(islands)
    widths = [_WIDTH] + [_ZOOM_WIDTH] * narrow + [_RESPONSE_WIDTH] * (checked is not None)
    figure = Figure(figsize=(sum(widths), _HEIGHT), layout="constrained")
    panels = figure.subplots(1, len(widths), squeeze=False, width_ratios=widths)[0]
    gains = np.array([(wall.stiffness, wall.damping) for wall in walls.values()]).reshape(-1, 2)
    designed = _designed(scene, answer) if isinstance(answer, Design) else []
    seen = [region.outline, gains, np.zeros((1, 2)), *(one.outline for one in designed)]
    _set_window(panels[0], np.concatenate(seen))
    _draw_settling(panels[0], loop, region)
    encoder = scene.device.encoder
    if encoder is not None:
        _draw_chatter(panels[0], loop, region, encoder, scene.units)
    tuned = answer if isinstance(answer, Tuned) else None
    _draw_best(panels[0], loop, region, tuned, scene.units)
    _draw_parts(panels[0], designed)
    if isinstance(answer, Design):
        label = f"wanted: {_STIFFNESS.words(answer.stiffness, scene.units)}"
        panels[0].axvline(answer.stiffness, color=BLACK, lw=1.2, ls="dashdot", label=label)
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
        _draw_parts(panel, parts)
        draw_linear_rule(panel, loop)
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
    width = int(_LETTERS * sum(widths))
    figure.suptitle("\n".join(fill(remark, width) for remark in remarks), fontsize=9)
    _draw_legend(figure, panels[0], min(1 + len(widths), 4))
    if walls:
        figure.draw_without_rendering()  # positions are known only now
        for panel in planes:
            name_walls(panel, walls)
    return figure


def _judged(scene: Scene, answer: Answer | None) -> Walls:
    """Return the walls of a scene with their verdicts, of an answer that has them."""
    if isinstance(answer, Check | LimitsOverDelays):
        return answer.walls
    if not scene.walls:
        return {}
    return check_walls(replace(scene, wanted=replace(scene.wanted, measures=()))).walls


def _moving_figure(scene: Scene, walls: Walls) -> Figure:
    """Draw the walls that are proved for every sequence of delays, and those of the scene."""
    controller, units = scene.controller, scene.units
    region = loops_over_delays(scene)[0].region(
        delays=controller.delays, lost=controller.lost_samples
    )
    figure = Figure(figsize=(_WIDTH, _HEIGHT), layout="constrained")
    panel = plot_moving_region(region, figure.subplots())
    panel.plot([], [], "s", mfc="white", mec=BLACK, ms=8, label="elsewhere: not decided")
    draw_walls(panel, walls)
    gains = np.array([(wall.stiffness, wall.damping) for wall in walls.values()]).reshape(-1, 2)
    unstable = region.unstable[np.isfinite(region.unstable[:, 0])]
    _set_window(panel, np.concatenate([region.outline, unstable, gains, np.zeros((1, 2))]))
    panel.set_xlabel(f"stiffness K ({units.stiffness})")
    panel.set_ylabel(f"damping B ({units.damping})")
    legend = panel.get_legend()
    assert legend is not None
    legend.remove()
    _draw_legend(figure, panel, 3)
    basis = basis_of(scene)
    remarks = [f"velocity: {basis.velocity}", f"delay {basis.range_of_delays}"]
    remarks += [f"hand {hand}" for hand in [at_lowest(scene, "")] if hand]
    width = int(_LETTERS * _WIDTH)
    figure.suptitle("\n".join(fill(remark, width) for remark in remarks), fontsize=9)
    if walls:
        figure.draw_without_rendering()  # positions are known only now
        name_walls(panel, walls)
    return figure


def _draw_legend(figure: Figure, panel: Axes, most: int) -> None:
    handles, labels = panel.get_legend_handles_labels()
    for columns in range(most, 0, -1):
        legend = figure.legend(
            handles, labels, fontsize=8, frameon=False, ncols=columns, loc="outside lower center"
        )
        if columns == 1 or legend.get_window_extent().width <= figure.bbox.width:
            return
        legend.remove()


class _Part(NamedTuple):
    """A part of the stable walls, and how it is drawn."""

    outline: Floats  # (K, B)
    look: dict[str, Any]


def _common(scene: Scene, answer: Answer | None) -> _Part:
    """Return the walls that are stable for the hands at all corners of the range, if it is one."""
    outline = common_outline(corner_loops(scene)) if hands_of(scene) else np.zeros((0, 2))
    label, all_hands = "for all corners of the hands' range", getattr(answer, "all_hands", None)
    if all_hands is not None and all_hands.none_is_stiffer_than is not None:
        bound = _BOUND.words(all_hands.none_is_stiffer_than, scene.units)
        label += f": none is stiffer than {bound}"
    look = {"facecolor": "none", "edgecolor": BLUE, "hatch": "///", "lw": 0.6, "label": label}
    return _Part(outline, look)


def _passive(scene: Scene, loop: HapticLoop) -> _Part:
    outline = np.zeros((0, 2))
    if is_plain(loop):  # the theorem is of one mass and one difference
        own = loop.device_damping * loop.sample_time / loop.mass
        corners = passive_region(delta=own, delay=loop.delay_samples).outline
        outline = np.column_stack([loop.stiffness(corners[:, 0]), loop.damping(corners[:, 1])])
    largest = _LARGEST.words(np.max(outline[:, 0], initial=0.0), scene.units)
    label = f"passive: up to {largest}"
    return _Part(outline, {"facecolor": GREEN, "edgecolor": GREEN, "alpha": 0.6, "label": label})


def _set_window(panel: Axes, points: Floats) -> None:
    """Show some points (K, B), and a little more, whatever is drawn."""
    low, high = points.min(axis=0), points.max(axis=0)
    (left, bottom), (right, top) = (
        low - (0.04, 0.06) * (high - low),
        high + (0.12, 0.06) * (high - low),
    )
    panel.set(xlim=(left, right), ylim=(bottom, top))


def _designed(scene: Scene, design: Design) -> list[_Part]:
    """Return the walls that are stable with the designed sample time, and with the delay."""
    time, delay = design.sample_time.largest_sample_time, design.delay.largest_delay
    parts = []
    for value, loop_with, words, colour, line in (
        (time, sampled_loop, "sample time", GREEN, "--"),
        (delay, delayed_loop, "delay", PURPLE, "-."),
    ):
        if isfinite(value):
            region = reachable(wall_region(loop_with(scene, value)))
            label = f"with a {words} of {_LARGEST_TIME.words(value)}"
            look = {"facecolor": "none", "edgecolor": colour, "ls": line, "lw": 2, "label": label}
            parts.append(_Part(region.outline, look))
    return parts


def _draw_parts(panel: Axes, parts: list[_Part]) -> None:
    for part in parts:
        panel.fill(*part.outline.T, **part.look)


def _draw_tuned(panel: Axes, tuned: Tuned, units: Units) -> None:
    """Draw the tuned walls beside the fastest one, each with its own mark."""
    given = [*tuned.walls.values(), *filter(None, [tuned.at_given_stiffness])]
    at_worst = tuned.over_ranges
    for label, walls, mark, colour in (
        ("smallest radius", [tuned.least_radius.rounded], "D", GREEN),
        ("best damping at a given stiffness", [one.rounded for one in given], "P", SKY),
        ("fastest at worst over the ranges", [at_worst], "p", PURPLE),
    ):
        pairs = [(wall.stiffness, wall.damping) for wall in walls if wall]
        gains = np.array([wall for wall in pairs if None not in wall], np.float64).reshape(-1, 2)
        if len(gains) == 1:
            label += f": {_gains_text(float(gains[0, 0]), float(gains[0, 1]), units)}"
        if len(gains):
            panel.plot(*gains.T, mark, color=colour, ms=8, mec=BLACK, ls="", label=label)


def _gains_text(stiffness: float, damping: float, units: Units) -> str:
    return f"{_STIFFNESS.words(stiffness, units)}, {_DAMPING.words(damping, units)}"


def _draw_best(
    panel: Axes, loop: HapticLoop, region: WallRegion, tuned: Tuned | None, units: Units
) -> None:
    stiffest = f"stiffest: {_LARGEST.words(region.stiffest.stiffness, units)}"
    damping = _DAMPING.words(region.stiffest.damping, units)
    panel.plot(*region.stiffest, ">", color=ORANGE, ms=9, mec=BLACK, label=f"{stiffest}, {damping}")
    if tuned is None:
        best = loop.tune("settling")
        fastest = (best.stiffness, best.damping), best.settling_time
        if best.status == TuningStatus.NO_STABLE_GAINS:
            return
    else:
        _draw_tuned(panel, tuned, units)
        rounded = tuned.least_settling.rounded
        if rounded is None:
            return
        fastest = (rounded.stiffness, rounded.damping), rounded.settling_time_2_percent
    gains, time = fastest
    label = f"fastest: {_gains_text(*gains, units)}, settles in {_TIME.words(time)}"
    panel.plot(*gains, "*", color=ORANGE, ms=12, mec=BLACK, label=label)


def _draw_chatter(
    panel: Axes, loop: HapticLoop, region: WallRegion, encoder: Encoder, units: Units
) -> None:
    """Draw lines of equal bounds of what the encoder's rounding does to the position."""
    resolution = encoder.resolution
    stiffness, damping = _columns_and_rows(region, _CALM_COLUMNS)
    amplitude = loop.amplitude(stiffness[None, :], damping[:, None], encoder=resolution)
    counts = np.where(np.isfinite(amplitude.position), amplitude.position / resolution, np.nan)
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
    return np.linspace(region.outline.min(axis=0), region.outline.max(axis=0), count).T


def _draw_settling(panel: Axes, loop: HapticLoop, region: WallRegion) -> None:
    """Draw lines of equal settling time to 2 %, in ms."""
    stiffness, damping = _columns_and_rows(region, _COLUMNS)
    settling = loop.settling_time(stiffness[None, :], damping[:, None], horizon=_HORIZON)
    times = np.where(np.isfinite(settling.value), 1e3 * np.asarray(settling.value), np.nan)
    if np.isnan(times).all():
        return
    fastest, slowest = float(np.nanmin(times)), float(np.nanmax(times))
    levels = [time for time in _ROUND if fastest < time < min(slowest, _LONGEST * fastest)]
    lines = panel.contour(
        stiffness, damping, times, levels, colors=BLACK, linewidths=0.7, linestyles="dotted"
    )
    panel.clabel(lines, fmt="%g ms", fontsize=7)


# A picture of several scenes: the stable set and the largest stiffness of each.

_SIZE = 10.0, 4.6  # inches
_COLOURS = BLUE, ORANGE, GREEN, RED, PURPLE, SKY, BLACK
_MOST_NAMES = 12  # in a legend


def comparison_figure(scenes: Mapping[str, Scene]) -> Figure:
    """The stable walls of several scenes by name, and the largest stiffness of each.

    Of the components that contain small gains. ValueError: there is no scene, or rotational and
    linear ones.
    """
    if not scenes:
        raise ValueError("no scene was answered; there is nothing to draw.")
    if len({scene.units for scene in scenes.values()}) > 1:
        raise ValueError("linear and rotational scenes cannot share a picture; draw them apart.")
    names, units = list(map(plain, scenes)), next(iter(scenes.values())).units
    regions = [reachable(wall_region(loop_of(scene))) for scene in scenes.values()]
    graded = colormaps["viridis"](np.linspace(0.0, 0.9, len(scenes)))
    colours = _COLOURS[: len(scenes)] if len(scenes) <= len(_COLOURS) else list(graded)
    figure = Figure(figsize=_SIZE, layout="constrained")
    walls, largest = figure.subplots(1, 2, width_ratios=(3, 2))
    for name, region, colour in zip(names, regions, colours, strict=True):
        if not region.is_empty:
            walls.plot(*closed_outline(region).T, color=colour, lw=1.2, label=name)
    walls.set_title("stable walls")
    walls.set_xlabel(f"stiffness K ({units.stiffness})")
    walls.set_ylabel(f"damping B ({units.damping})")
    places = np.arange(len(scenes))
    stiffnesses = [region.stiffest.stiffness for region in regions]
    largest.barh(places, np.nan_to_num(stiffnesses), color=colours)
    largest.set_yticks(places, names, fontsize=7)
    largest.invert_yaxis()
    largest.set_xlabel(f"largest stiffness K ({units.stiffness})")
    largest.set_title("the largest stiffness")
    if len(scenes) <= _MOST_NAMES:
        walls.legend(fontsize=8, frameon=True)
    return figure


# A picture of a guard: the granted stiffness beside the exact one.

_CURVES = 5
_POINTS = 400


def guard_figure(guard: Guard, units: Units = Units.LINE) -> Figure:
    """The largest stiffness over the damping: exact, and as granted by the guard.

    For masses of the range, at the middle delay or for a delay that moves; where it is constant, on
    the left for delays, at the middle mass.
    """
    figure = Figure(figsize=_SIZE, layout="constrained")
    panels = figure.subplots(1, 1 + guard.is_delay_constant, sharey=True, squeeze=False)[0]
    left, right = panels[0], panels[-1]
    mass, delay = float(np.mean(guard.mass)), None
    low, high = (f"{1e3 * end:.3g}" for end in guard.delay)
    title = f"a delay that moves between {low} and {high} ms"
    if guard.is_delay_constant:
        delay = float(np.mean(guard.delay))
        for one, colour in _coloured(guard.delay):
            _draw(left, guard, (mass, one), colour, f"{1e3 * one:.3g} ms")
        left.set_title(f"delays, at {mass:.3g} {units.kilogram}")
        title = f"{1e3 * delay:.3g} ms"
    for one, colour in _coloured(guard.mass):
        _draw(right, guard, (one, delay), colour, f"{one:.3g} {units.kilogram}")
    right.set_title(f"{units.moved} of the device, at {title}")
    left.set_ylabel(f"largest stiffness K ({units.stiffness}), for all hands")
    edge = "where a hand becomes unstable" + ("" if delay else " at a constant delay")
    for panel in panels:
        panel.set_xlabel(f"damping B ({units.damping})")
        panel.set_ylim(0.0, None)
        panel.set_xlim(0.0, None)
        panel.plot([], [], color="black", lw=0.8, ls="--", label=edge)
        panel.plot([], [], color="black", lw=1.6, label="granted, proved stable")
        panel.legend(fontsize=8)
    return figure


def _coloured(ends: tuple[float, float]) -> list[tuple[float, object]]:
    colours = colormaps["viridis"](np.linspace(0.0, 0.85, _CURVES))
    return list(zip(np.linspace(*ends, _CURVES).tolist(), colours, strict=True))


def _draw(
    panel: Axes, guard: Guard, place: tuple[float, float | None], colour: object, label: str
) -> None:
    mass, delay = place
    damping = np.linspace(0.0, 1.1 * float(guard.grid.top.max()), _POINTS)
    delays = np.array([guard.delay[0] if delay is None else delay])
    exact = guard.exact_stiffness(damping[None, None], mass=np.array([mass]), delay=delays)[0, 0]
    panel.plot(damping, np.where(exact > 0.0, exact, np.nan), color=colour, lw=0.8, ls="--")
    granted = guard.largest_stiffness(damping, mass=mass, delay=delay)
    panel.plot(damping, np.where(granted > 0.0, granted, np.nan), color=colour, lw=1.6, label=label)
