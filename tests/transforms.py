"""What JAX's transformations make of each public function: the table of docs/transforms.md."""

from collections.abc import Callable
from dataclasses import is_dataclass, replace
from operator import attrgetter
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from calls import COMPUTING_CALLS, OBJECTS

import jaxstab
from jaxstab.arrays import leaves
from jaxstab.loop.margins import Margins

WORD = {True: "yes", False: "no"}
REFUSALS = (TypeError, ValueError, NotImplementedError, jax.errors.JAXTypeError)


FILTERED = "with an estimator"
ESTIMATORS = (
    jaxstab.Velocity.difference(window=0.003),
    jaxstab.Velocity.transfer_function([420.0, -400.0, -20.0], [1.0, -0.7, 0.12]),
)
BESIDE = 1e-3  # of the second point that vmap is given
STEP = 1e-6  # of differences, in both relative to the numbers


def rows() -> dict[str, tuple[str, str, str, str]]:
    """A row for each public function, and one for each method that an estimator changes."""
    plain = {name: row(name) for name in COMPUTING_CALLS}
    of_loops = [name for name, given in COMPUTING_CALLS.items() if given[0] == "loop"]
    others = [(name, row(name, with_estimator(x))) for x in ESTIMATORS for name in of_loops]
    return plain | {f"{name}` {FILTERED}": one for name, one in others if one != plain[name]}


def with_estimator(estimator: jaxstab.Velocity) -> dict[str, Callable[[], Any]]:
    """The objects of calls, the loop with an estimator."""
    return OBJECTS | {"loop": lambda: replace(OBJECTS["loop"](), velocity=estimator)}


def row(name: str, objects: dict[str, Callable[[], Any]] = OBJECTS) -> tuple[str, str, str, str]:
    """What is traced, and whether jit, vmap and grad go through; nothing is compiled."""
    what, function, value = _of_one_argument(name, objects)
    return (
        what,
        WORD[_goes(lambda: jax.make_jaxpr(jax.jit(function))(value))],
        WORD[_goes(lambda: jax.make_jaxpr(jax.vmap(function))(_stacked(value)))],
        WORD[_goes(lambda: jax.make_jaxpr(jax.grad(_summed(function), allow_int=True))(value))],
    )


def check_values(name: str, objects: dict[str, Callable[[], Any]] = OBJECTS) -> None:
    """Compare a function under jit and vmap with its plain answers, and grad with differences."""
    _, *words = row(name, objects)
    _, function, value = _of_one_argument(name, objects)
    if words[:2] == ["yes", "yes"]:
        points = [_moved(value, step) for step in (0.0, BESIDE)]
        together = jax.tree.map(lambda *leaf: jnp.stack(list(map(jnp.asarray, leaf))), *points)
        traced = jax.vmap(lambda point: _answers(name, function(point), jnp.asarray))
        found = map(np.asarray, jax.jit(traced)(together))
        for many, *each in zip(found, *(_answers(name, function(x)) for x in points), strict=True):
            for own, plain in zip(many, each, strict=True):
                more = np.zeros(own.size - plain.size, plain.dtype)
                known = np.append(plain, more).reshape(own.shape)  # roots at 0, of a traced delay
                np.testing.assert_allclose(own, known, rtol=1e-9, atol=1e-10, err_msg=name)
    if words[2] == "yes":
        point = jax.tree.map(jnp.asarray, value)
        way = jax.tree.map(jnp.subtract, _moved(value, 1.0), point)

        def slopes(point: Any) -> list[Any]:
            return _real(_answers(name, function(point), jnp.asarray))

        ends = [_real(_answers(name, function(_moved(value, by)))) for by in (STEP, -STEP)]
        found = jax.jvp(slopes, (point,), (way,))[1]
        for own, ahead, behind in zip(found, *ends, strict=True):
            truth = (ahead - behind) / (2.0 * STEP)
            size = 1e-5 * np.nanmax(abs(truth), initial=0.0) + 1e-6 * np.nanmax(abs(ahead))
            np.testing.assert_allclose(own, truth, rtol=1e-4, atol=size + 1e-10, err_msg=name)


def _moved(value: Any, step: float) -> Any:
    """Numbers, or those of a loop, each by another sign times a step relative to it."""
    numbers, structure = jax.tree.flatten(value)
    moved = [np.asarray(x) * (1.0 + step * (-1) ** k) for k, x in enumerate(numbers)]
    return jax.tree.unflatten(structure, [x if x.ndim else float(x) for x in moved])


def _answers(name: str, answer: Any, array: Callable[[Any], Any] = np.asarray) -> list[Any]:
    """The numbers of an answer: of regions not the vertices, which move across the boundary."""
    return list(map(array, _numbers(answer)[name == "regions_of" :]))


def _numbers(answer: Any) -> list[Any]:
    """The leaves but for names and units of gains, and the factors that no traced wall has."""
    if isinstance(answer, Margins):
        answer = answer._replace(both_factors=None)
    return [leaf for leaf in leaves(answer) if not isinstance(leaf, str)]


def _real(numbers: list[Any]) -> list[Any]:
    return [x for x in numbers if x.dtype.kind == "f"]


def _of_one_argument(
    name: str, objects: dict[str, Callable[[], Any]]
) -> tuple[str, Callable[[Any], Any], Any]:
    """The argument that is traced: the first number or, where there is none, the loop itself."""
    given = [
        objects[value]() if isinstance(value, str) else value for value in COMPUTING_CALLS[name]
    ]
    options = given.pop() if isinstance(given[-1], dict) else {}
    function = attrgetter(name)(jaxstab)
    keywords = dict(enumerate(given)) | options
    traced = next((key for key, value in keywords.items() if isinstance(value, float)), 0)
    value = keywords[traced]
    loops = value if isinstance(value, list) else [value]
    is_of_loops = all(is_dataclass(loop) for loop in loops)
    what = ("loop" if value is loops[0] else "loops") if is_of_loops else "a number"

    def of_one(argument: Any) -> Any:
        every = keywords | {traced: argument}
        named = {key: every[key] for key in options}
        answer = function(*(every[index] for index in range(len(given))), **named)
        numbers = _numbers(answer)
        return numbers if any(isinstance(leaf, jax.Array) for leaf in numbers) else answer

    return what, of_one, value if is_of_loops else jnp.asarray(value)


def _stacked(value: Any) -> Any:
    return jax.tree.map(lambda leaf: jnp.stack([jnp.asarray(leaf)] * 2), value)


def _summed(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    def total(argument: Any) -> Any:
        numbers = map(jnp.asarray, _numbers(function(argument)))
        floats = [leaf for leaf in numbers if leaf.dtype.kind == "f"]
        if not floats:
            raise TypeError("no real number depends on it")
        return sum(leaf.sum() for leaf in floats)

    return total


def _goes(trace: Callable[[], object]) -> bool:
    try:
        trace()
    except REFUSALS:
        return False
    return True
