"""Studies: the answers of many devices, people and controllers as one labelled table.

A study varies keys of a scene, or fields of a loop. Each list is a separate dimension, and all
distributions share the dimension ``sample``: a study with three lists and two distributions has
four dimensions, and walls are one more. ``jaxstab.scene.labelled`` computes it block by block.

Within a block, a scene is made for each combination of the values that decide the filters and the
sampling period. Masses, dampings, stiffnesses and delays are arrays beside the resulting loop, and
answers are computed for all of them at once. Limits of combinations with few loops are computed
together, whatever their filters. Walls on devices that are not one mass are computed loop by loop.
Where all draws are rows of CSV files, equal ones are computed once.

A part of a study is a piece of its longest dimension, with the draws of the whole. So it is a
smaller study, and parts are put together by ``xarray.open_mfdataset`` or by ``jaxstab study
--merge``, which tells parts of other studies by a hash of what was asked.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from hashlib import sha256
from itertools import islice, product
from math import inf, prod
from os import PathLike
from pathlib import Path
from statistics import NormalDist
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import jaxstab
from jaxstab.batches import alike
from jaxstab.conventions import Verdict
from jaxstab.loop import HapticLoop, limits_of
from jaxstab.motion.settling import SettlingStatus
from jaxstab.numbers import checked_count
from jaxstab.region import RegionStatus
from jaxstab.scene.answers import delay_notes
from jaxstab.scene.draws import Column, Values, draws_of, is_distribution, values_of, words_of
from jaxstab.scene.labelled import Variable, computed, read, table_of, xarray_module
from jaxstab.scene.loops import loop_of
from jaxstab.scene.scene import INNER, TABLES, Scene, Units
from jaxstab.shown import shortened
from jaxstab.tables import Interval, Table, check_keys, checked_label, one_of, read_table, unit_of

if TYPE_CHECKING:
    from xarray import DataArray, Dataset

Floats = NDArray[np.float64]

_BLOCK = 1 << 13  # loops times walls
SAMPLE, WALL = "sample", "wall"  # dimensions

_NUMBERS = {  # keys of a scene that are numbers of a loop: its fields
    "device.mass": "device_mass",
    "device.inertia": "device_mass",
    "device.damping": "device_damping",
    "hand.mass": "hand_mass",
    "hand.inertia": "hand_mass",
    "hand.stiffness": "hand_stiffness",
    "hand.damping": "hand_damping",
    "controller.delay": "delay",
    "controller.delay_samples": "delay_samples",
}

ANSWERS: dict[str, dict[str, Variable]] = {
    "verdict": {"verdict": Variable("whether the wall is stable, proved", "1", Verdict)},
    "limits": {
        "largest_stiffness": Variable("largest stiffness of a stable wall", "N/m"),
        "at_damping": Variable("damping at the largest stiffness", "N s/m"),
        "largest_damping": Variable("largest damping of a stable wall", "N s/m"),
        "at_stiffness": Variable("stiffness at the largest damping", "N/m"),
        "limits_status": Variable("what is known of the stable walls", "1", RegionStatus),
    },
    "margins": {
        "stiffness_gain": Variable("factor by which the stiffness may grow"),
        "damping_gain": Variable("factor by which the damping may grow"),
        "extra_delay": Variable("delay that may be added", "s"),
    },
    "settling_time": {
        "settling_time": Variable("time to settle to 2 percent", "s"),
        "settling_status": Variable("what is known of the settling time", "1", SettlingStatus),
    },
    "spectral_radius": {
        "spectral_radius": Variable("largest modulus of the poles, per sample"),
        "spectral_radius_error": Variable("proved bound of its error"),
    },
}
_FIELDS = {  # of what loops answer, where their names are others than those of the variables
    "largest_stiffness": "stiffness",
    "largest_damping": "damping",
    "limits_status": "status",
    "settling_time": "value",
    "settling_status": "status",
    "spectral_radius": "value",
    "spectral_radius_error": "error",
}


def study(
    of: "HapticLoop | Mapping[str, Any] | str | PathLike[str]",
    over: Mapping[str, Any],
    *,
    answers: Sequence[str] | None = None,
    walls: Mapping[str, tuple[float, float]] | None = None,
    samples: int | None = None,
    seed: int = 0,
    part: tuple[int, int] = (1, 1),
) -> "Dataset":
    """Answer for many devices, people and controllers, as one labelled table.

    dask computes it block by block: in this process, in others after
    ``dask.config.set(scheduler="processes")``, or by the workers of the ``distributed.Client``
    that is open. The values are the same.

    Args:
        of: a scene (a file, or its tables) or a loop.
        over: what varies, by keys of the scene such as "hand.stiffness", or by fields of the loop:
            a list of values, (low, high, count), a frozen distribution of ``scipy.stats``, or a
            text such as "0.1:0.5:20", "csv:hands.csv:stiffness" or "normal:300:100". Lists span a
            grid; distributions are drawn together, ``samples`` times at each of its points.
        answers: of "limits", "verdict", "margins", "settling_time", "spectral_radius"; all but the
            first are of walls. By default limits, and verdicts if there are walls.
        walls: stiffness and damping in SI units by name; those of the scene by default.
        samples: the number of draws; by default 10,000, or as many as take about a minute.
        seed: of the draws, a whole number >= 0.
        part: (3, 64) computes the third of 64 parts, a piece of the longest dimension.

    Returns:
        ``xarray.Dataset`` with the dimensions of the lists, ``sample`` and ``wall``; names, units
        and the meaning of codes are attributes. Its ``to_netcdf`` stores it.

    Raises:
        ValueError: a key is unknown, a value is refused by the scene, or a distribution reaches
            where the scene forbids. OSError: a file cannot be read. RuntimeError: xarray, dask or
            h5netcdf is missing, or a worker died.

    Source: the answers' own, see ``HapticLoop``.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> study = jaxstab.study(loop, over={"device_mass": [0.1, 0.2]})
        >>> study.largest_stiffness.round().values.tolist()
        [70643.0, 139265.0]
        >>> study.largest_stiffness.dims, study.at_damping.units
        (('device_mass',), 'N s/m')
    """
    return plan_study(
        of, over, answers=answers, walls=walls, samples=samples, seed=seed, part=part
    ).compute()


def shares(study: "Dataset", *, confidence: float = 0.95) -> "Dataset":
    """Return the share of draws for which each wall is proved stable, with its interval.

    Args:
        study: of draws, with verdicts, from ``jaxstab.study`` or from its file.
        confidence: of the interval, between 0 and 1.

    Returns:
        ``xarray.Dataset`` over the other dimensions: ``share`` of all draws; ``low`` and ``high``,
        the interval of the share among all that could be drawn, whose lower end takes what is
        undecided for unstable, and its upper end for stable; ``undecided``, how many verdicts are.

    Raises:
        ValueError: the study has no draws or no verdicts, or the confidence is not between 0 and 1.

    Source: the score interval (Wilson 1927).

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> over = {"delay": (0.0, 2e-3, 3), "hand_stiffness": "lognormal:300:1.5"}
        >>> study = jaxstab.study(loop, over, walls={"stiff": (20000.0, 20.0)}, samples=50)
        >>> jaxstab.shares(study).share.sel(wall="stiff").values
        array([1., 0., 0.])
    """
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence is {confidence:g}; give a number between 0 and 1.")
    if "verdict" not in study:
        raise ValueError("the study has no verdicts; give walls, and verdict among answers.")
    verdict = _drawn(study, "verdict")
    count = verdict.sizes[SAMPLE]
    stable = (verdict == Verdict.STABLE).sum(SAMPLE).compute()
    undecided = (verdict == Verdict.UNDECIDED).sum(SAMPLE).compute()
    low, _ = _score_interval(stable, count, confidence)
    _, high = _score_interval(stable + undecided, count, confidence)
    return xarray_module().Dataset(
        {"share": stable / count, "low": low, "high": high, "undecided": undecided},
        attrs={"draws": count, "confidence": confidence},
    )


def quantiles(
    study: "Dataset",
    variable: str = "largest_stiffness",
    *,
    at: Sequence[float] = (0.05, 0.5, 0.95),
) -> "DataArray":
    """Return quantiles of a variable over the draws.

    Where no wall is stable, the largest stiffness and damping count as 0; what is not known
    (NaN) is left out.

    Args:
        study: of draws, from ``jaxstab.study`` or from its file.
        variable: of the study, with the dimension ``sample``.
        at: probabilities, between 0 and 1.

    Returns:
        ``xarray.DataArray``, whose first dimension ``quantile`` takes the place of ``sample``.

    Raises:
        KeyError: the study has no such variable. ValueError: it has no draws, or a probability is
            not between 0 and 1.

    Source: the inverse of the empirical distribution function.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> study = jaxstab.study(loop, {"hand_stiffness": "uniform:100:500"}, samples=20)
        >>> low, median, high = jaxstab.quantiles(study).values
        >>> bool(low < median < high)
        True
    """
    if not all(0.0 <= share <= 1.0 for share in at):
        raise ValueError(f"at is {shortened(list(at))}; give numbers from 0 to 1.")
    if variable not in study.variables:
        names = ", ".join(map(str, study.variables))
        raise KeyError(f"{variable} is no variable of the study; it has {names}.")
    values = _drawn(study, variable).astype(np.float64).compute()
    if variable in ("largest_stiffness", "largest_damping"):
        values = values.where(study.limits_status.compute() != RegionStatus.EMPTY, 0.0)
    found = values.quantile([*at], SAMPLE, method="inverted_cdf", skipna=True)
    return found.assign_attrs(study[variable].attrs)


def lists_of(study: "Dataset") -> list[str]:
    """Return the dimensions that are lists of values: neither draws nor walls."""
    return [str(name) for name in study.dims if name not in (SAMPLE, WALL)]


def _drawn(study: "Dataset", variable: str) -> "DataArray":
    if SAMPLE not in study[variable].dims:
        raise ValueError(
            f"{variable} has no draws; let a quantity have a distribution, such as "
            "scipy.stats.norm(300.0, 100.0)."
        )
    return study[variable]


class StudyPlan(NamedTuple):
    """A study before it is computed: its table, of dask; sentences on draws, warnings, the cost."""

    table: "Dataset"
    notes: list[str]

    def compute(self) -> "Dataset":
        """Return the study."""
        return computed(self.table)


def plan_study(
    of: Any,
    over: Mapping[str, Any],
    *,
    answers: Sequence[str] | None = None,
    walls: Mapping[str, tuple[float, float]] | None = None,
    samples: int | None = None,
    seed: int = 0,
    part: tuple[int, int] = (1, 1),
) -> StudyPlan:
    """Return the plan of a study; arguments and errors as ``study``."""
    if not over:
        raise ValueError("over is empty; give at least one key that varies.")
    source = _Source(_table_of(of))
    over = {**over, **{key: own for key, own in source.ranges.items() if key not in over}}
    for key in over:
        source.check_key(key)
    given = {key: values_of(key, own) for key, own in over.items()}
    gains = source.walls if walls is None else {n: _checked_wall(n, *w) for n, w in walls.items()}
    wanted = _wanted(answers, gains)
    seconds = _seconds_of_a_loop(source, _columns(source, given, 1, seed)[0], wanted, len(gains))
    if samples is None:
        samples = _affordable(given, seconds)
    samples = checked_count("samples", samples, 1, 10_000_000)
    columns, notes = _columns(source, given, samples, seed)
    notes = source.check(columns) + notes
    notes += [
        f"{key}: drawn from the range of the scene, {words}."
        for key, words in source.ranges.items()
        if over[key] == words
    ]
    asked = _digest([source.table, wanted, gains], columns)
    columns, along, piece = _part_of(columns, part)
    numbers = np.arange(samples)[piece if along == SAMPLE else slice(None)]
    columns, draws = _different(columns)  # and the places in them of draws that repeat
    block = _Block(source, tuple(c.key for c in columns), np.array([*gains.values()]).T, wanted)
    size = max(1, min(_BLOCK // max(1, len(gains)), int(4.0 / seconds)))  # of at most 4 s
    table = _table(block, columns, gains, size)
    different = {str(name): length for name, length in table.sizes.items()}
    table = table.isel(draws).assign_attrs(
        title="Stability of haptic loops; verdicts are proved",
        source=f"jaxstab {jaxstab.__version__}, study",
        of=str(source.table),
        over=json.dumps({key: words_of(own) for key, own in over.items()}),
        seed=str(seed),
        notes="\n".join(notes),
        study=asked,
    )
    if part[1] > 1:
        table = table.assign_attrs(part=str(part[0]), parts=str(part[1]), along=along)
    if SAMPLE in table.dims:
        about = {"long_name": "number of the draw"}
        table = table.assign_coords({SAMPLE: (SAMPLE, numbers, about)})
    return StudyPlan(table, [*notes, _cost(table, different, seconds)])


def merged(paths: Sequence[Path]) -> "Dataset":
    """Return the study whose parts are in files, in any order.

    ValueError: parts are of different studies, missing or given twice; OSError: a file cannot be
    read.
    """
    parts = dict[int, tuple[Path, Any]]()
    for path in paths:
        table = read(path)
        if not {"part", "parts", "study"} <= table.attrs.keys():
            raise ValueError(f"{path} is no part of a study; give the files that --part wrote.")
        number = int(table.attrs["part"])
        first = next(iter(parts.values()), (path, table))
        if any(first[1].attrs[name] != table.attrs[name] for name in ("study", "parts")):
            raise ValueError(
                f"{path} and {first[0]} are parts of different studies; give those of one."
            )
        if number in parts:
            raise ValueError(f"{path} and {parts[number][0]} are the same part; give each once.")
        parts[number] = path, table
    if not parts:
        raise ValueError("no part is given; give the files of all parts.")
    tables = [table for _, (_, table) in sorted(parts.items())]
    about = tables[0].attrs
    missing = [k for k in range(1, int(about["parts"]) + 1) if k not in parts]
    if missing:
        raise ValueError(
            f"part {missing[0]} of {about['parts']} is missing; give the files of all parts."
        )
    same = {"data_vars": "minimal", "coords": "minimal", "compat": "override", "join": "exact"}
    whole = xarray_module().concat(tables, about["along"], combine_attrs="override", **same)
    for name in ("part", "parts", "along"):
        del whole.attrs[name]
    return whole


# What varies, checked.


class _Column(NamedTuple):
    """A key that varies: its values, what they are, and whether they are drawn."""

    key: str
    values: Values
    words: str
    unit: str
    drawn_from: Any  # None for a list

    @property
    def name(self) -> str:
        return self.key.replace(".", "_")

    @property
    def dimension(self) -> str:
        return self.name if self.drawn_from is None else SAMPLE


def _columns(
    source: "_Source", given: Mapping[str, Any], samples: int, seed: int
) -> tuple[list[_Column], list[str]]:
    """The columns that vary, those of lists first, and notes on the draws."""
    columns, notes = list[_Column](), list[str]()
    for key, own in sorted(given.items(), key=lambda pair: is_distribution(pair[1])):
        words, unit = _described(key)
        if not is_distribution(own):
            columns.append(_Column(key, own, words, unit, None))
            continue
        draws, below = draws_of(key, own, samples, seed, source.least(key))
        columns.append(_Column(key, draws, words, unit, own))
        if below > 0.0:
            notes.append(f"{key}: {100.0 * below:.2g} % of the distribution, below 0, is left out.")
    if source.is_loop and {"delay", "delay_samples"} <= given.keys():
        raise ValueError("delay is given beside delay_samples; give one.")
    names = [column.name for column in columns]
    doubled = next((n for n in names if names.count(n) > 1 or n in (SAMPLE, WALL)), None)
    if doubled is not None:
        raise ValueError(f"{doubled} is twice in over; give each key once.")
    return columns, notes


def _part_of(columns: list[_Column], part: tuple[int, int]) -> tuple[list[_Column], str, slice]:
    """Return the columns of a part, the longest dimension, and its piece."""
    index, count = part
    lengths = {column.dimension: len(column.values) for column in columns}
    along = max(lengths, key=lambda name: lengths[name])
    if not 1 <= index <= count:
        raise ValueError(f"part is {index}/{count}; give 1/{count} to {count}/{count}.")
    if count > lengths[along]:
        raise ValueError(
            f"part is {index}/{count}, and the longest dimension, {along}, has {lengths[along]} "
            "values; give fewer parts."
        )
    piece = slice(*(lengths[along] * k // count for k in (index - 1, index)))
    cut = [c._replace(values=c.values[piece]) if c.dimension == along else c for c in columns]
    return cut, along, piece


def _digest(asked: Any, columns: Sequence[_Column]) -> str:
    """Return what tells a study from others, so that their parts are not mixed up."""
    digest = sha256(repr([asked, [column.key for column in columns]]).encode())
    for column in columns:
        values = column.values
        digest.update(repr(values).encode() if isinstance(values, list) else values.tobytes())
    return digest.hexdigest()[:16]


def _different(columns: list[_Column]) -> tuple[list[_Column], dict[str, NDArray[np.int64]]]:
    """Return columns in which equal rows of CSV files are once, and the place of each draw."""
    drawn = [column for column in columns if column.drawn_from is not None]
    if not drawn or not all(isinstance(column.drawn_from, Column) for column in drawn):
        return columns, {}
    rows, again = np.unique([column.values for column in drawn], axis=1, return_inverse=True)
    once = dict(zip((column.key for column in drawn), rows, strict=True))
    return [c._replace(values=once.get(c.key, c.values)) for c in columns], {SAMPLE: again.ravel()}


def _described(key: str) -> tuple[str, str]:
    """Return what a key of a scene, or a field of a loop, is, and its unit."""
    of_loops = {field: own for own, field in reversed(_NUMBERS.items())}
    *_, section, name = ["controller", *of_loops.get(key, key).split(".")]
    section = key.split(".")[-3] if section.isdigit() else section
    table = {**TABLES, **INNER}.get(section, Table)
    entry = {entry.name: entry for entry in fields(table)}.get(name)
    return (key, "1") if entry is None else (entry.metadata["words"] or key, unit_of(entry))


def _checked_wall(name: str, stiffness: float, damping: float) -> tuple[float, float]:
    checked_label(name)
    pair = float(stiffness), float(damping)
    if not np.isfinite(pair).all():
        raise ValueError(f"wall {name} is {pair}; give finite numbers.")
    return pair


def _wanted(answers: Sequence[str] | None, gains: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the answers that are wanted, checked, each once."""
    wanted = answers or ("limits", *(["verdict"] if gains else []))
    for name in wanted:
        try:
            one_of(ANSWERS)(name)
        except ValueError as error:
            raise ValueError(f"answers has {shortened(name)}; {error}") from None
        if name != "limits" and not gains:
            raise ValueError(f"answers has {name}, which is of walls; give walls.")
    return tuple(name for name in ANSWERS if name in wanted)


