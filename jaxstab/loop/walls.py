"""Walls of one loop, answered in balls one by one (``jaxstab.exact``).

A wall takes 0.1 to some milliseconds, whatever the device. More than a hundred at once, and walls
that JAX has, are a grid for ``jaxstab.point``.
"""

from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex128, Int8

from jaxstab.arrays import Array, Numbers, is_any_jax, named
from jaxstab.conventions import RadiusStatus, Verdict
from jaxstab.exact import TripleAt, poles, spectral_radius, wall_verdict
from jaxstab.model import LoopParameters
from jaxstab.model.balls import ball_triple
from jaxstab.model.parameters import wall_grid
from jaxstab.point import SpectralRadius


class FewWalls(NamedTuple):
    """Walls (K, B) of a loop, one after the other, and the shape of their grid."""

    triple: TripleAt
    walls: list[list[float]]
    shape: tuple[int, ...]

    def verdicts(self) -> Int8[Array, "*grid"]:
        """Their verdicts."""
        codes = [wall_verdict(self.triple, *wall).verdict for wall in self.walls]
        return named(np.array(codes, np.int8).reshape(self.shape), Verdict)

    def spectral_radii(self) -> SpectralRadius:
        """Their spectral radii."""
        radii = [spectral_radius(self.triple, *wall) for wall in self.walls]
        value, error, status = np.reshape(np.transpose(radii), (3, *self.shape))
        return SpectralRadius(value, error, named(status.astype(np.int8), RadiusStatus))

    def poles(self) -> Complex128[np.ndarray, "*grid degree"] | None:
        """Their poles; None if some coincide, and cannot be told apart."""
        found = [poles(self.triple, *wall) for wall in self.walls]
        if not found or not all(np.isfinite(one.error) for one in found):
            return None
        return np.reshape([one.values for one in found], (*self.shape, -1))


def few_walls(loop: LoopParameters, stiffness: Numbers, damping: Numbers) -> FewWalls | None:
    """Up to a hundred walls of one loop; None for more, for many loops, and where JAX has them."""
    if is_any_jax(loop, stiffness, damping) or loop.shape:
        return None
    grid = wall_grid(stiffness=stiffness, damping=damping)
    walls = grid.reshape(-1, 2).tolist()
    return (
        FewWalls(partial(ball_triple, loop), walls, grid.shape[:-1]) if len(walls) <= 100 else None
    )
