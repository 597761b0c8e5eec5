"""Tables: TOML files, checked key by key; columns of CSV files; arrays over named dimensions.

Tables of TOML become frozen dataclasses. Errors are one sentence: the key, its value and the
allowed values.

Labelled tables are computed in blocks by dask, and kept as netCDF-4. A function of plain arrays is
applied to columns, which are labelled: ``xarray.apply_ufunc`` cuts the grid of their dimensions
into blocks, and dask computes these where it is told to: in threads or processes
(``dask.config.set(scheduler="processes")``), or by the workers of the ``distributed.Client`` that
is open. By default one block follows another in this process, as the programs of JAX in a block use
all cores and the memory is that of one block.

Nothing is kept of a table that is not finished. A finished one is written to memory, and then in
one step to a path at which nothing may have appeared meanwhile.
"""

import csv
import os
import re
import sys
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, Field, dataclass, field, fields
from difflib import get_close_matches
from enum import IntEnum
from functools import partial
from io import StringIO
from math import inf, isfinite
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeVar

from jaxstab.conventions import AXES
from jaxstab.durable import (
    is_memory_short,
    named_errors,
    replacing,
    require_no_output,
    target_of,
    write_all,
)
from jaxstab.shown import printable, shortened

if TYPE_CHECKING:
    from xarray import DataArray, Dataset


Made = TypeVar("Made", bound="Table")
Check = Callable[[Any], Any]
"""It returns the value to store, or raises a ValueError that says what is allowed."""

MOST_BYTES = 4_000_000
"""Of a TOML file: more would take minutes to read."""

MOST_LETTERS = 64
"""Of a name."""


def read_table(path: str | PathLike[str], kind: str) -> dict[str, Any]:
    """Read a TOML file as it is; one of another ``kind`` ("scene", "specification") is refused."""
    table = parsed(text_of(path, MOST_BYTES), f"{path}: ")
    for other, (keys, words) in _KINDS.items():
        if kind != other and keys & {*table} and not _KINDS[kind][0] & {*table}:
            raise ValueError(f"{path} is {words}")
    return table


_KINDS = {
    "scene": (
        {"device", "controller", "hand", "walls", "loop"},
        "a scene; jaxstab limits, check, tune, design and guard take it, and jaxstab atlas spec "
        "--scene prints the specification of its atlas.",
    ),
    "specification": (
        {*AXES, "rows", "fields"},
        "the specification of an atlas; jaxstab atlas build --spec takes it.",
    ),
}
"""The keys by which kinds of files are told apart, what they are and who takes them."""


def text_of(path: str | PathLike[str], most: int) -> str:
    """The text of a UTF-8 file ("-": stdin), ``most`` bytes at most, without a byte order mark."""
    source = "stdin" if str(path) == "-" else path
    if source == "stdin" and sys.stdin is None:
        raise ValueError("stdin is closed; redirect a file to it, or give the name of one.")
    require_no_output(0 if source == "stdin" else path)
    try:
        with sys.stdin.buffer if source == "stdin" else Path(path).open("rb") as stream:
            data = stream.read(most + 1)
        if data.startswith(b"\x89HDF\r\n\x1a\n"):
            raise ValueError(
                f"{source} is HDF5, not text; jaxstab atlas info, query, verify and plot take "
                "atlases, study --merge parts of studies."
            )
        if len(data) > most:
            raise ValueError(f"{source} has more than {most / 1e6:g} MB; give a smaller file.")
        return data.decode("utf-8-sig")
    except OSError as error:
        raise OSError(
            error.errno, f"cannot read {source}: {error.strerror}; name a file that can be read."
        ) from error
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ValueError(
            f"{source}: line {line} is not UTF-8 text; save the file as UTF-8."
        ) from error


