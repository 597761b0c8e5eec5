"""Searches that branch on their numbers, in the midst of JAX.

Such a search cannot be compiled. As a primitive of JAX that is only ever evaluated it still works
inside of vmap and grad. A callback out of compiled code would allow jit too, but a search that
itself calls JAX can then wait for itself forever.
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.extend.core import Primitive
from jax.interpreters import batching
from jax.typing import ArrayLike
from jaxtyping import Float64

Search = Callable[[Float64[np.ndarray, " number"]], Float64[np.ndarray, " found"]]

_search_p = Primitive("host_search")


def found_on_host(search: Search, count: int, *numbers: ArrayLike) -> Float64[Array, "*grid found"]:
    """Return the ``count`` numbers that a search finds, for each place of broadcast arrays.

    To derivatives they are constants.

    Raises:
        TypeError: jit, or a loop of JAX, traces the numbers.
    """
    rows = jnp.stack(jnp.broadcast_arrays(*map(jnp.asarray, numbers)), axis=-1)
    found: Array = _search_p.bind(lax.stop_gradient(rows), search=search, count=count)
    return found


def _search_each(rows: Array, *, search: Search, count: int) -> Array:
    table = np.asarray(rows)
    found = [search(row) for row in table.reshape(-1, table.shape[-1])]
    return jnp.asarray(np.reshape(found, (*table.shape[:-1], count)))


def _refuse(*_: Any, **__: Any) -> Any:
    raise TypeError(
        "margins and distances are searched for outside of JAX; call them without jit, or close "
        "over what they return."
    )


def _batch(rows: tuple[Array], axes: tuple[int], **what: Any) -> tuple[Array, int]:
    return _search_p.bind(jnp.moveaxis(rows[0], axes[0], 0), **what), 0


_search_p.def_impl(_search_each)
_search_p.def_abstract_eval(_refuse)
batching.primitive_batchers[_search_p] = _batch
