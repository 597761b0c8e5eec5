"""Studies: the answers of many devices, people and controllers as one labelled table.

A study varies keys of a scene, or fields of a loop. Each list is a separate dimension, and all
distributions share the dimension ``sample``: a study with three lists and two distributions has
four dimensions, and walls are one more. The table is a ``Dataset``: computed in blocks by any
executor, resumed, in parts, and read by xarray.

Within a block, a scene is made for each combination of the values that decide the filters and the
sampling period. Masses, dampings, stiffnesses and delays are arrays beside the resulting loop:
verdicts, radii, margins and settling times are computed for all of them at once. Limits are
computed for all loops of the block together, whatever their filters. If every distribution is
measured data, equal rows are drawn repeatedly, and each is computed once in a block. Walls on
devices that are not one mass are computed loop by loop.
"""

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import islice, product
from math import prod
from os import PathLike
from pathlib import Path
from shutil import rmtree
from statistics import NormalDist
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Any, NamedTuple
from weakref import finalize

import numpy as np
from jaxtyping import Int64
from numpy.typing import NDArray

import jaxstab
from jaxstab.conventions import Verdict
from jaxstab.loop import HapticLoop, limits_of
from jaxstab.motion.settling import SettlingStatus
from jaxstab.numbers import checked_count
from jaxstab.region import RegionStatus
from jaxstab.scene.answers import delay_notes
from jaxstab.scene.draws import Distribution, Measured, Uniform, draws_of
from jaxstab.scene.loops import loop_of
from jaxstab.scene.scene import Scene, Units
from jaxstab.shown import shortened
from jaxstab.tables import check_keys, checked_label, interval, one_of, read_table

if TYPE_CHECKING:
    from xarray import Dataset as XarrayDataset

    from jaxstab.datasets import Block, Dataset, Header
    from jaxstab.tiles import Progress

Floats = NDArray[np.float64]
Values = list[Any] | NDArray[Any]

MOST_SAMPLES = 10_000_000
_MOST_CORNERS = 4096  # loops that are made before anything is computed
_BLOCK = 1 << 13  # loops times walls
SAMPLE, WALL = "sample", "wall"  # dimensions

_NUMBERS = {  # keys of a scene that are numbers of a loop: the field, the words, the unit
    "device.mass": ("device_mass", "mass of the device", "kg"),
    "device.inertia": ("device_mass", "moment of inertia of the device", "kg"),
    "device.damping": ("device_damping", "damping of the device", "N s/m"),
    "hand.mass": ("hand_mass", "mass of the hand", "kg"),
    "hand.inertia": ("hand_mass", "moment of inertia of the hand", "kg"),
    "hand.stiffness": ("hand_stiffness", "stiffness of the hand", "N/m"),
    "hand.damping": ("hand_damping", "damping of the hand", "N s/m"),
    "controller.delay": ("delay", "delay", "s"),
    "controller.delay_samples": ("delay_samples", "delay", "samples"),
}
_RANGES = tuple(key for key in _NUMBERS if "mass" in key or "inertia" in key or key[:5] == "hand.")
_DELAYS = ("controller.delay", "controller.delay_samples")
_OF_LOOPS = {field: (field, words, unit) for field, words, unit in _NUMBERS.values()} | {
    "delay": ("delay", "delay", "s")
}
_OTHER_UNITS = {"sample_time": "s", "window": "s", "cutoff": "Hz", "frequency": "Hz"}

_LIMITS = {-1: "not_computed"} | {status.value: status.name.lower() for status in RegionStatus}
_VERDICTS = {verdict.value: verdict.name.lower() for verdict in Verdict}
_SETTLING = {status.value: status.name.lower() for status in SettlingStatus}

