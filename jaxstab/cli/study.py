"""The command for studies: many devices, people and controllers as one table."""

from collections.abc import Iterator, Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN
from math import inf, isfinite, nan, prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jaxstab.cli.options import (
    computing,
    draw,
    executor_options,
    file_option,
    keep_programs,
    key_values,
    plot_option,
    print_with_csv,
    refuse,
    split,
)
from jaxstab.cli.scene import mechanics_options, scene_command, tables_of
from jaxstab.conventions import Verdict
from jaxstab.shown import rounded_text, table_text
from jaxstab.tables import computed, require_free, write

if TYPE_CHECKING:
    from xarray import Dataset


@scene_command()
@mechanics_options
@click.option(
    "--over",
    multiple=True,
    callback=key_values,
    metavar="KEY=VALUES",
    help="What varies: LOW:HIGH:COUNT, V,V,..., normal:MEAN:DEVIATION, uniform:LOW:HIGH, "
    "lognormal:MEDIAN:FACTOR or csv:FILE:COLUMN; may be repeated.",
)
@click.option(
    "--answer",
    multiple=True,
    help="limits, verdict, margins, settling_time or spectral_radius; may be repeated. Default: "
    "limits, and verdict if there are walls.",
)
@click.option(
    "--samples", type=int, help="Number of draws; default: 10,000, or what takes about a minute."
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the draws.")
@file_option(
    "-o", "--output", endings=(".h5", ".nc"), help="Store the table as this netCDF-4 file."
)
@file_option(
    "--csv", "csv_file", help="CSV file ('-': stdout) for the table, a row for each loop and wall."
)
@executor_options
@click.option(
    "--part",
    callback=split("/", int, (2,), "is no part; give NUMBER/COUNT, such as 3/64."),
    metavar="NUMBER/COUNT",
    help="Compute one part of the study alone.",
)
@click.option("--merge", is_flag=True, help="FILEs are all parts of a study: put them together.")
@plot_option("PNG or SVG file to draw the study into.")
def study(
    over: dict[str, str],
    samples: int | None,
    seed: int,
    output: Path | None,
    csv_file: Path | None,
    part: list[int] | None,
    merge: bool,
    plot: Path | None,
    **given: Any,
) -> None:
    """Answer for many devices, people and controllers at once, as one table.

    Lists of values span a grid, distributions are drawn at each of its points.
    """
    from jaxstab.scene.study import merged, plan_study

    if output is None and (merge or part):
        raise click.UsageError("--merge and --part are given without --output; give the file.")
    if merge:
        files = given.pop("files")
        of_studies = {"over": over, "part": part, "samples": samples, "seed": seed or None, **given}
        words = "is given beside --merge, but nothing is computed anew; give one of them."
        refuse(of_studies, words)
        table = merged(files)
    else:
        if len(given["files"]) > 1:
            raise click.UsageError("a study is for one scene; give one FILE, or --merge.")
        ((_, scene),) = tables_of(given).items()
        keep_programs()
        number, count = part or (1, 1)
        asked: Any = {"answers": given["answer"], "samples": samples, "seed": seed}
        table, notes = plan_study(scene, over, part=(number, count), **asked)
        if samples is not None and "sample" not in table.dims:
            raise click.UsageError(
                f"--samples is {samples}, but nothing is drawn; leave it out, or let --over have a "
                "distribution, such as device.mass=uniform:0.1:0.2."
            )
    for file in (output, csv_file):  # what is read is refused above, and not to be removed
        if file is not None and str(file) != "-":
            require_free(file)
    rows, most = prod(table.sizes.values()), 1_048_575  # in a spreadsheet, with one of names
    if csv_file and rows > most:
        raise click.UsageError(
            f"the CSV file would have {rows:,} rows; give --output in place of --csv for more than "
            f"{most:,}."
        )
    if not merge:
        for note in notes:
            click.echo(f"jaxstab: {note}", err=True)
        with computing(given):
            table = computed(table)
    if output is not None:
        write(table, output)
    cells = _cells(table) if csv_file else ()
    print_with_csv(_report(table, is_small=rows <= most), cells, csv_file)
    if plot:
        from jaxstab.pictures.scene import study_figure

        draw(study_figure(table), plot)


# What is printed: the table of a grid; quantiles of draws, and shares of stable walls.

_INWARDS = {"largest": ROUND_FLOOR, "least": ROUND_CEILING}


def _report(table: "Dataset", *, is_small: bool) -> str:
    from jaxstab.scene.study import limit_in, quantiles, shares, walls_in

    walls, limit = walls_in(table), limit_in(table)
    of_walls = [name for name in table.coords if str(name).startswith(f"{walls}_")]
    if "sample" not in table.dims:
        words = [_text(table.drop_vars(of_walls))]
        for wall in table[walls].values if "verdict" in table else ():
            codes = table.verdict.sel({walls: wall})
            stable, undecided = (codes == Verdict.STABLE).sum(), (codes == Verdict.UNDECIDED).sum()
            counts = f"{stable.item():,} of {codes.size:,} loops, {undecided.item():,} undecided"
            words.append(f"{wall}: stable for {counts}")
        return "\n".join(words if is_small else words[1:])
    words, draws = [], f"{table.sizes['sample']:,} draws"
    if limit:
        found = quantiles(table, limit)
        found = found if found.ndim > 1 else found.expand_dims({"": [draws]})
        named = {0.05: "5th percentile", 0.5: "median", 0.95: "95th percentile"}
        words.append(f"{limit.replace('_', ' ')} in {found.units}, over {draws}:")
        words.append(_text(found.to_dataset("quantile").rename(named), limit))
    if "verdict" in table:
        found = shares(table)
        found = found.drop_vars(of_walls)
        percent = 100.0 * found[["share", "low", "high"]]
        words.append(f"proved stable in % of {draws}, with the 95 % confidence interval:")
        words.append(_text(percent.rename(share="stable").assign(undecided=found.undecided)))
    return "\n".join(words)


def _frame(table: "Dataset") -> Any:
    """Parameters and answers, a row for each loop and wall, codes as words."""
    import numpy as np

    from jaxstab.scene.study import lists_of

    words = {}
    for name, values in table.data_vars.items():
        if "flag_values" in values.attrs:
            meanings = np.array(values.attrs["flag_meanings"].split())
            words[name] = values.copy(data=meanings[np.searchsorted(values.flag_values, values)])
    order = [n for n in (*lists_of(table), "sample", "wall", "gains") if n in table.dims]
    frame = table.assign(words).to_dataframe(dim_order=order).reset_index()
    return frame[[*order, *(name for name in table.coords if name not in order), *table.data_vars]]


def _text(table: "Dataset", limit: str = "") -> str:
    """Return the first rows of a table in columns, with units; its values may be of one limit."""
    frame, most = _frame(table), 40
    units = {name: table[name].attrs.get("units", "1") for name in frame}
    heads = [f"{name} ({unit})" if unit.strip("1") else name for name, unit in units.items()]
    names = [(name in table.data_vars and limit) or name for name in frame]
    ways = [_INWARDS.get(name.partition("_")[0], ROUND_HALF_EVEN) for name in names]
    rows = [[*map(_cell, row, ways)] for row in frame.head(most).itertuples(index=False)]
    text = table_text([[head.replace("_", " ") for head in heads], *rows])
    more = len(frame) - most
    return f"{text}\n... and {more:,} more rows; write them with --csv or -o" if more > 0 else text


def _cell(value: Any, way: str) -> str:
    if isinstance(value, str):
        return value
    return rounded_text(value, 6, way) if isfinite(value) else f"{value:g}"


def _cells(table: "Dataset") -> Iterator[Sequence[Any]]:
    """Yield the rows of a CSV file, names first; a cell is empty for NaN and infinite numbers."""
    frame = _frame(table).replace([-inf, inf, nan], None)
    yield [*frame]
    yield from frame.itertuples(index=False)
