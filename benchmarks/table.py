"""The table of benchmarks: a line for each task and method, with its run time and its error.

docs/accuracy.md has all of it below the table of rivals; README has three sizes of an atlas.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.record import Record, Row

ROOT = Path(__file__).parents[1]
README, PAGE = ROOT / "README.md", ROOT / "docs" / "accuracy.md"
MAP = ROOT / "docs" / "mapper.md"

_WAYS = ("nearest", "linear", "cubic")
_KINDS = {
    "random": "at random",
    "near": "next to limits",
    "faces": "on faces of cells",
    "whole": "at whole delays and next to them",
}

_HEADING = ("task", "method", "run time", "error", "speed-up over LAPACK eigenvalues")
_DELAYS = (0.0, 1.0, 5.0, 20.0, 60.0)  # of the throughput, whose record has others
_METHODS = ("verdict", "spectral_radius")
_DEGREES = ("degree 25", "degree 205", "degree 485")  # of loops in balls
_OWN_REGIONS = ("stable_region", "regions_of")
_POLYNOMIALS = ("degree 10", "degree 10, clustered", "degree 40", "degree 40, clustered")

DAMPINGS = 0.4, 1.0, 2.0  # of walls with delays that move, times that of the largest stiffness

Line = tuple[str, str, str, str, str]


def markdown(records: list[Record]) -> str:
    """Return the table of the machine that has the most records, under the machine's name."""
    chosen = of_one_machine(records)
    lines = [
        line for name in _LINES if name in chosen for line in _LINES[name](chosen[name]["rows"])
    ]
    caption = _caption(chosen.get("throughput") or next(iter(chosen.values())))
    return f"{caption}\n\n{of_cells(_HEADING, lines)}"


def rivals(records: list[Record]) -> str:
    """The times of tools for a loop, and their errors."""
    found = of_one_machine(records)["rivals"]["rows"]
    groups = list(_grouped(found, "section"))
    tools = {
        name: {row["section"]: row for row in some}
        for name, some in _grouped(found, "method").items()
    }
    rows = []
    for name, of in tools.items():
        ends = (", ".join(_end([of[group]])) if group in of else "" for group in groups)
        own = [row for row in of.values() if "wrong" in row]
        verdict = _time(float(np.mean([r["cpu_seconds_per_verdict"] for r in own]))) if own else ""
        wrong = " of ".join(map(str, _sums(own, "wrong", "verdicts")))
        first = next(
            (_time(row["first_seconds"]) for row in of.values() if "first_seconds" in row), ""
        )
        lines_ = str(next(iter(of.values()))["lines"])
        rows.append((name, *ends, verdict, wrong if own else "", lines_, first))
    return of_cells(("tool", *groups, "verdict", "wrong verdicts", "lines", "fresh process"), rows)


def _end(rows: list[Row]) -> tuple[str, str]:
    """CPU time per loop, and the largest error of ends that were found with how many were not."""
    seconds, loops, missed, judged = _sums(rows, "cpu_seconds", "points", "missed", "judged")
    errors = [row["largest_error_found"] for row in rows if row["missed"] < row["judged"]]
    said = [_error(max(errors))] if errors else []
    said += [f"{missed} of {judged} missed"] if missed else []
    return _time(seconds / loops), "; ".join(said)


def of_one_machine(records: list[Record]) -> dict[str, Record]:
    """The records of the machine that has the most, by benchmark."""
    machines = Counter(one["machine"]["name"] for one in records)
    machine = machines.most_common(1)[0][0]
    return {one["benchmark"]: one for one in records if one["machine"]["name"] == machine}


def put_into_pages(records: list[Record]) -> None:
    """Replace what is between the markers in the README and in docs/accuracy.md."""
    devices = [one for one in records if one["benchmark"] == "accelerator"]
    of_page = {"rivals": rivals(records), "benchmarks": markdown(records)}
    if any(one["benchmark"] == "resolution" for one in records):
        of_page["resolutions"] = resolutions(records)
        put_between(README, "table of {}: {}", {"sizes": sizes(records)})
    if any(one["benchmark"] == "loops" for one in records):
        of_page["unresolved"] = unresolved(records)
    if devices:
        of_page["devices"] = accelerated(devices)
    if any(one["benchmark"] == "jitter" for one in records):
        of_page["delays"] = moving_delays(records)
    if any(one["benchmark"] == "mapper" for one in records):
        put_between(MAP, "table of {}: {}", {"maps": maps(records)})
    put_between(PAGE, "table of {}: {}", of_page)