def _table_of(source: Any) -> Any:
    """A loop, or the tables of a scene."""
    if isinstance(source, HapticLoop):
        return source.in_floats()
    if isinstance(source, Mapping):
        return {name: source[name] for name in source}
    if isinstance(source, str | PathLike):
        return read_table(source, "scene")
    raise TypeError(f"of is {shortened(source)}; give a scene (file or tables) or a HapticLoop.")


@dataclass(frozen=True)
class _Source:
    """The source of loops: a loop, or the tables of a scene."""

    table: Any

    @property
    def is_loop(self) -> bool:
        return isinstance(self.table, HapticLoop)

    @property
    def numbers(self) -> dict[str, str]:
        """The fields of a loop that are numbers, by their keys."""
        return {name: name for name in _NUMBERS.values()} if self.is_loop else _NUMBERS

    @property
    def units(self) -> Units:
        turns = not self.is_loop and "inertia" in self.table.get("device", {})
        return Units.ROTATION if turns else Units.LINE

    @property
    def walls(self) -> dict[str, tuple[float, float]]:
        """The walls of the scene; they are checked with it."""
        walls = {} if self.is_loop else self.table.get("walls", {})
        return {name: (wall["stiffness"], wall["damping"]) for name, wall in walls.items()}

    @property
    def ranges(self) -> dict[str, str]:
        """The ranges of the hand and of the device's mass, as uniform distributions."""
        ranges = dict[str, str]()
        for key in () if self.is_loop else _NUMBERS:
            section, _, name = key.partition(".")
            if section == "controller" or key == "device.damping":
                continue  # a range of delays is the longest one, and there is one damping
            match self.table.get(section):
                case {**keys} if isinstance(keys.get(name), list | tuple):
                    with suppress(ValueError):  # the scene refuses it later
                        low, high = Interval("")(keys[name])
                        ranges |= {key: f"uniform:{low!r}:{high!r}"} if low < high else {}
        return ranges

    def least(self, key: str) -> float:
        """The least value that can be drawn for a key."""
        return 0.0 if key in self.numbers else -inf

    def check_key(self, key: str) -> None:
        if self.is_loop:
            names = [*self.numbers, *(f.name for f in fields(HapticLoop) if f.name != "delay")]
            check_keys("", [key], list(dict.fromkeys(names)))
        elif key.partition(".")[0] in ("walls", "wanted", "contact"):
            raise ValueError(f"{key} cannot vary in a study; give a wall for each value.")

    def made(self, values: Mapping[str, Any]) -> HapticLoop:
        """The loop with these values in place of those of the source."""
        if self.is_loop:
            given = {key: value for key, value in values.items() if key != "delay_samples"}
            if "delay_samples" in values:
                period = given.get("sample_time", self.table.sample_time)
                given["delay"] = values["delay_samples"] * period
            return replace(self.table, **given)
        return loop_of(self._scene(values).at_longest_delay)

    def _scene(self, values: Mapping[str, Any]) -> Scene:
        table: Any = self.table
        if any(key.startswith("controller.delay") for key in values):  # in place of either unit
            own = table.get("controller", {}).items()
            others = {k: v for k, v in own if not k.startswith("delay") and k != "lost_samples"}
            table = {**table, "controller": others}
        for key, value in values.items():
            is_whole = isinstance(value, float) and value.is_integer()  # as a window in samples
            table = _with_value(table, key, int(value) if is_whole else value, key.split("."))
        return Scene.from_table(table)

    def check(self, columns: "Sequence[_Column]") -> list[str]:
        """Refuse bad values at the corners of what varies; return warnings of unusual values.

        Both are the sentences that a scene gives.
        """
        most_corners = 4096  # loops that are made before anything is computed
        ends = [
            list(dict.fromkeys(_few(c.values, 2 if c.key in self.numbers else most_corners)))
            for c in columns
        ]
        keys = [column.key for column in columns]
        for corner in islice(product(*ends), most_corners):
            self.made(dict(zip(keys, corner, strict=True)))
        if self.is_loop:
            return []
        outer = [self._scene(dict(zip(keys, [v[k] for v in ends], strict=True))) for k in (0, -1)]
        notes = [f"{note}." for note in dict.fromkeys(n for s in outer for n in delay_notes(s))]
        words = dict.fromkeys(words for scene in outer for words in scene.unusual())
        return notes + [f"warning: {said}{'' if said.endswith('?') else '.'}" for said in words]


