"""The commands around a scene: what it allows, how its walls do, the best walls, the design."""

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jaxstab.cli.many import answer_many
from jaxstab.cli.options import at_work, output_file, picture_file, write_beside
from jaxstab.cli.scene_options import refused, scene_of, scene_options, warn

if TYPE_CHECKING:
    from jaxstab.scene import Answer, Scene


class _FileOrCommand(click.Group):
    """A group whose first argument may also be a file, for the command ``answer``."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Put the name of the command in front where it is left out."""
        if args and args[0] not in {*self.commands, "--help"}:
            args.insert(0, "answer")
        return super().parse_args(ctx, args)


_plot_option = click.option(
    "--plot", type=Path, callback=picture_file, help="PNG or SVG file to draw the scene into."
)
_safety_option = click.option(
    "--safety", type=float, help="Multiply all limits by this, such as 0.8."
)


@click.command()
@scene_options
@_plot_option
@_safety_option
@click.option("--at-damping", type=float, help="Give the stiffness limits at this B in N s/m.")
@click.option("--at-stiffness", type=float, help="Give the damping limits at this K in N/m.")
def limits(as_json: bool, **given: Any) -> int:
    """Give the largest stiffness and damping that a scene allows.

    The exit code is 0 if walls are stable, for all hands of the scene by proof, 1 if not.
    """
    return _answer(given, "limits", as_json)


@click.command()
@scene_options
@_plot_option
def check(as_json: bool, **given: Any) -> int:
    """Check each wall: stable or not, its margins, how fast it settles.

    The exit code is 0 if every wall is proved stable, 1 if not.
    """
    return _answer(given, "check", as_json)


@click.command()
@scene_options
@_plot_option
@click.option("--at-stiffness", type=float, help="Give the best B at this K in N/m.")
@click.option("--mass-tolerance", type=float, help="Of the device; 0.1 means 10 % up and down.")
@click.option("--delay-tolerance", type=float, help="Of the delay up and down, in s.")
def tune(as_json: bool, **given: Any) -> int:
    """Find the walls that come to rest fastest, and the best damping for each wall.

    The exit code is 0 if every wall is found and proved stable, 1 if not; over ranges none is
    proved.
    """
    return _answer(given, "tune", as_json)


@click.command()
@scene_options
@_plot_option
@_safety_option
@click.option("--stiffness", type=float, help="The stiffness to design for, in N/m.")
def design(as_json: bool, **given: Any) -> int:
    """Find the largest sample time, and the largest delay, for a wanted stiffness.

    The exit code is 0 if both are found, 1 if not.
    """
    return _answer(given, "design", as_json)


@click.group(cls=_FileOrCommand)
def scene() -> None:
    """Write an example of a scene (init), or answer what a scene FILE wants.

    With FILE: --explain prints the model, what is computed, what is skipped and why; --json prints
    JSON; --plot draws a picture into a PNG or SVG file. presets lists devices and software.
    """


@scene.command()
@click.option(
    "-o",
    "--output",
    type=Path,
    callback=output_file,
    help="File to write, which must not exist; default: print it.",
)
def init(output: Path | None) -> None:
    """Write a commented example of a scene."""
    from jaxstab.durable import publish
    from jaxstab.scene import EXAMPLE

    if output is None or str(output) == "-":
        click.echo(EXAMPLE, nl=False)
        return
    if os.path.lexists(output):
        raise click.UsageError(f"{output} exists; remove it, or give another name.")
    publish(EXAMPLE.encode(), output)
    click.echo(output)


@scene.command()
def presets() -> None:
    """List devices and velocity estimators by name: their numbers, and where these are from."""
    from jaxstab.scene.presets import device_presets, software_presets

    for heading, known in (
        ("[device] preset =", device_presets()),
        ("[controller.velocity] preset =", software_presets()),
    ):
        for name, preset in known.items():
            title, *lines = preset.lines()
            click.echo("\n".join([f'{heading} "{name}"', f"  {title}", *lines, ""]))


@scene.command(hidden=True)
@click.argument("file", type=Path)
@click.option(
    "--explain",
    is_flag=True,
    help="Print the model, what is computed and what is skipped, and why.",
)
@_plot_option
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def answer(file: Path, explain: bool, plot: Path | None, as_json: bool) -> int:
    """Answer what a scene FILE wants.

    The exit code is 1 if it would be that of the command for one of the answers.
    """
    from jaxstab.scene import Answers, basis_of, explain_model, plan_scene

    scene = scene_of({"files": [file]})
    if explain:
        warn(*scene.unusual())
        click.echo(f"{explain_model(scene)}\n")
        for step in plan_scene(scene):
            click.echo(f"{'compute' if step.computed else 'skip':8}{step.what:36}{step.why}")
        return 0
    computed = {name: _computed(scene, name) for name in scene.wanted.answers}
    by_name = {name: replace(one, inputs=None) for name, one in computed.items()}
    answers = Answers(basis_of(scene), by_name)
    if plot:
        _draw(scene, computed.get("check") or [*computed.values()][-1], plot)
    _print(scene, answers, as_json)
    return 0 if all(one.all_stable for one in computed.values()) else 1


# --------------------------------------------------------------------------- from options to scene


def _answer(given: dict[str, Any], name: str, as_json: bool) -> int:
    """Answer one scene or many, and return the exit code."""
    if len(given["files"]) > 1 or given["sweep"] or given["csv_file"]:
        answers = answer_many(given, FUNCTIONS[name], as_json)
        return 0 if all(one.all_stable for one in answers) else 1
    scene, plot = scene_of(given), given.get("plot")
    answer = _computed(scene, name)
    if plot:
        _draw(scene, answer, plot)
    _print(scene, answer, as_json)
    return 0 if answer.all_stable else 1


def _draw(scene: "Scene", answer: Any, file: Path) -> None:
    from jaxstab.pictures.scene import scene_figure
    from jaxstab.pictures.style import picture

    with refused():
        write_beside(picture(scene_figure(scene, answer), file.suffix[1:]), file)


FUNCTIONS = {
    "limits": "scene_limits",
    "check": "check_walls",
    "tune": "tune_walls",
    "design": "design_loop",
}


def _computed(scene: "Scene", name: str) -> Any:
    import jaxstab.scene

    with (
        refused(),
        at_work(f"{name} of a loop with {scene.controller.samples:g} samples of delay"),
    ):
        return getattr(jaxstab.scene, FUNCTIONS[name])(scene)


# ------------------------------------------------------------------------------------------- print


def _print(scene: "Scene", answer: "Answer", as_json: bool) -> None:
    warn(*scene.unusual())
    click.echo(json.dumps(answer.as_json(), indent=1) if as_json else answer)
