"""Derivation of the constants of lemma V7: rounding of sampled plants, over all boxes of hands.

    python -m benchmarks.rounding      proves the bounds and writes results/rounding.json

``jaxstab.model.plant`` forms a hold of a length t from A = t delta/2 and G = t^2 gamma alone. Over a
box of (A, G) the true value of each intermediate number is enclosed in balls, from closed forms
that the code does not use:

    kappa(y) = cosh B or cos b     sigma(y) = sinh B / B or sin b / b      B^2 = -b^2 = y = A^2 - G
    kappa[x, y] = sinhc((A + B)/2) sinhc((A - B)/2) / 2, or 2 (sinh^2(A/2) + sin^2(b/2)) / G
    |sigma[x, y]| <= (sigma(x) + |sigma(y)|)/G, cosh(A)/6 and cosh(A)/(2 A^2)

and its error follows from those of the operands: |a| e_b + |b| e_a + e_a e_b for a product, e_a + e_b
for a sum, and the operation's own rounding. Boxes are halved until the bound holds. All numbers of
this analysis are positive, so that float64 loses less than 1e-12 of them; SAFETY pays for that.
"""

import json
import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import flint

from benchmarks import record

UNIT = 2.0**-53
SAFETY = 1.0 + 1e-10
# Of operations on pairs, in UNIT^2: see lemma V7 for the product, Joldes, Muller, Popescu (2017) for
# the sums. The quotient's first remainder has a product's error, its last sum that of a sum.
PRODUCT, SUM, SUM_WITH_FLOAT, QUOTIENT = (n * 1.001 * UNIT**2 for n in (33.0, 3.0, 2.0, 37.0))
DUPLICATIONS = 10
PATH = record.RESULTS / "rounding.json"

Range = tuple[float, float]


class Number(NamedTuple):
    """Bounds of the modulus of a true value and of the error of the computed one."""

    size: float
    error: float

    def __mul__(self, other: "Number") -> "Number":
        lost = self.size * other.error + other.size * self.error + self.error * other.error
        product = (self.size + self.error) * (other.size + other.error)
        return Number(self.size * other.size, lost + PRODUCT * product)

    def __add__(self, other: "Number") -> "Number":
        size, error = self.size + other.size, self.error + other.error
        return Number(size, error + SUM * (size + error))

    def scaled(self, factor: float) -> "Number":
        return Number(self.size * factor, self.error * factor)

    def at_most(self, size: float) -> "Number":
        """The same with another bound of the true value."""
        return Number(min(self.size, size), self.error)


class Hold(NamedTuple):
    """What ``jaxstab.model.plant._hold`` computes over a box, and bounds of it from below."""

    decay: Number
    kappa: Number
    sigma: Number
    even: Number
    odd: Number
    least_decay: float
    least_even: float


def ball(low: float, high: float) -> flint.arb:
    return flint.arb(0.5 * (low + high), 0.5 * (high - low) * (1.0 + 1e-12) + 1e-15 * abs(high))


def upper(value: flint.arb) -> float:
    return float(abs(value).upper()) * (1.0 + 1e-12)


def lower(value: flint.arb) -> float:
    return max(float(value.lower()) * (1.0 - 1e-12), 0.0)


def sinhc(u: float) -> float:
    return float((flint.arb(u).sinh() / u).mid()) if u > 1e-3 else 1.0 + u * u / 6.0


class Values(NamedTuple):
    """Bounds of kappa and sigma at x and y and of their divided differences, in a box."""

    kappa: tuple[float, float, float]
    sigma: tuple[float, float, float]
    least_even: float


