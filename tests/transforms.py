"""What JAX's transformations make of each public function: the table of docs/transforms.md."""

from collections.abc import Callable
from dataclasses import is_dataclass, replace
from operator import attrgetter
from typing import Any

import jax
import jax.numpy as jnp

import jaxstab
from benchmarks.calls import COMPUTING_CALLS, OBJECTS
from jaxstab.arrays import leaves

WORD = {True: "yes", False: "no"}
REFUSALS = (TypeError, ValueError, NotImplementedError, jax.errors.JAXTypeError)


FILTERED = "with an estimator"


def rows() -> dict[str, tuple[str, str, str, str]]:
    """A row for each public function, and one for each method that an estimator changes."""
    plain = {name: row(name) for name in COMPUTING_CALLS}
    estimator = jaxstab.Velocity.difference(window=0.003)
    filtered = OBJECTS | {"loop": lambda: replace(OBJECTS["loop"](), velocity=estimator)}
    of_loops = [name for name, given in COMPUTING_CALLS.items() if given[0] == "loop"]
    others = {name: row(name, filtered) for name in of_loops}
    changed = {f"{name}` {FILTERED}": one for name, one in others.items() if one != plain[name]}
    return plain | changed


def row(name: str, objects: dict[str, Callable[[], Any]] = OBJECTS) -> tuple[str, str, str, str]:
    """What is traced, and whether jit, vmap and grad go through; nothing is compiled."""
    what, function, value = _of_one_argument(name, objects)
    return (
        what,
        WORD[_goes(lambda: jax.make_jaxpr(jax.jit(function))(value))],
        WORD[_goes(lambda: jax.make_jaxpr(jax.vmap(function))(_stacked(value)))],
        WORD[_goes(lambda: jax.make_jaxpr(jax.grad(_summed(function), allow_int=True))(value))],
    )


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
        return [leaf for leaf in leaves(answer) if isinstance(leaf, jax.Array)] or answer

    return what, of_one, value if is_of_loops else jnp.asarray(value)


def _stacked(value: Any) -> Any:
    return jax.tree.map(lambda leaf: jnp.stack([jnp.asarray(leaf)] * 2), value)


def _summed(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    def total(argument: Any) -> Any:
        floats = [leaf for leaf in leaves(function(argument)) if leaf.dtype.kind == "f"]
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
