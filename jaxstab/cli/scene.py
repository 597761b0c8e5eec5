"""The commands around a scene: what it allows, how its walls do, the best walls, the design."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from math import isfinite, isinf, isnan
from pathlib import Path
from typing import Any

import click

from jaxstab.batches import use_compilation_cache

_UNITS = (  # the first that is in a name
    ("gain", ""),
    ("share", ""),
    ("ratio", ""),
    ("radius", ""),
    ("time", "s"),
    ("delay", "s"),
    ("stiffness", "N/m"),
    ("damping", "N s/m"),
    ("mass", "kg"),
    ("frequency", "Hz"),
)


class _FileOrCommand(click.Group):
    """A group whose first argument may also be a file, for the command ``answer``."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Put the name of the command in front where it is left out."""
        if args and args[0] not in {*self.commands, "--help"}:
            args.insert(0, "answer")
        return super().parse_args(ctx, args)


def _range(_: click.Context, option: click.Parameter, text: str | None) -> Any:
    """Return one number, or two in a list."""
    try:
        numbers = [float(part) for part in text.split(":")] if text else [None]
    except ValueError:
        raise click.BadParameter(
            f"{text!r} is neither a number nor LOW:HIGH.", param=option
        ) from None
    return numbers if len(numbers) > 1 else numbers[0]


def _picture_file(_: click.Context, option: click.Parameter, path: Path | None) -> Path | None:
    """Return the name of a picture, or refuse it before anything is computed."""
    if path and path.suffix not in (".png", ".svg"):
        raise click.BadParameter(f"{path} ends in neither .png nor .svg.", param=option)
    if path and (path.is_dir() or not path.parent.is_dir()):
        raise click.BadParameter(f"{path} is no file in a folder that exists.", param=option)
    return path