def _with_value(table: Any, key: str, value: Any, path: Sequence[str]) -> Any:
    """Return a table with the value of a key; ``path`` leads there, by numbers through lists."""
    name, *inner = path
    if isinstance(table, list):
        if not (name.isdigit() and int(name) < len(table)):
            raise ValueError(f"{key} is not in the scene; that list has {len(table)} entries.")
        changed = [*table]
        changed[int(name)] = _with_value(table[int(name)], key, value, inner) if inner else value
        return changed
    if not isinstance(table, Mapping):
        raise ValueError(f"{key} is not in the scene, which has {shortened(table)} in its place.")
    own = _with_value(table.get(name, {}), key, value, inner) if inner else value
    return {**table, name: own}


def _few(values: Values, most: int) -> list[Any]:
    """Return values as Python's own; of more numbers than ``most``, the ends."""
    if isinstance(values, list):
        return values
    return values.tolist() if len(values) <= most else [values.min().item(), values.max().item()]


# What it costs.


def _seconds_of_a_loop(
    source: "_Source", columns: Sequence[_Column], wanted: Sequence[str], walls: int
) -> float:
    """The CPU time of a loop in s, from that of the kind of the first one."""
    loop = source.made({column.key: _few(column.values[:1], 1)[0] for column in columns})
    is_other = loop.device is not None
    costs = {  # CPU s of a loop and a wall (of a loop for limits): of one mass, another device
        "verdict": (1.2e-5, 4e-3),
        "limits": (1.3e-3, 0.012),
        "margins": (0.09, 0.4),
        "settling_time": (4e-3, 0.02),
        "spectral_radius": (2.5e-4, 7e-3),
    }
    return sum(costs[name][is_other] * (1 if name == "limits" else walls) for name in wanted)


