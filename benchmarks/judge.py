"""Each method's verdict and spectral radius of many loops of one delay, judged by certified roots.

The rivals are what people use: numpy.roots (batched), with the library's coefficients or with eq.
(9) as printed. A rival calls a loop stable when its radius is below 1; it has no error bound.
"""

from typing import NamedTuple

import flint
import numpy as np
from near_boundary import ExactPlant
from truth import printed_plant

import jaxstab
from jaxstab.conventions import STABLE, UNDECIDED, UNSTABLE

CERTIFIED = ("verdict", "verdict, exact", "spectral_radius", "spectral_radius, companion")
RIVALS = ("numpy.roots", "eq. (9) as printed")
METHODS = (*CERTIFIED, *RIVALS)

_BITS = (160, 480, 1390)  # the plants have 1400


class Loops(NamedTuple):
    """Loops of one delay: plants, and the gains of each, shape (plant, wall)."""

    gamma: np.ndarray
    delta: np.ndarray
    alpha: np.ndarray
    beta: np.ndarray
    delay: float

    @property
    def points(self) -> np.ndarray:
        """The parameters of each loop in their order, shape (loop, 5)."""
        shape = self.alpha.shape
        plants = (np.broadcast_to(x[:, None], shape) for x in (self.gamma, self.delta))
        columns = (self.alpha, self.beta, *plants, np.full(shape, self.delay))
        return np.stack([column.ravel() for column in columns], axis=-1)


class Truth(NamedTuple):
    """The true code of each loop, its spectral radius as a sum of two floats, and the distance of
    the root closest to the circle; NaN where the roots could not be told apart."""

    code: np.ndarray
    radius: np.ndarray
    rest: np.ndarray
    distance: np.ndarray


class Answer(NamedTuple):
    """What a method says: codes, radii and their bounds; NaN for what it does not say."""

    code: np.ndarray
    radius: np.ndarray
    bound: np.ndarray


class Judgement(NamedTuple):
    """How one method did at each loop: error in units of the last place, and against its bound.

    The error of a radius that comes with a bound counts only where there is one.
    """

    wrong: np.ndarray
    undecided: np.ndarray
    ulps: np.ndarray
    share: np.ndarray  # true error over the bound; above 1 it is a lie


def truth_of(loops: Loops) -> Truth:
    rows = []
    for gamma, delta, alphas, betas in zip(*loops[:4], strict=True):
        plant = ExactPlant.of(float(gamma), float(delta), loops.delay)
        rows += [
            _true(plant.polynomial(a, b, loops.delay))
            for a, b in zip(alphas.tolist(), betas.tolist(), strict=True)
        ]
    codes, *floats = zip(*rows, strict=True)
    return Truth(np.array(codes), *(np.array(column) for column in floats))


def answers_of(loops: Loops) -> dict[str, Answer]:
    alpha, beta, gamma, delta, _ = points = loops.points.T
    unknown = np.full(len(alpha), np.nan)
    found = {}
    for name, resolve in (("verdict", None), ("verdict, exact", "exact")):
        codes = jaxstab.verdict(*points[:4], loops.delay, resolve=resolve)
        found[name] = Answer(np.asarray(codes), unknown, unknown)
    for name, method in (("spectral_radius", "fast"), ("spectral_radius, companion", "companion")):
        radius = jaxstab.spectral_radius(*points[:4], loops.delay, method=method)
        value, bound = np.asarray(radius.value), np.asarray(radius.error)
        code = np.where(value + bound < 1, STABLE, np.where(value - bound > 1, UNSTABLE, UNDECIDED))
        found[name] = Answer(code, value, bound)
    exact = jaxstab.characteristic_polynomial(alpha, beta, gamma, delta, loops.delay)
    found["numpy.roots"] = _by_roots(np.asarray(exact))
    if loops.delay % 1.0 == 0.0:
        found["eq. (9) as printed"] = _by_roots(_printed(loops))
    return found


def judged(answer: Answer, truth: Truth) -> Judgement:
    undecided = answer.code == UNDECIDED
    # UNSTABLE also holds with a root on the circle, which leaves the truth undecided.
    fits = (answer.code == truth.code) | ((answer.code == UNSTABLE) & (truth.code == UNDECIDED))
    wrong = ~undecided & ~fits & np.isfinite(truth.distance)
    with np.errstate(invalid="ignore", divide="ignore"):
        error = np.abs((answer.radius - truth.radius) - truth.rest)
        share = np.where(error == 0.0, 0.0, error / answer.bound)
        ulps = np.where(np.isposinf(answer.bound), np.nan, error / np.spacing(truth.radius))
    return Judgement(wrong, undecided, ulps, share)


def _true(coefficients: list[flint.arb]) -> tuple[int, float, float, float]:
    moduli = _moduli(coefficients)
    if not moduli:
        return UNDECIDED, np.nan, np.nan, np.nan
    with flint.ctx.workprec(_BITS[-1]):
        largest = max(moduli, key=lambda modulus: modulus.mid())
        radius = float(largest.mid())
        rest = float((largest - radius).mid())
        distance = min(abs(float((modulus - 1).mid())) for modulus in moduli)
    if any(modulus > 1 for modulus in moduli):
        code = UNSTABLE
    else:
        code = STABLE if all(modulus < 1 for modulus in moduli) else UNDECIDED
    return code, radius, rest, distance


def _moduli(coefficients: list[flint.arb]) -> list[flint.arb]:
    """The moduli of all roots in balls, each on one side of the circle if 400 digits can tell."""
    while coefficients[-1] == 0:
        coefficients.pop()
    moduli: list[flint.arb] = []
    for bits in _BITS:
        with flint.ctx.workprec(bits):
            try:
                balls = flint.acb_poly(coefficients[::-1]).roots(tol=flint.arb(2) ** (60 - bits))
            except ValueError:
                continue
            moduli = [abs(ball) for ball in balls] or [flint.arb(0)]
            if not any(modulus.overlaps(flint.arb(1)) for modulus in moduli):
                break
    return moduli


def _by_roots(coefficients: np.ndarray) -> Answer:
    """numpy.roots of many polynomials: the same companion matrices, in one call."""
    count, degree = coefficients.shape[0], coefficients.shape[1] - 1
    usable = np.isfinite(coefficients).all(axis=1)
    companion = np.zeros((count, degree, degree))
    companion[:, 0] = np.where(usable[:, None], -coefficients[:, 1:], 0.0)
    companion[:, range(1, degree), range(degree - 1)] = 1.0
    radius = np.abs(np.linalg.eigvals(companion)).max(axis=1)
    radius = np.where(usable, radius, np.inf)
    return Answer(np.where(radius < 1, STABLE, UNSTABLE), radius, np.full(count, np.nan))


def _printed(loops: Loops) -> np.ndarray:
    whole, walls = int(loops.delay), loops.alpha.shape[1]
    rows = []
    for gamma, delta in zip(loops.gamma.tolist(), loops.delta.tolist(), strict=True):
        rows += [printed_plant(gamma, delta)[:4]] * walls
    d1, d0, n1, n0 = np.array(rows).T
    alpha, beta = loops.alpha.ravel(), loops.beta.ravel()
    coefficients = np.zeros((alpha.size, whole + 4))
    coefficients[:, :3] = np.stack([np.ones_like(d1), d1, d0], axis=-1)
    with np.errstate(all="ignore"):
        coefficients[:, -3] += n1 * (alpha + beta)
        coefficients[:, -2] += n0 * (alpha + beta) - n1 * beta
        coefficients[:, -1] -= n0 * beta
    return coefficients
