"""A picture of several scenes: what is stable in each, and the largest stiffness of each."""

from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxstab.pictures.shown import closed_outline
from jaxstab.pictures.style import BLACK, BLUE, GREEN, ORANGE, PURPLE, RED, SKY, plain
from jaxstab.scene.loops import loop_of, reachable, wall_region
from jaxstab.scene.many import Variant, short
from jaxstab.scene.scene import Scene

_SIZE = 10.0, 4.6  # inches
_COLOURS = BLUE, ORANGE, GREEN, RED, PURPLE, SKY, BLACK
_MOST_NAMES = 12  # in a legend


def comparison_figure(variants: Sequence[Variant]) -> Figure:
    """Draw the stable walls of several scenes that gains reach when they are turned up from 0.

    Beside them stands the largest stiffness of each: over the values of a key, where one was swept
    through numbers, else by name.

    Raises:
        ValueError: there is no scene, or some turn and others move along a line.

    Source: sec. V of Hulin, Preusche, Hirzinger (2008).
    """
    scenes = [variant.scene for variant in variants if variant.scene]
    if not scenes:
        raise ValueError("no scene was answered; there is nothing to draw.")
    if len({scene.units for scene in scenes}) > 1:
        raise ValueError("some of the scenes turn, others move along a line; draw them apart.")
    regions = [reachable(wall_region(loop_of(scene))) for scene in scenes]
    swept = _swept_numbers(variants)
    colours = _colours(len(scenes), is_graded=swept is not None)
    figure = Figure(figsize=_SIZE)
    figure.set_layout_engine("constrained")
    walls, largest = figure.subplots(1, 2, width_ratios=(3, 2))
    for variant, region, colour in zip(variants, regions, colours, strict=True):
        if not region.is_empty:
            outline = closed_outline(region)
            walls.plot(*outline.T, color=colour, lw=1.2, label=_label(variant))
    walls.set_title("stable walls, as far as gains are turned up")
    _name_axes(walls, scenes[0])
    stiffnesses = [region.stiffest.stiffness for region in regions]
    if swept is None:
        _draw_bars(largest, [_label(variant) for variant in variants], stiffnesses, colours)
        largest.set_xlabel(f"largest stiffness K ({scenes[0].units.stiffness})")
        if len(scenes) <= _MOST_NAMES:
            walls.legend(fontsize=8, frameon=True, title=", ".join(variants[0].values))
    else:
        name, values = swept
        largest.plot(values, stiffnesses, color=BLACK, lw=0.8, zorder=1)
        largest.scatter(values, stiffnesses, c=colours, s=24, zorder=2)
        largest.set(xlabel=name, ylim=(0.0, None))
        largest.set_ylabel(f"largest stiffness K ({scenes[0].units.stiffness})")
    largest.set_title("the largest stiffness")
    return figure


def _label(variant: Variant) -> str:
    """Return the file and the values, without their keys."""
    values = map(short, variant.values.values())
    return plain(", ".join([*([variant.source] if variant.source else []), *values]))


def _swept_numbers(variants: Sequence[Variant]) -> tuple[str, list[float]] | None:
    """Return the key and its values where one file was swept through the numbers of one key."""
    keys = {tuple(variant.values) for variant in variants}
    if len({variant.source for variant in variants}) > 1 or len(keys) > 1:
        return None
    (names,) = keys
    values = [value for variant in variants for value in variant.values.values()]
    numbers = [value for value in values if isinstance(value, float)]
    return (names[0], numbers) if len(names) == 1 and len(numbers) == len(variants) > 1 else None


def _colours(count: int, *, is_graded: bool) -> list[object]:
    if is_graded or count > len(_COLOURS):
        return list(colormaps["viridis"](np.linspace(0.0, 0.9, count)))
    return list(_COLOURS[:count])


def _name_axes(panel: Axes, scene: Scene) -> None:
    panel.set_xlabel(f"stiffness K ({scene.units.stiffness})")
    panel.set_ylabel(f"damping B ({scene.units.damping})")


def _draw_bars(panel: Axes, names: list[str], values: list[float], colours: list[object]) -> None:
    places = np.arange(len(names))
    panel.barh(places, np.nan_to_num(values), color=colours)
    panel.set_yticks(places, names, fontsize=7)
    panel.invert_yaxis()
