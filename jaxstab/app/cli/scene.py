"""The commands around a scene: limits, checks, the best walls, the design, studies of many."""

import json
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import Field, fields
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN
from functools import cache, partial
from math import inf, isfinite, nan, prod
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Any, NamedTuple, get_args

import click

import jaxstab
from jaxstab import lab
from jaxstab import tables as t
from jaxstab.answers import Units
from jaxstab.app import pictures
from jaxstab.app import scene as scenes
from jaxstab.app.cli.options import (
    at_work,
    computing,
    csv_option,
    draw,
    executor_options,
    file_option,
    keep_programs,
    key_values,
    plot_option,
    print_with_csv,
    refuse,
    require_one_stdout,
    split,
    together,
    write_beside,
)
from jaxstab.durable import publish
from jaxstab.shown import printable, rounded_text, table_text

if TYPE_CHECKING:
    from xarray import Dataset

# Options that describe scenes, and the tables of scenes that files and options make.


@cache
def _keys() -> dict[str, tuple[tuple[str, ...], Field[Any]]]:
    """The keys of a scene that are options, by the names of these: the path and the field."""
    names = {
        ("device", "preset"): "device",
        ("velocity", "preset"): "estimator",
        ("controller", "delay_is"): "constant_delay",
    }
    velocity = ("controller", "velocity"), scenes.scene.INNER["velocity"]
    keys = dict[str, tuple[tuple[str, ...], Field[Any]]]()
    for path, table in (
        *(((name,), table) for name, table in scenes.scene.TABLES.items()),
        velocity,
    ):
        for entry in fields(table):
            name = "hand_" * (path[-1] == "hand") + entry.name
            if entry.metadata["words"]:
                keys[names.get((path[-1], entry.name), name)] = (*path, entry.name), entry
    return keys


def scene_command(
    *wanted: str, describes: bool = True, simulates: bool = False
) -> Callable[[Callable[..., Any]], click.Command]:
    """A command with the keys of a scene as options; of [wanted] some, of a contact if it has one.

    They are made when it is called: jaxstab --help and other commands do not import scenes.
    ``describes`` tells whether other keys than those of [wanted] are options, too.
    """

    class SceneCommand(click.Command):
        def get_params(self, ctx: click.Context) -> list[click.Parameter]:
            """Return arguments and options."""
            made = [
                _option(name, entry, is_velocity="velocity" in path)
                for name, (path, entry) in _keys().items()
                if (name in wanted if path[0] == "wanted" else describes)
                and (simulates or not (path[0] == "contact" or name == "friction"))
            ]
            return [*made, *super().get_params(ctx)]

    return click.command(cls=SceneCommand)


def _option(name: str, entry: Field[Any], *, is_velocity: bool) -> click.Option:
    """Return the option of a key: its kind is that of the field, its unit that of the check."""
    kind = get_args(entry.type)[0] if isinstance(entry.type, UnionType) else entry.type
    reads: dict[str, Any] = {"type": kind}
    words, unit = entry.metadata["words"], t.unit_of(entry)
    words = f"velocity: {words}" if is_velocity else words
    if unit != "1":
        turning = Units.ROTATION.unit(unit)
        words += f" in {unit}" + (f" ({turning})" if turning != unit and unit != "kg" else "")
    if kind == tuple[float, float]:
        reads = {"callback": split(":", float, (1, 2), "is neither a number nor LOW:HIGH.")}
        words = f"{words}; LOW:HIGH for a range"
    flags: dict[str, Any] = {"constant_delay": "constant", "frequency": True}
    if name in flags:
        reads = {"flag_value": flags[name], "default": None}
    sentence = f"{words[0].upper()}{words[1:]}."
    return click.Option([f"--{name.replace('_', '-')}"], **reads, help=sentence)


wall_option = click.option(
    "--wall",
    type=(str, float, float),
    multiple=True,
    metavar="NAME K B",
    help="A wall: its name, N/m and N s/m; may be repeated.",
)


# What describes a loop beside the options of a ``scene_command``, which go before the files.
loop_options = together(
    click.argument("files", type=Path, nargs=-1, metavar="[FILE]..."),
    click.option("--rate", type=float, help="Sampling rate in Hz, in place of the sample time."),
    click.option(
        "--set",
        multiple=True,
        callback=key_values,
        metavar="KEY=VALUE",
        help="Any key of a scene, such as loop.substeps=4 or gains.soft.kp=300; may be repeated.",
    ),
)

# The same, and its walls.
mechanics_options = together(
    wall_option,
    click.option(
        "--gains",
        type=(float, float),
        metavar="K B",
        help="One wall in place of the scene's: N/m and N s/m (kp and kd: N m/rad and N m s/rad).",
    ),
    loop_options,
)

