"""Loops in time behind any monotone force, and a search for a motion that does not decay.

The states of a device are sampled by scipy's exponential, the estimator is its difference equation,
forces wait in a line. A motion is told from its place of rest, so that the force is any piecewise
linear function through 0 with slopes from 0 to 1: constant pushes move its knots. The search breeds
starts, knots and slopes by how little a motion decays. Nothing is shared with jaxstab.
"""

from dataclasses import dataclass, replace
from math import floor
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

T = 1e-3


class Body(NamedTuple):
    """A mass with a damper, a hand's spring, and a mode (Hz, ratio, kg, motor, encoder, handle)."""

    mass: float
    damping: float
    spring: float
    mode: tuple[float, ...] | None = None

    @property
    def matrices(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """A, the motor's force, the hand's force and the encoder, of s' = A s + b f + h p."""
        shapes = [(self.mass, self.damping, 0.0, 1.0, 1.0, 1.0)]
        if self.mode:
            frequency, ratio, mass, motor, encoder, handle = self.mode
            rate = 2.0 * np.pi * frequency
            shapes.append((mass, 2.0 * ratio * rate * mass, rate**2 * mass, motor, encoder, handle))
        size = 2 * len(shapes)
        a, b, h, c = np.zeros((size, size)), np.zeros(size), np.zeros(size), np.zeros(size)
        for k, (mass, damping, stiffness, motor, encoder, handle) in enumerate(shapes):
            a[2 * k, 2 * k + 1] = 1.0
            a[2 * k + 1, 2 * k : 2 * k + 2] = -stiffness / mass, -damping / mass
            b[2 * k + 1], h[2 * k + 1], c[2 * k] = motor / mass, handle / mass, encoder
        places = np.zeros(size)
        places[::2] = [shape[5] for shape in shapes]
        return a - self.spring * np.outer(h, places), b, h, c


@dataclass(frozen=True)
class Sampled:
    """s' = A s + b f + push p at the samples, and the position and the velocity that are read."""

    matrix: np.ndarray
    force: np.ndarray
    push: np.ndarray
    position: np.ndarray
    velocity: np.ndarray

    @classmethod
    def of(cls, body: Body, delay: float, *, window: int = 1, smoothing: float = 0.0) -> "Sampled":
        """A delay in samples; the velocity over a window, then behind (1 - q) z/(z - q)."""
        a, b, h, c = body.matrices
        size, whole = len(a), floor(delay)
        late = delay - whole

        def moved(time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            full = np.zeros((size + 2, size + 2))
            full[:size, :size], full[:size, size], full[:size, size + 1] = a, b, h
            full = expm(full * time * T)
            return full[:size, :size], full[:size, size], full[:size, size + 1]

        first, second, step = moved(late), moved(1.0 - late), moved(1.0)
        line, past = size, size + whole + 1  # where forces and positions that are old begin
        total = past + window + 1
        matrix, force, push = np.zeros((total, total)), np.zeros(total), np.zeros(total)
        matrix[:size, :size], push[:size] = step[0], step[2]
        # The force of whole + 1 samples ago acts for the first part, then the next one.
        matrix[:size, line + whole] += second[0] @ first[1]
        if whole:
            matrix[:size, line + whole - 1] += second[1]
        else:
            force[:size] += second[1]
        force[line] = 1.0
        matrix[line + 1 : past, line : past - 1] = np.eye(whole)
        matrix[past, :size] = c
        matrix[past + 1 : total - 1, past : total - 2] = np.eye(window - 1)
        velocity = np.zeros(total)
        velocity[:size], velocity[total - 2] = c, -1.0
        velocity *= (1.0 - smoothing) / (window * T)
        velocity[-1] = smoothing
        matrix[-1] = velocity
        position = np.r_[c, np.zeros(total - size)]
        return cls(matrix, force, push, position, velocity)

    def read(self, stiffness: float, damping: float) -> np.ndarray:
        """What gives K x + B v of a state."""
        return stiffness * self.position + damping * self.velocity

    def damped(self, damping: float) -> "Sampled":
        """The same beside a damper that is always on."""
        matrix = self.matrix - damping * np.outer(self.force, self.velocity)
        return replace(self, matrix=matrix)

    def radius(self, stiffness: float, damping: float) -> float:
        """The spectral radius of the linear wall."""
        closed = self.matrix - np.outer(self.force, self.read(stiffness, damping))
        return float(np.abs(np.linalg.eigvals(closed)).max())


class Forces(NamedTuple):
    """Piecewise linear functions through 0: knots (5, n), rising, and slopes (6, n) in [0, 1]."""

    knots: np.ndarray
    slopes: np.ndarray

    def __call__(self, y: np.ndarray) -> np.ndarray:
        """Return the values at y, (n,)."""
        bends = np.diff(self.slopes, axis=0)
        beyond = np.maximum(y - self.knots, 0.0) - np.maximum(-self.knots, 0.0)
        values: np.ndarray = self.slopes[0] * y + (bends * beyond).sum(axis=0)
        return values

    def chosen(self, index: np.ndarray) -> "Forces":
        """Some of them."""
        return Forces(self.knots[:, index], self.slopes[:, index])


def _drawn(rng: np.random.Generator, count: int) -> Forces:
    """Any forces, a third one-sided or clipped."""
    size = 10.0 ** rng.uniform(-2.0, 0.5, count)
    knots = np.sort(rng.standard_normal((5, count)) * size, axis=0)
    slopes = np.clip(rng.uniform(-0.5, 1.5, (6, count)), 0.0, 1.0)
    for member in range(0, count, 3):
        cut = int(rng.integers(1, 6))
        slopes[:, member] = np.arange(6) >= cut
        if rng.random() < 0.5:
            slopes[max(cut + 1, 5) :, member] = 0.0
    return Forces(knots, slopes)


def run(
    loop: Sampled, wall: np.ndarray, forces: Forces, states: np.ndarray, samples: int
) -> tuple[np.ndarray, np.ndarray]:
    """The states at the end, and max |y| of the last quarter over that of the one before.

    |y| is of size 1 at first; below 1e-8 a motion has decayed.
    """
    nothing = 1e-8
    peaks = np.zeros((4, states.shape[1]))
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for quarter in range(4):
            for _ in range(samples // 4):
                y = wall @ states
                states = loop.matrix @ states - np.outer(loop.force, forces(y))
                np.maximum(peaks[quarter], np.abs(y), out=peaks[quarter])
            if peaks[quarter].max() < nothing:
                break
        ratio = peaks[3] / peaks[2]
    grows = ~np.isfinite(ratio) & (peaks[3] > 0.0)
    return states, np.where(grows, np.inf, np.where(peaks[3] < nothing, 0.0, ratio))


def attacked(
    loop: Sampled,
    wall: np.ndarray,
    rng: np.random.Generator,
    *,
    generations: int = 5,
    samples: int = 2000,
    motions: int = 48,
) -> float:
    """The largest ratio that is found of two quarters of a motion; below 1 all decay.

    ``wall`` is what the force is a function of, times a state.
    """
    size, kept, longer = len(loop.matrix), motions // 4, 10  # times, for what may be a beat
    forces, states = _drawn(rng, motions), rng.standard_normal((size, motions))
    states[4:] *= rng.random((size - 4, motions)) < 0.1
    best = 0.0
    for _ in range(generations):
        states = states / np.maximum(np.abs(wall @ states), 1e-300)
        states, ratio = run(loop, wall, forces, states, samples)
        own = np.flatnonzero(ratio >= 1.0)
        if own.size:
            ratio[own] = run(loop, wall, forces.chosen(own), states[:, own], longer * samples)[1]
        best = max(best, float(ratio.max()))
        if best >= 1.0:
            break
        # Motions have shrunk, and knots as well: the same at another scale.
        parents = np.tile(np.argsort(-ratio)[:kept], motions // kept)
        states = states[:, parents]
        knots = forces.knots[:, parents] * 10.0 ** rng.uniform(-1.0, 1.0, motions)
        knots = np.sort(knots * (1.0 + 0.3 * rng.standard_normal(knots.shape)), axis=0)
        slopes = forces.slopes[:, parents]
        is_moved = rng.random(slopes.shape) < 0.3
        slopes = np.clip(slopes + is_moved * 0.5 * rng.standard_normal(slopes.shape), 0.0, 1.0)
        fresh, is_fresh = _drawn(rng, motions), np.arange(motions) >= 3 * kept
        forces = Forces(
            np.where(is_fresh, fresh.knots, knots), np.where(is_fresh, fresh.slopes, slopes)
        )
    return best
