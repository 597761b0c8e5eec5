"""Pictures of scenes and studies.

Of a scene: the stable set in the plane of K and B, its walls and their responses.
Below that several scenes in one picture, a guard, simulated contacts, and the log that a device was
identified from.

Of a study: the largest stiffness, or the share for which a wall is stable. Without a list the draws
are shown as a distribution. Over one list there is a line, with a band from the 5th to the 95th
percentile of the draws; over two a line for each value of the second one, or a map if it has many.
Walls are a line each, with the band of 95 % confidence.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from decimal import ROUND_FLOOR
from itertools import cycle, product
from math import isfinite
from textwrap import fill, wrap
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection, QuadMesh
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jaxstab import lab
from jaxstab.answers import BUT_FOR_DRIFT, GIVEN, Basis, GainAnswer, Quantity, Units, in_words
from jaxstab.app.pictures.style import HALO, Level, Spot, write_names
from jaxstab.app.scene import loops
from jaxstab.app.scene.answers import basis_of
from jaxstab.app.scene.check import check_walls
from jaxstab.app.scene.contact import simulated_map, walls_around
from jaxstab.app.scene.gains import GainScene
from jaxstab.app.scene.limits import StableGains
from jaxstab.app.scene.scene import Encoder, Scene
from jaxstab.app.scene.tune import stiffness_over
from jaxstab.conventions import Verdict
from jaxstab.drawing import (
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    PLUM,
    PURPLE,
    RED,
    SKY,
    Floats,
    draw_islands,
    draw_linear_rule,
    draw_stable,
    plain,
    raise_powers,
)
from jaxstab.loop import HapticLoop, Region
from jaxstab.loop.answers import Answers
from jaxstab.loop.jitter import Jitter
from jaxstab.loop.wanted import margins_in_words
from jaxstab.motion.bounds import likely_settling

if TYPE_CHECKING:
    from xarray import DataArray, Dataset


# The walls of a scene in its picture: marks by their verdicts, names, and responses.

Marks = Mapping[str, tuple[Spot, Verdict | str]]  # where walls, or gains, stand, and verdicts

_LOOKS: dict[Verdict | str, tuple[str, str, str]] = {  # colour, mark and line of a wall
    Verdict.STABLE: (BLUE, "o", "-"),
    Verdict.UNSTABLE: (RED, "X", ":"),
    Verdict.UNDECIDED: (BLACK, "s", "--"),
    BUT_FOR_DRIFT: (SKY, "o", "-"),
}


def _with_origin(marks: Marks) -> Floats:
    return np.array([(0.0, 0.0), *(spot for spot, _ in marks.values())])


def _draw_marks(panel: Axes, marks: Marks, noun: str = "wall") -> None:
    """Draw a mark for each wall, by its verdict."""
    for verdict, (colour, mark, _) in _LOOKS.items():
        found = [spot for spot, own in marks.values() if own == verdict]
        look: Any = {"color": colour, "ms": 9, "mec": BLACK, "ls": "", "zorder": 5}
        if found:
            label = f"{noun}, {in_words(verdict)}"
            panel.plot(*np.transpose(found), mark, label=label, **look)


def draw_margins(panel: Axes, checked: dict[str, GainAnswer]) -> None:
    """Draw from each stable wall how far K alone, and B alone, may go."""
    label = "K alone, or B alone, may go this far"
    for wall in checked.values():
        if "stiffness_gain" in wall.values and np.isfinite(wall.stiffness_limits).all():
            stiffness, damping = wall.stiffness_limits, wall.damping_limits
            panel.plot(stiffness, [wall.damping] * 2, "|-", color=BLACK, lw=1.2, ms=9, label=label)
            panel.plot([wall.stiffness] * 2, damping, "_-", color=BLACK, lw=1.2, ms=9)
            label = ""


def draw_responses(panel: Axes, scene: Scene, checked: dict[str, GainAnswer]) -> None:
    """Draw the response to a step of force, relative to the final displacement."""
    far_off, seen, row = 5.0, 2.3, 0.22  # final positions: that are drawn, that are seen, of a name
    fewest, most = 100, 2000  # samples of a response
    level = 0.02
    period = scene.controller.sample_time
    times = (wall.values.get("settling_time_2_percent") for wall in checked.values())
    settled = [time for time in times if time is not None and isfinite(time)] or [0.0]
    longest = min(1.2 * max(settled), 6.0 * min(settled))
    samples = int(np.clip(longest / period, fewest, most))
    panel.set_prop_cycle(color=_COLOURS)
    for name, wall in checked.items():
        held = loops.loop_of(scene, wall.worst_hand)
        spring = held.device.static_stiffness() if held.device else held.hand_stiffness
        if wall.stiffness + spring == 0.0:  # there is no final displacement
            continue
        response = held.simulate(
            wall.stiffness, wall.damping, samples=samples, force=1.0, between=most // samples
        )
        relative = np.asarray(response.position) * (wall.stiffness + spring)
        gone = np.logical_or.accumulate(np.abs(relative) > far_off)
        shown = np.where(gone, np.nan, relative)
        panel.plot(np.asarray(response.time), shown, _LOOKS[wall.verdict][2], label=plain(name))
    panel.axhspan(1.0 - level, 1.0 + level, color=BLACK, alpha=0.12, lw=0)
    panel.set(xlim=(0.0, samples * period), ylim=(-0.3, seen + row * (len(checked) + 1)))
    panel.set(xlabel="time (s)", ylabel="position / final position")
    panel.legend(fontsize=8, framealpha=1.0, loc="upper right")  # above what is seen


_HEIGHT = 4.6  # inches
_WIDTH = 6.4
_MOST_LEVELS = 3  # of lines of equal values
_LARGEST = Quantity("N/m", 4, ROUND_FLOOR)
_STIFFNESS = Quantity("N/m", GIVEN)


def scene_figure(scene: Scene | GainScene, answer: GainAnswer | None = None) -> Figure:
    """The picture of an answer: one for each question, in SI units.

    Of ``scene_limits``, or without an answer, it is the stable set in the plane of K and B, the
    scene's walls and the walls for all hands; passive walls, or walls for all hands, that are too
    small to be seen are enlarged in a panel. Of ``check_walls`` it has the margins of the walls and
    their step responses, of ``tune_walls`` settling times and the best walls, of ``design_loop``
    the largest stiffness over the sample time and the delay, of ``simulate_contacts`` the map of
    simulated contacts. For a delay that moves it has the walls that are proved for every sequence.
    ValueError: no wall is stable. Of another loop it is the stable set of its gains.
    """
    if isinstance(scene, GainScene):
        return _gain_figure(scene, answer)
    given = answer or GainAnswer({})
    if "friction" in given.values:
        return scene_contacts(scene)
    if "now_allowed_stiffness" in given.values:
        return _design_figure(scene, given)
    is_tuned = "least_settling" in given.values
    is_check = "walls" in given.values and not (is_tuned or "best" in given.values)
    walls, basis = _judged(scene, given), basis_of(scene, at_longest=is_tuned)
    scene = scene.at_longest_delay if is_tuned else scene
    if scene.controller.moves:
        return _moving_figure(scene, walls, basis)
    loop = loops.loop_of(scene)
    everything = loops.wall_region(loop)
    if everything.is_empty:
        raise ValueError("no wall is stable for this scene; there is nothing to draw.")
    region, is_limits = everything.reachable, not (is_tuned or is_check)
    islands = [island for island in everything.islands if isfinite(island.stiffest.stiffness)]
    areas = [] if is_tuned else [_common(scene)]
    areas += [_passive(scene, loop)] if is_limits else []
    areas = [area for area in areas if len(area[0])]
    least = 0.05 * np.array(region.extent)  # in K or in B: smaller sets are enlarged
    small = [outline for outline, _ in areas if (np.ptp(outline, axis=0) < least).any()]
    beside = [("enlarged", np.concatenate(small))] if small else []
    if islands and is_limits and not small:
        outlines = [each.outline for each in (region, *islands)]
        beside.append(("with islands", np.maximum(np.concatenate(outlines), 0.0)))
    widths = [_WIDTH] + [3.6] * len(beside) + [4.8] * is_check  # inches
    figure = Figure(figsize=(sum(widths), _HEIGHT), layout="constrained")
    panels = figure.subplots(1, len(widths), squeeze=False, width_ratios=widths)[0]
    planes = [*panels[: 1 + len(beside)]]
    seen: Any = [np.maximum(region.outline, 0.0), _with_origin(walls)]
    if is_check:
        draw_margins(panels[0], given.walls)
        seen += [np.maximum(line.get_xydata(), 0.0) for line in panels[0].get_lines()]
    title = "Settling times of stable walls" if is_tuned else "Stable walls"
    views = [(title, np.concatenate(seen)), *beside]
    usable = _usable(loop, {} if is_tuned else scene.wanted.margins)
    for panel, (words, points) in zip(planes, views, strict=True):
        _set_window(panel, points)
        panel.set_title(words)
        _label_gains(panel, scene.units)
        draw_stable(panel, region._drawn)
        for outline, look in areas:
            panel.fill(*outline.T, **look)
        _draw_usable(panel, *usable)
        if not is_tuned:
            draw_islands(panel, [island._drawn for island in islands])
        if is_limits:
            draw_linear_rule(panel, loop._linear_rule)
    for panel in planes[1:]:
        panel.locator_params(axis="x", nbins=5)
    levels = []
    if is_tuned:
        levels = _draw_settling(panels[0], loop, region)
        encoder = scene.device.encoder
        if encoder is not None:
            levels += _draw_chatter(panels[0], loop, region, encoder, scene.units)
        _draw_tuned(panels[0], given, scene.units)
    elif is_check:
        draw_responses(panels[-1], scene, given.walls)
        panels[-1].set_title("Response to a constant push")
    elif isfinite(region.stiffest.stiffness):
        printed = StableGains(loop, are_walls=True).limit(loop.gains[0], *region.stiffest)
        pair = printed.largest_stiffness, printed.at_damping
        label = plain(f"stiffest: {_gains_text(*pair, scene.units, _LARGEST)}")
        panels[0].plot(*region.stiffest, ">", color=ORANGE, ms=9, mec=BLACK, label=label)
    for panel in planes:
        _draw_marks(panel, walls)
    _write_basis(figure, scene, basis, "; responses: worst hand of each wall" * is_check)
    return _with_legend(figure, planes, walls, min(1 + len(widths), 4), levels)


def _gain_figure(scene: GainScene, answer: GainAnswer | None) -> Figure:
    """The stable gains of a loop, in the coordinates of its region, with the pairs of a scene."""
    judged = answer.values.get("gains", {}) if answer else {}
    small = 0.1  # of the axes, in either direction: pairs that close are enlarged
    region, marks = scene.loop.region(), dict[str, tuple[Spot, Verdict | str]]()
    for name, pair in scene.pairs.items():
        with np.errstate(all="ignore"):  # of a mass of 0
            x, y = scene.loop._chart.of_gains(*np.array([*pair.values()]))
        verdict = judged[name].verdict if judged else scene.stable.verdict(*pair.values())
        marks[name] = (float(x), float(y)), verdict
    figure = Figure(figsize=(_WIDTH, _HEIGHT), layout="constrained")
    panels = [region.plot(figure.subplots())]
    points = _with_origin(marks)
    points = points[np.isfinite(points).all(axis=1)]
    window = np.ptp([panels[0].get_xlim(), panels[0].get_ylim()], axis=1)
    if len(points) > 1 and (np.ptp(points, axis=0) < small * window).all():
        figure = Figure(figsize=(1.6 * _WIDTH, _HEIGHT), layout="constrained")
        panels = [region.plot(panel) for panel in figure.subplots(1, 2)]
        _set_window(panels[1], points)
        panels[1].set_title("enlarged", fontsize=9)
    stiffest = ", the stiffest" if scene.is_range else ""
    figure.suptitle(fill(plain(scene.loop.words + stiffest), 70), fontsize=9)
    usable = _usable(scene.loop, scene.margins)
    for panel in panels:
        _draw_usable(panel, *usable)
        _draw_marks(panel, marks, "gains")
    return _with_legend(figure, panels, marks, 3)


def _write_basis(figure: Figure, scene: Scene, basis: Basis, more: str = "") -> None:
    """Write the assumptions above a picture: the estimator, the device, the delay, the hand."""
    letters, line = 14.0, 0.17  # of a remark, per inch; inches of a line
    delay, hand = basis.range_of_delays, loops.at_lowest(scene, "")
    remarks = [f"velocity: {basis.velocity}"]
    remarks += [f"delay {delay}" if delay else f"delay: {basis.delay_in_words}"]
    remarks += [remark for remark in (basis.mechanics, basis.postures) if remark]
    remarks += [f"hand {hand}{more}"] if hand else []
    width = int(letters * figure.get_figwidth())
    lines = [line for remark in remarks for line in wrap(remark, width)]
    figure.suptitle(plain("\n".join(lines)), fontsize=9)
    figure.set_figheight(figure.get_figheight() + line * max(0, len(lines) - 2))


def _design_figure(given: Scene, design: GainAnswer) -> Figure:
    """Draw the largest stiffness over the sample time and over the delay, and the wanted one."""
    scene, basis = given.at_longest_delay, basis_of(given, at_longest=True)
    largest_time = Quantity("s", 4, ROUND_FLOOR)
    room_above = 1.6  # of the stiffness that a design is about
    units, loop = scene.units, loops.loop_of(scene)
    figure = Figure(figsize=(1.5 * _WIDTH, _HEIGHT), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    wanted, now = design.stiffness, design.now_allowed_stiffness
    time, delay = design.sample_time.largest_sample_time, design.delay.largest_delay
    for panel, key, present, designed in (
        (panels[0], "sample_time", loop.sample_time, time),
        (panels[1], "delay", loop.delay, delay),
    ):
        name, (values, largest) = key.replace("_", " "), stiffness_over(key, scene, design)
        panel.plot(1e3 * values, largest, color=BLUE, lw=1.6, label="largest allowed stiffness")
        label = plain(f"wanted: {_STIFFNESS.words(wanted, units)}")
        panel.axhline(wanted, color=BLACK, lw=1.2, ls="dashdot", label=label)
        stiffest = _LARGEST.words(now, units) if isfinite(now) else "no stable wall"
        label = plain(f"now: {stiffest}")
        panel.plot(1e3 * present, now, "o", color=SKY, mec=BLACK, ms=8, ls="", label=label)
        if isfinite(designed):
            label = f"largest {name}: {largest_time.words(designed)}"
            panel.plot(
                1e3 * designed, wanted, "D", color=ORANGE, mec=BLACK, ms=8, label=label, ls=""
            )
        panel.set(xlabel=f"{name} (ms)", title=f"Stiffness over the {name}")
        panel.legend(fontsize=8)
    panels[0].set_ylabel(f"stiffness K ({units.stiffness})")
    panels[0].set_ylim(0.0, room_above * np.nanmax([wanted, now]))
    _write_basis(figure, scene, basis)
    return figure


def _judged(scene: Scene, answer: GainAnswer) -> Marks:
    """Return the marks of a scene's walls, with verdicts of an answer that has them."""
    known = answer.values.get("walls", {})
    judged = {name: wall for name, wall in known.items() if "hands_are" in wall.values}
    if scene.walls and not judged:
        judged = check_walls(replace(scene, wanted=replace(scene.wanted, measures=()))).walls
    return {name: ((wall.stiffness, wall.damping), wall.verdict) for name, wall in judged.items()}


