"""Pictures of simulated contacts: one run over time, and where in (K, B) a device rests."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from jaxstab.loop import Contact, ContactKind, HapticLoop
from jaxstab.pictures.style import BLACK, BLUE, GREEN, ORANGE, closed_outline, new_axes

Floats = NDArray[np.float64]

_PANEL = (4.6, 3.6)  # inches
_FAINTEST, _STRONGEST = 1e-3, 100.0  # mm, of the colours
_WIDER = 1.6  # times the stiffest and the most damped stable wall


def plot_contact(contact: Contact, ax: Axes | None = None) -> Axes:
    """Draw a simulated contact over time; ValueError if it is not one run with its path."""
    path = contact.path
    if path is None or path.position.ndim != 1:
        raise ValueError(
            f"there is no single path to draw: {contact!r}; ask loop.contact about one wall."
        )
    panel = new_axes() if ax is None else ax
    panel.axhline(0.0, color=BLACK, lw=0.6)
    panel.plot(path.time, 1000.0 * path.position, color=BLUE, lw=1.0)
    panel.set_xlabel("time in s")
    panel.set_ylabel("position in mm, positive inside the wall", color=BLUE)
    beside = panel.twinx()
    beside.plot(path.time, path.force, color=ORANGE, lw=0.6)
    beside.set_ylabel("force of the wall in N", color=ORANGE)
    panel.set_title(f"simulated: {ContactKind(int(contact.kind)).words}", fontsize=9)
    return panel


def walls_around(loop: HapticLoop, count: int) -> tuple[Floats, Floats]:
    """Return a grid of walls somewhat beyond the stable ones, (count, 1) and (count,)."""
    limits = loop.limits()
    stiffness = np.linspace(0.0, _WIDER * float(limits.stiffness), count + 1)[1:]
    damping = np.linspace(0.0, _WIDER * float(limits.damping), count)
    return stiffness, damping[:, None]


def contact_figure(
    loop: HapticLoop, walls: tuple[Floats, Floats], maps: dict[str, Contact]
) -> Figure:
    """Return a figure with a panel for each map of walls, by its title."""
    size = _PANEL[0] * len(maps), _PANEL[1]
    figure = Figure(figsize=size, layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(maps), sharey=True))
    for panel, (title, contact) in zip(panels, maps.items(), strict=True):
        mesh = _draw_map(panel, loop, walls, contact)
        panel.set_title(title, fontsize=9)
    bar = figure.colorbar(mesh, ax=list(panels), label="amplitude at the end in mm, simulated")
    bar.ax.tick_params(labelsize=7)
    panels[0].set_ylabel("damping B in N s/m")
    panels[0].legend(fontsize=7, loc="upper right")
    return figure


def _draw_map(
    panel: Axes, loop: HapticLoop, walls: tuple[Floats, Floats], contact: Contact
) -> QuadMesh:
    """Draw where contacts rest, how far others move, and the edge of the stable set."""
    stiffness, damping = (np.ravel(gains) for gains in walls)
    does_rest = contact.kind == ContactKind.RESTS
    size = np.clip(1000.0 * contact.amplitude, _FAINTEST, _STRONGEST)
    panel.pcolormesh(
        stiffness, damping, np.where(does_rest, 1.0, np.nan),
        cmap="Greens", vmin=0.0, vmax=2.5, shading="nearest", rasterized=True,
    )  # fmt: skip
    mesh = panel.pcolormesh(
        stiffness, damping, np.where(does_rest, np.nan, size),
        cmap="inferno_r", norm=LogNorm(_FAINTEST, _STRONGEST), shading="nearest", rasterized=True,
    )  # fmt: skip
    panel.fill([], [], color=GREEN, alpha=0.4, label="rests, simulated")
    panel.plot(*closed_outline(loop.region()).T, color=BLUE, lw=1.6, label="edge of stability")
    panel.set(xlim=(0.0, stiffness[-1]), ylim=(0.0, damping[-1]), xlabel="stiffness K in N/m")
    panel.tick_params(labelsize=8)
    return mesh
