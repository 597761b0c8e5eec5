"""Studies: the answers of many devices, people and controllers as one labelled table.

A study varies keys of a scene, or fields of a loop. Each list is a separate dimension, and all
distributions share the dimension ``sample``: a study with three lists and two distributions has
four dimensions, and walls are one more. ``jaxstab.tables`` computes it block by block.

Within a block, combinations that differ in masses, dampings, stiffnesses and delays alone are one
loop that has arrays, and walls are asked of all of them at once; devices that are not one mass are
asked loop by loop. Limits of combinations with few loops are computed together, whatever their
filters. Where all draws are rows of CSV files, equal ones are computed once.

A part of a study is a piece of its longest dimension, with the draws of the whole. So it is a
smaller study, and parts are put together by ``xarray.open_mfdataset`` or by ``jaxstab study
--merge``, which tells parts of other studies by a hash of what was asked.

A distribution is a frozen one of ``scipy.stats``, or a column of a CSV file, whose rows are drawn
with replacement: the columns of one file together, so that mass and stiffness of a hand stay
together (the bootstrap, Efron 1979). Each key is drawn by the inverse of its distribution from a
stream of random numbers of its own, set by the seed and the name of the key. Its draws do not
depend on what else varies, on how many follow or on how the work is divided.
"""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from itertools import islice, product
from math import inf, log, prod
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

import jaxstab
from jaxstab import tables as t
from jaxstab.answers import Units
from jaxstab.batches import alike
from jaxstab.conventions import Verdict
from jaxstab.loop import HapticLoop, Loop, limits_of
from jaxstab.model.gain import Gain
from jaxstab.motion.bounds import SettlingStatus
from jaxstab.numbers import (
    checked,
    checked_count,
    checked_number,
    has_shape,
    listed,
    number_or_text,
)
from jaxstab.region import RegionStatus
from jaxstab.shown import shortened

if TYPE_CHECKING:
    from xarray import DataArray, Dataset


_BLOCK = 1 << 13  # loops times walls


SAMPLE, WALL, GAINS = "sample", "wall", "gains"  # dimensions


ANSWERS: dict[str, dict[str, t.Variable]] = {  # beside limits
    "verdict": {"verdict": t.Variable("whether the wall is stable, proved", "1", Verdict)},
    "margins": {
        "stiffness_gain": t.Variable("factor by which the stiffness may grow"),
        "damping_gain": t.Variable("factor by which the damping may grow"),
        "extra_delay": t.Variable("delay that may be added", "s"),
    },
    "settling_time": {
        "settling_time": t.Variable("time to settle to 2 percent", "s"),
        "settling_status": t.Variable("what is known of the settling time", "1", SettlingStatus),
    },
    "spectral_radius": {
        "spectral_radius": t.Variable("largest modulus of the poles, per sample"),
        "spectral_radius_error": t.Variable("proved bound of its error"),
    },
}


