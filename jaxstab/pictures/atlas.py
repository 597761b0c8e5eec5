"""Pictures of an atlas: verdicts and fields in planes of (alpha, beta)."""

from collections.abc import Sequence
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap, Normalize, PowerNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from jaxstab.conventions import Verdict
from jaxstab.model import by_name
from jaxstab.numbers import checked_number
from jaxstab.pictures.style import (
    ALPHA_LABEL,
    BETA_LABEL,
    DAMPING_LABEL,
    SKY,
    STIFFNESS_LABEL,
    Floats,
    hand_label,
    new_axes,
    picture,
    plain,
)

if TYPE_CHECKING:
    from jaxstab.atlas import Atlas, LoopAtlas


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


def draw_atlas(
    atlas: "Atlas",
    gamma: float | None = None,
    delta: float | None = None,
    delays: Sequence[float] = (),
) -> bytes:
    """A PNG of an atlas in planes of (alpha, beta), one for each of at most 6 delays.

    Verdicts are those of queries. Fields, if there are any, are drawn at the nodes of gamma and
    delta that are nearest, at delays of theirs. Without delays these are those of the fields, or
    whole ones. ValueError: a value is outside of the atlas, or a delay has no fields.
    """
    chosen = _delays(atlas, delays)
    rows = ["verdict", *(("spectral_radius", *_FIELDS) if atlas.has_fields else ())]
    table = atlas.table
    hand = (
        float(table.gamma[0]) if gamma is None else gamma,
        float(table.delta[0]) if delta is None else delta,
    )
    size = 3.3 * len(chosen) + 0.9, 2.9 * len(rows) + 1.0  # inches
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(len(rows), len(chosen), squeeze=False)
    filled: dict[str, ScalarMappable] = {}
    for column, delay in zip(panels.T, chosen, strict=True):
        alpha, beta = _raster(atlas, *hand, delay)
        plane = by_name(*hand, delay)
        _draw_verdicts(column[0], alpha, beta, atlas.query(alpha, beta[:, None], **plane).verdict)
        for panel, row in zip(column[1:], rows[1:], strict=True):
            nodes = _nodes_of(atlas, row, *hand, delay)
            if row in _FIELDS:
                filled[row] = panel.pcolormesh(*nodes, norm=_FIELDS[row][1])
            else:
                look: Any = {"norm": BoundaryNorm(_RADII, 256, extend="both"), "cmap": "viridis"}
                filled[row] = panel.contourf(*nodes, levels=_RADII, extend="both", **look)
                panel.contour(*nodes, levels=[1.0], colors="white", linewidths=1.2)
        for panel in column:
            panel.tick_params(labelsize=8)
            panel.locator_params(axis="x", nbins=5)
        column[0].set_title(f"delay {delay:g} T", fontsize=10)
        column[-1].set_xlabel(ALPHA_LABEL)
    for panel in panels[:, 0]:
        panel.set_ylabel(BETA_LABEL)
    for row, drawn in filled.items():
        is_radius = row == "spectral_radius"
        ticks = _RADII if is_radius else None
        bar = figure.colorbar(drawn, ax=list(panels[rows.index(row)]), pad=0.01, ticks=ticks)
        bar.ax.tick_params(labelsize=8)
        bar.set_label("spectral radius (line: 1)" if is_radius else _FIELDS[row][0])
    figure.legend(handles=_legend(), loc="outside lower center", ncols=3, frameon=False)
    title = f"{plain(atlas.filters_in_words)}\n{hand_label(*hand)}"
    if atlas.has_fields:
        places = zip((atlas.fields["gamma"], atlas.fields["delta"]), hand, strict=True)
        near = [float(axis[np.argmin(np.abs(axis - value))]) for axis, value in places]
        title += f"; fields at {hand_label(*near)}" * (near != [*hand])
    figure.suptitle(title, fontsize=10)
    return picture(figure, "png")


