"""One stable region, annotated with the facts about it."""

from decimal import ROUND_FLOOR

import numpy as np
from matplotlib.figure import Figure

from jaxstab.numbers import without_noise
from jaxstab.paper import linear_alpha_limit, passive_region, resolved_region
from jaxstab.pictures.shown import closed_outline
from jaxstab.pictures.style import BLACK, BLUE, GREEN, ORANGE, RED, hand_label, panels
from jaxstab.scene.answers import Quantity

_LIMIT = Quantity(digits=5, rounding=ROUND_FLOOR)


def region_figure(gamma: float, delta: float, delay: float, radius: float = 1.0) -> Figure:
    """Draw a stable region with its corners, extremes, linear condition and passive region.

    Args:
        gamma: physical stiffness k T^2/m in [0, 1e4].
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, whole or fractional.
        radius: modulus in (0, 1] below which all roots lie; 1 is stability.

    Returns:
        A matplotlib figure; ``picture`` makes a file of it.

    Raises:
        ValueError: an argument is outside its range, or the region is empty or unresolved.

    Source: sec. V to VIII of Hulin, Preusche, Hirzinger (2008).
    """
    region = resolved_region(gamma=gamma, delta=delta, delay=delay, radius=radius)
    figure, ((panel,),) = panels(1, 1, width=1.35, height=1.25)
    inside = "stable region" if radius == 1.0 else f"all roots within {radius:g}"
    panel.plot(*closed_outline(region).T, color=BLUE, label=inside)
    panel.fill(*closed_outline(region).T, facecolor=BLUE, alpha=0.15)
    window = panel.get_xlim(), panel.get_ylim()
    passive = passive_region(delta=delta, delay=delay).outline
    if len(passive):
        panel.fill(*passive.T, facecolor=GREEN, alpha=0.35, edgecolor=GREEN, label="passive region")
    beta = np.array(window[1])
    limit = np.asarray(linear_alpha_limit(beta, delta=delta, delay=delay))
    panel.plot(limit, beta, "--", color=RED, label="linear condition")
    panel.plot(*region.corners.T, "s", color=BLACK, markersize=5, label="corners")
    extent = np.ptp(region.points, axis=0)
    for point, name, mark in ((region.max_alpha, "alpha", ">"), (region.max_beta, "beta", "^")):
        numbers = ", ".join(_LIMIT.words(float(x)) for x in map(without_noise, point, extent))
        label = rf"largest $\{name}$: ({numbers})"
        panel.plot(*point, mark, color=ORANGE, markersize=8, label=label)
    panel.set(xlim=window[0], ylim=window[1])
    panel.set_title(f"{hand_label(gamma, delta)}, $d = {delay:g}$")
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    return figure
