"""The command for studies: many devices, people and controllers as one table."""

from pathlib import Path
from typing import Any

import click

from jaxstab.cli.options import (
    computing,
    executor_options,
    file_in,
    file_option,
    keep_programs,
    plot_option,
)
from jaxstab.cli.scene import SceneCommand, mechanics_options, tables_of
from jaxstab.shown import shortened


def _part(_: click.Context, option: click.Parameter, text: str | None) -> tuple[int, int]:
    if text is None:
        return 1, 1
    index, slash, count = text.partition("/")
    if not (slash and index.isdigit() and count.isdigit() and 1 <= int(index) <= int(count)):
        raise click.BadParameter(
            f"{text!r} is no part; give NUMBER/COUNT, such as 3/64.", param=option
        )
    return int(index), int(count)


def _over(_: click.Context, option: click.Parameter, texts: tuple[str, ...]) -> dict[str, str]:
    over = dict[str, str]()
    for text in texts:
        key, __, values = text.partition("=")
        if not (key and values):
            raise click.BadParameter(
                f"{shortened(text)} is not KEY=VALUES, such as device.mass=0.1:0.5:20.",
                param=option,
            )
        if key in over:
            raise click.BadParameter(f"{key} is given twice; give each key once.", param=option)
        over[key] = values
    return over


@click.command(cls=SceneCommand)
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
@click.option(
    "--samples", type=int, help="Number of draws; default: 10,000, or what takes about a minute."
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the draws.")
@file_option(
    "-o", "--output", check=file_in(".h5", ".nc"), help="Store the table as this netCDF-4 file."
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
    over: dict[str, str],
    samples: int | None,
    seed: int,
    output: Path | None,
    csv_file: Path | None,
    part: tuple[int, int],
    merge: bool,
    plot: Path | None,
    **given: Any,
) -> None:
    """Answer for many devices, people and controllers at once, as one table.

    Lists of values span a grid, distributions are drawn at each of its points.
    """
    from jaxstab.cli.study_report import report, require_few
    from jaxstab.scene.labelled import require_free, write
    from jaxstab.scene.study import merged, plan_study

    if output is None and (merge or part != (1, 1)):
        raise click.UsageError("--merge and --part are given without --output; give the file.")
    if merge and (over or part != (1, 1)):
        raise click.UsageError("--merge is given beside --over or --part; give one of them.")
    if not merge and len(given["files"]) > 1:
        raise click.UsageError("a study is for one scene; give one FILE, or --merge.")
    if output is not None:
        require_free(output)
    if merge:
        table = merged(given["files"])
        require_few(table.sizes, csv_file)
    else:
        ((_, scene),) = tables_of(given).items()
        keep_programs()
        planned = plan_study(
            scene, over, answers=given["answers"], samples=samples, seed=seed, part=part
        )
        require_few(planned.table.sizes, csv_file)
        for note in planned.notes:
            click.echo(f"jaxstab: {note}", err=True)
        with computing(given):
            table = planned.compute()
    if output is not None:
        write(table, output)
    report(table, csv_file, plot)
