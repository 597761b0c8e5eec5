"""The commands that specify, plan, build, describe and verify atlases."""

import re
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import jaxstab
from jaxstab.cli.options import (
    at_work,
    executor_of,
    executor_options,
    file_in,
    file_option,
    keep_programs,
    resumable,
)
from jaxstab.cli.scene import scene_of, warn
from jaxstab.conventions import Verdict

if TYPE_CHECKING:
    from jaxstab.atlas import Atlas

_MOST_DESCRIBED = 2**24  # nodes that are loaded after a build
_MOST_ASKED = 128  # nodes along alpha and beta


@click.command()
@click.option("--spec", type=Path, help="TOML file; default: the haptic range of the paper.")
@file_option("-o", "--output", default=Path("atlas.h5"), show_default=True)
@executor_options
def build(spec: Path | None, output: Path, **where: Any) -> None:
    """Compute an atlas and write it as one HDF5 file.

    An interrupted build continues where it stopped when the command is repeated.
    """
    from jaxstab.atlas import AtlasSpec
    from jaxstab.atlas.file import node_count
    from jaxstab.atlas.write.build import write_atlas

    keep_programs()
    chosen = AtlasSpec.from_file(spec) if spec else AtlasSpec()
    with resumable(output) as show, executor_of(where) as executor:
        write_atlas(chosen, output, show, executor)
    if node_count(output) <= _MOST_DESCRIBED:
        click.echo(_described(jaxstab.open_atlas(output), output))
    else:
        click.echo(
            f"{output}: {output.stat().st_size / 1e6:.2f} MB; jaxstab atlas info loads it to say "
            "what it holds."
        )


@click.command()
@click.option("--scene", "file", type=Path, required=True, help="TOML file of the scene.")
@click.option("--mass-tolerance", type=float, help="Of the device; 0.1 means 10 % up and down.")
@click.option("--delay-tolerance", type=float, help="Of the delay up and down, in s.")
def spec(file: Path, **tolerances: float | None) -> None:
    """Print the specification of an atlas for the device, hands and delays of a scene.

    Write it into a file for `jaxstab atlas build --spec`; the atlas answers for the ranges of the
    scene, with its estimator: `jaxstab atlas query FILE --scene SCENE`.
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
    help="About how many points of each kind to compute again.",
)
def verify(file: Path, sample: int) -> None:
    """Check that an atlas is whole, and right at a random sample of points."""
    from jaxstab.atlas.write.build import verify_atlas

    keep_programs()
    passed = True
    for check in verify_atlas(file, sample):
        click.echo(check)
        passed = passed and check.passed
    sys.exit(0 if passed else 1)


def _described(opened: "Atlas", file: Path) -> str:
    """Return what an atlas holds, ending in a line to query it."""
    from jaxstab.atlas.products.table import PRODUCTS

    attributes = {name: PRODUCTS[name].attributes(opened.arrays) for name in opened.products}
    shape = {name: nodes.size for name, nodes in opened.nodes(0).items()}
    lines = [
        f"{file}: {file.stat().st_size / 1e6:.2f} MB, made by {opened.created_by}",
        f"products: {', '.join(opened.products)}",
        *(f"{name}: {about[name]}" for name, about in attributes.items() if name in about),
        opened.filters_in_words,
        *(
            f"{name}: {shape[name]} nodes from {nodes[0]:g} to {nodes[-1]:g}"
            for name, nodes in list(opened.nodes(0).items())[2:]
        ),
        "",
        f"delay   alpha ({shape['alpha']} nodes)      beta ({shape['beta']} nodes)       "
        "decided between nodes",
    ]
    for index, delay in enumerate(opened.delays):
        spans = [f"{n[0]:9.3g} to {n[-1]:<8.3g}" for n in list(opened.nodes(index).values())[:2]]
        decided = f"{100.0 * opened.decided_fraction(index):.4g} %"
        lines.append(f"{delay:<5g} {spans[0]} {spans[1]}   {decided}")
    options = " ".join(f"--{name} {value:g}" for name, value in _example(opened).items())
    lines += ["", "Query it with", f"  jaxstab atlas query {shlex.quote(str(file))} {options}"]
    return "\n".join(lines)


def _example(opened: "Atlas") -> dict[str, float]:
    """A point in the middle of the stable part of the first delay's box."""
    nodes, delay = opened.nodes(0), float(opened.delays[0])
    point = {name: float(axis[axis.size // 2]) for name, axis in nodes.items()}
    alpha, beta = (
        nodes[name][:: -(-nodes[name].size // _MOST_ASKED)] for name in ("alpha", "beta")
    )
    gamma, delta = point["gamma"], point["delta"]
    codes = opened.verdict(alpha[:, None], beta, gamma=gamma, delta=delta, delay=delay)
    i, j = (codes == Verdict.STABLE).nonzero()
    if i.size:
        centre = i.size // 2
        point |= {"alpha": float(alpha[i[centre]]), "beta": float(beta[j[centre]])}
    return point | {"delay": delay}


_UNITS = {"": 1.0, "B": 1.0, "kB": 1e3, "MB": 1e6, "GB": 1e9}


def _bytes(_: click.Context, option: click.Parameter, text: str | None) -> float | None:
    if text is None:
        return None
    parts = re.fullmatch(r"([0-9.eE+-]*[0-9.]) ?([a-zA-Z]*)", text)
    try:
        return float(parts[1]) * _UNITS[parts[2]] if parts else float(text)
    except (KeyError, ValueError):
        raise click.BadParameter(
            f"invalid size {text!r}; give one such as 500kB, 10MB or 2GB.", param=option
        ) from None


@click.command()
@click.argument("spec", type=Path, required=False)
@click.option(
    "--accuracy",
    type=float,
    help="Wish: error of 95 % of the limits of alpha, as a share of the largest alpha.",
)
@click.option("--size", callback=_bytes, help="Wish: largest size of the file, such as 10MB.")
@file_option(
    "-o", "--output", check=file_in(".toml"), help="TOML file to write, which meets the wish."
)
def plan(spec: Path | None, output: Path | None, **wishes: float | None) -> None:
    """Print what a build of SPEC, or of the range of the paper, would compute, and what it takes.

    With a wish, print instead the error and the cost of the resolution that meets it, by samples,
    and write its specification: jaxstab atlas plan mine.toml --accuracy 0.01 -o finer.toml
    """
    from jaxstab.atlas import AtlasSpec, plan_atlas, plan_resolution
    from jaxstab.atlas.write.resolution import estimate_build

    given = {name: wish for name, wish in wishes.items() if wish is not None}
    if not given and output:
        raise click.UsageError("-o needs a target, such as --accuracy 0.01.")
    keep_programs()
    given_spec = AtlasSpec.from_file(spec) if spec else AtlasSpec()
    if not given:
        planned = plan_atlas(given_spec)
        click.echo(planned)
        click.echo(estimate_build(planned))
        return
    if len(given) > 1:
        raise click.UsageError(f"--{' and --'.join(given)} are given; give only one.")
    with at_work("resolutions of the range"):
        resolutions = plan_resolution(given_spec, **given)
    click.echo(resolutions)
    if output:
        from jaxstab.durable import publish

        publish(resolutions.spec.to_toml().encode(), output)
        click.echo(f"\nBuild it with\n  jaxstab atlas build --spec {output}")
