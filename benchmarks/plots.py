"""Draw every record as a PNG beside it, run time and error in one picture."""

from collections.abc import Callable, Iterable, Sequence
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
    "scipy linear": ("#000000", "P"),
    "verdict grid": ("#56B4E9", "^"),
    "verdict": ("#56B4E9", "^"),
    "streamed verdict": ("#56B4E9", "^"),
    "traced": ("#009E73", "X"),
    "spectral_radius": ("#0072B2", "o"),
    "spectral_radius, companion": ("#009E73", "X"),
    "closed form": ("#0072B2", "o"),
    "stable_region": ("#0072B2", "o"),
    "its polygon": ("#E69F00", "s"),
    "write": ("#000000", "P"),
    "write, new memory": ("#CC79A7", "v"),
    "verdict, exact": ("#0072B2", "o"),
    "python-flint roots": ("#E69F00", "s"),
    "eq. (9) as printed": ("#D55E00", "P"),
    "linear_validity": ("#0072B2", "o"),
    "exact": ("#0072B2", "o"),
    "float64 and pairs": ("#E69F00", "s"),
}
_AMPLITUDE_STYLES = {
    "largest_over_runs": ("#D55E00", "D"),
    "error": ("#0072B2", "o"),
    "median_over_signals": ("#009E73", "X"),
}
_DOCS, _ON_PAGES = Path(__file__).parents[1] / "docs", ("resolution",)
_ULPS = (0.1, 1e20)  # smaller and larger errors are drawn here; at 1e16 no digit is right

_SHOWN = (0.0, 0.5, 1.0, 5.0, 20.0, 60.0)  # delays, where all would be too many
_SMALLEST = 1e-17  # errors of zero are drawn here


def draw_all(folder: Path) -> None:
    """Draw the records of a folder."""
    for one in record.read_all(folder):
        figure = draw(one)
        path = record.path_of(one, folder.parent if one["small"] else folder).with_suffix(".png")
        figure.savefig(path, dpi=120)
        print(path)
        if folder == record.RESULTS and one["benchmark"] in _ON_PAGES:
            figure.savefig(_DOCS / f"{one['benchmark']}.png", dpi=90)


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


def _estimators(rows: list[Row]) -> Figure:
    figure, axes = _panels(1, 2, "Dense slices with velocity estimators beside eigenvalues")
    columns = {
        "seconds_per_point": "seconds per point",
        "error": "distance at which wrong or undecided\n(share of the gains)",
    }
    words = [row["section"].replace(" of ", "\nof ") for row in rows]
    names = [f"{word}\ndegree {row['degree']}" for word, row in zip(words, rows, strict=True)]
    shown = [row | {"name": name} for row, name in zip(rows, names, strict=True)]
    for panel, (column, label) in zip(axes[0], columns.items(), strict=True):
        _lines(panel, shown, "name", column, floor=_SMALLEST, line=" ")
        panel.set(yscale="log", ylabel=label)
        panel.tick_params(axis="x", labelsize=7)
    return _with_legend(figure, axes)


def _regions(rows: list[Row]) -> Figure:
    figure, axes = _panels(1, 2, "Stable regions of random slices against certified root counts")
    _lines(axes[0, 0], rows[::2], "delay", "seconds")
    _lines(axes[0, 1], rows, "delay", "error")
    axes[0, 0].set(yscale="log", ylabel="seconds for a region")
    axes[0, 1].set(ylim=(-0.01, 0.2), ylabel="share of points misclassified")
    for panel in axes[0]:
        panel.set_xlabel("delays up to, in samples")
    return _with_legend(figure, axes)


def _answers(rows: list[Row]) -> Figure:
    asked, wrong = (sum(row[column] for row in rows) for column in ("asked", "wrong"))
    figure, axes = _panels(1, 1, f"{asked:,} questions to the default atlas, {wrong} wrong")
    kinds, shares = zip(*((row["section"], row["computed"]) for row in rows[::-1]), strict=True)
    axes[0, 0].barh(kinds, shares, color=_STYLES["linear"][0])
    axes[0, 0].set(xscale="log", xlabel="share that is left to be computed")
    return figure


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


def _verdicts(rows: list[Row]) -> Figure:
    figure, axes = _panels(1, 3, f"{_judged(rows):,} verdicts next to the boundary")
    _lines(axes[0, 0], rows, "delay", "seconds_per_point")
    _lines(axes[0, 1], rows, "delay", "wrong")
    axes[0, 0].set(yscale="log", xlabel="delay in samples", ylabel="seconds per point")
    axes[0, 1].set(ylim=(-0.05, 1.0), xlabel="delay in samples", ylabel="wrong verdicts")
    panel = axes[0, 2]
    prefix = "undecided_beyond_1e-"
    some = [row for row in rows if row["method"] == "verdict" and row["delay"] in _SHOWN]
    for row in some:
        shares = {int(k.removeprefix(prefix)): v for k, v in row.items() if k.startswith(prefix)}
        panel.plot([10.0**-k for k in shares], list(shares.values()), label=f"{row['delay']:g}")
    panel.set(xscale="log", xlabel="at least this far from the boundary", ylabel="undecided")
    panel.legend(title="delay", fontsize=8)
    return _with_legend(figure, axes[:, :2])


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


