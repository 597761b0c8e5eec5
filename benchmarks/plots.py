"""Draw the records that pages show as PNGs, run time and error in the same picture."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks import record
from benchmarks.record import Row

# Okabe and Ito's colours, told apart by the colour-blind; a marker each for those who print grey.
_STYLES = {
    "nearest": ("#CC79A7", "v"),
    "linear": ("#0072B2", "o"),
    "cubic": ("#009E73", "X"),
    "jaxstab": ("#0072B2", "o"),
    "jaxstab, batched": ("#0072B2", "s"),
    "jaxstab, atlas": ("#0072B2", "^"),
    "numpy.roots, bisection": ("#E69F00", "o"),
    "scipy brentq": ("#E69F00", "X"),
    "python-control margins": ("#D55E00", "o"),
    "python-control margins, poly": ("#D55E00", "X"),
    "python-control root locus": ("#D55E00", "s"),
    "grid of 16 x 16, contourpy": ("#009E73", "v"),
    "grid of 50 x 50, contourpy": ("#009E73", "s"),
    "grid of 160 x 160, contourpy": ("#009E73", "^"),
    "python-flint, exact fractions": ("#CC79A7", "D"),
    "MuJoCo, bisection": ("#000000", "P"),
}
_DOCS = Path(__file__).parents[1] / "docs"


def draw_all(folder: Path) -> None:
    """Draw the records of a folder."""
    for one in record.read_all(folder):
        if one["benchmark"] not in DRAWINGS:
            continue  # the table has it
        machine = one["machine"]
        where = machine["accelerator"] or f"{machine['cpu']}, {machine['cores']} cores"
        with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.25}):
            figure = DRAWINGS[one["benchmark"]](one["rows"])
            figure.suptitle(f"{figure.get_suptitle()}\n{where}", fontsize=11)
            path = record.path_of(one, folder.parent if one["small"] else folder)
            figure.savefig(path.with_suffix(".png"), dpi=120)
            print(path.with_suffix(".png"))
            if folder == record.RESULTS:
                figure.savefig(_DOCS / f"{one['benchmark']}.png", dpi=90)


def _resolution(rows: list[Row]) -> Figure:
    """What nodes give and take: error and share computed, over the size of the table."""
    points = f"{rows[0]['points']:,}"
    figure, axes = _panels(1, 3, f"Nodes of the haptic range: {points} random walls")
    labels = ("largest error of a limit (largest alpha = 1)", "share computed")
    for panel, column, label in zip(axes[0], ("error", "computed"), labels, strict=False):
        _lines(panel, [row for row in rows if row[column] > 0], "bytes", column)
        panel.set(xscale="log", yscale="log", xlabel="bytes of the table", ylabel=label)
    built = [row for row in rows if row["method"] == "linear"]
    _lines(axes[0, 2], built, "bytes", "build_seconds")
    axes[0, 2].set(
        xscale="log", yscale="log", xlabel="bytes of the table", ylabel="CPU seconds of the build"
    )
    for number, row in enumerate(built):
        words = axes[0, 2].annotate(
            row["section"],
            (row["bytes"], row["build_seconds"]),
            xytext=(7, -4 if number else -13),
            textcoords="offset points",
            fontsize=7,
        )
        words.set_in_layout(False)
    sizes = [row["bytes"] for row in built]
    axes[0, 2].set_xlim(0.5 * min(sizes), 100.0 * max(sizes))
    axes[0, 2].set_ylim(0.7 * min(row["build_seconds"] for row in built))
    axes[0, 2].set_title("rows x gamma x delta x delay", fontsize=8)
    return _with_legend(figure, axes)


def _rivals(rows: list[Row]) -> Figure:
    """CPU time of a loop against the error of its end, a panel for each group of loops."""
    figure, axes = _panels(2, 2, "How far may one gain go: the same question to each tool")
    figure.set_figwidth(9.5)
    for panel, group in zip(axes.flat, dict.fromkeys(row["section"] for row in rows), strict=True):
        some = [
            row | {"each": row["cpu_seconds"] / row["points"]}
            for row in rows
            if row["section"] == group
        ]
        _lines(panel, some, "each", "error", floor=1e-17)
        panel.set(xscale="log", yscale="log", title=group, xlim=(1e-7, 3.0), ylim=(5e-18, 5.0))
    for panel in axes[1]:
        panel.set_xlabel("CPU time per loop in s")
    for panel in axes[:, 0]:
        panel.set_ylabel("largest relative error\n(1: an end was not found)")
    return _with_legend(figure, axes)


DRAWINGS: dict[str, Callable[[list[Row]], Figure]] = {
    "rivals": _rivals,
    "resolution": _resolution,
}


def _panels(rows: int, columns: int, title: str) -> tuple[Figure, np.ndarray]:
    figure = Figure(figsize=(max(1.5 + 3.2 * columns, 7.9), 1.4 + 2.7 * rows), layout="constrained")
    figure.suptitle(title)
    return figure, figure.subplots(rows, columns, squeeze=False)


def _lines(panel: Axes, rows: Iterable[Row], x: str, y: str, *, floor: float = 0.0) -> None:
    """Draw a line for each method, in the order of the rows."""
    rows = list(rows)
    for method in dict.fromkeys(row["method"] for row in rows):
        colour, marker = _STYLES[method]
        some = [row for row in rows if row["method"] == method]
        heights = [max(row[y], floor) for row in some]
        panel.plot(
            [row[x] for row in some],
            heights,
            color=colour,
            marker=marker,
            markersize=5,
            linewidth=1.2,
            label=method,
            clip_on=False,
            zorder=3,
        )


def _with_legend(figure: Figure, axes: np.ndarray) -> Figure:
    found: dict[str, Any] = {}
    for panel in axes.ravel():
        handles, labels = panel.get_legend_handles_labels()
        for handle, label in zip(handles, labels, strict=True):
            found.setdefault(label, handle)
    figure.legend(found.values(), found.keys(), loc="outside lower center", ncols=4, frameon=False)
    return figure
