"""Verdict and radius of a dense slice beside eigenvalues, per point, over delay and batch size.

LAPACK's matrices are made beforehand; jaxstab starts from the axes. Where a rival is slow it gets a
random part of the slice, stated as ``points``. ``error`` is, for a verdict, the largest distance
from the boundary at which it was wrong or undecided (relative to the region); for a radius, the
largest error. Both are judged by certified roots, on points that come closer and closer to the
boundary.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import control
import jax
import jax.numpy as jnp
import numpy as np

import jaxstab
from benchmarks.record import Row
from benchmarks.rivals import LAPACK_WORK, LoopFamily, jax_eigenvalues, largest_modulus
from benchmarks.timing import Timing, interleaved
from benchmarks.truth.slices import ExactSlice
from jaxstab.batches import compiled
from jaxstab.conventions import Verdict

GAMMA, DELTA = 1e-3, 0.015
BAND = "largest distance from the boundary with a wrong or no verdict, relative to the region"
RADIUS_ERROR = "largest error of the spectral radius by certified roots"

_CHAINS = 8  # independent sums of the plain kernel, so that no operation waits for the one before
_PYTHON_POINTS = 200  # for rivals that take one polynomial at a time
_EIGENVALUES_ON_ACCELERATOR = 100

Points = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Method:
    """A way to answer for points: ``answer(alpha, beta)``, and the timed ``call`` of the slice."""

    name: str
    is_verdict: bool
    points: int
    call: Callable[[], Any]
    answer: Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Judged:
    """Points near the boundary with their distance to it, and what is true of them."""

    alpha: np.ndarray
    beta: np.ndarray
    distance: np.ndarray
    stable: np.ndarray
    radius: np.ndarray


def rows(small: bool) -> Iterator[Row]:
    side = 8 if small else 1000
    for delay in (1.0,) if small else (0.0, 1.0, 2.0, 5.0, 10.0, 20.0, 40.0, 60.0):
        yield from _slice_rows("delay", delay, side, small)
    for side in (6,) if small else (10, 32, 100, 316, 1000, 3162):
        yield from _slice_rows("batch", 1.0, side, small)


def _slice_rows(section: str, delay: float, side: int, small: bool) -> Iterator[Row]:
    exact = _exact(delay)
    judged = _judged(delay, 2 if small else 16)
    methods = {method.name: method for method in _methods(exact, side)}
    limits = _limits(delay, side**2)
    calls = {name: method.call for name, method in methods.items()} | limits
    timings = interleaved(calls, budget=0.1 if small else 2.0, most=30)
    for name, method in methods.items():
        yield {
            "section": section,
            "method": name,
            "delay": delay,
            "batch": side**2,
            "points": method.points,
            **timings[name].columns(),
            "seconds_per_point": timings[name].median / method.points,
            **_errors(method, judged),
            **_ratios(method, methods, timings, side**2),
        }


@cache
def _exact(delay: float) -> ExactSlice:
    return ExactSlice(GAMMA, DELTA, delay)


def _methods(exact: ExactSlice, side: int) -> list[Method]:
    alpha_ends, beta_ends = exact.box()
    alpha, beta = np.linspace(*alpha_ends, side), np.linspace(*beta_ends, side)[:, None]
    family = LoopFamily(GAMMA, DELTA, exact.delay)
    degree = family.plant.size - 1
    slice_ = [points.ravel() for points in np.broadcast_arrays(alpha, beta)]
    order = np.random.default_rng(0).permutation(side**2)

    def part(most: float) -> Points:
        return tuple(points[order[: max(int(most), 1)]] for points in slice_)

    lapack = part(LAPACK_WORK / degree**2)
    on_cpu = jax.default_backend() == "cpu"
    accelerated = lapack if on_cpu else part(_EIGENVALUES_ON_ACCELERATOR)
    one_by_one = part(_PYTHON_POINTS)
    matrices, device_matrices = family.companions(*lapack), family.companions(*accelerated)
    device_matrices = jax.device_put(device_matrices)
    polynomials = family.coefficients(*one_by_one)
    systems = [control.tf([1.0], polynomial, dt=True) for polynomial in polynomials]

    verdict = partial(_verdict, exact.delay)
    radius = partial(_radius, exact.delay)
    companion = partial(_radius, exact.delay, method="companion")
    return [
        Method("verdict", True, side**2, partial(verdict, alpha, beta), verdict),
        Method(
            "spectral_radius",
            False,
            side**2,
            partial(radius, alpha, beta),
            lambda *points: np.asarray(radius(*points).value),
        ),
        Method(
            "spectral_radius, companion",
            False,
            lapack[0].size,
            partial(companion, *lapack),
            lambda *points: np.asarray(companion(*points).value),
        ),
        Method(
            "numpy eigvals",
            False,
            len(matrices),
            partial(np.linalg.eigvals, matrices),
            lambda *points: largest_modulus(np.linalg.eigvals(family.companions(*points))),
        ),
        Method(
            "jax eigvals",
            False,
            len(device_matrices),
            partial(jax_eigenvalues, device_matrices),
            lambda *points: largest_modulus(jax_eigenvalues(family.companions(*points))),
        ),
        Method(
            "numpy.roots",
            False,
            len(polynomials),
            lambda: [np.roots(polynomial) for polynomial in polynomials],
            lambda *points: largest_modulus([np.roots(p) for p in family.coefficients(*points)]),
        ),
        Method(
            "python-control poles",
            False,
            len(systems),
            lambda: [system.poles() for system in systems],
            lambda *points: largest_modulus(
                [control.tf([1.0], p, dt=True).poles() for p in family.coefficients(*points)]
            ),
        ),
    ]


def _verdict(delay: float, alpha: np.ndarray, beta: np.ndarray) -> jax.Array:
    return jaxstab.verdict(alpha, beta, gamma=GAMMA, delta=DELTA, delay=delay)


def _radius(
    delay: float, alpha: np.ndarray, beta: np.ndarray, method: str = "fast"
) -> jaxstab.results.SpectralRadius:
    return jaxstab.spectral_radius(
        alpha, beta, gamma=GAMMA, delta=DELTA, delay=delay, method=method
    )


# ---------------------------------------------------------------------------------------- errors


@cache
def _judged(delay: float, boundary_points: int) -> Judged:
    """Return points at distances 1e-3 ... 1e-16 on both sides of the boundary."""
    exact = _exact(delay)
    border = exact.points(boundary_points)
    centre = border.mean(axis=0)
    step = np.concatenate([sign * 10.0 ** np.arange(-16.0, -2.0) for sign in (-1, 1)])
    alpha, beta = (centre + (1.0 + step[:, None, None]) * (border - centre)).reshape(-1, 2).T
    # Points that are exact for every method: the loop with a root at 1 is on the boundary.
    points = [p for p in zip(alpha, beta, strict=True) if exact.is_stable(*p) is not None]
    alpha, beta = np.array(points).T
    return Judged(
        alpha,
        beta,
        np.array([exact.distance(*point) for point in points]),
        np.array([exact.is_stable(*point) for point in points]),
        np.array([exact.radius(*point) for point in points]),
    )


def _errors(method: Method, judged: Judged) -> dict[str, Any]:
    answer = np.asarray(method.answer(judged.alpha, judged.beta))
    codes = (
        answer if method.is_verdict else np.where(answer < 1.0, Verdict.STABLE, Verdict.UNSTABLE)
    )
    right = codes == np.where(judged.stable, Verdict.STABLE, Verdict.UNSTABLE)
    undecided = codes == Verdict.UNDECIDED
    band = float(judged.distance[~right].max(initial=0.0))
    common = {
        "judged": len(right),
        "wrong": int(np.sum(~right & ~undecided)),
        "undecided": int(np.sum(undecided)),
        "band": band,
    }
    if method.is_verdict:
        return {"error": band, "error_measure": BAND, **common}
    error = float(np.abs(answer - judged.radius).max())
    return {"error": error, "error_measure": RADIUS_ERROR, **common}


# ---------------------------------------------------------------------------- the machine's limit


def _limits(delay: float, points: int) -> dict[str, Callable[[], Any]]:
    """Return what the machine needs for the arithmetic alone and for writing the results."""
    x, y = jax.random.uniform(jax.random.key(0), (2, points), jnp.float64)
    plain = _plain_kernel(arithmetic(delay))
    codes, numbers = np.empty(points, np.int8), np.empty(points)
    return {
        "plain arithmetic": partial(plain, x, y),
        "write int8": partial(codes.fill, 1),
        "write float64": partial(numbers.fill, 1.0),
    }


def _ratios(
    method: Method, methods: dict[str, Method], timings: dict[str, Timing], points: int
) -> dict[str, Any]:
    if method.name not in ("verdict", "spectral_radius"):
        return {}
    per_point = timings[method.name].median / method.points

    def times(rival: str) -> float:
        return timings[rival].median / methods[rival].points / per_point

    def cpu_times(rival: str) -> float:
        cpu = [float(np.median(timings[name].cpu_seconds)) for name in (rival, method.name)]
        return cpu[0] / methods[rival].points / (cpu[1] / method.points)

    memory = timings["write int8" if method.is_verdict else "write float64"].median / points
    ratios: dict[str, Any] = {
        "times_numpy_eigvals": times("numpy eigvals"),
        "times_jax_eigvals": times("jax eigvals"),
        "cpu_times_numpy_eigvals": cpu_times("numpy eigvals"),
        "cpu_times_jax_eigvals": cpu_times("jax eigvals"),
        "memory_writes": per_point / memory,
    }
    if method.is_verdict:
        ratios["share_of_plain_arithmetic"] = (
            timings["plain arithmetic"].median / points / per_point
        )
    return ratios


@cache
def arithmetic(delay: float) -> float:
    """Return the operations of the verdict per point, as XLA counts them in the compiled code.

    It counts the body of a loop once, so long delays are extrapolated: the recursion takes one more
    step for each sample of delay.
    """
    if delay > 5.0:
        slope = (arithmetic(5.0) - arithmetic(2.0)) / 3.0
        return arithmetic(5.0) + slope * (delay - 5.0)
    axis = np.linspace(0.0, 0.1, 64)
    compiled = jax.jit(partial(_verdict, delay)).lower(axis, axis[:, None]).compile()
    return float(compiled.cost_analysis()["flops"]) / axis.size**2


@cache
def _plain_kernel(operations: float) -> Callable[[jax.Array, jax.Array], jax.Array]:
    """Return a kernel of so many multiplications and additions per point and nothing else."""
    steps = max(round(operations / 2.0 / _CHAINS), 1)

    @compiled(wide=True)
    def kernel(x: jax.Array, y: jax.Array) -> jax.Array:
        chains = [x + chain for chain in range(_CHAINS)]
        for _ in range(steps):
            chains = [chain * y + x for chain in chains]
        return (sum(chains) > 0.0).astype(jnp.int8)

    return kernel
