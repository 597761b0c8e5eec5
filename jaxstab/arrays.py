"""The two array namespaces that kernels are written for: NumPy and ``jax.numpy``.

A single question is answered by NumPy, and waits neither for a compiler nor for the import of JAX;
large grids, and everything that is traced, go through XLA. A kernel is written once: it takes its
namespace from its arguments (``xp = namespace(alpha)``) and its loops from here, because a compiled
loop is written differently from a Python loop.
"""

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import MISSING, field, fields, is_dataclass
from enum import IntEnum
from functools import cache, lru_cache, wraps
from typing import Any, TypeAlias, TypeVar

import numpy as np

Array: TypeAlias = Any
"""A NumPy array, a JAX array or a tracer; ``Float64[Array, "*grid"]`` checks shape and dtype."""

PI_REST = 1.2246467991473532e-16
"""pi minus the float64 next to it."""

Numbers: TypeAlias = Any
"""Array-like arguments of public functions: numbers, lists, NumPy or JAX arrays, tracers."""

Tree = TypeVar("Tree")
Kept = TypeVar("Kept")
Class = TypeVar("Class", bound=type)


def named(codes: Array, kind: type[IntEnum]) -> Array:
    """Return the code of one point as its member; others as they are."""
    if isinstance(codes, np.ndarray | np.int8) and codes.ndim == 0:
        return kind(int(codes))
    return codes


_PLAIN = frozenset({float, int, np.ndarray, np.float64})
_PLAIN_OR_NONE = _PLAIN | {type(None)}

_unregistered: list[type] = []


def is_jax(value: object) -> bool:
    """True for a JAX array or a tracer; this does not import JAX."""
    if type(value) in _PLAIN:  # most values, at once
        return False
    jax = sys.modules.get("jax")
    return hasattr(jax, "Array") and isinstance(value, jax.Array)  # type: ignore[union-attr]


def is_any_jax(*trees: object) -> bool:
    """True if a leaf of nested values is a JAX array or a tracer."""
    return "jax" in sys.modules and any(map(is_jax, leaves(trees, plain=False)))


def is_traced(value: object) -> bool:
    """True if JAX traces a value, so that only jit, vmap or grad know it."""
    return is_jax(value) and isinstance(value, sys.modules["jax"].core.Tracer)


def load_jax() -> Any:
    """Return JAX, which is imported where it is first needed: that takes a second."""
    import jax

    return jax


def is_any_traced(*trees: object) -> bool:
    """True if JAX traces a leaf of nested values."""
    _register_once()
    return "jax" in sys.modules and any(map(is_traced, leaves(trees, plain=False)))


def are_numbers(*trees: object) -> bool:
    """True if all leaves of nested values are concrete real numbers, as a repr needs."""
    if is_any_traced(*trees):
        return False
    return all(np.asarray(leaf).dtype.kind in "biuf" for tree in trees for leaf in leaves(tree))


def namespace(*values: object) -> Any:
    """Return ``jax.numpy`` if a leaf of the values is a JAX array or a tracer, else ``numpy``."""
    _register_once()
    if is_any_jax(values):
        return load_jax().numpy
    return np


def float_arrays(*values: Numbers) -> list[Array]:
    """Return numbers as float64 arrays of one namespace."""
    xp = namespace(values)
    return [xp.asarray(value, xp.float64) for value in values]


def leaves(tree: object, *, plain: bool = True) -> Iterator[Any]:
    """Yield the arrays and numbers of nested tuples, lists, dicts and pytree dataclasses.

    Those of NumPy and Python are passed over unless requested (``plain``).
    """
    pending = [tree]  # no recursion: it is called often, and nested generators are slow
    while pending:
        node = pending.pop()
        kind: Any = type(node)
        if kind in _PLAIN:
            if plain:
                yield node
        elif isinstance(node, tuple | list):
            if plain or not _PLAIN_OR_NONE.issuperset(map(type, node)):
                pending.extend(reversed(node))
        elif isinstance(node, dict):
            pending.extend(reversed(node.values()))
        elif (names := _field_names(kind)) is not None:
            pending.extend(getattr(node, name) for name in reversed(names))
        elif node is not None:
            yield node


