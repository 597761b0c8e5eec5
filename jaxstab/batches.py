"""The one owner of what is compiled: which calls meet XLA, in which shapes, with which options.

A kernel written for both array namespaces (``jaxstab.arrays``) is wrapped once, by ``compiled``. A
call with JAX arrays or tracers is compiled by XLA, one with numbers or small NumPy arrays is
answered by NumPy, and one with NumPy arrays of ``many`` elements goes to XLA and returns NumPy.
XLA compiles for each shape; so what others give is padded here, to few shapes.
"""

from collections.abc import Callable, Sequence
from functools import cache, wraps
from typing import Any, ParamSpec, TypeVar

import numpy as np

from jaxstab.arrays import is_jax, is_traced, leaves, namespace, tree_map

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

TILE = 4096  # points whose working set stays in the cache of a CPU
_WIDE: dict[str, Any] = {
    "xla_cpu_prefer_vector_width": 512
}  # bits; XLA prefers half of what the CPU has


def compiled(
    *, static: Sequence[str] = (), many: int | float = np.inf, wide: bool = False
) -> Callable[[Callable[Arguments, Result]], Callable[Arguments, Result]]:
    """Let XLA answer for JAX arrays, and for ``many`` points and more; NumPy for the rest.

    Args:
        static: names of arguments that are compiled in, to be given by keyword.
        many: size of the largest NumPy argument from which on XLA answers, as NumPy arrays.
        wide: ask for the widest vectors of the CPU, for plain arithmetic on many points.
    """

    def decorate(kernel: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
        @cache
        def program(is_wide: bool) -> Callable[..., Any]:
            import jax

            is_wide = is_wide and jax.default_backend() == "cpu"
            extra = _WIDE if is_wide else None
            return jax.jit(kernel, static_argnames=tuple(static), compiler_options=extra)

        @wraps(kernel)
        def call(*arguments: Arguments.args, **options: Arguments.kwargs) -> Result:
            given = list(leaves((arguments, {k: v for k, v in options.items() if k not in static})))
            if any(is_jax(leaf) for leaf in given):
                namespace(given)  # tells JAX of our pytrees
                # Within another compilation an option cannot be given.
                is_outer = not any(map(is_traced, given))
                answer: Result = program(wide and is_outer)(*arguments, **options)
                return answer
            if max((np.size(leaf) for leaf in given), default=0) < many:
                with np.errstate(all="ignore"):  # as XLA does: NaN and infinity are answers
                    return kernel(*arguments, **options)
            return in_float64(program(wide), *arguments, **options)

        return call

    return decorate


def in_float64(function: Callable[..., Result], *arguments: Any, **options: Any) -> Result:
    """Call a JAX function in float64, whatever its flag says; NumPy arrays in and out."""
    import jax
    import jax.numpy as jnp

    with jax.enable_x64(True):
        namespace(jnp.zeros(()))
        arrays = tree_map(lambda leaf: leaf if np.ndim(leaf) == 0 else jnp.asarray(leaf), arguments)
        result: Result = tree_map(np.asarray, function(*arrays, **options))
    return result
