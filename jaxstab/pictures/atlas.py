"""Pictures of an atlas: verdicts and fields in planes of (alpha, beta)."""

from collections.abc import Sequence
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap, Normalize, PowerNorm
from matplotlib.contour import QuadContourSet
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from jaxstab.atlas.products.fields import FIELDS
from jaxstab.conventions import Verdict
from jaxstab.model import by_name
from jaxstab.pictures.style import (
    ALPHA_LABEL,
    BETA_LABEL,
    DAMPING_LABEL,
    SKY,
    STIFFNESS_LABEL,
    hand_label,
    new_axes,
    picture,
    plain,
)

if TYPE_CHECKING:
    from jaxstab.atlas import Atlas, LoopAtlas

_RASTER = 400  # points along each side of a plane
_WIDTH, _HEIGHT = 3.3, 2.9  # inches of a panel
_MOST_PLANES = 6
_LINE = 60  # letters of a title

# The rows of a picture, and the products that provide each.
_ANSWERED_BY = {
    "verdict": {"verdict", "alpha_limits"},
    "spectral_radius": {FIELDS},
    "frequency": {FIELDS},
    "damping_ratio": {FIELDS},
}

# Fields at nodes: the label of their colours, and the map from values to colours.
_FIELDS = {
    "frequency": ("frequency of the dominant pole\n(rad per sample)", PowerNorm(0.5, 0.0, np.pi)),
    "damping_ratio": ("damping ratio of the dominant pole", Normalize(0.0, 1.0)),
}

# Distinguishable with any colour vision, and in grey.
_COLOURS = {
    Verdict.NOT_COMPUTED: "#ffffff",
    Verdict.STABLE: SKY,
    Verdict.UNSTABLE: "#f5ead0",
    Verdict.UNDECIDED: "#444444",
}
_RADII = (0.6, 0.7, 0.8, 0.85, 0.9, 0.94, 0.97, 1.0, 1.02, 1.05, 1.1)  # finer towards the boundary

Floats = NDArray[np.float64]


def draw_atlas(
    atlas: "Atlas", gamma: float, delta: float, delays: Sequence[float] | None = None
) -> bytes:
    """A PNG of an atlas in planes of (alpha, beta), one for each of at most 6 of its delays.

    Fields are drawn at the nodes of gamma and delta that are nearest. ValueError: gamma or delta is
    outside of the atlas, a delay is not one of the atlas, or the atlas has nothing to draw.
    """
    indices = _indices_of(atlas, delays)
    rows = [answer for answer, own in _ANSWERED_BY.items() if not own.isdisjoint(atlas.products)]
    if not rows:
        raise ValueError(
            f"this atlas holds {', '.join(atlas.products)}; a picture needs one of "
            f"{', '.join(sorted(set().union(*_ANSWERED_BY.values())))}."
        )
    size = _WIDTH * len(indices) + 0.9, _HEIGHT * len(rows) + 1.0
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(len(rows), len(indices), squeeze=False)
    filled: dict[str, ScalarMappable] = {}
    for column, index in zip(panels.T, indices, strict=True):
        for panel, row in zip(column, rows, strict=True):
            if row == "verdict":
                alpha, beta = _raster(atlas, index)
                hand = by_name(gamma, delta, atlas.delays[index])
                _draw_verdicts(panel, alpha, beta, atlas.verdict(alpha, beta[:, None], **hand))
            elif row in _FIELDS:
                plane = _nodes_of(atlas, row, index, gamma, delta)
                filled[row] = panel.pcolormesh(*plane, norm=_FIELDS[row][1])
            else:
                filled[row] = _draw_radii(panel, *_nodes_of(atlas, row, index, gamma, delta))
            panel.tick_params(labelsize=8)
        column[0].set_title(f"delay {atlas.delays[index]:g} T", fontsize=10)
        column[-1].set_xlabel(ALPHA_LABEL)
    for panel in panels[:, 0]:
        panel.set_ylabel(BETA_LABEL)
    for row, drawn in filled.items():
        is_radius = row == "spectral_radius"
        ticks = _RADII if is_radius else None
        bar = figure.colorbar(drawn, ax=list(panels[rows.index(row)]), pad=0.01, ticks=ticks)
        bar.ax.tick_params(labelsize=8)
        bar.set_label("spectral radius (line: 1)" if is_radius else _FIELDS[row][0])
    if "verdict" in rows:
        figure.legend(handles=_legend(), loc="outside lower center", ncols=3, frameon=False)
    figure.suptitle(f"{plain(atlas.filters_in_words)}\n{hand_label(gamma, delta)}", fontsize=10)
    return picture(figure, "png")


