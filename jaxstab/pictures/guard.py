"""A picture of a guard: what it grants beside what is stable."""

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxstab.guard import Guard
from jaxstab.scene.units import Units

_SIZE = 10.0, 4.6  # inches
_CURVES = 5
_POINTS = 400


def guard_figure(guard: Guard, units: Units = Units.LINE) -> Figure:
    """Draw the largest stiffness over the damping: exact, and as the guard grants it.

    On the left for delays of the range, at the middle mass, on the right for masses, at the middle
    delay.

    Source: the D-decomposition of eq. (9) of Hulin, Preusche, Hirzinger (2008), and lemma B15.
    """
    figure = Figure(figsize=_SIZE)
    figure.set_layout_engine("constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    middle = float(np.mean(guard.mass)), float(np.mean(guard.delay))
    for delay, colour in _coloured(guard.delay):
        _draw(left, guard, (middle[0], delay), colour, f"{1e3 * delay:.3g} ms")
    for mass, colour in _coloured(guard.mass):
        _draw(right, guard, (mass, middle[1]), colour, f"{mass:.3g} {units.kilogram}")
    left.set_title(f"delays, at {middle[0]:.3g} {units.kilogram}")
    right.set_title(f"{units.moved} of the device, at {1e3 * middle[1]:.3g} ms")
    left.set_ylabel(f"largest stiffness K ({units.stiffness}), for all hands")
    for panel in (left, right):
        panel.set_xlabel(f"damping B ({units.damping})")
        panel.set_ylim(0.0, None)
        panel.set_xlim(0.0, None)
        panel.plot([], [], color="black", lw=0.8, ls="--", label="where a hand becomes unstable")
        panel.plot([], [], color="black", lw=1.6, label="granted, proved stable")
        panel.legend(fontsize=8)
    return figure


def _coloured(ends: tuple[float, float]) -> list[tuple[float, object]]:
    colours = colormaps["viridis"](np.linspace(0.0, 0.85, _CURVES))
    return list(zip(np.linspace(*ends, _CURVES).tolist(), colours, strict=True))


def _draw(
    panel: Axes, guard: Guard, place: tuple[float, float], colour: object, label: str
) -> None:
    mass, delay = place
    damping = np.linspace(0.0, 1.1 * float(guard.grid.top.max()), _POINTS)
    exact = guard.exact_stiffness(
        damping[None, None], mass=np.array([mass]), delay=np.array([delay])
    )[0, 0]
    panel.plot(damping, np.where(exact > 0.0, exact, np.nan), color=colour, lw=0.8, ls="--")
    granted = guard.largest_stiffness(damping, mass=mass, delay=delay)
    panel.plot(damping, np.where(granted > 0.0, granted, np.nan), color=colour, lw=1.6, label=label)
