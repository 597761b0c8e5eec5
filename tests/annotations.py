"""The annotations of jaxstab, checked by beartype (types) and jaxtyping (shapes) at calls.

Decorators that check would cost a fifth of all tests' time, most of it where nothing is checked any
more. Here nothing is decorated: the interpreter tells when a function starts and returns
(sys.monitoring, from Python 3.12 on), in each test until its first calls have been checked.
"""

import ast
import inspect
import sys
from collections.abc import Callable, Hashable, Iterator
from contextlib import nullcontext
from dataclasses import _HAS_DEFAULT_FACTORY
from functools import cache, cached_property
from types import CodeType, FrameType, FunctionType, ModuleType
from typing import Any, NamedTuple, get_args, get_type_hints

from beartype import BeartypeConf, beartype
from beartype.roar import BeartypeException
from jaxtyping import AbstractArray, TypeCheckError, jaxtyped

CHECKED = 20  # calls of a function in each test

_TOOL = 4  # none that Python or coverage takes
_by_type = beartype(conf=BeartypeConf(violation_type=TypeCheckError))


class _Known(NamedTuple):
    """What is known of a function by its code."""

    code: CodeType
    names: dict[str, Any]  # of its module
    hints: dict[str, Any]
    has_sizes: bool
    checks: dict[str, Callable[[Any], None]]  # of these, filled when the function is called
    checked: list[int]  # the last test in which it was called, and so many calls of that


_known: dict[int, _Known] = {}  # by the identity of the code: to hash it takes as long as a check
_running: dict[FrameType, dict[str, Any]] = {}  # the arguments of calls that will return
_watched: set[str] = set()
_now = [0, 0]  # the number of this test, and how many modules there were when it began


def install() -> None:
    """Let the interpreter tell of calls."""
    if sys.version_info >= (3, 12):
        events = sys.monitoring.events
        sys.monitoring.use_tool_id(_TOOL, "annotations")
        sys.monitoring.register_callback(_TOOL, events.PY_START, _starts)
        sys.monitoring.register_callback(_TOOL, events.PY_RETURN, _returns)


def begin() -> None:
    """Let the first calls of every function be checked again, and those of new modules, too."""
    if sys.version_info < (3, 12):
        return
    if _now[1] != len(sys.modules):
        for name in [name for name in sys.modules if name.split(".")[0] == "jaxstab"]:
            if name not in _watched:
                _watched.add(name)
                watch(sys.modules[name], name)
    _now[:] = _now[0] + 1, len(sys.modules)
    _running.clear()
    sys.monitoring.restart_events()


def watch(owner: ModuleType | type, module: str) -> None:
    """Check calls of all functions of the module that it, or a class of it, defines."""
    for value in list(vars(owner).values()):
        found = _function(value)
        if isinstance(found, FunctionType) and found.__module__ == module:
            watch_function(found)
        elif isinstance(value, type) and value.__module__ == module and value is not owner:
            watch(value, module)


def watch_function(function: FunctionType) -> None:
    """Check calls of a function, and of those within it."""
    _watch(function.__code__, function.__annotations__, function.__globals__)
    for code, annotations in _within(function):
        _watch(code, annotations, function.__globals__)


def _function(value: Any) -> Any:
    """What runs where a value is called, or read."""
    match value:
        case property():
            value = value.fget
        case classmethod() | staticmethod():
            value = value.__func__
        case cached_property():
            value = value.func
    return inspect.unwrap(value) if callable(value) else None


def _within(function: FunctionType) -> Iterator[tuple[CodeType, dict[str, Any]]]:
    """The functions that a function makes, with their annotations as its source has them."""
    codes = list(_codes(function.__code__))
    if not codes:
        return
    source = inspect.getsource(function)
    tree = ast.parse(("if True:\n" if source[0].isspace() else "\n") + source)
    ast.increment_lineno(tree, function.__code__.co_firstlineno - 2)
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            every = ast.walk(node.args)
            texts = {a.arg: a.annotation for a in every if isinstance(a, ast.arg)}
            texts |= {"return": node.returns}
            line = min([node.lineno, *(part.lineno for part in node.decorator_list)])
            for code in codes:
                if (code.co_name, code.co_firstlineno) == (node.name, line):
                    yield code, {name: ast.unparse(text) for name, text in texts.items() if text}


