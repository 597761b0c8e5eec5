"""All zeros of a cosine sum between 0 and pi, each in a ball of its own.

    f(theta) = c_0 + c_1 cos(theta) + ... + c_n cos(n theta),    f(0) and f(pi) not 0.

Up to degree 36 the sum is a polynomial in x = 2 cos(theta), by Chebyshev's recursion. Sturm's chain
counts its real roots in (-2, 2); float64 suggests as many, between the signs of a transform, and
Newton's step in balls proves that each ball holds one (lemma E3). Where guesses are too few, all
complex roots are isolated (lemma E2): one is real if its ball meets the real axis and its mirror
image, a root too, can be in no other ball. What is lost to powers of x, about 1.3 n bits, is in the
radii. Above, and where roots coincide or nearly so, the angles are searched.

The half circle is divided into 2n cells or a few more. Two discrete Fourier transforms give f and
three derivatives at the middle of each. A cell of half-width h has no zero if

    |f| > h |f'| + h^2/2 |f''| + h^3/6 |f'''| + h^4/24 (sum of k^4 |c_k|)

(Taylor; the fourth derivative is at most that sum). A cell that is left gets its Taylor polynomial
P of so many terms that what it misses, at most E = h^D/D! (sum of k^D |c_k|), is far below the sum
of |c_k|: k h is below 1, so that D is 32 for 192 bits. Neither loses digits to the degree n: the
k-th term is multiplied by a root of unity that is known exactly, not by a power that was formed.

Within the cell, on an interval of half-width r around m, with P(m + r t) = q_0 + q_1 t + ...,

    f has no zero if  |q_0| > |q_1| + |q_2| + |q_3| + ... + E,
    f' has none if    |q_1| > 2 |q_2| + 3 |q_3| + ... + r E',    E' the same bound for f' - P',
    f'' has none if   |q_2| > 3 |q_3| + 6 |q_4| + ... + r^2 E''/2, and so on.

A derivative is monotone where the next has no zero: with like signs at both ends it has none
either. Where that ends with f, monotone between unlike signs, there is one zero. Newton's iteration
finds it in numbers, then one step of it in balls proves it: where T is a ball around x and

    N = x - f(x)/f'(T)    lies inside T,

f has one zero in T, and it is in N (mean value theorem). Where it ends with a higher derivative,
the interval is parted on both sides of that one's zero, next to it: zeros of f that coincide, or
nearly, are there. Any other interval is halved. The ends of cells are places where a sign is known:
an end that falls on a zero is moved, for both of its cells.

Zeros of a higher order, and zeros so close to each other that balls do not part them, leave an
interval that is too short to be parted. It is reported as one place, without a direction, if that
is asked for; else the answer is that more bits are needed.
"""

import math
from functools import lru_cache
from itertools import cycle, pairwise
from typing import NamedTuple

import numpy as np
from flint import acb, arb, arb_mat, arb_poly, ctx, fmpq
from jaxtyping import Float64

from jaxstab.exact.roots import real_roots, sign_of
from jaxstab.model.device.parts import FIRST_BITS, remembered, tiny

_OVERLAP = 9  # a cell reaches to 9/8 of its share: the ends of shares may be moved by 1/8
_MOST_DERIVATIVES = 5  # zeros of one order less are found at once
_PATIENT = FIRST_BITS << 2  # bits from which on places without a direction are taken as they are


class Zero(NamedTuple):
    """A ball of angles that holds one zero, and the sign of the derivative there.

    The sign is 0 for a place that holds all zeros of a short interval, of an unknown number.
    """

    angle: "arb"
    slope: int


def zeros(cosines: "list[arb]", *, is_last_try: bool) -> list[Zero] | None:
    """All zeros in (0, pi), from left to right; None where more bits are needed.

    ``is_last_try`` has places without a direction reported: see ``is_patient``.
    """
    most_for_powers = 36  # degree: above, 192 bits are too few for Sturm's chain
    if all(c.contains(0) for c in cosines[1:]):  # a constant, as far as the balls tell
        return None if sum(cosines[1:], cosines[0]).contains(0) else []
    if len(cosines) - 1 <= most_for_powers:
        found = _by_powers(cosines)
        if found is not None:
            return found
    return _by_cells(cosines, is_last_try=is_last_try)


def is_patient() -> bool:
    """True if places without a direction are taken as they are at the precision that is set."""
    return ctx.prec >= _PATIENT


def is_positive(cosines: "list[arb]") -> bool | None:
    """True if c_0 + c_1 cos(theta) + ... > 0 for all angles; None where more bits are needed."""
    places, at_zero = zeros(cosines, is_last_try=False), sign_of(sum(cosines[1:], cosines[0]))
    if places is None or not at_zero:
        return None
    return not places and at_zero == 1


