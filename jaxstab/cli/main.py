"""The command line. JAX, matplotlib and rich are imported inside the commands that need them."""

import csv
import json
import math
import sys
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import jaxstab
from jaxstab.cli import atlas as atlas_commands
from jaxstab.cli import scene as commands
from jaxstab.conventions import AXES, Verdict

if TYPE_CHECKING:
    from jaxstab.atlas import AtlasAnswer

_ANSWER = ("verdict", "spectral_radius", "radius_error", "status")


class OneSentence(click.Group):
    """Commands whose every failure is one sentence on stderr and a non-zero exit code."""

    def main(self, *args: Any, standalone_mode: bool = True, **extra: Any) -> Any:
        """Run a command; see click.Command.main."""
        run = partial(super().main, *args, standalone_mode=False, **extra)
        if not standalone_mode:
            return run()
        try:
            code: object = run()
        except click.ClickException as error:
            words = error.format_message()
            click.echo(words if words.startswith("Usage:") else f"jaxstab: {words}", err=True)
            sys.exit(error.exit_code)
        except click.Abort:
            click.echo("jaxstab: interrupted; nothing was written.", err=True)
            sys.exit(130)
        except BrokenPipeError:  # the reader of our output has enough
            sys.stderr.close()
            sys.exit(1)
        except OSError as error:
            named = f"{error.filename}: {error.strerror}." if error.filename else error.strerror
            click.echo(f"jaxstab: {named or error}", err=True)
            sys.exit(1)
        except (ValueError, TypeError, RuntimeError, MemoryError) as error:
            click.echo(f"jaxstab: {str(error) or 'there is not enough memory.'}", err=True)
            sys.exit(1)
        sys.exit(code if isinstance(code, int) else 0)


@click.group(cls=OneSentence)
@click.version_option(jaxstab.__version__, prog_name="jaxstab")
def main() -> None:
    """Stability of haptic rendering loops."""


for _command in (commands.limits, commands.check, commands.tune, commands.design, commands.scene):
    main.add_command(_command)


@main.group()
def atlas() -> None:
    """Plan, build, inspect, verify, ask and plot atlases: stability over a grid, in one file."""


for _command in (
    atlas_commands.build,
    atlas_commands.plan,
    atlas_commands.info,
    atlas_commands.verify,
):
    atlas.add_command(_command)


def _axis_options(command: Any) -> Any:
    for name in reversed(AXES):
        command = click.option(f"--{name}", type=float)(command)
    return command


@atlas.command()
@click.argument("file", type=Path)
@_axis_options
@click.option(
    "--csv", "table", type=Path, help="CSV file of points ('-': stdin), columns in any order."
)
@click.option("--format", "form", type=click.Choice(["csv", "json"]), default="csv")
@click.option(
    "--outside",
    type=click.Choice(["error", "undecided"]),
    default="error",
    help="Refuse points outside of the atlas, or answer that they are undecided.",
)
@click.option("--exact", is_flag=True, help="Compute the verdicts that the atlas leaves open.")
def query(
    file: Path,
    table: Path | None,
    form: str,
    outside: Any,
    exact: bool,
    **point: float | None,
) -> None:
    """Ask an atlas about a point, or about the points of a CSV file.

    An option such as --gamma gives the value of a column that the CSV file does not have.
    """
    if exact:
        import jax

        jax.config.update("jax_enable_x64", True)
    given = {name: value for name, value in point.items() if value is not None}
    points = _read_points(table, given) if table else _one_point(given)
    alpha, beta, gamma, delta, delay = (points[name] for name in AXES)
    answer = jaxstab.open_atlas(file).query(alpha, beta, gamma, delta, delay, outside, exact=exact)
    rows = _answered(points, answer)
    if form == "csv":
        writer = csv.writer(sys.stdout, lineterminator="\n")
        writer.writerow((*AXES, *_ANSWER))
        writer.writerows(row.values() for row in rows)
    else:
        click.echo(json.dumps([_finite(row) for row in rows], indent=1))


@atlas.command()
@click.argument("file", type=Path)
@click.option("-o", "--output", type=Path, required=True, help="PNG file to write.")
@click.option("--gamma", type=float, help="Physical stiffness; without, the smallest.")
@click.option("--delta", type=float, help="Physical damping; without, the smallest.")
@click.option("--delay", type=float, multiple=True, help="May be repeated; without, all.")
def plot(
    file: Path, output: Path, gamma: float | None, delta: float | None, delay: tuple[float, ...]
) -> None:
    """Draw verdict and spectral radius in the (alpha, beta) plane."""
    from jaxstab.durable import publish
    from jaxstab.pictures.atlas import draw_atlas

    opened = jaxstab.open_atlas(file)
    lowest = {name: float(nodes[0]) for name, nodes in opened.nodes(0).items()}
    png = draw_atlas(
        opened,
        lowest["gamma"] if gamma is None else gamma,
        lowest["delta"] if delta is None else delta,
        delay or None,
    )
    publish(png, output)