def plot_atlas(
    atlas: "Atlas", ax: Axes | None, gamma: float | None, delta: float | None, delay: float | None
) -> Axes:
    """Draw the verdicts of an atlas in one plane on axes, or on new ones: ``Atlas.plot``."""
    table = atlas.table
    hand = (
        float(table.gamma[table.gamma.size // 2]) if gamma is None else gamma,
        float(table.delta[table.delta.size // 2]) if delta is None else delta,
        float(table.delay[0]) if delay is None else delay,
    )
    alpha, beta = _raster(atlas, *hand)
    verdict = atlas.query(alpha, beta[:, None], **by_name(*hand)).verdict
    words = f"{hand_label(*hand[:2])}, $d = {hand[2]:g}$"
    return _plot_plane(ax, atlas, (alpha, beta, verdict), (ALPHA_LABEL, BETA_LABEL), words)


def plot_walls(walls: "LoopAtlas", ax: Axes | None) -> Axes:
    """Draw the verdicts of an atlas for the walls of one loop, in SI units: ``LoopAtlas.plot``."""
    loop = walls.loop
    alpha, beta = _raster(walls.atlas, *loop.slice.values())
    stiffness, damping = loop.stiffness(alpha), loop.damping(beta)
    plane = stiffness, damping, walls.query(stiffness, damping[:, None]).verdict
    words = f"{loop.mass:g} kg, delay {1e3 * loop.delay:g} ms"
    return _plot_plane(ax, walls.atlas, plane, (STIFFNESS_LABEL, DAMPING_LABEL), words)


def _plot_plane(
    ax: Axes | None, atlas: "Atlas", plane: Any, labels: tuple[str, str], words: str
) -> Axes:
    panel = new_axes() if ax is None else ax
    _draw_verdicts(panel, *plane)
    panel.set(xlabel=labels[0], ylabel=labels[1])
    filters = fill(plain(atlas.filters_in_words), 60)
    panel.set_title(f"{filters}\n{words}", fontsize=9)
    panel.legend(handles=_legend(), fontsize=8, loc="upper right")
    return panel


def _raster(atlas: "Atlas", gamma: float, delta: float, delay: float) -> tuple[Floats, Floats]:
    """Return alphas and betas around the stable set of a plant."""
    aside = 0.06  # around the stable set, of its size
    raster = 400  # points along each side of a plane
    given = {"gamma": gamma, "delta": delta, "delay": delay}
    plant = [np.array([checked_number(name, value)]) for name, value in given.items()]
    low, high = atlas.table.ends(*plant)[0]
    if np.isnan(low):
        raise ValueError(
            f"gamma {gamma:g}, delta {delta:g} and delay {delay:g} are outside of this atlas, or "
            "nothing is stable there."
        )
    rows = low + atlas.table.row * (high - low)
    limits = atlas.table.limits(rows, *(np.repeat(value, rows.size) for value in plant))
    spans = (np.nanmin(limits.lower), np.nanmax(limits.upper)), (low, high)
    alpha, beta = (np.linspace(a - aside * (b - a), b + aside * (b - a), raster) for a, b in spans)
    return alpha, beta


def _delays(atlas: "Atlas", given: Sequence[float]) -> list[float]:
    """Return the delays of a picture; ValueError for one that has no fields."""
    most_planes = 6
    nodes = (atlas.fields["delay"] if atlas.has_fields else atlas.table.delay).tolist()
    for delay in given:
        if atlas.has_fields and delay not in nodes:
            listed = ", ".join(f"{node:g}" for node in nodes)
            raise ValueError(f"delay {delay:g} has no fields in this atlas; give some of {listed}.")
    whole = [delay for delay in nodes if float(delay).is_integer()]
    return [*(given or (nodes if atlas.has_fields else whole or nodes))][:most_planes]


def _draw_verdicts(panel: Axes, alpha: Floats, beta: Floats, verdict: NDArray[np.int8]) -> None:
    colours = ListedColormap([_COLOURS[code] for code in Verdict])
    panel.pcolormesh(alpha, beta, verdict, cmap=colours, vmin=-0.5, vmax=len(Verdict) - 0.5)


def _nodes_of(
    atlas: "Atlas", name: str, gamma: float, delta: float, delay: float
) -> tuple[Floats, Floats, Floats]:
    """Return alpha, beta and a field at the nodes of gamma, delta and delay that are nearest."""
    fields = atlas.fields
    i, j, k = (
        int(np.argmin(np.abs(fields[axis] - value)))
        for axis, value in by_name(gamma, delta, delay).items()
    )
    values: Floats = fields[name][:, :, i, j, k].T.astype(float)
    return fields["alpha"][:, k], fields["beta"][:, k], values


def _legend() -> list[Patch]:
    shown = (Verdict.STABLE, Verdict.UNSTABLE, Verdict.UNDECIDED)
    return [
        Patch(facecolor=_COLOURS[code], edgecolor="#888888", label=code.name.lower())
        for code in shown
    ]