# The same of several, and the form of the answer.
scene_options = together(
    mechanics_options,
    plot_option("PNG or SVG file to draw the scene into."),
    csv_option("to write all values into, a row for each scene."),
    click.option("--json", "as_json", is_flag=True, help="Print JSON."),
)


def tables_of(given: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the table of each file, or an empty one, with the options in place of its values."""
    files = given.get("files") or ()
    describing = "device", "mass", "inertia", "damping", "sample_time", "wall", "gains", "set"
    if not files and all(value in (None, (), {}) for value in map(given.get, describing)):
        raise click.UsageError(
            "no scene is given; give the FILE of one (jaxstab scene init -o scene.toml writes an "
            "example), or options, such as --device omega --sample-time 0.001 --delay 0.001."
        )
    tables = {str(file): t.read_table(file, "scene") for file in files} or {"": {}}
    return {source: _merged(table, given) for source, table in tables.items()}


def scene_of(given: dict[str, Any], what: str = "") -> "scenes.Scene":
    """Return the checked scene of one file and options, for ``what`` there may be one alone."""
    if len(given.get("files", ())) > 1:
        raise click.UsageError(f"{what} is for one scene; give one FILE.")
    ((source, table),) = tables_of(given).items()
    return scenes.Scene.from_table(table, source)


def warn(*unusual: str) -> None:
    """Print warnings about unusual values of a scene."""
    if unusual:
        words = "; ".join(unusual)
        words = printable(f"{words}{'' if words.endswith('?') else '.'}")
        click.echo(f"jaxstab: warning: {words}", err=True)


def sentence_of(error: OSError) -> str:
    """Return the sentence of an error; the system has none for what it refuses of stdout."""
    reason = error.strerror or str(error)
    if error.errno is None or reason != os.strerror(error.errno):
        return reason
    return f"cannot {'use' if error.filename else 'write'} {error.filename or 'stdout'}: {reason}."


def _merged(table: dict[str, Any], given: dict[str, Any]) -> dict[str, Any]:
    period, rate = ("controller", "sample_time"), given.get("rate")
    options = {path: name for name, (path, _) in _keys().items() if given.get(name) is not None}
    chosen: dict[tuple[str, ...], Any] = {path: given[name] for path, name in options.items()}
    if rate is not None:
        if not 0.0 < rate < inf:
            raise click.UsageError(f"--rate is {rate:g}; give a finite number > 0 in Hz.")
        if period in chosen:
            raise click.UsageError(f"--rate is {rate:g} beside --sample-time; give one of them.")
        chosen[period], options[period] = 1.0 / rate, "rate"
    walls = [*given.get("wall", ())]
    if given.get("gains"):
        table = {name: own for name, own in table.items() if name != "walls"}
        walls.append(("gains", *given["gains"]))
    for name, stiffness, damping in walls:
        if ("walls", name) in chosen:
            raise ValueError(f"wall {name} is given twice; give each wall another name.")
        chosen["walls", name] = {"stiffness": stiffness, "damping": damping}
    own = {path[1] for path in chosen if path[0] == "controller"}
    if "velocity" in own:  # in place of all that the file says
        table = t.with_value(table, "controller.velocity", {}, ["controller", "velocity"])
    for path, value in chosen.items():
        table = t.with_value(table, ".".join(path), value, path)
    if {"delay", "delay_samples"} & own:  # in either unit
        is_kept = "constant" if not chosen.get(("controller", "lost_samples")) else None
        table["controller"] = {
            key: value
            for key, value in table["controller"].items()
            if key in own or "delay" not in key or value == is_kept
        }
    for name, value in given.get("set", {}).items():
        path = (*name.split("."),)
        if path in options:
            option = options[path].replace("_", "-")
            raise click.UsageError(f"--set {name} is given beside --{option}; give one of them.")
        table = t.with_value(table, name, t.value_of(value), path)
    return table


# The answers of one scene in full, or of several in a table; CSV, JSON, and a picture.


class _SceneAnswer(NamedTuple):
    """The answer of a scene, or why it was refused."""

    source: str
    scene: Any  # None for one that was refused
    answer: Any  # None for a scene that was refused
    refusal: str

    def cells(self, paths: list[str], index: int) -> list[Any]:
        """The source, the values (0) or words (1) of an answer at paths, and the refusal."""
        leaves = {path: leaf for path, *leaf in self.answer.leaves()} if self.answer else {}
        own = (leaves[path][index] if path in leaves else "" for path in paths)
        return [self.source, *own, self.refusal]

    def as_json(self) -> dict[str, Any]:
        """The answer, or the refusal, with the name of the scene."""
        answer = self.answer.as_json() if self.answer else None
        return {"scene": self.source, "answer": answer, "refusal": self.refusal or None}


def _answer(
    given: dict[str, Any],
    name: str,
    asked: str | None = None,
    *,
    is_short: bool = False,
    **options: Any,
) -> int:
    """Print what scenes answer, and return the exit code; UsageError if some were refused.

    ``options`` are those of the function that answers about walls. ``asked`` is the quantity that
    walls are to be stable with, in place of what ``name`` answers.
    """
    require_one_stdout(given["as_json"], given["csv_file"])
    if asked:
        others = ("plot", "safety", "stiffness", "at_damping", "at_stiffness")
        words = "is given, but what walls need of one quantity is asked for; leave it out."
        refuse({name: given.get(name) for name in others}, words)

    make: Any = scenes.any_scene
    make = partial(scenes.Backwards.from_table, asked=asked) if asked else make
    is_one, rows = len(given["files"]) <= 1, list[_SceneAnswer]()
    refusals = () if is_one else (ValueError, TypeError, RuntimeError)
    for source, table in tables_of(given).items():
        scene: Any = None
        try:
            scene = make(table, source if is_one else "")
            if given["plot"]:
                _require_picture(scene, name, is_one=is_one)
            rows.append(_SceneAnswer(source, scene, _computed(scene, name, options), ""))
        except refusals as error:
            rows.append(_SceneAnswer(source, scene, None, str(error)))
    if given["plot"]:
        answered = {row.source: row.scene for row in rows if row.answer}
        one = partial(pictures.scene.scene_figure, rows[0].scene, rows[0].answer)
        draw(one() if is_one else pictures.scene.comparison_figure(answered), given["plot"])
    warn(*dict.fromkeys(words for row in rows if row.scene for words in row.scene.unusual()))
    leaves = (leaf for row in rows if row.answer for leaf in row.answer.leaves())
    paths = list(dict.fromkeys(path for path, *_ in leaves))
    if given["as_json"]:
        own = rows[0].answer.as_json() if is_one else [row.as_json() for row in rows]
        words = json.dumps(own, indent=1)
    elif is_one:
        words = rows[0].answer.in_short() if is_short else str(rows[0].answer)
    else:
        words = _table(rows)
    cells = [["scene", *paths, "refusal"], *(row.cells(paths, 0) for row in rows)]
    print_with_csv(words, cells, given["csv_file"])
    refused = [row for row in rows if row.refusal]
    if refused:
        raise click.UsageError(
            f"{len(refused)} of {len(rows)} scenes were refused; the first, {refused[0].source}: "
            f"{refused[0].refusal}"
        )
    return 0 if all(row.answer.all_stable for row in rows) else 1


def _require_picture(scene: Any, name: str, *, is_one: bool) -> None:
    """Refuse a picture of what has none, before anything is computed."""
    if isinstance(scene, scenes.GainScene):
        if not is_one:
            raise click.UsageError("a picture of several scenes is for walls; give one FILE.")
    elif not (is_one and (name in ("tune", "design") or scene.controller.moves)):
        try:
            scene.controller.require_one_delay("a picture")
        except ValueError as error:
            raise click.UsageError(str(error)) from None


def _computed(scene: Any, name: str, options: dict[str, Any]) -> Any:
    if not isinstance(scene, scenes.Scene):
        with at_work(f"{name} of a loop"):
            return scene.answer(name)
    every = ", proved for every sequence of delays" if scene.controller.moves else ""
    functions = {
        "limits": "scene_limits",
        "check": "check_walls",
        "tune": "tune_walls",
        "design": "design_loop",
        "contact": "simulate_contacts",
    }
    with at_work(f"{name} of a loop with {scene.controller.samples:g} samples of delay{every}"):
        return getattr(scenes, functions[name])(scene, **options)


def _table(rows: list[_SceneAnswer]) -> str:
    """Return the main numbers of each scene, in columns, or the reason why it was refused."""
    mains = (path for row in rows if row.answer for path in row.answer.main_paths())
    paths = list(dict.fromkeys(mains))
    plain = (path.removeprefix("walls.").replace("_", " ").replace(".", ": ") for path in paths)
    return table_text([["scene", *plain, ""], *(row.cells(paths, 1) for row in rows)])


MARGINS = "phase_margin", "gain_margin", "sensitivity", "delay_margin"


@scene_command("safety", "at_damping", "at_stiffness", *MARGINS)
@scene_options
@click.option("--all", "in_full", is_flag=True, help="Print everything, as --json does.")
@click.option("--islands", is_flag=True, help="Print stable walls not connected to zero gains too.")
def limits(in_full: bool, islands: bool, **given: Any) -> int:
    """Give the largest stiffness that a scene allows, and the limits at each of its walls.

    All limits are of walls with K >= 0 and B >= 0. The exit code is 0 if there are stable walls,
    for all hands and delays of the scene by proof, and the walls of the scene are among them, 1 if
    not. --gains without a mass or inertia asks for the least inertia that these need.
    """
    tables = tables_of(given).values() if given["gains"] else ()
    is_asked = tables and not any(
        {"mass", "inertia"} & scenes.tune.known_of(table) for table in tables
    )
    asked = "inertia" if is_asked else None
    return _answer(given, "limits", asked, is_short=not (in_full or is_asked), islands=islands)


@scene_command("frequency", *MARGINS, simulates=True)
@scene_options
@click.option("--all", "in_full", is_flag=True, help="Print everything, as --json does.")
@file_option(
    "--certificate",
    endings=(".json",),
    help="JSON file for a program that confirms the verdicts without jaxstab: jaxstab files "
    "check_wall.py.",
)
def check(in_full: bool, certificate: Path | None, **given: Any) -> int:
    """Check each wall: stable or not, its margins, how fast it settles.

    The exit code is 0 if every wall is proved stable, if only but for a position that nothing
    holds, 1 if not.
    """
    if certificate:
        claims = scenes.exports.certificate(scene_of(given, "a certificate"))
        write_beside(json.dumps(claims, indent=1).encode() + b"\n", certificate)
    is_short = not (in_full or given["as_json"] or given["csv_file"])
    return _answer(given, "check", is_short=is_short, in_full=not is_short)


@scene_command(simulates=True)
@scene_options
@file_option(
    "-o",
    "--output",
    endings=(".h5", ".nc"),
    help="Simulate a map of walls around the stable ones into this netCDF-4 file instead.",
)
@click.option(
    "--count", type=click.IntRange(2, 10_000), help="Walls along each axis of it; default: 60."
)
@click.option("--frictions", help="LOW:HIGH:COUNT or V,V,... in N: its third axis.")
@executor_options
def contact(output: Path | None, count: int | None, frictions: str | None, **given: Any) -> int:
    """Simulate how the device of a scene meets each wall: does it rest, bounce or buzz?

    With friction, a one-sided wall and the encoder, as the table [contact] of the scene says.
    Nothing is proved. The exit code is 0 if every simulated contact comes to rest, 1 if not.
    """
    if output is None:
        where = {name: given[name] for name in ("workers", "scheduler", "scheduler_file")}
        of_maps = {"count": count, "frictions": frictions, **where}
        refuse(of_maps, "is for a map; give --output, too.")
        return _answer(given, "contact")
    beside = {"plot": given["plot"], "csv": given["csv_file"], "json": given["as_json"]}
    refuse(beside, "is given beside --output; give one of them.")
    from jaxstab.numbers import listed

    scene = scene_of(given, "a map")
    t.require_free(output)
    keep_programs()
    warn(*scene.unusual(), *scenes.answers.delay_notes(scene))
    forces = None if frictions is None else listed("friction", frictions)
    planned = scenes.contact.map_contacts(scene, count or 60, forces)
    assert scene.contact is not None  # there is a map
    axes = " x ".join(f"{length} {name}" for name, length in planned.sizes.items())
    words = f"{planned.kind.size:,} contacts of {scene.contact.duration:g} s"
    click.echo(f"jaxstab: {axes}: {words}, simulated, not proved", err=True)
    with computing(given):
        table = t.computed(planned)
    t.write(table, output)
    rests = float((table.kind == jaxstab.results.ContactKind.RESTS).mean())
    click.echo(f"{output}: {100.0 * rests:.1f} % of the contacts come to rest")
    return 0


@scene_command("at_stiffness", "mass_tolerance", "delay_tolerance", *MARGINS)
@scene_options
def tune(**given: Any) -> int:
    """Find the walls that come to rest fastest, and the best damping for each wall.

    Of a range of delays, walls are those of the longest one as a constant delay. The exit code is 0
    if every wall is found, and proved stable for all hands and delays, 1 if not.
    """
    return _answer(given, "tune")


@scene_command("safety", "stiffness", *MARGINS)
@scene_options
@click.option(
    "--for",
    "asked",
    type=click.Choice(["inertia", "mass", "damping", "delay", "sample-time", "cutoff", "window"]),
    help="Find the values of this quantity with which each wall is stable, for every hand.",
)
def design(asked: str | None, **given: Any) -> int:
    """Find the sample time, and the delay, up to which a wanted stiffness is allowed.

    With --for, find what a wall needs: all values of one quantity that a scan finds, each end of
    them proved. Of a range of delays it takes the longest one as a constant delay. The exit code is
    0 if all are found, 1 if not.
    """
    if not asked:
        walls = {name: given[name] for name in ("wall", "gains")}
        refuse(walls, "is given without --for; give what it needs.")
    return _answer(given, "design", asked=asked)


_FILES = {
    "check_wall.py": ("check", "confirms certificates of check; Python's standard library alone"),
    "jaxstab_verdict.h": ("readers/c", "verdicts, proved, in C99 or C++ without libraries"),
    "jaxstab_atlas.h": ("readers/c", "reads atlases in C by libhdf5, beside jaxstab_verdict.h"),
    "jaxstab_query.c": ("readers/c", "an example: asks an atlas by jaxstab_atlas.h"),
}


@click.command()
@click.argument("name", required=False, type=click.Choice([*_FILES]))
@file_option(
    "-o",
    "--output",
    may_be_stdout=True,
    help="File to write, which must not exist; default: print it.",
)
def files(name: str | None, output: Path | None) -> None:
    """Write a program that works without jaxstab, or list all of them."""
    if name is None:
        refuse({"output": output}, "is given without the NAME of a file; give one.")
        click.echo(table_text([(own, words) for own, (_, words) in _FILES.items()]))
        return
    _write_shipped(_FILES[name][0], name, output)


def _write_shipped(folder: str, name: str, output: Path | None) -> None:
    """Print a file of data/, or write it to a path at which there is nothing."""
    text = (scenes.scene.folder_of(folder) / name).read_text(encoding="utf-8")
    if output is None or str(output) == "-":
        click.echo(text, nl=False)
        return
    t.require_free(output)
    publish(text.encode(), output, may_replace=False)
    click.echo(output)


@click.group()
def scene() -> None:
    """Write an example of a scene, explain the model of one, or list devices and software."""


@scene.command()
@file_option(
    "-o",
    "--output",
    may_be_stdout=True,
    help="File to write, which must not exist; default: print it.",
)
@click.option(
    "--kind",
    type=click.Choice(["wall", "simulator", "admittance", "pid", "coupling"]),
    default="wall",
    help="Of the loop; default: a wall.",
)
def init(output: Path | None, kind: str) -> None:
    """Write a commented example of a scene."""
    _write_shipped("scenes/gains", f"{kind}.toml", output)


@scene.command()
def presets() -> None:
    """List devices and velocity estimators by name: their numbers, and where these are from."""
    for place, kind in (("device", "devices"), ("controller.velocity", "software")):
        for name, preset in scenes.scene.presets(kind).items():
            lines = [f'[{place}] preset = "{name}"', f"  {preset['title']}"]
            for key, own in scenes.scene.numbers_in(preset).items():
                value = own["value"] if isinstance(own["value"], list) else f"{own['value']:g}"
                words = f"{value} {own['unit']}  ({own['source']}; {own['date']})"
                lines.append(f"  {key.replace('_', ' '):28}{words}")
            lines += [f"  {preset['note']}"] if "note" in preset else []
            click.echo("\n".join([*lines, ""]))


@scene.command()
@click.argument("file", type=Path)
def explain(file: Path) -> None:
    """Print the model of a scene FILE: its blocks with their values, and what it leaves out."""
    ((source, table),) = tables_of({"files": [file]}).items()
    scene = scenes.any_scene(table, source)
    warn(*scene.unusual())
    is_wall = isinstance(scene, scenes.Scene)
    click.echo(scenes.explain_model(scene) if is_wall else scenes.explain_gains(scene))


# The command that writes a page to explore a scene in.


@click.command()
@click.argument("file", type=Path, required=False)
@file_option(
    "-o",
    "--output",
    endings=(".html", ".htm"),
    default=Path("walls.html"),
    show_default=True,
    help="HTML file to write.",
)
def explore(file: Path | None, output: Path) -> None:
    """Write a page that draws the stable walls while sliders move device, hand and controller.

    It begins with the scene of FILE; without one, with an omega-like device and the velocity of its
    maker's software. The page is one file, and needs a browser, but no network.
    """
    from jaxstab.app.explore import explorer_page

    omega = {
        "device": "omega",
        "sample_time": 0.001,
        "delay_samples": 1.0,
        "estimator": "force-dimension-sdk",
        "wall": [("chai3d", 5000.0, 30.0), ("soft", 1000.0, 15.0)],
    }
    given = {"files": [file]} if file else omega
    scene = scene_of(given)
    warn(*scene.unusual(), *scenes.answers.delay_notes(scene))
    title = f"the scene {file.name}" if file else "an omega-like device at 1 kHz"
    page = explorer_page(scene, title)
    publish(page.encode(), output)
    click.echo(output)


# The command that writes a guard for C.


@scene_command()
@loop_options
@file_option("-o", "--output", required=True, help="Header file; its name begins all names in it.")
@click.option(
    "--cells",
    callback=split(",", int, (3,), "is not MASS,DELAY,DAMPING."),
    help="Cells along mass, delay and damping: powers of two.",
)
@plot_option("PNG or SVG file of the limits.")
def guard(output: Path, plot: Path | None, **given: Any) -> None:
    """Write a C header that clamps K and B to what is proved stable, for a running loop.

    It is for the ranges of the scene, such as --mass 0.22:0.28 --delay 0.0008:0.0012. Of one mass
    it takes 0.8 to 1.25 times it; of one delay that to one sample more, and from one less if it is
    constant. With modes, an actuator or a grip it is 0.96 to 1.04 times and a tenth of a sample.

    Its walls are proved for every sequence of the delays; with --constant-delay for delays that do
    not change during contact, and the function takes the delay.
    """
    lost = given.pop("lost_samples") or 0  # beside one delay of the scene, too
    scene = scene_of(given, "a guard")
    warn(*scene.unusual())
    name = lab.guard.checked_name(output.stem)  # before the proof, which takes long
    a, b, c = given["cells"] or scenes.exports.cells_of(scene)
    # One, which is printed as the proof begins.
    plans = iter([lab.guard.plan_guard(scenes.loops.loops_over_delays(scene)[0], (a, b, c))])
    with at_work("proving") as show:

        def tell(share: float) -> None:
            for plan in plans:
                click.echo(plan, err=True)
            show(share, 1.0)

        made = scenes.exports.scene_guard(scene, lost=lost, progress=tell, cells=(a, b, c))
    about = scenes.exports.guard_about(scene, made)
    publish(made.header(name, about, scene.units.value[:3]).encode(), output)
    if plot:
        draw(pictures.scene.guard_figure(made, scene.units), plot)
    click.echo(f"{output}: {output.stat().st_size / 1e3:.0f} kB\n{about}")


# The command that identifies a device: a scene from a log of forces and positions.


@click.command()
@click.argument("log", type=Path)
@file_option("-o", "--output", may_be_stdout=True, help="Scene (TOML) to write; '-': stdout.")
@together(
    *(
        click.option(
            f"--{name}", metavar="COLUMN", help=f'Column of the {name}; default: "{name}".'
        )
        for name in ("time", "force", "position", "velocity", "setpoint")
    )
)
@click.option("--sample-time", type=float, help="Sampling period in s, in place of a time column.")
@click.option("--turns", is_flag=True, help="Rotary device: rad and N m in place of m and N.")
@click.option(
    "--spring", is_flag=True, help="Also fit a spring of the device, such as a centring spring."
)
@click.option("--kp", type=float, help="Of a closed servo: its stiffness in N/m (N m/rad).")
@click.option("--kd", type=float, help="Of a closed servo: its damping in N s/m (N m s/rad).")
@click.option("--window-samples", type=int, help="Of a closed servo: window of its velocity.")
@plot_option("PNG or SVG file: measured against fitted.")
def identify(
    log: Path,
    output: Path | None,
    sample_time: float | None,
    turns: bool,
    spring: bool,
    window_samples: int | None,
    plot: Path | None,
    **given: Any,
) -> None:
    """Fit mass, damping, friction and delay to a LOG, with 95 % confidence intervals.

    The log is a CSV file with a header and a row for each sample: time in s, commanded force in N,
    position in m, and, if logged, the velocity of the software. docs/identify.md says how to
    record one.

    With --kp and --kd it is of a closed servo, its setpoint in place of the force, with a step:
    inertia, damping and delay are fitted.
    """
    gains = {name: given.pop(name) for name in ("kp", "kd")}
    is_servo = None not in gains.values()
    servos = (window_samples, *gains.values())  # options that nothing else has
    if spring if is_servo else servos != (None, None, None):
        raise click.UsageError(
            "of --kp, --kd and --window-samples some are missing, or there is --spring beside "
            "them; give --kp and --kd of a servo, without --spring, or none of them."
        )
    used = ("time", "position", "setpoint" if is_servo else "force", *["velocity"] * (not is_servo))
    for name in (name for name, column in given.items() if column and name not in used):
        raise click.UsageError(
            f"--{name} is {given[name]}, which is not read {'beside' if is_servo else 'without'} "
            "--kp and --kd; leave it out."
        )
    names = {name: given[name] or name for name in used}
    optional = [] if is_servo or given["velocity"] else [names["velocity"]]
    columns, clash = lab.identify.read_log(str(log), names, sample_time, optional)
    with warnings.catch_warnings(), at_work(f"fitting {log}"):
        warnings.simplefilter("ignore", UserWarning)  # the scene's are printed
        if is_servo:
            window = None if window_samples is None else jaxstab.Velocity.difference(window_samples)
            device = lab.identify.identify_servo(**columns, **gains, velocity=window)
        else:
            device = lab.identify.identify(**columns, spring=spring)
    units = Units.ROTATION if turns else Units.LINE
    scene = lab.identify.identified_scene(device, units, log.name)
    unusual = scenes.Scene.from_table(t.parsed(scene)).unusual()
    warn(*filter(None, [clash, device.warning]), *unusual)
    if plot:
        draw(pictures.scene.identified_figure(device, units), plot)
    if str(output) == "-":
        click.echo(scene, nl=False)
        return
    if output:
        publish(scene.encode(), output)
    click.echo(lab.identify.identified_text(device, units))


# The command for the joints of a robot file.


@click.command()
@click.argument("robot", type=Path)
@click.option("--rate", type=float, help="Of the controller in Hz.")
@click.option("--delay", type=float, default=0.0, help="From sample to torque in s; default: 0.")
@click.option("--jitter", type=float, default=0.0, help="By which the delay varies, in s.")
@click.option("--cutoff", type=float, help="Low pass of the velocity in Hz; default: none.")
@click.option("--gains", type=Path, help="YAML file: kp and kd by the names of joints.")
@click.option("--simulated", is_flag=True, help="Take the file's own step and integrator.")
@csv_option("for the table, a row for each joint.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@file_option("--safe-gains", endings=(".yaml", ".yml"), help="YAML file of safe gains to write.")
def joints(
    robot: Path,
    cutoff: float | None,
    gains: Path | None,
    csv_file: Path | None,
    as_json: bool,
    safe_gains: Path | None,
    **asked: Any,
) -> int:
    """Judge kp and kd of each joint of a ROBOT (MJCF or URDF), and of all joints at once.

    Each joint for every inertia that it has over its postures, the robot at sampled postures. Gains
    are those of the file's position actuators, or of --gains. With --simulated and no --rate they
    are inside of the simulation's step. The exit code is 0 if the gains are stable, for each joint
    (proved) and for all at once (computed), 1 if not, or if no joint has any.
    """
    require_one_stdout(as_json, csv_file)
    velocity = None if cutoff is None else jaxstab.Velocity.low_pass(cutoff)
    own = None if gains is None else lab.joints.read_gains(gains)
    with at_work(f"joints of {robot}"):
        answer = jaxstab.joints(robot, gains=own, velocity=velocity, **asked)
    if safe_gains:
        write_beside(answer.as_yaml().encode(), safe_gains)
    words = json.dumps(answer.as_json(), indent=1) if as_json else str(answer)
    print_with_csv(words, answer.rows(), csv_file)
    return 0 if answer.all_stable else 1


# The command for studies: many devices, people and controllers as one table.


@scene_command()
@mechanics_options
@click.option(
    "--over",
    multiple=True,
    callback=key_values,
    metavar="KEY=VALUES",
    help="What varies: LOW:HIGH:COUNT, V,V,..., normal:MEAN:DEVIATION, uniform:LOW:HIGH, "
    "lognormal:MEDIAN:FACTOR or csv:FILE:COLUMN; may be repeated.",
)
@click.option(
    "--answer",
    multiple=True,
    help="limits, verdict, margins, settling_time or spectral_radius; may be repeated. Default: "
    "limits, and verdict if there are walls.",
)
@click.option(
    "--samples", type=int, help="Number of draws; default: 10,000, or what takes about a minute."
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the draws.")
@file_option(
    "-o", "--output", endings=(".h5", ".nc"), help="Store the table as this netCDF-4 file."
)
@csv_option("for the table, a row for each loop and wall.")
@executor_options
@click.option(
    "--part",
    callback=split("/", int, (2,), "is no part; give NUMBER/COUNT, such as 3/64."),
    metavar="NUMBER/COUNT",
    help="Compute one part of the study alone.",
)
@click.option("--merge", is_flag=True, help="FILEs are all parts of a study: put them together.")
@plot_option("PNG or SVG file to draw the study into.")
def study(
    over: dict[str, str],
    samples: int | None,
    seed: int,
    output: Path | None,
    csv_file: Path | None,
    part: list[int] | None,
    merge: bool,
    plot: Path | None,
    **given: Any,
) -> None:
    """Answer for many devices, people and controllers at once, as one table.

    Lists of values span a grid, distributions are drawn at each of its points.
    """
    if output is None and (merge or part):
        raise click.UsageError("--merge and --part are given without --output; give the file.")
    if merge:
        files = given.pop("files")
        of_studies = {"over": over, "part": part, "samples": samples, "seed": seed or None, **given}
        words = "is given beside --merge, but nothing is computed anew; give one of them."
        refuse(of_studies, words)
        table = lab.study.merged(files)
    else:
        if len(given["files"]) > 1:
            raise click.UsageError("a study is for one scene; give one FILE, or --merge.")
        ((_, scene),) = tables_of(given).items()
        keep_programs()
        number, count = part or (1, 1)
        asked: Any = {"answers": given["answer"], "samples": samples, "seed": seed}
        table, notes = lab.study.plan_study(
            scenes.study.source_of(scene), over, part=(number, count), **asked
        )
        if samples is not None and "sample" not in table.dims:
            raise click.UsageError(
                f"--samples is {samples}, but nothing is drawn; leave it out, or let --over have a "
                "distribution, such as device.mass=uniform:0.1:0.2."
            )
    for file in (output, csv_file):  # what is read is refused above, and not to be removed
        if file is not None and str(file) != "-":
            t.require_free(file)
    rows, most = prod(table.sizes.values()), 1_048_575  # in a spreadsheet, with one of names
    if csv_file and rows > most:
        raise click.UsageError(
            f"the CSV file would have {rows:,} rows; give --output in place of --csv for more than "
            f"{most:,}."
        )
    if not merge:
        for note in notes:
            click.echo(f"jaxstab: {note}", err=True)
        with computing(given):
            table = t.computed(table)
    if output is not None:
        t.write(table, output)
    cells, lines = _cells(table) if csv_file else (), list[str]()
    for words, numbers, limit in lab.study.summary(table, is_small=rows <= most):
        lines += [words] * bool(words) + ([] if numbers is None else [_text(numbers, limit)])
    print_with_csv("\n".join(lines), cells, csv_file, may_replace=False)
    if plot:
        draw(pictures.scene.study_figure(table), plot)


# What is printed: the tables of a summary.

_INWARDS = {"largest": ROUND_FLOOR, "least": ROUND_CEILING}


def _frame(table: "Dataset") -> Any:
    """Parameters and answers, a row for each loop and wall, codes as words."""
    import numpy as np

    words = {}
    for name, values in table.data_vars.items():
        if "flag_values" in values.attrs:
            meanings = np.array(values.attrs["flag_meanings"].split())
            words[name] = values.copy(data=meanings[np.searchsorted(values.flag_values, values)])
    order = [n for n in (*lab.study.lists_of(table), "sample", "wall", "gains") if n in table.dims]
    frame = table.assign(words).to_dataframe(dim_order=order).reset_index()
    return frame[[*order, *(name for name in table.coords if name not in order), *table.data_vars]]


def _text(table: "Dataset", limit: str = "") -> str:
    """Return the first rows of a table in columns, with units; its values may be of one limit."""
    frame, most = _frame(table), 40
    units = {name: table[name].attrs.get("units", "1") for name in frame}
    heads = [f"{name} ({unit})" if unit.strip("1") else name for name, unit in units.items()]
    names = [(name in table.data_vars and limit) or name for name in frame]
    ways = [_INWARDS.get(lab.study.sense_of(name), ROUND_HALF_EVEN) for name in names]
    rows = [[*map(_cell, row, ways)] for row in frame.head(most).itertuples(index=False)]
    text = table_text([[head.replace("_", " ") for head in heads], *rows])
    more = len(frame) - most
    return f"{text}\n... and {more:,} more rows; write them with --csv or -o" if more > 0 else text


def _cell(value: Any, way: str) -> str:
    if isinstance(value, str):
        return value
    return rounded_text(value, 6, way) if isfinite(value) else f"{value:g}"


def _cells(table: "Dataset") -> Iterator[Sequence[Any]]:
    """Yield the rows of a CSV file, names first; a cell is empty for NaN and infinite numbers."""
    frame = _frame(table).replace([-inf, inf, nan], None)
    yield [*frame]
    yield from frame.itertuples(index=False)