def plot_atlas(
    atlas: "Atlas", ax: Axes | None, gamma: float | None, delta: float | None, delay: float | None
) -> Axes:
    """Draw the verdicts of an atlas in one plane on axes, or on new ones: ``Atlas.plot``."""
    if _ANSWERED_BY["verdict"].isdisjoint(atlas.products):
        raise ValueError(f"this atlas holds {', '.join(atlas.products)}, and no verdicts to draw.")
    (index,) = _indices_of(atlas, [float(atlas.delays[0]) if delay is None else delay])
    middle = {name: float(axis[len(axis) // 2]) for name, axis in atlas.nodes(index).items()}
    hand = (
        middle["gamma"] if gamma is None else gamma,
        middle["delta"] if delta is None else delta,
        float(atlas.delays[index]),
    )
    alpha, beta = _raster(atlas, index)
    panel = new_axes() if ax is None else ax
    _draw_verdicts(panel, alpha, beta, atlas.verdict(alpha, beta[:, None], **by_name(*hand)))
    panel.set(xlabel=ALPHA_LABEL, ylabel=BETA_LABEL)
    words = fill(plain(atlas.filters_in_words), _LINE)
    panel.set_title(f"{words}\n{hand_label(*hand[:2])}, $d = {hand[2]:g}$", fontsize=9)
    panel.legend(handles=_legend(), fontsize=8, loc="upper right")
    return panel


def plot_walls(walls: "LoopAtlas", ax: Axes | None) -> Axes:
    """Draw the verdicts of an atlas for the walls of one loop, in SI units: ``LoopAtlas.plot``."""
    atlas, loop = walls.atlas, walls.loop
    nearest = int(np.argmin(np.abs(atlas.delays - loop.delay_samples)))
    alpha, beta = _raster(atlas, nearest)
    stiffness, damping = loop.stiffness(alpha), loop.damping(beta)
    panel = new_axes() if ax is None else ax
    _draw_verdicts(
        panel, stiffness, damping, walls.verdict(stiffness, damping[:, None], "undecided")
    )
    panel.set(xlabel=STIFFNESS_LABEL, ylabel=DAMPING_LABEL)
    words = fill(plain(atlas.filters_in_words), _LINE)
    panel.set_title(f"{words}\n{loop.mass:g} kg, delay {1e3 * loop.delay:g} ms", fontsize=9)
    panel.legend(handles=_legend(), fontsize=8, loc="upper right")
    return panel


def _raster(atlas: "Atlas", index: int) -> tuple[Floats, Floats]:
    nodes = atlas.nodes(index)
    alpha, beta = (
        np.linspace(nodes[name][0], nodes[name][-1], _RASTER) for name in ("alpha", "beta")
    )
    return alpha, beta


def _indices_of(atlas: "Atlas", delays: Sequence[float] | None) -> list[int]:
    nodes = atlas.delays.tolist()
    chosen = nodes if delays is None else list(delays)
    for delay in chosen:
        if delay not in nodes:
            of_the_atlas = ", ".join(f"{node:g}" for node in nodes)
            raise ValueError(f"delay {delay:g} is not in this atlas; give some of {of_the_atlas}.")
    return [nodes.index(delay) for delay in chosen[:_MOST_PLANES]]


def _draw_verdicts(panel: Axes, alpha: Floats, beta: Floats, verdict: NDArray[np.int8]) -> None:
    colours = ListedColormap([_COLOURS[code] for code in Verdict])
    panel.pcolormesh(alpha, beta, verdict, cmap=colours, vmin=-0.5, vmax=len(Verdict) - 0.5)


def _draw_radii(panel: Axes, alpha: Floats, beta: Floats, radius: Floats) -> QuadContourSet:
    filled = panel.contourf(
        alpha,
        beta,
        radius,
        levels=_RADII,
        norm=BoundaryNorm(_RADII, ncolors=256, extend="both"),
        cmap="viridis",
        extend="both",
    )
    panel.contour(alpha, beta, radius, levels=[1.0], colors="white", linewidths=1.2)
    return filled


def _nodes_of(atlas: "Atlas", name: str, index: int, *hand: float) -> tuple[Floats, Floats, Floats]:
    """Return alpha, beta and a field at the nodes of gamma and delta that are nearest."""
    alpha, beta, *axes = atlas.nodes(index).values()
    i, j = (int(np.argmin(np.abs(axis - value))) for axis, value in zip(axes, hand, strict=True))
    return alpha, beta, atlas.arrays[name][:, :, i, j, index].T.astype(float)


def _legend() -> list[Patch]:
    shown = (Verdict.STABLE, Verdict.UNSTABLE, Verdict.UNDECIDED)
    return [
        Patch(facecolor=_COLOURS[code], edgecolor="#888888", label=code.name.lower())
        for code in shown
    ]
