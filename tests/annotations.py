"""The annotations of jaxstab, checked at every call: types by beartype, shapes by jaxtyping.

jaxtyping's own decorator binds the arguments of each call, also of functions without a shape, and
checks them twice; among many small NumPy functions that is nine tenths of a test's time. This one
refuses as much.
"""

from collections.abc import Callable
from dataclasses import is_dataclass
from functools import wraps
from inspect import isclass, isgeneratorfunction
from types import CodeType, FunctionType
from typing import Any, get_args, get_type_hints

import jaxtyping
from beartype import BeartypeConf, beartype
from jaxtyping import AbstractArray, TypeCheckError, jaxtyped

_by_type = beartype(conf=BeartypeConf(violation_type=TypeCheckError))
_made: dict[CodeType, Any] = {}  # what beartype has made of a function
_known: dict[CodeType, tuple[dict[str, Any], bool]] = {}  # its annotations; whether one has a shape


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
    if isgeneratorfunction(target):  # beartype would check its arguments when it is gone through
        return jaxtyped(target, typechecker=_by_type)
    if target.__code__ not in _known:  # one within another is made at each call of that
        known = known_annotations(target)
        _known[target.__code__] = known, any(map(has_shape, known.values()))
    target.__annotations__, has_sizes = _known[target.__code__]
    function = by_type(target)
    return with_sizes(function) if has_sizes else function


def by_type(function: FunctionType) -> Any:
    """Let beartype check a function; a function within another is compiled only the first time."""
    made = _made.get(function.__code__)
    keywords = getattr(made, "__kwdefaults__", None) or {}
    if "__beartype_func" not in keywords:
        _made[function.__code__] = made = _by_type(function)
        return made
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