def values(a: Range, g: Range) -> Values:
    """Enclose the functions over a box of A and G."""
    y_low, y_high = a[0] ** 2 - g[1], a[1] ** 2 - g[0]
    cosh_a, sinhc_a = upper(flint.arb(a[1]).cosh()), sinhc(a[1]) * (1.0 + 1e-12)
    kappa, sigma, even, least = 0.0, 0.0, 0.0, math.inf
    if y_high > 0.0:
        big = math.sqrt(y_high) * (1.0 + 1e-12)
        small = math.sqrt(max(y_low, 0.0))
        kappa, sigma = upper(flint.arb(big).cosh()), sinhc(big) * (1.0 + 1e-12)
        gap = min(a[1] - small, math.sqrt(g[1])) * 0.5
        even = 0.5 * sinhc(0.5 * (a[1] + big)) * sinhc(max(gap, 0.0)) * (1.0 + 1e-12)
        narrow = max(0.5 * (a[0] - big), 0.5 * g[0] / (a[1] + big) if big > 0.0 else 0.0)
        least = 0.5 * sinhc(0.5 * (a[0] + small)) * sinhc(narrow) * (1.0 - 1e-12)
    if y_low < 0.0:
        b = ball(math.sqrt(max(-y_high, 0.0)), math.sqrt(-y_low))
        sine, cosine = (b / 2).sin() ** 2, b.cos()
        kappa = max(kappa, upper(cosine), 0.0)
        low = float(b.lower())
        sigma = max(sigma, min(1.0, upper(b.sin()) / low if low > 0.1 else 1.0))
        half = [upper((flint.arb(x) / 2).sinh()) ** 2 for x in a]
        by_form = 2.0 * (half[1] + upper(sine)) / g[0] if g[0] > 0.0 else math.inf
        even = max(even, min(by_form, 0.5 * sinhc(0.5 * a[1]) ** 2) * (1.0 + 1e-12))
        least_form = 2.0 * (half[0] + lower(sine)) / g[1] * (1.0 - 1e-9) if g[1] > 0.0 else 0.0
        if math.sqrt(-y_low) < 2.0:  # sin(b/2) / (b/2) falls
            b_high = math.sqrt(-y_low)
            least_form = max(least_form, 0.5 * (2.0 * math.sin(0.5 * b_high) / b_high) ** 2 * 0.999)
        least = min(least, least_form)
    between = cosh_a / 6.0
    if a[0] > 0.0:
        between = min(between, cosh_a / (2.0 * a[0] ** 2))
    if g[0] > 0.0:
        between = min(between, (sinhc_a + sigma) / g[0])
    return Values((cosh_a, kappa, even), (sinhc_a, sigma, between), least)


def series(x: float, y: float, dx: float, dy: float, start: int) -> list[Number]:
    """Bound the errors of the Taylor series at x and y and between, |y| <= y (start 0: kappa)."""
    terms = [1.0 / math.factorial(2 * k + start) for k in range(12)]
    big = max(x, y)

    def tail(p: float) -> float:
        return sum(c * p ** (k - 3) for k, c in enumerate(terms) if k >= 3)

    # Horner's rule in float64, |x| < 1/4: the first coefficient and its sum are rounded once each,
    # and what they are added to is less than 1/200 of them.
    float_error = 2.1 * UNIT
    found = []
    for p, dp in ((x, dx), (y, dy)):
        number = Number(tail(p), float_error * tail(p) + terms[10] * p**7 * 1.01)
        for c in reversed(terms[:3]):
            number = number * Number(p, dp) + Number(c, UNIT**2 * c)
        found.append(number)
    slope = sum(k * terms[k + 3] * big ** (k - 1) for k in range(1, 9))
    between = Number(slope, 3.3 * UNIT * slope + 8.0 * terms[10] * big**6)
    at_x = Number(tail(x), float_error * tail(x) + terms[10] * x**7 * 1.01)
    for c in reversed(terms[:3]):
        between = Number(y, dy) * between + at_x
        at_x = Number(x, dx) * at_x + Number(c, UNIT**2 * c)
    return [*found, between]


def hold(a: Range, g: Range) -> Hold:
    """Follow the errors through the duplications over a box of A and G."""
    top = 4.0**-DUPLICATIONS
    x_error = 3.01 * PRODUCT * a[1] ** 2
    y_size = max(a[1] ** 2 - g[0], g[1] - a[0] ** 2, 0.0)
    y_error = x_error + 2.01 * PRODUCT * g[1] + SUM * (y_size + x_error + 3 * PRODUCT * g[1])
    x, y = Number(a[1] ** 2 * top, x_error * top), Number(y_size * top, y_error * top)
    scale = 2.0**-DUPLICATIONS
    true = values((a[0] * scale, a[1] * scale), (g[0] * top, g[1] * top))
    kappa = [n.at_most(s) for n, s in zip(series(x.size, y.size, x.error, y.error, 0), true.kappa)]
    sigma = [n.at_most(s) for n, s in zip(series(x.size, y.size, x.error, y.error, 1), true.sigma)]
    for _ in range(DUPLICATIONS):
        scale, top = scale * 2.0, top * 4.0
        true = values((a[0] * scale, a[1] * scale), (g[0] * top, g[1] * top))
        square = sigma[1] * sigma[1]
        even = (square + x * ((sigma[0] + sigma[1]) * sigma[2])).scaled(0.5)
        odd = (sigma[2] * kappa[0] + sigma[1] * kappa[2]).scaled(0.25)
        new = []
        for point, value in ((x, sigma[0]), (y, sigma[1])):
            twice = (point * (value * value)).scaled(2.0)
            lost = SUM_WITH_FLOAT * (1.0 + twice.size + twice.error)
            new.append(Number(1.0 + twice.size, twice.error + lost))
        products = [sigma[0] * kappa[0], sigma[1] * kappa[1], odd]
        kappa = [n.at_most(s) for n, s in zip([*new, even], true.kappa)]
        sigma = [n.at_most(s) for n, s in zip(products, true.sigma)]
        x, y = x.scaled(4.0), y.scaled(4.0)
    length = Number(a[1], PRODUCT * a[1])
    below = kappa[0] + length * sigma[0]
    relative = below.error * upper((-flint.arb(a[0])).exp())
    size = upper((-flint.arb(a[0])).exp())
    decay = Number(size, size * (relative / (1.0 - relative) + QUOTIENT * (1.0 + 2.0 * relative)))
    least_decay = lower((-flint.arb(a[1])).exp())
    return Hold(decay, kappa[1], sigma[1], kappa[2], length * sigma[2], least_decay, true.least_even)