def _codes(code: CodeType) -> Iterator[CodeType]:
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield constant
            yield from _codes(constant)


def _watch(code: CodeType, annotations: dict[str, Any], names: dict[str, Any]) -> None:
    hints = dict(_hints(annotations, names))
    if id(code) in _known or not hints:
        return
    rest = iter(code.co_varnames[code.co_argcount + code.co_kwonlyargcount :])
    if code.co_flags & inspect.CO_VARARGS and (name := next(rest)) in hints:
        hints[name] = tuple[hints[name], ...]
    if code.co_flags & inspect.CO_VARKEYWORDS and (name := next(rest)) in hints:
        hints[name] = dict[str, hints[name]]
    if code.co_flags & inspect.CO_GENERATOR:
        hints.pop("return", None)
    _known[id(code)] = _Known(code, names, hints, any(map(_has_shape, hints.values())), {}, [0, 0])
    events = sys.monitoring.events
    sys.monitoring.set_local_events(_TOOL, code, events.PY_START | events.PY_RETURN)


def _hints(annotations: dict[str, Any], names: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """The annotations as objects, without those that only a type checker can look up."""

    def lookup() -> None: ...

    for name, annotation in annotations.items():
        lookup.__annotations__ = {name: annotation}
        try:
            hint = get_type_hints(lookup, names, include_extras=True)[name]
        except (NameError, ModuleNotFoundError):  # for the type checker, local, or of a lost room
            continue
        if hint is not Any and isinstance(hint, Hashable):  # not the arguments of any function
            yield name, hint


def _has_shape(hint: Any) -> bool:
    if inspect.isclass(hint) and issubclass(hint, AbstractArray):
        return True
    return any(map(_has_shape, get_args(hint)))


@cache
def _check(name: str, hint: Any, module: str) -> Callable[[Any], None]:
    """What refuses values of a name that are not as annotated in a module."""

    def check(value: Any) -> None: ...

    name = "returned" if name == "return" else name  # what a parameter may be called
    code = check.__code__.replace(co_varnames=(name,))
    there = FunctionType(code, vars(sys.modules[module]))
    there.__annotations__ = {name: hint}
    try:
        return _by_type(there)
    except BeartypeException:  # for type checkers alone
        return check


def _starts(code: CodeType, _: int) -> Any:
    known = _known[id(code)]
    last, count = known.checked
    if last != _now[0]:
        count = 0
    elif count == CHECKED:
        return sys.monitoring.DISABLE
    known.checked[:] = _now[0], count + 1
    if not known.checks:
        module = known.names["__name__"]
        known.checks.update(
            {name: _check(name, hint, module) for name, hint in known.hints.items()}
        )
    frame = sys._getframe(1)
    values = frame.f_locals
    given = {name: values[name] for name in known.checks if name != "return"}
    _all_right(known, given)
    if "return" in known.checks:
        _running[frame] = given if known.has_sizes else {}
    return None


def _returns(code: CodeType, _: int, value: Any) -> Any:
    known = _known[id(code)]
    given = _running.pop(sys._getframe(1), None)
    if given is not None:
        _all_right(known, {**given, "return": value})
    return None if known.checked[1] < CHECKED else sys.monitoring.DISABLE


def _all_right(known: _Known, values: dict[str, Any]) -> None:
    """Let a name of a dimension mean one size in all arguments and the result of a call."""
    with jaxtyped("context") if known.has_sizes else nullcontext():
        for name, value in values.items():
            if value is not _HAS_DEFAULT_FACTORY:  # which stands for what will be made
                known.checks[name](value)
