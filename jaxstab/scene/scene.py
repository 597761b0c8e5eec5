"""A haptic scene in SI units: what a TOML file or the command line says, checked; no JAX here."""

import math
import tomllib
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from functools import partial
from os import PathLike
from pathlib import Path
from reprlib import repr as shortened
from typing import Annotated, Any, Literal, NamedTuple, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

Answer = Literal["limits", "check", "tune", "design"]
Measure = Literal["margins", "distance", "radius", "settling", "oscillation"]
Range = tuple[float, float]

MOST_SAMPLES = 1024  # of delay: the degree of what is solved
ANSWERS: tuple[str, ...] = get_args(Answer)
MEASURES: tuple[str, ...] = get_args(Measure)


class Preset(NamedTuple):
    """A device by name: mass in kg, damping in N s/m, and where the numbers are from."""

    mass: float
    damping: float
    source: str


PRESETS = {
    "phantom": Preset(0.1, 1.5, "Remark 4 of Hulin, Preusche, Hirzinger (2008)"),
    "omega": Preset(0.25, 0.1, "assumed: the maker publishes neither mass nor damping"),
    "falcon": Preset(0.2, 0.1, "assumed: the maker publishes neither mass nor damping"),
}

EXAMPLE = """\
# A haptic scene for jaxstab. All quantities are in SI units.

[device]
# preset = "phantom"      # instead of the two below: phantom, omega or falcon
mass = 0.1                # kg, effective mass at the handle
damping = 1.5             # N s/m, physical damping of the device

[hand]                    # leave this table out for no hand
mass = [0.0, 0.3]         # kg; each of the three is a number or [lowest, highest]
stiffness = [0.0, 200.0]  # N/m
damping = 1.0             # N s/m

[controller]
sample_time = 0.001       # s
delay_samples = 1.5       # samples, whole or not; or: delay = 0.0015, in s

[walls.soft]              # any number of walls, each with a name of its own
stiffness = 300.0         # N/m
damping = 2.0             # N s/m

[walls.hard]
stiffness = 10000.0
damping = 20.0

[wanted]                  # what `jaxstab scene FILE` answers
answers = ["limits", "check"]    # of limits, check, tune, design
# measures = ["margins"]  # check: beside the verdict of a wall; all of them by default:
                          # margins, distance, radius, settling, oscillation
# at_damping = 20.0       # N s/m, limits: the stiffness allowed at this damping
# at_stiffness = 1000.0   # N/m, limits: the damping allowed at this stiffness
# stiffness = 3000.0      # N/m, design: what the sample time or the delay is to allow
"""


# --------------------------------------------------------------------------------- checked numbers


