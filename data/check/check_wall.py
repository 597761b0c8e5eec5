"""Check what jaxstab says of virtual walls, without jaxstab: python check_wall.py wall.json

``jaxstab check SCENE --certificate wall.json`` writes the numbers of a loop as exact fractions, and
claims: walls (K, B) that are stable or not, and between which K they are. This program needs the
standard library of Python alone. It exits with 0 if it confirms all claims.

The loop. m x'' + b x' + k x = F (device and hand). The position is sampled every T seconds; a
sample y_j makes the force -(K y_j + B v_j), which begins d = w + f sampling periods later (w whole,
0 <= f < 1) and is held for T. v is the difference over n samples, or that over one behind
first-order low passes of the pole exp(-2 pi c), c the cut-off times T. With T as the unit of time
and m/T^2 as that of K, only kT^2/m, bT/m, KT^2/m and BT/m are left. The state (x, x', F) moves by
e^(rates h) over h. From the force that was before during f, and the new one during 1 - f, follow
x_(j+1) = Phi x_j + new u_(j-w) + old u_(j-w-1) and the polynomial whose roots are the poles:

    p(z) = z^(w+1) det(z - Phi) V_below + (c adj(z - Phi) (new z + old)) (K V_below + B V_above).

The verdict. All roots are inside the unit circle if and only if |a_0| < |a_n|, and this holds again
for a_i - (a_0 / a_n) a_(n-i) without its constant, down to degree 0 (Schur and Cohn).
The arithmetic. A number is an interval of two integers in units of 2^-bits, rounded outwards. e^X
is (e^(X / 2^s))^(2^s), by its Taylor sum and a bound of the remainder. If a comparison is not
decided, there are twice as many bits. One case no number of bits decides: where K = -k, p(1) is 0.
What is confirmed: the verdict on each wall; and at both ends of each interval of K that K is stable
within by a part of 1e-9, and not stable beyond. That nothing between is unstable, and that there
are no other intervals, is not shown here.
"""

import json
import re
import sys
from contextlib import suppress
from fractions import Fraction
from itertools import zip_longest
from math import ceil, factorial, floor
from operator import mul

TOLERANCE = Fraction(1, 10**9)  # of an interval's ends
BITS = 256, 512, 1024, 2048, 4096, 8192
NUMBERS = "mass", "damping", "stiffness", "sample_time", "delay_samples"


class Undecided(ArithmeticError):
    """More bits are needed."""


