"""Limits of alpha in single precision, which claim no more than those in double. No JAX."""

import numpy as np
from jaxtyping import Float32, Float64

_EVALUATION = 1e-14  # of the terms of a limit, for those who add them up


def in_float32(
    terms: Float64[np.ndarray, "*cells 10"], largest: tuple[float, float, float, float]
) -> Float32[np.ndarray, "*cells 10"]:
    """Round the terms of limits to float32, and their errors up by what that changes.

    Args:
        terms: of one limit, as ``jaxstab.proofs.columns.TERMS`` has them.
        largest: the largest |beta|, gamma, delta and delay for which they are asked.
    """
    exact, error = terms[..., :-1], terms[..., -1]
    *others, delay = largest
    sizes = np.array([1.0, *largest, *(delay * size for size in (delay, *others))])
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        rounded = exact.astype(np.float32).astype(np.float64)
        moved = np.where(rounded == exact, 0.0, np.abs(rounded - exact)) * sizes
        lost = _EVALUATION * np.where(np.isfinite(exact), np.abs(exact), 0.0) * sizes
        raised = (error + moved.sum(axis=-1) + lost.sum(axis=-1)) * (1.0 + 1e-12)
        above = raised.astype(np.float32)
        above = np.where(above < raised, np.nextafter(above, np.float32(np.inf)), above)
    is_known = np.all(np.isfinite(rounded) | (rounded == exact), axis=-1) & ~np.isnan(above)
    limits = np.concatenate([rounded, above[..., None]], axis=-1).astype(np.float32)
    unknown = np.append(np.zeros(sizes.size), np.inf).astype(np.float32)
    chosen: np.ndarray = np.where(is_known[..., None], limits, unknown)
    return chosen
