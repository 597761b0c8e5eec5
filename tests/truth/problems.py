"""Loops that are hard to compute, by name: why each is hard, and its exact answer.

Most are built backwards: a root is chosen, the gains that put it there are solved for with 50
digits and rounded once. The exact answer of the rounded loop is that of certified roots.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import flint
import numpy as np
from mpmath import mp, mpc, mpf

from jaxstab import Verdict
from tests.truth import loop as truth
from tests.truth.balls import ExactPlant

Point = tuple[float, float, float, float, float]

_BITS = (200, 800, 3200)  # of the roots, until they are told apart
_PAIR = mp.rect(0.95, 0.2)  # a lightly damped oscillation: a usual dominant pair


@dataclass(frozen=True)
class Problem:
    """A loop, why it is hard, and what is known of it beforehand.

    ``root`` is the root that the gains were solved for, of ``multiplicity``; ``code``, the verdict
    follows from how the problem was built. Either may be missing.
    """

    name: str
    why: str
    tags: frozenset[str]
    point: Point
    root: mpc | None = None
    multiplicity: int = 1
    code: int | None = None

    @property
    def delay(self) -> float:
        return self.point[4]

    @cached_property
    def roots(self) -> list[flint.acb]:
        """All roots in certified balls, the largest modulus first; roots at zero are exact."""
        if self.point[:2] == (0.0, 0.0):
            zeros = [flint.acb(0)] * (truth.degree(self.delay) - 2)
            with flint.ctx.workprec(_BITS[0]):
                return truth.plant_poles(*self.point[2:4]) + zeros
        return _certified_roots(*self.point)

    @cached_property
    def radius(self) -> tuple[mpf, mpf]:
        """Lower and upper bound of the spectral radius."""
        with flint.ctx.workprec(_BITS[-1]):
            moduli = [abs(root) for root in self.roots]
            ends = [(truth.as_mpf(m.lower()), truth.as_mpf(m.upper())) for m in moduli]
        return max(low for low, _ in ends), max(high for _, high in ends)

    @cached_property
    def exact_code(self) -> int:
        """STABLE, UNSTABLE, or UNDECIDED with no root outside and one on the circle, not at 1."""
        plant = ExactPlant.of(*self.point[2:])
        return plant.code(*self.point[:3], self.delay)


def _certified_roots(*point: float) -> list[flint.acb]:
    coefficients = ExactPlant.of(*point[2:]).polynomial(*point[:2], point[4])
    for bits in _BITS:
        with flint.ctx.workprec(bits):
            balls = truth.isolated_roots(coefficients, flint.arb(2) ** (-bits // 2))
            if balls is not None:
                return sorted(balls, key=lambda ball: -float(abs(ball).mid()))
    return truth.root_balls(*point)  # exactly multiple roots, at gamma = delta = 0


# ------------------------------------------------------------------------------- gains from roots


def gains_of_root(
    root: mpc, gamma: float, delta: float, delay: float, multiplicity: int = 1
) -> tuple[float, float]:
    """The gains, rounded once, that make a pair of complex roots, or a double real root."""
    with mp.workdps(80):
        stiff, damp, free = _parts(root, gamma, delta, delay)
        if mp.im(root) == 0:
            assert multiplicity == 2, "one simple real root leaves the gains open"
            step = mpf(10) ** -30
            above, below = (_parts(root + s, gamma, delta, delay) for s in (step, -step))
            slopes = [(a - b).real / (2 * step) for a, b in zip(above, below, strict=True)]
            rows = [[part.real for part in (stiff, damp, free)], slopes]
        else:
            rows = [[part.real for part in (stiff, damp, free)],
                    [part.imag for part in (stiff, damp, free)]]  # fmt: skip
        (a, b, e), (c, d, f) = rows
        determinant = a * d - b * c
        return float((b * f - d * e) / determinant), float((c * e - a * f) / determinant)


def _parts(z: mpc, gamma: float, delta: float, delay: float) -> tuple[mpc, mpc, mpc]:
    """p(z) = alpha * first + beta * second + third."""
    whole, fraction = truth.split_delay(delay)
    plant = truth.sampled_plant(gamma, delta, fraction if fraction else 0)
    force = (plant.n2 * z + plant.n1) * z + plant.n0
    free = z ** (whole + 2) * ((z + plant.d1) * z + plant.d0)
    return force * z, force * (z - 1), free


def _on_boundary(theta: float, gamma: float, delta: float, delay: float) -> tuple[float, float]:
    alpha, beta = truth.boundary_point(theta, gamma, delta, delay)
    return float(alpha), float(beta)


def _up(value: float, ulps: int) -> float:
    for _ in range(abs(ulps)):
        value = math.nextafter(value, math.copysign(math.inf, ulps))
    return value


# ----------------------------------------------------------------------------------- the registry


def _with_pair(
    name: str, why: str, tags: set[str], gamma: float, delta: float, delay: float, z: mpc = _PAIR
) -> Problem:
    gains = gains_of_root(z, gamma, delta, delay)
    return Problem(name, why, frozenset(tags), (*gains, gamma, delta, delay), root=z)


def _critical_damping() -> Iterator[Problem]:
    why = "eq. (9) divides by c1, which is 0 at critical damping and changes its nature beside it"
    for delta in (1e-8, 1e-3, 0.015, 0.5, 2.0, 6.0):
        for ulps in (-1, 0, 1):
            gamma = _up(0.25 * delta**2, ulps)
            name = f"critical damping, delta {delta:g}, {ulps:+d} ulp"
            yield _with_pair(name, why, {"critical"}, gamma, delta, 0.0)


def _sizes() -> Iterator[Problem]:
    why = "eq. (9) loses all digits for small gamma and delta, and overflows on its way for large"
    small = (5e-324, 1e-300, 1e-160, 1e-16, 1e-8)
    for size in small:
        yield _with_pair(f"gamma {size:g} alone", why, {"tiny"}, size, 0.0, 0.0)
        yield _with_pair(f"delta {size:g} alone", why, {"tiny"}, 0.0, size, 1.0)
    yield _with_pair("gamma 1e-300, delta 1e-8", why, {"tiny", "mixed"}, 1e-300, 1e-8, 0.0)
    yield _with_pair("gamma 1e-8, delta 1e-300", why, {"tiny", "mixed"}, 1e-8, 1e-300, 1.0)
    for gamma, delta in ((1e3, 0.1), (1e4, 5.0), (1e4, 1e3), (0.1, 1e3), (40.0, 10.0)):
        name = f"gamma {gamma:g}, delta {delta:g}"
        yield Problem(name, why, frozenset({"large"}), (0.1, 0.2, gamma, delta, 0.0))


def _free_device() -> Iterator[Problem]:
    why = "gamma = delta = 0: eq. (9) is 0/0"
    for delay in (0.0, 1.0, 2.0, 5.0, 0.5):
        z = mp.rect(0.97, 0.3 / (1 + delay))
        yield _with_pair(f"free device, delay {delay:g}", why, {"zero"}, 0.0, 0.0, delay, z)


def _nyquist() -> Iterator[Problem]:
    why = "gamma = (k pi)^2: the plant swings k half periods in a sample, poles gather at 1 or -1"
    for k in (1, 2, 3, 4, 7):
        for delta in (0.0, 1e-3):
            tags = {"nyquist", "cancellation"} if k % 2 == 0 or delta == 0 else {"nyquist"}
            point = (0.01, 0.02, (k * math.pi) ** 2, delta, 0.0)
            yield Problem(f"Nyquist, k = {k}, delta {delta:g}", why, frozenset(tags), point)
    for power in (16, 32):
        why = "N(z) nearly vanishes, and a huge gain makes up for it"
        gains = (3.43148918394457 * 10.0**power, 1.757839836966317 * 10.0**power)
        for k in (2, 24):
            name = f"Nyquist, k = {k}, gains 1e{power}"
            point = (*gains, (k * math.pi) ** 2, 5e-324, 0.0)
            yield Problem(name, why, frozenset({"nyquist", "cancellation", "huge"}), point)


def _multiple_roots() -> Iterator[Problem]:
    why = "a root of multiplicity k moves by the k-th root of a rounding"
    with mp.workdps(60):
        r = mp.cbrt(4) - 1
        gains = float(6 * r**2 - 2), float(2 * r**3)
    tags = frozenset({"multiple", "triple"})
    name = "triple root, the smallest radius of a free device"
    yield Problem(name, why, tags, (*gains, 0.0, 0.0, 0.0), mpc(r), 3, Verdict.STABLE)
    # Gains of a double root so near to the triple one that all three move like it.
    for delay, radius in ((1.0, 0.752114), (2.0, 0.824656), (5.0, 0.907271)):
        point = (*gains_of_root(mpc(radius), 0.0, 0.0, delay, 2), 0.0, 0.0, delay)
        name = f"nearly triple root, delay {delay:g}"
        yield Problem(name, why, frozenset({"multiple"}), point, mpc(radius), 3, Verdict.STABLE)
    for delay, plant in ((0.0, (1e-3, 0.015)), (0.5, (1e-3, 0.015)), (1.0, (0.5, 0.1))):
        for radius in (0.9, -0.8, 1.0 - 1e-9):
            gains = gains_of_root(mpc(radius), *plant, delay, 2)
            name = f"double root at {radius:g}, delay {delay:g}"
            point = (*gains, *plant, delay)
            yield Problem(name, why, frozenset({"multiple"}), point, mpc(radius), 2)


def _without_wall() -> Iterator[Problem]:
    why = "alpha = beta = 0: as many roots at zero as the delay has samples, a defective companion"
    for delay in (1.0, 2.0, 5.0, 20.0, 0.5):
        point = (0.0, 0.0, 0.5, 0.2, delay)
        root = mp.exp(-mpf(0.1) + mpc(0, 1) * mp.sqrt(mpf(0.5) - mpf(0.2) ** 2 / 4))
        tags = frozenset({"no wall"})
        yield Problem(f"no wall, delay {delay:g}", why, tags, point, root, code=Verdict.STABLE)
    why = "alpha or beta alone is 0: coefficients vanish, roots at zero"
    tags = frozenset({"no wall"})
    yield Problem("stiffness alone, delay 2", why, tags, (0.01, 0.0, 1e-3, 0.5, 2.0))
    yield Problem("damping alone, delay 2", why, tags, (0.0, 0.1, 1e-3, 0.015, 2.0))


def _on_circle() -> Iterator[Problem]:
    why = "a root exactly on the circle: not stable, and told to be unstable only at 1"
    tags = frozenset({"on circle"})
    for gamma, delay in ((1e-3, 0.0), (1e-3, 1.0), (0.5, 2.0), (0.0, 0.5)):
        name = f"root at z = 1, gamma {gamma:g}, delay {delay:g}"
        point = (-gamma, 0.3, gamma, 0.015, delay)
        yield Problem(name, why, tags, point, mpc(1), code=Verdict.UNSTABLE)
    # gamma = delta = 0, delay 1/2: alpha + 2 beta = w(-1) = -8, in exact numbers.
    point = (-9.0, 0.5, 0.0, 0.0, 0.5)
    yield Problem("root at z = -1", why, tags, point, mpc(-1), code=Verdict.UNSTABLE)
    name = "undamped plant without wall"
    point = (0.0, 0.0, 0.5, 0.0, 1.0)
    yield Problem(name, why, tags, point, mp.expj(mp.sqrt(mpf(0.5))), code=Verdict.UNDECIDED)
    name = "free device without wall: a double root at 1"
    yield Problem(name, why, tags | {"multiple"}, (0.0,) * 5, mpc(1), 2, Verdict.UNSTABLE)


def _near_circle() -> Iterator[Problem]:
    why = "the boundary, rounded to float64, and the float64 numbers next to it"
    haptic = (1e-3, 0.015)
    for delay, theta in ((0.0, 0.5), (1.0, 0.3), (5.0, 0.1), (0.5, 0.4)):
        alpha, beta = _on_boundary(theta, *haptic, delay)
        for ulps in (-4, -1, 0, 1, 4):
            name = f"boundary, delay {delay:g}, {ulps:+d} ulp"
            point = (_up(alpha, ulps), beta, *haptic, delay)
            yield Problem(name, why, frozenset({"boundary"}), point, mp.expj(mpf(theta)))
    why = "one ulp beside the line of a root at z = 1"
    for side, code in ((1, Verdict.STABLE), (-1, Verdict.UNSTABLE)):
        point = (_up(-1e-3, side), 0.3, *haptic, 0.0)
        yield Problem(f"line z = 1, {side:+d} ulp", why, frozenset({"boundary"}), point, code=code)


def _delays() -> Iterator[Problem]:
    why = "a delay so close to a whole number that a coefficient nearly vanishes"
    for delay in (1e-12, 1.0 - 1e-12, 1.0 + 1e-12, 2.0 - 2.0**-51, 1e-100):
        tags = {"delay", "near whole"}
        yield _with_pair(f"delay {delay!r}", why, tags, 1e-3, 0.015, delay)
    why = "a high degree: sums of many terms, roots crowd the circle"
    for delay in (20.0, 100.5, 200.0):
        z = mp.rect(1 - 0.2 / delay, 0.5 / delay)
        yield _with_pair(f"delay {delay:g}", why, {"delay", "long"}, 1e-3, 0.015, delay, z)


def _gains() -> Iterator[Problem]:
    why = "numbers overflow or vanish on the way"
    plant = (1e-3, 0.015)
    for alpha, beta in ((1e150, 0.1), (-1e150, 0.1), (0.1, 1e150), (1e150, -1e150), (1e100, 1e-3)):
        point = (alpha, beta, *plant, 1.0)
        name = f"gains {alpha:g}, {beta:g}"
        yield Problem(name, why, frozenset({"huge"}), point, code=Verdict.UNSTABLE)
    for alpha, beta in ((5e-324, 5e-324), (1e-300, 0.1), (0.05, 1e-300)):
        name = f"gains {alpha:g}, {beta:g}"
        yield Problem(name, why, frozenset({"denormal"}), (alpha, beta, *plant, 0.0))


def _found() -> Iterator[Problem]:
    """What `python -m benchmarks stress` came upon, in ten million loops; long numbers are cut."""
    tags = frozenset({"found"})
    why = "of all loops, the error of the radius came closest to its bound"
    for point in (
        (0.0, -0.00010504751337496828, 4.682197010121848e-08, 3.0881567389404805e-243, 0.0),
        (4.457196952402061e-06, -3.488428983188316e-05, 1.891679930688e-64, 2.073856808e-169, 0.5),
        (3.91174463507816e-07, -0.0001691572460956, 1e-323, 0.0, 1.0),
        (-4195.473068869074, 9130.514844823405, 10000.0, 390.72468524164725, 2.0),
        (-4.37613424807816e37, -5.1639047742893263e-51, 0.0009999996237, 3.746742505862e-15, 5.0),
    ):
        yield Problem(f"radius next to its bound, delay {point[4]:g}", why, tags, point)
    why = "eigenvalues of the companion matrix are on the wrong side of the circle"
    for point in (
        (0.0013831540092740524, 0.0006920557676006523, 0.0, 1.2559399935892389e-11, 0.0),
        (-0.20606655967413212, -1.1438006180743916, 0.21718220198237284, 0.9320562257339904, 0.5),
        (0.14272789862009577, 0.37898628065579604, 1.5e-323, 5e-324, 1.0),
        (0.23047799971431326, 0.1068183237077505, 0.12967152755119973, 0.720198660235354, 5.0),
    ):
        yield Problem(f"eigenvalues are wrong, delay {point[4]:g}", why, tags, point)


PROBLEMS: tuple[Problem, ...] = tuple(
    problem
    for family in (
        _critical_damping, _sizes, _free_device, _nyquist, _multiple_roots, _without_wall,
        _on_circle, _near_circle, _delays, _gains, _found,
    )
    for problem in family()
)  # fmt: skip


def points() -> np.ndarray:
    """The parameters of all problems in their order, shape (problem, 5)."""
    return np.array([problem.point for problem in PROBLEMS])


LEAST_INERTIAS = [
    (2e-3, (10.0, 1.0), 0.0024816383),
    (2e-3, (20.0, 2.0), 0.0049632767),
    (2e-3, (40.0, 2.0), 0.0051069302),
    (6e-3, (10.0, 1.0), 0.0052609807),
    (6e-3, (20.0, 2.0), 0.0105219615),
    (6e-3, (40.0, 2.0), 0.0110740324),
]
"""Of an undamped joint at 500 Hz with a one-sample difference: delay in s, kp and kd, kg m^2."""
