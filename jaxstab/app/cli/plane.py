"""The commands in the plane of alpha and beta: one region, the figures of the paper, atlases."""

import json
import shlex
import sys
from decimal import ROUND_FLOOR, ROUND_HALF_EVEN
from math import isfinite
from pathlib import Path
from typing import Any

import click

import jaxstab
from jaxstab import atlas as atlases
from jaxstab.app import pictures
from jaxstab.app import scene as scenes
from jaxstab.app.cli.options import (
    PICTURES,
    at_work,
    draw,
    executor_options,
    file_option,
    keep_programs,
    print_with_csv,
    refuse,
    together,
    workers_in,
)
from jaxstab.app.cli.scene import scene_command, scene_of, wall_option, warn
from jaxstab.conventions import AXES, Verdict
from jaxstab.durable import named_errors, publish, require_no_output
from jaxstab.shown import number_text, table_text
from jaxstab.tables import columns_of


@click.command()
@click.option("--spec", type=Path, help="TOML file; default: the haptic range of the paper.")
@file_option("-o", "--output", default=Path("atlas.h5"), show_default=True)
@executor_options
def build(spec: Path | None, output: Path, **where: Any) -> None:
    """Compute an atlas and write it as one HDF5 file.

    The file appears when it is whole. Ctrl-C ends the build at once and leaves nothing.
    """
    keep_programs()
    chosen = jaxstab.AtlasSpec.from_file(spec) if spec else atlases.spec.HAPTIC
    with at_work(f"building {output}") as show, workers_in(where) as (pool, client):
        atlases.build.write_atlas(
            chosen, output, show, atlases.build.workers_of(client) if client else pool
        )
    click.echo(_described(jaxstab.open_atlas(output), output))


@scene_command("mass_tolerance", "delay_tolerance", describes=False)
@click.option("--scene", "file", type=Path, required=True, help="TOML file of the scene.")
def spec(file: Path, **tolerances: float | None) -> None:
    """Print the specification of an atlas for the device, hands and delays of a scene.

    Write it into a file for `jaxstab atlas build --spec`; the atlas has limits for the ranges of
    the scene, with its estimator: `jaxstab atlas query FILE --scene SCENE`.
    """
    scene = scene_of({"files": [file], **tolerances})
    warn(*scene.unusual())
    click.echo(scenes.exports.spec_text(scene, str(file)), nl=False)


@click.command()
@click.argument("file", type=Path)
def info(file: Path) -> None:
    """Print what an atlas holds, and a line to query it."""
    click.echo(_described(jaxstab.open_atlas(file), file))


@click.command()
@click.argument("file", type=Path)
@click.option(
    "--sample",
    type=click.IntRange(1, 1_000_000),
    default=1000,
    show_default=True,
    help="About how many limits and nodes to compute again.",
)
def verify(file: Path, sample: int) -> None:
    """Check that an atlas can be read, and is right at a random sample of points."""
    keep_programs()
    passed = True
    for check in atlases.build.verify_atlas(file, sample):
        click.echo(check)
        passed = passed and check.passed
    sys.exit(0 if passed else 1)


def _described(opened: "jaxstab.results.Atlas", file: Path) -> str:
    """The contents of an atlas, ending in a line to query it."""
    options = " ".join(f"--{name} {value:g}" for name, value in _example(opened).items())
    query = f"Query it with\n  jaxstab atlas query {shlex.quote(str(file))} {options}"
    return f"{file}: {file.stat().st_size / 1e6:.2f} MB\n{opened!r}\n\n{query}"


def _example(opened: "jaxstab.results.Atlas") -> dict[str, float]:
    """A wall in the middle of the stable ones of the first plant; of any, where none is known."""
    table = opened.table
    plant = {name: float(getattr(table, name)[0]) for name in ("gamma", "delta", "delay")}
    row = table.row.size // 2
    low, high = table.beta_limits[0, 0, 0]
    alpha = table.alpha_limits[0, 0, 0, row].mean()
    beta = low + table.row[row] * (high - low)
    wall = (alpha, beta) if isfinite(alpha) else (0.1, 0.1)
    return {"alpha": float(wall[0]), "beta": float(wall[1])} | plant


