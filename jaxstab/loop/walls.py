"""Walls of one loop, answered in balls one by one (``jaxstab.exact``).

A wall takes 0.1 to some milliseconds, whatever the device. More than a hundred at once, and walls
that JAX has, are a grid for ``jaxstab.point``.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64, Int8

from jaxstab.arrays import Array, Numbers, is_any_jax, named
from jaxstab.conventions import RadiusStatus, Verdict
from jaxstab.exact import TripleAt, poles, spectral_radius, wall_verdict
from jaxstab.model import LoopParameters
from jaxstab.model.balls import ball_triple
from jaxstab.model.linear_loop import LinearLoop
from jaxstab.model.parameters import wall_grid
from jaxstab.point import SpectralRadius


class FewWalls(NamedTuple):
    """Pairs of gains of a loop, such as (K, B), answered one after the other."""

    triple: TripleAt
    grid: Float64[np.ndarray, "*grid 2"]

    def verdicts(self) -> Int8[Array, "*grid"]:
        """Their verdicts."""
        codes = [answer.verdict for answer in self._each(wall_verdict)]
        return named(np.array(codes, np.int8).reshape(self.grid.shape[:-1]), Verdict)

    def spectral_radii(self) -> SpectralRadius:
        """Their spectral radii."""
        radii = np.transpose(self._each(spectral_radius))
        value, error, status = np.reshape(radii, (3, *self.grid.shape[:-1]))
        return SpectralRadius(value, error, named(status.astype(np.int8), RadiusStatus))

    def poles(self) -> Complex128[np.ndarray, "*grid pole"]:
        """Their poles; NaN where some coincide and are not told apart."""
        values = [answer.values for answer in self._each(poles)]
        return np.reshape(values, (*self.grid.shape[:-1], -1))

    def _each(self, question: Callable[[TripleAt, float, float], Any]) -> list[Any]:
        return [question(self.triple, *pair) for pair in self.grid.reshape(-1, 2).tolist()]


def few_walls(loop: LoopParameters, stiffness: Numbers, damping: Numbers) -> FewWalls | None:
    """One to a hundred walls of one loop; None for more, for many loops, and where JAX has them."""
    if is_any_jax(loop, stiffness, damping) or loop.shape:
        return None
    grid = wall_grid(stiffness=stiffness, damping=damping)
    return FewWalls(partial(ball_triple, loop), grid) if 0 < grid.size <= 200 else None


def open_loop(loop: LinearLoop, gains: tuple[float, float], period: float) -> Any:
    """The open loop (a S + b R)/base of two gains in units of the loop, for python-control."""
    try:
        from control import TransferFunction
    except ImportError as error:
        raise ImportError(
            "python-control is not installed; pip install 'jaxstab[control]'."
        ) from error
    pairs = zip(loop.stiffness, loop.damping, strict=True)
    numerator = [float((k * gains[0] + b * gains[1]).rounded()) for k, b in pairs]
    denominator = [float(coefficient.rounded()) for coefficient in loop.base]
    return TransferFunction(numerator, denominator, dt=period)
