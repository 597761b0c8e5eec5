"""The annotations of jaxstab, checked by beartype (types) and jaxtyping (shapes).

jaxtyping's own decorator binds the arguments of each call, also of functions without a shape, and
checks them twice; among many small NumPy functions that is nine tenths of a test's time. This one
refuses as much, and in each test it checks the first calls of a function, not those of long loops.
"""

from collections.abc import Callable
from dataclasses import is_dataclass
from functools import wraps
from inspect import isclass, isgeneratorfunction
from types import CodeType, FunctionType
from typing import Any, NamedTuple, get_args, get_type_hints

import jaxtyping
from beartype import BeartypeConf, beartype
from jaxtyping import AbstractArray, TypeCheckError, jaxtyped

_by_type = beartype(conf=BeartypeConf(violation_type=TypeCheckError))

CHECKED = 20  # calls of a function in each test


class _Known(NamedTuple):
    """What is known of a function by its code: one within another is made at each call of that."""

    code: CodeType
    annotations: dict[str, Any]
    has_sizes: bool
    left: list[int]  # calls that will be checked
    made: list[Any]  # what beartype made of it


_known: dict[int, _Known] = {}  # by the identity of the code: to hash it takes as long as a check


def install() -> None:
    """Let the import hook decorate every function and dataclass of jaxstab that is loaded later."""
    jaxtyping.jaxtyped = lambda *, typechecker: checked
    jaxtyping.install_import_hook("jaxstab", "beartype.beartype")


def checked(target: Any) -> Any:
    """Decorate a function, or the construction of a dataclass."""
    if isclass(target):
        if is_dataclass(target) and not hasattr(target.__init__, "__wrapped__"):
            target.__init__ = checked(target.__init__)
        return target
    if isinstance(target, classmethod | staticmethod):
        return type(target)(checked(target.__func__))
    if isinstance(target, property):
        return property(checked(target.fget))
    known = _known.get(id(target.__code__))
    if known is None:
        hints = known_annotations(target)
        sizes = any(map(has_shape, hints.values()))
        known = _Known(target.__code__, hints, sizes, [CHECKED], [])
        _known[id(target.__code__)] = known
    target.__annotations__ = known.annotations
    if isgeneratorfunction(target):  # beartype would check its arguments when it is gone through
        return at_first(target, jaxtyped(target, typechecker=_by_type), known.left)
    function = by_type(target, known.made)
    return at_first(target, with_sizes(function) if known.has_sizes else function, known.left)


def begin() -> None:
    """Let the first calls of every function be checked again."""
    for known in _known.values():
        known.left[0] = CHECKED


def at_first(
    target: FunctionType, checking: Callable[..., Any], left: list[int]
) -> Callable[..., Any]:
    """Let so many calls be checked that are left, and others not."""

    @wraps(target)
    def call(*arguments: Any, **options: Any) -> Any:
        if left[0]:
            left[0] -= 1
            return checking(*arguments, **options)
        return target(*arguments, **options)

    return call


def by_type(function: FunctionType, before: list[Any]) -> Any:
    """Let beartype check a function; a function within another is compiled only the first time."""
    made = before[0] if before else None
    keywords = getattr(made, "__kwdefaults__", None) or {}
    if "__beartype_func" not in keywords:
        before[:] = [_by_type(function)]
        return before[0]
    again = FunctionType(made.__code__, made.__globals__, closure=made.__closure__)
    again.__kwdefaults__ = keywords | {"__beartype_func": function}
    return wraps(function)(again)


def with_sizes(function: Callable[..., Any]) -> Callable[..., Any]:
    """Let a name of a dimension mean one size in all arguments and the result of a call."""

    @wraps(function)
    def call(*arguments: Any, **options: Any) -> Any:
        with jaxtyped("context"):
            return function(*arguments, **options)

    return call


def has_shape(annotation: Any) -> bool:
    if isclass(annotation) and issubclass(annotation, AbstractArray):
        return True
    return any(map(has_shape, get_args(annotation)))


def known_annotations(function: FunctionType) -> dict[str, Any]:
    """The annotations as objects, without those that only a type checker can look up."""

    def lookup() -> None: ...

    known = {}
    for name, annotation in function.__annotations__.items():
        lookup.__annotations__ = {name: annotation}
        try:
            known |= get_type_hints(lookup, function.__globals__, include_extras=True)
        except NameError:  # imported for the type checker, or a class that comes later
            continue
    return known