# The commands that ask an atlas and draw it.


@click.command()
@click.argument("file", type=Path)
@together(*(click.option(f"--{name}", type=float) for name in AXES))
@click.option(
    "--csv", "table", type=Path, help="CSV file of points ('-': stdin), columns in any order."
)
@click.option("--format", "form", type=click.Choice(["csv", "json"]), default="csv")
@click.option(
    "--scene",
    "scene_file",
    type=Path,
    help="Ask about the walls of a scene in SI units, at each corner of its ranges.",
)
@wall_option
def query(
    file: Path,
    table: Path | None,
    form: str,
    scene_file: Path | None,
    wall: tuple[tuple[str, float, float], ...],
    **point: float | None,
) -> int:
    """Ask an atlas about a point, about the points of a CSV file, or about a scene's walls.

    Where the table of the atlas is not clear, and outside of it, the verdict is computed. An option
    such as --gamma gives the value of a column that the CSV file does not have.

    The rows for a scene are of its walls with the hands, masses and delays at the corners of its
    ranges; of those between nothing is said. The exit code is 0 if every verdict is stable, 1 if
    not.
    """
    given = {name: value for name, value in point.items() if value is not None}
    if wall and scene_file is None:
        raise click.UsageError("--wall is given without a scene; give --scene FILE.")
    if scene_file is not None:
        words = "is given beside --scene, which has it; give one of them."
        refuse(given | {"csv": table}, words)
        opened, scene = jaxstab.open_atlas(file), scene_of({"files": [scene_file], "wall": wall})
        stated, rows = scenes.exports.ask_atlas(scene, opened)
    else:
        points = _points(table, given)
        opened = jaxstab.open_atlas(file)
        rows = _answered(points, opened.query(**points))
        words = opened.filters_in_words.removeprefix("velocity: ")
        velocity, _, position = words.partition("; position: ")
        filters = {"velocity": velocity, "position": position}
        if position == str(jaxstab.Filter()):
            del filters["position"]
        inputs = filters | {"created_by": opened.created_by}
        stated = {"inputs": inputs, "units": dict.fromkeys(AXES, "1")}
    _write(rows, form, stated)
    return 0 if all(row["verdict"] == "stable" for row in rows) else 1


@click.command()
@click.argument("file", type=Path)
@file_option("-o", "--output", endings=(".png",), required=True, help="PNG file to write.")
@click.option("--gamma", type=float, help="Physical stiffness; default: the smallest.")
@click.option("--delta", type=float, help="Physical damping; default: the smallest.")
@click.option(
    "--delay", type=float, multiple=True, help="May be repeated; default: some whole ones."
)
def plot(
    file: Path, output: Path, gamma: float | None, delta: float | None, delay: tuple[float, ...]
) -> None:
    """Draw verdicts and fields in the (alpha, beta) plane."""
    require_no_output(file)
    png = pictures.plane.draw_atlas(jaxstab.open_atlas(file), gamma, delta, delay)
    publish(png, output)
    click.echo(output)


def _points(table: Path | None, given: dict[str, float]) -> dict[str, list[float]]:
    """Return the points of a CSV file, with an option's value for a column that it lacks."""
    columns = columns_of(table, (), AXES) if table else {}
    for name in AXES:
        if name in columns and name in given:
            raise ValueError(f"{name} is a column of the file and an option; give one of them.")
        if name not in columns and name not in given:
            own = "as a column of the file, or an option"
            remedy = own if table else "as an option, or points with --csv"
            raise ValueError(f"{name} is missing; give it {remedy}.")
    count = max(map(len, columns.values()), default=1)
    return {name: columns[name] if name in columns else [given[name]] * count for name in AXES}