def _moving_figure(scene: Scene, walls: Marks, basis: Basis) -> Figure:
    """Draw walls that are proved for every sequence of delays, and those of the scene."""
    figure = Figure(figsize=(_WIDTH, _HEIGHT), layout="constrained")
    panel = figure.subplots()
    loop = Jitter.from_loop(loops.loops_over_delays(scene)[0], **loops.delays_of(scene))
    stable = [spot for spot, verdict in walls.values() if verdict == Verdict.STABLE]
    drawn = draw_moving(loop, panel, stable)
    _draw_marks(panel, walls)
    _set_window(panel, np.concatenate([drawn, _with_origin(walls)]))
    _label_gains(panel, scene.units)
    _write_basis(figure, scene, basis)
    return _with_legend(figure, [panel], walls, 3)


def draw_moving(loop: Jitter, panel: Axes, stable: Iterable[tuple[float, float]] = ()) -> Floats:
    """Draw proved walls of a delay that moves, and unstable ones, which it returns, too.

    The area of the walls that are proved holds those that are known to be stable. ValueError: no
    wall was found that is proved.
    """
    proved, unstable = loop.stiffest_walls(stable)
    if not len(proved):
        raise ValueError(
            "no wall was found that is proved for every sequence of delays; there is nothing to "
            "draw."
        )
    unstable = unstable[np.isfinite(unstable[:, 0])]
    look: Any = {"color": SKY, "alpha": 0.35, "lw": 0}
    label = "stable for every sequence of delays, sampled"
    softest = loop.softest_walls(proved, stable)
    panel.fill_betweenx(proved[:, 1], softest, proved[:, 0], label=label, **look)
    label = "stiffest proved for every sequence, at some dampings"
    panel.plot(*proved.T, "o-", color=BLUE, lw=0.6, ms=4, label=label)
    panel.plot(*unstable.T, "x", color=RED, ms=6, label="unstable for some sequence, proved")
    return np.concatenate([proved, unstable])