def _affordable(given: Mapping[str, Any], seconds: float) -> int:
    """The number of draws that take a minute, at most the usual number."""
    drawn = [own for own in given.values() if is_distribution(own)]
    points = prod(len(own) for own in given.values() if not is_distribution(own))
    most, usual = int(60.0 / (points * seconds)), 10_000
    if drawn and all(isinstance(own, Column) for own in drawn):  # equal rows are computed once
        rows = {own.file: len(own.values) for own in drawn}
        most = usual if prod(rows.values()) <= most else most
    return max(1, min(usual, most))


def _cost(table: "Dataset", different: Mapping[str, int], seconds: float) -> str:
    """The number of loops of a study, their cost and the size of its values, as text."""
    loops = prod(length for name, length in different.items() if name != WALL)
    is_repeated = table.sizes.get(SAMPLE) != different.get(SAMPLE)
    words = f" of {different[SAMPLE]:,} different draws" if is_repeated else ""
    axes = " x ".join(f"{length} {name}" for name, length in table.sizes.items())
    return (
        f"{axes}: {loops:,} loops{words}, about {_time(loops * seconds)} of CPU time, "
        f"{max(table.nbytes / 1e6, 1e-3):.3g} MB"
    )


def _time(seconds: float) -> str:
    for limit, unit, words in ((90.0, 1.0, "s"), (5400.0, 60.0, "min")):
        if seconds < limit:
            return f"{max(seconds / unit, 1.0):.0f} {words}"
    return f"{seconds / 3600.0:.0f} h"


