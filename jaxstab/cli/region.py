"""The commands around one region of the (alpha, beta) plane, and around the paper's figures."""

import json
from decimal import ROUND_FLOOR, ROUND_HALF_EVEN
from pathlib import Path
from typing import Any

import click

from jaxstab.cli.options import at_work, draw, file_option, picture_file

_FIGURES = range(4, 11)


@click.command()
@click.argument("number", type=click.Choice([*map(str, _FIGURES), "all"]))
@click.option("-o", "--output", type=Path, default=Path(), help="Folder to write to; it is made.")
@click.option("--format", "form", type=click.Choice(["png", "svg"]), default="png")
def figure(number: str, output: Path, form: str) -> None:
    """Draw a figure of Hulin, Preusche, Hirzinger (2008): NUMBER is 4 ... 10, or all."""
    from jaxstab.durable import named_errors, publish
    from jaxstab.pictures.paper import paper_figure
    from jaxstab.pictures.style import picture

    if output.suffix in (".png", ".svg"):
        raise click.UsageError(f"{output} is the name of a picture; give a folder to -o.")
    with named_errors("write to", output):
        output.mkdir(parents=True, exist_ok=True)
    for which in _FIGURES if number == "all" else [int(number)]:
        file = output / f"figure_{which}.{form}"
        publish(picture(paper_figure(which), form), file)
        click.echo(file)


@click.command()
@click.option("--gamma", type=float, required=True, help="Physical stiffness k T^2/m.")
@click.option("--delta", type=float, required=True, help="Physical damping b T/m.")
@click.option("--delay", type=float, default=0.0, show_default=True, help="t_d/T in samples.")
@click.option(
    "--radius", type=float, default=1.0, show_default=True, help="Largest modulus of all roots."
)
@file_option("-o", "--output", check=picture_file, help="PNG or SVG file for a picture.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def region(
    gamma: float, delta: float, delay: float, radius: float, output: Path | None, as_json: bool
) -> None:
    """Measure the stable region in the (alpha, beta) plane, and draw it."""
    from jaxstab.model import Velocity
    from jaxstab.paper.facts import region_facts

    with at_work(f"region of a loop with {delay:g} samples of delay"):
        facts = region_facts(gamma=gamma, delta=delta, delay=delay, radius=radius)
    if output:
        from jaxstab.pictures.paper import region_figure

        draw(region_figure(gamma, delta, delay, radius), output)
    if as_json:
        inputs = {name: facts.pop(name) for name in ("gamma", "delta", "delay", "radius")}
        units = dict.fromkeys([*inputs, *(name for name in facts if facts[name] is not None)], "1")
        inputs = {"velocity": str(Velocity()), **inputs}
        stated = {"inputs": inputs, "units": units, **facts}
        click.echo(json.dumps(stated, indent=1, allow_nan=False))
    else:
        width = max(map(len, facts))
        for name, value in facts.items():
            click.echo(f"{name.replace('_', ' '):{width}}  {_words(name, value)}")


def _words(name: str, value: Any) -> str:
    """A number, a point or a list of points; the largest values are not rounded up."""
    from jaxstab.paper.facts import DIGITS
    from jaxstab.scene.answers import Quantity

    if isinstance(value, list):
        return f"({', '.join(_words(name, entry) for entry in value)})"
    is_largest = name.startswith("largest")
    quantity = Quantity("", DIGITS, ROUND_FLOOR if is_largest else ROUND_HALF_EVEN)
    return quantity.words(value) if isinstance(value, float) else "none"