def _label_gains(panel: Axes, units: Units) -> None:
    panel.set_xlabel(f"stiffness K ({units.stiffness})")
    panel.set_ylabel(f"damping B ({units.damping})")


def _with_legend(
    figure: Figure,
    panels: list[Axes],
    marks: Marks,
    most: int,
    levels: Sequence[Level] = (),
) -> Figure:
    """Write a legend of the first panel, in as many columns as fit, and what stands in panels.

    The figure becomes higher by what a long legend needs.
    """
    usual = 0.55  # inches
    handles, labels = panels[0].get_legend_handles_labels()
    for columns in range(most, 0, -1):
        legend = figure.legend(
            handles, labels, fontsize=8, frameon=False, ncols=columns, loc="outside lower center"
        )
        if columns == 1 or legend.get_window_extent().width <= figure.bbox.width:
            break
        legend.remove()
    more = legend.get_window_extent().height / figure.dpi - usual
    figure.set_figheight(figure.get_figheight() + max(0.0, more))
    return _named(figure, panels, {name: spot for name, (spot, _) in marks.items()}, levels)


def _named(
    figure: Figure, panels: list[Axes], spots: Mapping[str, Spot], levels: Sequence[Level] = ()
) -> Figure:
    """Write names in panels, and values on lines of the first one."""
    raise_powers(figure.axes)
    figure.draw_without_rendering()  # positions are known only now
    for panel in panels:
        write_names(panel, spots, levels if panel is panels[0] else ())
    return figure