@main.command()
@click.argument("number", type=click.Choice([*map(str, range(4, 11)), "all"]))
@click.option("-o", "--output", type=Path, default=Path(), help="Folder to write to.")
@click.option("--format", "form", type=click.Choice(["png", "svg"]), default="png")
def figure(number: str, output: Path, form: str) -> None:
    """Draw a figure of Hulin, Preusche, Hirzinger (2008): NUMBER is 4 ... 10, or all."""
    import jax

    from jaxstab.durable import publish
    from jaxstab.pictures.paper import FIGURES, paper_figure, picture

    jax.config.update("jax_enable_x64", True)
    for one in FIGURES if number == "all" else [int(number)]:
        file = output / f"figure_{one}.{form}"
        publish(picture(paper_figure(one), form), file)
        click.echo(file)


@main.command()
@click.option("--gamma", type=float, required=True, help="Physical stiffness k T^2/m.")
@click.option("--delta", type=float, required=True, help="Physical damping b T/m.")
@click.option("--delay", type=float, default=0.0, show_default=True, help="t_d/T in samples.")
@click.option("--radius", type=float, default=1.0, show_default=True, help="Of all roots.")
@click.option("-o", "--output", type=Path, help="PNG or SVG file to draw the region into.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def region(
    gamma: float, delta: float, delay: float, radius: float, output: Path | None, as_json: bool
) -> None:
    """Measure the stable region in the (alpha, beta) plane, and draw it."""
    import jax

    from jaxstab.criteria import region_facts

    jax.config.update("jax_enable_x64", True)
    facts = region_facts(gamma, delta, delay, radius)
    if output:
        from jaxstab.durable import publish
        from jaxstab.pictures.paper import picture, region_figure

        publish(picture(region_figure(gamma, delta, delay, radius), output.suffix[1:]), output)
    if as_json:
        click.echo(json.dumps(facts, indent=1, allow_nan=False))
    else:
        width = max(map(len, facts))
        for name, value in facts.items():
            click.echo(f"{name.replace('_', ' '):{width}}  {_in_words(value)}")


def _in_words(value: Any) -> str:
    if isinstance(value, list):
        return "(" + ", ".join(_in_words(part) for part in value) + ")"
    return f"{value:.10g}" if isinstance(value, float) else "none" if value is None else str(value)


# ------------------------------------------------------------------------------------------- points


def _one_point(given: dict[str, float]) -> dict[str, list[float]]:
    _check_complete(given, "give it as an option, or points with --csv")
    return {name: [given[name]] for name in AXES}


def _read_points(table: Path, given: dict[str, float]) -> dict[str, list[float]]:
    """Return the columns of a CSV file, and those that the options fill in."""
    if str(table) == "-":
        return _parsed(sys.stdin, "stdin", given)
    try:
        with table.open(encoding="utf-8-sig", newline="") as stream:
            return _parsed(stream, str(table), given)
    except OSError as error:
        raise OSError(error.errno, f"cannot read {table}: {error.strerror}.") from error


def _parsed(stream: Iterable[str], source: str, given: dict[str, float]) -> dict[str, list[float]]:
    lines = csv.reader(stream)
    header = [name.strip() for name in next(lines, [])]
    columns = {name: header.index(name) for name in AXES if name in header}
    both = sorted(columns.keys() & given.keys())
    if both:
        raise ValueError(f"{both[0]} is a column of {source} and an option; give one of them.")
    _check_complete(columns.keys() | given.keys(), f"{source} has the columns {', '.join(header)}")
    points: dict[str, list[float]] = {name: [] for name in AXES}
    for row in lines:
        if row:
            where = f"line {lines.line_num} of {source}"
            for name in AXES:
                value = _cell(row, columns[name], name, where) if name in columns else given[name]
                points[name].append(value)
    return points


def _cell(row: list[str], column: int, name: str, where: str) -> float:
    text = row[column] if column < len(row) else ""
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{name} is {text!r} in {where}; give a number.") from None


def _check_complete(known: Iterable[str], remedy: str) -> None:
    missing = [name for name in AXES if name not in known]
    if missing:
        raise ValueError(f"{missing[0]} is missing; {remedy}.")


def _answered(
    points: dict[str, list[float]], answer: "AtlasAnswer"
) -> Iterator[dict[str, float | str]]:
    """Yield a row of words and numbers for each point."""
    from jaxstab.atlas import QueryStatus

    columns = (*points.values(), *(getattr(answer, name).tolist() for name in _ANSWER))
    for *numbers, verdict, radius, error, status in zip(*columns, strict=True):
        words = {
            "verdict": Verdict(verdict).name.lower(),
            "spectral_radius": radius,
            "radius_error": error,
            "status": QueryStatus(status).name.lower(),
        }
        yield dict(zip(AXES, numbers, strict=True)) | words


def _finite(row: dict[str, float | str]) -> dict[str, float | str | None]:
    """Return a row for JSON, which has no NaN and no infinity."""
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in row.items()
    }
