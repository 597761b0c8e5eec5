"""Batches of any polynomials, on the device that JAX prefers: is_schur and radius beside rivals.

Of arrays of JAX jaxstab leaves open what float64 does not tell; of NumPy's it asks balls.
Rivals answer by eigenvalues of companion matrices: jax.numpy.roots under vmap (one matrix after the
other, also on a GPU), LAPACK in batches (numpy), and numpy.roots in a loop. Roots lie anywhere, or
in a cluster, 1e-1 to 1e-6 wide. ``error`` is the largest error of a radius relative to
certified roots of python-flint, of some of them, ``too_small`` how many of these have an error
beyond the bound that is told, ``open`` how many are not answered.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import flint
import jax
import jax.numpy as jnp
import numpy as np

import jaxstab
from benchmarks import eigenvalues
from benchmarks.record import Row
from benchmarks.timing import interleaved
from tests.truth.balls import largest_modulus

DEGREES = 3, 5, 10, 20, 40, 60
_MANY, _SOME = 1 << 14, 1 << 8  # polynomials of a call: of is_schur, and of slower rivals
_JUDGED, _BITS = 100, 2400
_FEW = 16  # polynomials of a call that balls answer
MEASURE = "largest relative error of a radius; of is_schur the share of wrong verdicts"

_is_schur, _largest = jax.jit(jaxstab.is_schur), jax.jit(jaxstab.radius)


def rows(small: bool, points: int | None = None) -> Iterator[Row]:
    """``points`` polynomials in a call of is_schur, a 64th in one of radius: a GPU has room."""
    sizes = (1 << 10, 1 << 5, 6) if small else (points or _MANY, _SOME, _JUDGED)
    for degree in DEGREES[: 1 if small else None]:
        for is_clustered in (False, True):
            yield from _of_degree(degree, is_clustered, *sizes, budget=0.05 if small else 1.0)


def _of_degree(
    degree: int, is_clustered: bool, many: int, some: int, judged: int, *, budget: float
) -> Iterator[Row]:
    given = _drawn(np.random.default_rng(degree), degree, many, is_clustered)
    batch, few = jnp.asarray(given), given[:some]
    exact = ([flint.arb(c) for c in row] for row in given[:judged].tolist())
    truth = np.array([float(largest_modulus(row, _BITS)) for row in exact])
    calls: dict[str, tuple[int, Callable[[], Any]]] = {
        "jaxstab.is_schur": (many, partial(_is_schur, batch)),
        "jaxstab.radius": (many // 64, partial(_largest, batch[: many // 64])),
        "jaxstab.radius, balls": (_FEW, partial(jaxstab.radius, given[:_FEW])),
        "jax.numpy.roots": (some, partial(_by_jax, batch[:some])),
        "numpy eigvals": (some, partial(eigenvalues.radius, few)),
        "numpy.roots": (some, lambda: [np.abs(np.roots(row)).max() for row in few]),
    }
    timings = interleaved({name: call for name, (_, call) in calls.items()}, budget=budget, least=3)
    for name, timing in timings.items():
        points, answer = calls[name][0], timing.answer
        columns: dict[str, Any] = {}
        if name == "jaxstab.is_schur":
            codes = np.asarray(answer)
            wrong = (codes[:judged] != 3) & ((codes[:judged] == 1) != (truth < 1))
            error, columns = float(np.mean(wrong)), {"open": int(np.sum(codes == 3))}
        else:
            is_bounded = name.startswith("jaxstab.radius")
            found = np.asarray(answer.value if is_bounded else answer)[:judged]
            apart = np.abs(found - truth[: found.size])
            error = float(np.max(apart / truth[: found.size]))
            if is_bounded:
                bound = np.asarray(answer.error)
                columns = {
                    "open": int(np.sum(np.isinf(bound))),
                    "too_small": int(np.sum(apart > bound[: found.size])),
                }
        yield timing.row(
            f"degree {degree}{', clustered' * is_clustered}",
            name,
            error,
            MEASURE,
            points=points,
            seconds_per_point=timing.median / points,
            cpu_seconds_per_point=timing.cpu_median / points,
            **columns,
        )


def _drawn(rng: np.random.Generator, degree: int, count: int, is_clustered: bool) -> np.ndarray:
    """Monic polynomials by their roots, conjugates beside them."""
    pairs = degree // 2
    moduli, angles = rng.uniform(0.0, 1.05, (count, pairs)), rng.uniform(0.0, np.pi, (count, pairs))
    if is_clustered:
        spread = 10.0 ** rng.uniform(-6.0, -1.0, (count, 1))
        moduli = moduli[:, :1] + spread * moduli
        angles = angles[:, :1] + spread * angles
    rows = np.ones((count, 1))
    real = np.full((count, 1), 0.5)
    factors = [
        np.stack([-2.0 * r * np.cos(a), r**2], -1) for r, a in zip(moduli.T, angles.T, strict=True)
    ]
    for factor in [*factors, *([-real] if degree % 2 else [])]:
        longer = np.concatenate([rows, np.zeros((count, factor.shape[1]))], axis=1)
        for k in range(factor.shape[1]):
            longer[:, k + 1 : k + 1 + rows.shape[1]] += factor[:, k : k + 1] * rows
        rows = longer
    return rows


@jax.jit
def _by_jax(rows: Any) -> Any:
    return jnp.abs(jax.vmap(partial(jnp.roots, strip_zeros=False))(rows)).max(axis=-1)