def _answered(
    points: dict[str, list[float]], answer: "jaxstab.results.AtlasAnswer"
) -> list[dict[str, Any]]:
    """A row of words and numbers for each point."""
    columns = dict[str, list[Any]](points)
    columns["verdict"] = [Verdict(code).name.lower() for code in answer.verdict.tolist()]
    columns["status"] = [
        jaxstab.results.QueryStatus(code).name.lower() for code in answer.status.tolist()
    ]
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _write(rows: list[dict[str, Any]], form: str, stated: dict[str, Any]) -> None:
    """Print rows as CSV, or as JSON with the units of what is in them."""
    header = [*(rows[0] if rows else (*AXES, "verdict", "status"))]
    if form == "csv":
        print_with_csv("", [header, *(row.values() for row in rows)], Path("-"))
        return
    used = {*stated["inputs"], *header}
    units = {name: unit for name, unit in stated["units"].items() if name in used}
    click.echo(json.dumps(stated | {"units": units, "points": rows}, indent=1))


# One region, and the figures of the paper.

_FIGURES = range(4, 11)


@click.command()
@click.argument("number", type=click.Choice([*map(str, _FIGURES), "all"]))
@click.option("-o", "--output", type=Path, default=Path(), help="Folder to write to; it is made.")
@click.option("--format", "form", type=click.Choice(["png", "svg"]), default="png")
def figure(number: str, output: Path, form: str) -> None:
    """Draw a figure of Hulin, Preusche, Hirzinger (2008): NUMBER is 4 ... 10, or all."""
    from jaxstab.drawing import picture

    if output.suffix in (".png", ".svg") or str(output) == "-":
        raise click.UsageError(f"{output} is not the name of a folder; give one to -o.")
    with named_errors("write to", output):
        output.mkdir(parents=True, exist_ok=True)
    for which in _FIGURES if number == "all" else [int(number)]:
        file = output / f"figure_{which}.{form}"
        publish(picture(pictures.plane.paper_figure(which), form), file)
        click.echo(file)


@click.command()
@click.option("--gamma", type=float, required=True, help="Physical stiffness k T^2/m.")
@click.option("--delta", type=float, required=True, help="Physical damping b T/m.")
@click.option("--delay", type=float, default=0.0, show_default=True, help="t_d/T in samples.")
@click.option(
    "--radius", type=float, default=1.0, show_default=True, help="Largest modulus of all roots."
)
@file_option("-o", "--output", endings=PICTURES, help="PNG or SVG file for a picture.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def region(
    gamma: float, delta: float, delay: float, radius: float, output: Path | None, as_json: bool
) -> None:
    """Measure the stable region in the (alpha, beta) plane, and draw it."""
    from jaxstab.paper.facts import region_facts

    with at_work(f"region of a loop with {delay:g} samples of delay"):
        facts = region_facts(gamma=gamma, delta=delta, delay=delay, radius=radius)
    if output:
        draw(pictures.plane.region_figure(gamma, delta, delay, radius), output)
    if as_json:
        inputs = {name: facts.pop(name) for name in ("gamma", "delta", "delay", "radius")}
        units = dict.fromkeys([*inputs, *(name for name in facts if facts[name] is not None)], "1")
        inputs = {"velocity": str(jaxstab.Velocity()), **inputs}
        stated = {"inputs": inputs, "units": units, **facts}
        click.echo(json.dumps(stated, indent=1, allow_nan=False))
    else:
        rows = [(name.replace("_", " "), _fact(name, value)) for name, value in facts.items()]
        click.echo(table_text(rows))


def _fact(name: str, value: Any) -> str:
    """A number, a point or a list of points."""
    from jaxstab.paper.facts import DIGITS, LARGEST

    if isinstance(value, list):
        return f"({', '.join(_fact(name, entry) for entry in value)})"
    way = ROUND_FLOOR if name in LARGEST else ROUND_HALF_EVEN
    return number_text(value, DIGITS, way) if isinstance(value, float) else "none"
