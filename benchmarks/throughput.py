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
from itertools import zip_longest
from typing import Any

import control
import jax
import numpy as np

import jaxstab
from benchmarks.record import Row
from benchmarks.rivals import LAPACK_WORK, LoopFamily, jax_eigenvalues, largest_modulus
from benchmarks.timing import Timing, interleaved
from benchmarks.truth.slices import ExactSlice
from jaxstab.arrays import namespace, repeat
from jaxstab.batches import MANY, TILE, compiled, over_tiles
from jaxstab.conventions import Verdict
from jaxstab.model import polynomial_degree
from jaxstab.point.verdicts import float_plant

GAMMA, DELTA = 1e-3, 0.015
BAND = "largest distance from the boundary with a wrong or no verdict, relative to the region"
RADIUS_ERROR = "largest error of the spectral radius by certified roots"

PLAIN = "Schur-Cohn, not proved"
_NO_ERROR = {"error": 0.0, "error_measure": "nothing is computed"}
_HIGHEST_UNROLLED, _WITHOUT_TILES, _SHORT, _TILE = 26, 4, 12, 512  # the quickest of those tried
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
    writes = _writes(side**2)
    calls = {name: method.call for name, method in methods.items()} | writes
    timings = interleaved(calls, budget=0.1 if small else 2.0, most=30)
    for name in calls:
        method = methods.get(name)
        points = method.points if method else side**2
        yield {
            "section": section,
            "method": name,
            "delay": delay,
            "batch": side**2,
            "points": points,
            **timings[name].columns(),
            "seconds_per_point": timings[name].median / points,
            **(_errors(method, judged) if method else _NO_ERROR),
            **(_ratios(method, methods, timings, side**2) if method else {}),
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
    plain = partial(_plain_verdict, exact.delay)
    radius = partial(_radius, exact.delay)
    companion = partial(_radius, exact.delay, method="companion")
    return [
        Method("verdict", True, side**2, partial(verdict, alpha, beta), verdict),
        Method(PLAIN, True, side**2, partial(plain, alpha, beta), plain),
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


def _writes(points: int) -> dict[str, Callable[[], Any]]:
    """Return what it takes to write the results alone."""
    codes, numbers = np.empty(points, np.int8), np.empty(points)
    return {"write int8": partial(codes.fill, 1), "write float64": partial(numbers.fill, 1.0)}


def _plain_verdict(delay: float, alpha: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """Return codes by the recursion of Schur and Cohn in float64, and prove nothing."""
    fraction = delay % 1.0
    numbers = map(np.asarray, (GAMMA, DELTA, fraction))
    plant = float_plant(*numbers, is_fractional=fraction > 0.0)
    degree = polynomial_degree(delay)
    codes = _untiled_plain_codes if degree <= _WITHOUT_TILES else _plain_codes
    return np.asarray(codes(alpha, beta, plant, degree=degree))


@compiled(static=["degree"], many=MANY, wide=True, pointwise=True, parallel=True)
def _untiled_plain_codes(alpha: Any, beta: Any, plant: Any, *, degree: int) -> Any:
    return _plain(alpha, beta, plant, degree=degree)


@compiled(static=["degree"], many=MANY, wide=True, pointwise=True)
def _plain_codes(alpha: Any, beta: Any, plant: Any, *, degree: int) -> Any:
    codes = partial(_plain, degree=degree)
    return over_tiles(codes, (alpha, beta, plant), TILE if degree <= _SHORT else _TILE)


def _plain(alpha: Any, beta: Any, plant: Any, *, degree: int) -> Any:
    """Lower the degree as ``verdict`` does, on the few coefficients that are not 0."""
    xp = namespace(alpha, beta)
    one = xp.ones_like(alpha + beta)
    head = [one, one * plant.d1, one * plant.d0]  # of z^n and below
    tail = [s * alpha - d * beta for s, d in zip(plant.stiff, plant.damp, strict=True)]
    inside = one > 0.0

    def lowered(state: tuple[list[Any], list[Any], Any]) -> tuple[list[Any], list[Any], Any]:
        head, tail, inside = state
        ratio = tail[0] / head[0]
        pairs = list(zip_longest(head, tail, fillvalue=0.0))
        head = [first - ratio * last for first, last in pairs]
        tail = [last - ratio * first for first, last in pairs[1:]]
        return head, tail, inside & (abs(ratio) < 1.0)

    state, settled = (head, tail, inside), 2  # steps after which the lengths stay
    for _ in range(min(degree - 3, settled)):
        state = lowered(state)
    remaining = max(degree - 3 - settled, 0)
    if degree > _HIGHEST_UNROLLED:
        state = repeat(remaining, lowered, state)
    else:
        for _ in range(remaining):
            state = lowered(state)
    head, tail, inside = state
    cubic = [xp.zeros_like(one)] * 4
    for power, (high, low) in enumerate(zip_longest(head, tail, fillvalue=0.0)):
        cubic[power] = cubic[power] + high
        cubic[3 - power] = cubic[3 - power] + low
    a, b, c, d = cubic
    inside = inside & (a + c > abs(b + d)) & (a > abs(d)) & (a * a - d * d > a * c - b * d)
    return xp.where(inside, Verdict.STABLE, Verdict.UNSTABLE).astype(np.int8)


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
        ratios["share_of_plain_recursion"] = timings[PLAIN].median / points / per_point
    return ratios
