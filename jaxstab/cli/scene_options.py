"""Options that describe scenes, and the tables of scenes that files and options make."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jaxstab.cli.options import number_or_range, output_file

if TYPE_CHECKING:
    from jaxstab.scene import Scene


def scene_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add what describes a scene: a file, options that go before it, and the form of the answer."""
    decorations = (
        click.argument("files", type=Path, nargs=-1, metavar="[FILE]..."),
        click.option("--device", help="A device by name; jaxstab scene presets lists them."),
        click.option(
            "--mass", callback=number_or_range, help="Of the device in kg; LOW:HIGH for a range."
        ),
        click.option(
            "--inertia",
            callback=number_or_range,
            help="In kg m^2, for a device that turns; LOW:HIGH for a range.",
        ),
        click.option("--damping", type=float, help="Damping of the device in N s/m (N m s/rad)."),
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
        click.option("--sample-time", type=float, help="Sampling period T in s."),
        click.option("--delay", type=float, help="Time delay of the loop in s."),
        click.option("--delay-samples", type=float, help="The same in samples."),
        click.option("--window", type=float, help="Velocity: difference over this window in s."),
        click.option("--window-samples", type=int, help="The same in samples."),
        click.option("--cutoff", type=float, help="Velocity: low pass at this cut-off in Hz."),
        click.option(
            "--estimator",
            help="Velocity as this software estimates it; jaxstab scene presets lists names.",
        ),
        click.option(
            "--wall",
            type=(str, float, float),
            multiple=True,
            metavar="NAME K B",
            help="A wall: its name, N/m and N s/m; may be repeated.",
        ),
        click.option(
            "--sweep",
            multiple=True,
            metavar="KEY=LOW:HIGH:COUNT",
            help="Answer for each value of a key, such as device.mass=0.1:0.5:20, or KEY=V,V,...; "
            "may be repeated.",
        ),
        click.option(
            "--csv",
            "csv_file",
            type=Path,
            callback=output_file,
            help="CSV file ('-': stdout) to write all values into, a row for each scene.",
        ),
        click.option("--json", "as_json", is_flag=True, help="Print JSON."),
    )
    for decoration in reversed(decorations):
        command = decoration(command)
    return command


_DESCRIBES = ("device", "mass", "inertia", "damping", "sample_time", "wall", "sweep")
_NOTHING = (
    "no scene is given; give the FILE of one (jaxstab scene init -o scene.toml writes an example), "
    "or options, such as --device omega --sample-time 0.001 --delay 0.001."
)


def tables_of(given: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the table of each file, or an empty one, with the options in place of its values."""
    from jaxstab.tables import read_table

    with refused():
        files = given.get("files") or ()
        if not files and all(value in (None, ()) for value in map(given.get, _DESCRIBES)):
            raise click.UsageError(_NOTHING)
        tables = {str(file): read_table(file, "scene") for file in files} or {"": {}}
        return {source: _merged(table, given) for source, table in tables.items()}


def scene_of(given: dict[str, Any]) -> "Scene":
    """Return the checked scene of one file and options."""
    from jaxstab.scene import Scene

    ((source, table),) = tables_of(given).items()
    with refused():
        return Scene.from_table(table, source)


def warn(*unusual: str) -> None:
    """Say what is unusual about a scene."""
    if unusual:
        words = "; ".join(unusual)
        click.echo(f"jaxstab: warning: {words}{'' if words.endswith('?') else '.'}", err=True)


@contextmanager
def refused() -> Iterator[None]:
    """End a command that cannot answer with exit code 2: 1 is for walls that are not stable."""
    try:
        yield
    except (OSError, ValueError, TypeError, RuntimeError, MemoryError) as error:
        words = sentence_of(error) if isinstance(error, OSError) else str(error)
        raise click.UsageError(words or "there is not enough memory.") from error


def sentence_of(error: OSError) -> str:
    """Return the sentence of an error; the system has none for what it refuses of stdout."""
    reason = error.strerror or str(error)
    if error.errno is None or reason != os.strerror(error.errno):
        return reason
    return f"cannot {'use' if error.filename else 'write'} {error.filename or 'stdout'}: {reason}."


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
        "mass_tolerance": ("wanted", "mass_tolerance"),
        "delay_tolerance": ("wanted", "delay_tolerance"),
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
