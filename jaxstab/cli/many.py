"""Many scenes in one process: a table, CSV, JSON, and a picture that compares them."""

import csv
import io
import json
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jaxstab.cli.options import write_beside
from jaxstab.cli.scene_options import refused, tables_of, warn
from jaxstab.shown import printable

if TYPE_CHECKING:
    from jaxstab.scene.many import Row, Variant

_SHOWN = {
    "best.largest_stiffness",
    "best.at_damping",
    "most_damped.largest_damping",
    "all_hands.largest_stiffness",
    "least_settling.stiffness",
    "least_settling.damping",
    "least_settling.settling_time_2_percent",
    "now_allowed_stiffness",
    "sample_time.largest_sample_time",
    "delay.largest_delay",
}
_SHOWN_OF_WALLS = {"verdict", "stiffness_gain", "settling_time_2_percent"}


def answer_many(given: dict[str, Any], function: str, as_json: bool) -> list[Any]:
    """Answer several scenes, print what they allow, and return the answers.

    Raises:
        click.UsageError: no scene could be answered, or some were refused; the others are printed.
    """
    import jaxstab.scene
    from jaxstab.scene.many import answer_all, sweep_of, variants_of

    with refused():
        variants = variants_of(tables_of(given), dict(map(sweep_of, given["sweep"])))
        for words in dict.fromkeys(w for v in variants if v.scene for w in v.scene.unusual()):
            warn(words)
        rows = list(
            _with_progress(answer_all(variants, getattr(jaxstab.scene, function)), len(variants))
        )
        _write(rows, given["csv_file"], as_json)
        if given["plot"]:
            _draw(rows, given["plot"])
    _refuse_some(rows)
    return [row.answer for row in rows if row.answer]


def _with_progress(rows: Iterable["Row"], count: int) -> Iterator["Row"]:
    """Show on a terminal how many scenes are answered."""
    if not sys.stderr.isatty():
        yield from rows
        return
    from rich.console import Console
    from rich.progress import track

    yield from track(rows, "scenes", total=count, console=Console(stderr=True), transient=True)


def _write(rows: list["Row"], csv_file: Path | None, as_json: bool) -> None:
    if csv_file:
        text = _csv(rows)
        if str(csv_file) == "-":
            click.echo(text, nl=False)
            return
        write_beside(text.encode(), csv_file)
    click.echo(_json(rows) if as_json else _table(rows))


def _csv(rows: list["Row"]) -> str:
    columns = [*_heads(rows), *_paths(rows), "refusal"]
    stream = io.StringIO()
    writer = csv.DictWriter(stream, columns, lineterminator="\n", restval="")
    writer.writeheader()
    for row in rows:
        given = {"scene": row.variant.source, **row.variant.values}
        cells = {**given, **row.values, "refusal": row.refusal}
        writer.writerow({name: _no_formula(value) for name, value in cells.items()})
    return stream.getvalue()


def _no_formula(value: Any) -> Any:
    """Return a cell with a quote before what a spreadsheet would compute."""
    return f"'{value}" if isinstance(value, str) and value[:1] in tuple("=+-@\t\r") else value


def _json(rows: list["Row"]) -> str:
    return json.dumps(
        [
            {
                "scene": row.variant.source,
                "swept": row.variant.values,
                "answer": row.answer.as_json() if row.answer else None,
                "refusal": row.refusal or None,
            }
            for row in rows
        ],
        indent=1,
    )


def _table(rows: list["Row"]) -> str:
    """Return the main numbers of each scene, in columns, or the reason why it was refused."""
    from jaxstab.scene.many import short

    paths = [path for path in _paths(rows) if path in _SHOWN or _is_of_wall(path)]
    first = "scene" if any(row.variant.source for row in rows) else ""
    heads = [first, *rows[0].variant.values]
    lines = [[*heads, *(_head(path) for path in paths)]]
    for row in rows:
        own = [row.variant.source, *(short(value) for value in row.variant.values.values())]
        lines.append(list(map(printable, [*own, *(row.words.get(path, "") for path in paths)])))
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    refusals = ["", *(printable(row.refusal) for row in rows)]
    return "\n".join(
        "  ".join(
            f"{cell:{width}}" for cell, width in zip(line, widths, strict=True) if width
        ).rstrip()
        + (f"  {refusal}" if refusal else "")
        for line, refusal in zip(lines, refusals, strict=True)
    )


def _is_of_wall(path: str) -> bool:
    outer, _, name = path.rpartition(".")
    return name in _SHOWN_OF_WALLS and outer.startswith("walls.") and outer.count(".") == 1


def _head(path: str) -> str:
    return path.removeprefix("walls.").replace("_", " ").replace(".", ": ")


def _heads(rows: list["Row"]) -> list[str]:
    return ["scene", *rows[0].variant.values]


def _paths(rows: list["Row"]) -> list[str]:
    """Return the paths of all values, in the order in which they come."""
    return list(dict.fromkeys(path for row in rows for path in row.values))


def _draw(rows: list["Row"], file: Path) -> None:
    from jaxstab.pictures.comparison import comparison_figure
    from jaxstab.pictures.style import picture

    answered: list[Variant] = [row.variant for row in rows if row.answer]
    write_beside(picture(comparison_figure(answered), file.suffix[1:]), file)


def _refuse_some(rows: list["Row"]) -> None:
    wrong = [row for row in rows if row.refusal]
    if wrong:
        first = wrong[0]
        raise click.UsageError(
            f"{len(wrong)} of {len(rows)} scenes were refused; the first, {first.variant.name}: "
            f"{first.refusal}"
        )
