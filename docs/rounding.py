"""Derivation of the constants of lemma V7: rounding of sampled plants, over all boxes of hands.

    python docs/rounding.py [N]  proves the bounds in at most N boxes each, and writes
                                 docs/rounding.json

``jaxstab.model.plant`` forms a hold of a length t from A = t delta/2 and G = t^2 gamma alone. Over
a box of (A, G) the true value of each intermediate number is enclosed in balls, from closed forms
that the code does not use:

    kappa(y) = cosh B or cos b     sigma(y) = sinh B / B or sin b / b      B^2 = -b^2 = y = A^2 - G
    kappa[x, y] = sinhc((A + B)/2) sinhc((A - B)/2) / 2, or 2 (sinh^2(A/2) + sin^2(b/2)) / G
    |sigma[x, y]| <= (sigma(x) + |sigma(y)|)/G, cosh(A)/6 and cosh(A)/(2 A^2)

and its error follows from those of the operands: |a| e_b + |b| e_a + e_a e_b for a product,
e_a + e_b for a sum, and the operation's own rounding. Boxes are halved until the bound holds. All
numbers of this analysis are positive, so that float64 loses less than 1e-12 of them; SAFETY pays
for that.
"""

import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import flint

UNIT = 2.0**-53
SAFETY = 1.0 + 1e-10
# Of operations on pairs, in UNIT^2: lemma V7 has the product, Joldes, Muller, Popescu (2017) have
# the sums. The quotient's first remainder has a product's error, its last sum that of a sum.
PRODUCT, SUM, SUM_WITH_FLOAT, QUOTIENT = (n * 1.001 * UNIT**2 for n in (33.0, 3.0, 2.0, 37.0))
DUPLICATIONS = 10
PATH = Path(__file__).with_suffix(".json")

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


def upper(value: flint.arb) -> float:
    """Return a bound of the modulus from above."""
    return _finite(float(value.abs_upper()) * (1.0 + 1e-12))


def lower(value: flint.arb) -> float:
    """Return a bound of the modulus from below."""
    return _finite(float(value.abs_lower()) * (1.0 - 1e-12))


def _finite(bound: float) -> float:
    if not math.isfinite(bound):  # min and max would pass over a NaN
        raise ArithmeticError(f"{bound} is no bound.")
    return bound


def sinhc(u: float) -> float:
    return float((flint.arb(u).sinh() / u).mid()) if u > 1e-3 else 1.0 + u * u / 6.0


class Values(NamedTuple):
    """Bounds of kappa and sigma at x and y and of their divided differences, in a box."""

    kappa: tuple[float, float, float]
    sigma: tuple[float, float, float]
    least_even: float


def values(a: Range, g: Range) -> Values:
    """Enclose the functions over a box of A and G."""
    lost = 1e-15 * (a[1] ** 2 + g[1])
    y_low, y_high = a[0] ** 2 - g[1] - lost, a[1] ** 2 - g[0] + lost
    with flint.ctx.workprec(160):
        return _values(a, g, y_low, y_high)


def _values(a: Range, g: Range, y_low: float, y_high: float) -> Values:
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
        ends = [flint.arb(g[0]) - flint.arb(a[1]) ** 2, flint.arb(g[1]) - flint.arb(a[0]) ** 2]
        b_low, b_high = (end.sqrt() if end > 0 else flint.arb(0) for end in ends)
        b = b_low.union(b_high)
        sine, cosine = (b / 2).sin(), b.cos()
        kappa = max(kappa, upper(cosine), 0.0)
        low = float(b.lower())
        sigma = max(sigma, min(1.0, upper(b.sin()) / low if low > 0.1 else 1.0))
        half = lower((flint.arb(a[0]) / 2).sinh()) ** 2, upper((flint.arb(a[1]) / 2).sinh()) ** 2
        by_form = 2.0 * (half[1] + upper(sine) ** 2) / g[0] if g[0] > 0.0 else math.inf
        even = max(even, min(by_form, 0.5 * sinhc(0.5 * a[1]) ** 2) * (1.0 + 1e-12))
        least_form = 2.0 * (half[0] + lower(sine) ** 2) / g[1] * (1.0 - 1e-9) if g[1] > 0.0 else 0.0
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
    kappa = [
        n.at_most(s)
        for n, s in zip(series(x.size, y.size, x.error, y.error, 0), true.kappa, strict=True)
    ]
    sigma = [
        n.at_most(s)
        for n, s in zip(series(x.size, y.size, x.error, y.error, 1), true.sigma, strict=True)
    ]
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
        kappa = [n.at_most(s) for n, s in zip([*new, even], true.kappa, strict=True)]
        sigma = [n.at_most(s) for n, s in zip(products, true.sigma, strict=True)]
        x, y = x.scaled(4.0), y.scaled(4.0)
    length = Number(a[1], PRODUCT * a[1])
    below = kappa[0] + length * sigma[0]
    relative = below.error * upper((-flint.arb(a[0])).exp())
    size = upper((-flint.arb(a[0])).exp())
    if not relative < 0.5:  # a box that is too large
        return Hold(*[Number(math.inf, math.inf)] * 5, 0.0, 0.0)
    decay = Number(size, size * (relative / (1.0 - relative) + QUOTIENT * (1.0 + 2.0 * relative)))
    least_decay = lower((-flint.arb(a[1])).exp())
    return Hold(
        decay, kappa[1], sigma[1], kappa[2], length * sigma[2], least_decay, true.least_even
    )


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