# What is computed.


@dataclass(frozen=True)
class _Block:
    """The function of a block: values of the keys in, variables of the answers out."""

    source: _Source
    keys: tuple[str, ...]
    gains: Floats  # (2, wall)
    answers: tuple[str, ...]

    @property
    def variables(self) -> dict[str, Variable]:
        """What the block returns; all but limits are of walls."""
        unit = self.source.units.unit
        return {
            name: own._replace(units=unit(own.units), along=() if answer == "limits" else (WALL,))
            for answer in self.answers
            for name, own in ANSWERS[answer].items()
        }

    def __call__(self, *columns: NDArray[Any]) -> tuple[NDArray[Any], ...]:
        """Return the variables, of the shape to which the columns broadcast, walls last."""
        shape = np.broadcast_shapes(*map(np.shape, columns))
        count = prod(shape)
        flat = {
            key: np.broadcast_to(column, shape).ravel()
            for key, column in zip(self.keys, columns, strict=True)
        }
        numbers = {key: flat.pop(key) for key in self.keys if key in self.source.numbers}
        found = {
            name: np.zeros((count, len(self.gains.T))[: 1 + len(variable.along)], variable.dtype)
            for name, variable in self.variables.items()
        }
        loops = dict[int, HapticLoop]()
        rows = [*_rows(flat, count)]
        for members in alike(rows):
            fixed = dict(zip(flat, rows[members[0]], strict=True))
            own = {key: values[members] for key, values in numbers.items()}
            for name, values in self._answered(fixed, own, members, loops).items():
                found[name][members] = values
        if loops:
            for name, values in _variables("limits", limits_of([*loops.values()])).items():
                found[name][[*loops]] = values
        return tuple(values.reshape(*shape, *values.shape[1:]) for values in found.values())

    def _answered(
        self,
        fixed: Mapping[str, Any],
        numbers: Mapping[str, Floats],
        members: list[int],
        loops: dict[int, HapticLoop],
    ) -> dict[str, NDArray[Any]]:
        """Return answers of loops that have filters and sampling period in common.

        Loops too few for a program of JAX of their own, and those of general devices, are put among
        ``loops`` where limits are wanted.
        """
        count = len(members)
        rows = [dict(zip(numbers, row, strict=True)) for row in _rows(numbers, count)]
        base = self.source.made({**fixed, **rows[0]})
        wants_limits = "limits" in self.answers
        if base.device is not None:
            own = [base, *(self.source.made({**fixed, **row}) for row in rows[1:])]
            loops |= dict(zip(members, own, strict=True)) if wants_limits else {}
            answers = [self._about_walls(loop) for loop in own]
            return {name: np.array([answer[name] for answer in answers]) for name in answers[0]}
        named = {self.source.numbers[key]: values for key, values in numbers.items()}
        if "delay_samples" in named:
            named["delay"] = named.pop("delay_samples") * base.sample_time
        columns: dict[str, Any] = {name: values[:, None] for name, values in named.items()}
        found = self._about_walls(replace(base, **columns))
        if wants_limits and count >= 64:  # for which ``limits_of`` runs a program of JAX
            found |= _variables("limits", limits_of(base, **named))
        elif wants_limits:
            varied = [dict(zip(named, row, strict=True)) for row in _rows(named, count)]
            own = [replace(base, **fields) for fields in varied]
            loops |= dict(zip(members, own, strict=True))
        return found

    def _about_walls(self, loop: HapticLoop) -> dict[str, NDArray[Any]]:
        """Return the answers of a loop, or of many as one, about walls."""
        values: dict[str, NDArray[Any]] = {}
        for name in self.answers:
            if name != "limits":
                values |= _variables(name, getattr(loop, name)(*self.gains))
        return values


