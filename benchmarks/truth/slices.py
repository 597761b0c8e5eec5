"""The exact boundary of one slice, from the 50-digit truth: the judge of the rivals.

Lengths are relative to the size of the stable region: alpha and beta are divided by its extents.
"""

from functools import cached_property
from typing import NamedTuple

import numpy as np
from mpmath import mp, mpc, mpf

from benchmarks import truth
from benchmarks.truth.balls import BallLoop
from benchmarks.truth.filtered import FilteredLoop, average, difference

_ANGLES = 4000  # of the scan that finds the pieces of the boundary
_LINE_POINTS = 200
_BISECTIONS = 45
_DIGITS = 40
_ON_CIRCLE = 1e-9  # float64 roots this close to the circle count as inside
_STEPS = 6  # of the search for the nearest point; each doubles the digits


class Piece(NamedTuple):
    """A stretch of the boundary in its order: parameters (angles, or beta on a line) and points."""

    root: complex | None  # of a line, where it is real
    parameters: np.ndarray
    points: np.ndarray


class ExactSlice:
    """The boundary of the stable region in (alpha, beta) at one gamma, delta and delay."""

    def __init__(self, gamma: float, delta: float, delay: float) -> None:
        self.gamma, self.delta, self.delay = gamma, delta, delay
        self.whole, self.fraction = truth.split_delay(delay)
        self.plant = truth.plant(gamma, delta, self.fraction)

    @cached_property
    def _balls(self) -> BallLoop:
        return FilteredLoop(self.gamma, self.delta, self.delay, difference(1), average(1)).balls()

    @cached_property
    def pieces(self) -> list[Piece]:
        """All stretches that bound the stable region, found by a scan with bisected ends.

        All roots are followed in float64: a point of the curve or of a line is on the boundary when
        the roots that do not make it such a point are inside.
        """
        even = np.pi * np.arange(1, _ANGLES) / _ANGLES
        small = np.geomspace(1e-8, 0.9 * even[0], 20)
        pieces = self._pieces_of(None, np.concatenate([small, even, np.pi - small[::-1]]))
        ends = [piece.points[[0, -1], 1] for piece in pieces]
        beta = np.concatenate([piece.points[:, 1] for piece in pieces])
        # The two lines bound nothing without the curve, so none reaches far beyond it. They end
        # where they meet it or each other: the scan is dense there.
        crossing = (float(self._wall(mpc(-1)).real) + self.gamma) / 2.0
        reach = 2.0 * np.ptp(beta)
        near = reach * np.geomspace(1e-7, 0.1, _LINE_POINTS)
        keys = np.concatenate([*ends, [crossing]])[:, None]
        even = np.linspace(beta.min() - reach, beta.max() + reach, 5 * _LINE_POINTS)
        scan = np.unique(np.concatenate([even, *(keys - near), *(keys + near)]))
        return pieces + self._pieces_of(1.0, scan) + self._pieces_of(-1.0, scan)

    @cached_property
    def size(self) -> np.ndarray:
        """The extents of the stable region along alpha and beta."""
        return np.ptp(np.concatenate([piece.points for piece in self.pieces]), axis=0)

    def box(self, margin: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
        """Return the ends of alpha and of beta around the stable region."""
        points = np.concatenate([piece.points for piece in self.pieces])
        low, high = points.min(axis=0) - margin * self.size, points.max(axis=0) + margin * self.size
        return np.array([low[0], high[0]]), np.array([low[1], high[1]])

    def points(self, count: int) -> np.ndarray:
        """Return points of the boundary at equal distances along it, shape (count, 2)."""
        steps = [np.linalg.norm(np.diff(p.points / self.size, axis=0), axis=1) for p in self.pieces]
        ends = np.cumsum([step.sum() for step in steps])
        wanted = (np.arange(count) + 0.5) / count * ends[-1]
        found = []
        for piece, step, end in zip(self.pieces, steps, ends, strict=True):
            length = np.concatenate([[0.0], np.cumsum(step)]) + end - step.sum()
            here = wanted[(wanted > length[0]) & (wanted <= end)]
            found.append(self._on_path(piece.root, np.interp(here, length, piece.parameters)))
        return np.concatenate(found)

    def distance(self, alpha: float, beta: float) -> float:
        """Return how far a point is from the boundary, relative to the size of the region."""
        point = np.array([alpha, beta])
        return float(min(self._distance_to(piece, point) for piece in self.pieces))

    def largest_distance(self, points: np.ndarray, count: int) -> float:
        """Return the largest distance of points from the boundary, of count of them."""
        return max(self.distance(*point) for point in chosen(points, count))

    def largest_radius_error(self, points: np.ndarray, count: int) -> float:
        """Return the largest |spectral radius - 1|, by certified roots, of count points."""
        ends = [self._radius_ends(*point) for point in chosen(points, count)]
        return float(max(abs((lower + upper) / 2 - 1) for lower, upper in ends))

    def gap(self, segments: np.ndarray, count: int) -> float:
        """Return the largest distance of the boundary's points from segments (n, 2, 2)."""
        start, end = segments[:, 0] / self.size, segments[:, 1] / self.size
        along = end - start
        square = np.maximum((along**2).sum(axis=1), np.finfo(float).tiny)
        largest = 0.0
        for point in self.points(count) / self.size:
            part = np.clip(((point - start) * along).sum(axis=1) / square, 0.0, 1.0)
            nearest = np.linalg.norm(start + part[:, None] * along - point, axis=1).min()
            largest = max(largest, float(nearest))
        return largest

    def radius(self, alpha: float, beta: float) -> float:
        """Return the certified spectral radius."""
        return float(sum(self._radius_ends(alpha, beta)) / 2)

    def is_stable(self, alpha: float, beta: float) -> bool | None:
        """Return the certified verdict; None where balls of 1400 bits do not tell."""
        return self._balls.is_stable(float(alpha), float(beta))

    def curve(self, angle: mpf) -> tuple[mpf, mpf]:
        """Return (alpha, beta) with roots at exp(+-i angle)."""
        with mp.workdps(_DIGITS):
            z = mp.expj(angle)
            w, slope = self._wall(z), 1 - 1 / z
            beta = w.imag / slope.imag
            return w.real - beta * slope.real, beta

    def _radius_ends(self, alpha: float, beta: float) -> tuple[mpf, mpf]:
        return truth.spectral_radius(float(alpha), float(beta), self.gamma, self.delta, self.delay)

    def _wall(self, z: mpc) -> mpc:
        """Return -z^(n+1) D/N, which is alpha + beta (1 - 1/z) where z is a root."""
        p = self.plant
        denominator, numerator = (z + p.d1) * z + p.d0, (p.n2 * z + p.n1) * z + p.n0
        return -(z ** (self.whole + 1)) * denominator / numerator

    def _on_path(self, root: complex | None, parameters: np.ndarray) -> np.ndarray:
        """Return points of the curve, or of the line of a real root; shape (n, 2)."""
        if root is None:
            pairs = [self.curve(mpf(float(angle))) for angle in parameters]
            return np.array([[float(v) for v in pair] for pair in pairs]).reshape(-1, 2)
        if root > 0:
            return np.stack([np.full(parameters.shape, -self.gamma), parameters], axis=1)
        offset = float(self._wall(mpc(-1)).real)
        return np.stack([offset - 2.0 * parameters, parameters], axis=1)

    def _pieces_of(self, root: complex | None, scan: np.ndarray) -> list[Piece]:
        def bounds(parameters: np.ndarray) -> np.ndarray:
            known = np.exp(1j * parameters) if root is None else np.full(parameters.shape, root)
            pair = np.stack([known, known.conj()][: 2 if root is None else 1], axis=1)
            return self._others_inside(self._on_path(root, parameters), pair)

        def end(inside: float, outside: float) -> float:
            for _ in range(_BISECTIONS):
                middle = (inside + outside) / 2.0
                inside, outside = (
                    (middle, outside)
                    if bounds(np.array([middle]))[0]
                    else (
                        inside,
                        middle,
                    )
                )
            return inside

        pieces = []
        mask = np.concatenate([[False], bounds(scan), [False]])
        scan = np.concatenate([scan[:1], scan, scan[-1:]])
        for first, stop in np.flatnonzero(np.diff(mask)).reshape(-1, 2) + 1:
            run = scan[first:stop]
            run = np.array([end(run[0], scan[first - 1]), *run, end(run[-1], scan[stop])])
            pieces.append(Piece(root, run, self._on_path(root, run)))
        return pieces

    def _others_inside(self, points: np.ndarray, known: np.ndarray) -> np.ndarray:
        """Say where all roots are inside but the known ones, shape (point, root)."""
        p, n = self.plant, self.whole
        n2, n1, n0 = float(p.n2), float(p.n1), float(p.n0)
        alpha, beta = points.T
        coefficients = np.zeros((points.shape[0], n + 5))
        coefficients[:, :3] = 1.0, float(p.d1), float(p.d0)
        for place, force in enumerate((n2, n1, n0), start=n + 1):
            coefficients[:, place] += force * (alpha + beta)
            coefficients[:, place + 1] -= force * beta
        inside = []
        for polynomial, roots in zip(coefficients, known, strict=True):
            others = list(np.roots(polynomial))
            for root in roots:
                del others[int(np.argmin(np.abs(np.array(others) - root)))]
            inside.append(max(map(abs, others), default=0.0) < 1.0 + _ON_CIRCLE)
        return np.array(inside)

    def _distance_to(self, piece: Piece, point: np.ndarray) -> mpf:
        offsets = (piece.points - point) / self.size
        nearest = float(piece.parameters[int(np.argmin((offsets**2).sum(axis=1)))])
        alpha, beta = mpf(float(point[0])), mpf(float(point[1]))
        size_alpha, size_beta = mpf(float(self.size[0])), mpf(float(self.size[1]))

        def offset(parameter: mpf) -> mpc:
            on_path = self._exactly_on_path(piece.root, parameter)
            return mpc((on_path[0] - alpha) / size_alpha, (on_path[1] - beta) / size_beta)

        with mp.workdps(_DIGITS):
            lowest, highest = (mpf(float(p)) for p in piece.parameters[[0, -1]])
            parameter, small = mpf(nearest), mpf(10) ** -15
            for _ in range(_STEPS):
                here = offset(parameter)
                along = (offset(parameter + small) - here) / small
                shift = (here.real * along.real + here.imag * along.imag) / abs(along) ** 2
                parameter = min(max(parameter - shift, lowest), highest)
            return abs(offset(parameter))

    def _exactly_on_path(self, root: complex | None, parameter: mpf) -> tuple[mpf, mpf]:
        if root is None:
            return self.curve(parameter)
        if root > 0:
            return -mpf(self.gamma), parameter
        return self._wall(mpc(-1)).real - 2 * parameter, parameter


def chosen(points: np.ndarray, count: int) -> np.ndarray:
    """Return count of the points, evenly from all of them."""
    return points[np.linspace(0, len(points) - 1, min(count, len(points))).round().astype(int)]
