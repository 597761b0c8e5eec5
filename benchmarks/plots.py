"""Draw every record as a PNG beside it, run time and error in one picture."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks import record
from benchmarks.record import Record, Row
from benchmarks.table import markdown

# Okabe and Ito's colours, told apart by the colour-blind; a marker each for those who print grey.
_STYLES = {
    "eigenvalue grid": ("#E69F00", "s"),
    "numpy eigvals": ("#E69F00", "s"),
    "jax eigvals": ("#D55E00", "D"),
    "n-cube bisection": ("#D55E00", "D"),
    "numpy.roots": ("#CC79A7", "v"),
    "python-control poles": ("#000000", "P"),
    "nearest node": ("#CC79A7", "v"),
    "scipy linear": ("#000000", "P"),
    "verdict grid": ("#56B4E9", "^"),
    "verdict": ("#56B4E9", "^"),
    "streamed verdict": ("#56B4E9", "^"),
    "traced": ("#009E73", "X"),
    "spectral_radius": ("#0072B2", "o"),
    "closed form": ("#0072B2", "o"),
    "atlas": ("#0072B2", "o"),
}
_SMALLEST = 1e-17  # errors of zero are drawn here


def draw_all(folder: Path) -> None:
    """Draw the records of a folder, and print the table of the README."""
    records = [record.read(path) for path in sorted(folder.glob("*.json"))]
    if not records:
        raise SystemExit(f"{folder} holds no records; run `python -m benchmarks` first.")
    for one in records:
        figure = draw(one)
        path = record.path_of(one, folder.parent if one["small"] else folder).with_suffix(".png")
        figure.savefig(path, dpi=120)
        print(path)
    print(markdown(records))


def draw(one: Record) -> Figure:
    """Return the picture of a record."""
    with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.25}):
        figure = _DRAWINGS[one["benchmark"]](one["rows"])
        machine = one["machine"]
        where = machine["accelerator"] or f"{machine['cpu']}, {machine['cores']} cores"
        figure.suptitle(f"{figure.get_suptitle()}\n{where}", fontsize=11)
        return figure


def _boundary(rows: list[Row]) -> Figure:
    rows = [row for row in rows if row["section"] == "outline"]
    delays = _values(rows, "delay")
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


def _queries(rows: list[Row]) -> Figure:
    delay = 1.0
    rows = [row for row in rows if row["delay"] == delay]
    figure, axes = _panels(2, 3, f"Atlas queries, delay {delay:g}: resolution against accuracy")
    across = {
        "bytes": "bytes kept",
        "build_seconds": "seconds to build",
        "seconds_per_point": "seconds per query",
    }
    for column, (x, label) in zip(axes.T, across.items(), strict=True):
        for section, line in (("wall", "-"), ("plant", ":")):
            some = [row for row in rows if row["section"] == section and row[x] > 0]
            _lines(column[0], some, x, "error", line=line)
            kept = [row for row in some if row["radius_error_median"] is not None]
            _lines(column[1], kept, x, "radius_error_median", line=line)
        column[0].set_yscale("symlog", linthresh=1e-4)
        column[0].set_ylim(bottom=0.0)
        column[1].set_yscale("log")
        for panel in column:
            panel.set_xscale("log")
        column[1].set_xlabel(label)
    axes[0, 0].set_ylabel("share without a right verdict")
    axes[1, 0].set_ylabel("median error of the radius")
    figure.text(
        0.99, 0.005, "solid: nodes in alpha, beta; dotted: in gamma, delta", ha="right", fontsize=8
    )
    return _with_legend(figure, axes)


def _scaling(rows: list[Row]) -> Figure:
    figure, axes = _panels(3, 2, "Cost as work grows")
    for column, section, x in zip(axes.T, ("points", "delay"), ("points", "delay"), strict=True):
        some = [row for row in rows if row["section"] == section]
        _lines(column[0], some, x, "seconds_per_point")
        _lines(column[1], some, x, "error")
        # Rivals share a process, so one line says what they took together.
        _lines(column[2], [row for row in some if "verdict" in row["method"]], x, "peak_mib")
        column[0].set_yscale("log")
        column[1].set_yscale("symlog", linthresh=1e-3 if x == "points" else 10 * _SMALLEST)
        column[1].set_ylim(bottom=0.0)
        column[2].set_ylim(bottom=0.0)
        for panel in column:
            panel.set_xscale("log" if x == "points" else "linear")
        column[2].set_xlabel("points, streamed" if x == "points" else "delay in samples")
    axes[0, 0].set_ylabel("seconds per point")
    axes[1, 0].set_ylabel("share wrong or undecided")
    axes[1, 1].set_ylabel("verdict: share wrong or undecided\nothers: error of the radius")
    axes[2, 0].set_ylabel("peak memory in MiB")
    return _with_legend(figure, axes)


_DRAWINGS: dict[str, Callable[[list[Row]], Figure]] = {
    "boundary": _boundary,
    "queries": _queries,
    "throughput": _throughput,
    "scaling": _scaling,
}


def _panels(rows: int, columns: int, title: str) -> tuple[Figure, np.ndarray]:
    figure = Figure(figsize=(max(1.5 + 3.2 * columns, 7.9), 1.4 + 2.7 * rows), layout="constrained")
    figure.suptitle(title)
    return figure, figure.subplots(rows, columns, squeeze=False)


def _lines(
    panel: Axes, rows: Iterable[Row], x: str, y: str, *, line: str = "-", floor: float = 0.0
) -> None:
    """Draw a line for each method, in the order of the rows."""
    rows = list(rows)
    for method in dict.fromkeys(row["method"] for row in rows):
        colour, marker = _STYLES[method]
        some = [row for row in rows if row["method"] == method]
        heights = [max(row[y], floor) for row in some]
        panel.plot(
            [row[x] for row in some],
            heights,
            line,
            color=colour,
            marker=marker,
            markersize=5,
            linewidth=1.2,
            label=method,
            clip_on=False,
            zorder=3,
        )


def _values(rows: Iterable[Row], column: str) -> list[Any]:
    return sorted({row[column] for row in rows})


def _with_legend(figure: Figure, axes: np.ndarray) -> Figure:
    found: dict[str, Any] = {}
    for panel in axes.ravel():
        handles, labels = panel.get_legend_handles_labels()
        for handle, label in zip(handles, labels, strict=True):
            found.setdefault(label, handle)
    figure.legend(found.values(), found.keys(), loc="outside lower center", ncols=4, frameon=False)
    return figure
