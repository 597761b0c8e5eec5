"""The command that identifies a device: a scene from a log of forces and positions."""

from pathlib import Path

import click

from jaxstab.cli.options import draw, file_option, keep_programs, plot_option, together
from jaxstab.cli.scene import warn

_NAMES = ("time", "force", "position", "velocity")

_columns = together(
    *(
        click.option(
            f"--{name}", metavar="COLUMN", help=f'Column of the {name}; default: "{name}".'
        )
        for name in _NAMES
    )
)


@click.command()
@click.argument("log", type=Path)
@file_option("-o", "--output", help="Scene (TOML) to write; '-': stdout.")
@_columns
@click.option("--sample-time", type=float, help="Sampling period in s, in place of a time column.")
@click.option("--turns", is_flag=True, help="Rotary device: rad and N m in place of m and N.")
@click.option(
    "--spring", is_flag=True, help="Also fit a spring of the device, such as a centring spring."
)
@plot_option("PNG or SVG file: measured against fitted.")
def identify(
    log: Path,
    output: Path | None,
    sample_time: float | None,
    turns: bool,
    spring: bool,
    plot: Path | None,
    **columns: str | None,
) -> None:
    """Fit mass, damping, friction and delay to a LOG, with 95 % confidence intervals.

    The log is a CSV file with a header and a row for each sample: time in s, commanded force in N,
    position in m, and, if logged, the velocity of the software. docs/identify.md says how to
    record one.
    """
    from jaxstab.durable import publish
    from jaxstab.scene.identify import identified_scene, identified_text, read_log
    from jaxstab.scene.identify import identify as fit
    from jaxstab.scene.scene import Scene, Units
    from jaxstab.tables import parsed

    keep_programs()
    names = {name: columns[name] or name for name in _NAMES}
    given = read_log(str(log), names, sample_time, columns["velocity"] is not None)
    device = fit(**given, spring=spring)
    units = Units.ROTATION if turns else Units.LINE
    scene = identified_scene(device, units, log.name)
    warn(*filter(None, [device.warning]), *Scene.from_table(parsed(scene)).unusual())
    if plot:
        from jaxstab.pictures.scene import identified_figure

        draw(identified_figure(device, units), plot)
    if str(output) == "-":
        click.echo(scene, nl=False)
        return
    if output:
        publish(scene.encode(), output)
    click.echo(identified_text(device, units))
