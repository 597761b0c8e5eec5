"""Check what jaxstab says of virtual walls, without jaxstab: python check_wall.py wall.json

``jaxstab check SCENE --certificate wall.json`` writes the numbers of loops as exact fractions, and
claims: walls (K, B) that are stable or not, and between which K they are. This program needs the
standard library of Python alone. It exits with 0 if it confirms all claims.

The loop. m x'' + b x' + k x = F (device and hand). The position is sampled every T seconds; samples
y_j make the force -(K P y_j + B V y_j / T), which begins d = w + f sampling periods later (w whole,
0 <= f < 1) and is held for T. P and V are quotients of polynomials in 1/z, the lowest power first:
P filters the position, V = 1 - 1/z is the difference over one sample. With T as the unit of time
and m/T^2 as that of K, only kT^2/m, bT/m, KT^2/m and BT/m are left. The state (x, x', F) moves by
e^(rates h) over h. From the force that was before during f, and the new one during 1 - f, follow
x_(j+1) = Phi x_j + new u_(j-w) + old u_(j-w-1) and the polynomial whose roots are the poles:

    p(z) = z^(w+1) det(z - Phi) P_below V_below
           + (c adj(z - Phi) (new z + old)) (K P_above V_below + B V_above P_below).

The verdict. All roots are inside the unit circle if and only if |a_0| < |a_n|, and this holds again
for a_i - (a_0 / a_n) a_(n-i) without its constant, down to degree 0 (Schur and Cohn).
The arithmetic. A number is an interval of two integers in units of 2^-bits, rounded outwards. e^X
is (e^(X / 2^s))^(2^s), by its Taylor sum and a bound of the remainder. If a comparison is not
decided, there are twice as many bits. One case no number of bits decides: that p(1) is 0.
What is confirmed: the verdict on each wall; and at both ends of each interval of K that K is stable
within by a part of 1e-9, and not stable beyond. That nothing between is unstable, that there are no
other intervals, and what other hands, masses or delays do, is not shown here.
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
FILTERS = "position", "velocity"
WALL = "loop", "stiffness", "damping", "verdict", "stiffness_intervals"
NUMBER = re.compile(r'"-?\d+(\.\d*)?(/\d+|e[+-]?\d{1,3})?"', re.ASCII)  # as JSON has it


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


def polynomial(loop, stiffness, damping):
    m, b, k, period, delay = (loop[name] for name in NUMBERS)
    rates = [[0, 1, 0], [-k * period**2 / m, -b * period / m, 1], [0, 0, 0]]
    whole, part = divmod(delay, 1)
    first, then = (exponential([[x * h for x in row] for row in rates]) for h in (part, 1 - part))
    (p, q), (r, s) = (row[:2] for row in product(then, first)[:2])
    new = [row[2] for row in then[:2]]
    old = [row[0] for row in product([row[:2] for row in then[:2]], [row[2:] for row in first[:2]])]
    below = times([p * s - q * r, Real.of(0) - p - s, Real.of(1)], numbers(*[0] * (whole + 1), 1))
    first, later = ([q * side[1] - s * side[0], side[0]] for side in (old, new))
    above = plus(first, times(later, numbers(0, 1)))
    (a, b), (c, d) = ([numbers(*side) for side in loop[name]] for name in FILTERS)
    spring, damper = numbers(stiffness * period**2 / m), numbers(damping * period / m)
    wall = plus(times(spring, times(a, d)), times(damper, times(c, b)))
    return plus(times(below, times(b, d)), times(above, wall))


def is_stable(loop, stiffness, damping):
    """Whether a wall is stable; proved."""
    (a, b), (c, d) = ([sum(side) for side in loop[name]] for name in FILTERS)
    at_rest = loop["stiffness"] * b * d + stiffness * a * d + damping / loop["sample_time"] * c * b
    if at_rest == 0:  # p(1) = 0: nothing holds the position
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


def numbers_in(texts):
    """Fractions or decimals in a list; an exponent of many digits would fill the memory."""
    if not isinstance(texts, list) or not all(NUMBER.fullmatch(json.dumps(x)) for x in texts):
        raise ValueError(f"{json.dumps(texts)[:60]} is no list of numbers such as '1/3', '2.5e-3'")
    return [*map(Fraction, texts)]


def fields(table, *names):
    """The values of these keys, of which a table has all and no other."""
    if not isinstance(table, dict) or {*table} != {*names}:
        raise ValueError(f"{json.dumps(table)[:60]} ... has not the keys {', '.join(names)} alone")
    return [table[name] for name in names]


def read_once(pairs):
    """A table of JSON; ValueError where a key is there twice."""
    if len(dict(pairs)) < len(pairs):
        raise ValueError("a key is given twice")
    return dict(pairs)


def checked(given):
    """A loop in exact numbers, its filters in z; ValueError for another kind, or too large."""
    *values, position, velocity = fields(given, *NUMBERS, *FILTERS)
    m, b, k, period, delay = values = numbers_in(values)
    loop = dict(zip(NUMBERS, values))
    for name, (above, below) in zip(FILTERS, (position, velocity)):
        sides = numbers_in(above), numbers_in(below)
        if not (all(1 <= len(side) <= 502 for side in sides) and sides[1][0]):
            raise ValueError(f"the {name} filter is not of 1 to 502 coefficients, or not causal")
        pairs = [*zip_longest(*sides, fillvalue=0)]  # as many of each, then in powers of z
        loop[name] = [side[::-1] for side in zip(*pairs)]
    is_right = min(m, period) > 0 and min(b, k, delay) >= 0 and delay <= 500
    if not is_right or max(b, k * period) * period > 10**4 * m:
        raise ValueError("the loop has a number that is negative or too large")
    return loop


def claims(file):
    """Each claim in words, with its loop, the wall (K, B) and whether it should be stable."""
    form, walls = fields(file, "format", "walls")
    if form != "jaxstab wall 2":
        raise ValueError(f"format is {json.dumps(form)}; this program reads 'jaxstab wall 2'")
    for name, wall in walls.items():
        if not name.isprintable():
            raise ValueError(f"the name {json.dumps(name)} has a character that is not printed")
        given, *pair, verdict, intervals = fields(wall, *WALL)
        if verdict not in ("stable", "unstable"):
            raise ValueError(f"the verdict of {name} is {json.dumps(verdict)}")
        loop, (stiffness, damping) = checked(given), numbers_in(pair)
        yield f"{name}: {verdict}", loop, stiffness, damping, verdict == "stable"
        for low, high in map(numbers_in, intervals):
            aside = TOLERANCE * max(abs(low), abs(high))
            if high - low <= 2 * aside:
                raise ValueError(f"{name}: the interval from {low} to {high} is empty")
            words = f"{name}: K from {float(low):.12g} to {float(high):.12g}"
            for end, way in ((low, 1), (high, -1)):
                yield f"{words}, stable within", loop, end + way * aside, damping, True
                yield f"{words}, not stable beyond", loop, end - way * aside, damping, False


def main(path):
    try:
        with open(path, encoding="utf-8") as stream:
            file = json.load(stream, object_pairs_hook=read_once)
        asked, refused = list(claims(file)), 0
        for words, *claim, expected in asked:
            try:
                answer = ("REFUSED", "confirmed")[is_stable(*claim) == expected]
            except Undecided:
                answer = "NOT DECIDED"
            refused += answer != "confirmed"
            print(f"{words}: {answer}")
    except Exception as error:  # noqa: BLE001, a file may be wrong in any way
        print(f"{path}: {error}", file=sys.stderr)
        return 2
    print(f"{len(asked) - refused} of {len(asked)} claims confirmed")
    return 1 if refused or not asked else 0


if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1] == "--help":
        print(__doc__)
        sys.exit(0 if len(sys.argv) == 2 else 2)
    sys.exit(main(sys.argv[1]))
