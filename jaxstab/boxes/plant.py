"""The plant's coefficients over whole boxes of hands, enclosed.

How far they can bend follows from lemmas B1 and B2 of docs/proofs.md: the plant's response to an
impulse stays below t, its velocity below 1, and derivatives by gamma and delta are convolutions.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from jaxstab.boxes.models import Floats, LinearModel
from jaxstab.model.plant import pairs_error, plant_coefficients


class Bend(NamedTuple):
    """Bounds of a function's second derivatives by gamma and delta."""

    gamma_twice: float
    mixed: float
    delta_twice: float

    def rest(self, half_gamma: Floats, half_delta: Floats) -> Floats:
        """Bound how far the function is from its tangent within half-widths of gamma and delta."""
        pure = self.gamma_twice * half_gamma**2 + self.delta_twice * half_delta**2
        return 0.5 * pure + self.mixed * half_gamma * half_delta


# The tables of lemma B2.
BENDS = {
    "d1": Bend(1 / 6, 1 / 2, 1.0),
    "d0": Bend(0.0, 0.0, 1.0),
    "n2": Bend(1 / 360, 1 / 60, 1 / 12),
    "n1": Bend(1 / 180, 1 / 24, 1 / 3),
    "n0": Bend(1 / 360, 1 / 40, 1 / 4),
    "sum": Bend(1 / 180, 1 / 24, 1 / 3),
    "difference": Bend(1 / 180, 1 / 24, 1 / 3),
}
NUMERATOR_SLOPES = (1 / 12, 1 / 2, 2.0)
"""Bounds of the slopes of N by gamma, delta and delay, as sums over its coefficients."""

_ROUNDING = 64 * np.finfo(np.float64).eps  # more than the coefficients have
_UNDERFLOW = 1e-290  # more than all that is lost by numbers flushed to zero

Boxes = Float64[np.ndarray, " box"]


class HandBoxes(NamedTuple):
    """Boxes of gamma and delta: middles and half-widths."""

    gamma: Boxes
    delta: Boxes
    half_gamma: Boxes
    half_delta: Boxes


class PlantModels(NamedTuple):
    """Linear models of the plant over boxes, of which the last two variables are gamma and delta.

    The names are those of ``PlantCoefficients``.
    """

    gamma: LinearModel
    d1: LinearModel
    d0: LinearModel
    n2: LinearModel
    n1: LinearModel
    n0: LinearModel
    sum: LinearModel
    difference: LinearModel

    def some(self, box: Int64[np.ndarray, " some"]) -> "PlantModels":
        """Return the models of chosen boxes."""
        return PlantModels(
            *(
                LinearModel(m.centre[box], m.slope[:, box], m.rest[box], m.half[:, box])
                for m in self
            )
        )

    def beside(self, half: Float64[np.ndarray, "other box"]) -> "PlantModels":
        """Return the same models with other variables before gamma and delta."""
        still = np.zeros_like(half)
        halves = np.concatenate([half, self.gamma.half])
        return PlantModels(
            *(LinearModel(m.centre, np.concatenate([still, m.slope]), m.rest, halves) for m in self)
        )


def plant_models(hands: HandBoxes, delay: float) -> PlantModels:
    """Enclose the plant's coefficients: secants for slopes, and the table for what they leave.

    Args:
        hands: boxes of gamma in [0, 1e4] and delta in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, of which the fraction enters.

    Raises:
        ValueError: gamma, delta or delay is outside the range of the model.
    """
    h_gamma, h_delta = hands.half_gamma, hands.half_delta
    still = np.zeros_like(h_gamma)
    gamma = np.maximum(hands.gamma + np.stack([still, -h_gamma, h_gamma, still, still]), 0.0)
    delta = np.maximum(hands.delta + np.stack([still, still, still, -h_delta, h_delta]), 0.0)
    values = plant_coefficients(gamma, delta, delay)
    half = np.stack([h_gamma, h_delta])
    widths = gamma[2] - gamma[1], delta[4] - delta[3]
    # More than a rounding is lost of N where it nearly vanishes, and of D where it decays.
    lost = 8.0 * np.asarray(pairs_error(np.max(gamma, axis=0), np.max(delta, axis=0)))
    size_n = np.sqrt(np.max(np.asarray(values.sum), axis=0))

    def model(name: str) -> LinearModel:
        at = np.asarray(getattr(values, name))
        slope = [_secant(at[1], at[2], widths[0]), _secant(at[3], at[4], widths[1])]
        # A secant differs from the tangent by as much as the function from its tangent.
        bend = BENDS[name]
        secant = bend.rest(h_gamma, 0.0) + bend.rest(0.0, h_delta)
        rest = bend.rest(h_gamma, h_delta) + secant + _ROUNDING * np.max(np.abs(at), axis=0)
        rest += lost * (1.0 if name in ("d1", "d0") else size_n) + _UNDERFLOW
        return LinearModel(at[0], np.stack(slope), rest, half)

    exact = LinearModel(hands.gamma, np.stack([np.ones_like(still), still]), still, half)
    return PlantModels(exact, *map(model, PlantModels._fields[1:]))


def _secant(before: Floats, after: Floats, width: Floats) -> Floats:
    wide = width > 0.0
    slope: Floats = np.where(wide, (after - before) / np.where(wide, width, 1.0), 0.0)
    return slope
