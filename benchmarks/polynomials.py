"""Batches of any polynomials, on the device that JAX prefers: is_schur and radius beside rivals.

Rivals answer by eigenvalues of companion matrices: jax.numpy (one matrix after the other, also on
a GPU), numpy (LAPACK), and numpy.roots in a loop. Half of the polynomials have roots anywhere,
half have clusters of roots, down to 1e-6 apart. ``error`` is the largest error of a radius relative
to 40 digits (mpmath) on some of them, ``too_small`` how many of these have an error beyond the
bound that is told, ``open`` how many are not answered.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import mpmath
import numpy as np

import jaxstab
from benchmarks.record import Row
from benchmarks.timing import interleaved

DEGREES = 3, 5, 10, 20, 40, 60
_MANY, _SOME = 1 << 16, 1 << 10  # polynomials of a call: of jaxstab, and of rivals that are slower
_JUDGED = 10
MEASURE = "largest relative error of a radius; of is_schur the share of wrong verdicts"


def rows(small: bool) -> Iterator[Row]:
    for degree in DEGREES[: 2 if small else None]:
        yield from _of_degree(degree, *((1 << 8, 1 << 5, 6) if small else (_MANY, _SOME, _JUDGED)))


def _of_degree(degree: int, many: int, some: int, judged: int) -> Iterator[Row]:
    given = _drawn(np.random.default_rng(degree), degree, many)
    batch, few = jnp.asarray(given), given[:some]
    truth = np.array([_radius(row) for row in given[:judged]])
    calls: dict[str, tuple[int, Callable[[], Any]]] = {
        "jaxstab.is_schur": (many, partial(jax.jit(jaxstab.is_schur), batch)),
        "jaxstab.radius": (some, partial(jax.jit(jaxstab.radius), batch[:some])),
        "jax.numpy eigvals": (some, partial(jax.jit(_by_jax), batch[:some])),
        "numpy eigvals": (some, partial(_by_numpy, few)),
        "numpy.roots": (some, lambda: [np.abs(np.roots(row)).max() for row in few]),
    }
    timings = interleaved({name: call for name, (_, call) in calls.items()}, budget=2.0, least=5)
    for name, timing in timings.items():
        points, answer = calls[name][0], timing.answer
        columns: dict[str, Any] = {}
        if name == "jaxstab.is_schur":
            codes = np.asarray(answer)
            wrong = (codes[:judged] != 3) & ((codes[:judged] == 1) != (truth < 1))
            error, columns = float(np.mean(wrong)), {"open": int(np.sum(codes == 3))}
        else:
            found = answer.value if name == "jaxstab.radius" else answer
            apart = np.abs(np.asarray(found)[:judged] - truth)
            error = float(np.max(apart / truth))
            if name == "jaxstab.radius":
                bound = np.asarray(answer.error)
                columns = {
                    "open": int(np.sum(np.isinf(bound))),
                    "too_small": int(np.sum(apart > bound[:judged])),
                }
        yield {
            "section": f"degree {degree}",
            "method": name,
            "delay": 0.0,
            "points": points,
            **timing.columns(),
            "seconds_per_point": timing.median / points,
            "error": error,
            "error_measure": MEASURE,
            **columns,
        }


def _drawn(rng: np.random.Generator, degree: int, count: int) -> np.ndarray:
    """Monic polynomials by their roots, conjugates beside them."""
    pairs = degree // 2
    moduli, angles = rng.uniform(0.0, 1.05, (count, pairs)), rng.uniform(0.0, np.pi, (count, pairs))
    spread = 10.0 ** rng.uniform(-6.0, -1.0, (count // 2, 1))
    moduli[: count // 2] = moduli[: count // 2, :1] + spread * moduli[: count // 2]
    angles[: count // 2] = angles[: count // 2, :1] + spread * angles[: count // 2]
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
    order = rng.permutation(count)
    return rows[order]


def _companion(rows: Any, xp: Any) -> Any:
    degree = rows.shape[1] - 1
    below = xp.broadcast_to(xp.eye(degree)[:-1], (len(rows), degree - 1, degree))
    return xp.concatenate([-rows[:, None, 1:], below], axis=1)


def _by_jax(rows: Any) -> Any:
    return jnp.abs(jnp.linalg.eigvals(_companion(rows, jnp))).max(axis=-1)


def _by_numpy(rows: np.ndarray) -> np.ndarray:
    return np.abs(np.linalg.eigvals(_companion(rows, np))).max(axis=-1)


def _radius(row: np.ndarray) -> float:
    with mpmath.workdps(40):
        rising = [mpmath.mpf(c) for c in row[::-1].tolist()]
        roots = mpmath.polyroots(rising, maxsteps=1000, extraprec=2000, asc=True)
        return float(max(abs(root) for root in roots))
