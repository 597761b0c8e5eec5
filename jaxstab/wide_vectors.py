"""Compile elementwise functions for the widest vectors of a CPU.

XLA prefers vectors of half the width where a CPU has 512 bits, which halves the speed of plain
arithmetic. An option of a single compilation asks for all of it; other CPUs are not changed by it.
"""

from collections.abc import Callable, Sequence
from functools import wraps
from typing import ParamSpec, TypeVar

import jax

_WIDE = {"xla_cpu_prefer_vector_width": 512}  # bits

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def wide_jit(
    function: Callable[Arguments, Result], static_argnames: Sequence[str] = ()
) -> Callable[Arguments, Result]:
    """Return the function compiled; within another compilation the option cannot be given."""
    inner = jax.jit(function, static_argnames=static_argnames)
    outer = jax.jit(function, static_argnames=static_argnames, compiler_options=_WIDE)

    @wraps(function)
    def compiled(*arguments: Arguments.args, **options: Arguments.kwargs) -> Result:
        leaves = jax.tree.leaves((arguments, options))
        is_inner = any(isinstance(leaf, jax.core.Tracer) for leaf in leaves)
        is_inner = is_inner or jax.default_backend() != "cpu"
        result: Result = (inner if is_inner else outer)(*arguments, **options)
        return result

    return compiled