def scene_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add what describes a scene: a file, options that go before it, and the form of the answer."""
    decorations = (
        click.argument("file", type=Path, required=False),
        click.option("--device", help="A device by name: phantom, omega or falcon."),
        click.option("--mass", type=float, help="Of the device, in kg."),
        click.option("--damping", type=float, help="Of the device, in N s/m."),
        click.option("--hand-mass", callback=_range, help="In kg; LOW:HIGH for a range."),
        click.option("--hand-stiffness", callback=_range, help="In N/m; LOW:HIGH for a range."),
        click.option("--hand-damping", callback=_range, help="In N s/m; LOW:HIGH for a range."),
        click.option("--sample-time", type=float, help="T in s."),
        click.option("--delay", type=float, help="Time delay of the loop in s."),
        click.option("--delay-samples", type=float, help="The same in samples."),
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
    "--plot", type=Path, callback=_picture_file, help="PNG or SVG file to draw the scene into."
)


@click.command()
@scene_options
@_plot_option
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
    checked = _answer(given, "check", as_json)
    from jaxstab.scene.answers import all_stable

    return 0 if all_stable(checked) else 1


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
@click.option("--stiffness", type=float, help="The stiffness to design for, in N/m.")
def design(as_json: bool, **given: Any) -> None:
    """Find the largest sample time, and the largest delay, for a wanted stiffness."""
    _answer(given, "design", as_json)


@click.group(cls=_FileOrCommand)
def scene() -> None:
    """Write an example of a scene (init), or answer what a scene FILE wants.

    With FILE: --explain prints what is computed, what is skipped and why; --json prints JSON;
    --plot draws a picture into a PNG or SVG file.
    """


@scene.command()
@click.option("-o", "--output", type=Path, help="File to write; without, print it.")
def init(output: Path | None) -> None:
    """Write a commented example of a scene."""
    from jaxstab.scene.scene import EXAMPLE

    if output is None:
        click.echo(EXAMPLE, nl=False)
        return
    try:
        with output.open("x", encoding="utf-8") as stream:
            stream.write(EXAMPLE)
    except OSError as error:
        raise click.UsageError(f"cannot write {output}: {error.strerror}.") from error


@scene.command(hidden=True)
@click.argument("file", type=Path)
@click.option("--explain", is_flag=True, help="Print what is computed, what is skipped and why.")
@_plot_option
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def answer(file: Path, explain: bool, plot: Path | None, as_json: bool) -> None:
    """Answer what a scene FILE wants."""
    from jaxstab.scene.scene import plan

    given = _scene({"file": file})
    if explain:
        _warn(given)
        for step in plan(given):
            click.echo(f"{'compute' if step.computed else 'skip':8}{step.what:36}{step.why}")
        return
    answers = {name: _computed(given, name) for name in given.wanted.answers}
    if plot:
        _draw(given, answers.get("check"), plot)
    _print(given, answers, as_json)


# --------------------------------------------------------------------------- from options to scene


def _answer(given: dict[str, Any], name: str, as_json: bool) -> dict[str, Any]:
    made, plot = _scene(given), given.get("plot")
    found = _computed(made, name)
    if plot:
        _draw(made, found if name == "check" else None, plot)
    _print(made, found, as_json)
    return found


def _draw(scene: Any, checked: dict[str, Any] | None, file: Path) -> None:
    from jaxstab.durable import publish
    from jaxstab.pictures.paper import picture
    from jaxstab.pictures.scene import scene_figure

    with _refused():
        publish(picture(scene_figure(scene, checked), file.suffix[1:]), file)


def _computed(scene: Any, name: str) -> dict[str, Any]:
    start_jax()
    from jaxstab.scene import answers as front

    with _refused():
        found: dict[str, Any] = getattr(front, name)(scene)
        return found


def _scene(given: dict[str, Any]) -> Any:
    """Return the checked scene of a file and options."""
    from jaxstab.scene.scene import Scene, read_table

    file = given.get("file")
    with _refused():
        table = read_table(file) if file else {}
        return Scene.from_table(_merged(table, given), str(file) if file else "")


@contextmanager
def _refused() -> Iterator[None]:
    """End a command that cannot answer with exit code 2: 1 is for walls that are not stable."""
    try:
        yield
    except (OSError, ValueError, TypeError, MemoryError) as error:
        words = error.strerror if isinstance(error, OSError) else None
        raise click.UsageError(words or str(error) or "there is not enough memory.") from error


def _merged(table: dict[str, Any], given: dict[str, Any]) -> dict[str, Any]:
    """Return the tables of a file with the options in place of its values."""
    places = {
        "device": ("device", "preset"),
        "mass": ("device", "mass"),
        "damping": ("device", "damping"),
        "hand_mass": ("hand", "mass"),
        "hand_stiffness": ("hand", "stiffness"),
        "hand_damping": ("hand", "damping"),
        "sample_time": ("controller", "sample_time"),
        "delay": ("controller", "delay"),
        "delay_samples": ("controller", "delay_samples"),
        "at_damping": ("wanted", "at_damping"),
        "at_stiffness": ("wanted", "at_stiffness"),
        "stiffness": ("wanted", "stiffness"),
    }
    merged = {"device": {}, "controller": {}} | table
    options = {option: value for option, value in given.items() if value is not None}
    sections = {section for option, (section, _) in places.items() if option in options}
    if options.get("wall"):
        sections.add("walls")
    if any(not isinstance(merged.get(section, {}), dict) for section in sections):
        return merged  # which is refused
    if "delay" in options or "delay_samples" in options:  # in place of one in either unit
        kept = merged["controller"].items()
        merged["controller"] = {key: value for key, value in kept if "delay" not in key}
    for option, (section, key) in places.items():
        if option in options:
            merged[section] = merged.get(section, {}) | {key: options[option]}
    walls = {}
    for name, stiffness, damping in options.get("wall", ()):
        if name in walls:
            raise ValueError(f"wall {name} is given twice; give each wall a name of its own.")
        walls[name] = {"stiffness": stiffness, "damping": damping}
    return merged | ({"walls": merged.get("walls", {}) | walls} if walls else {})


def start_jax() -> None:
    """Switch on float64, and keep what was compiled for the next process of this user."""
    with suppress(OSError):  # without a cache it only takes longer
        use_compilation_cache()
    import jax

    jax.config.update("jax_enable_x64", True)


# ------------------------------------------------------------------------------------------- print


def _warn(scene: Any) -> None:
    """Say what is unusual about a scene."""
    unusual = scene.unusual()
    if unusual:
        click.echo(f"jaxstab: warning: {'; '.join(unusual)}.", err=True)


def _print(scene: Any, answers: dict[str, Any], as_json: bool) -> None:
    _warn(scene)
    if as_json:
        click.echo(json.dumps(_for_json(answers), indent=1))
    else:
        for line in _lines(answers, ""):
            click.echo(line)


def _lines(answers: dict[str, Any], indent: str) -> list[str]:
    lines = []
    for name, value in answers.items():
        words = name.replace("_", " ")
        if isinstance(value, dict):
            lines += [f"{indent}{words}", *_lines(value, indent + "  ")]
        else:
            lines.append(f"{indent}{words:{34 - len(indent)}}{_in_words(name, value)}")
    return lines


def _in_words(name: str, value: Any) -> str:
    if isinstance(value, str):
        return value
    unit = next((unit for part, unit in _UNITS if part in name), "")
    values = value if isinstance(value, list) else [value]
    if all(part is None or isnan(part) for part in values):
        return "none"
    if unit == "s":
        unit, values = "ms", [1e3 * part for part in values]
    numbers = " to ".join(_number(part) for part in values)
    return f"{numbers} {unit}" if unit and numbers[-1].isdigit() else numbers


def _number(value: float) -> str:
    return "unlimited" if isinf(value) else f"{value + 0.0:.6g}"  # no minus zero


def _for_json(value: Any) -> Any:
    """Return a value for JSON, which has no NaN and no infinity."""
    if isinstance(value, dict):
        return {name: _for_json(part) for name, part in value.items()}
    if isinstance(value, list):
        return [_for_json(part) for part in value]
    return None if isinstance(value, float) and not isfinite(value) else value
