"""Each method's verdict and spectral radius of many loops of one delay, judged by certified roots.

The rivals are what people use: numpy.roots (batched), with the library's coefficients or with eq.
(9) as printed. A rival calls a loop stable when its radius is below 1; it has no error bound.
"""

from typing import NamedTuple

import flint
import numpy as np

import jaxstab
from benchmarks import eigenvalues
from jaxstab.conventions import Verdict
from jaxstab.model import by_name
from tests.truth.balls import code_of, isolated_roots
from tests.truth.loop import plant_in_balls

CERTIFIED = ("verdict", "verdict, exact", "spectral_radius", "spectral_radius, companion")
RIVALS = ("numpy.roots", "eq. (9) as printed")
METHODS = (*CERTIFIED, *RIVALS)

_BITS = {160: 400, 480: 800, 1390: 1700, 5300: 5600}  # of roots, and of the plants for them
_DIGITS = 80  # binary digits of a true radius, at least


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
    the root closest to the circle; NaN where the roots could not be told apart, from each other or
    from the circle, or not to digits of a radius."""

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
    codes, *floats = zip(*(_true(*point) for point in loops.points.tolist()), strict=True)
    return Truth(np.array(codes), *(np.array(column) for column in floats))


def answers_of(loops: Loops) -> dict[str, Answer]:
    alpha, beta, gamma, delta, _ = points = loops.points.T
    unknown = np.full(len(alpha), np.nan)
    found = {}
    for name, resolve in (("verdict", None), ("verdict, exact", "exact")):
        codes = jaxstab.verdict(**by_name(*points[:4], loops.delay), resolve=resolve)
        found[name] = Answer(np.asarray(codes), unknown, unknown)
    for name, method in (("spectral_radius", "fast"), ("spectral_radius, companion", "companion")):
        radius = jaxstab.spectral_radius(**by_name(*points[:4], loops.delay), method=method)
        value, bound = np.asarray(radius.value), np.asarray(radius.error)
        code = np.where(
            value + bound < 1,
            Verdict.STABLE,
            np.where(value - bound > 1, Verdict.UNSTABLE, Verdict.UNDECIDED),
        )
        found[name] = Answer(code, value, bound)
    exact = jaxstab.characteristic_polynomial(
        alpha, beta, gamma=gamma, delta=delta, delay=loops.delay
    )
    found["numpy.roots"] = _by_roots(np.asarray(exact))
    if loops.delay % 1.0 == 0.0:
        found["eq. (9) as printed"] = _by_roots(
            eigenvalues.polynomial(alpha, beta, gamma, delta, int(loops.delay))
        )
    return found


def judged(answer: Answer, truth: Truth) -> Judgement:
    undecided = answer.code == Verdict.UNDECIDED
    # UNSTABLE also holds with a root on the circle, which leaves the truth undecided.
    fits = (answer.code == truth.code) | (
        (answer.code == Verdict.UNSTABLE) & (truth.code == Verdict.UNDECIDED)
    )
    wrong = ~undecided & ~fits & np.isfinite(truth.distance)
    claims = np.isfinite(answer.bound) & np.isfinite(truth.radius)
    with np.errstate(all="ignore"):
        error = np.abs((answer.radius - truth.radius) - truth.rest)
        share = np.where(error == 0.0, 0.0, error / answer.bound)
        share = np.where(claims & np.isnan(error), np.inf, share)  # a bound of what is no number
        ulps = np.where(np.isposinf(answer.bound), np.nan, error / np.spacing(truth.radius))
    return Judgement(wrong, undecided, ulps, share)


def _true(
    alpha: float, beta: float, gamma: float, delta: float, delay: float
) -> tuple[int, float, float, float]:
    moduli = _moduli(alpha, beta, gamma, delta, delay)
    if not moduli:
        return Verdict.UNDECIDED, np.nan, np.nan, np.nan
    largest = _largest(moduli)
    with flint.ctx.workprec(max(_BITS)):
        radius, rest = np.nan, np.nan
        if largest.rel_accuracy_bits() >= _DIGITS:
            radius = float(largest.mid())
            rest = float((largest - radius).mid())
        distance = min(abs(float((modulus - 1).mid())) for modulus in moduli)
    code = code_of(moduli)
    if code == Verdict.UNDECIDED and alpha != -gamma:
        distance = np.nan  # by too few digits: whether a root is on the circle is not known
    return code, radius, rest, distance


def _moduli(alpha: float, beta: float, gamma: float, delta: float, delay: float) -> list[flint.arb]:
    """The moduli of all roots in balls, each on one side of the circle if 1600 digits can tell."""
    moduli: list[flint.arb] = []
    for bits, plant_bits in _BITS.items():
        coefficients = plant_in_balls(gamma, delta, delay, plant_bits).polynomial(
            alpha, beta, delay
        )
        size = 1 + max(abs(float(coefficient)) for coefficient in coefficients)  # of all roots
        with flint.ctx.workprec(bits):
            tolerance = size * flint.arb(2) ** -(5 * bits // 8)
            balls = isolated_roots(coefficients, tolerance)
            if balls is None:
                continue
            moduli = [abs(ball) for ball in balls]
            on_circle = sum(modulus.overlaps(flint.arb(1)) for modulus in moduli)
            are_told_apart = on_circle <= (alpha == -gamma)  # p(1) = (alpha + gamma) N(1)
            if are_told_apart and _largest(moduli).rel_accuracy_bits() >= _DIGITS:
                break
    return moduli


def _largest(moduli: list[flint.arb]) -> flint.arb:
    return max(moduli, key=lambda modulus: modulus.mid())


def _by_roots(coefficients: np.ndarray) -> Answer:
    radius = eigenvalues.radius(coefficients)
    return Answer(
        np.where(radius < 1, Verdict.STABLE, Verdict.UNSTABLE), radius, np.full(radius.size, np.nan)
    )
