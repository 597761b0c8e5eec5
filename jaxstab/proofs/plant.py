"""The plant's coefficients over boxes of (gamma, delta), enclosed.

D and N of one mass are smooth functions of gamma, delta and, between whole samples, the delay.
Bounds of the second derivatives follow from the plant's energy (lemmas B1 and B2 of
docs/proofs.md): its response to an impulse stays below t, its velocity below 1, and derivatives by
gamma and delta are convolutions of these. With the bounds (``BENDS``), accurate values in the
middle and at the ends of a box give linear models over the box: secants are the slopes, and the
bounds are what they leave (``plant_models``). The delay is a further variable, whose derivatives
are closed (lemma B16).

"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from jaxstab.boxes.enclosures import LinearModel
from jaxstab.model import plant_coefficients
from jaxstab.model.plant import pairs_error
from jaxstab.region.on_circle import motion
from jaxstab.rounding import PLANT_MODEL, UNDERFLOW

# Bounds of the second derivatives of the plant's coefficients, and models of these over boxes.

Floats = Any  # real or complex arrays


class Bend(NamedTuple):
    """Bounds of a function's second derivatives by gamma, delta and delay.

    ``delay_thrice`` times gamma + delta bounds the third one by the delay.
    """

    gamma_twice: float
    mixed: float
    delta_twice: float
    gamma_delay: float = 0.0
    delta_delay: float = 0.0
    delay_thrice: float = 0.0

    def rest(self, half_gamma: Floats, half_delta: Floats, half_delay: float = 0.0) -> Floats:
        """Bound the distance of the function from its tangent within these half-widths."""
        pure = self.gamma_twice * half_gamma**2 + self.delta_twice * half_delta**2
        hand = 0.5 * pure + self.mixed * half_gamma * half_delta
        return hand + half_delay * (self.gamma_delay * half_gamma + self.delta_delay * half_delta)


# The tables of lemmas B2 and B16.
BENDS = {
    "d1": Bend(1 / 6, 1 / 2, 1.0),
    "d0": Bend(0.0, 0.0, 1.0),
    "n2": Bend(1 / 360, 1 / 60, 1 / 12, 1 / 6, 1 / 2, 1),
    "n1": Bend(1 / 180, 1 / 24, 1 / 3, 1 / 6, 1 / 2, 2),
    "n0": Bend(1 / 360, 1 / 40, 1 / 4, 1 / 6, 1 / 2, 1),
    "sum": Bend(1 / 180, 1 / 24, 1 / 3),
    "difference": Bend(1 / 180, 1 / 24, 1 / 3, 1 / 3, 1.0, 4),
}

NUMERATOR_SLOPES = (1 / 12, 1 / 2, 2.0)

"""Bounds of the slopes of N by gamma, delta and delay, as sums over its coefficients."""

Boxes = Float64[np.ndarray, " box"]


class HandBoxes(NamedTuple):
    """Boxes of gamma and delta: middles and half-widths."""

    gamma: Boxes
    delta: Boxes
    half_gamma: Boxes
    half_delta: Boxes


class PlantModels(NamedTuple):
    """Linear models of the plant over boxes of gamma, delta and perhaps delay.

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


class CurveParts(NamedTuple):
    """The terms of the plant alone in the curve, as linear models over boxes of hands."""

    gamma: LinearModel
    sum: LinearModel
    kappa: LinearModel  # 1 + d0
    eps: LinearModel  # 1 - d0
    sigma: LinearModel  # n2 + n0
    nu: LinearModel  # n2 - n0
    gamma_sum: LinearModel
    eps_nu: LinearModel
    nu_square: LinearModel
    by_q: LinearModel  # kappa - gamma sigma
    by_mirror_h: LinearModel  # nu (gamma nu - eps)

    @staticmethod
    def from_plant(plant: PlantModels) -> "CurveParts":
        """Return the terms over the boxes of a plant."""
        gamma, total = plant.gamma, plant.sum
        kappa, eps = plant.d0 + 1.0, 1.0 - plant.d0
        sigma, nu = plant.n2 + plant.n0, plant.n2 - plant.n0
        products = gamma * total, eps * nu, nu * nu
        by_q, by_mirror_h = kappa - gamma * sigma, nu * (gamma * nu - eps)
        return CurveParts(gamma, total, kappa, eps, sigma, nu, *products, by_q, by_mirror_h)

    def over_patches(
        self, box: Int64[np.ndarray, " patch"], half_theta: Float64[np.ndarray, " patch"]
    ) -> "CurveParts":
        """Return the models over patches, each of one of the boxes, with theta before the rest."""
        has_products, still = self.gamma.has_products, np.zeros((1, box.size))

        def joined(theta: np.ndarray, product: np.ndarray, own: np.ndarray) -> np.ndarray:
            parts = [theta, own[:4], product, own[4:]] if has_products else [theta, own]
            return np.concatenate(parts)

        half = self.gamma.half[:, box]
        by_delay = half_theta * half[2] if has_products else half_theta
        half = joined(half_theta[None], by_delay[None], half)
        return CurveParts(
            *(
                LinearModel(
                    model.centre[box],
                    joined(still, still, model.slope[:, box]),
                    model.rest[box],
                    half,
                    has_products,
                )
                for model in self
            )
        )


