"""The command for studies: many devices, people and controllers as one table."""

from collections.abc import Callable, Iterator
from itertools import chain
from math import inf, prod
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import click

from jaxstab.cli.options import (
    draw,
    executor_of,
    executor_options,
    file_in,
    file_option,
    keep_programs,
    plot_option,
    print_with_csv,
    resumable,
)
from jaxstab.cli.scene import mechanics_options, tables_of
from jaxstab.shown import printable, shortened, table_text

if TYPE_CHECKING:
    from jaxstab.scene.study import Study

_MOST_ROWS = 20
_MOST_IN_CSV = 1_048_575  # as in a spreadsheet, with a row of names
_PROBABILITIES = (0.05, 0.5, 0.95)


def _part(_: click.Context, option: click.Parameter, text: str | None) -> tuple[int, int]:
    if text is None:
        return 1, 1
    index, slash, count = text.partition("/")
    if not (slash and index.isdigit() and count.isdigit() and 1 <= int(index) <= int(count)):
        raise click.BadParameter(
            f"{text!r} is no part; give NUMBER/COUNT, such as 3/64.", param=option
        )
    return int(index), int(count)


def _over(_: click.Context, option: click.Parameter, texts: tuple[str, ...]) -> dict[str, Any]:
    from jaxstab.scene.draws import distribution_of, values_of

    over: dict[str, Any] = {}
    for text in texts:
        key, __, values = text.partition("=")
        if not (key and values):
            raise click.BadParameter(
                f"{shortened(text)} is not KEY=VALUES, such as device.mass=0.1:0.5:20.",
                param=option,
            )
        try:
            given: Any = distribution_of(values) or values_of(key, values)
        except ValueError as error:
            raise click.BadParameter(str(error), param=option) from None
        if key in over:
            raise click.BadParameter(f"{key} is given twice; give each key once.", param=option)
        over[key] = given
    return over


@click.command()
@mechanics_options
@click.option(
    "--over",
    multiple=True,
    callback=_over,
    metavar="KEY=VALUES",
    help="What varies: LOW:HIGH:COUNT, V,V,..., normal:MEAN:DEVIATION, uniform:LOW:HIGH, "
    "lognormal:MEDIAN:FACTOR or csv:FILE:COLUMN; may be repeated.",
)
@click.option(
    "--answer",
    "answers",
    multiple=True,
    help="limits, verdict, margins, settling_time or spectral_radius; may be repeated. Default: "
    "limits, and verdict if there are walls.",
)
@click.option("--samples", default=10_000, show_default=True, help="Number of draws.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the draws.")
@file_option(
    "-o",
    "--output",
    check=file_in(".h5", ".nc"),
    help="Store the table as this netCDF-4 file, and continue an interrupted study.",
)
@file_option(
    "--csv", "csv_file", help="CSV file ('-': stdout) for the table, a row for each loop and wall."
)
@executor_options
@click.option(
    "--part", callback=_part, metavar="NUMBER/COUNT", help="Compute one part of the study alone."
)
@click.option("--merge", is_flag=True, help="FILEs are all parts of a study: put them together.")
@plot_option("PNG or SVG file to draw the study into.")
def study(
    over: dict[str, Any],
    answers: tuple[str, ...],
    samples: int,
    seed: int,
    output: Path | None,
    csv_file: Path | None,
    part: tuple[int, int],
    merge: bool,
    plot: Path | None,
    **given: Any,
) -> None:
    """Answer for many devices, people and controllers at once, as one table.

    Lists of values span a grid, distributions are drawn at each of its points. A study that was
    interrupted continues when the command is repeated; one that is done is read.
    """
    from jaxstab.scene.study import Study, merge_studies, plan_of, study_dataset

    if output is None and (merge or part != (1, 1)):
        raise click.UsageError("--merge and --part are given without --output; give the file.")
    if merge:
        if over or part != (1, 1):
            raise click.UsageError("--merge is given beside --over or --part; give one of them.")
        assert output is not None
        _report(merge_studies(given["files"], output), csv_file, plot)
        return
    if len(given["files"]) > 1:
        raise click.UsageError("a study is for one scene; give one FILE, or --merge.")
    from jaxstab.datasets import ensure

    ((_, table),) = tables_of(given).items()
    keep_programs()
    options: dict[str, Any] = {"samples": samples, "seed": seed, "part": part}
    with TemporaryDirectory(prefix="jaxstab-study-") as folder:
        path = output or Path(folder, "study.h5")
        dataset = study_dataset(table, over, path, answers=answers, **options)
        _require_few(prod(dataset.shape), csv_file)
        for note in [*dataset.attributes["notes"].splitlines(), plan_of(dataset)]:
            click.echo(f"jaxstab: {note}", err=True)
        with resumable(output) as show, executor_of(given) as executor:
            ensure(dataset, show, executor)
        if part != (1, 1):
            click.echo(f"{output}: part {part[0]} of {part[1]}; --merge puts all together")
        else:
            _report(Study(path), csv_file, plot)


