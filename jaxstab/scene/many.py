"""Many scenes at once: sweeps over keys, and a row of values for each scene."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import product
from typing import Any

from jaxstab.scene.answers import Answer
from jaxstab.scene.check import check_scenes, check_walls
from jaxstab.scene.scene import Scene
from jaxstab.shown import shortened

MOST_SCENES = 100_000
_AT_ONCE = 16  # scenes whose walls are checked together, so that a bar of progress moves
_LONG = 64.0  # samples of delay: walls take memory by its square, and are checked scene by scene

Sweep = Mapping[str, list[float | str]]
"""Values by the dotted key of a scene, such as ``device.mass``."""


@dataclass(frozen=True)
class Variant:
    """A scene of many: where it is from, the values that were swept, and why it was refused."""

    source: str
    values: dict[str, float | str]
    scene: Scene | None
    refusal: str = ""

    @property
    def name(self) -> str:
        """The name of the file, and what was swept."""
        values = (f"{key} = {short(value)}" for key, value in self.values.items())
        return ", ".join([*([self.source] if self.source else []), *values])


@dataclass(frozen=True)
class Row:
    """What one scene answers; ``answer`` is None where it was refused."""

    variant: Variant
    answer: Answer | None = None
    refusal: str = ""
    values: dict[str, Any] = field(default_factory=dict)
    words: dict[str, str] = field(default_factory=dict)


def short(value: float | str) -> str:
    """Return a value that was swept, in few digits."""
    return value if isinstance(value, str) else f"{value:.6g}"


def sweep_of(text: str) -> tuple[str, list[float | str]]:
    """The key and the values of ``KEY=LOW:HIGH:COUNT`` or ``KEY=VALUE,VALUE,...``."""
    name, equals, values = text.partition("=")
    parts = values.split(":")
    try:
        if name and len(parts) == 3:
            low, high, count = float(parts[0]), float(parts[1]), int(parts[2])
            if not 2 <= count <= MOST_SCENES:
                raise ValueError
            step = (high - low) / (count - 1)
            between = (float(f"{low + step * k:.15g}") for k in range(count - 1))
            return name, [*between, high]
    except ValueError:
        parts = []
    if not (name and equals and values) or len(parts) != 1:
        raise ValueError(
            f"sweep is {shortened(text)}; give KEY=LOW:HIGH:COUNT with a COUNT from 2 to "
            f"{MOST_SCENES}, or KEY=VALUE,VALUE,..."
        )
    return name, [_value(part) for part in values.split(",")]


def variants_of(tables: Mapping[str, Mapping[str, Any]], sweep: Sweep) -> list[Variant]:
    """The scenes of some tables, each with all combinations of the swept values."""
    count = len(tables)
    for values in sweep.values():
        count *= len(values)
    if count > MOST_SCENES:
        raise ValueError(f"the sweep has {count} scenes; give {MOST_SCENES} at most.")
    combinations = [dict(zip(sweep, values, strict=True)) for values in product(*sweep.values())]
    variants = [
        _variant(source, table, values)
        for source, table in tables.items()
        for values in combinations
    ]
    refusals = {variant.refusal for variant in variants}
    if len(refusals) == 1 and all(refusals):
        raise ValueError(*refusals)
    return variants


def answer_all(variants: list[Variant], function: Callable[[Scene], Answer]) -> Iterator[Row]:
    """Yield what each scene answers, in their order; a refusal is the row of its scene."""
    delays = [variant.scene.controller.samples for variant in variants if variant.scene]
    is_quick = function is check_walls and max(delays, default=0.0) <= _LONG
    at_once = _AT_ONCE if is_quick else 1
    for first in range(0, len(variants), at_once):
        some = variants[first : first + at_once]
        scenes = [variant.scene for variant in some if variant.scene]
        answers = iter(_answers(scenes, function))
        for variant in some:
            yield _row(variant, next(answers) if variant.scene else variant.refusal)


def _answers(scenes: list[Scene], function: Callable[[Scene], Answer]) -> list[Answer | str]:
    """Return the answers of scenes, or why they were refused; checks are one batch."""
    try:
        return [*check_scenes(scenes)] if function is check_walls else [*map(function, scenes)]
    except (ValueError, TypeError, RuntimeError) as error:
        if len(scenes) == 1:
            return [str(error)]
        return [answer for scene in scenes for answer in _answers([scene], function)]


def _row(variant: Variant, answer: Answer | str) -> Row:
    if isinstance(answer, str):
        return Row(variant, None, answer)
    leaves = list(answer.leaves())
    return Row(
        variant,
        answer,
        values={path: value for path, value, _ in leaves},
        words={path: words for path, _, words in leaves},
    )


def _variant(source: str, table: Mapping[str, Any], values: dict[str, float | str]) -> Variant:
    changed: Any = table
    try:
        for name, value in values.items():
            changed = with_value(changed, name.split("."), value)
        return Variant(source, values, Scene.from_table(changed))
    except ValueError as error:
        return Variant(source, values, None, str(error))


def with_value(table: Any, path: list[str], value: Any) -> Any:
    """Return a table with a value in place of another one; entries of lists go by their numbers."""
    first, *rest = path
    if isinstance(table, list):
        if not (first.isdigit() and int(first) < len(table)):
            raise ValueError(f"{first} is not an entry of a list of {len(table)} to sweep.")
        number = int(first)
        changed = with_value(table[number], rest, value) if rest else value
        return [*table[:number], changed, *table[number + 1 :]]
    inner = table.get(first, {})
    if rest and not isinstance(inner, Mapping | list):
        raise ValueError(f"{first} is {inner!r}; it has no key {rest[0]!r} to sweep.")
    return {**table, first: with_value(inner, rest, value) if rest else value}


def _value(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text
