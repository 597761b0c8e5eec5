"""The questions of ``latency`` answered by NumPy's eigenvalues, without jaxstab, JAX and SciPy.

`python -m benchmarks.eigenvalues QUESTION` prints what jaxstab is asked for there. The plant is
eq. (9) as printed, poles are those of companion matrices, and searches are grids.
"""

import sys

import numpy as np

ALPHA, BETA, GAMMA, DELTA, DELAY = 0.05, 0.2, 1e-3, 0.01275, 1
SAMPLE_TIME, MASS = 1e-3, 0.4

Values = np.ndarray | float

_GRID = 200
_WINDOW = (0.2, 1.2)  # of alpha and beta: the stable set is inside


def printed_plant(gamma: Values, delta: Values) -> tuple[Values, Values, Values, Values]:
    """d1, d0, n1 and n0 by eq. (9) as printed, divided by -2 c1 gamma: what the library avoids."""
    with np.errstate(all="ignore"):
        c1 = np.sqrt(np.asarray(delta, complex) ** 2 - 4.0 * gamma)
        c2, c3, d0 = np.exp(-(delta + c1) / 2.0), np.exp(-(delta - c1) / 2.0), np.exp(-delta)
        unit = -2.0 * c1 * gamma
        n1 = ((c3 + c2 - 2.0) * c1 + (c3 - c2) * delta) / unit
        n0 = ((c3 + c2 - 2.0 * d0) * c1 + (c2 - c3) * delta) / unit
        return -(c2 + c3).real, d0, n1.real, n0.real


def polynomial(
    alpha: Values, beta: Values, gamma: Values = GAMMA, delta: Values = DELTA, delay: int = DELAY
) -> np.ndarray:
    """Coefficients of the characteristic polynomial, shape (..., 4 + delay)."""
    d1, d0, n1, n0 = printed_plant(gamma, delta)
    p = np.zeros((*np.broadcast_shapes(*map(np.shape, (alpha, beta, n1))), 4 + delay))
    p[..., 0], p[..., 1], p[..., 2] = 1.0, d1, d0
    with np.errstate(all="ignore"):
        p[..., -3] += n1 * (alpha + beta)
        p[..., -2] += n0 * (alpha + beta) - n1 * beta
        p[..., -1] -= n0 * beta
    return p


def companions(p: np.ndarray) -> np.ndarray:
    """The companion matrices of monic polynomials, as numpy.roots has them."""
    degree = p.shape[-1] - 1
    matrices = np.zeros((*p.shape[:-1], degree, degree))
    matrices[..., 0, :] = -p[..., 1:]
    matrices[..., range(1, degree), range(degree - 1)] = 1.0
    return matrices


def radius(p: np.ndarray) -> np.ndarray:
    """The largest modulus of a root of each polynomial; infinite where a coefficient is."""
    is_finite = np.isfinite(p).all(axis=-1)
    poles = np.linalg.eigvals(companions(np.where(is_finite[..., None], p, 0.0)))
    return np.where(is_finite, np.abs(poles).max(axis=-1), np.inf)


def grid(
    low: tuple[float, float] = (-0.05, 0.0), high: tuple[float, float] = _WINDOW
) -> tuple[np.ndarray, np.ndarray]:
    """Alphas (a column) and betas (a row) of a grid."""
    alpha, beta = (np.linspace(a, b, _GRID) for a, b in zip(low, high, strict=True))
    return alpha[:, None], beta[None, :]


def verdict() -> list[float]:
    return [1.0 if abs(np.roots(polynomial(ALPHA, BETA))).max() < 1.0 else 2.0]


def spectral_radius() -> list[float]:
    return [float(abs(np.roots(polynomial(ALPHA, BETA))).max())]


def outline() -> list[float]:
    import contourpy

    alpha, beta = grid()
    lines = contourpy.contour_generator(
        alpha[:, 0], beta[0], radius(polynomial(alpha, beta)).T
    ).lines(1.0)
    return [float(max(line[:, 0].max() for line in lines))]


def picture() -> list[float]:
    from matplotlib import pyplot

    alpha, beta = grid()
    values = radius(polynomial(alpha, beta))
    pyplot.contourf(beta[0], alpha[:, 0], values, levels=20)
    pyplot.contour(beta[0], alpha[:, 0], values, levels=[1.0])
    pyplot.savefig("eigenvalues.png")
    return [float(alpha[(values < 1.0).any(axis=1)].max())]


def margins() -> list[float]:
    """The largest stable K at this B, and the same for B at this K, and for the delay, by steps."""
    alphas, betas = np.linspace(ALPHA, 0.2, _GRID), np.linspace(BETA, 1.2, _GRID)
    for_alpha = alphas[radius(polynomial(alphas, BETA)) < 1.0]
    _ = betas[radius(polynomial(ALPHA, betas)) < 1.0]
    _ = [radius(polynomial(ALPHA, BETA, delay=delay)) for delay in range(20)]
    return [float(for_alpha.max())]


def best_gains() -> list[float]:
    """The smallest radius of a grid, and of two finer ones around it."""
    low, high = (0.0, 0.0), (0.05, 0.5)
    for _ in range(3):
        alpha, beta = grid(low, high)
        values = radius(polynomial(alpha, beta))
        i, j = np.unravel_index(values.argmin(), values.shape)
        a, b = float(alpha[i, 0]), float(beta[0, j])
        steps = (high[0] - low[0]) / 40.0, (high[1] - low[1]) / 40.0
        low, high = (a - steps[0], b - steps[1]), (a + steps[0], b + steps[1])
    return [float(values.min()), a, b]


def robust_region() -> list[float]:
    """True if the wall is stable at 3 x 3 hands, and the largest alpha of all walls that are."""
    alpha, beta = grid()
    stable = np.ones((_GRID, _GRID), bool)
    for gamma in np.linspace(1e-6, GAMMA, 3):
        for delta in np.linspace(0.0, 0.015, 3):
            stable &= radius(polynomial(alpha, beta, gamma, delta)) < 1.0
    return [float(alpha[stable.any(axis=1)].max())]


if __name__ == "__main__":
    print(*globals()[sys.argv[1]]())