def _number(value: Any, allowed: str, *, positive: bool) -> float:
    """Return a number, or raise a ValueError that says what is allowed."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"give {allowed}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number) or number < 0 or (positive and number == 0):
        raise ValueError(f"give {allowed}")
    return number


def _quantity(unit: str, *, positive: bool = False) -> BeforeValidator:
    allowed = f"a finite number {'> 0' if positive else '>= 0'} in {unit}"
    return BeforeValidator(partial(_number, allowed=allowed, positive=positive))


def _range(unit: str) -> BeforeValidator:
    allowed = f"a finite number >= 0 in {unit}, or [lowest, highest]"

    def check(value: Any) -> Range:
        ends = value if isinstance(value, list | tuple) else (value, value)
        if len(ends) != 2:
            raise ValueError(f"give {allowed}")
        low, high = (_number(end, allowed, positive=False) for end in ends)
        if low > high:
            raise ValueError(f"its ends are swapped, so give [{high:g}, {low:g}]")
        return low, high

    return BeforeValidator(check)


def _one_of(names: tuple[str, ...]) -> Callable[[Any], Any]:
    def check(value: Any) -> Any:
        if value not in names:
            near = get_close_matches(str(value), names, n=1)
            raise ValueError(f"did you mean {near[0]!r}?" if near else f"give {', '.join(names)}")
        return value

    return check


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Device(_Table):
    """The haptic device: effective mass in kg and physical damping in N s/m, or a preset."""

    preset: Annotated[str, BeforeValidator(_one_of(tuple(PRESETS)))] | None = None
    mass: Annotated[float, _quantity("kg", positive=True)]
    damping: Annotated[float, _quantity("N s/m")]

    @model_validator(mode="before")
    @classmethod
    def _filled_in(cls, table: Any) -> Any:
        """Let a preset give what the table does not."""
        preset = PRESETS.get(str(table.get("preset"))) if isinstance(table, Mapping) else None
        if preset is None:
            return table
        return {"mass": preset.mass, "damping": preset.damping, **table}


class Hand(_Table):
    """The hand that holds the device; each quantity a range from lowest to highest."""

    mass: Annotated[Range, _range("kg")] = (0.0, 0.0)
    stiffness: Annotated[Range, _range("N/m")] = (0.0, 0.0)
    damping: Annotated[Range, _range("N s/m")] = (0.0, 0.0)

    @property
    def varies(self) -> bool:
        """Whether this is more than one hand."""
        return any(low < high for low, high in (self.mass, self.stiffness, self.damping))


class Controller(_Table):
    """The sampling period in s, and the delay of the loop in s or in samples."""

    sample_time: Annotated[float, _quantity("s", positive=True)]
    delay: Annotated[float, _quantity("s")] | None = None
    delay_samples: Annotated[float, _quantity("samples")] | None = None

    @model_validator(mode="after")
    def _one_delay(self) -> "Controller":
        if self.delay is not None and self.delay_samples is not None:
            raise ValueError(
                f"controller.delay is {self.delay:g} beside controller.delay_samples; give one"
            )
        samples = self.time_delay / self.sample_time
        if samples > MOST_SAMPLES:
            raise ValueError(
                f"controller.delay is {samples:g} samples of {self.sample_time:g} s; give at most "
                f"{MOST_SAMPLES} samples, or a longer sample_time"
            )
        return self

    @property
    def time_delay(self) -> float:
        """The delay t_d in s."""
        return self.delay or (self.delay_samples or 0.0) * self.sample_time


class Wall(_Table):
    """A virtual wall: stiffness K in N/m and damping B in N s/m."""

    stiffness: Annotated[float, _quantity("N/m")]
    damping: Annotated[float, _quantity("N s/m")]


class Wanted(_Table):
    """What to answer, and with which measures of a wall beside its verdict."""

    answers: tuple[Annotated[Answer, BeforeValidator(_one_of(ANSWERS))], ...] = ("limits",)
    measures: tuple[Annotated[Measure, BeforeValidator(_one_of(MEASURES))], ...] = get_args(Measure)
    at_damping: Annotated[float, _quantity("N s/m")] | None = None
    at_stiffness: Annotated[float, _quantity("N/m")] | None = None
    stiffness: Annotated[float, _quantity("N/m", positive=True)] | None = None

    @model_validator(mode="after")
    def _some_answer(self) -> "Wanted":
        if not self.answers:
            raise ValueError(f"wanted.answers is empty; give at least one of {', '.join(ANSWERS)}")
        return self


class Scene(_Table):
    """A device, the hand that holds it, its controller, walls, and what is wanted."""

    device: Device
    controller: Controller
    hand: Hand | None = None
    walls: dict[str, Wall] = Field(default_factory=dict)
    wanted: Wanted = Wanted()

    @classmethod
    def from_file(cls, path: str | PathLike[str]) -> "Scene":
        """Read a TOML file.

        Raises:
            OSError: the file cannot be read.
            ValueError: as for ``from_table``, with the name of the file.
        """
        return cls.from_table(read_table(path), str(path))

    @classmethod
    def from_table(cls, table: Mapping[str, Any], source: str = "") -> "Scene":
        """Check a table of tables, as TOML has them.

        Raises:
            ValueError: one sentence on the first key that is unknown, missing or has a bad value.
        """
        try:
            return cls.model_validate(table)
        except ValidationError as error:
            sentence = _sentence(error)
            raise ValueError(f"{source}: {sentence}" if source else sentence) from None

    def require_walls(self) -> None:
        """Refuse a scene without a wall.

        Raises:
            ValueError: there is no wall.
        """
        if not self.walls:
            raise ValueError("walls is empty; give at least one wall with stiffness and damping.")

    def unusual(self) -> list[str]:
        """Return what looks like a slip of the unit, in words."""
        device, controller = self.device, self.controller
        hand = self.hand or Hand()
        found = [
            _outside("device.mass", device.mass, 1e-3, 50.0, "kg"),
            _outside("device.damping", device.damping, 0.0, 100.0, "N s/m"),
            _outside("hand.mass", hand.mass[1], 0.0, 20.0, "kg"),
            _outside("hand.stiffness", hand.stiffness[1], 0.0, 1e6, "N/m"),
            _outside("hand.damping", hand.damping[1], 0.0, 1e3, "N s/m"),
            _outside("controller.sample_time", controller.sample_time, 1e-5, 0.05, "s"),
            _outside("the delay", controller.time_delay, 0.0, 2.0, "s"),
        ]
        for name, wall in self.walls.items():
            found.append(_outside(f"walls.{name}.stiffness", wall.stiffness, 0.0, 1e6, "N/m"))
            found.append(_outside(f"walls.{name}.damping", wall.damping, 0.0, 1e4, "N s/m"))
        return [words for words in found if words]


class Step(NamedTuple):
    """One thing that a scene may ask for: whether it is computed, and why or why not."""

    what: str
    computed: bool
    why: str


def plan(scene: Scene) -> list[Step]:
    """Return what is computed for a scene and what is skipped."""
    wanted, hand = scene.wanted, scene.hand or Hand()
    asked = {name: name in wanted.answers for name in ANSWERS}
    reason = {True: "wanted.answers has it", False: "wanted.answers does not have it"}
    steps = [Step(name, asked[name], reason[asked[name]]) for name in ("limits", "tune", "design")]
    for key, what in (("at_damping", "stiffness limits"), ("at_stiffness", "damping limits")):
        given = getattr(wanted, key) is not None
        why = f"wanted.{key} is {'given' if given else 'not given'}"
        steps.append(Step(f"{what} at a given {key[3:]}", given and asked["limits"], why))
    checked = f"for each of {len(scene.walls)} walls" if asked["check"] else reason[False]
    steps.append(Step("certified verdicts", asked["check"], checked))
    for name in MEASURES:
        is_wanted = name in wanted.measures
        why = checked if is_wanted else "wanted.measures does not have it"
        steps.append(Step(name, asked["check"] and is_wanted, why))
    why = "the hand is a range" if hand.varies else "there is one hand at most"
    steps.append(Step("proof and worst case over the hands", hand.varies, why))
    samples = scene.controller.time_delay / scene.controller.sample_time
    steps.append(Step("sweep over delays", False, f"the delay is fixed: {samples:g} samples"))
    return steps


def read_table(path: str | PathLike[str]) -> dict[str, Any]:
    """Read a TOML file as it is.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is not TOML.
    """
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise OSError(error.errno, f"cannot read {path}: {error.strerror}.") from error
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path}: byte {error.start} is no UTF-8; save the file as UTF-8 text."
        ) from error
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{path}: this is not TOML: {error}.") from error


def _outside(name: str, value: float, low: float, high: float, unit: str) -> str:
    if low <= value <= high:
        return ""
    return f"{name} is {value:g} {unit}, usual are {low:g} to {high:g} {unit}"


# -------------------------------------------------------------------------- errors in one sentence


def _sentence(error: ValidationError) -> str:
    """Return one error with its key, its value and what is allowed: a misspelt key before all."""
    errors = error.errors()
    first = next((one for one in errors if one["type"] == "extra_forbidden"), errors[0])
    path = [str(part) for part in first["loc"]]
    where = ".".join(path)
    if first["type"] == "extra_forbidden":
        known = list(_model_at(path[:-1]).model_fields)
        near = get_close_matches(path[-1], known, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(known)}."
        return f"{where} is unknown; {hint}"
    if first["type"] == "missing":
        return f"{where} is missing; give it a value."
    if first["type"] != "value_error":
        kind = "a list" if first["type"] == "tuple_type" else "a table"
        if path[0] == "walls":
            kind = "a table [walls.NAME] for each wall"
        return f"{where} is {shortened(first['input'])}; give {kind}."
    words = str(first["ctx"]["error"])
    end = "" if words.endswith("?") else "."
    if isinstance(first["input"], Mapping):  # of a table as a whole: it has its key in it
        return f"{words}{end}"
    return f"{where} is {shortened(first['input'])}; {words}{end}"


def _model_at(path: list[str]) -> type[_Table]:
    if path[:1] == ["walls"]:
        return Wall
    tables: dict[str, type[_Table]] = {
        "device": Device,
        "hand": Hand,
        "controller": Controller,
        "wanted": Wanted,
    }
    return tables[path[0]] if path else Scene