_Area = tuple[Floats, dict[str, Any]]  # the outline (K, B) of a set of stable walls, and its look


def _common(scene: Scene) -> _Area:
    """The walls that are stable for the hands at all corners; empty without a range of hands."""
    for_all = "#8bc0e2"  # darker than the stable set
    outline = (
        loops.common_outline(loops.corner_loops(scene))
        if loops.hands_of(scene)
        else np.zeros((0, 2))
    )
    label = "stable for the hands at all corners of the range"
    return outline, {"facecolor": for_all, "lw": 0.0, "label": label}


def _passive(scene: Scene, loop: HapticLoop) -> _Area:
    # Of other estimators than the difference over one sample it would be hardly more than a dot.
    outline = loop.passive_region().outline if loops.is_plain(loop) else np.zeros((0, 2))
    largest = _LARGEST.words(np.max(outline[:, 0], initial=0.0), scene.units)
    label = plain(f"passive: up to {largest}")
    return outline, {"facecolor": GREEN, "edgecolor": GREEN, "alpha": 0.6, "label": label}


def _usable(loop: Answers, margins: Mapping[str, Any]) -> tuple[list[list[Spot]], str]:
    """Pieces of the gains that have margins, between rows of proved intervals, and their words.

    There are none of a delay margin, which is not proved for whole intervals.
    """
    rows = 48
    if not margins or "delay_margin" in margins:
        return [], ""
    top, other = loop.limits(**margins).second, loop.gains[1].name
    if not isfinite(top):
        return [], ""
    places = (top * np.linspace(0.0, 1.0 - 1e-6, rows)).tolist()
    lines = [loop.intervals(**{other: at}, **margins).inner for at in places]
    pieces = [
        [(a, low), (b, low), (d, high), (c, high)]
        for low, high, below, above in zip(places, places[1:], lines, lines[1:], strict=False)
        for (a, b), (c, d) in product(below, above)
        if max(a, c) <= min(b, d)
    ]
    return pieces, plain(f"with {margins_in_words(margins)}")


