"""The boundary in one slice as a polygon, with the distance that it may keep from the true curve.

For fixed (gamma, delta, delay) the number of unstable roots changes only across the closed form's
curve, by two, and across the two lines of a real root at z = 1 and z = -1, by one. So these carry a
flow: one unit along each half of a line, inwards to the point where the curve begins (theta = 0)
and outwards from the one where it ends (theta = pi), two units along the curve. On the left side of
the flow there are fewer unstable roots, as many fewer as the flow is strong.

A polygon that stays within ``reach`` of the curve can be deformed into it without passing over any
point that is farther away, so for such points the polygon counts as the curve does. ``reach`` is
measured: the distance of each vertex from the chord of its neighbours, four times what a smooth
curve keeps from the chords of single steps.
"""

from dataclasses import dataclass
from math import ceil, pi
from typing import NamedTuple, TypeVar

import numpy as np
from jax import numpy as jnp
from jaxtyping import Float64, Int64

from jaxstab.region.curve import (
    SliceCoefficients,
    curve_point,
    minus_offset,
    minus_slope,
    plus_offset,
    slice_coefficients,
)

Floats = Float64[np.ndarray, "..."]
Number = TypeVar("Number", float, np.ndarray)

_BATCH = 1024  # vertices of one call, so that one size is compiled
_SCANS = (512, 4096)  # fewest and most even vertices of the first look
_VERTICES = (512, 32768)  # fewest and most
_PER_HALF_TURN = 32  # of the first look
_TOWARDS_POLE = pi * 2.0 ** (-np.arange(1.0, 161.0) / 4.0)  # the curve flies off at zeros of N
_GAP = 0.01  # wanted, in node distances, inside of the grid
_GAP_SHARE = 0.02  # and as a share of the distance that a chord, made longer, keeps from it
_CHORD_SHARE = 0.2  # of the distance from the grid: such a chord needs no more than that
_FEWEST_PARTS = 0.02
_MOST_PARTS = 256.0  # of one step, so that one to infinity leaves vertices for the others
_ROUNDING_OF_LINES = 1e-15
_FARTHEST = 1e100  # squares stay finite
_ROUNDING = 1e-10  # of the gains: more than the closed form and the verdict leave open


@dataclass(frozen=True)
class Frame:
    """A grid of (alpha, beta) in units of its mean node distances, from its first node on."""

    x: Float64[np.ndarray, " alpha_node"]
    y: Float64[np.ndarray, " beta_node"]
    origin: tuple[float, float]
    unit: tuple[float, float]
    rounding: float  # in these units

    @classmethod
    def of(
        cls, alpha: Float64[np.ndarray, " alpha_node"], beta: Float64[np.ndarray, " beta_node"]
    ) -> "Frame":
        """Return the frame of ascending nodes, of which there may be one alone."""
        axes = (alpha, beta)
        unit = tuple(_unit(nodes) for nodes in axes)
        x, y = ((nodes - nodes[0]) / step for nodes, step in zip(axes, unit, strict=True))
        size = max(
            float(np.abs(nodes).max()) / step for nodes, step in zip(axes, unit, strict=True)
        )
        origin = (float(alpha[0]), float(beta[0]))
        return cls(x, y, origin, (unit[0], unit[1]), _ROUNDING * (size + x.size + y.size))

    def point(self, alpha: Number, beta: Number) -> tuple[Number, Number]:
        """Return gains in the units of the frame."""
        return (alpha - self.origin[0]) / self.unit[0], (beta - self.origin[1]) / self.unit[1]


def _unit(nodes: Float64[np.ndarray, " node"]) -> float:
    if nodes.size > 1:
        return float((nodes[-1] - nodes[0]) / (nodes.size - 1))
    return max(1e-3 * abs(float(nodes[0])), 1e-6)


class Pieces(NamedTuple):
    """Straight pieces of the boundary in the units of a frame."""

    x: Float64[np.ndarray, "2 piece"]  # begin and end
    y: Float64[np.ndarray, "2 piece"]
    flow: Int64[np.ndarray, " piece"]
    reach: Float64[np.ndarray, " piece"]


def boundary_pieces(gamma: float, delta: float, delay: float, frame: Frame) -> Pieces:
    """Return the boundary in pieces so fine that few nodes of the frame are in their reach.

    Args:
        gamma: physical stiffness k T^2/m in [0, 1e4].
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples.
        frame: the nodes that it is made for.
    """
    coefficients = slice_coefficients(gamma, delta, delay)
    angles = _first_angles(coefficients)
    x, y, angles = _vertices(coefficients, angles, frame)
    x, y, _ = _vertices(coefficients, _refined(angles, x, y, frame), frame)
    gap = _gaps(x, y)
    curve = Pieces(
        x=np.stack([x[:-1], x[1:]]),
        y=np.stack([y[:-1], y[1:]]),
        flow=np.full(x.size - 1, 2),
        reach=np.maximum(gap[:-1], gap[1:]),
    )
    lines = [_plus_line(coefficients, frame)]
    at_minus_one = _minus_line(coefficients, frame, x[-1])
    if at_minus_one is not None:
        lines.append(at_minus_one)
    parts = [np.concatenate(part, axis=-1) for part in zip(curve, *lines, strict=True)]
    pieces = Pieces(*parts)
    rounding = frame.rounding + _ROUNDING_OF_LINES * np.abs(pieces.y).sum(axis=0)
    return pieces._replace(reach=pieces.reach + rounding)