def _by_powers(cosines: "list[arb]") -> list[Zero] | None:
    """The zeros from roots in x = 2 cos(theta); None where they are not told apart."""
    total = arb_poly((_in_powers(len(cosines)) * arb_mat([[c] for c in cosines])).entries())
    slope = total.derivative()
    roots = _as_many_as_counted(total, slope, _guesses(cosines))
    roots = real_roots(total) if roots is None else roots
    if roots is None:
        return None
    found = []
    for root in sorted(roots, reverse=True):
        if abs(root) < 2:
            sign = -sign_of(slope(root))
            if not sign:
                return None
            found.append(Zero((root / 2).acos(), sign))
        elif not abs(root) > 2:
            return None  # no zero is at 0 or pi, but this one may be there
    return found


@lru_cache
def _in_powers(count: int) -> arb_mat:
    """The coefficients of so many cos(k theta) in powers of x, exact, each in its column."""
    orders = [arb_poly([2]), arb_poly([0, 1])]  # 2 cos(k theta)
    while len(orders) < count:
        orders.append(orders[-1].left_shift(1) - orders[-2])
    rows = [[order[power] / 2 for order in orders[:count]] for power in range(count)]
    return arb_mat(rows)


def _as_many_as_counted(
    f: "arb_poly", slope: "arb_poly", guesses: list[float]
) -> "list[arb] | None":
    """The roots in (-2, 2), one next to each guess; None where there may be others."""
    roots = [_root_at(f, slope, guess) for guess in guesses]
    ends = [arb(2), *roots, arb(-2)]
    are_apart = all(left > right for left, right in pairwise(ends))
    return roots if are_apart and len(roots) == _sturm_count(f, slope) else None


@np.errstate(all="ignore")  # NaN where it finds none
def _guesses(cosines: "list[arb]") -> list[float]:
    """The roots in float64, descending: next to changes of sign between 16n angles."""
    degree, steps = len(cosines) - 1, 2
    largest = max(map(abs, cosines), key=float)
    c, order = np.array([float((x / largest).mid()) for x in cosines]), np.arange(degree + 1.0)
    places = _places(16 * degree)
    values = np.fft.rfft(c, 2 * len(places) - 2).real
    is_negative = values < 0.0
    left = np.flatnonzero(is_negative[1:] != is_negative[:-1])
    share = values[left] / (values[left] - values[left + 1])
    x = places[left] + share * (places[left + 1] - places[left])
    for _ in range(steps):
        theta = np.arccos(0.5 * x)
        turns = np.outer(theta, order)
        slope = np.sin(turns) @ (order * c) / (2.0 * np.sin(theta))
        x = np.minimum(np.maximum(x - np.cos(turns) @ c / slope, -2.0), 2.0)
    roots: list[float] = x.tolist()
    return roots


@lru_cache
def _places(cells: int) -> Float64[np.ndarray, " place"]:
    return 2.0 * np.cos(np.linspace(0.0, np.pi, cells + 1))


def _root_at(f: "arb_poly", slope: "arb_poly", guess: float) -> "arb":
    """The one root in a ball around the end of Newton's iteration; NaN if none is found."""
    most = 10  # steps; the error of the last but one is squared
    x = arb(guess)
    for _ in range(most):
        rise = slope(x)
        step = f(x) / rise
        x = (x - step).mid()
        if abs(step) < tiny(4):
            value = f(x)
            around = arb(x, (4 * value / rise).abs_upper())
            root = x - value / slope(around)
            return root if around.contains(root) else arb("nan")
    return arb("nan")


def _sturm_count(f: "arb_poly", slope: "arb_poly") -> int | None:
    """The number of real roots in (-2, 2); None where balls do not tell, or roots coincide."""
    chain = [f, slope]
    while chain[-1].degree() > 0:
        if chain[-1].coeffs()[-1].contains(0):
            return None
        chain.append(-(chain[-2] % chain[-1]))
    ends = [[sign_of(part(end)) for part in chain] for end in (-2, 2)]
    if len(chain) <= f.degree() or not all(map(all, ends)):
        return None
    low, high = (sum(a != b for a, b in pairwise(signs)) for signs in ends)
    return low - high


def _by_cells(cosines: "list[arb]", *, is_last_try: bool) -> list[Zero] | None:
    cells = _Cells(cosines)
    signs = [_sign_on_cell(cells, cell) for cell in range(cells.count)]
    parts = cells.polynomials([cell for cell, sign in enumerate(signs) if not sign])
    ends = [_end(cell, signs, parts) for cell in range(cells.count + 1)]
    found: list[Zero] = []
    for cell, part in parts.items():
        (left, first), (right, last) = ends[cell : cell + 2]
        places = _isolated(part, (_place(-1, left), first), (_place(1, right), last))
        if places is None or not (is_last_try or all(place.slope for place in places)):
            return None
        found += [Zero(cells.angle(cell, place.angle), place.slope) for place in places]
    return found


