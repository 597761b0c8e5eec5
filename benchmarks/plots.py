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
    "jaxstab": ("#0072B2", "o"),
    "NumPy eigenvalues": ("#E69F00", "s"),
    "Schur-Cohn, not proved": ("#999999", "^"),
    "write int8": ("#999999", "v"),
    "write float64": ("#999999", "o"),
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
    "streamed verdict": ("#56B4E9", "^"),
    "traced": ("#009E73", "X"),
    "spectral_radius": ("#0072B2", "o"),
    "spectral_radius, companion": ("#009E73", "X"),
    "closed form": ("#0072B2", "o"),
    "stable_region": ("#0072B2", "o"),
    "its polygon": ("#E69F00", "s"),
    "verdict, exact": ("#0072B2", "o"),
    "eq. (9) as printed": ("#D55E00", "P"),
    "linear_validity": ("#0072B2", "o"),
    "exact": ("#0072B2", "o"),
}
_DOCS, _ON_PAGES = Path(__file__).parents[1] / "docs", ("resolution",)
_ULPS = (0.1, 1e20)  # smaller and larger errors are drawn here; at 1e16 no digit is right

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


def _scaling(rows: list[Row]) -> Figure:
    figure, axes = _panels(1, 2, "Cost as work grows")
    some = [row for row in rows if row["section"] == "points"]
    labels = {"seconds_per_point": "seconds per point", "peak_mib": "peak memory in MiB"}
    for panel, (column, label) in zip(axes[0], labels.items(), strict=True):
        _lines(panel, some, "points", column)
        panel.set(xscale="log", xlabel="points, streamed", ylabel=label)
    axes[0, 0].set_yscale("log")
    axes[0, 1].set_ylim(bottom=0.0)
    return _with_legend(figure, axes)


def _stress(rows: list[Row]) -> Figure:
    figure, axes = _panels(
        1, 3, "Largest errors of a spectral radius, random and adversarial loops"
    )
    rows = [
        row | {"error": min(row["error"], _ULPS[1])}
        for row in rows
        if "verdict" not in row["method"]
    ]
    for panel, axis in zip(axes[0], ("delay", "gamma", "delta"), strict=True):
        some = [row for row in rows if row["section"] == axis]
        _lines(panel, some, "place", "error", floor=_ULPS[0])
        panel.set(yscale="log", ylim=_ULPS)
        panel.set_xlabel("delay in samples" if axis == "delay" else f"decade of {axis}")
    axes[0, 0].set_xscale("symlog", linthresh=1.0)
    axes[0, 0].set_xlim(left=0.0)
    axes[0, 0].set_ylabel("units of the last place")
    return _with_legend(figure, axes)


def _latency(rows: list[Row]) -> Figure:
    """Time and memory of each question, a line each; a bar ends at what is wanted."""
    questions = list(dict.fromkeys(row["section"] for row in rows))[::-1]
    figure, axes = _panels(1, 2, "One question to a fresh process, imports included")
    figure.set_figheight(1.6 + 0.3 * len(questions))
    columns = (
        ("seconds", "target_seconds", "CPU time in s"),
        ("peak_mib", "target_mib", "memory in MiB"),
    )
    for panel, (column, target, label) in zip(axes[0], columns, strict=True):
        wanted = {row["section"]: row[target] for row in rows}
        panel.barh(questions, [wanted[name] for name in questions], color="0.9", label="wanted")
        for method in dict.fromkeys(row["method"] for row in rows):
            colour, marker = _STYLES[method]
            some = [row for row in rows if row["method"] == method]
            values, names = [row[column] for row in some], [row["section"] for row in some]
            panel.plot(values, names, marker, color=colour, label=method)
        panel.set(xlabel=label)
    axes[0, 0].set_xscale("log")
    axes[0, 1].set_yticklabels([])
    return _with_legend(figure, axes)


def _exact(rows: list[Row]) -> Figure:
    """CPU time of balls, and what they leave open."""
    kinds = [row for row in rows if "judged" in row][::-1]
    judged, wrong = (sum(row[column] for row in kinds) for column in ("judged", "wrong"))
    title = f"Random loops in balls: {judged:,} answers judged, {wrong} wrong"
    figure, axes = _panels(1, 2, title)
    figure.set_figheight(2.4 + 0.22 * len(kinds))
    sections = [row["section"] for row in kinds]
    labels = {"seconds": "median CPU time in s", "open": "left open"}
    for panel, (name, label) in zip(axes[0], labels.items(), strict=True):
        panel.plot([row[name] for row in kinds], sections, _STYLES["exact"][1])
        panel.set(xlabel=label)
    axes[0, 0].set_xscale("log")
    axes[0, 1].set_yticklabels([])
    return figure


DRAWINGS: dict[str, Callable[[list[Row]], Figure]] = {
    "latency": _latency,
    "boundary": _boundary,
    "exact": _exact,
    "resolution": _resolution,
    "throughput": _throughput,
    "accelerator": _accelerator,
    "scaling": _scaling,
    "stress": _stress,
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