def _first_angles(c: SliceCoefficients) -> Floats:
    """Return angles that see every turn of the curve, and its flight where N(z) vanishes."""
    sigma, nu, total, turns = (float(v) for v in (c.sigma, c.nu, c.num_plus, c.turns))
    zeros = np.roots([0.5 * (sigma + nu), total - sigma, 0.5 * (sigma - nu)])
    centres = np.concatenate([[0.0, pi], np.abs(np.angle(zeros))])
    close = centres[:, None] + np.concatenate([-_TOWARDS_POLE, [0.0], _TOWARDS_POLE])
    even = np.linspace(0.0, pi, ceil(np.clip(_PER_HALF_TURN * turns, *_SCANS)))
    ordered: Floats = np.unique(np.clip(np.append(even, close), 0.0, pi))
    return ordered


def _vertices(c: SliceCoefficients, angles: Floats, frame: Frame) -> tuple[Floats, Floats, Floats]:
    """Return points of the curve in units of the frame, and the angles of those that are finite."""
    batches = np.resize(angles, (ceil(angles.size / _BATCH), _BATCH))
    points = [curve_point(c, jnp.asarray(batch)) for batch in batches]
    alpha, beta = (np.concatenate(gain)[: angles.size] for gain in zip(*points, strict=True))
    x, y = frame.point(alpha, beta)
    known = (np.abs(x) < _FARTHEST) & (np.abs(y) < _FARTHEST)
    return (x, y, angles) if known.all() else (x[known], y[known], angles[known])


def _refined(angles: Floats, x: Floats, y: Floats, frame: Frame) -> Floats:
    """Return as many angles as bring the gaps between chords and curve down to what is wanted.

    Far outside only the side matters on which the grid is passed, so a gap may be a share of the
    distance to the chord's line: both are stretched alike with the axes.
    """
    half_x, half_y = 0.5 * frame.x[-1], 0.5 * frame.y[-1]
    off_x, off_y = x - half_x, y - half_y
    chord_x, chord_y = np.gradient(x), np.gradient(y)
    chord = np.hypot(chord_x, chord_y) + 1e-300
    aside = np.abs(off_x * chord_y - off_y * chord_x)
    aside -= half_x * np.abs(chord_y) + half_y * np.abs(chord_x)
    wanted = _GAP + _GAP_SHARE * np.maximum(aside / chord, 0.0)
    distance = np.maximum(np.maximum(np.abs(off_x) - half_x, np.abs(off_y) - half_y), 1e-300)
    parts = np.minimum(np.sqrt(_gaps(x, y) / wanted), chord / (_CHORD_SHARE * distance))
    parts = np.minimum(np.maximum(parts[:-1], parts[1:]), _MOST_PARTS)
    passed = np.cumsum(parts + _FEWEST_PARTS)
    passed = np.concatenate([[0.0], passed])
    count = ceil(np.clip(passed[-1], *_VERTICES))
    refined: Floats = np.interp(np.linspace(0.0, passed[-1], count), passed, angles)
    return refined


def _gaps(x: Floats, y: Floats) -> Floats:
    """Return the distance of each vertex from the chord of its neighbours; 0 at the ends."""
    chord_x, chord_y = x[2:] - x[:-2], y[2:] - y[:-2]
    step_x, step_y = x[1:-1] - x[:-2], y[1:-1] - y[:-2]
    square = chord_x**2 + chord_y**2
    along = (step_x * chord_x + step_y * chord_y) / np.where(square > 0.0, square, 1.0)
    along = np.clip(along, 0.0, 1.0)
    gap = np.zeros_like(x)
    gap[1:-1] = np.hypot(step_x - along * chord_x, step_y - along * chord_y)
    return gap


def _plus_line(c: SliceCoefficients, frame: Frame) -> Pieces:
    """Return alpha = -gamma, and its way in from infinity, below the frame and from the right."""
    x = float(frame.point(float(plus_offset(c)), 0.0)[0])
    below, above = -1.0, frame.y[-1] + 1.0
    right = max(x, frame.x[-1]) + 1.0
    return Pieces(
        x=np.array([[x, right], [x, x]]),
        y=np.array([[below, below], [above, below]]),
        flow=np.array([1, 1]),  # upright, the line itself counts for nothing
        reach=np.zeros(2),
    )


def _minus_line(c: SliceCoefficients, frame: Frame, end: float) -> Pieces | None:
    """Return the line of a real root at -1, outwards from the end of the curve."""
    x = np.unique([-1.0, frame.x[-1] + 1.0, end])
    alpha = frame.origin[0] + x * frame.unit[0]
    y = frame.point(alpha, (float(minus_offset(c)) - alpha) / float(minus_slope(c)))[1]
    if not np.all(np.abs(y) < _FARTHEST):
        return None
    outwards = np.where(x[:-1] >= end, 1, -1)
    return Pieces(
        x=np.stack([x[:-1], x[1:]]),
        y=np.stack([y[:-1], y[1:]]),
        flow=outwards,
        reach=np.zeros(x.size - 1),
    )
