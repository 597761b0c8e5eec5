"""The one owner of compilation: which calls go to XLA, in which shapes, with which options.

A kernel written for both array namespaces (``jaxstab.arrays``) is wrapped once, by ``compiled``,
and one rule says who computes:

- JAX arrays and tracers: XLA.
- NumPy arrays: NumPy, until it has spent on one program as much time as XLA takes to compile it,
  summed over calls; from then on, or at once where one call is that large, XLA, which returns
  NumPy. So nobody waits for more than twice the best.
- Numbers, and arrays of a few hundred: NumPy.

Time is counted in points (``many``), so that answers do not hang on a clock. XLA compiles for each
shape; so what others give is padded here, to few shapes.
"""

import os
import sys
from collections import defaultdict, deque
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache, partial, wraps
from itertools import chain, islice, pairwise
from math import prod
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numpy as np
from jaxtyping import Int64

from jaxstab.arrays import (
    Array,
    constant,
    is_any_traced,
    is_jax,
    is_traced,
    leaves,
    load_jax,
    namespace,
    tree_map,
)

if TYPE_CHECKING:
    from concurrent.futures import Future

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")
Item = TypeVar("Item")

TILE = 4096  # points whose working set stays in the cache of a CPU

# What NumPy computes while XLA compiles: verdicts in one to two seconds, plants in six, numbers of
# dense polynomials, or angles of a boundary.
MANY = 1 << 21
MANY_PLANTS = 1 << 18
MANY_COEFFICIENTS = 1 << 22
MANY_ANGLES = 1 << 18
FEW = 1 << 8  # points for which no program pays: NumPy needs no longer than to call one
_FOR_A_CORE = 1 << 17  # points from which on a second core pays

# Options of XLA's compiler for CPUs; ``compiler_options`` leaves out what a release lacks. They are
# for a program of hundreds of kernels and of loops; what it computes is the same to the last bit.
LEAN: dict[str, Any] = {
    # In JAX 0.10 XLA's newer code generator takes 400 MB more and compiles for longer. JAX 0.12 has
    # it alone, and compiles such programs as fast by it.
    "xla_cpu_use_fusion_emitters": False,
    # Copy less of what a loop carries: a tenth of the time.
    "xla_cpu_copy_insertion_use_region_analysis": True,
    # One kernel after the other, the order that takes the least memory: threads that wait for each
    # other take another tenth.
    "xla_cpu_scheduler_type": 1,
}


