"""The commands around a scene: what it allows, how its walls do, the best walls, the design."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jaxstab.cli.options import at_work, number_or_range, picture_file

if TYPE_CHECKING:
    from jaxstab.scene import Answer, Check, Scene


class _FileOrCommand(click.Group):
    """A group whose first argument may also be a file, for the command ``answer``."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Put the name of the command in front where it is left out."""
        if args and args[0] not in {*self.commands, "--help"}:
            args.insert(0, "answer")
        return super().parse_args(ctx, args)


def scene_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add what describes a scene: a file, options that go before it, and the form of the answer."""
    decorations = (
        click.argument("file", type=Path, required=False),
        click.option("--device", help="A device by name; jaxstab scene presets lists them."),
        click.option("--mass", type=float, help="Of the device, in kg."),
        click.option("--inertia", type=float, help="In place of the mass, in kg m^2: it turns."),
        click.option("--damping", type=float, help="Of the device, in N s/m (N m s/rad)."),
        click.option("--hand-mass", callback=number_or_range, help="In kg; LOW:HIGH for a range."),
        click.option(
            "--hand-inertia", callback=number_or_range, help="In kg m^2; LOW:HIGH for a range."
        ),
        click.option(
            "--hand-stiffness", callback=number_or_range, help="In N/m; LOW:HIGH for a range."
        ),
        click.option(
            "--hand-damping", callback=number_or_range, help="In N s/m; LOW:HIGH for a range."
        ),
        click.option("--sample-time", type=float, help="T in s."),
        click.option("--delay", type=float, help="Time delay of the loop in s."),
        click.option("--delay-samples", type=float, help="The same in samples."),
        click.option("--window", type=float, help="Velocity: difference over so many s."),
        click.option("--window-samples", type=int, help="The same in samples."),
        click.option("--cutoff", type=float, help="Velocity: behind a low pass at so many Hz."),
        click.option(
            "--estimator",
            help="Velocity as a software estimates it; jaxstab scene presets lists them.",
        ),
        click.option(
            "--wall",
            type=(str, float, float),
            multiple=True,
            metavar="NAME K B",
            help="A wall: its name, N/m and N s/m; may be repeated.",
        ),
        click.option("--json", "as_json", is_flag=True, help="Print JSON."),
    )
    for decoration in reversed(decorations):
        command = decoration(command)
    return command


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
def limits(as_json: bool, **given: Any) -> None:
    """Give the largest stiffness and damping that a scene allows."""
    _answer(given, "limits", as_json)


@click.command()
@scene_options
@_plot_option
def check(as_json: bool, **given: Any) -> int:
    """Check each wall: stable or not, its margins, how fast it settles.

    The exit code is 0 if every wall is proved stable, 1 if not.
    """
    checked: Check = _answer(given, "check", as_json)
    return 0 if checked.all_stable else 1


@click.command()
@scene_options
@_plot_option
@click.option("--at-stiffness", type=float, help="Give the best B at this K in N/m.")
def tune(as_json: bool, **given: Any) -> None:
    """Find the walls that come to rest fastest, and the best damping for each wall."""
    _answer(given, "tune", as_json)


@click.command()
@scene_options
@_plot_option
@_safety_option
@click.option("--stiffness", type=float, help="The stiffness to design for, in N/m.")
def design(as_json: bool, **given: Any) -> None:
    """Find the largest sample time, and the largest delay, for a wanted stiffness."""
    _answer(given, "design", as_json)


@click.group(cls=_FileOrCommand)
def scene() -> None:
    """Write an example of a scene (init), or answer what a scene FILE wants.

    With FILE: --explain prints the model, what is computed, what is skipped and why; --json prints
    JSON; --plot draws a picture into a PNG or SVG file. presets lists devices and software.
    """


@scene.command()
@click.option("-o", "--output", type=Path, help="File to write; without, print it.")
def init(output: Path | None) -> None:
    """Write a commented example of a scene."""
    from jaxstab.scene import EXAMPLE

    if output is None:
        click.echo(EXAMPLE, nl=False)
        return
    try:
        with output.open("x", encoding="utf-8") as stream:
            stream.write(EXAMPLE)
    except OSError as error:
        raise click.UsageError(f"cannot write {output}: {error.strerror}.") from error


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
def answer(file: Path, explain: bool, plot: Path | None, as_json: bool) -> None:
    """Answer what a scene FILE wants."""
    from jaxstab.scene import Answers, basis_of, explain_model, plan_scene

    scene = _scene({"file": file})
    if explain:
        _warn(scene)
        click.echo(f"{explain_model(scene)}\n")
        for step in plan_scene(scene):
            click.echo(f"{'compute' if step.computed else 'skip':8}{step.what:36}{step.why}")
        return
    computed = {name: _computed(scene, name) for name in scene.wanted.answers}
    by_name = {name: replace(one, basis=None) for name, one in computed.items()}
    answers = Answers(basis_of(scene), by_name)
    if plot:
        _draw(scene, computed.get("check"), plot)
    _print(scene, answers, as_json)


# --------------------------------------------------------------------------- from options to scene


def _answer(given: dict[str, Any], name: str, as_json: bool) -> Any:
    scene, plot = _scene(given), given.get("plot")
    answer = _computed(scene, name)
    if plot:
        _draw(scene, answer if name == "check" else None, plot)
    _print(scene, answer, as_json)
    return answer


def _draw(scene: "Scene", checked: Any, file: Path) -> None:
    from jaxstab.durable import publish
    from jaxstab.pictures.scene import scene_figure
    from jaxstab.pictures.style import picture

    with _refused():
        publish(picture(scene_figure(scene, checked), file.suffix[1:]), file)


_FUNCTIONS = {
    "limits": "scene_limits",
    "check": "check_walls",
    "tune": "tune_walls",
    "design": "design_loop",
}


def _computed(scene: "Scene", name: str) -> Any:
    import jaxstab.scene

    with (
        _refused(),
        at_work(f"{name} of a loop with {scene.controller.samples:g} samples of delay"),
    ):
        return getattr(jaxstab.scene, _FUNCTIONS[name])(scene)


def _scene(given: dict[str, Any]) -> "Scene":
    """Return the checked scene of a file and options."""
    from jaxstab.scene import Scene
    from jaxstab.tables import read_table

    file = given.get("file")
    with _refused():
        table = read_table(file) if file else {}
        return Scene.from_table(_merged(table, given), str(file) if file else "")


@contextmanager
def _refused() -> Iterator[None]:
    """End a command that cannot answer with exit code 2: 1 is for walls that are not stable."""
    try:
        yield
    except (OSError, ValueError, TypeError, RuntimeError, MemoryError) as error:
        words = error.strerror if isinstance(error, OSError) else None
        raise click.UsageError(words or str(error) or "there is not enough memory.") from error


_VELOCITY = {
    "window": "window",
    "window_samples": "window_samples",
    "cutoff": "cutoff",
    "estimator": "preset",
}


def _merged(table: dict[str, Any], given: dict[str, Any]) -> dict[str, Any]:
    """Return the tables of a file with the options in place of its values."""
    keys = {
        "device": ("device", "preset"),
        "mass": ("device", "mass"),
        "inertia": ("device", "inertia"),
        "damping": ("device", "damping"),
        "hand_mass": ("hand", "mass"),
        "hand_inertia": ("hand", "inertia"),
        "hand_stiffness": ("hand", "stiffness"),
        "hand_damping": ("hand", "damping"),
        "sample_time": ("controller", "sample_time"),
        "delay": ("controller", "delay"),
        "delay_samples": ("controller", "delay_samples"),
        "at_damping": ("wanted", "at_damping"),
        "at_stiffness": ("wanted", "at_stiffness"),
        "stiffness": ("wanted", "stiffness"),
        "safety": ("wanted", "safety"),
    }
    merged = {"device": {}, "controller": {}} | table
    options = {option: value for option, value in given.items() if value is not None}
    sections = {section for option, (section, _) in keys.items() if option in options}
    if options.get("wall"):
        sections.add("walls")
    if any(not isinstance(merged.get(section, {}), dict) for section in sections):
        return merged  # which is refused
    if "delay" in options or "delay_samples" in options:  # in place of one in either unit
        kept = merged["controller"].items()
        merged["controller"] = {key: value for key, value in kept if "delay" not in key}
    velocity = {key: options[option] for option, key in _VELOCITY.items() if option in options}
    if velocity and isinstance(merged["controller"], dict):  # in place of all that the file says
        merged["controller"] = merged["controller"] | {"velocity": velocity}
    for option, (section, key) in keys.items():
        if option in options:
            merged[section] = merged.get(section, {}) | {key: options[option]}
    walls = {}
    for name, stiffness, damping in options.get("wall", ()):
        if name in walls:
            raise ValueError(f"wall {name} is given twice; give each wall a name of its own.")
        walls[name] = {"stiffness": stiffness, "damping": damping}
    return merged | ({"walls": merged.get("walls", {}) | walls} if walls else {})


# ------------------------------------------------------------------------------------------- print


def _warn(scene: "Scene") -> None:
    """Say what is unusual about a scene."""
    unusual = scene.unusual()
    if unusual:
        click.echo(f"jaxstab: warning: {'; '.join(unusual)}.", err=True)


def _print(scene: "Scene", answer: "Answer", as_json: bool) -> None:
    _warn(scene)
    click.echo(json.dumps(answer.as_json(), indent=1) if as_json else answer)