def fractional(a: Range, g: Range, f: Range) -> Bounds:
    """Bound the errors of a plant with a fraction of delay."""
    t = 1.0 - f[1], 1.0 - f[0]
    up = 1.0 + 1e-15
    step = hold(a, g)
    after, before = (
        hold(
            (a[0] * x[0] / up, a[1] * x[1] * up),
            (g[0] * x[0] ** 2 / up**3, g[1] * x[1] ** 2 * up**3),
        )
        for x in (t, f)
    )
    total = (step.decay * step.even).scaled(2.0)
    n2 = _times_square(t[1], after.decay * (after.even + after.odd))
    kept = after.decay * after.decay
    n0 = kept * _times_square(f[1], before.decay * (before.even + before.odd))
    n1 = total + n2 + n0
    n_error = max(part.error for part in (n1, (n2 + n0).scaled(2.0) + total))
    d1 = (step.decay * step.kappa).scaled(2.0)
    d_error = max(d1.error, (step.decay * step.decay).error)
    # |n2| + |n1| + |n0| is N(1) at least, and n2, where odd >= 0.
    least = max(
        2.0 * step.least_decay * step.least_even, t[0] ** 2 * after.least_decay * after.least_even
    )
    return Bounds(d_error, n_error, least)


def _times_square(length: float, number: Number) -> Number:
    size = length**2 * number.size
    return Number(size, length**2 * number.error + 2.01 * PRODUCT * (size + number.error))


class Zone(NamedTuple):
    """Hands of one bound, relative to the size of N or to its root, which is derived as well."""

    gamma: Range
    delta: Range
    root: bool
    bound: float


ZONES = {
    "soft": Zone((0.0, 36.0), (0.0, 10.0), False, 2.0**-89),
    "soft, N may cancel": Zone((36.0, 40.0), (0.0, 10.0), True, 2.0**-89),
    "stiff": Zone((40.0, 1e4), (0.0, 10.0), True, 2.0**-66),
    "damped": Zone((0.0, 1e4), (10.0, 1e3), False, 2.0**-56),
}
_DEEPEST, _MOST = 200, 400_000


class Derived(NamedTuple):
    """Largest ratios of errors to the size, the number of boxes, and of those that are open."""

    of_d: float
    of_n: float
    boxes: int
    open: int


def derive(zone: Zone, *, with_fraction: bool, most: int = _MOST) -> Derived:
    """Halve boxes of A = delta/2, G = gamma and the fraction until the zone's bound holds."""
    start = (0.5 * zone.delta[0], 0.5 * zone.delta[1]), zone.gamma, (0.0, 1.0)
    boxes, worst, done, left = [(start, 0)], (0.0, 0.0), 0, 0
    while boxes:
        box, depth = boxes.pop()
        done += 1
        bounds = fractional(*box) if with_fraction else whole(*box[:2])
        size = math.sqrt(bounds.least) if zone.root else bounds.least
        ratios = bounds.of_d * SAFETY, bounds.of_n / size * SAFETY if size > 0.0 else math.inf
        if all(ratio <= zone.bound for ratio in ratios):
            worst = max(worst[0], ratios[0]), max(worst[1], ratios[1])
        elif depth > _DEEPEST or done >= most:
            left += 1 + (len(boxes) if done >= most else 0)
            if done >= most:
                break
        else:
            boxes += [(half, depth + 1) for half in _halves(*box, with_fraction=with_fraction)]
    return Derived(*worst, done, left)


def _halves(a: Range, g: Range, f: Range, *, with_fraction: bool) -> Iterator[tuple[Range, ...]]:
    """Halve a box where the functions change most: e^A, and cos or cosh of B."""
    away = 2.0 * math.sqrt(max(a[0] ** 2 - g[1], 0.0))
    by_g = math.sqrt(g[1]) - math.sqrt(g[0])
    by_g = min(by_g, (g[1] - g[0]) / away) if away > 0.0 else by_g
    relative = 0.5 * (g[1] - g[0]) / (g[1] + 1.0)
    by_a = a[1] - a[0]
    by_f = (f[1] - f[0]) * (1.0 + a[1] + math.sqrt(g[1])) if with_fraction else 0.0
    by_g = max(by_g, relative)
    if by_f > max(by_a, by_g):
        middle = 0.5 * (f[0] + f[1])
        yield from ((a, g, (f[0], middle)), (a, g, (middle, f[1])))
    elif by_a > by_g:
        middle = 0.5 * (a[0] + a[1])
        yield from (((a[0], middle), g, f), ((middle, a[1]), g, f))
    elif math.nextafter(g[0], math.inf) >= g[1]:  # gamma is a float64: one of the ends
        yield from ((a, (end, end), f) for end in g)
    else:
        middle = 0.5 * (g[0] + g[1])
        yield from ((a, (g[0], middle), f), (a, (middle, g[1]), f))


def main(most: int = _MOST) -> int:
    """Derive the bounds of all zones, one after the other, and keep what was found."""
    found = {}
    for with_fraction in (False, True):
        for name, zone in ZONES.items():
            derived = derive(zone, with_fraction=with_fraction, most=most)
            delays = "any delay" if with_fraction else "whole delays"
            found[f"{name}, {delays}"] = {"bound": zone.bound, **derived._asdict()}
            state = "derived" if derived.open == 0 else f"{derived.open} boxes open"
            bits = [math.log2(part) if part else -math.inf for part in derived[:2]]
            line = f"{name:20} {delays:13} D 2^{bits[0]:.1f}, N 2^{bits[1]:.1f}"
            print(f"{line}, {derived.boxes} boxes, {state}", flush=True)
            PATH.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else _MOST))