def _draw_usable(panel: Axes, pieces: list[list[Spot]], label: str) -> None:
    light = "#f3cf80"  # of orange; opaque, for pieces overlap at their edges
    look: Any = {"facecolor": light, "edgecolor": light, "lw": 0.3}
    if pieces:
        panel.add_collection(PolyCollection(pieces, label=label, **look), autolim=False)


def _set_window(panel: Axes, points: Floats) -> None:
    """Show some points (K, B), and a little more, whatever is drawn."""
    low, high = points.min(axis=0), points.max(axis=0)
    x, y = np.array([low - (0.04, 0.12) * (high - low), high + (0.12, 0.06) * (high - low)]).T
    panel.set(xlim=x, ylim=y)


def _draw_tuned(panel: Axes, tuned: GainAnswer, units: Units) -> None:
    """Draw the tuned walls, each with its own mark."""
    given = [*tuned.walls.values(), *filter(None, [tuned.at_given_stiffness])]
    fastest = tuned.least_settling.rounded
    for label, walls, mark, colour in (
        ("fastest", [fastest], "*", ORANGE),
        ("smallest radius", [tuned.least_radius.rounded], "D", GREEN),
        ("best damping at a given stiffness", [wall.rounded for wall in given], "P", SKY),
        ("fastest in the worst case of the ranges", [tuned.over_ranges], "p", PURPLE),
    ):
        pairs = [(wall.stiffness, wall.damping) for wall in walls if wall]
        gains = np.array([wall for wall in pairs if None not in wall], np.float64).reshape(-1, 2)
        if len(gains) == 1:
            label += f": {_gains_text(float(gains[0, 0]), float(gains[0, 1]), units)}"
        if mark == "*" and fastest:
            time = Quantity("s", 3).words(fastest.settling_time_2_percent)
            label += f", settles in {time}"
        if len(gains):
            look: Any = {"color": colour, "ms": 13 if mark == "*" else 8, "mec": BLACK, "ls": ""}
            panel.plot(*gains.T, mark, label=plain(label), zorder=5, **look)


def _gains_text(
    stiffness: float, damping: float, units: Units, quantity: Quantity = _STIFFNESS
) -> str:
    return f"{quantity.words(stiffness, units)}, {Quantity('N s/m', GIVEN).words(damping, units)}"


def _draw_chatter(
    panel: Axes, loop: HapticLoop, region: Region, encoder: Encoder, units: Units
) -> list[Level]:
    """Draw lines of equal bounds of the chatter that the encoder's resolution causes."""
    drawn = 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0, 20.0  # amplitudes that are drawn, in counts
    resolution, length = encoder.resolution, Quantity("m", 3)
    stiffness, damping = _columns_and_rows(region, 24)
    amplitude = loop.amplitude(stiffness[None, :], damping[:, None], encoder=resolution)
    counts = np.where(np.isfinite(amplitude.position), amplitude.position / resolution, np.nan)
    label = f"encoder of {length.words(resolution, units)}: chatters by less, proved"
    words = {count: length.words(count * resolution, units) for count in drawn}
    return _draw_levels(panel, (stiffness, damping, counts), words, label, PLUM, "dashed")


def _columns_and_rows(region: Region, count: int) -> Floats:
    return np.linspace(region.outline.min(axis=0), region.outline.max(axis=0), count).T


def _draw_settling(panel: Axes, loop: HapticLoop, region: Region) -> list[Level]:
    """Draw lines of equal settling time to 2 %, in ms."""
    stiffness, damping = _columns_and_rows(region, 64)
    walls = stiffness[None, :], damping[:, None]
    times = 1e3 * likely_settling(loop.in_floats(), *walls, horizon=4096)
    least = 1.5 * float(np.nanmin(times, initial=np.inf))
    even = np.outer(10.0 ** np.arange(-3, 8), [1.0, 2.0, 5.0]).ravel()  # ms
    words = {time: f"{time:g} ms" for time in even[even > least].tolist()}
    grid = stiffness, damping, times
    return _draw_levels(panel, grid, words, "settling time to 2 %", BLACK, "dotted")


def _draw_levels(
    panel: Axes,
    grid: tuple[Floats, Floats, Floats],
    words: Mapping[float, str],
    label: str,
    colour: str,
    style: str,
) -> list[Level]:
    """Draw the first lines of equal values that there are; their values are written last."""
    fewest, most = np.nanmin(grid[2], initial=np.inf), np.nanmax(grid[2], initial=0.0)
    levels = [value for value in words if fewest < value < most][:_MOST_LEVELS]
    if not levels:
        return []
    panel.plot([], [], color=colour, lw=1.0, ls=style, label=label)
    lines = panel.contour(*grid, levels, colors=colour, linewidths=1.0, linestyles=style)
    paths = zip(levels, lines.get_paths(), strict=True)
    return [Level(np.asarray(path.vertices), words[level], colour) for level, path in paths]


# A picture of several scenes: the stable set and the largest stiffness of each.

_SIZE = 10.0, 4.6  # inches
_COLOURS = BLUE, ORANGE, GREEN, RED, PURPLE, SKY, BLACK


