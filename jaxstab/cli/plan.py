"""The command that plans atlases: what a build would take, and which resolution a wish needs."""

import re
from pathlib import Path

import click

from jaxstab.cli.options import at_work, keep_programs, picture_file, spec_file, write_beside

_UNITS = {"": 1.0, "B": 1.0, "kB": 1e3, "MB": 1e6, "GB": 1e9}


def _bytes(_: click.Context, option: click.Parameter, text: str | None) -> float | None:
    """Return a number of bytes from a text such as 10MB."""
    if text is None:
        return None
    parts = re.fullmatch(r"([0-9.eE+-]*[0-9.]) ?([a-zA-Z]*)", text)
    try:
        return float(parts[1]) * _UNITS[parts[2]] if parts else float(text)
    except (KeyError, ValueError):
        raise click.BadParameter(
            f"{text!r} is no size; give one such as 500kB, 10MB or 2GB.", param=option
        ) from None


@click.command()
@click.argument("file", metavar="[SPEC]", type=Path, required=False)
@click.option("--spec", type=Path, help="TOML file, like SPEC; default: the range of the paper.")
@click.option(
    "--accuracy",
    type=float,
    help="Wish: error of 95 % of the limits of alpha, as a share of the largest alpha.",
)
@click.option("--decided", type=float, help="Wish: share of the range that is decided.")
@click.option("--size", callback=_bytes, help="Wish: largest size of the file, such as 10MB.")
@click.option("--time", type=float, help="Wish: most seconds of CPU for the build.")
@click.option(
    "-o",
    "--output",
    type=Path,
    callback=spec_file,
    help="TOML file to write, which meets the wish.",
)
@click.option(
    "--plot", type=Path, callback=picture_file, help="PNG or SVG file of the resolutions."
)
def plan(
    file: Path | None,
    spec: Path | None,
    output: Path | None,
    plot: Path | None,
    **wishes: float | None,
) -> None:
    """Print what a build would compute, why it need not compute the rest, and what it will take.

    With a wish, print instead what resolutions of the same range give and take, by samples, and
    write the specification that meets the wish: jaxstab atlas plan --spec mine.toml --accuracy
    0.01 -o mine-0.01.toml
    """
    from jaxstab.atlas import AtlasSpec, plan_atlas, plan_resolution
    from jaxstab.atlas.write.estimate import estimate_build

    if file and spec:
        raise click.UsageError("SPEC and --spec are given; give one of them.")
    given = {name: wish for name, wish in wishes.items() if wish is not None}
    if not given and (output or plot):
        raise click.UsageError("-o and --plot need a wish, such as --accuracy 0.01.")
    keep_programs()
    source = file or spec
    asked = AtlasSpec.from_file(source) if source else AtlasSpec()
    if not given:
        planned = plan_atlas(asked)
        click.echo(planned)
        click.echo(estimate_build(planned))
        return
    if len(given) > 1:
        raise click.UsageError(f"--{' and --'.join(given)} are given; give one wish.")
    with at_work("resolutions of the range"):
        resolutions = plan_resolution(asked, **given)
    click.echo(resolutions)
    if output:
        from jaxstab.durable import publish

        publish(resolutions.spec.to_toml().encode(), output)
        click.echo(f"\nBuild it with\n  jaxstab atlas build --spec {output}")
    if plot:
        from jaxstab.pictures.resolution import resolution_figure
        from jaxstab.pictures.style import picture

        write_beside(picture(resolution_figure(resolutions), plot.suffix[1:]), plot)
