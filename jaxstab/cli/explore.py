"""The command that writes a page to explore a scene in."""

from pathlib import Path

import click

from jaxstab.cli.options import page_file
from jaxstab.cli.scene import scene_of, warn


@click.command()
@click.argument("file", type=Path, required=False)
@click.option(
    "-o",
    "--output",
    type=Path,
    callback=page_file,
    default=Path("walls.html"),
    show_default=True,
    help="HTML file to write.",
)
def explore(file: Path | None, output: Path) -> None:
    """Write a page that draws the stable walls while sliders move device, hand and controller.

    It begins with the scene of FILE; without one, with an omega-like device and the velocity of its
    maker's software. The page is one file, and needs a browser, but no network.
    """
    from jaxstab.durable import publish
    from jaxstab.explore import explorer_page

    given = {"files": [file]} if file else _OMEGA
    scene = scene_of(given)
    warn(*scene.unusual())
    title = f"the scene {file.name}" if file else "an omega-like device at 1 kHz"
    page = explorer_page(scene, title)
    publish(page.encode(), output)
    click.echo(output)


_OMEGA = {
    "device": "omega",
    "sample_time": 0.001,
    "delay_samples": 1.0,
    "estimator": "force-dimension-sdk",
    "wall": [("chai3d", 5000.0, 30.0), ("soft", 1000.0, 15.0)],
}