def comparison_figure(scenes: Mapping[str, Scene]) -> Figure:
    """The stable walls of several scenes by name, and the largest stiffness of each.

    Of the components that contain small gains. ValueError: there is no scene, or rotational and
    linear ones.
    """
    most_names = 12  # in a legend
    if not scenes:
        raise ValueError("no scene was answered; there is nothing to draw.")
    if len({scene.units for scene in scenes.values()}) > 1:
        raise ValueError("linear and rotational scenes cannot share a picture; draw them apart.")
    names, units = list(map(plain, scenes)), next(iter(scenes.values())).units
    regions = [loops.wall_region(loops.loop_of(scene)).reachable for scene in scenes.values()]
    graded = colormaps["viridis"](np.linspace(0.0, 0.9, len(scenes)))
    colours = _COLOURS[: len(scenes)] if len(scenes) <= len(_COLOURS) else list(graded)
    figure = Figure(figsize=_SIZE, layout="constrained")
    walls, largest = figure.subplots(1, 2, width_ratios=(3, 2))
    for name, region, colour in zip(names, regions, colours, strict=True):
        if not region.is_empty:
            walls.plot(*region._drawn.T, color=colour, lw=1.2, label=name)
    walls.set_title("stable walls")
    _label_gains(walls, units)
    places = np.arange(len(scenes))
    stiffnesses = [region.stiffest.stiffness for region in regions]
    largest.barh(places, np.nan_to_num(stiffnesses), color=colours)
    largest.set_yticks(places, names, fontsize=7)
    largest.invert_yaxis()
    largest.set_xlabel(f"largest stiffness K ({units.stiffness})")
    largest.set_title("the largest stiffness")
    if len(scenes) <= most_names:
        walls.legend(fontsize=8, frameon=True)
    return figure


# A picture of a guard: the granted stiffness beside the exact one.


def guard_figure(guard: "lab.guard.Guard", units: Units = Units.LINE) -> Figure:
    """The largest stiffness over the damping: exact, and as granted by the guard.

    For masses of the range, at the middle delay or for a delay that moves; where it is constant, on
    the left for delays, at the middle mass.
    """
    curves = 5
    figure = Figure(figsize=_SIZE, layout="constrained")
    panels = figure.subplots(1, 1 + guard.is_delay_constant, sharey=True, squeeze=False)[0]
    mass, delay = float(np.mean(guard.mass)), None
    masses = np.linspace(*guard.mass, curves).tolist()
    delays = np.linspace(*guard.delay, curves).tolist()
    low, high = (f"{1e3 * end:.3g}" for end in guard.delay)
    title = f"delay between {low} and {high} ms"
    if guard.is_delay_constant:
        delay = delays[curves // 2]
        of_delays = [(f"{1e3 * value:.3g} ms", mass, value) for value in delays]
        _draw_granted(panels[0], guard, of_delays)
        panels[0].set_title(plain(f"five delays; {units.moved} {mass:.3g} {units.kilogram}"))
        title = f"delay {1e3 * delay:.3g} ms"
    of_masses = [(plain(f"{value:.3g} {units.kilogram}"), value, delay) for value in masses]
    _draw_granted(panels[-1], guard, of_masses)
    plural = {"mass": "masses", "inertia": "inertias"}[units.moved]
    panels[-1].set_title(f"five {plural}; {title}")
    panels[0].set_ylabel(f"largest stiffness K ({units.stiffness}), for all hands")
    edge = "where a hand becomes unstable" + ("" if delay else " at a constant delay")
    for panel in panels:
        panel.set(xlabel=f"damping B ({units.damping})", xlim=(0.0, None), ylim=(0.0, None))
        panel.legend(fontsize=8, loc="upper right")
    lines = [Line2D([], [], color=BLACK, lw=0.8, ls="--", label=edge)]
    lines += [Line2D([], [], color=BLACK, lw=1.6, label="granted, proved stable")]
    figure.legend(handles=lines, fontsize=9, frameon=False, ncols=2, loc="outside lower center")
    return figure


def _draw_granted(
    panel: Axes, guard: "lab.guard.Guard", places: Sequence[tuple[str, float, float | None]]
) -> None:
    """Draw the exact and the granted stiffness at masses and delays, by their labels."""
    damping = np.linspace(0.0, 1.1 * float(guard.grid.top.max()), 400)
    colours = colormaps["viridis"](np.linspace(0.0, 0.85, len(places)))
    for (label, mass, delay), colour in zip(places, colours, strict=True):
        place = {"mass": np.array([mass]), "delay": np.array([delay or guard.delay[0]])}
        exact = guard.exact_stiffness(damping[None, None], **place)[0, 0]
        granted = guard.largest_stiffness(damping, mass=mass, delay=delay)
        for stiffness, look in ((exact, {"lw": 0.8, "ls": "--"}), (granted, {"label": label})):
            seen = np.where(stiffness > 0.0, stiffness, np.nan)
            panel.plot(damping, seen, color=colour, **({"lw": 1.6} | look))


# Simulated contacts: where in (K, B) a device rests.

REST = "#98d594"
"""The colour of contacts that come to rest."""


def scene_contacts(scene: Scene) -> Figure:
    """Return the map of simulated contacts of a scene, from its own start, and its walls."""
    loop, gains, units = loops.loop_of(scene.at_longest_delay), loops.walls_of(scene), scene.units
    walls = walls_around(loop, 60, gains.values())  # along each axis
    (push, speed), contact = scene.start, simulated_map(scene, *walls)
    force = Quantity("N")
    words = f"push {force.words(push, units)}, speed {speed:g} {units.speed}, "
    words += f"friction {force.words(scene.device.friction, units)}\n"
    assert scene.contact is not None  # else nothing is simulated
    words += "one-sided wall" if scene.contact.one_sided else "wall that also pulls"
    words += ", gated by its force" if scene.contact.gate == "force" else ""
    figure = contact_figure(loop, walls, {words: contact}, gains, units)
    _write_basis(figure, scene, basis_of(scene, at_longest=True))
    return _named(figure, figure.axes[:1], gains)


def contact_figure(
    loop: HapticLoop,
    walls: tuple[Floats, Floats],
    maps: "Mapping[str, lab.contact.Contact]",
    marked: Mapping[str, tuple[float, float]] | None = None,
    units: Units = Units.LINE,
) -> Figure:
    """Return a figure with a panel for each map of walls, by its title; some walls are named."""
    figure = Figure(figsize=(1.2 + 4.2 * len(maps), 4.2), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(maps), sharey=True))
    for panel, (title, contact) in zip(panels, maps.items(), strict=True):
        mesh = _draw_map(panel, loop, walls, contact)
        panel.set_title(plain(title), fontsize=9)
        panel.set_xlabel(f"stiffness K ({units.stiffness})")
        for gains in (marked or {}).values():
            panel.plot(*gains, "o", color=BLACK, mfc="white", ms=6, clip_on=False, zorder=5)
    length = "mm" if units is Units.LINE else "mrad"
    words = f"does not rest, simulated:\namplitude at the end ({length})"
    bar = figure.colorbar(mesh, ax=list(panels), extend="both", label=words)
    bar.ax.tick_params(labelsize=7)
    panels[0].set_ylabel(f"damping B ({units.damping})")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=8, frameon=False, ncols=2, loc="outside lower center")
    return figure