class _Cells:
    """A cosine sum on equal cells of the half circle."""

    def __init__(self, cosines: "list[arb]") -> None:
        self.cosines = cosines
        self.degree = len(cosines) - 1
        self.count = 1 << (2 * self.degree - 1).bit_length()
        self.half = arb.pi() * _OVERLAP / (16 * self.count)
        first = _times_order(cosines)
        second = _times_order(first)
        third = _times_order(second)
        # The second and third derivative have the other sign: only their moduli are asked for.
        self.values = _sums(cosines, first, self.count) + _sums(second, third, self.count)
        self.fourth = sum(map(abs, _times_order(third)), arb(0))

    def angle(self, cell: int, t: "arb") -> "arb":
        """The angle at t of a cell, from -1 to 1."""
        return arb.pi() * (2 * cell + 1) / (2 * self.count) + self.half * t

    def polynomials(self, chosen: list[int]) -> "dict[int, _CellModel]":
        """The Taylor polynomials of cells, in t."""
        if not chosen:
            return {}
        even, odd, last = _weights(self.degree, self.count)
        roots = _roots_of_unity(4 * self.count)
        terms = []  # of cos(k theta), the even ones, and of sin(k theta)
        for side, weights in enumerate((even, odd)):
            given = [
                [
                    c * roots[k * (2 * cell + 1) % len(roots)][side]
                    for k, c in enumerate(self.cosines)
                ]
                for cell in chosen
            ]
            terms.append((arb_mat(given) * weights).tolist())
        missed = (arb_mat([[abs(c) for c in self.cosines]]) * last)[0, 0].abs_upper()
        parts = {}
        for cell, *sides in zip(chosen, *terms, strict=True):
            taylor = [term for pair in zip(*sides, strict=True) for term in pair]
            signs = cycle((1, -1, -1, 1))  # cos, -sin, -cos, sin
            p = arb_poly([s * term for s, term in zip(signs, taylor, strict=False)])
            parts[cell] = _CellModel(p, arb(0, missed), len(taylor))
        return parts


class _CellModel(NamedTuple):
    """A cosine sum f on a cell, t from -1 to 1: a polynomial P of so many terms, and |f - P|."""

    value: "arb_poly"
    missed: "arb"
    terms: int

    def derivative(self, times: int = 1) -> "_CellModel":
        """f', or a higher derivative."""
        value, missed = self.value, self.missed
        for _ in range(times):
            value, missed = value.derivative(), missed * self.terms
        return _CellModel(value, missed, self.terms)

    def on(self, centre: "arb", half: "arb") -> int:
        """The order of the first derivative that surely has no zero around a centre, at most 5."""
        sizes = [abs(c) for c in self.value(arb_poly([centre, half])).coeffs()]
        missed = self.missed
        for order, size in enumerate(sizes[:_MOST_DERIVATIVES]):
            others = (math.comb(k, order) * sizes[k] for k in range(order + 1, len(sizes)))
            if size > sum(others, missed):
                return order
            missed *= self.terms * half
        return _MOST_DERIVATIVES

    def sign(self, t: "arb") -> int:
        """The sign at a place, 0 if it is not known."""
        return sign_of(self.value(t) + self.missed)


def _end(index: int, signs: list[int], parts: "dict[int, _CellModel]") -> tuple[int, int]:
    """By how much the end before a cell is moved, in 72ths of a cell, and the sign there."""
    moves = 9  # of an end
    known = [signs[cell] for cell in (index - 1, index) if 0 <= cell < len(signs)]
    sign, is_outermost, cell = known[0] or known[-1], len(known) == 1, max(index - 1, 0)
    for moved in range(1 if is_outermost else moves):
        sign = sign or parts[cell].sign(_place(1 if index else -1, moved))
        if sign:
            break
    return moved, sign


def _place(side: int, moved: int) -> "arb":
    """The right or the left end of a cell, moved, as a place of it."""
    return arb(64 * side + moved) / 72


def _sign_on_cell(cells: _Cells, cell: int) -> int:
    """The sign of f in all of a cell; 0 where it may have a zero."""
    f, f1, f2, f3 = (values[cell] for values in cells.values)
    h = cells.half
    rest = abs(f3) * 4 + h * cells.fourth
    more = h * (abs(f1) * 24 + h * (abs(f2) * 12 + h * rest))
    return sign_of(f) if abs(f) * 24 > more else 0


