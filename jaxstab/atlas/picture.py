"""Verdicts of an atlas in a plane of its gains, drawn: in colours, with a legend."""

from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.table import LimitTable
from jaxstab.conventions import Verdict
from jaxstab.drawing import SKY, Floats, new_axes, plain
from jaxstab.numbers import checked_number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.patches import Patch

# Distinguishable with any colour vision, and in grey.
_COLOURS = {
    Verdict.NOT_COMPUTED: "#ffffff",
    Verdict.STABLE: SKY,
    Verdict.UNSTABLE: "#f5ead0",
    Verdict.UNDECIDED: "#444444",
}


def plot_verdicts(
    ax: "Axes | None",
    plane: tuple[Any, Any, NDArray[np.int8]],
    labels: tuple[str, str],
    filters: str,
    words: str,
) -> "Axes":
    """Draw verdicts over two gains on axes, or on new ones."""
    panel = new_axes() if ax is None else ax
    draw_verdicts(panel, *plane)
    panel.set(xlabel=labels[0], ylabel=labels[1])
    panel.set_title(f"{fill(plain(filters), 60)}\n{words}", fontsize=9)
    panel.legend(handles=legend(), fontsize=8, loc="upper right")
    return panel


def raster(table: LimitTable, gamma: float, delta: float, delay: float) -> tuple[Floats, Floats]:
    """Return alphas and betas around the stable set of a plant."""
    aside = 0.06  # around the stable set, of its size
    count = 400  # points along each side of a plane
    given = {"gamma": gamma, "delta": delta, "delay": delay}
    plant = [np.array([checked_number(name, value)]) for name, value in given.items()]
    low, high = table.ends(*plant)[0]
    if np.isnan(low):
        raise ValueError(
            f"gamma {gamma:g}, delta {delta:g} and delay {delay:g} are outside of this atlas, or "
            "nothing is stable there."
        )
    rows = low + table.row * (high - low)
    limits = table.limits(rows, *(np.repeat(value, rows.size) for value in plant))
    spans = (np.nanmin(limits.lower), np.nanmax(limits.upper)), (low, high)
    alpha, beta = (np.linspace(a - aside * (b - a), b + aside * (b - a), count) for a, b in spans)
    return alpha, beta


def draw_verdicts(panel: "Axes", alpha: Floats, beta: Floats, verdict: NDArray[np.int8]) -> None:
    """Colour a plane by its verdicts."""
    from matplotlib.colors import ListedColormap

    colours = ListedColormap([_COLOURS[code] for code in Verdict])
    panel.pcolormesh(alpha, beta, verdict, cmap=colours, vmin=-0.5, vmax=len(Verdict) - 0.5)


def legend() -> "list[Patch]":
    """Return the colours of verdicts, named."""
    from matplotlib.patches import Patch

    return [
        Patch(facecolor=colour, edgecolor="#888888", label=code.name.lower())
        for code, colour in _COLOURS.items()
        if code != Verdict.NOT_COMPUTED
    ]
