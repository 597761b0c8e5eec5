"""Pictures of simulated contacts: one run over time, and where in (K, B) a device rests."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from jaxstab.loop import Contact, ContactKind, HapticLoop
from jaxstab.pictures.style import BLACK, BLUE, GREEN, HALO, ORANGE, closed_outline, new_axes, plain
from jaxstab.scene.answers import Quantity
from jaxstab.scene.contact import MAP_COUNT, contact_loop, simulated_map, walls_around
from jaxstab.scene.loops import walls_of
from jaxstab.scene.scene import Scene, Units

Floats = NDArray[np.float64]

_PANEL = (4.6, 3.6)  # inches
_FAINTEST, _STRONGEST = 1e-3, 100.0  # mm, of the colours


def plot_contact(contact: Contact, ax: Axes | None = None) -> Axes:
    """Draw a simulated contact over time; ValueError if it is not one run with its path."""
    path = contact.path
    if path is None or path.position.ndim != 1:
        raise ValueError(
            f"there is no single path to draw: {contact!r}; call loop.contact with one wall."
        )
    panel = new_axes() if ax is None else ax
    panel.axhline(0.0, color=BLACK, lw=0.6)
    panel.plot(path.time, 1000.0 * path.position, color=BLUE, lw=1.0)
    panel.set_xlabel("time (s)")
    panel.set_ylabel("position (mm), positive inside the wall", color=BLUE)
    beside = panel.twinx()
    beside.plot(path.time, path.force, color=ORANGE, lw=0.6)
    beside.set_ylabel("force of the wall (N)", color=ORANGE)
    panel.set_title(f"simulated: {ContactKind(int(contact.kind)).words}", fontsize=9)
    return panel


def scene_contacts(scene: Scene) -> Figure:
    """Return the map of simulated contacts of a scene, from its own start, and its walls."""
    loop, gains, units = contact_loop(scene), walls_of(scene), scene.units
    walls = walls_around(loop, MAP_COUNT, gains.values())
    friction = Quantity("N").words(scene.device.friction, units)
    contact = simulated_map(scene, *walls)
    return contact_figure(loop, walls, {f"friction {friction}": contact}, gains, units)


def contact_figure(
    loop: HapticLoop,
    walls: tuple[Floats, Floats],
    maps: Mapping[str, Contact],
    marked: Mapping[str, tuple[float, float]] | None = None,
    units: Units = Units.LINE,
) -> Figure:
    """Return a figure with a panel for each map of walls, by its title; some walls are named."""
    size = _PANEL[0] * len(maps), _PANEL[1]
    figure = Figure(figsize=size, layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(maps), sharey=True))
    for panel, (title, contact) in zip(panels, maps.items(), strict=True):
        mesh = _draw_map(panel, loop, walls, contact)
        panel.set_title(title, fontsize=9)
        panel.set_xlabel(f"stiffness K ({units.stiffness})")
        for name, gains in (marked or {}).items():
            panel.plot(*gains, "o", color=BLACK, mfc="white", ms=5)
            text = panel.annotate(
                plain(name), gains, xytext=(5, 4), textcoords="offset points", fontsize=8
            )
            text.set_path_effects(HALO)
    length = "mm" if units is Units.LINE else "mrad"
    bar = figure.colorbar(
        mesh, ax=list(panels), label=f"amplitude at the end ({length}), simulated"
    )
    bar.ax.tick_params(labelsize=7)
    panels[0].set_ylabel(f"damping B ({units.damping})")
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
    panel.set(xlim=(0.0, stiffness[-1]), ylim=(0.0, damping[-1]))
    panel.tick_params(labelsize=8)
    return mesh