def shares(study: "Dataset", *, confidence: float = 0.95) -> "Dataset":
    """The share of draws for which each wall is proved stable, with its interval.

    Args:
        study: of draws, with verdicts, from ``jaxstab.study`` or from its file.
        confidence: of the interval, between 0 and 1.

    Returns:
        ``xarray.Dataset`` over the other dimensions: ``share`` of all draws; ``low`` and ``high``,
        the interval of the share among all that could be drawn, whose lower end takes what is
        undecided for unstable, and its upper end for stable; ``undecided``, their number.

    Raises:
        ValueError: the study has no draws or no verdicts, or the confidence is not between 0 and 1.

    Source: the score interval (Wilson 1927).

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> over = {"delay": (0.0, 2e-3, 3), "hand_stiffness": "lognormal:300:1.5"}
        >>> study = jaxstab.study(loop, over, walls={"stiff": (20000.0, 20.0)}, samples=20)
        >>> jaxstab.shares(study).share.sel(wall="stiff").values
        array([1., 0., 0.])
    """
    confidence = checked_number("confidence", confidence)
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence is {confidence:g}; give a number between 0 and 1.")
    _require_table(study)
    if "verdict" not in study:
        raise ValueError("the study has no verdicts; give walls, and verdict among answers.")
    verdict = _drawn(study, "verdict").drop_attrs(deep=False)  # counts are no verdicts
    count = verdict.sizes[SAMPLE]
    stable = (verdict == Verdict.STABLE).sum(SAMPLE).compute()
    undecided = (verdict == Verdict.UNDECIDED).sum(SAMPLE).compute()

    from scipy.stats import binomtest  # it takes longer to import than a study of few loops

    def ends(stable: Any) -> tuple[float, float]:
        return (*binomtest(int(stable), count).proportion_ci(confidence, "wilson"),)

    xarray = t.xarray_module()
    of_each = partial(xarray.apply_ufunc, ends, vectorize=True, output_core_dims=[[], []])
    (low, _), (_, high) = of_each(stable), of_each(stable + undecided)
    return xarray.Dataset(
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
        KeyError: the study has no such variable. ValueError: it has no draws, it has codes, or a
            probability is not between 0 and 1.

    Source: the inverse of the empirical distribution function.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> study = jaxstab.study(loop, {"hand_stiffness": "uniform:100:500"}, samples=20)
        >>> low, median, high = jaxstab.quantiles(study).values
        >>> bool(low < median < high)
        True
    """
    shares_below = np.ravel(checked("at", at, 0.0, 1.0))
    _require_table(study)
    is_limit = sense_of(str(variable)) == "largest"
    for name in (variable, "limits_status")[: 1 + is_limit]:
        if str(name) not in study.variables:
            names = ", ".join(map(str, study.variables))
            raise KeyError(f"{name} is no variable of the study; it has {names}.")
    if "flag_values" in study[variable].attrs:
        raise ValueError(f"{variable} has codes, not numbers; jaxstab.shares counts verdicts.")
    values = _drawn(study, variable).astype(np.float64).compute()
    if is_limit:
        values = values.where(study.limits_status.compute() != RegionStatus.EMPTY, 0.0)
    found = values.quantile(shares_below, SAMPLE, method="inverted_cdf", skipna=True)
    return found.assign_attrs(study[variable].attrs)


def lists_of(study: "Dataset") -> list[str]:
    """Return the dimensions that are lists of values: neither draws nor walls or gains."""
    return [str(name) for name in study.dims if name not in (SAMPLE, WALL, GAINS)]


def walls_in(study: "Dataset") -> str:
    """Return the dimension of walls, or of pairs of gains."""
    return GAINS if GAINS in study.dims else WALL


def limit_in(study: "Dataset") -> str | None:
    """Return the first limit of a study, such as ``largest_stiffness``, if it has limits."""
    return next(filter(sense_of, map(str, study.data_vars)), None)


def sense_of(variable: str) -> str:
    """Return "largest" or "least" for a limit of that sense; "" for another variable."""
    sense, _, gain = variable.partition("_")
    return sense if gain and sense in ("largest", "least") else ""


def summary(study: "Dataset", *, is_small: bool) -> Iterator[tuple[str, "Dataset | None", str]]:
    """Yield what is printed of a study: words, numbers, and the limit that these are of.

    Of lists it is the table, if that is small, and how many loops are stable with each wall; of
    draws the quantiles of a limit, and shares of stable walls.
    """
    walls, limit = walls_in(study), limit_in(study)
    of_walls = [
        name for name, own in study.coords.items() if own.dims == (walls,) and name != walls
    ]
    if SAMPLE not in study.dims:
        if is_small:
            yield "", study.drop_vars(of_walls), ""
        for wall in study[walls].values if "verdict" in study else ():
            codes = study.verdict.sel({walls: wall})
            stable, undecided = (codes == Verdict.STABLE).sum(), (codes == Verdict.UNDECIDED).sum()
            counts = f"{stable.item():,} of {codes.size:,} loops, {undecided.item():,} undecided"
            yield f"{wall}: stable for {counts}", None, ""
        return
    draws = f"{study.sizes[SAMPLE]:,} draws"
    if limit:
        found: Any = quantiles(study, limit)
        found = found if found.ndim > 1 else found.expand_dims({"": [draws]})
        named = {0.05: "5th percentile", 0.5: "median", 0.95: "95th percentile"}
        words = f"{limit.replace('_', ' ')} in {found.units}, over {draws}:"
        yield words, found.to_dataset("quantile").rename(named), limit
    if "verdict" in study:
        found = shares(study).drop_vars(of_walls)
        percent = 100.0 * found[["share", "low", "high"]]
        words = f"proved stable in % of {draws}, with the 95 % confidence interval:"
        yield words, percent.rename(share="stable").assign(undecided=found.undecided), ""


def _require_table(study: Any) -> None:
    if not isinstance(study, t.xarray_module().Dataset):
        raise TypeError(
            f"study is {shortened(study)}; give the xarray.Dataset of jaxstab.study or of its file."
        )


def _drawn(study: "Dataset", variable: str) -> "DataArray":
    if not study[variable].sizes.get(SAMPLE):
        raise ValueError(
            f"{variable} has no draws; let a quantity have a distribution, such as "
            "scipy.stats.norm(300.0, 100.0)."
        )
    return study[variable]


def plan_study(
    source: "Source",
    over: Mapping[str, Any],
    *,
    answers: Sequence[str] | None = None,
    walls: Mapping[str, tuple[float, float]] | None = None,
    samples: int | None = None,
    seed: int = 0,
    part: tuple[int, int] = (1, 1),
) -> tuple["Dataset", list[str]]:
    """The table of a study, not yet computed, and sentences: on draws, warnings, the cost.

    Arguments and errors as ``study``.
    """
    varied: Any = over
    if not isinstance(varied, Mapping) or not all(isinstance(key, str) for key in varied):
        raise TypeError(f"over is {shortened(over)}; give lists of values by the keys that vary.")
    if not over:
        raise ValueError("over is empty; give at least one key that varies.")
    for key in over:
        source.check_key(key)
    ranges = {key: own for key, own in source.ranges.items() if key not in over}
    given = {key: values_of(key, own) for key, own in {**over, **ranges}.items()}
    gains = source.walls if walls is None else _checked_walls(walls)
    wanted = _wanted(answers, gains, source.answers)
    seconds = _seconds_of_a_loop(source, given, wanted, len(gains))
    if samples is None:  # those that take a minute
        points = prod(len(own) for own in given.values() if not is_distribution(own))
        samples = max(1, min(10_000, int(60.0 / (points * seconds))))
    samples = checked_count("samples", samples, 1, 10_000_000)
    seed = checked_count("seed", seed, 0, 2**64)
    columns, notes = _columns(source, given, samples, seed)
    notes = source.check(columns) + notes
    notes += [f"{key}: drawn from the range of the scene, {own}." for key, own in ranges.items()]
    columns, about, begin = _part_of(columns, part, [source.table, wanted, gains])
    different, draws = _different(columns, given)
    block = _Block(source, (*columns,), np.array([*gains.values()]).T, wanted)
    size = max(1, min(_BLOCK // max(1, len(gains)), int(4.0 / seconds)))  # of at most 4 s
    table = _table(block, different, gains, size)
    loops = prod(length for name, length in table.sizes.items() if name != WALL)
    table = table.isel(draws).assign_attrs(
        title="Stability of haptic loops; verdicts are proved",
        source=f"jaxstab {jaxstab.__version__}, study",
        of=str(source.table),
        over=json.dumps({key: words_of(own) for key, own in {**over, **ranges}.items()}),
        seed=str(seed),
        notes="\n".join(notes),
        **about,
    )
    if SAMPLE in table.dims:
        numbers = begin + np.arange(table.sizes[SAMPLE])
        table = table.assign_coords(
            {SAMPLE: (SAMPLE, numbers, {"long_name": "number of the draw"})}
        )
    if source.has_gains and WALL in table.dims:
        table = table.rename({WALL: GAINS})
    axes = " x ".join(f"{length} {name}" for name, length in table.sizes.items())
    start = min(0.02 * loops, 10.0) * ("limits" in wanted)  # a few one by one, or to compile
    cost = f"{axes}: {loops:,} loops, about {_time(loops * seconds + start)} of CPU time"
    return table, [*notes, f"{cost}, {max(table.nbytes / 1e6, 1e-3):.3g} MB"]


def merged(paths: Sequence[Path]) -> "Dataset":
    """Return the study whose parts are in files, in any order.

    ValueError: parts are of different studies, missing or given twice; OSError: a file cannot be
    read.
    """
    part = r"(\d{1,7}) of ((\d{1,7}) along (\w+) of study .*)"  # as an attribute of its table
    parts, about, along = dict[int, tuple[Path, Any]](), "1", ""
    if not paths:
        raise ValueError("no file is given; give those of all parts.")
    for path in paths:
        table = t.read(path)
        found = re.fullmatch(part, str(table.attrs.pop("part", "")))
        if found is None:
            raise ValueError(f"{path} is no part of a study; give the files that --part wrote.")
        number, own, along = int(found[1]), found[2], found[4]
        first, _ = next(iter(parts.values()), (path, table))
        if parts and own != about:
            raise ValueError(
                f"{path} and {first} are parts of different studies; give those of one."
            )
        if number in parts:
            raise ValueError(f"{path} and {parts[number][0]} are the same part; give each once.")
        parts[number], about = (path, table), own
    count = int(about.split()[0])
    missing = next((k for k in range(1, count + 1) if k not in parts), None)
    if missing is not None:
        raise ValueError(f"part {missing} of {count} is missing; give the files of all parts.")
    tables = [table for _, (_, table) in sorted(parts.items())]
    same = {"data_vars": "minimal", "coords": "minimal", "compat": "override", "join": "exact"}
    return t.xarray_module().concat(tables, along, combine_attrs="override", **same)


# Values: lists, and draws from distributions.


@dataclass(frozen=True)
class CsvColumn:
    """A column of a CSV file."""

    file: str
    name: str
    values: tuple[float, ...]


def is_distribution(given: Any) -> bool:
    """True if values can be drawn from it."""
    return isinstance(given, CsvColumn) or (hasattr(given, "ppf") and hasattr(given, "kwds"))


def words_of(given: Any) -> str:
    """A variation in words: a distribution with its parameters, or some of the values."""
    if isinstance(given, CsvColumn):
        return f"csv:{given.file}:{given.name}"
    if is_distribution(given):
        pairs = (f"{name}={value}" for name, value in given.kwds.items())
        return f"{given.dist.name}({', '.join([*map(str, given.args), *pairs])})"
    return shortened(given)


def values_of(key: str, given: Any) -> Any:
    """Return the distribution or the values that are given for a key, checked.

    A list, ``(low, high, count)``, a distribution, or one of these as a text: ``VALUE,VALUE,...``,
    ``LOW:HIGH:COUNT``, ``normal:300:100``. ValueError: it is none of these, or not finite; OSError:
    a file cannot be read.
    """
    if isinstance(given, tuple) and len(given) == 3 and isinstance(given[2], int):
        given = ":".join(map(str, given))
    given = distribution_of(given) or listed(key, given) if isinstance(given, str) else given
    if is_distribution(given):
        return given
    if not (isinstance(given, Sequence) or np.ndim(given)):
        raise ValueError(
            f"{key} is {shortened(given)}; give a list of values, (low, high, count), or a "
            "distribution such as scipy.stats.norm(300.0, 100.0)."
        )
    values = list(given)
    if not values:
        raise ValueError(f"{key} is an empty list; give at least one value.")
    if all(isinstance(value, str) for value in values):
        return values
    try:
        numbers = np.array(values, np.float64)
        if numbers.ndim > 1:
            raise TypeError
    except (TypeError, ValueError, OverflowError):
        raise ValueError(
            f"{key} is {shortened(values)}; give numbers, or texts, not both."
        ) from None
    if not np.isfinite(numbers).all():
        raise ValueError(f"{key} is {shortened(numbers.tolist())}; give finite numbers.")
    return numbers


def distribution_of(text: str) -> Any:
    """Return the distribution of a text such as ``normal:300:100``; None where it is none.

    ValueError: its numbers are bad, or its file has no such column; OSError: it cannot be read.
    """
    from scipy import stats

    kind, *parts = text.split(":")
    if kind == "csv" and len(parts) >= 2:
        file, column = ":".join(parts[:-1]), parts[-1]
        values = tuple(t.columns_of(file, [column])[column])
        if not values:
            raise ValueError(f"{file} has no rows below its names; give measured values.")
        return CsvColumn(file, column, values)
    if not parts or isinstance(number_or_text(kind), float):
        return None
    with suppress(ValueError):
        a, b = map(float, parts)
        match kind:
            case "normal":
                return stats.norm(a, b)
            case "uniform":
                return stats.uniform(a, b - a)
            case "lognormal" if b > 1.0:
                return stats.lognorm(log(b), scale=a)
    raise ValueError(
        f"{shortened(text)} is no distribution; give normal:MEAN:DEVIATION, uniform:LOW:HIGH, "
        "lognormal:MEDIAN:FACTOR with a FACTOR above 1, or csv:FILE:COLUMN."
    )


def draws_of(
    key: str, given: Any, count: int, seed: int, least: float = -inf
) -> tuple[Float64[np.ndarray, " draw"], float]:
    """Return draws of a quantity that is at least a number, and the share that is cut off below it.

    ValueError: the distribution begins below that number, or most of it lies there; or its
    parameters make no draws.
    """
    stream = f"{given.file} of {len(given.values)}" if isinstance(given, CsvColumn) else key
    uniform = np.random.default_rng([seed, *stream.encode()]).random(count)
    if isinstance(given, CsvColumn):
        draws = np.array(given.values)[(uniform * len(given.values)).astype(np.int64)]
        low, below = draws.min(), 0.0
    else:
        with np.errstate(all="ignore"):  # parameters may be anything
            low, _ = given.support()
            if np.ndim(low):
                raise ValueError(f"{key} is {words_of(given)}; give a distribution of one number.")
            below = float(given.cdf(np.nextafter(least, -inf)))
            draws = np.asarray(given.ppf(below + (1.0 - below) * uniform), np.float64)
    if -inf < low < least or below > 0.5:
        raise ValueError(
            f"{key} has draws below {least:g}, which a scene refuses; give a distribution that "
            "stays above, such as a lognormal one."
        )
    if not np.isfinite(draws).all():
        raise ValueError(
            f"{key} has draws that are not finite; correct the parameters of {words_of(given)}."
        )
    return draws, below


# What varies, checked.


Columns = dict[str, "DataArray"]  # by the keys that vary, each along its own name or the draws


def _columns(
    source: "Source", given: Mapping[str, Any], samples: int, seed: int
) -> tuple[Columns, list[str]]:
    """The columns that vary, those of lists first, and notes on the draws."""
    made, columns, notes = t.xarray_module().DataArray, Columns(), list[str]()
    for key, own in sorted(given.items(), key=lambda pair: is_distribution(pair[1])):
        name, below = key.replace(".", "_"), 0.0
        if is_distribution(own):
            least = 0.0 if key in source.numbers else -inf
            draws, below = draws_of(key, own, samples, seed, least)
            columns[key] = made(draws, dims=SAMPLE, name=name)
        else:
            columns[key] = made(np.asarray(own), dims=name, name=name)
        if below > 0.0:
            notes.append(f"{key}: {100.0 * below:.2g} % of the distribution, below 0, is left out.")
    names = [str(column.name) for column in columns.values()]
    doubled = next((n for n in names if names.count(n) > 1 or n in (SAMPLE, WALL)), None)
    if doubled is not None:
        raise ValueError(f"{doubled} is twice in over; give each key once.")
    return columns, notes


def _part_of(
    columns: Columns, part: tuple[int, int], asked: Any
) -> tuple[Columns, dict[str, str], int]:
    """Return the columns of a part, the attribute that says of what it is, and its first draw."""
    index, count = part
    lengths = {column.dims[0]: column.size for column in columns.values()}
    along = max(lengths, key=lambda name: lengths[name])
    if not 1 <= index <= count:
        raise ValueError(f"part is {index}/{count}; give 1/{count} to {count}/{count}.")
    if count > lengths[along]:
        raise ValueError(
            f"part is {index}/{count}, and the longest dimension, {along}, has {lengths[along]} "
            "values; give fewer parts."
        )
    if count == 1:
        return columns, {}, 0
    digest = sha256(repr([asked, [*columns]]).encode())
    for column in columns.values():
        digest.update(column.values.tobytes())
    piece = slice(*(lengths[along] * k // count for k in (index - 1, index)))
    cut = {k: own.isel({along: piece}, missing_dims="ignore") for k, own in columns.items()}
    about = f"{index} of {count} along {along} of study {digest.hexdigest()[:16]}"
    return cut, {"part": about}, piece.start if along == SAMPLE else 0


def _different(
    columns: Columns, given: Mapping[str, Any]
) -> tuple[Columns, dict[str, NDArray[np.int64]]]:
    """Return columns in which equal rows of CSV files are once, and the place of each draw."""
    drawn = [key for key, column in columns.items() if SAMPLE in column.dims]
    if not drawn or not all(isinstance(given[key], CsvColumn) for key in drawn):
        return columns, {}
    rows = [columns[key].values for key in drawn]
    _, first, again = np.unique(rows, axis=1, return_index=True, return_inverse=True)
    once = {key: columns[key].isel({SAMPLE: first}) for key in drawn}
    return columns | once, {SAMPLE: again.ravel()}


def _checked_walls(walls: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    if not isinstance(walls, Mapping):
        raise TypeError(f"walls is {shortened(walls)}; give (K, B) by the name of each wall.")
    for name, wall in walls.items():
        if not has_shape(wall, 2):
            raise TypeError(f"wall {name} is {shortened(wall)}; give its K and B.")
    return {
        t.checked_label(name): (
            checked_number(f"the stiffness of wall {name}", stiffness),
            checked_number(f"the damping of wall {name}", damping),
        )
        for name, (stiffness, damping) in walls.items()
    }


def _wanted(
    answers: Sequence[str] | None, gains: Mapping[str, Any], known: Mapping[str, Any]
) -> tuple[str, ...]:
    """Return the answers that are wanted, checked, each once."""
    wanted = answers or ("limits", *(["verdict"] if gains else []))
    wanted = [wanted] if isinstance(wanted, str) else wanted
    t.check_keys("answers", map(str, wanted), [*known])
    of_walls = [name for name in wanted if name != "limits"]
    if of_walls and not gains:
        raise ValueError(f"answers has {of_walls[0]}, which is of walls; give walls.")
    return tuple(name for name in known if name in wanted)


# Where loops come from.


@dataclass(frozen=True)
class Source:
    """The source of the loops of a study: here one loop, whose fields vary."""

    table: Any
    """What the loops are made from; its text is kept with the study."""

    has_gains: ClassVar[bool] = False
    """Whether the pairs that are judged are called gains, not walls."""

    @property
    def gains(self) -> tuple[Gain, Gain]:
        """The gains of the loops."""
        return HapticLoop.gains

    @property
    def numbers(self) -> Mapping[str, str]:
        """The fields of a loop that are numbers, by their keys."""
        return {name: name for name in _FIELDS if name != "sample_time"}

    @property
    def answers(self) -> dict[str, dict[str, t.Variable]]:
        """The answers that may be asked for, by name."""
        (first, second), limits = self.gains, dict[str, t.Variable]()
        for own, other in ((first, second), (second, first)):
            name = f"{own.sense} {own.name}"
            limits[name.replace(" ", "_")] = t.Variable(f"{name} of stable gains", own.unit)
            limits[f"at_{other.name}"] = t.Variable(f"{other.name} at the {name}", other.unit)
        limits["limits_status"] = t.Variable("what is known of the limits", "1", RegionStatus)
        return {"verdict": ANSWERS["verdict"], "limits": limits, **ANSWERS}

    @property
    def units(self) -> Units:
        """The units of the answers."""
        return Units.LINE

    @property
    def walls(self) -> dict[str, tuple[float, float]]:
        """The pairs of gains that are judged if none are given, by name."""
        return {}

    @property
    def ranges(self) -> dict[str, str]:
        """What varies if nothing else is said of it: distributions by their keys."""
        return {}

    def check_key(self, key: str) -> None:
        """Refuse a key that cannot vary: ValueError."""
        if key in ("velocity", "position", "device"):
            raise ValueError(
                f"{key} cannot vary in a study of a loop; give a scene, of which the numbers "
                "of its filters and device can, or ask limits_of for a list of loops."
            )
        t.check_keys("", [key], [*_FIELDS])

    def described(self, key: str) -> tuple[str, str]:
        """The description and the unit of a key."""
        return _FIELDS[key]

    def made(self, values: Mapping[str, Any]) -> Any:
        """The loop with these values in place of those of the source."""
        return _with(self.table, values)

    def check(self, columns: Columns) -> list[str]:
        """Refuse bad values at the corners of what varies; return ``notes`` on the outer ones."""
        ends = {key: np.unique(own.values) for key, own in columns.items()}
        for key, values in ends.items():  # all values of a few, the first and the last of others
            few = 2 if key in self.numbers else 64
            ends[key] = (values if len(values) <= few else values[[0, -1]]).tolist()
        most_corners = 4096  # loops that are made before anything is computed
        for corner in islice(product(*ends.values()), most_corners):
            self.made(dict(zip(ends, corner, strict=True)))
        return self.notes([{key: own[k] for key, own in ends.items()} for k in (0, -1)])

    def notes(self, outer: Sequence[Mapping[str, Any]]) -> list[str]:
        """Sentences on the lowest and the highest values: what answers hold for, warnings."""
        return []


_FIELDS = {  # of a loop
    "device_mass": ("mass of the device", "kg"),
    "device_damping": ("damping of the device", "N s/m"),
    "hand_mass": ("mass of the hand", "kg"),
    "hand_stiffness": ("stiffness of the hand", "N/m"),
    "hand_damping": ("damping of the hand", "N s/m"),
    "delay": ("delay", "s"),
    "delay_samples": ("delay", "samples"),
    "sample_time": ("sampling period", "s"),
}


def _with(loop: Any, given: Mapping[str, Any]) -> Any:
    """Return a loop with other fields; ``delay_samples`` are of its sampling period."""
    own = {**given}
    if "delay_samples" in own:
        if "delay" in own:
            raise ValueError("delay is given beside delay_samples; give one.")
        own["delay"] = own.pop("delay_samples") * own.get("sample_time", loop.sample_time)
    return replace(loop, **own) if own else loop


# What it costs.


def _seconds_of_a_loop(
    source: Source, given: Mapping[str, Any], wanted: Sequence[str], walls: int
) -> float:
    """The CPU time of a loop in s, from that of the kind of the first one."""
    columns, _ = _columns(source, given, 1, 0)
    loop = source.made({key: column[0].item() for key, column in columns.items()})
    is_other = isinstance(loop, Loop) or loop.device is not None
    costs = {  # CPU s of a loop and a wall (of a loop for limits): of one mass, another device
        "verdict": (1.2e-5, 4e-3),
        "limits": (1.3e-3, 0.012),
        "margins": (0.09, 0.4),
        "settling_time": (4e-3, 0.02),
        "spectral_radius": (2.5e-4, 7e-3),
    }
    return sum(costs[name][is_other] * (1 if name == "limits" else walls) for name in wanted)


def _time(seconds: float) -> str:
    for limit, unit, words in ((90.0, 1.0, "s"), (5400.0, 60.0, "min")):
        if seconds < limit:
            return f"{max(seconds / unit, 1.0):.0f} {words}"
    return f"{seconds / 3600.0:.0f} h"


# What is computed.


@dataclass(frozen=True)
class _Block:
    """The function of a block: values of the keys in, variables of the answers out."""

    source: Source
    keys: tuple[str, ...]
    gains: NDArray[np.float64]  # (2, wall)
    answers: tuple[str, ...]

    @property
    def variables(self) -> dict[str, t.Variable]:
        """The variables that the block returns; all but limits are of walls."""
        unit = self.source.units.unit
        return {
            name: own._replace(units=unit(own.units), along=() if answer == "limits" else (WALL,))
            for answer in self.answers
            for name, own in self.source.answers[answer].items()
        }

    def __call__(self, *columns: NDArray[Any]) -> tuple[NDArray[Any], ...]:
        """Return the variables, of the shape to which the columns broadcast, walls last."""
        shape = np.broadcast_shapes(*map(np.shape, columns))
        count = prod(shape)
        flat = {
            key: np.broadcast_to(column, shape).ravel()
            for key, column in zip(self.keys, columns, strict=True)
        }
        found = {
            name: np.zeros((count, len(self.gains.T))[: 1 + len(variable.along)], variable.dtype)
            for name, variable in self.variables.items()
        }

        def tell(answer: str, members: list[int], of: Any) -> None:
            # The fields of an answer have the order of its variables.
            values = [of] if answer == "verdict" else of
            if answer == "margins":
                values = of.stiffness_gain, of.damping_gain, of.extra_delay
            for name, own in zip(self.source.answers[answer], values, strict=False):
                found[name][members] = np.asarray(own)

        def made(row: int) -> Any:
            return self.source.made({key: own[row].item() for key, own in flat.items()})

        names, first = (gain.name for gain in self.source.gains), made(0)
        pairs: Any = dict(zip(names, self.gains, strict=False))  # without walls there are none
        is_one_mass = isinstance(first, HapticLoop) and first.device is None
        numbers = self.source.numbers if is_one_mass else {}  # of others each is by itself
        others = [values.tolist() for key, values in flat.items() if key not in numbers]
        alone = dict[int, Any]()
        for members in alike(zip(*others, strict=True) if others else [()] * count):
            base = made(members[0])
            varied = {numbers[key]: own[members] for key, own in flat.items() if key in numbers}
            for answer in self.answers:
                if answer != "limits":
                    stack = _with(base, {name: own[:, None] for name, own in varied.items()})
                    tell(answer, members, getattr(stack, answer)(**pairs))
                elif varied and len(members) >= 64:  # ``limits_of`` runs a program of JAX
                    tell(answer, members, limits_of(_with(base, varied)))
                else:
                    for k in members:
                        row = {numbers[key]: flat[key][k].item() for key in flat if key in numbers}
                        alone[k] = _with(base, row)
        if alone:
            tell("limits", [*alone], limits_of([*alone.values()]))
        return tuple(values.reshape(*shape, *values.shape[1:]) for values in found.values())


def _table(block: _Block, columns: Columns, gains: Mapping[str, Any], size: int) -> "Dataset":
    """Return the answers to be computed in blocks, with what varies and walls as coordinates."""
    table = t.table_of(block, columns, block.variables, size, {WALL: len(gains)})
    labels: dict[str, Any] = {
        str(own.name): (own.dims, own.values, *block.source.described(key))
        for key, own in columns.items()
    }
    if WALL in table.dims:
        what = "gains" if block.source.has_gains else "wall"
        labels[WALL] = WALL, np.array([*gains]), f"name of the {what}", "1"
        for own, values in zip(block.source.gains, block.gains, strict=True):
            labels[f"{what}_{own.name}"] = WALL, values, f"{own.name} of the {what}", own.unit
    unit = block.source.units.unit
    return table.assign_coords(
        {
            name: (along, values, t.Variable(words, unit(of_line)).attributes)
            for name, (along, values, words, of_line) in labels.items()
        }
    )