def _draw_map(
    panel: Axes, loop: HapticLoop, walls: tuple[Floats, Floats], contact: "lab.contact.Contact"
) -> QuadMesh:
    """Draw where contacts rest, how far others move, and the edge of the stable set."""
    faintest, strongest = 1e-3, 100.0  # mm, of the colours
    stiffness, damping = (np.ravel(gains) for gains in walls)
    does_rest = contact.kind == lab.contact.ContactKind.RESTS
    is_through = contact.kind == lab.contact.ContactKind.PUSHED_THROUGH
    amplitude = np.where(is_through, np.inf, contact.amplitude)  # nothing holds it
    size = np.clip(1000.0 * amplitude, faintest, strongest)
    look: Any = {"shading": "nearest", "rasterized": True}
    rests = np.where(does_rest, 1.0, np.nan)
    panel.pcolormesh(stiffness, damping, rests, cmap=ListedColormap([REST]), **look)
    look |= {"cmap": "inferno_r", "norm": LogNorm(faintest, strongest)}
    mesh = panel.pcolormesh(stiffness, damping, np.where(does_rest, np.nan, size), **look)
    panel.fill([], [], color=REST, label="rests, simulated")
    edge = panel.plot(*loop.region()._drawn.T, color=BLUE, lw=1.6)
    edge[0].set(label="edge of stability of the linear loop", path_effects=HALO)
    panel.set(xlim=(0.0, stiffness[-1]), ylim=(0.0, damping[-1]))
    panel.tick_params(labelsize=8)
    return mesh


# A fitted log: measured and fitted positions, and the residual over time.


def identified_figure(device: "lab.identify.Identified", units: Units) -> Figure:
    """Return the first two segments, and the residual of the whole log."""
    fit_size = (7.0, 4.6)  # inches

    figure = Figure(figsize=fit_size, layout="constrained")
    above, below = figure.subplots(2, 1, height_ratios=[3, 2])
    milli, micro = f"m{units.length}", f"u{units.length}"
    is_step = len(device.measured) == 1  # of a servo
    times = device.sample_time * (
        lab.identify.HISTORY * (not is_step) + np.arange(device.measured.size)
    )
    shown = slice(2 * device.measured.shape[1])
    measured, fitted = np.ravel(device.measured), np.ravel(device.fitted)
    above.plot(times[shown], 1e3 * measured[shown], color=ORANGE, lw=3.5, label="measured")
    above.plot(times[shown], 1e3 * fitted[shown], "--", color=BLUE, lw=1.4, label="fitted")
    for begin in times[: shown.stop : device.measured.shape[1]]:
        above.axvline(begin, color="0.75", lw=0.8, zorder=0)
    above.set(xlabel="time (s)", ylabel=f"position ({milli})")
    words = "first two segments, each with a fitted initial position and velocity"
    above.set_title("step of the set point" if is_step else words)
    above.title.set_fontsize(9)
    above.legend(fontsize=8, loc="upper right", framealpha=0.9)
    below.plot(times, 1e6 * (measured - fitted), ".", color=RED, ms=1.0, rasterized=True)
    if device.resolution:
        for side in (-0.5, 0.5):
            label = "half a step of the encoder" if side > 0.0 else ""
            below.axhline(side * 1e6 * device.resolution, color=BLUE, lw=1.0, label=label)
        below.legend(fontsize=8, loc="upper right", framealpha=0.9)
    top = 1.7 * float(abs(measured - fitted).max()) * 1e6  # room for the legend
    below.set(ylim=(-top / 1.5, top), xlabel="time (s)", ylabel=f"residual ({micro})")
    return figure


