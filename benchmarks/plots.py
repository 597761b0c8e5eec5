"""Draw records of run times as PNGs beside them, with the errors in the same picture."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks import record
from benchmarks.record import Record, Row

# Okabe and Ito's colours, told apart by the colour-blind; a marker each for those who print grey.
_STYLES = {
    "nearest": ("#CC79A7", "v"),
    "linear": ("#0072B2", "o"),
    "cubic": ("#009E73", "X"),
    "Schur-Cohn, not proved": ("#999999", "^"),
    "write int8": ("#999999", "v"),
    "write float64": ("#999999", "o"),
    "closed form": ("#0072B2", "o"),
    "two cores": ("#E69F00", "s"),
    "device": ("#0072B2", "o"),
    "eigenvalue grid": ("#E69F00", "s"),
    "numpy eigvals": ("#E69F00", "s"),
    "jax eigvals": ("#D55E00", "D"),
    "n-cube bisection": ("#D55E00", "D"),
    "numpy.roots": ("#CC79A7", "v"),
    "python-control poles": ("#000000", "P"),
    "verdict grid": ("#56B4E9", "^"),
    "verdict": ("#56B4E9", "^"),
    "traced": ("#009E73", "X"),
    "spectral_radius": ("#0072B2", "o"),
    "spectral_radius, companion": ("#009E73", "X"),
}
_DOCS, _ON_PAGES = Path(__file__).parents[1] / "docs", ("resolution",)

_SMALLEST = 1e-17  # errors of zero are drawn here


def draw_all(folder: Path) -> None:
    """Draw the records of a folder."""
    for one in record.read_all(folder):
        if one["benchmark"] not in DRAWINGS:
            continue  # counts, which the table has
        figure = draw(one)
        path = record.path_of(one, folder.parent if one["small"] else folder).with_suffix(".png")
        figure.savefig(path, dpi=120)
        print(path)
        if folder == record.RESULTS and one["benchmark"] in _ON_PAGES:
            figure.savefig(_DOCS / f"{one['benchmark']}.png", dpi=90)


def draw(one: Record) -> Figure:
    """Return the picture of a record."""
    with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.25}):
        figure = DRAWINGS[one["benchmark"]](one["rows"])
        machine = one["machine"]
        where = machine["accelerator"] or f"{machine['cpu']}, {machine['cores']} cores"
        figure.suptitle(f"{figure.get_suptitle()}\n{where}", fontsize=11)
        return figure


def _boundary(rows: list[Row]) -> Figure:
    rows = [row for row in rows if row["section"] == "outline"]
    delays = sorted({row["delay"] for row in rows})
    figure, axes = _panels(2, len(delays), "The boundary of one slice: run time against error")
    for column, delay in zip(axes.T, delays, strict=True):
        some = [row for row in rows if row["delay"] == delay]
        for panel, what in zip(column, ("error", "gap"), strict=True):
            _lines(panel, some, "seconds", what, floor=_SMALLEST)
            panel.set(xscale="log", yscale="log", xlabel="run time in s")
        column[0].set_title(f"delay {delay:g}")
    axes[0, 0].set_ylabel("largest distance of found points\nfrom the boundary (region = 1)")
    axes[1, 0].set_ylabel("largest distance of the boundary\nfrom the outline found (region = 1)")
    return _with_legend(figure, axes)


def _throughput(rows: list[Row]) -> Figure:
    figure, axes = _panels(2, 2, "Verdict and spectral radius beside eigenvalues")
    for column, section, x in zip(axes.T, ("delay", "batch"), ("delay", "batch"), strict=True):
        some = [row for row in rows if row["section"] == section]
        _lines(column[0], some, x, "seconds_per_point")
        _lines(column[1], some, x, "error", floor=_SMALLEST)
        for panel in column:
            panel.set_yscale("log")
            panel.set_xscale("log" if x == "batch" else "linear")
        column[1].set_xlabel("points of the slice, delay 1" if x == "batch" else "delay in samples")
    axes[0, 0].set_ylabel("seconds per point")
    axes[1, 0].set_ylabel("verdict: distance at which undecided\nothers: error of the radius")
    return _with_legend(figure, axes)


def _accelerator(rows: list[Row]) -> Figure:
    """Draw verdicts and radii; rows come in pairs, that of two cores first."""
    names = [("two cores", "device")[number % 2] for number in range(len(rows))]
    shown = [row | {"method": name} for row, name in zip(rows, names, strict=True)]
    figure, axes = _panels(1, 2, "Dense grids that stay on the device, and two cores of its host")
    for panel, section in zip(axes[0], ("verdict", "spectral_radius"), strict=True):
        some = [row for row in shown if row["section"] == section]
        _lines(panel, some, "delay", "seconds_per_point")
        panel.set(yscale="log", title=section, xlabel="delay in samples")
    axes[0, 0].set_ylabel("seconds per point")
    return _with_legend(figure, axes)


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


DRAWINGS: dict[str, Callable[[list[Row]], Figure]] = {
    "boundary": _boundary,
    "resolution": _resolution,
    "throughput": _throughput,
    "accelerator": _accelerator,
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
