"""The command that writes a guard for C."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from jaxstab.cli.options import number_or_range, output_file, picture_file, write_beside
from jaxstab.cli.scene import scene_of, scene_options, warn
from jaxstab.shown import shortened


def _range(context: click.Context, option: click.Parameter, text: str | None) -> Any:
    ends = number_or_range(context, option, text)
    if ends is not None and (not isinstance(ends, list) or len(ends) != 2):
        raise click.BadParameter(f"{text!r} is no range; give LOW:HIGH.", param=option)
    return ends and tuple(ends)


def _cells(_: click.Context, option: click.Parameter, text: str | None) -> Any:
    if text is None:
        return None
    try:
        counts = tuple(int(part) for part in text.split(","))
    except ValueError:
        counts = ()
    if len(counts) != 3:
        raise click.BadParameter(f"{shortened(text)} is not MASS,DELAY,DAMPING.", param=option)
    return counts


@click.command()
@scene_options
@click.option(
    "-o",
    "--output",
    type=Path,
    required=True,
    callback=output_file,
    help="Header file; its name begins all names in it.",
)
@click.option(
    "--masses",
    callback=_range,
    help="LOW:HIGH in kg; default: 0.8 to 1.25 times the mass; 0.96 to 1.04 times that of a device "
    "with modes, an actuator or a grip.",
)
@click.option(
    "--delays",
    callback=_range,
    help="LOW:HIGH in s; default: one sample less and more; a tenth of one for such a device.",
)
@click.option(
    "--cells", callback=_cells, help="Cells along mass, delay and damping: powers of two."
)
@click.option("--plot", type=Path, callback=picture_file, help="PNG or SVG file of the limits.")
def guard(output: Path, plot: Path | None, as_json: bool, **given: Any) -> None:
    """Write a C header that clamps K and B to what is proved stable, for a running loop."""
    if len(given["files"]) > 1 or given["sweep"] or given["csv_file"] or as_json:
        raise click.UsageError("a guard is of one scene; give one FILE, no --sweep, --csv, --json.")
    scene = scene_of(given)
    warn(*scene.unusual())
    from jaxstab.durable import publish
    from jaxstab.guard.guard import checked_name
    from jaxstab.scene.guard import guard_about, guard_plan, header_of, scene_guard

    name = checked_name(output.stem)  # before the proof, which takes long
    cells = given["cells"]
    with _progress(guard_plan(scene, cells)) as show:
        made = scene_guard(scene, given["masses"], given["delays"], progress=show, cells=cells)
    publish(header_of(scene, made, name).encode(), output)
    if plot:
        from jaxstab.pictures.scene import guard_figure
        from jaxstab.pictures.style import picture

        write_beside(picture(guard_figure(made, scene.units), plot.suffix[1:]), plot)
    click.echo(f"{output}: {output.stat().st_size / 1e3:.0f} kB\n{guard_about(scene, made)}")


@contextmanager
def _progress(plan: str) -> Iterator[Callable[[float], None]]:
    """Yield a function that prints the plan when the work begins, and draws a bar on a terminal."""
    from rich.console import Console
    from rich.progress import Progress

    plans, console = [plan], Console(stderr=True)
    with Progress(console=console, transient=True, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task("proving", total=1.0)

        def show(share: float) -> None:
            if plans:
                click.echo(plans.pop(), err=True)
            bar.update(task, completed=share)

        yield show
