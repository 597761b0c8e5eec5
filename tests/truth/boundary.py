"""Where walls of any loop have roots on the circle, by eigenvalues alone."""

import numpy as np

from benchmarks import eigenvalues
from tests.truth.balls import BallLoop

_ON_CIRCLE = 1e-9  # float64 roots this close to the circle count as inside
_HIGH = 60  # degree above which eigenvalues take minutes
_SAMPLES, _AT_ONCE = 1 << 16, 8  # of the circle, and walls in memory


class Boundary:
    """Walls that have roots on the circle, in float64 from the truth's numbers."""

    def __init__(self, balls: BallLoop) -> None:
        size = balls.base.degree() + 1
        parts = [[float(part[k].mid()) for k in range(size)] for part in balls[:3]]
        self.parts = np.array(parts)[:, ::-1]

    def points(self, rng: np.random.Generator, angles: int = 200) -> np.ndarray:
        """Return walls (n, 2) next to which walls are stable; others where there are none.

        They are those of random angles, half of them small, and of the lines of real roots.
        """
        size = self.parts.shape[1]
        low = np.pi * 10.0 ** rng.uniform(-3.0, 0.0, angles // 2) / size
        thetas = np.concatenate([rng.uniform(0.0, np.pi, angles - low.size), low])
        curve = self.solved(np.exp(1j * thetas))
        curve = curve[np.isfinite(curve).all(axis=1)]
        scale = np.median(np.abs(curve), axis=0) if len(curve) else np.ones(2)
        walls = np.concatenate(
            [
                curve,
                *(self._line(z, scale * rng.normal(size=(angles // 8, 2))) for z in (1.0, -1.0)),
            ]
        )
        walls = walls[np.isfinite(walls).all(axis=1)]
        high = size > _HIGH
        is_stable = self._turns(walls) if high else self.largest_roots(walls) < 1.0 + _ON_CIRCLE
        return walls[is_stable] if is_stable.any() else walls

    def _turns(self, walls: np.ndarray) -> np.ndarray:
        """True where p(z)/z^n does not turn around 0 on a circle that is one sample wider."""
        base, stiffness, damping = self.parts
        wider = (1.0 + 2.0 * np.pi / _SAMPLES) ** -np.arange(len(base), dtype=float)
        turns = []
        for start in range(0, len(walls), _AT_ONCE):
            some = walls[start : start + _AT_ONCE]
            p = (base + some[:, :1] * stiffness + some[:, 1:] * damping) * wider
            values = np.fft.rfft(p, _SAMPLES)
            turns += np.angle(values[:, 1:] / values[:, :-1]).sum(axis=1).tolist()
        return np.abs(turns) < 1.0

    def largest_roots(self, walls: np.ndarray) -> np.ndarray:
        """Return the largest |z| of walls (n, 2), by eigenvalues."""
        base, stiffness, damping = self.parts
        return eigenvalues.radius(base + walls[:, :1] * stiffness + walls[:, 1:] * damping)

    def solved(self, z: np.ndarray) -> np.ndarray:
        """Return walls (n, 2) with roots at points of the upper half circle."""
        base, stiffness, damping = (np.polyval(part, z) for part in self.parts)
        with np.errstate(all="ignore"):
            determinant = (np.conj(stiffness) * damping).imag
            alpha = (np.conj(damping) * base).imag / determinant
            beta = -(np.conj(stiffness) * base).imag / determinant
        return np.stack([alpha, beta], axis=1)

    def _line(self, z: float, walls: np.ndarray) -> np.ndarray:
        """Return walls (n, 2) moved along one axis to where they have a root at z = 1 or -1."""
        base, stiffness, damping = (float(np.polyval(part, z)) for part in self.parts)
        alpha, beta = walls.T
        with np.errstate(all="ignore"):
            if abs(stiffness) > abs(damping):
                alpha = -(base + damping * beta) / stiffness
            else:
                beta = -(base + stiffness * alpha) / damping
        return np.stack([alpha, beta], axis=1)