ANSWERS: dict[str, dict[str, tuple[Any, ...]]] = {  # variables: type, words, unit, codes
    "verdict": {"verdict": ("int8", "whether the wall is stable, proved", "1", _VERDICTS)},
    "limits": {
        "largest_stiffness": ("float64", "largest stiffness of a stable wall", "N/m"),
        "at_damping": ("float64", "damping at the largest stiffness", "N s/m"),
        "largest_damping": ("float64", "largest damping of a stable wall", "N s/m"),
        "at_stiffness": ("float64", "stiffness at the largest damping", "N/m"),
        "limits_status": ("int8", "what is known of the stable walls", "1", _LIMITS),
    },
    "margins": {
        "stiffness_gain": ("float64", "factor by which the stiffness may grow", "1"),
        "damping_gain": ("float64", "factor by which the damping may grow", "1"),
        "extra_delay": ("float64", "delay that may be added", "s"),
    },
    "settling_time": {
        "settling_time": ("float64", "time to settle to 2 percent", "s"),
        "settling_status": ("int8", "what is known of the settling time", "1", _SETTLING),
    },
    "spectral_radius": {
        "spectral_radius": ("float64", "largest modulus of the poles, per sample", "1"),
        "spectral_radius_error": ("float64", "proved bound of its error", "1"),
    },
}
_FIELDS: dict[str, tuple[str, ...]] = {  # those of what loops answer, in the order of variables
    "limits": ("stiffness", "at_damping", "damping", "at_stiffness", "status"),
    "margins": tuple(ANSWERS["margins"]),
    "settling_time": ("value", "status"),
    "spectral_radius": ("value", "error"),
}
_COSTS = {  # CPU seconds of a loop and a wall (of a loop for limits): of one mass, another device
    "verdict": (1e-5, 5e-3),
    "limits": (8e-4, 6e-3),
    "margins": (9e-4, 0.8),
    "settling_time": (5e-4, 0.012),
    "spectral_radius": (3e-4, 0.012),
}


class Shares(NamedTuple):
    """The share of draws for which a wall is stable, with a confidence interval.

    Attributes:
        share: proved stable, of all draws, over the other dimensions and the walls.
        low, high: the interval of the share among all that could be drawn: its lower end takes
            what is undecided for unstable, its upper end for stable.
        undecided: how many verdicts are.
        draws: their number.
        confidence: of the interval.

    Example:
        >>> jaxstab.results.Shares(*map(np.array, (0.9, 0.89, 0.91, 0)), 4000, 0.95).share
        array(0.9)
    """

    share: Floats
    low: Floats
    high: Floats
    undecided: Int64[np.ndarray, "*grid"]
    draws: int
    confidence: float