def maps(records: list[Record]) -> str:
    """The CPU time of a point of dense grids, by how many points there are, beside its error."""
    one = next(one for one in records if one["benchmark"] == "mapper")
    sizes = sorted({row["batch"] for row in one["rows"]})
    lines = []
    for section, some in _grouped(one["rows"], "section").items():
        for method, rows in _grouped(some, "method").items():
            by_size = {row["batch"]: row for row in rows}
            own = [
                f"{_time(row['seconds_per_point'])}, {row['times_numpy_eigvals']:.2g}x"
                if row
                else "-"
                for row in map(by_size.get, sizes)
            ]
            error = max(row["error"] for row in by_size.values())
            lines.append((section, method, *own, f"{error:.1e}"))
    heading = ("grid", "method", *(f"{size:,} points" for size in sizes), "largest error")
    return f"{_caption(one)}\n\n{of_cells(heading, lines)}"


def put_between(page: Path, marker: str, tables: dict[str, str]) -> None:
    """Replace what is between the comments that mark where each table begins and ends."""
    text = page.read_text(encoding="utf-8")
    for name, table in tables.items():
        begin, end = (f"<!-- {marker.format(name, side)} -->" for side in ("begin", "end"))
        text = f"{text.split(begin)[0]}{begin}\n{table}\n{end}{text.split(end)[1]}"
    page.write_text(text, encoding="utf-8")


