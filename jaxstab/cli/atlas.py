"""The commands that specify, build, describe and verify atlases."""

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import jaxstab
from jaxstab.cli.options import at_work, executor_of, executor_options, file_option, keep_programs
from jaxstab.cli.scene import SceneCommand, scene_of, warn

if TYPE_CHECKING:
    from jaxstab.atlas import Atlas


@click.command()
@click.option("--spec", type=Path, help="TOML file; default: the haptic range of the paper.")
@file_option("-o", "--output", default=Path("atlas.h5"), show_default=True)
@executor_options
def build(spec: Path | None, output: Path, **where: Any) -> None:
    """Compute an atlas and write it as one HDF5 file.

    The file appears when it is whole. Ctrl-C ends the build at once and leaves nothing.
    """
    from jaxstab.atlas import AtlasSpec
    from jaxstab.atlas.build import write_atlas
    from jaxstab.atlas.spec import HAPTIC

    keep_programs()
    chosen = AtlasSpec.from_file(spec) if spec else HAPTIC
    with at_work(f"building {output}") as show, executor_of(where) as executor:
        write_atlas(chosen, output, show, executor)
    click.echo(_described(jaxstab.open_atlas(output), output))


@click.command(cls=SceneCommand, describes=False, wanted=["mass_tolerance", "delay_tolerance"])
@click.option("--scene", "file", type=Path, required=True, help="TOML file of the scene.")
def spec(file: Path, **tolerances: float | None) -> None:
    """Print the specification of an atlas for the device, hands and delays of a scene.

    Write it into a file for `jaxstab atlas build --spec`; the atlas has limits for the ranges of
    the scene, with its estimator: `jaxstab atlas query FILE --scene SCENE`.
    """
    from jaxstab.scene.atlas import spec_text

    scene = scene_of({"files": [file], **tolerances})
    warn(*scene.unusual())
    click.echo(spec_text(scene, str(file)), nl=False)


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
    """Check that an atlas is whole, and right at a random sample of points."""
    from jaxstab.atlas.build import verify_atlas

    keep_programs()
    passed = True
    for check in verify_atlas(file, sample):
        click.echo(check)
        passed = passed and check.passed
    sys.exit(0 if passed else 1)


def _described(opened: "Atlas", file: Path) -> str:
    """Return what an atlas holds, ending in a line to query it."""
    options = " ".join(f"--{name} {value:g}" for name, value in _example(opened).items())
    lines = [
        f"{file}: {file.stat().st_size / 1e6:.2f} MB",
        repr(opened),
        "",
        "Query it with",
        f"  jaxstab atlas query {shlex.quote(str(file))} {options}",
    ]
    return "\n".join(lines)


def _example(opened: "Atlas") -> dict[str, float]:
    """A wall in the middle of the stable ones of the first plant; of any, where none is known."""
    table = opened.table
    plant = {name: float(getattr(table, name)[0]) for name in ("gamma", "delta", "delay")}
    row = table.row.size // 2
    low, high = table.beta_limits[0, 0, 0]
    alpha = table.alpha_limits[0, 0, 0, row].mean()
    beta = low + table.row[row] * (high - low)
    wall = (
        {"alpha": float(alpha), "beta": float(beta)}
        if alpha == alpha
        else dict.fromkeys(("alpha", "beta"), 0.1)
    )
    return wall | plant