def compiled(
    *,
    static: Sequence[str] = (),
    many: int | float = np.inf,
    wide: bool = False,
    pointwise: bool = False,
    parallel: bool = False,
) -> Callable[[Callable[Arguments, Result]], Callable[Arguments, Result]]:
    """Let XLA answer for JAX arrays, and for NumPy arrays once that pays; NumPy for the rest.

    Args:
        static: names of arguments that are compiled in, to be given by keyword.
        many: points of NumPy arguments that NumPy computes while XLA compiles (``pays``).
        wide: use the widest vectors of the CPU, for plain arithmetic on many points.
        pointwise: each point of the grid is computed on its own, so grids of NumPy arrays are
            filled up to one of few sizes.
        parallel: the kernel has no loop, as over tiles, so XLA itself divides it among the cores;
            other grids of points are cut into a piece for each core.
    """

    def decorate(kernel: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
        @cache
        def program(is_wide: bool) -> Callable[..., Any]:
            # In bits; XLA prefers half of what the CPU has.
            extra = compiler_options({"xla_cpu_prefer_vector_width": 512}) if is_wide else None
            return load_jax().jit(kernel, static_argnames=tuple(static), compiler_options=extra)

        @wraps(kernel)
        def call(*arguments: Arguments.args, **options: Arguments.kwargs) -> Result:
            given = list(leaves((arguments, {k: v for k, v in options.items() if k not in static})))
            if any(map(is_jax, given)):
                namespace(given)  # tells JAX of our pytrees
                # Within another compilation an option cannot be given.
                is_outer = not any(map(is_traced, given))
                return program(wide and is_outer)(*arguments, **options)
            own = kernel, *(options[name] for name in static if name in options)
            if many == np.inf or not pays(own, _size(given), many, map(np.shape, given)):
                with np.errstate(all="ignore"):  # as XLA does: NaN and infinity are answers
                    return kernel(*arguments, **options)
            if pointwise:
                on_grid = filled_up if parallel else on_few_sizes
                return on_grid(partial(program(wide), **options), *arguments)
            return in_float64(program(wide), *arguments, **options)

        return call

    return decorate


_computed: dict[Hashable, float] = defaultdict(float)


def pays(
    program: Hashable, size: int, many: int | float, shapes: Iterable[tuple[int, ...]] = ()
) -> bool:
    """True once NumPy, with so many points more, has computed ``many`` for one program of XLA."""
    if size < min(many, FEW):
        return False
    own = program, *(tuple(map(_filled_length, shape)) for shape in shapes)
    _computed[own] += size
    return _computed[own] >= many


def _filled_length(length: int) -> int:
    """Return a length of five binary digits, at most 6 % more than the given one."""
    step = 1 << max(0, length.bit_length() - 5)
    return -(-length // step) * step


def _size(arrays: list[Any]) -> int:
    """Return the size of the grid to which arrays broadcast, or of the largest if they do not."""
    shapes = {np.shape(array) for array in arrays}
    try:
        return prod(np.broadcast_shapes(*shapes))
    except ValueError:
        return max(map(prod, shapes))


def in_float64(function: Callable[..., Result], *arguments: Any, **options: Any) -> Result:
    """Call a JAX function in float64, whatever its flags say; NumPy arrays in and out."""
    # The arrays that come back share the memory of XLA and are read-only.
    jnp = load_jax().numpy
    namespace()  # tells JAX of our pytrees
    with own_settings():
        arrays = tree_map(lambda leaf: leaf if np.ndim(leaf) == 0 else jnp.asarray(leaf), arguments)
        result: Result = tree_map(np.asarray, function(*arrays, **options))
    return result


@contextmanager
def own_settings() -> Iterator[None]:
    """Set JAX as our programs need it: what users forbid their own code is no fault of ours.

    NaN and infinity are answers, and NumPy's rules of promotion hold for both namespaces.
    """
    jax = load_jax()
    with (
        jax.enable_x64(True),
        jax.debug_nans(False),
        jax.debug_infs(False),
        jax.numpy_dtype_promotion("standard"),
        jax.numpy_rank_promotion("allow"),
        jax.transfer_guard("allow"),
    ):
        yield


def on_few_sizes(function: Callable[..., Result], *arguments: Any) -> Result:
    """Call a JAX function of points in float64, on grids of few sizes; NumPy in and out.

    A large grid is cut into pieces, and each core of the CPU computes some: a program in tiles uses
    one core alone.
    """
    shape = np.broadcast_shapes(*map(np.shape, leaves(arguments)))
    count = min(_cores(), prod(shape) // _FOR_A_CORE)
    filled = partial(filled_up, function)
    return filled(*arguments) if count < 2 else in_pieces(filled, arguments, count)


def in_pieces(function: Callable[..., Result], arguments: tuple[Any, ...], count: int) -> Result:
    """Call a function of points, NumPy in and out, on ``count`` pieces of their grid.

    The grid is cut across its longest axis, and each answer is copied into arrays for the whole
    grid. The cores of the CPU share the pieces.
    """
    shape = np.broadcast_shapes(*map(np.shape, leaves(arguments)))
    count = max(1, min(count, max(shape) // 2))
    axis = int(np.argmax(shape)) - len(shape)
    ends = [shape[axis] * k // count for k in range(count + 1)]
    wholes: list[Any] = []
    is_first = Lock()

    def has_axis(leaf: Any) -> bool:
        return np.ndim(leaf) >= -axis and np.shape(leaf)[axis] > 1

    def whole(leaf: np.ndarray) -> np.ndarray:
        last = (shape[axis], *leaf.shape[leaf.ndim + axis + 1 :]) if has_axis(leaf) else ()
        return np.empty((*leaf.shape[: leaf.ndim - len(last)], *last), leaf.dtype)

    def of_piece(start_and_stop: tuple[int, int]) -> None:
        index: Any = (..., slice(*start_and_stop), *(slice(None),) * (-axis - 1))
        answer = function(
            *tree_map(lambda leaf: leaf[index] if has_axis(leaf) else leaf, arguments)
        )
        with is_first:
            if not wholes:
                wholes.append(tree_map(whole, answer))
        for target, leaf in zip(leaves(wholes[0]), leaves(answer), strict=True):
            target[index if has_axis(target) else ...] = leaf

    on_cores(of_piece, list(pairwise(ends)))
    return wholes[0]


def on_cores(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Apply a function to items, on all cores that the CPU has for JAX."""
    return [result for _, result in ahead(function, items)]


def ahead(
    function: Callable[[Item], Result], items: Iterable[Item]
) -> Iterator[tuple[Item, Result]]:
    """Yield items and the function of each, in order: cores compute while this thread makes items.

    Few items wait for their turn, so few are held in memory. What runs in Python for long belongs
    into the making of items: threads that take turns in it wait for each other.
    """
    every = iter(items)
    head = list(islice(every, 1))
    if not head:
        return  # without JAX
    count = _threads()
    with ThreadPoolExecutor(count) as pool:
        waiting: deque[tuple[Item, Future[Result]]] = deque()
        for item in chain(head, every):
            waiting.append((item, pool.submit(function, item)))
            while len(waiting) > 2 * count or (waiting and waiting[0][1].done()):
                first, future = waiting.popleft()
                yield first, future.result()
        for item, future in waiting:
            yield item, future.result()


def _threads() -> int:
    """The number of threads that keep the cores busy that JAX computes on."""
    # One thread more than there are cores: a thread spends part of its time in Python, between
    # two programs, and its core would be idle.
    return _cores() + 1 if is_on_cpu() else 1


def is_on_cpu() -> bool:
    """True if JAX computes on the CPU."""
    is_cpu: bool = load_jax().default_backend() == "cpu"
    return is_cpu


def compiler_options(wanted: dict[str, Any]) -> dict[str, Any] | None:
    """Return those of the wanted options of XLA on CPUs that this release of JAX has."""
    if not is_on_cpu():
        return None
    return {name: value for name, value in wanted.items() if _has_option(name, value)}


@cache
def _has_option(name: str, value: Any) -> bool:
    jax = load_jax()
    try:  # XLA lists its options nowhere, and refuses one that it does not know
        jax.jit(lambda x: x, compiler_options={name: value}).lower(0.0).compile()
    except jax.errors.JaxRuntimeError:
        return False
    return True


def _cores() -> int:
    """The number of CPU cores of this process if JAX computes there, else 1."""
    if not is_on_cpu():
        return 1
    affinity = getattr(os, "sched_getaffinity", None)  # of Linux
    return len(affinity(0)) if affinity else os.cpu_count() or 1


def filled_up(function: Callable[..., Result], *arguments: Any, is_smooth: bool = False) -> Result:
    """Call a JAX function of points in float64, on a grid of one of few sizes; NumPy in and out.

    An axis is filled up with its last points again, or, for a function that compares neighbours
    (``is_smooth``), with points that continue it evenly.
    """
    shape = np.broadcast_shapes(*map(np.shape, leaves(arguments)))
    filled = list(map(_filled_length, shape))  # so grids of new sizes are rarely compiled anew

    def fill(leaf: Any) -> Any:
        for axis, length in enumerate(np.shape(leaf), start=-np.ndim(leaf)):
            if 1 < length < filled[axis]:
                missing = filled[axis] - length
                padding = leaf.take(range(length - missing, length), axis)
                if is_smooth:
                    before = leaf.take(range(length - 2, length - 2 - missing, -1), axis)
                    padding = 2.0 * leaf.take([-1], axis) - before
                leaf = np.concatenate([leaf, padding], axis)
        return leaf

    def cut(leaf: np.ndarray) -> np.ndarray:
        return leaf[tuple(slice(length) for length in shape[len(shape) - leaf.ndim :])]

    return tree_map(cut, in_float64(function, *tree_map(fill, arguments)))


def over_tiles(kernel: Callable[..., Result], arguments: Any, tile: int = TILE) -> Result:
    """Evaluate an elementwise kernel tile by tile, so that its working data stays in the cache."""
    # Arrays of one element are not copied for every point. Only XLA on a CPU needs it: NumPy and an
    # accelerator get all points at once.
    xp = namespace(arguments)
    if xp is np:
        return kernel(*arguments)
    jax = load_jax()
    leaves_of, structure = jax.tree.flatten(arguments)
    shape = xp.broadcast_shapes(*(xp.shape(leaf) for leaf in leaves_of))
    size = prod(shape)
    if size <= tile or not is_on_cpu():
        return kernel(*arguments)
    shared = [xp.reshape(leaf, ()) if leaf.size == 1 else None for leaf in leaves_of]
    count = -(-size // tile)
    tiles = [
        xp.resize(xp.broadcast_to(leaf, shape).ravel(), (count, -(-size // count)))
        for leaf in leaves_of
        if leaf.size > 1
    ]

    def of_tile(columns: list[Array]) -> Array:
        parts = iter(columns)
        mixed = [next(parts) if value is None else value for value in shared]
        return kernel(*jax.tree.unflatten(structure, mixed))

    return tree_map(lambda row: row.ravel()[:size].reshape(shape), jax.lax.map(of_tile, tiles))


def lists(
    indices: Int64[np.ndarray, " point"], longest: int, shortest: int | None = None
) -> Iterator[tuple[Int64[np.ndarray, " block"], Int64[np.ndarray, " list"]]]:
    """Cut a list of points into blocks, and repeat points to fill each to a length compiled before.

    The lengths are ``longest`` / 8^k down to ``shortest`` (by default ``longest``): a few points do
    not pay for many. Yields each block and the padded list to compute, which begins with the block.
    """
    for start in range(0, indices.size, longest):
        block = indices[start : start + longest]
        length = longest
        while length // 8 >= max(block.size, longest if shortest is None else shortest):
            length //= 8
        yield block, np.resize(block, length)


def alike(kinds: Iterable[Hashable]) -> list[list[int]]:
    """The indices of the items of each kind, which may be evaluated together."""
    indices: dict[Hashable, list[int]] = defaultdict(list)
    for index, kind in enumerate(kinds):
        indices[kind].append(index)
    return list(indices.values())


def use_compilation_cache(folder: str | os.PathLike[str] | None = None) -> Path:
    """Keep compiled programs of XLA in a folder, for this process, its children and later ones.

    Every command of ``jaxstab`` does the same. JAX is not imported for this: it reads the setting
    when it is imported, or at once if it is already loaded. Numbers and small NumPy arrays never
    need the folder.

    By default in ``JAX_COMPILATION_CACHE_DIR`` where that is set, else in ``jaxstab`` in the user's
    folder of caches (``XDG_CACHE_HOME`` or ``~/.cache``). Returns the folder, which is made if it
    is missing.

    Raises: OSError if the folder cannot be made, or the home directory is not known.

    Example:
        >>> import jaxstab
        >>> jaxstab.use_compilation_cache()  # doctest: +SKIP
    """
    folder = folder or os.environ.get("JAX_COMPILATION_CACHE_DIR")
    if not folder:
        home = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
        try:
            folder = Path(home or Path.home() / ".cache") / "jaxstab"
        except RuntimeError as error:  # the user has no entry in the list of users
            words = "the home directory is not known; set HOME or JAX_COMPILATION_CACHE_DIR."
            raise FileNotFoundError(words) from error
    path = Path(folder).absolute()
    path.mkdir(parents=True, exist_ok=True)
    options: dict[str, str | float] = {
        "jax_compilation_cache_dir": str(path),
        # By default JAX keeps only what took a second to compile: hardly anything.
        "jax_persistent_cache_min_compile_time_secs": 0.0,
        "jax_persistent_cache_min_entry_size_bytes": -1,
    }
    os.environ |= {name.upper(): str(value) for name, value in options.items()}
    if "jax" in sys.modules:
        from jax.experimental.compilation_cache import compilation_cache

        compilation_cache.reset_cache()  # else the first program's folder, or none, remains
        for name, value in options.items():
            load_jax().config.update(name, value)
    return path


def on_host(
    function: Callable[..., Result],
    *arrays: Array,
    shape: tuple[int, ...],
    like: Any,
    is_count: bool = True,
) -> Result:
    """Call a NumPy function of arrays that all have one shape, also from JAX, jit and vmap.

    A search that branches for each loop is not a kernel for XLA, so JAX gives its arrays, broadcast
    to ``shape``, to NumPy and continues with the answer: a tree ``like`` the given one of dtypes,
    of that shape. The function must not call JAX. The answer has no derivative: that of counts
    (``is_count``) is 0, any other one is refused by JAX.
    """
    xp = namespace(arrays)
    arrays = tuple(xp.broadcast_to(array, shape) for array in arrays)
    arrays = constant(arrays) if is_count else arrays
    if xp is np:
        return function(*arrays)
    if not is_any_traced(arrays):  # JAX calls back for no array that lies on several devices
        return tree_map(xp.asarray, function(*map(np.asarray, arrays)))
    jax = load_jax()
    shapes = tree_map(lambda dtype: jax.ShapeDtypeStruct(shape, dtype), like)
    return jax.pure_callback(
        lambda *given: function(*map(np.asarray, given)),
        shapes,
        *arrays,
        vmap_method="broadcast_all",
    )


def asked_of_lanes(
    ask: Callable[..., Any],
    loop_of: Callable[..., Any],
    lanes: Sequence[Array],
    count: int,
    *,
    is_count: bool,
    gains: int = 2,
) -> tuple[Array, ...]:
    """So many numbers that are asked of a loop and some gains, for lanes of gains and of loops.

    NaN where there is no loop; ``is_count`` as of ``on_host``.
    """

    def of_lane(*lane: float) -> Any:
        loop = loop_of(*lane[gains:])
        return np.full(count, np.nan) if loop is None else ask(loop, *lane[:gains])

    def search(*own: np.ndarray) -> tuple[np.ndarray, ...]:
        columns = np.array([np.ravel(lane) for lane in own]).T.tolist()
        found = np.reshape([of_lane(*lane) for lane in columns], (*own[0].shape, count))
        return tuple(map(np.asarray, np.moveaxis(found, -1, 0)))

    shape = namespace(lanes).broadcast_shapes(*map(np.shape, lanes))
    like = (np.float64,) * count
    return on_host(search, *lanes, shape=shape, like=like, is_count=is_count)