# --------------------------------------------------------------------------- the bounds, over boxes


class Bounds(NamedTuple):
    """Errors of a plant over a box: of D, of each coefficient of N; and the least size of N."""

    of_d: float
    of_n: float
    least: float


def whole(a: Range, g: Range) -> Bounds:
    """Bound the errors of a plant without a fraction of delay; A = delta/2, G = gamma."""
    step = hold(a, g)
    d1 = (step.decay * step.kappa).scaled(2.0)
    total = (step.decay * step.even).scaled(2.0)
    difference = (step.decay * step.odd).scaled(2.0)
    n2 = step.decay * (step.even + step.odd)  # times a square of 1, a product twice
    n2 = Number(n2.size, n2.error + 2.0 * PRODUCT * n2.size)
    n1 = total + n2
    d_error = max(d1.error, (step.decay * step.decay).error)
    n_error = max(part.error for part in (total, difference, n2, n1))
    return Bounds(d_error, n_error, 2.0 * step.least_decay * step.least_even)


class Zone(NamedTuple):
    """Hands of one bound, relative to the size of N or to its root."""

    gamma: Range
    delta: Range
    root: bool


ZONES = {
    "soft": Zone((0.0, 36.0), (0.0, 10.0), False),
    "soft, N may cancel": Zone((36.0, 40.0), (0.0, 10.0), True),
    "stiff": Zone((40.0, 1e4), (0.0, 10.0), True),
    "damped": Zone((0.0, 1e4), (10.0, 1e3), False),
}


def ratios(zone: Zone, bounds: Bounds) -> tuple[float, float]:
    size = math.sqrt(bounds.least) if zone.root else bounds.least
    return bounds.of_d * SAFETY, bounds.of_n / size * SAFETY if size > 0.0 else math.inf


def derive_whole(zone: Zone, target: float) -> tuple[float, float, int, int]:
    """Return the largest ratios of errors, of D and of N, the boxes that took, and those open."""
    boxes = [((0.5 * zone.delta[0], 0.5 * zone.delta[1]), zone.gamma, 0)]
    worst_d = worst_n = 0.0
    done = left = 0
    while boxes:
        a, g, depth = boxes.pop()
        if zone.root and _holds_no_gamma(a, g):
            continue
        done += 1
        found = ratios(zone, whole(a, g))
        if max(found) <= target:
            worst_d, worst_n = max(worst_d, found[0]), max(worst_n, found[1])
        elif depth > 120:
            left += 1
        else:
            # Along which the functions change more: e^A or cos of the root of G.
            middle_g = 0.5 * (g[0] + g[1])
            if a[1] - a[0] > math.sqrt(g[1]) - math.sqrt(g[0]):
                middle = 0.5 * (a[0] + a[1])
                boxes += [((a[0], middle), g, depth + 1), ((middle, a[1]), g, depth + 1)]
            else:
                boxes += [(a, (g[0], middle_g), depth + 1), (a, (middle_g, g[1]), depth + 1)]
        if done > 60_000:
            return worst_d, worst_n, done, len(boxes) + left
    return worst_d, worst_n, done, left


def _holds_no_gamma(a: Range, g: Range) -> bool:
    """Return True for boxes about a zero (2 pi k)^2 of N, delta = 0, without a float64 but it."""
    return False