def _isolated(
    part: _CellModel, first: "tuple[arb, int]", last: "tuple[arb, int]"
) -> list[Zero] | None:
    """The zeros of a part between two places with their signs, from left to right, in t."""
    found: list[Zero] = []
    intervals = [(first, last)]
    while intervals:
        (a, sign_a), (b, sign_b) = intervals.pop()
        whole = a.union(b)
        order, turns = part.on(whole.mid(), whole.rad()), None
        shortest = tiny(2 * max(order, 2))
        while 1 < order < _MOST_DERIVATIVES:
            bend = part.derivative(order - 1)
            turns = bend.sign(a) * bend.sign(b)
            if turns != 1:
                break
            order -= 1  # monotone, without a change of sign
        is_monotone = order == 1 and sign_a and sign_b
        if order == 0 or (is_monotone and sign_a == sign_b):
            continue
        zero = _refined(part, a, b, sign_b) if is_monotone else None
        if zero:
            found.append(zero)
        elif whole.rad() < shortest:
            found.append(Zero(whole, 0))
        else:
            around = _around_zero(bend, a, b, shortest / 2) if turns == -1 else []
            places = [(t, part.sign(t)) for t in around] or [_known_place(part, a, b)]
            if not all(sign for _, sign in places):
                return None  # the balls tell nothing about all of the interval
            ends = [(a, sign_a), *places, (b, sign_b)]
            intervals += reversed(list(pairwise(ends)))
    return found


def _around_zero(part: _CellModel, a: "arb", b: "arb", distance: "arb") -> "list[arb]":
    """Two places at a distance from the one zero of a monotone part, those in the interval."""
    zero = _refined(part, a, b, part.sign(b))
    if zero is None:
        return []
    places = (zero.angle - distance).mid(), (zero.angle + distance).mid()
    return [place for place in places if a < place < b]


def _known_place(part: _CellModel, a: "arb", b: "arb") -> "tuple[arb, int]":
    """A place about the middle of an interval, and the sign there, if one can be known."""
    for share in range(6, 11):  # 16ths of an interval, where it is divided
        place = (a + (b - a) * share / 16).mid()
        sign = part.sign(place)
        if sign:
            break
    return place, sign


def _refined(part: _CellModel, a: "arb", b: "arb", sign_b: int) -> Zero | None:
    """The zero of a monotone part with unlike signs at its ends."""
    refinements = 80
    low, high, slope = a.mid(), b.mid(), part.derivative()
    x, smallest = low, tiny(1)
    for _ in range(refinements):
        f = part.value(x)
        sign = sign_of(f + part.missed)
        if sign == sign_b:
            high = x
        elif sign:
            low = x
        new = (x - f / slope.value(x)).mid()
        if not low.union(high).contains(new):
            new = ((low + high) / 2).mid()
        x = new
        if not sign:
            break
    f = part.value(x) + part.missed
    radius = max(4 * (f / slope.value(x)).abs_upper(), smallest)
    around = arb(x, radius)
    place = x - f / (slope.value(around) + slope.missed)
    return Zero(place, sign_b) if around.contains(place) else None


def _times_order(cosines: "list[arb]") -> "list[arb]":
    return [k * c for k, c in enumerate(cosines)]


def _sums(even: "list[arb]", odd: "list[arb]", cells: int) -> "list[list[arb]]":
    """Sums of ``even`` times cos(k theta), of ``odd`` times -sin(k theta), at middles of cells."""
    roots = _roots_of_unity(4 * cells)
    given = [acb(a, b) * acb(z[0], -z[1]) for a, b, z in zip(even, odd, roots, strict=False)]
    turned = acb.dft(given + [acb(0)] * (2 * cells - len(given)))
    pairs = [(turned[cell].real, turned[-1 - cell].real) for cell in range(cells)]
    return [[(a + b) / 2 for a, b in pairs], [(b - a) / 2 for a, b in pairs]]


@remembered()
def _roots_of_unity(count: int) -> "list[tuple[arb, arb]]":
    angles = [fmpq(2 * part, count) for part in range(count)]
    return [(arb.cos_pi_fmpq(angle), arb.sin_pi_fmpq(angle)) for angle in angles]


@remembered()
def _weights(degree: int, cells: int) -> "tuple[arb_mat, arb_mat, arb_mat]":
    """(k h)^d/d!, columns for the even d below D and for the odd ones, and that of D."""
    steps = [arb.pi() * (_OVERLAP * k) / (16 * cells) for k in range(degree + 1)]
    last = [arb(1)] * (degree + 1)
    rows: list[list[arb]] = []
    while len(rows) % 2 or not last[-1] < tiny(3) ** 2:
        rows.append(last)
        last = [value * step / len(rows) for value, step in zip(last, steps, strict=True)]
    even, odd, missed = map(arb_mat, (rows[::2], rows[1::2], [last]))
    return even.transpose(), odd.transpose(), missed.transpose()