@dataclass(frozen=True)
class Study:
    """A study on disk; ``jaxstab.study`` computes one and ``jaxstab.open_study`` opens one.

    Attributes:
        path: of the file, netCDF-4.
        is_temporary: whether the file goes when the study does.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> study = jaxstab.study(loop, over={"device_mass": [0.1, 0.2]})
        >>> study.lists, study.dimensions
        (['device_mass'], {'device_mass': array([0.1, 0.2])})
        >>> study.units["at_damping"], study.long_names["at_damping"]
        ('N s/m', 'damping at the largest stiffness')
        >>> study.values("largest_stiffness").round().tolist()
        [70643.0, 139265.0]
        >>> study.open().largest_stiffness.dims
        ('device_mass',)
        >>> over = {"delay": [0.0, 1e-3], "hand_stiffness": jaxstab.Normal(300.0, 100.0)}
        >>> study = jaxstab.study(loop, over=over, walls={"a": (2e4, 20.0)}, samples=100)
        >>> study.columns()["verdict"][:, 0].tolist()
        [['stable'], ['unstable']]
        >>> shares = study.shares()
        >>> bool((shares.low <= shares.share).all() and (shares.share <= shares.high).all())
        True
        >>> low, median, high = study.quantiles()
        >>> bool((low < median).all() and (median < high).all())
        True
    """

    path: Path
    is_temporary: bool = False

    def open(self) -> "XarrayDataset":
        """Open the table as an ``xarray.Dataset``, whose values are read when they are used.

        Those of a temporary file are read at once.

        ModuleNotFoundError: xarray or h5netcdf is missing. OSError: the file cannot be read.
        """
        import xarray

        opened = xarray.open_dataset(self.path, engine="h5netcdf")
        if not self.is_temporary:
            return opened
        with opened:
            return opened.load()

    @cached_property
    def _header(self) -> "Header":
        from jaxstab.datasets import header_of

        return header_of(self.path)

    @property
    def dimensions(self) -> dict[str, NDArray[Any]]:
        """The values along each dimension, by its name; of ``sample``, numbers from 0."""
        names = dict.fromkeys(name for own in self._header.dimensions.values() for name in own)
        return {name: self._header.coordinates[name] for name in names}

    @property
    def lists(self) -> list[str]:
        """The dimensions that are lists of values: neither draws nor walls."""
        return [name for name in self.dimensions if name not in (SAMPLE, WALL)]

    @property
    def units(self) -> dict[str, str]:
        """The units of the variables and coordinates, by name."""
        return self._header.units

    @property
    def long_names(self) -> dict[str, str]:
        """The descriptions of the variables and coordinates, by name."""
        return self._header.long_names

    def values(self, name: str) -> NDArray[Any]:
        """Return the values of a variable or of what was drawn, whole.

        KeyError: the study has no such variable. OSError: the file cannot be read.
        """
        from jaxstab.datasets import values

        self._require(name)
        return values(self.path, name)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return dimensions, draws and answers as the columns of a table, with codes as words.

        Returns:
            An array for each name, of the shape of the whole grid: lists, then ``sample`` and
            ``wall`` if there are any. Units: ``units``.
        """
        grid, variables = self.dimensions, self._header.dimensions
        order = [*self.lists, *(name for name in (SAMPLE, WALL) if name in grid)]
        coded = {name: own for answer in ANSWERS.values() for name, own in answer.items()}
        labels = (name for name in variables if name not in coded)
        columns = {}
        for name in [*order, *labels, *(name for name in coded if name in variables)]:
            own, values = variables.get(name, (name,)), self.values(name)
            if len(coded.get(name, ())) > 3:
                words = coded[name][3]
                values = np.array([words.get(code, "") for code in range(max(words) + 1)])[values]
            lengths = [len(grid[axis]) if axis in own else 1 for axis in order]
            shape = [len(grid[axis]) for axis in order]
            columns[name] = np.broadcast_to(values.reshape(lengths), shape)
        return columns

    def shares(self, *, confidence: float = 0.95) -> Shares:
        """Return the share of draws for which each wall is proved stable, with its interval.

        Args:
            confidence: of the interval, between 0 and 1.

        Returns:
            Shares of the shape of all dimensions but ``sample``, walls last.

        Raises:
            ValueError: the study has no draws or no verdicts, or is a part, or the confidence is
                not between 0 and 1.

        Source: the score interval (Wilson 1927).
        """
        from jaxstab.datasets import chunks

        if not 0.0 < confidence < 1.0:
            raise ValueError(f"confidence is {confidence:g}; give a number between 0 and 1.")
        dimensions, axis = self._drawn("verdict")
        lengths = [len(self.dimensions[name]) for name in dimensions]
        count = lengths.pop(axis)
        stable, open_ = np.zeros((2, *lengths), np.int64)
        for block, codes in chunks(self.path, "verdict"):
            place = block[:axis] + block[axis + 1 :]
            stable[place] += (codes == Verdict.STABLE).sum(axis=axis)
            open_[place] += (codes == Verdict.UNDECIDED).sum(axis=axis)
        low, _ = _score_interval(stable, count, confidence)
        _, high = _score_interval(stable + open_, count, confidence)
        return Shares(stable / count, low, high, open_, count, confidence)

    def quantiles(
        self, variable: str = "largest_stiffness", *, at: Sequence[float] = (0.05, 0.5, 0.95)
    ) -> Floats:
        """Return quantiles of a variable over the draws.

        Where no wall is stable, the largest stiffness and damping count as 0; what is not known
        (NaN) is left out.

        Args:
            variable: of the study, with the dimension ``sample``.
            at: probabilities, between 0 and 1.

        Returns:
            float64 array, (probability, *all dimensions of the variable but ``sample``).

        Raises:
            KeyError: the study has no such variable. ValueError: it has no draws, or is a part, or
            a probability is not between 0 and 1.

        Source: the inverse of the empirical distribution function.
        """
        chosen = np.asarray(at, np.float64)
        if not ((chosen >= 0.0) & (chosen <= 1.0)).all():
            raise ValueError(f"at is {shortened(list(at))}; give numbers from 0 to 1.")
        _, axis = self._drawn(variable)
        numbers = self.values(variable).astype(np.float64)
        if variable in ("largest_stiffness", "largest_damping"):
            numbers[self.values("limits_status") == RegionStatus.EMPTY] = 0.0
        quantiles = np.nanquantile(numbers, chosen, axis=axis, method="inverted_cdf")
        return np.asarray(quantiles, np.float64)

    def _require(self, name: str) -> None:
        names = [*self._header.dimensions, *self._header.coordinates]
        if name not in names:
            raise KeyError(f"{name} is no variable of the study; it has {', '.join(names)}.")

    def _drawn(self, variable: str) -> tuple[tuple[str, ...], int]:
        """Return the dimensions of a variable, and which of them are the draws."""
        if "part" in self._header.attributes:
            raise ValueError(f"{self.path} is a part of a study; merge all parts first.")
        if variable == "verdict" and variable not in self._header.dimensions:
            raise ValueError("the study has no verdicts; give walls, and verdict among answers.")
        self._require(variable)
        dimensions = self._header.dimensions.get(variable, ())
        if SAMPLE not in dimensions:
            raise ValueError(
                f"{variable} has no draws; let a quantity have a distribution, such as "
                "jaxstab.Normal(300.0, 100.0)."
            )
        return dimensions, dimensions.index(SAMPLE)


def open_study(path: str | PathLike[str]) -> Study:
    """Open the file of a study.

    Args:
        path: of a file that ``jaxstab.study`` or ``jaxstab study`` wrote.

    Returns:
        Study.

    Raises:
        OSError: the file cannot be read. ValueError: it is of something else.

    Source: none.

    Example:
        >>> jaxstab.open_study("nothing.h5")
        Traceback (most recent call last):
        FileNotFoundError: [Errno 2] cannot read nothing.h5: No such file or directory.
    """
    made = Study(Path(path))
    if "over" not in made._header.attributes:
        raise ValueError(f"{path} is no study.")
    return made


def study(
    of: "HapticLoop | Mapping[str, Any] | str | PathLike[str]",
    over: Mapping[str, Any],
    *,
    answers: Sequence[str] | None = None,
    walls: Mapping[str, tuple[float, float]] | None = None,
    samples: int = 10_000,
    seed: int = 0,
    store: str | PathLike[str] | None = None,
    part: tuple[int, int] = (1, 1),
    progress: "Progress | None" = None,
    executor: Executor | None = None,
) -> Study:
    """Answer for many devices, people and controllers, as one labelled table.

    An interrupted study continues where it stopped when it is called again with the same ``store``,
    and one that is done is opened. The file is the same however the work was divided.

    Args:
        of: a scene (a file, or its tables) or a loop.
        over: what varies, by keys of the scene such as "hand.stiffness", or by fields of the loop:
            a list of values, (low, high, count), or a distribution such as ``jaxstab.Normal``.
            Lists span a grid; distributions are drawn together, ``samples`` times at each of its
            points.
        answers: of "limits", "verdict", "margins", "settling_time", "spectral_radius"; all but the
            first are of walls. By default limits, and verdicts if there are walls.
        walls: stiffness and damping in SI units by name; those of the scene by default.
        samples: the number of draws.
        seed: of the draws, a whole number >= 0.
        store: the file; without one it is temporary, and goes when the study does.
        part: (3, 64) computes the third of 64 parts, with a ``store``; see ``merge_studies``.
        progress: called with the number of finished blocks and of all blocks.
        executor: any ``concurrent.futures.Executor``; one of processes must not fork them. Without
            one, the dask ``Client`` of this process computes; without a client, this process.

    Returns:
        Study.

    Raises:
        ValueError: a key is unknown, a value is refused by the scene, or a distribution reaches
            where the scene forbids. FileExistsError: another file is at ``store``; OSError: it
            cannot be written; RuntimeError: workers died, or are of other code.

    Source: the answers' own, see ``HapticLoop``.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> over = {"delay": (0.0, 2e-3, 3), "hand_stiffness": jaxstab.LogNormal(300.0, 1.5)}
        >>> study = jaxstab.study(loop, over=over, walls={"stiff": (20000.0, 20.0)}, samples=50)
        >>> study.shares().share.ravel()
        array([1., 0., 0.])
    """
    from jaxstab.datasets import ensure

    if store is None and part != (1, 1):
        raise ValueError("part is given without store; give the file of the part.")
    folder = mkdtemp(prefix="jaxstab-study-") if store is None else None
    path = Path(folder, "study.h5") if folder else Path(str(store))
    made = Study(path, is_temporary=folder is not None)
    if folder is not None:
        finalize(made, rmtree, folder, ignore_errors=True)
    dataset = study_dataset(
        of, over, path, answers=answers, walls=walls, samples=samples, seed=seed, part=part
    )
    ensure(dataset, progress, executor)
    return made


def merge_studies(parts: Sequence[str | PathLike[str]], store: str | PathLike[str]) -> Study:
    """Put the parts of a study together.

    Args:
        parts: the files of all parts, in any order.
        store: the file of the whole.

    Returns:
        Study, with the values of one that was computed in one part.

    Raises:
        ValueError: parts are of different studies, missing or given twice. FileExistsError: another
            file is at ``store``; OSError: a file cannot be read or written.

    Source: none.

    Example:
        >>> jaxstab.merge_studies([], "study.h5")
        Traceback (most recent call last):
        ValueError: no part is given; give the files of all parts.
    """
    from jaxstab.datasets import merged

    merged([Path(file) for file in parts], Path(store))
    return Study(Path(store))


def study_dataset(
    of: Any,
    over: Mapping[str, Any],
    path: Path,
    *,
    answers: Sequence[str] | None = None,
    walls: Mapping[str, tuple[float, float]] | None = None,
    samples: int = 10_000,
    seed: int = 0,
    part: tuple[int, int] = (1, 1),
) -> "Dataset":
    """Return the dataset of a study; arguments and errors as ``study``."""
    from jaxstab.datasets import Dataset, Variable

    index, count = part
    if not 1 <= index <= count:
        raise ValueError(f"part is {index}/{count}; give 1/{count} to {count}/{count}.")
    if not over:
        raise ValueError("over is empty; give at least one key that varies.")
    source = _Source(_table_of(of))
    drawn_ranges = {key: own for key, own in source.ranges.items() if key not in over}
    over = {**over, **drawn_ranges}
    samples = checked_count("samples", samples, 1, MOST_SAMPLES)
    columns, notes = _columns(source, over, samples, seed)
    notes += [
        f"{key}: drawn uniformly from the range of the scene, {own.low:g} to {own.high:g}."
        for key, own in drawn_ranges.items()
    ]
    notes = source.check([(column.key, column.values) for column in columns]) + notes
    gains = source.walls if walls is None else {n: _checked_wall(n, *w) for n, w in walls.items()}
    wanted = tuple(dict.fromkeys(answers or ("limits", *(["verdict"] if gains else []))))
    for name in wanted:
        try:
            one_of(ANSWERS)(name)
        except ValueError as error:
            raise ValueError(f"answers has {shortened(name)}; {error}") from None
        if name != "limits" and not gains:
            raise ValueError(f"answers has {name}, which is of walls; give walls.")
    has_walls = wanted != ("limits",)
    drawn = [column for column in columns if column.is_drawn]
    repeats = bool(drawn) and all(isinstance(over[c.key], Measured) for c in drawn)
    coordinates = {c.name: np.asarray(c.values) for c in columns if not c.is_drawn}
    if drawn:
        coordinates[SAMPLE] = np.arange(samples)
    own_dimensions = tuple(coordinates)
    if has_walls:
        coordinates[WALL] = np.array([*gains])
    unit = source.units.unit
    variables = {c.name: Variable("", c.words, unit(c.unit)) for c in columns}
    if drawn:
        variables[SAMPLE] = Variable("", "number of the draw", "1")
    labels = {c.name: (SAMPLE, np.asarray(c.values)) for c in drawn}
    if has_walls:
        variables[WALL] = Variable("", "name of the wall", "1")
        for k, (name, words, symbol) in enumerate(
            (
                ("wall_stiffness", "stiffness of the wall", "N/m"),
                ("wall_damping", "damping of the wall", "N s/m"),
            )
        ):
            labels[name] = (WALL, np.array([pair[k] for pair in gains.values()]))
            variables[name] = Variable("", words, unit(symbol))
    for name in wanted:
        lacks = (WALL,) if name == "limits" and has_walls else ()
        for variable, (kind, words, symbol, *codes) in ANSWERS[name].items():
            flags = codes[0] if codes else {}
            variables[variable] = Variable(kind, words, unit(symbol), flags, lacks)
    said = json.dumps({k: shortened(v) if np.ndim(v) else str(v) for k, v in over.items()})
    return Dataset(
        path=path,
        coordinates=coordinates,
        variables=variables,
        attributes={
            "title": "Stability of haptic loops; verdicts are proved",
            "source": f"jaxstab {jaxstab.__version__}, study",
            "of": str(source.table),
            "over": said,
            "seed": str(seed),
            "notes": "\n".join(notes),
        },
        identity=repr([source.table, [*over], wanted, gains, seed]),
        compute=_Blocks(source, tuple(columns), own_dimensions, gains, wanted, repeats),
        size=max(_BLOCK, len(gains)),
        labels=labels,
        part=part,
    )


def plan_of(dataset: "Dataset") -> str:
    """The number of loops of a study, their cost and the largest size of its file, as text."""
    blocks = dataset.compute
    assert isinstance(blocks, _Blocks)
    share = len(dataset.items) / len(dataset.blocks)
    loops = prod(len(dataset.coordinates[name]) for name in blocks.dimensions)
    walls = max(len(blocks.walls), 1)
    computed, words = share * loops, ""
    if blocks.repeats:
        count = len(blocks.different(slice(None))[0])
        computed *= min(count / dataset.chunk[blocks.dimensions.index(SAMPLE)], 1.0)
        words = f" (of {count:,} different draws, each computed once in a block)"
    first = {column.key: _few(column.values[:1], 1)[0] for column in blocks.columns}
    is_other = blocks.source.made(first).device is not None
    seconds = computed * sum(
        _COSTS[name][is_other] * (1 if name == "limits" else walls) for name in blocks.answers
    )
    drawn = sum(column.nbytes for _, column in dataset.labels.values())
    bytes_ = drawn + share * sum(
        np.dtype(variable.dtype).itemsize * prod(dataset.own(variable, dataset.shape))
        for variable in dataset.computed.values()
    )
    axes = " x ".join(f"{len(values)} {name}" for name, values in dataset.coordinates.items())
    split = "" if share == 1.0 else f", part {dataset.part[0]} of {dataset.part[1]} of them"
    return (
        f"{axes}: {loops:,} loops{words}{split}, about {_time(seconds)} of CPU time, "
        f"at most {max(bytes_ / 1e6, 1e-3):.3g} MB"
    )


def _time(seconds: float) -> str:
    for limit, unit, words in ((90.0, 1.0, "s"), (5400.0, 60.0, "min")):
        if seconds < limit:
            return f"{max(seconds / unit, 1.0):.0f} {words}"
    return f"{seconds / 3600.0:.0f} h"


# What varies, checked.


class _Column(NamedTuple):
    """A key that varies: its values, what they are, and whether they are drawn."""

    key: str
    values: Values
    words: str
    unit: str
    is_drawn: bool

    @property
    def name(self) -> str:
        return self.key.replace(".", "_")

    @property
    def dimension(self) -> str:
        return SAMPLE if self.is_drawn else self.name


def _columns(
    source: "_Source", over: Mapping[str, Any], samples: int, seed: int
) -> tuple[list[_Column], list[str]]:
    """The columns that vary, and notes on the draws."""
    columns, notes = list[_Column](), list[str]()
    for key, given in over.items():
        source.check_key(key)
        other_unit = _OTHER_UNITS.get(key.rpartition(".")[2], "1")
        _, words, unit = source.numbers.get(key, ("", key, other_unit))
        if isinstance(given, Distribution):
            least = 0.0 if key in source.numbers else -np.inf
            values, again = draws_of(key, given, samples, seed, least)
            if again:
                share = 100.0 * again / samples
                notes.append(f"{key}: {share:.2g} % of the draws were below 0 and drawn again.")
            columns.append(_Column(key, values, words, unit, is_drawn=True))
        else:
            listed = _listed(key, given)
            if key not in source.numbers and not isinstance(listed, list):
                is_whole = (listed == np.rint(listed)) & (abs(listed) < 2.0**53)  # as a window is
                listed = listed.astype(np.int64) if is_whole.all() else listed
            columns.append(_Column(key, listed, words, unit, is_drawn=False))
    if source.is_loop and {"delay", "delay_samples"} <= {*over}:
        raise ValueError("delay is given beside delay_samples; give one.")
    names = [column.name for column in columns]
    doubled = next((n for n in names if names.count(n) > 1 or n in (SAMPLE, WALL)), None)
    if doubled is not None:
        raise ValueError(f"{doubled} is twice in over; give each key once.")
    return columns, notes


def _listed(key: str, given: Any) -> Values:
    """Return the values of a list or of (low, high, count)."""
    if isinstance(given, tuple) and len(given) == 3 and isinstance(given[2], int):
        low, high, count = given
        if count < 2:
            raise ValueError(f"{key} is {given}; give (low, high, count) with a count >= 2.")
        with np.errstate(all="ignore"):  # ends so far apart overflow
            return _finite(key, np.linspace(float(low), float(high), count))
    if isinstance(given, str) or not np.ndim(given):
        raise ValueError(
            f"{key} is {shortened(given)}; give a list of values, (low, high, count), or a "
            "distribution such as jaxstab.Normal(300.0, 100.0)."
        )
    values = list(given)
    if not values:
        raise ValueError(f"{key} is an empty list; give at least one value.")
    if all(isinstance(value, str) for value in values):
        return values
    try:
        numbers = np.array(values, np.float64)
    except (TypeError, ValueError):
        raise ValueError(
            f"{key} is {shortened(values)}; give numbers, or texts, not both."
        ) from None
    return _finite(key, numbers)


def _finite(key: str, values: Floats) -> Floats:
    if not np.isfinite(values).all():
        raise ValueError(f"{key} is {shortened(values.tolist())}; give finite numbers.")
    return values


def _checked_wall(name: str, stiffness: float, damping: float) -> tuple[float, float]:
    checked_label(name)
    pair = float(stiffness), float(damping)
    if not np.isfinite(pair).all():
        raise ValueError(f"wall {name} is {pair}; give finite numbers.")
    return pair


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
    def numbers(self) -> dict[str, tuple[str, str, str]]:
        """The keys that are numbers of a loop."""
        return _OF_LOOPS if self.is_loop else _NUMBERS

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
    def ranges(self) -> dict[str, Uniform]:
        """The ranges of the hand and of the device's mass, as uniform distributions."""
        uniform = dict[str, Uniform]()
        for key in () if self.is_loop else _RANGES:
            section, _, name = key.partition(".")
            match self.table.get(section):
                case {**keys} if isinstance(keys.get(name), list | tuple):
                    with suppress(ValueError):  # the scene refuses it later
                        low, high = interval("")(keys[name])
                        uniform |= {key: Uniform(low, high)} if low < high else {}
        return uniform

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
        if any(key in _DELAYS for key in values):  # in place of one in either unit
            own = table.get("controller", {}).items()
            others = {k: v for k, v in own if not k.startswith("delay") and k != "lost_samples"}
            table = {**table, "controller": others}
        for key, value in values.items():
            is_whole = isinstance(value, float) and value.is_integer()  # as a window in samples
            table = _with_value(table, key, int(value) if is_whole else value, key.split("."))
        return Scene.from_table(table)

    def check(self, columns: Sequence[tuple[str, Values]]) -> list[str]:
        """Refuse bad values at the corners of what varies; return warnings of unusual values.

        Both are the sentences that a scene gives.
        """
        ends = [
            list(dict.fromkeys(_few(values, 2 if key in self.numbers else _MOST_CORNERS)))
            for key, values in columns
        ]
        keys = [key for key, _ in columns]
        for corner in islice(product(*ends), _MOST_CORNERS):
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


