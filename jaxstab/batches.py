"""The one owner of what is compiled: which calls meet XLA, in which shapes, with which options.

A kernel written for both array namespaces (``jaxstab.arrays``) is wrapped once, by ``compiled``. A
call with JAX arrays or tracers is compiled by XLA, one with numbers or small NumPy arrays is
answered by NumPy, and one with NumPy arrays of ``many`` elements goes to XLA and returns NumPy.
XLA compiles for each shape; so what others give is padded here, to few shapes.
"""

import os
import sys
from collections.abc import Callable, Sequence
from functools import cache, wraps
from pathlib import Path
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


def use_compilation_cache(folder: str | os.PathLike[str] | None = None) -> Path:
    """Keep all that XLA compiles in a folder, for this process, for those it starts, and for later.

    Every command of ``jaxstab`` does the same. JAX is not imported: it reads its options when it
    is; where it is loaded already, it is told. Numbers and small NumPy arrays never need it.

    Args:
        folder: of the cache; by default ``JAX_COMPILATION_CACHE_DIR`` where that is set, else
            ``jaxstab`` in the user's folder of caches (``XDG_CACHE_HOME`` or ``~/.cache``).

    Returns:
        The folder, which is made if it is missing.

    Raises:
        OSError: the folder cannot be made.

    Example:
        >>> import jaxstab
        >>> jaxstab.use_compilation_cache()  # doctest: +SKIP
    """
    path = Path(folder or os.environ.get("JAX_COMPILATION_CACHE_DIR") or _users_cache()).absolute()
    path.mkdir(parents=True, exist_ok=True)
    options: dict[str, str | float] = {
        "jax_compilation_cache_dir": str(path),
        # By default JAX keeps only what took a second to compile: hardly anything.
        "jax_persistent_cache_min_compile_time_secs": 0.0,
        "jax_persistent_cache_min_entry_size_bytes": -1,
    }
    os.environ |= {name.upper(): str(value) for name, value in options.items()}
    if "jax" in sys.modules:
        import jax
        from jax.experimental.compilation_cache import compilation_cache

        compilation_cache.reset_cache()  # it keeps to the folder of the first program, or to none
        for name, value in options.items():
            jax.config.update(name, value)
    return path


def _users_cache() -> Path:
    home = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    return (Path(home) if home else Path.home() / ".cache") / "jaxstab"