def plant_models(hands: HandBoxes, delay: float, half_delay: float = 0.0) -> PlantModels:
    """Enclose the plant's coefficients: secants give the slopes, the table bounds the remainder.

    ``hands`` are boxes of gamma in [0, 1e4] and delta in [0, 1e3]. ``half_delay`` is the largest
    distance of the delay from this one, between the whole samples around it; if it is not 0, the
    delay is a variable of the models, with its products.
    """
    h_gamma, h_delta = hands.half_gamma, hands.half_delta
    gamma, delta, values, errors = stencil(hands, delay)
    half, still = np.stack([h_gamma, h_delta]), np.zeros_like(h_gamma)
    moves = delay_moves(hands.gamma, hands.delta, delay) if half_delay else {}
    if half_delay:
        of_delay = [np.full_like(h_gamma, by) for by in (half_delay, 0.5 * half_delay**2)]
        half = np.concatenate([half, of_delay, half_delay * half])
    third = (gamma.max(axis=0) + delta.max(axis=0)) * half_delay**3 / 6.0
    widths = gamma[2] - gamma[1], delta[4] - delta[3]

    def model(name: str) -> LinearModel:
        points = values[name]
        slope = [_secant(points[1], points[2], widths[0]), _secant(points[3], points[4], widths[1])]
        # A secant differs from the tangent by as much as the function from its tangent.
        bend = BENDS[name]
        secant = bend.rest(h_gamma, 0.0) + bend.rest(0.0, h_delta)
        rest = bend.rest(h_gamma, h_delta, half_delay) + bend.delay_thrice * third + secant
        rest += PLANT_MODEL * (np.max(np.abs(points), axis=0) + half_delay)
        centre = points[0]
        if half_delay:
            rate, twice = moves.get(name, (still, still))
            slope += [rate, twice, still, still]
            centre = centre + twice * half[3]
        rest += errors[name]
        return LinearModel(centre, np.stack(slope), rest, half, bool(half_delay))

    along_gamma = np.stack([np.ones_like(still), *[still] * (len(half) - 1)])
    exact = LinearModel(hands.gamma, along_gamma, still, half, bool(half_delay))
    return PlantModels(exact, *map(model, PlantModels._fields[1:]))


def stencil(
    hands: HandBoxes, delay: float
) -> tuple[Floats, Floats, dict[str, Floats], dict[str, Floats]]:
    """Gamma, delta and the plant in the middle of boxes and at their ends, (5, box), and errors.

    The ends are those of gamma, then of delta; the errors are of all five points, (box).
    """
    h_gamma, h_delta = hands.half_gamma, hands.half_delta
    still = np.zeros_like(h_gamma)
    gamma = np.maximum(hands.gamma + np.stack([still, -h_gamma, h_gamma, still, still]), 0.0)
    delta = np.maximum(hands.delta + np.stack([still, still, still, -h_delta, h_delta]), 0.0)
    plant = plant_coefficients(gamma=gamma, delta=delta, delay=delay)
    values = {name: np.asarray(value) for name, value in plant._asdict().items()}
    # N is wrong by more than a rounding where it nearly vanishes, and D where it decays.
    error = 8.0 * np.asarray(pairs_error(gamma.max(axis=0), delta.max(axis=0)))
    size_n = np.sqrt(np.max(values["sum"], axis=0))
    of_n = dict.fromkeys(values, error * size_n + UNDERFLOW)
    return gamma, delta, values, of_n | dict.fromkeys(("d1", "d0"), error + UNDERFLOW)


def delay_moves(
    gamma: Floats, delta: Floats, delay: float
) -> dict[str, Float64[np.ndarray, "order *box"]]:
    """The first and half of the second derivatives of N by the delay; others are 0 (lemma B16)."""
    fraction = delay - np.floor(delay)
    (went, early), (gone, velocity) = (
        motion(gamma, delta, np.full_like(gamma, time)) for time in (1.0 - fraction, fraction)
    )
    fading = np.exp(-delta * (1.0 - fraction))
    n2 = np.stack([-early, 0.5 * (1.0 - delta * early - gamma * went)])
    n0 = fading * np.stack([velocity, 0.5 * (1.0 - gamma * gone)])
    return {"n2": n2, "n1": -n2 - n0, "n0": n0, "difference": 2.0 * (n2 + n0)}


def _secant(before: Floats, after: Floats, width: Floats) -> Floats:
    wide = width > 0.0
    slope: Floats = np.where(wide, (after - before) / np.where(wide, width, 1.0), 0.0)
    return slope