def _rows(columns: Mapping[str, NDArray[Any]], count: int) -> Iterator[tuple[Any, ...]]:
    if not columns:
        return iter([()] * count)
    return zip(*(values.tolist() for values in columns.values()), strict=True)


def _variables(answer: str, of: Any) -> dict[str, NDArray[Any]]:
    """Return the variables of an answer by their names in a study."""
    if answer == "verdict":
        return {answer: np.asarray(of)}
    return {name: np.asarray(getattr(of, _FIELDS.get(name, name))) for name in ANSWERS[answer]}


def _table(block: _Block, columns: Sequence[_Column], gains: Mapping[str, Any], size: int) -> Any:
    """Return the answers to be computed in blocks, with what varies and walls as coordinates."""
    labels = {c.name: (c.dimension, np.asarray(c.values), c.words, c.unit) for c in columns}
    made = xarray_module().DataArray
    given = {name: made(values, dims=along) for name, (along, values, *_) in labels.items()}
    table = table_of(block, given, block.variables, size, {WALL: len(gains)})
    if WALL in table.dims:
        stiffness, damping = block.gains
        labels |= {
            WALL: (WALL, np.array([*gains]), "name of the wall", "1"),
            "wall_stiffness": (WALL, stiffness, "stiffness of the wall", "N/m"),
            "wall_damping": (WALL, damping, "damping of the wall", "N s/m"),
        }
    unit = block.source.units.unit
    return table.assign_coords(
        {
            name: (along, values, Variable(words, unit(of_line)).attributes)
            for name, (along, values, words, of_line) in labels.items()
        }
    )


def _score_interval(
    count: "DataArray", total: int, confidence: float
) -> tuple["DataArray", "DataArray"]:
    """Return Wilson's interval of a share; 0 and 1 exactly where nothing and all was counted."""
    z = NormalDist().inv_cdf(0.5 + 0.5 * confidence)
    share, weight = count / total, z * z / total
    middle = (share + 0.5 * weight) / (1.0 + weight)
    half = z * np.sqrt(share * (1.0 - share) / total + 0.25 * weight / total) / (1.0 + weight)
    low, high = middle - half, middle + half
    return low.where(count > 0, 0.0), high.where(count < total, 1.0)