def columns_of(
    file: str | PathLike[str], columns: Sequence[str], optional: Sequence[str] = ()
) -> dict[str, list[float]]:
    """Return columns of a CSV file ("-": stdin) with a header; optional ones may be missing.

    ValueError: a column is missing or there twice, or holds anything but finite numbers.
    """
    source = "stdin" if str(file) == "-" else file
    stream = StringIO(text_of(file, most=100_000_000), newline="")
    lines = csv.reader(stream, skipinitialspace=True)
    numbers: dict[str, list[float]] = {}
    try:
        names = [name.strip() for name in next(lines, [])]
        for column in columns:
            if column not in names:
                listed = shortened(", ".join(names))
                hint = "" if len(names) > 1 else ", and names in the first line need commas between"
                raise ValueError(
                    f"{source} has no column {column!r}; its columns are {listed}{hint}."
                )
        numbers |= {name: [] for name in (*columns, *optional) if name in names}
        for column in numbers:
            if names.count(column) > 1:
                raise ValueError(f"{column} is the name of two columns of {source}; leave one out.")
        for row in filter(None, lines):
            if any(row[len(names) :]):  # of numbers with a decimal comma, for instance
                raise ValueError(
                    f"{source}, line {lines.line_num} has {len(row)} values, but the first line "
                    f"{len(names)} names; give one value a column, with a decimal point."
                )
            for column, values in numbers.items():
                index = names.index(column)
                cell = row[index] if index < len(row) else ""
                try:
                    values.append(float(cell))
                except ValueError:
                    values.append(inf)
                if not isfinite(values[-1]):
                    raise ValueError(
                        f"{source}, line {lines.line_num}: {column} is {shortened(cell)}; give a "
                        "finite number."
                    )
    except csv.Error as error:
        raise ValueError(f"{source}, line {lines.line_num} is not CSV: {error}.") from error
    return numbers


def parsed(text: str, source: str = "") -> dict[str, Any]:
    """The tables of a TOML text; ValueError, with the source, for bad TOML or too deep nesting."""
    try:
        # tomllib's time is the square of a key's parts.
        if re.search(r"(?:\.[^.,=\n]{1,64}){100}", text):
            raise RecursionError
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError(f"{source}it is nested too deeply; use fewer levels of tables.") from None
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{source}this is not TOML: {error}.") from error
    except ValueError as error:  # of a whole number
        raise ValueError(
            f"{source}a number has thousands of digits; give one that a float64 can hold."
        ) from error


class Usual(NamedTuple):
    """The usual range of a quantity, and that in a device that turns, if another."""

    low: float
    high: float
    turning: tuple[float, float] | None = None


MASSES, INERTIAS, PERIODS = Usual(1e-3, 50.0), Usual(1e-8, 50.0), Usual(1e-5, 0.05)
"""The usual masses of devices in kg, inertias in kg m^2, and sampling periods in s."""


def key(
    check: Check, default: Any = MISSING, usual: Usual | None = None, *, words: str = ""
) -> Any:
    """Return the field of a Table for a key: the check of its value, its usual range, what it is.

    A key that has ``words`` is an option of the commands, too.
    """
    return field(default=default, metadata={"check": check, "usual": usual, "words": words})


def unit_of(entry: Field[Any]) -> str:
    """Return the unit of a key, "1" where it has none."""
    return getattr(entry.metadata["check"], "unit", "1")