# ------------------------------------------------------------------------------------------ studies
def study_figure(study: "Dataset") -> Figure:
    """Return the picture of a study; ValueError for one with more than two lists."""
    lists, is_drawn = lab.study.lists_of(study), lab.study.SAMPLE in study.dims
    if len(lists) > 2:
        raise ValueError(
            f"the study has {len(lists)} lists ({', '.join(lists)}), and a picture shows two; "
            "choose by study.isel(...)."
        )
    figure = Figure(figsize=(6.0, 4.2), layout="constrained")
    panel = figure.subplots()
    panel.grid(visible=True, lw=0.3)
    limit: Any = lab.study.limit_in(study)
    if limit is None:
        if len(lists) != 1 or "verdict" not in study:
            raise ValueError(
                "the study has nothing to draw: give limits among answers, or verdict over one "
                "list."
            )
        found: Any = lab.study.shares(study) if is_drawn else study.verdict == Verdict.STABLE
        bands = [found.low, found.share, found.high] if is_drawn else [found]
        _draw_lines(
            panel, study, [100.0 * band.transpose(..., lab.study.walls_in(study)) for band in bands]
        )
        panel.set_ylabel("% of the draws for which the wall is stable\n(band: 95 % confidence)")
        panel.set_ylim(-4.0, 104.0)
        if not is_drawn:
            panel.set_ylabel("verdict")
            panel.set_yticks([0.0, 100.0], ["not proved\nstable", "stable"])
        return figure
    label = _label(study[limit])
    if not lists:
        below = np.linspace(0.0, 1.0, 1001)
        allowed = below if lab.study.sense_of(limit) == "least" else 1.0 - below
        panel.plot(
            lab.study.quantiles(study, limit, at=below.tolist()),
            100.0 * allowed,
            color=BLUE,
            lw=1.5,
        )
        panel.set_xlabel(label)
        panel.set_ylabel("% of the draws that allow it")
        panel.set_ylim(0.0, 103.0)
        panel.set_title(f"{study.sizes[lab.study.SAMPLE]:,} draws", fontsize=9)
        return figure
    bands = [*lab.study.quantiles(study, limit)] if is_drawn else [study[limit]]
    bands = [band.transpose(*lists) for band in bands]
    if len(lists) == 2 and study.sizes[lists[1]] > 6:  # lines in one panel
        _draw_study_map(
            panel, bands[len(bands) // 2], f"{label}\n(median of the draws)" if is_drawn else label
        )
        return figure
    _draw_lines(panel, study, bands)
    panel.set_ylim(bottom=0.0)
    panel.set_ylabel(f"{label}\n(median; band: 5th to 95th percentile)" if is_drawn else label)
    return figure


def _label(values: "DataArray") -> str:
    long_name, unit = values.attrs["long_name"].partition(";")[0], values.attrs["units"]
    return plain(long_name if unit in ("", "1") else f"{long_name} ({unit})")


def _is_number(values: "DataArray") -> bool:
    return values.dtype.kind in "fi"


def _draw_lines(panel: Axes, study: "Dataset", bands: "list[DataArray]") -> None:
    """Draw the middle one of bands, over a list and perhaps another one, and what lies between."""
    most_letters = 40  # below the axes, of words side by side
    looks = cycle(zip(("-", "--", "-.", ":"), "os^D", strict=True))
    first, *second = (study[name] for name in bands[0].dims)
    panel.set_xlabel(_label(first))
    places: Any = first.values
    if _is_number(first):
        panel.locator_params(axis="x", nbins=7)  # numbers of many digits stand apart
    else:  # words are side by side
        places = np.arange(len(first))
        words = [plain(str(word)) for word in first.values]
        are_long = sum(map(len, words)) > most_letters
        turned: Any = {"rotation": 30, "ha": "right", "rotation_mode": "anchor"} if are_long else {}
        panel.set_xticks(places, words, **turned)
    lines = np.reshape(bands, (len(bands), len(places), -1))
    count = lines.shape[2]
    colors = [BLUE] if count == 1 else mpl.colormaps["viridis"](np.linspace(0, 0.85, count))
    for k, (color, (line, mark)) in enumerate(zip(colors, looks, strict=False)):
        value = second[0][k].item() if second else ""
        label = plain(f"{value:g}" if isinstance(value, int | float) else f"{value}")
        look: Any = {"ls": line if _is_number(first) else "", "marker": mark, "color": color}
        size = 4 if _is_number(first) else 7
        panel.plot(places, lines[len(bands) // 2, :, k], ms=size, label=label, **look)
        panel.fill_between(places, *lines[[0, -1], :, k], color=color, alpha=0.2, lw=0)
    if second:
        panel.legend(title=_label(second[0]), fontsize=8, title_fontsize=8)


def _draw_study_map(panel: Axes, values: "DataArray", label: str) -> None:
    x, y = (values[name] for name in values.dims)
    if not (_is_number(x) and _is_number(y)):
        raise ValueError(f"{x.name} and {y.name} are not both numbers; draw fewer words.")
    panel.grid(visible=False)
    mesh = panel.pcolormesh(x, y, values.T, shading="nearest", cmap="viridis")
    if min(values.shape) >= 2 and values.min() < values.max():
        lines = panel.contour(x, y, values.T, levels=3, colors="white", linewidths=0.8)
        panel.clabel(lines, fontsize=7)
    figure: Any = panel.figure
    figure.colorbar(mesh, label=label)
    panel.set_xlabel(_label(x))
    panel.set_ylabel(_label(y))
