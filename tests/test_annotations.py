"""The check of annotations at calls refuses what jaxtyping's own decorator refuses."""

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from inspect import isclass
from typing import Any

import numpy as np
import pytest
from annotations import CHECKED, begin, watch, watch_function
from beartype import beartype
from jaxtyping import Float64, Int64, TypeCheckError, jaxtyped

from jaxstab.loop import Region
from jaxstab.region.curve import curve_gains

Decorator = Callable[[Any], Any]

Pair = Float64[np.ndarray, " pair"]
ONE, TWO, SINGLE = np.ones(1), np.ones(2), np.ones(2, np.float32)

pytestmark = pytest.mark.skipif(sys.version_info < (3, 12), reason="no calls are told of")


def ours(target: Any) -> Any:
    """Watch what is called; nothing is decorated."""
    watch(target, __name__) if isclass(target) else watch_function(target)
    return target


def jaxtypings(target: Any) -> Any:
    if not isclass(target):
        target.__code__ = target.__code__.replace()  # code of its own, which is not watched
    return jaxtyped(typechecker=beartype)(target)


def functions(decorator: Decorator) -> dict[str, Callable[..., Any]]:
    @decorator
    def returned(given: Any, like: Pair) -> Pair:
        return given

    @decorator
    def counted(indices: Int64[np.ndarray, "*grid"], grid: Float64[np.ndarray, "*grid"]) -> int:
        return indices.size + grid.size

    @decorator
    def named(word: str, *numbers: int | float, flag: bool = False) -> "str | None":
        return word if flag else None

    @decorator
    def yielded(given: Pair, like: Pair) -> Iterator[Pair]:
        for _ in given:
            yield like[:1]

    @decorator
    def among(sizes: Any, like: Pair) -> int:
        return sum(len(list(yielded(one, one))) for one in sizes) + like.size

    @decorator
    @dataclass
    class Box:
        low: Pair
        high: Pair

        @decorator
        def __add__(self, by: Pair) -> Pair:
            return self.low + by

        @property
        @decorator
        def size(self) -> int:
            return self.low

        @classmethod
        @decorator
        def of(cls, size: int) -> "Box":
            return cls(np.zeros(size), np.zeros(size))

    return {
        "returned": returned,
        "counted": counted,
        "named": named,
        "yielded": lambda *given: list(yielded(*given)),
        "among": among,
        "made": Box,
        "added": lambda low, by: Box(low, low) + by,
        "size": lambda low: Box(low, low).size,
        "of": Box.of,
        "within": lambda given: [functions(decorator)["named"](word) for word in given],
    }


RIGHT: list[tuple[Any, ...]] = [
    ("returned", TWO, TWO),
    ("counted", np.arange(4).reshape(2, 2), np.ones((2, 2))),
    ("named", "word", 1, 2.0),
    ("yielded", TWO, TWO),
    ("among", [TWO, ONE], np.ones(3)),
    ("made", TWO, TWO),
    ("added", TWO, TWO),
    ("of", 3),
    ("within", ["a", "b"]),
]
WRONG: list[tuple[Any, ...]] = [
    ("returned", TWO, ONE),
    ("returned", SINGLE, TWO),
    ("returned", TWO, SINGLE),
    ("returned", 1.0, TWO),
    ("counted", np.arange(4), np.ones((2, 2))),
    ("counted", np.ones(4), np.ones(4)),
    ("named", 1),
    ("named", "word", "1"),
    ("yielded", TWO, ONE),
    ("among", [TWO, SINGLE], ONE),
    ("made", TWO, ONE),
    ("made", TWO, SINGLE),
    ("added", TWO, SINGLE),
    ("size", TWO),
    ("of", "3"),
    ("within", ["a", 1]),
]


@pytest.fixture(params=[ours, jaxtypings])
def decorated(request: pytest.FixtureRequest) -> dict[str, Callable[..., Any]]:
    return functions(request.param)


@pytest.mark.parametrize(("name", "arguments"), [(name, rest) for name, *rest in RIGHT])
def test_what_is_as_annotated_passes(
    decorated: dict[str, Callable[..., Any]], name: str, arguments: list[Any]
) -> None:
    decorated[name](*arguments)


@pytest.mark.parametrize(("name", "arguments"), [(name, rest) for name, *rest in WRONG])
def test_another_type_dtype_or_size_is_refused(
    decorated: dict[str, Callable[..., Any]], name: str, arguments: list[Any]
) -> None:
    with pytest.raises(TypeCheckError):
        decorated[name](*arguments)


def test_the_first_calls_of_each_test_are_checked() -> None:
    returned = functions(ours)["returned"]
    for _ in range(CHECKED):
        with pytest.raises(TypeCheckError):
            functions(ours)["returned"](TWO, ONE)  # made anew, it is the same function
    assert returned(TWO, ONE) is TWO
    begin()  # as each test does
    with pytest.raises(TypeCheckError):
        returned(TWO, ONE)


def test_jaxstab_is_checked() -> None:
    with pytest.raises(TypeCheckError):
        Region("no loop", None)
    with pytest.raises(TypeCheckError):
        Region.in_si_units(None, np.ones((2, 3)))
    assert not hasattr(curve_gains, "__wrapped__")
    with pytest.raises(TypeCheckError):
        curve_gains(1, 2, 3)