def _require_few(rows: int, csv_file: Path | None) -> None:
    if csv_file and rows > _MOST_IN_CSV:
        raise click.UsageError(
            f"the CSV file would have {rows:,} rows; give --output in place of --csv for more than "
            f"{_MOST_IN_CSV:,}."
        )


def _report(made: "Study", csv_file: Path | None, plot: Path | None) -> None:
    """Print the results of a study, and write its table and its picture."""
    size = prod(map(len, made.dimensions.values()))
    _require_few(size, csv_file)
    is_grid = "sample" not in made.dimensions and size <= _MOST_IN_CSV
    columns = made.columns() if csv_file or is_grid else {}
    words = [*_limits_words(made), *_shares_words(made)]
    if is_grid:
        own = {name: values for name, values in columns.items() if not name.startswith("wall_")}
        units = {name: f" ({unit})" for name, unit in made.units.items() if unit != "1"}
        heads = [name.replace("_", " ") + units.get(name, "") for name in own]
        words = [_table([heads, *_rows(own, _shown)]), *words]
    print_with_csv("\n".join(words), chain([columns], _rows(columns, _cell)), csv_file)
    if plot:
        from jaxstab.pictures.study import study_figure

        draw(study_figure(made), plot)


def _rows(columns: dict[str, Any], shown: Callable[[Any], str]) -> Iterator[list[str]]:
    for row in zip(*(column.flat for column in columns.values()), strict=True):
        yield [shown(value) for value in row]


def _cell(value: Any) -> str:
    """Return a cell of CSV, empty for NaN and infinite numbers."""
    return "" if value in (-inf, inf) or value != value else str(value)


def _shown(value: Any) -> str:
    return printable(value) if isinstance(value, str) else f"{value:.6g}"


def _limits_words(made: "Study") -> list[str]:
    """Return the quantiles of the largest stiffness among draws."""
    if not {"largest_stiffness", "sample"} <= made.units.keys():
        return []
    unit = made.units["largest_stiffness"]
    low, middle, high = made.quantiles(at=_PROBABILITIES)
    rows = [
        [*labels, *(f"{value:.5g}" for value in row)]
        for labels, row in zip(
            _points(made, low.shape),
            zip(low.ravel(), middle.ravel(), high.ravel(), strict=True),
            strict=True,
        )
    ]
    heads = [*made.lists, f"largest stiffness in {unit}: 5 % below", "half below", "95 % below"]
    return [_table([heads, *rows])]


def _shares_words(made: "Study") -> list[str]:
    """Return for which share of the draws, or of the grid, each wall is stable."""
    if "verdict" not in made.units:
        return []
    import numpy as np

    from jaxstab.conventions import Verdict

    names = made.dimensions["wall"].tolist()
    if "sample" not in made.dimensions:
        codes = made.values("verdict").reshape(-1, len(names))
        return [
            f"{name}: stable for {(column == Verdict.STABLE).sum():,} of {len(column):,} loops, "
            f"{(column == Verdict.UNDECIDED).sum():,} undecided"
            for name, column in zip(names, codes.T, strict=True)
        ]
    shares = made.shares()
    if shares.share.ndim == 1:
        return [
            f"{name}: stable for {100.0 * share:.4g} % of {shares.draws:,} draws (95 % confidence: "
            f"{100.0 * low:.4g} to {100.0 * high:.4g} %; each verdict proved, {undecided} "
            "undecided)"
            for name, share, low, high, undecided in zip(
                names, shares.share, shares.low, shares.high, shares.undecided, strict=True
            )
        ]
    rows = [
        [*labels, *(f"{100.0 * v:.4g} ({100.0 * a:.4g} to {100.0 * b:.4g})" for v, a, b in row)]
        for labels, row in zip(
            _points(made, shares.share.shape[:-1]),
            np.stack(shares[:3], axis=-1).reshape(-1, len(names), 3),
            strict=True,
        )
    ]
    heads = [*made.lists, *(f"{name}: % stable" for name in names)]
    undecided = int(shares.undecided.sum())
    words = f"in brackets: 95 % confidence; each verdict proved, {undecided} undecided"
    return [_table([heads, *rows]), words]


def _points(made: "Study", shape: tuple[int, ...]) -> list[list[str]]:
    """Return the values of the dimensions at each point of the grid, as text."""
    import numpy as np

    values = [made.dimensions[name] for name in made.lists]
    places = np.indices(shape).reshape(len(shape), prod(shape)).T
    return [
        [
            f"{along[k]:g}" if along.dtype.kind in "fi" else printable(str(along[k]))
            for along, k in zip(values, place, strict=True)
        ]
        for place in places
    ]


def _table(rows: list[list[str]]) -> str:
    more = len(rows) - 1 - _MOST_ROWS
    text = table_text(rows[: 1 + _MOST_ROWS])
    return f"{text}\n... and {more:,} more rows; write them with --csv or -o" if more > 0 else text