@cache
def _field_names(kind: type) -> tuple[str, ...] | None:
    """The names of the fields of a dataclass, None for another type."""
    return tuple(field.name for field in fields(kind)) if is_dataclass(kind) else None


def tree_map(function: Callable[..., Any], tree: Tree, *others: Tree) -> Tree:
    """Return a tree like the first, its leaves those of ``function`` on the leaves of all."""
    result: Any
    kind: Any = type(tree)
    if kind in _PLAIN:
        result = function(tree, *others)
    elif isinstance(tree, tuple | list):
        branches = [tree_map(function, *branch) for branch in zip(tree, *others, strict=True)]
        result = kind(*branches) if hasattr(tree, "_fields") else kind(branches)
    elif (names := _field_names(kind)) is not None:
        columns = ([getattr(each, name) for each in (tree, *others)] for name in names)
        result = kind(*(tree_map(function, *column) for column in columns))
    else:
        result = tree if tree is None or isinstance(tree, str) else function(tree, *others)
    return result


def take(tree: Tree, index: Any) -> Tree:
    """Return a tree of the values at an index of each array: ``(..., i)`` for the last axis."""
    return tree_map(lambda values: values[index], tree)


def joined(trees: Sequence[Tree], axis: int = 0) -> Tree:
    """Return a tree of the arrays of all trees, one after the other along an axis."""
    xp = namespace(trees)
    return tree_map(lambda *arrays: xp.concatenate(arrays, axis), *trees)


def pytree(cls: Class) -> Class:
    """Register a dataclass as a pytree of JAX; if JAX is not loaded yet, at the first use of it.

    All fields that are not ``fixed`` are arrays, or else the class says by ``tree_flatten`` and
    ``tree_unflatten`` what its arrays are.
    """
    _unregistered.append(cls)
    _register_once()
    return cls


def fixed(default: Any = MISSING) -> Any:
    """Return a field of a pytree that is not an array."""
    return field(default=default, metadata={"static": True})


def _register_once() -> None:
    """Register the pytrees with JAX, if it is loaded by now."""
    if not _unregistered or not hasattr(sys.modules.get("jax"), "Array"):
        return
    jax = load_jax()
    while _unregistered:
        cls = _unregistered.pop()
        if hasattr(cls, "tree_flatten"):
            jax.tree_util.register_pytree_node_class(cls)
        else:
            jax.tree_util.register_dataclass(cls)


def remembered(function: Callable[..., Tree]) -> Callable[..., Tree]:
    """Remember what a function gives for small arrays of NumPy; nobody may change it."""
    small = 2048  # numbers

    @lru_cache(maxsize=128)
    def of_bytes(shapes: tuple[tuple[int, ...], ...], *values: bytes, **options: Any) -> Tree:
        numbers = map(np.frombuffer, values)
        return function(*map(np.reshape, numbers, shapes), **options)

    @wraps(function)
    def call(*arrays: Array, **options: Any) -> Tree:
        if is_any_jax(arrays) or sum(map(np.size, arrays)) > small:
            return function(*arrays, **options)
        own = [np.asarray(array, np.float64) for array in arrays]
        return of_bytes(tuple(map(np.shape, own)), *(array.tobytes() for array in own), **options)

    return call


def filled(like: Array, value: float) -> Array:
    """An array of one value in the shape of another; a float for a float, which is faster."""
    return value if type(like) is float else namespace(like).full_like(like, value)


def kept(rounded: Array) -> Array:
    """Return a number exactly as it was rounded; XLA must not rewrite the terms before it."""
    if not is_jax(rounded):
        return rounded
    # A choice that no compiler can make before it knows the number. It is fused with what is around
    # it; from JAX 0.12 on, a barrier of optimization would end a kernel, in the hottest loops.
    return namespace(rounded).where(rounded == rounded, rounded, np.nan)


# Inverses, roots and powers of two that XLA fuses with the arithmetic around them: it does not fuse
# a division whose result is used more than once. They start from the bits of the number.


def reciprocal(x: Array) -> Array:
    """Return 1/x for x > 0, to eight digits in JAX."""
    if not is_jax(x):
        return 1.0 / x
    y = floats(0x7FDE_6238_22FC_16E6 - bits(x))  # within 13 %
    for _ in range(3):
        y = y * (2.0 - x * y)
    return y