def _judged(rows: list[Row]) -> int:
    return sum(row["points"] for row in rows if row["method"] == "verdict")


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


def _criteria(rows: list[Row]) -> Figure:
    wrong = sum(row["wrong"] + row["raised"] for row in rows)
    questions = sum(row["points"] for row in rows)
    figure, axes = _panels(1, 1, f"{questions:,} limits of the linear condition, {wrong} wrong")
    _lines(axes[0, 0], rows, "seed", "error")
    axes[0, 0].set(yscale="log", xlabel="seed", ylabel="error of theta, times the level")
    return figure


def _tuning(rows: list[Row]) -> Figure:
    plants = sum(row["repeats"] for row in rows)
    figure, axes = _panels(1, 2, f"Smallest radii of {plants:,} random plants")
    panels = {
        "what is wrong": ("beaten", "region_below", "not_reached", "missed"),
        "where the smallest radius is": ("triple_root", "double_pair", "scanned"),
    }
    for panel, (title, columns) in zip(axes[0], panels.items(), strict=True):
        counts = [sum(row[column] for row in rows) for column in columns]
        _counted(panel, columns, counts)
        panel.set(title=title, xlabel="plants", xlim=(0.0, 1.15 * max(counts) or 1.0))
    return figure


def _counted(panel: Axes, columns: Sequence[str], counts: Sequence[int]) -> None:
    """Draw a bar with its number for each column: of none there is no bar to be seen."""
    bars = panel.barh([column.replace("_", " ") for column in columns], counts)
    panel.bar_label(bars, [f"{count:,}" for count in counts], padding=3)


def _ranges(rows: list[Row]) -> Figure:
    figure, axes = _panels(1, len(rows), "Margins and limits, by certified root counts")
    for panel, row in zip(axes[0], rows, strict=True):
        columns = [name for name in ("wrong", "short", "judged") if name in row]
        counts = [row[name] for name in columns]
        _counted(panel, columns, counts)
        panel.set(xscale="symlog", xlabel=row["section"].replace("_", " "))
        panel.set_xlim(0.0, 10.0 * max(counts))
    return figure


def _amplitudes(rows: list[Row]) -> Figure:
    runs = sum(row["points"] for row in rows)
    figure, axes = _panels(1, 1, f"Bounds of amplitudes beside {runs:,} simulated runs")
    seeds = [row["seed"] for row in rows]
    for column, label in (
        ("largest_over_runs", "largest over the worst run"),
        ("error", "median over the worst run"),
        ("median_over_signals", "median over the worst known signal"),
    ):
        colour, marker = _AMPLITUDE_STYLES[column]
        heights = [row[column] for row in rows]
        axes[0, 0].plot(seeds, heights, marker=marker, color=colour, label=label)
    axes[0, 0].set(ylim=(0.0, None), xlabel="seed", ylabel="bound, over what was driven")
    return _with_legend(figure, axes)


def _loops(rows: list[Row]) -> Figure:
    figure, axes = _panels(2, len(rows) // 2, "Random loops with estimators and filters, by balls")
    for panel, row in zip(axes.ravel(), rows, strict=True):
        words = ("wrong", "undecided", "unbounded", "unresolved", "unjudged", "judged")
        names = [name for name in words if name in row]
        panel.barh(names, [row[name] for name in names])
        panel.set(xscale="symlog", xlabel=f"{row['section']}: {row['method']}")
    return figure


def _exact(rows: list[Row]) -> Figure:
    """CPU time of balls and of the other answer, and below what each leaves open or gets wrong."""
    kinds = [row for row in rows if "judged" in row]
    figure, axes = _panels(1, 2, "Balls beside float64 and pairs, on random loops of all kinds")
    figure.set_figheight(2.4 + 0.22 * len(kinds))
    sections = [row["section"] for row in kinds][::-1]
    for panel, names, label in (
        (axes[0, 0], ("seconds", "rival_seconds"), "median CPU time in s"),
        (axes[0, 1], ("open", "rival_open"), "left open"),
    ):
        for name, method in zip(names, ("exact", "float64 and pairs"), strict=True):
            colour, marker = _STYLES[method]
            values = [row[name] for row in kinds][::-1]
            panel.plot(values, sections, marker, color=colour, label=method)
        panel.set(xlabel=label)
    axes[0, 0].set_xscale("log")
    axes[0, 1].set_yticklabels([])
    judged, wrong, contradicts = (
        sum(row[column] for row in kinds) for column in ("judged", "wrong", "contradicts")
    )
    words = f"{judged:,} judged, {wrong} wrong,\n{contradicts} contradict the other"
    axes[0, 1].set_title(words, fontsize=9)
    return _with_legend(figure, axes)


_DRAWINGS: dict[str, Callable[[list[Row]], Figure]] = {
    "latency": _latency,
    "boundary": _boundary,
    "criteria": _criteria,
    "tuning": _tuning,
    "ranges": _ranges,
    "loops": _loops,
    "exact": _exact,
    "amplitudes": _amplitudes,
    "regions": _regions,
    "answers": _answers,
    "resolution": _resolution,
    "throughput": _throughput,
    "accelerator": _accelerator,
    "estimators": _estimators,
    "scaling": _scaling,
    "stress": _stress,
    "verdicts": _verdicts,
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