def of_cells(heading: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    rows = [heading, ("---",) * len(heading), *lines]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _caption(one: Record) -> str:
    """On what the record that most rows are of was made."""
    machine, versions = one["machine"], one["versions"]
    device = machine["accelerator"] or machine["cpu"]
    small = " Small runs: they only show that the benchmarks run." if one["small"] else ""
    return (
        f"{device}, {machine['cores']} cores, {machine['memory_gib']:g} GiB; Python "
        f"{versions['python']}, jax {versions['jax']}, NumPy {versions['numpy']}.{small}"
    )


def _boundary(rows: list[Row]) -> Iterator[Line]:
    delay = 1.0
    rows = [row for row in rows if row["delay"] == delay]
    outlines = [row for row in rows if row["section"] == "outline"]
    finest = max(row["n"] for row in outlines)
    for row in outlines:
        if row["n"] == finest:
            task = f"boundary of a slice, delay {delay:g}, N = {finest}"
            yield task, row["method"], _time(row["seconds"]), _error(row["error"]), ""
    for row in rows:
        if row["section"] == "region" and row["method"] in _OWN_REGIONS:
            time = f"{_time(row['seconds'])} ({row['regions_per_second']:,.0f} regions/s)"
            number = "one region" if row["regions"] == 1 else f"{row['regions']} regions"
            yield f"{number}, delay {delay:g}", row["method"], time, _error(row["error"]), ""


def _regions(rows: list[Row]) -> Iterator[Line]:
    for method, some in _grouped(rows, "method").items():
        slices, judged, wrong, unresolved = _sums(some, "slices", "judged", "wrong", "unresolved")
        longest = max(row["delay"] for row in some)
        task = f"{slices:,} random slices, delays 0 to {longest:g}, {judged:,} points"
        error = f"{wrong:,} points wrong, {unresolved} slices unresolved"
        yield task, method, "", error, ""


def _throughput(rows: list[Row]) -> Iterator[Line]:
    for row in rows:
        shown = row["delay"] in _DELAYS and row["method"] in _METHODS
        if row["section"] != "batch" and shown:
            rivals = {"NumPy": "numpy_eigvals", "jax": "jax_eigvals"}
            times = {name: row[f"cpu_times_{rival}"] for name, rival in rivals.items()}
            ratios = ", ".join(
                f"{one:,.{0 if one >= 10.0 else 1}f} ({name})" for name, one in times.items()
            )
            estimator = "" if row["section"] == "delay" else f"{row['section']}, "
            task = f"slice of {row['batch']:,} points, {estimator}delay {row['delay']:g}"
            time = f"{_time(row['seconds_per_point'])} per point"
            yield task, row["method"], time, _error(row["error"]), ratios


def accelerated(records: list[Record]) -> str:
    """Return the table of dense grids on accelerators, and on two cores beside them."""
    lines = []
    for one in records:
        for host, device in zip(one["rows"][::2], one["rows"][1::2], strict=True):
            kind = "radius" if host["section"] == "spectral_radius" else host["section"]
            times = [_time(row["seconds_per_point"]) for row in (device, host)]
            name = device["method"]
            ratio = f"{device['times_two_cores']:,.0f}"
            task = f"{kind}, delay {host['delay']:g}"
            lines.append((task, name, *times, ratio, _error(device["error"])))
    head = "task", "device", "per point", "per point, two cores", "ratio", "contradictions"
    return of_cells(head, lines)


def moving_delays(records: list[Record]) -> str:
    """Return the table of the stiffness that is proved for every sequence of delays, in percent."""
    (one,) = (record for record in records if record["benchmark"] == "jitter")
    lines: dict[tuple[str, str], dict[float, str]] = {}
    for row in one["rows"][1:]:
        share = f"{100.0 * row['proved'] / row['grows']:.1f}" if row["proved"] else "-"
        lines.setdefault((str(row["window"]), row["delays"]), {})[row["factor"]] = share
    names = ("B" if factor == 1.0 else f"{factor:g} B" for factor in DAMPINGS)
    cells = ((*loop, *(some[factor] for factor in DAMPINGS)) for loop, some in lines.items())
    return of_cells(("window", "delays (samples)", *names), cells)


def unresolved(records: list[Record]) -> str:
    """Return the table of the random loops whose regions stay UNRESOLVED."""
    rows = of_one_machine(records)["loops"]["rows"]
    lines = [
        (row["section"].removeprefix("points of regions").strip() or "of one mass",
         f"{row['repeats']:,}", str(row["unresolved"]))
        for row in rows
        if row["method"] == "stable_region"
    ]  # fmt: skip
    return of_cells(("loops with estimators and filters", "regions", "UNRESOLVED"), lines)


def _answers(rows: list[Row]) -> Iterator[Line]:
    for row in rows:
        task = f"{row['asked']:,} points of the default atlas, {_KINDS[row['section']]}"
        error = f"{row['wrong']} wrong, {row['computed']:.2%} left to be computed"
        yield task, row["method"], f"{_time(row['seconds_per_point'])} per point", error, ""


def resolutions(records: list[Record]) -> str:
    """Nodes along the axes against error, share computed, size and time, about the default."""
    head = "nodes", "size", "build", *(f"{name}: error, computed" for name in _WAYS)
    lines = []
    for section, some in _about_the_default(records):
        first = some[_WAYS[0]]
        ways = (f"{some[name]['error']:.1e}, {some[name]['computed']:.2%}" for name in _WAYS)
        cells = section, _bytes(first["bytes"]), f"{_time(first['build_seconds'])} of CPU", *ways
        lines.append(cells)
    return of_cells(head, lines)


def sizes(records: list[Record]) -> str:
    """What an atlas costs, and how wrong its limits are between nodes."""
    left = "points left to compute"
    head = "nodes of an atlas", "file", "CPU to build", "largest error of a limit", left
    lines = []
    for section, some in _about_the_default(records):
        own = some["cubic"]
        costs = _bytes(own["bytes"]), _time(own["build_seconds"])
        lines.append((section, *costs, f"{own['error']:.1e}", f"{own['computed']:.2%}"))
    return of_cells(head, lines)


def _about_the_default(records: list[Record]) -> Iterator[tuple[str, dict[str, Row]]]:
    """The nodes of three tables, the default among them, and the rows of each interpolation."""
    (one,) = (record for record in records if record["benchmark"] == "resolution")
    for section, rows in list(_grouped(one["rows"], "section").items())[1:4]:
        yield section, {row["method"]: row for row in rows}


def _loops(rows: list[Row]) -> Iterator[Line]:
    for row in rows:
        loops, judged = row["repeats"], row["judged"]
        doubts = [
            f"{row[word]:,} {word}"
            for word in ("undecided", "unbounded", "unresolved")
            if row.get(word)
        ]
        task = f"{loops:,} loops with estimators and filters, {judged:,} {row['section']} judged"
        time = f"{_time(row['seconds'])} of CPU for {row['points']}"
        yield task, row["method"], time, ", ".join([f"{row['wrong']:,} wrong", *doubts]), ""


def _exact(rows: list[Row]) -> Iterator[Line]:
    asked = [row for row in rows if row["method"] == "exact"]
    asked = [row | {"question": row["section"].split()[0]} for row in asked]
    for question, some in _grouped(asked, "question").items():
        total, judged, wrong, undecided = _sums(some, "points", "judged", "wrong", "open")
        error = f"{wrong:,} of {judged:,} wrong, " if judged else ""
        error += f"{undecided:,} open"
        if largest := max(row["error"] for row in some):
            error += f", error at most {_error(largest)}"
        task = f"{total:,} {question} of random loops"
        yield task, "balls", f"{_time(some[0]['seconds'])} of CPU", error, ""
    for row in rows:
        if row["method"] != "exact" and row["section"] in _DEGREES:
            task = f"one {row['section'].replace('degree', 'loop of degree')}"
            yield task, f"balls: {row['method']}", f"{_time(row['seconds'])} of CPU", "", ""


def _polynomials(rows: list[Row]) -> Iterator[Line]:
    for row in rows:
        if row["section"] in _POLYNOMIALS:
            task = f"polynomials of {row['section']}: {row['points']:,} at once"
            time = f"{_time(row['cpu_seconds_per_point'])} of CPU each"
            error = _error(row["error"])
            if "open" in row:
                error += f", {row['open'] / row['points']:.2%} undecided"
            yield task, row["method"], time, error, ""


def _stress(rows: list[Row]) -> Iterator[Line]:
    rows = [row for row in rows if row["section"] == "delay"]
    for method, some in _grouped(rows, "method").items():
        total, wrong, undecided = _sums(some, "points", "wrong", "undecided")
        error = f"{wrong} wrong, {undecided / total:.1%} undecided"
        if "verdict" not in method:
            ulps = max(row["error"] for row in some)
            error += f", {ulps:.1e} ulp" if ulps < 2.0**53 else ", no digit right"
        if share := max(row["share_of_bound"] for row in some):
            error += f", at most {share:.3f} of its bound"
        yield f"{total:,} random and adversarial loops", method, "", error, ""


def _scaling(rows: list[Row]) -> Iterator[Line]:
    streamed = [row for row in rows if row["section"] == "points"]
    row = max(streamed, key=lambda row: row["points"])
    time = f"{_time(row['seconds'])}, peak {row['peak_mib']:.0f} MiB"
    error = f"{row['error']:.2%} wrong or undecided"
    yield f"{row['points']:,} points streamed", row["method"], time, error, ""


def _latency(rows: list[Row]) -> Iterator[Line]:
    for row in rows:
        time = f"{_time(row['seconds'])} of CPU"
        if row["method"] == "jaxstab":
            time += f" (target: {row['target_seconds']:g} s), {row['peak_mib']:.0f} MiB"
        yield f"fresh process: {row['section']}", row["method"], time, _error(row["error"]), ""


def _many(rows: list[Row]) -> Iterator[Line]:
    for one, alone in zip(rows[::2], rows[1::2], strict=True):
        task = f"{one['points']:,} loops of degree 25: {one['section']}"
        time = f"{_time(one['seconds'])} per loop, {_time(alone['seconds'])} one by one"
        yield task, one["method"], time, _error(one["error"]), ""


_LINES: dict[str, Callable[[list[Row]], Iterator[Line]]] = {
    "latency": _latency,
    "boundary": _boundary,
    "regions": _regions,
    "answers": _answers,
    "throughput": _throughput,
    "loops": _loops,
    "many": _many,
    "exact": _exact,
    "polynomials": _polynomials,
    "scaling": _scaling,
    "stress": _stress,
}


def _grouped(rows: list[Row], column: str) -> dict[str, list[Row]]:
    """Rows by what they have in a column, in their order."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(row[column], []).append(row)
    return groups


def _sums(rows: list[Row], *columns: str) -> list[Any]:
    return [sum(row[column] for row in rows) for column in columns]


def _time(seconds: float) -> str:
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds / 1e-9:.3g} ns"


def _error(error: float) -> str:
    return f"{error:.1e}" if error else "0"


def _bytes(count: int) -> str:
    return f"{count / 1e6:.3g} MB" if count >= 1e6 else f"{count / 1e3:.3g} kB"