def rounded_reciprocal(x: Array) -> Array:
    """Return 1/x for x > 0 within two roundings in JAX; NaN unless x is in 2^-960 to 2^960."""
    y = reciprocal(x)
    for _ in range(2):
        y = y + y * (1.0 - x * y)
    return namespace(x).where((x > 2.0**-960) & (x < 2.0**960), y, np.nan)


def square_root(x: Array) -> Array:
    """Return the root of x >= 0, to eight digits in JAX."""
    if not is_jax(x):
        return np.sqrt(x)
    y = floats(0x5FE6_EB50_C7B5_37A9 - (bits(x) >> 1))  # the inverse root within 4 %
    for _ in range(3):
        y = y * (1.5 - 0.5 * x * y * y)
    return x * y


def power_of_two_below_inverse(x: Array) -> Array:
    """Return the power of two that brings x > 0 to [1, 2)."""
    exponent = bits(x) & 0x7FF0_0000_0000_0000
    return floats(0x7FE0_0000_0000_0000 - exponent)


def bits(x: Array) -> Array:
    """Return the bits of float64 numbers, as integers."""
    if is_jax(x):
        return load_jax().lax.bitcast_convert_type(x, np.int64)
    return np.asarray(x, np.float64).view(np.int64)


def floats(integers: Array) -> Array:
    """Return the float64 numbers that have these bits."""
    if is_jax(integers):
        return load_jax().lax.bitcast_convert_type(integers, np.float64)
    return np.asarray(integers, np.int64).view(np.float64)


def constant(tree: Tree) -> Tree:
    """Return the values without their derivatives."""
    if namespace(tree) is np:
        return tree
    return load_jax().lax.stop_gradient(tree)


def repeat(
    count: int | Array, step: Callable[[Tree], Tree], start: Tree, *, is_unrolled: bool = False
) -> Tree:
    """Apply a step a number of times, in JAX as one compiled loop, the number traced or not."""
    if is_unrolled or namespace(count, start) is np:
        for _ in range(int(count)):
            start = step(start)
        return start
    return load_jax().lax.fori_loop(0, count, lambda _, state: step(state), start)


def repeat_and_keep(
    count: int, step: Callable[[Tree], tuple[Tree, Kept]], start: Tree
) -> tuple[Tree, Kept]:
    """Apply a step a number of times, and stack what each gives beside the state that follows."""
    if namespace(start) is np:
        history = []
        for _ in range(count):
            start, gift = step(start)
            history.append(gift)
        return start, tree_map(lambda *values: np.array(values), *history)
    return load_jax().lax.scan(lambda state, _: step(state), start, length=count)


def repeat_while(
    is_open: Callable[[Tree], Array], step: Callable[[Tree], Tree], start: Tree
) -> Tree:
    """Apply a step as long as a condition of the state holds; in JAX one compiled loop."""
    if namespace(start) is np:
        while is_open(start):
            start = step(start)
        return start
    return load_jax().lax.while_loop(is_open, step, start)


def with_values(array: Array, indices: np.ndarray, values: Array) -> Array:
    """Return an array with values at flat indices; one of NumPy is changed in place."""
    if is_jax(array):
        return array.ravel().at[indices].set(values).reshape(array.shape)
    array.flat[indices] = values
    return array


def solved(matrix: Array, values: Array) -> Array:
    """Return x of a small system matrix x = values (row, column) in JAX, by elimination.

    LAPACK's batches, which JAX calls for this, can wait for each other for ever: on two cores two
    of them at a time occupy both threads that are to do their work (jaxlib 0.10.2).
    """
    jnp, size = load_jax().numpy, len(matrix)
    rows = jnp.concatenate([matrix, values], axis=1)
    for column in range(size):
        pivot = column + jnp.argmax(jnp.abs(rows[column:, column]))
        pair = jnp.stack([jnp.asarray(column, pivot.dtype), pivot])
        rows = rows.at[pair].set(rows[pair[::-1]])
        scaled = rows[column] / rows[column, column]
        rows = (rows - rows[:, column : column + 1] * scaled).at[column].set(scaled)
    return rows[:, size:]