class Real:
    """An interval of numbers: low and high in units of 2^-bits."""

    bits = BITS[0]

    def __init__(self, low, high):
        self.low, self.high = low, high

    @classmethod
    def of(cls, value):
        value = Fraction(value) * 2**cls.bits
        return cls(floor(value), ceil(value))

    def __add__(self, other):
        return Real(self.low + other.low, self.high + other.high)

    def __sub__(self, other):
        return Real(self.low - other.high, self.high - other.low)

    def __mul__(self, other):
        products = [a * b for a in (self.low, self.high) for b in (other.low, other.high)]
        return Real(min(products) >> self.bits, -(-max(products) >> self.bits))

    def over(self, other):
        """The quotient by an interval without 0."""
        if other.low <= 0 <= other.high:
            raise Undecided
        ends = self.low << self.bits, self.high << self.bits
        pairs = [(a, b) for a in ends for b in (other.low, other.high)]
        return Real(min(a // b for a, b in pairs), -min(-a // b for a, b in pairs))

    def is_smaller(self, other):
        """Whether |self| < |other|; Undecided where the intervals meet."""
        (low, high), (others_low, others_high) = (
            (max(x.low, -x.high, 0), max(-x.low, x.high)) for x in (self, other)
        )
        if low < others_high and high >= others_low:
            raise Undecided
        return high < others_low


def product(a, b):
    return [[sum(map(mul, row, column), Real.of(0)) for column in zip(*b)] for row in a]


def exponential(matrix):
    """e^X of a matrix of fractions, in intervals."""
    halvings = (2 * int(max(sum(map(abs, row)) for row in matrix)) + 2).bit_length()
    scaled = [[Real.of(Fraction(x) / 2**halvings) for x in row] for row in matrix]
    unit = [[Real.of(int(i == j)) for j in range(len(matrix))] for i in range(len(matrix))]
    total, term, count = unit, unit, 0
    while Fraction(2) ** (1 - count) / factorial(count) > Fraction(1, 2**Real.bits):
        count += 1
        term = [[x * Real.of(Fraction(1, count)) for x in row] for row in product(term, scaled)]
        total = [[x + y for x, y in zip(*rows)] for rows in zip(total, term)]
    rest = Real(-1, 1)  # the remainder is at most 2 * 2^-(count + 1) / (count + 1)! < 2^-bits
    total = [[x + rest for x in row] for row in total]
    for _ in range(halvings):
        total = product(total, total)
    return total


def pi():
    """By Machin, 16 arctan(1/5) - 4 arctan(1/239), whose rests are less than the next terms."""

    def arctan(x):
        total, power, k = Fraction(0), Fraction(1, x), 0
        while power > Fraction(1, 2 ** (Real.bits + 8)):
            total += (-1) ** k * power / (2 * k + 1)
            power, k = power / x**2, k + 1
        return Real.of(total) + Real(-1, 1)

    return Real.of(16) * arctan(5) - Real.of(4) * arctan(239)


def exponential_of(x):
    """e^x of an interval: that of its middle, times 1 +- twice its half width, which is small."""
    middle = Fraction(x.low + x.high, 2 << Real.bits)
    value, half = exponential([[middle]])[0][0], x.high - x.low
    return value * Real((1 << Real.bits) - half, (1 << Real.bits) + half)


def times(a, b):
    """The product of polynomials, the lowest power first."""
    total = [Real.of(0)] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        for j, y in enumerate(b):
            total[i + j] = total[i + j] + x * y
    return total


def plus(a, b):
    return [x + y for x, y in zip_longest(a, b, fillvalue=Real.of(0))]


def numbers(*values):
    return [Real.of(value) for value in values]


def velocity(loop):
    """V_above and V_below in units of 1/T."""
    given = {name: Fraction(value) for name, value in loop["velocity"].items()}
    if "window_samples" in given:
        n = int(given["window_samples"])
        return numbers(Fraction(-1, n), *[0] * (n - 1), Fraction(1, n)), numbers(*[0] * n, 1)
    pole = exponential_of(Real.of(-2 * given["cutoff"]) * pi())  # in cycles per sample
    above, below = numbers(-1, 1), numbers(0, 1)
    for _ in range(int(given["order"])):
        above = times(above, [Real.of(0), Real.of(1) - pole])
        below = times(below, [Real.of(0) - pole, Real.of(1)])
    return above, below


def polynomial(loop, stiffness, damping):
    m, b, k, period, delay = (Fraction(loop[name]) for name in NUMBERS)
    rates = [[0, 1, 0], [-k * period**2 / m, -b * period / m, 1], [0, 0, 0]]
    whole, part = divmod(delay, 1)
    first, then = (exponential([[x * h for x in row] for row in rates]) for h in (part, 1 - part))
    (p, q), (r, s) = (row[:2] for row in product(then, first)[:2])
    new = [row[2] for row in then[:2]]
    old = [row[0] for row in product([row[:2] for row in then[:2]], [row[2:] for row in first[:2]])]
    below = times([p * s - q * r, Real.of(0) - p - s, Real.of(1)], numbers(*[0] * (whole + 1), 1))
    first, later = ([q * side[1] - s * side[0], side[0]] for side in (old, new))
    above = plus(first, times(later, numbers(0, 1)))
    rate_above, rate_below = velocity(loop)
    spring, damper = numbers(stiffness * period**2 / m), numbers(damping * period / m)
    wall = plus(times(spring, rate_below), times(damper, rate_above))
    return plus(times(below, rate_below), times(above, wall))


def is_stable(loop, stiffness, damping):
    """Whether a wall is stable; proved."""
    if stiffness + Fraction(loop["stiffness"]) == 0:  # nothing holds the position
        return False
    for Real.bits in BITS:  # of all intervals
        with suppress(Undecided):
            return has_roots_inside(polynomial(loop, stiffness, damping))
    raise Undecided


def has_roots_inside(p):
    while len(p) > 1:
        if not p[0].is_smaller(p[-1]):
            return False
        ratio = p[0].over(p[-1])
        p = [x - ratio * y for x, y in zip(p[1:], p[-2::-1])]
    return True


def checked(loop):
    """A loop; ValueError if it is of another kind, or larger than jaxstab allows."""
    own = {name: Fraction(value) for name, value in loop["velocity"].items()}
    if {*loop} != {"velocity", *NUMBERS} or {*own} not in ({"window_samples"}, {"cutoff", "order"}):
        raise ValueError("the loop has other keys than one mass and its estimator")
    m, b, k, period, delay = (Fraction(loop[name]) for name in NUMBERS)
    count, cutoff = own.get("window_samples", own.get("order")), own.get("cutoff", 1)
    is_right = min(m, period, cutoff) > 0 and min(b, k, delay) >= 0 and max(delay, count) <= 500
    if not is_right or not count == int(count) >= 1 or max(b, k * period) * period > 10**4 * m:
        raise ValueError("the loop has a number that is negative, too large or not whole")
    return loop


def claims(file):
    """Each claim in words, with the wall (K, B) and whether it should be stable."""
    for name, wall in file["walls"].items():
        stiffness, damping = Fraction(wall["stiffness"]), Fraction(wall["damping"])
        expected = {"stable": True, "unstable": False}[wall["verdict"]]
        yield f"{name}: {wall['verdict']}", stiffness, damping, expected
        for low, high in (map(Fraction, ends) for ends in wall["stiffness_intervals"]):
            aside = TOLERANCE * max(abs(low), abs(high))
            if high - low <= 2 * aside:
                raise ValueError(f"{name}: the interval from {low} to {high} is empty")
            words = f"{name}: K from {float(low):.12g} to {float(high):.12g}"
            for end, way in ((low, 1), (high, -1)):
                yield f"{words}, stable within", end + way * aside, damping, True
                yield f"{words}, not stable beyond", end - way * aside, damping, False


def main(path):
    try:
        with open(path, encoding="utf-8") as stream:
            file = json.loads(text := stream.read())
        if file["format"] != "jaxstab wall 1":
            raise ValueError(f"format is {file['format']!r}; this program reads 'jaxstab wall 1'")
        if re.search(r"[\d.]e[+-]?\d{4}", text, re.IGNORECASE):  # it fills the memory
            raise ValueError("a number is beyond what float64 can hold")
        loop, asked, refused = checked(file["loop"]), list(claims(file)), 0
        for words, stiffness, damping, expected in asked:
            try:
                answer = ("REFUSED", "confirmed")[is_stable(loop, stiffness, damping) == expected]
            except Undecided:
                answer = "NOT DECIDED"
            refused += answer != "confirmed"
            print(f"{words}: {answer}")
    except Exception as error:  # noqa: BLE001, a file may be wrong in any way
        print(f"{path}: {'it has no ' * isinstance(error, KeyError)}{error}", file=sys.stderr)
        return 2
    print(f"{len(asked) - refused} of {len(asked)} claims confirmed")
    return 1 if refused or not asked else 0


if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1] == "--help":
        print(__doc__)
        sys.exit(0 if len(sys.argv) == 2 else 2)
    sys.exit(main(sys.argv[1]))
