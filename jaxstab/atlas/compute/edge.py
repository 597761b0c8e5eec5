"""Where the closed-form boundary of a slice bounds the stable set, sampled.

All calls are of one shape, so that each is compiled once for a delay, or for all long ones.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.conventions import STABLE
from jaxstab.point import verdict
from jaxstab.region.curve import boundary_curve, minus_line

SAMPLES = 1024
_EVEN = np.linspace(0.0, 1.0, SAMPLES // 2 + 1, endpoint=False)[1:]
_ANGLES = np.pi * np.sort(np.concatenate([_EVEN**2, _EVEN]))  # at a long delay the edge is near 0
_TURNS = 2.0 * np.pi * np.arange(SAMPLES) / SAMPLES
_ASIDE = 1e-3  # of the way to the next point, or of the size of what is looked at

Samples = Float64[np.ndarray, " sample"]


class Edge(NamedTuple):
    """Points of the boundary, and which of them have a stable point beside them."""

    alpha: Samples
    beta: Samples
    is_edge: Bool[np.ndarray, " sample"]


class Plane(NamedTuple):
    """The (alpha, beta) plane of one loop."""

    gamma: float
    delta: float
    delay: float

    def curve(self) -> Edge:
        """Sample the curve of a pair of roots on the unit circle, at the same angles always."""
        alpha, beta = map(np.asarray, boundary_curve(_ANGLES, *self))
        # On the left of the curve the pair is inside.
        aside = -_ASIDE * np.gradient(beta), _ASIDE * np.gradient(alpha)
        return Edge(alpha, beta, self._is_stable(alpha + aside[0], beta + aside[1]))

    def lines(self, beta: Samples, width: float) -> tuple[Edge, Edge]:
        """Sample the lines of a real root at 1 and at -1 in a stable set of this width."""
        at_one = np.full_like(beta, -self.gamma)
        at_minus_one = np.asarray(minus_line(beta, *self))
        return self._line(at_one, beta, width), self._line(at_minus_one, beta, width)

    def corner(self) -> Edge:
        """Return the point where the two lines cross."""
        alpha = -self.gamma
        beta = 0.5 * (float(minus_line(0.0, *self)) - alpha)
        is_edge = False
        if np.isfinite(beta):
            close = _ASIDE * (abs(alpha) + abs(beta))
            around = alpha + close * np.cos(_TURNS), beta + close * np.sin(_TURNS)
            is_edge = bool(self._is_stable(*around).any())
        return Edge(np.array([alpha]), np.array([beta]), np.array([is_edge]))

    def _line(self, alpha: Samples, beta: Samples, width: float) -> Edge:
        left, right = (self._is_stable(alpha + side * width, beta) for side in (-_ASIDE, _ASIDE))
        return Edge(alpha, beta, left != right)

    def _is_stable(self, alpha: Samples, beta: Samples) -> Bool[np.ndarray, " sample"]:
        known = np.isfinite(alpha) & np.isfinite(beta)
        point = np.where(known, alpha, 0.0), np.where(known, beta, 0.0)
        stable: np.ndarray = known & (np.asarray(verdict(*point, *self)) == STABLE)
        return stable