@dataclass(frozen=True, kw_only=True)
class Table:
    """A checked table of a file; ValueError on the first value that is not allowed."""

    has_options: ClassVar[bool] = True
    """False where the options of the keys are those of another table."""

    def __post_init__(self) -> None:
        _checked_values(type(self), vars(self))

    @classmethod
    def from_table(cls: type[Made], table: Any, place: str = "") -> Made:
        """Check a table of a file at a place; ValueError on the first bad key."""
        if not isinstance(table, Mapping):
            raise ValueError(f"{place} is {shortened(table)}; {_example(cls, table)}.")
        check_keys(place, table, [entry.name for entry in fields(cls)])
        try:
            values = _checked_values(cls, cls.filled_in(table))
            for entry in fields(cls):
                if entry.name not in values and entry.default is MISSING:
                    raise ValueError(f"{entry.name} is missing; give it {cls.asked(entry.name)}.")
            return cls(**values)
        except ValueError as error:
            raise ValueError(_path(place, str(error))) from None

    @classmethod
    def filled_in(cls, table: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return a table with its values expanded."""
        return table

    @classmethod
    def asked(cls, name: str) -> str:
        """The words for a key that is missing: its unit, and its option if it has one."""
        entry = cls.__dataclass_fields__[name]
        words = "a value" if unit_of(entry) == "1" else f"in {unit_of(entry)}"
        is_option = entry.metadata["words"] and cls.has_options
        return f"{words} (--{name.replace('_', '-')})" if is_option else words

    def quantities(self, place: str) -> Iterator[tuple[str, float, str, Usual]]:
        """Yield name, value, unit and usual range of each quantity, those inside included."""
        for entry in fields(self):
            value, usual = getattr(self, entry.name), entry.metadata["usual"]
            is_list = isinstance(value, tuple)
            for index, own in enumerate(value if is_list else (value,)):
                name = f"{place}.{entry.name}"
                if isinstance(own, Table):
                    yield from own.quantities(f"{name}.{index}" if is_list else name)
                elif usual is not None and own is not None:
                    yield name, own, unit_of(entry), usual


_WALL = "give the stiffness or the damping of a wall, [walls.NAME]."
_PID = 'an integrator is another loop: give [loop] with kind = "pid" and one of kp, ki and kd.'
_NONE = "this kind of [loop] has none: leave out"
_INSTEAD = {
    "controller": {
        "kp": _WALL,
        "kd": _WALL,
        "ki": _PID,
        "rate": "give sample_time, which is 1/rate in s.",
    },
    "walls": {"kp": "give stiffness.", "kd": "give damping.", "ki": _PID},
    "": {
        "time_constant": "give cutoff, which is 1/(2 pi time_constant) in Hz.",
        "velocity": "give [controller.velocity].",
        "gains": "give [walls.NAME], or [loop] for another loop than that of a wall.",
        "walls": "give [gains.NAME] beside [loop] (--set gains.NAME.KEY=VALUE), and no --wall.",
        "device": f"{_NONE} [device] and --device, --mass, --inertia and --damping.",
        "hand": f"{_NONE} [hand] and --hand-mass, --hand-inertia, --hand-stiffness and "
        "--hand-damping.",
        "controller": f"{_NONE} [controller], --rate, --sample-time, --delay and the like; times "
        "are keys of [loop] (--set loop.KEY=VALUE).",
    },
}
"""What to give in place of keys of other programs or loops, by the table in which they stand."""


def check_keys(place: str, keys: Iterable[str], allowed: list[str]) -> None:
    """Refuse a key that is not allowed; say what to give, or suggest the most similar one."""
    for name in map(str, keys):
        if name not in allowed:
            near = _similar(name, allowed)
            hint = f"did you mean {near!r}?" if near else f"known are {', '.join(allowed)}."
            hint = _INSTEAD.get(place.partition(".")[0], {}).get(name, hint)
            unknown = shortened(name) if len(name) > MOST_LETTERS else printable(name)
            raise ValueError(f"{_path(place, unknown)} is unknown; {hint}")


def with_value(table: Any, key: str, value: Any, path: Sequence[str]) -> Any:
    """Return a table with the value of a key; ``path`` leads there, by numbers through lists."""
    name, *inner = path
    if isinstance(table, list):
        if not (name.isdigit() and int(name) < len(table)):
            raise ValueError(f"{key} is not in the scene; that list has {len(table)} entries.")
        changed = [*table]
        changed[int(name)] = with_value(table[int(name)], key, value, inner) if inner else value
        return changed
    if not isinstance(table, Mapping):
        raise ValueError(f"{key} is not in the scene, which has {shortened(table)} in its place.")
    own = with_value(table.get(name, {}), key, value, inner) if inner else value
    return {**table, name: own}


def value_of(text: str) -> Any:
    """Return a value of TOML; what is none is a text."""
    try:
        return parsed(f"value = {text}")["value"]
    except ValueError:
        return text.strip()


def checked_label(name: str) -> str:
    """The name of a wall, as tables, pictures and CSV files may hold it.

    ValueError: it is too long, not printable, or begins with another character than a letter or a
    digit, as the formulas of spreadsheets do.
    """
    if not (name[:1].isalnum() and name.isprintable() and len(name) <= MOST_LETTERS):
        raise ValueError(
            f"the name of a wall is {shortened(name)}; give at most {MOST_LETTERS} printable "
            "characters, the first one a letter or a digit."
        )
    return name


@dataclass(frozen=True)
class NumberCheck:
    """The check of a finite number in a unit, which says what is allowed."""

    allowed: str
    is_allowed: Callable[[float], bool]
    unit: str = "1"

    def __call__(self, value: Any) -> float:
        """Return the number; ValueError."""
        given = _finite(value)
        if given == inf or not self.is_allowed(given):
            raise ValueError(f"give {self.allowed}")
        return given


def quantity(unit: str, *, is_positive: bool = False) -> NumberCheck:
    """Return the check of a finite number in a unit, not negative."""
    return NumberCheck(
        f"a finite number {'> 0' if is_positive else '>= 0'} in {unit}",
        lambda value: value > 0.0 or (value == 0.0 and not is_positive),
        unit,
    )


@dataclass(frozen=True)
class IntervalCheck:
    """The check of a finite number in a unit, not negative, or of two in order."""

    unit: str
    is_positive: bool = False

    def __call__(self, value: Any) -> tuple[float, float]:
        """Return the two numbers, or the one twice; ValueError."""
        check = quantity(self.unit, is_positive=self.is_positive)
        try:
            low, high = map(check, value if isinstance(value, list | tuple) else (value, value))
        except ValueError:
            raise ValueError(f"give {check.allowed}, or [lowest, highest]") from None
        if low > high:
            raise ValueError(f"its ends are swapped, so give [{high:g}, {low:g}]")
        return low, high


def one_of(names: Iterable[str]) -> Check:
    """Return the check of a name that is one of these."""
    allowed = list(names)

    def check(value: Any) -> str:
        if value not in allowed:
            near = _similar(str(value), allowed)
            raise ValueError(f"did you mean {near!r}?" if near else f"give {', '.join(allowed)}")
        return str(value)

    return check


def _similar(name: str, names: list[str]) -> str | None:
    """The name that is most similar, whatever its case; a name that it begins with goes first."""
    small = {n.lower(): n for n in names}
    begins = [n for n in names if name.lower().startswith(n.lower())]
    near = get_close_matches(name.lower(), small, n=1)
    return max(begins, key=len) if begins else small[near[0]] if near else None


any_number = NumberCheck("a finite number", lambda value: True)

share = NumberCheck("a number above 0 and at most 1", lambda value: 0.0 < value <= 1.0)

tolerance = NumberCheck(
    "a number >= 0 and below 1, such as 0.1 for 10 %", lambda value: 0.0 <= value < 1.0
)


def whole(low: int, high: int) -> Check:
    """Return the check of a whole number in [low, high]."""

    def check(value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise ValueError(f"give a whole number from {low} to {high}")
        return value

    return check


def truth(value: Any) -> bool:
    """Return true or false."""
    if not isinstance(value, bool):
        raise ValueError("give true or false")
    return value


def coefficients(value: Any) -> tuple[float, ...]:
    """Return a list of finite numbers, at least one, as a tuple."""
    numbers = [_finite(entry) for entry in value] if isinstance(value, list | tuple) else []
    if not numbers or not all(map(isfinite, numbers)):
        raise ValueError("give a list of finite numbers, highest power of z first")
    return tuple(numbers)


def not_zero(unit: str) -> NumberCheck:
    """Return the check of a finite number in a unit, positive or negative."""
    return NumberCheck(f"a finite number in {unit}, not 0", bool, unit)


def nested(kind: type["Table"]) -> Check:
    """Return the check of a table within a table."""

    def check(value: Any) -> Table:
        if isinstance(value, kind):
            return value
        if not isinstance(value, Mapping):
            raise ValueError(_example(kind, value))
        try:
            return kind.from_table(value)
        except ValueError as error:
            raise _Sentence(str(error)) from None

    return check


def _example(kind: type[Table], value: Any) -> str:
    """Ask for a table, with what is given in its place as the first value that it may be."""
    for entry in fields(kind):
        with suppress(ValueError):
            entry.metadata["check"](value)
            return f"give a table, such as {{ {entry.name} = {shortened(value)} }}"
    return f"give a table, such as {{ {fields(kind)[0].name} = ... }}"


def each(check: Check) -> Check:
    """Return the check of a list, which checks each entry."""

    def check_list(value: Any) -> tuple[Any, ...]:
        if not isinstance(value, list | tuple):
            raise ValueError("give a list")
        return tuple(checked(str(index), entry, check) for index, entry in enumerate(value))

    return check_list


def _checked_values(kind: type[Table], values: Mapping[str, Any]) -> dict[str, Any]:
    entries = {entry.name: entry for entry in fields(kind)}
    return {
        name: value
        if value is entries[name].default
        else checked(name, value, entries[name].metadata["check"])
        for name, value in values.items()
    }


def checked(name: str, value: Any, check: Check) -> Any:
    """Return a checked value; ValueError: the name, the value and what is allowed."""
    try:
        return check(value)
    except _Sentence as error:
        raise _Sentence(f"{name}.{error}") from None
    except ValueError as error:
        end = "" if str(error).endswith("?") else "."
        raise _Sentence(f"{name} is {shortened(value)}; {error}{end}") from None


class _Sentence(ValueError):
    """A sentence with the key and its value."""


def _path(place: str, name: str) -> str:
    return f"{place}.{name}" if place else name


def _finite(value: Any) -> float:
    """A number as a float; infinite for anything else and for too large ones."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return inf
    try:
        given = float(value)
    except OverflowError:
        return inf
    return given if isfinite(given) else inf


# ---------------------------------------------------------------------------------- labelled tables
class Variable(NamedTuple):
    """A variable: its description, its unit, and its codes, if its numbers are these.

    along: a dimension that the function itself adds at the end.
    """

    long_name: str
    units: str = "1"
    codes: type[IntEnum] | None = None
    along: tuple[str, ...] = ()

    @property
    def dtype(self) -> str:
        """The type of its numbers."""
        return "int8" if self.codes else "float64"

    @property
    def attributes(self) -> dict[str, Any]:
        """The attributes of the variable, as CF names them."""
        attributes: dict[str, Any] = {"long_name": self.long_name, "units": self.units}
        if self.codes:
            from numpy import array

            attributes["flag_values"] = array([*self.codes], self.dtype)
            attributes["flag_meanings"] = " ".join(code.name.lower() for code in self.codes)
        return attributes


def xarray_module() -> Any:
    """Return xarray; RuntimeError where it, dask or h5netcdf is missing."""
    try:
        import dask.array  # noqa: F401
        import h5netcdf  # noqa: F401
        import xarray
    except ImportError as error:
        raise RuntimeError(
            f"labelled tables need xarray, dask and h5netcdf, and {error.name} is missing: "
            "python -m pip install 'jaxstab[study]'."
        ) from error
    return xarray


def table_of(
    function: Callable[..., Any],
    columns: Mapping[str, "DataArray"],
    variables: Mapping[str, Variable],
    size: int,
    added: Mapping[str, int],
) -> "Dataset":
    """Return the variables that a function makes of columns, to be computed block by block.

    The function takes arrays that broadcast and returns a tuple of arrays, one for each variable;
    it can be pickled. ``size`` is the most points of a block; ``added`` are the lengths of the
    dimensions that the function adds.
    """
    xarray = xarray_module()
    lengths = {name: n for column in columns.values() for name, n in column.sizes.items()}
    chunks = dict[str, int]()
    for name, length in reversed(lengths.items()):  # whole dimensions from the last one on
        chunks[name] = max(1, min(length, size))
        size //= chunks[name]
    used = {name for variable in variables.values() for name in variable.along}
    found = xarray.apply_ufunc(
        function if len(variables) > 1 else partial(_only, function),
        *(
            column.chunk({name: chunks[name] for name in column.dims})
            for column in columns.values()
        ),
        output_core_dims=[variable.along for variable in variables.values()],
        output_dtypes=[variable.dtype for variable in variables.values()],
        dask="parallelized",
        dask_gufunc_kwargs={"output_sizes": {name: added[name] for name in used}},
    )
    arrays = found if len(variables) > 1 else [found]
    named = zip(variables.items(), arrays, strict=True)
    return xarray.Dataset(
        {name: array.assign_attrs(own.attributes) for (name, own), array in named}
    )


def _only(function: Callable[..., Any], *columns: Any) -> Any:
    (one,) = function(*columns)  # xarray takes a single variable as it is
    return one


def computed(table: "Dataset") -> "Dataset":
    """Return a table with its values, computed by the scheduler of dask that is set, if any."""
    from dask.base import get_scheduler

    return table.compute(**({} if get_scheduler() else {"scheduler": "synchronous"}))


def require_free(path: Path) -> None:
    """Refuse a path at which there is something; FileExistsError."""
    if os.path.lexists(path):
        raise FileExistsError(f"{path} exists; remove it, or give another name.")


def write(table: "Dataset", path: Path) -> None:
    """Write a table as a netCDF-4 file, whole or not at all; FileExistsError, OSError."""
    stored = {"zlib": True, "complevel": 1, "shuffle": True, "fletcher32": True}
    encoding = {name: stored for name in table.data_vars if table[name].ndim}
    with (
        table.to_netcdf(engine="h5netcdf", encoding=encoding) as image,
        replacing(path, may_replace=False) as descriptor,
    ):
        write_all(descriptor, image)


def read(path: Path) -> "Dataset":
    """Return the table in a file, whole; OSError: it cannot be read; ValueError: it is no table."""
    xarray = xarray_module()
    require_no_output(path)
    with named_errors("read", path):
        target_of(path)  # which refuses folders, devices and pipes
        path.open("rb").close()
    unreadable = AttributeError, IndexError, KeyError, OSError, RuntimeError, TypeError, ValueError
    try:
        return xarray.load_dataset(path, engine="h5netcdf")
    except unreadable as error:
        if is_memory_short():
            raise MemoryError(f"there is not enough memory to read {path}.") from error
        raise ValueError(f"{path} is not a netCDF-4 file, or is damaged.") from error