# What is computed.


@dataclass(frozen=True)
class _Blocks:
    """Blocks of a study: where loops come from, what varies, the dimensions, walls, answers."""

    source: _Source
    columns: tuple[_Column, ...]
    dimensions: tuple[str, ...]  # but that of walls
    walls: Mapping[str, tuple[float, float]]
    answers: tuple[str, ...]
    repeats: bool  # whether every distribution is measured data, so that rows are drawn again

    def __call__(self, block: "Block") -> dict[str, NDArray[Any]]:
        """Return the answers of a block; equal measured draws are computed once."""
        spans = dict(zip(self.dimensions, block, strict=False))
        indices = {name: np.arange(span.start, span.stop) for name, span in spans.items()}
        if self.repeats:
            unique, again = self.different(spans[SAMPLE])
            indices[SAMPLE] = indices[SAMPLE][unique]
        answers = self._computed(indices)
        if self.repeats:
            axis = self.dimensions.index(SAMPLE)
            answers = {name: np.take(values, again, axis) for name, values in answers.items()}
        return answers

    def different(self, span: slice) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the indices of draws that differ, and for each draw which of them it equals."""
        draws = np.stack([column.values[span] for column in self.columns if column.is_drawn])
        _, unique, again = np.unique(draws, axis=1, return_index=True, return_inverse=True)
        return unique, again.ravel()

    def _computed(self, indices: Mapping[str, NDArray[np.int64]]) -> dict[str, NDArray[Any]]:
        """Return the answers at the points of a grid of indices along the dimensions."""
        shape = tuple(map(len, indices.values()))
        places = dict(zip(indices, np.indices(shape).reshape(len(shape), -1), strict=True))
        numbers, others = dict[str, Floats](), dict[str, tuple[Values, NDArray[np.int64]]]()
        for column in self.columns:
            own, place = column.values, indices[column.dimension][places[column.dimension]]
            if column.key in self.source.numbers:
                numbers[column.key] = np.asarray(own)[place]
            else:
                others[column.key] = own, place
        answers = {
            name: np.zeros(
                (prod(shape), *((len(self.walls),) if answer != "limits" else ())), variable[0]
            )
            for answer in self.answers
            for name, variable in ANSWERS[answer].items()
        }
        keys = np.array([place for _, place in others.values()], np.int64)
        keys = keys.reshape(len(others), prod(shape))
        _, unique, group = np.unique(keys, axis=1, return_index=True, return_inverse=True)
        loops = np.empty(prod(shape), object)
        for k, row in enumerate(unique.tolist()):
            members = np.flatnonzero(group.ravel() == k)
            fixed = {
                key: own[place[row]] if isinstance(own, list) else own[place[row]].item()
                for key, (own, place) in others.items()
            }
            given = {key: values[members] for key, values in numbers.items()}
            for name, values in self._answered(fixed, given, members, loops).items():
                answers[name][members] = values
        if "limits" in self.answers:
            every = limits_of(list(loops))  # batches are of loops with any filters
            answers |= _variables("limits", every)
        return {name: values.reshape(*shape, *values.shape[1:]) for name, values in answers.items()}

    def _answered(
        self,
        fixed: Mapping[str, Any],
        numbers: Mapping[str, Floats],
        members: NDArray[np.int64],
        loops: NDArray[Any],
    ) -> dict[str, NDArray[Any]]:
        """Return answers about walls, of loops that have filters and sampling period in common.

        Where limits are wanted, the loops are put among ``loops``.
        """
        count = len(members)
        rows = [dict(zip(numbers, row, strict=True)) for row in _rows(numbers, count)]
        base = self.source.made({**fixed, **rows[0]})
        gains = np.array([*self.walls.values()]).reshape(-1, 2).T
        if base.device is not None:
            own = [base, *(self.source.made({**fixed, **row}) for row in rows[1:])]
            loops[members] = own
            answers = [_about_walls(loop, gains, self.answers) for loop in own]
            return {name: np.array([answer[name] for answer in answers]) for name in answers[0]}
        named = {self.source.numbers[key][0]: values for key, values in numbers.items()}
        if "delay_samples" in named:
            named["delay"] = named.pop("delay_samples") * base.sample_time
        if "limits" in self.answers:
            varied = _rows(named, count)
            loops[members] = [replace(base, **dict(zip(named, row, strict=True))) for row in varied]
        columns: dict[str, Any] = {name: values[:, None] for name, values in named.items()}
        return _about_walls(replace(base, **columns), gains, self.answers)


def _rows(numbers: Mapping[str, Floats], count: int) -> Any:
    if not numbers:
        return iter([()] * count)
    return zip(*(values.tolist() for values in numbers.values()), strict=True)


def _about_walls(
    loop: HapticLoop, gains: Floats, answers: Sequence[str]
) -> dict[str, NDArray[Any]]:
    """Return the answers of a loop, or of many as one, about walls."""
    values: dict[str, NDArray[Any]] = {}
    for name in answers:
        if name != "limits":
            values |= _variables(name, getattr(loop, name)(*gains))
    return values


def _variables(answer: str, of: Any) -> dict[str, NDArray[Any]]:
    """Return the variables of an answer by their names in a study."""
    columns = [of] if answer == "verdict" else [getattr(of, name) for name in _FIELDS[answer]]
    return dict(zip(ANSWERS[answer], map(np.asarray, columns), strict=True))


def _score_interval(
    count: Int64[np.ndarray, "*grid"], total: int, confidence: float
) -> tuple[Floats, Floats]:
    """Return Wilson's interval of a share; 0 and 1 exactly where nothing and all was counted."""
    z = NormalDist().inv_cdf(0.5 + 0.5 * confidence)
    share, weight = count / total, z * z / total
    middle = (share + 0.5 * weight) / (1.0 + weight)
    half = z * np.sqrt(share * (1.0 - share) / total + 0.25 * weight / total) / (1.0 + weight)
    low, high = middle - half, middle + half
    return np.where(count == 0, 0.0, low), np.where(count == total, 1.0, high)
