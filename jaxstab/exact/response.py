"""E4. Responses of a wall: sums of their moduli, and the time from which on they stay small.

A response of a stable wall is h = num(z)/p(z) = h_0 + h_1/z + ..., num of a disturbance or of a way
to begin to move. Its first terms are the quotient of two power series. With simple poles z_j, which
E2 isolates, and residues, the terms from h_K on are sums of geometric series,

    h_(K + t) = sum_j R_j z_j^t,     |h_(K + t)| <= sum_j |R_j| |z_j|^t,

so that what comes after any t is bounded, however close to the boundary the wall is. Millions of
terms are needed there, so they are evaluated in float64, from numbers that are rounded once: t = i
+ W l takes i + l products of powers of z_j and z_j^W, each of them right to 4 units, and a sum.

Poles that coincide have no residues. Then x^m mod p(x) = q_0 + q_1 x + ... tells the terms from
those m earlier: h_(k + m) = sum_i q_i h_(k + i). With eta = sum |q_i| below 1 all terms from N on
are at most the largest of h_N ... h_(N + m - 1), and their moduli add up to at most the sum of
these, over 1 - eta.

What is summed are combinations of few series, the states of the device at the samples and the
forces that act: a sample has many times, and a disturbance by friction many inputs.
"""

from bisect import bisect_left
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from math import ceil, inf, isfinite, log, nan
from typing import Any, NamedTuple

import numpy as np
from flint import acb, arb, arb_mat, arb_poly, arb_series
from jaxtyping import Complex128, Float64

from jaxstab.exact.roots import (
    TripleAt,
    are_inside,
    is_sharp,
    isolated_roots,
    real_or_not,
    sign_of,
)
from jaxstab.model.balls import Factored, LoopFactors, ball_loop
from jaxstab.model.device.device import in_steps
from jaxstab.model.device.discrete import held_steps
from jaxstab.model.device.mechanics import after_impact, equations
from jaxstab.model.device.parts import Answer, decided, exact, remembered
from jaxstab.model.device.sampling import seen
from jaxstab.model.filters import behind_measured
from jaxstab.model.loop import LoopParameters
from jaxstab.rounding import EPS, UNDERFLOW, UNIT

_MOST_POWERS = 100_000  # terms where poles coincide
_BLOCK = 1_000_000  # numbers that are evaluated at once
_NARROW = 1e-24  # of the largest term: balls of all terms of a quotient
_NOTHING = 1e-30  # of a sum: far less than a rounding
_UP = 1.0 + 1e-15  # for a number that was rounded to float64, or the sum of a few

Causes = tuple[bool, bool, bool]  # errors of the read position, errors of the force, and friction


class ModalTerms(NamedTuple):
    """The terms from h_K on: Re(sum_j R_j z_j^t), one z_j of each pair.

    sizes, errors: bounds of |R_j|, and of what its float64 is wrong by.
    moduli, gaps: no less than |z_j|, no more than 1 - |z_j|.
    balls: z_j, and the residues of the first response.
    """

    poles: Complex128[np.ndarray, " pole"]
    residues: Complex128[np.ndarray, "input series pole"]
    sizes: Float64[np.ndarray, "input series pole"]
    errors: Float64[np.ndarray, "input series pole"]
    moduli: Float64[np.ndarray, " pole"]
    gaps: Float64[np.ndarray, " pole"]
    balls: "list[tuple[acb, acb]]"

    def powers(self, terms: int) -> tuple[np.ndarray, np.ndarray, float]:
        """z^i for i < W, z^(W l) for W l < terms, and the relative error of values from them."""
        width = ceil(terms**0.5)
        count = ceil(terms / width)

        def blocks() -> "list[acb]":
            return [ball**width for ball, _ in self.balls]

        def are_sharp(balls: "list[acb]") -> bool:
            return all(is_sharp(ball) or abs(ball) < _NOTHING for ball in balls)

        balls = decided(blocks, is_answered=are_sharp)
        far = np.array([complex(ball) for ball in balls])
        with np.errstate(under="ignore"):
            near, late = _powers(self.poles, width), _powers(far, count)
        return near, late, 4 * UNIT * (width + count + len(far) + 4)

    def terms_above(self, limit: float, most: int) -> int:
        """The terms of the first response before its bound falls to a limit, or most + 1."""

        def is_low(terms: int) -> bool:
            with np.errstate(under="ignore"):
                bound = self.sizes[0, 0] @ self.moduli**terms * (1.0 + 1e-12)
            return bool(bound <= limit)

        return bisect_left(range(most + 1), True, key=is_low)

    def values(self, terms: int) -> tuple[np.ndarray, np.ndarray]:
        """Terms of the first response, that many at least, and how wrong each may be."""
        near, late, error = self.powers(terms)
        with np.errstate(under="ignore"):
            begins = self.moduli[:, None] ** (near.shape[1] * np.arange(late.shape[1]))
            wrong = (error * self.sizes[0, 0] + self.errors[0, 0]) @ begins
            values = ((self.residues[0, 0][:, None] * late).T @ near).real.ravel()
        return values, np.repeat(wrong, near.shape[1])


class WallResponses(NamedTuple):
    """Responses of one wall, some series for each of some inputs.

    head: the first terms, to the nearest float64, and in balls for the first response.
    modes: the later terms; None where poles coincide.
    late: without modes, the moduli of all terms from this one on, of a response and of any
        combination of them, add up to at most 1 + growth times those in the head.
    """

    head: Float64[np.ndarray, "input series term"]
    balls: "arb_poly"
    modes: ModalTerms | None = None
    late: int = 0
    growth: float = 0.0

    @np.errstate(under="ignore")  # of what decays
    def sums(
        self, rows: Float64[np.ndarray, "row series"], columns: Float64[np.ndarray, "column input"]
    ) -> Float64[np.ndarray, "column row"]:
        """No less than the sum over all k of |rows h_k columns'|.

        Rows and columns may be wrong by a unit of each entry, and by 2^-150 of the largest one.
        """
        most_terms = 4_000_000  # that are summed; what comes later is bounded
        nothing = 1e-12  # a share of a response that is not looked at
        large_rows, large_columns = (
            np.abs(side) + _NOTHING * np.abs(side).max(initial=0.0) for side in (rows, columns)
        )
        inputs, series, summed = self.head.shape
        rounding = UNIT * (inputs + series + 9)  # and the terms that are left out
        values = np.abs(_mixed(rows, columns, self.head))
        total = values.sum(axis=-1) + self.growth * values[..., self.late :].sum(axis=-1)
        sizes = np.abs(self.head).sum(axis=-1, keepdims=True) * (1.0 + self.growth)
        total += rounding * _mixed(large_rows, large_columns, sizes)[..., 0]
        modes = self.modes
        if modes is not None and len(modes.poles):
            terms = min(ceil(log(nothing) / log(min(modes.moduli.max(), 1.0 - UNIT))), most_terms)
            near, late, error = modes.powers(terms)
            terms = near.shape[1] * late.shape[1]
            residues = _mixed(rows, columns, modes.residues)
            step = max(1, _BLOCK // (near.shape[1] * residues[..., 0].size))
            for begin in range(0, late.shape[1], step):
                slow = np.abs(late[:, begin]) > _NOTHING
                first = residues[:, :, None, slow] * late[slow, begin : begin + step].T
                first = np.concatenate([first.real, -first.imag], axis=-1)
                later = first @ np.concatenate([near[slow].real, near[slow].imag])
                total += np.abs(later, out=later).sum(axis=(2, 3))
            wrong = (error + rounding) * modes.sizes + modes.errors
            wrong = _mixed(large_rows, large_columns, wrong)
            tail = (np.abs(residues) + wrong) * modes.moduli**terms
            total += ((wrong + tail) / modes.gaps).sum(axis=-1)
            summed += terms
        return total * (1.0 + summed * EPS)

    def settled(self, level: float, horizon: int, *, is_impact: bool) -> float | None:
        """The term from which on all are at most ``level``, or ``level`` times the largest one.

        NaN if that is not known of the terms up to twice the horizon, or it is later than the
        horizon; None where there are not enough terms in the head.
        """
        values = self.head[0, 0]
        # No less than 8 units of a value, here and of those from modes: comparisons may round.
        wrong = np.abs(values) * (4.0 * EPS) + _NARROW * np.abs(values).max()
        limit = level * (np.abs(values).max() if is_impact else 1.0)
        if self.modes is None:
            if np.any((np.abs(values) + wrong)[self.late :] > limit):
                return None
        else:
            most = 2 * horizon
            terms = self.modes.terms_above(limit, most)
            if terms > most:
                return nan
            more, error = self.modes.values(max(terms, 1))
            values, wrong = np.append(values, more), np.append(wrong, error)
        largest = np.abs(values).max() if is_impact else 1.0
        bound = arb(level) * (self._largest_ball(values, wrong) if is_impact else 1)
        doubt = np.abs(values) + wrong > level * (largest - wrong.max())
        for term in np.flatnonzero(doubt)[::-1].tolist():
            if not self._ball(term) <= bound:
                return float(term + 1) if term < horizon else nan
        return 0.0

    def _ball(self, term: int) -> "arb":
        count = self.head.shape[-1]
        if term < count:
            return abs(self.balls[term])
        assert self.modes is not None
        values = (residue * pole ** (term - count) for pole, residue in self.modes.balls)
        return abs(sum((value.real for value in values), arb(0)))

    def _largest_ball(self, values: np.ndarray, wrong: np.ndarray) -> "arb":
        size = np.abs(values)
        near = np.flatnonzero(size + wrong >= (size - wrong).max())
        largest = arb(0)
        for term in near.tolist():
            largest = largest.max(self._ball(term))
        return largest


def _mixed(rows: np.ndarray, columns: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Combinations of the series of all inputs: column, row, term."""
    return rows @ np.tensordot(columns, values, 1)


def _powers(numbers: np.ndarray, count: int) -> np.ndarray:
    powers = np.repeat(numbers[:, None], count, axis=1)
    powers[:, :1] = 1.0
    return np.cumprod(powers, axis=1)


Quotients = list[tuple[Any, list[Any]]]
"""Numerators over p(z), for each input: a factor, and what it multiplies for each series."""


class _WallPolynomials(NamedTuple):
    """The loop of one wall, or of two gains without a plant, in balls.

    p: p(z), the roots that are known told apart; whole: multiplied out.
    force: K Np Dv + B Nv Dp.
    """

    p: Factored
    whole: "arb_poly"
    force: Any = None
    parts: Any = None

    @classmethod
    def from_loop(
        cls, loop: LoopParameters, stiffness: float, damping: float
    ) -> "_WallPolynomials":
        parts = _Parts.from_loop(loop)
        p = parts.loop.triple.at(stiffness, damping)
        # An actuator's pole that is a zero of the device is no root of p, but of its states.
        if parts.hidden.degree:
            p = p.times(parts.hidden)
        p = p._replace(power=p.power + parts.degree - p.degree)
        return cls(p, p.polynomial(), parts.loop.wall(stiffness, damping).polynomial(), parts)

    def disturbed(self, causes: Causes) -> Quotients:
        """Numerators of states, acting and arriving force, for each cause of size 1.

        Friction: for each state of the device alone, from 1 at a sample on.
        """
        parts, z = self.parts, _z()
        denominator = parts.denominator
        series = [*parts.pull, denominator, z * denominator]
        factors = (-self.force, parts.memory)
        found = [(one, series) for one, cause in zip(factors, causes, strict=False) if cause]
        for column in parts.states if causes[2] else []:
            position = column[0] * self.force
            states = [
                (part * self.whole - one * position) // denominator
                for part, one in zip(column, parts.pull, strict=True)
            ]
            found.append((z, [*states, -position, -z * position]))
        return found

    def begun(self, *, is_impact: bool) -> Quotients:
        """The deviation of the position: of its final value, or after an impact.

        Of two gains without a plant, the motion after an impulse.
        """
        parts, z = self.parts, _z()
        if parts is None:
            return [(arb_poly([1]), [z ** self.whole.degree()])]
        if is_impact:
            return [(z, [parts.struck])]
        final = parts.pushed(1) / self.whole(1)
        return [(z, [(parts.pushed * (1 / final) - self.whole) // (z - 1)])]

    def responses(self, numerators: Quotients) -> WallResponses | None:
        """Responses by their modes; None where poles are not told apart, or not inside."""
        told = real_or_not(isolated_roots(self.p._replace(power=0)))
        if told is None:
            return None
        chosen = [(root, is_real) for root, is_real in told if is_real or root.imag > 0]
        start = 2 * self.whole.degree() + 2  # after which fast poles no longer count
        head = self._head(numerators, start)
        if head is None:
            return None
        slope = self.whole.derivative()
        moduli, gaps, balls = list[float](), list[float](), list[list[list[acb]]]()
        for root, is_real in chosen:
            gap = 1 - abs(root)
            if sign_of(gap) != 1 or not (abs(root) < 1e-40 or is_sharp(root)):
                return None
            moduli.append(_above(root))
            gaps.append(float(gap.lower()) / _UP)
            share = root ** (start - 1) * (1 if is_real else 2) / slope(root)
            factors = ((factor(root) * share, series) for factor, series in numerators)
            balls.append([[part(root) * factor for part in series] for factor, series in factors])
        shape = len(chosen), len(numerators), len(numerators[0][1])
        grid = np.moveaxis(np.array(balls, object).reshape(shape), 0, -1)
        residues = np.vectorize(complex, [complex])(grid)
        sizes, errors = (np.vectorize(_above, [float])(each) for each in (grid, grid - residues))
        if np.any(errors > 1e-12 * sizes.max(axis=-1, initial=0.0, keepdims=True)):
            return None
        roots = [root for root, _ in chosen]
        rounded = np.array(list(map(complex, roots))), residues
        bounds = sizes + UNDERFLOW, errors + UNDERFLOW, np.array(moduli), np.array(gaps)
        return WallResponses(
            *head, ModalTerms(*rounded, *bounds, list(zip(roots, grid[0, 0], strict=True)))
        )

    def by_powers(self, numerators: Quotients, terms: int) -> WallResponses | None:
        """Responses by x^m mod p, with that many terms before; None where m is too large."""
        power, count = _z() % self.whole, 1
        while not _size(power) < 1e-9:
            if count > _MOST_POWERS:
                return None
            power, count = power * power % self.whole, 2 * count
        late = max(terms, self.whole.degree() + 1)
        head = self._head(numerators, late + count)
        if head is None:
            return None
        size = _above(_size(power))
        return WallResponses(*head, None, late, size / (1.0 - size) * _UP)

    def _head(self, numerators: Quotients, terms: int) -> "tuple[np.ndarray, arb_poly] | None":
        """The first terms of quotients num/p in powers of 1/z, rounded, and the first in balls.

        None where the balls are wide.
        """
        inverse = arb_series(self.whole.coeffs()[::-1], terms).inv()
        quotients, length = [], self.whole.length()
        head = np.zeros((len(numerators), len(numerators[0][1]), terms))
        for place in np.ndindex(head.shape[:2]):
            factor, series = numerators[place[0]]
            rising = (factor * series[place[1]]).coeffs()
            above = arb_series([arb(0)] * (length - len(rising)) + rising[::-1], terms)
            quotient = above * inverse
            if quotient.prec < terms:  # a thread of a program has shortened all series
                return None
            balls = quotient.coeffs()
            quotients.append(arb_poly(balls))
            head[place][: len(balls)] = [float(ball) for ball in balls]
            widest = max((float(ball.rad()) for ball in balls), default=0.0)
            if widest > _NARROW * np.abs(head[place]).max():
                return None
        return head, quotients[0]


class _Parts(NamedTuple):
    """A loop without its wall, polynomials of z.

    degree: of p(z) with all powers of z that the sequences have.
    memory: Dp Dv.
    denominator: D(z) = det(z - F) of the states of ``equations``, F their transition in a sample.
    hidden: D over that of the loop.
    states: adj(z - F), by columns.
    pull: adj(z - F) (g_0 + g_1 z), of the force that acts at first, and of the one that arrives.
    struck, pushed: the position in the closed loop after an impact, and under a unit force of the
        hand from 0 on, times p(z)/z and p(z) (z - 1)/z.
    """

    loop: LoopFactors
    degree: int
    memory: "arb_poly"
    denominator: "arb_poly"
    hidden: Factored
    states: "list[list[arb_poly]]"
    pull: "list[arb_poly]"
    struck: "arb_poly"
    pushed: "arb_poly"

    @classmethod
    @remembered()
    def from_loop(cls, loop: LoopParameters) -> "_Parts":
        transition, newer, older, push, hit = _moves(loop)
        size = transition.nrows()
        denominator = transition.charpoly()
        one = arb_mat(size, size) + 1

        def after(vector: "list[arb]") -> "list[arb_poly]":
            return seen(one, transition, denominator, arb_mat([vector]).transpose())

        parts = ball_loop(loop)
        memory = parts.position[1].times(parts.velocity[1]).polynomial()
        waiting = int(loop.delay_samples) + 1
        free = memory.left_shift(waiting)
        return cls(
            parts,
            waiting + size + memory.degree(),
            memory,
            denominator,
            Factored(denominator // parts.denominator.polynomial()),
            [after(row) for row in one.tolist()],
            [a + b.left_shift(1) for a, b in zip(after(older), after(newer), strict=True)],
            free * after(hit)[0],
            free * after(push)[0],
        )


def _moves(loop: LoopParameters) -> "tuple[arb_mat, list[arb], list[arb], list[arb], list[arb]]":
    """F, and what the states become by the newer and the older force, a push and an impact."""
    device, period, fraction = loop.held_device, float(loop.sample_time), loop.delay_samples % 1.0
    if own := in_steps(device):
        if loop.velocity and behind_measured(loop.velocity) is not None:
            raise ValueError(
                f"the velocity is that of the device ({device}); its motion is computed with an "
                "estimator from positions: give one, or ask for verdicts, poles and tune."
            )
        count = round(period / own.step)
        held, _ = held_steps(own)
        powers = (held**j for j in (count, count - round(fraction * count), 1))
        whole, late, one = (arb_mat(power).tolist() for power in powers)
    else:
        matrix, _, _ = equations(device, period)
        whole = matrix.exp().tolist()
        late = (matrix * (1 - arb(exact(fraction)))).exp().tolist()
    size = len(whole) - (1 if own else 2)
    hand = size if own else size + 1
    newer = [late[row][size] for row in range(size)]
    older = [whole[row][size] - newer[row] for row in range(size)]
    push = [whole[row][hand] for row in range(size)]
    hit = [row[hand] for row in one[:size]] if own else [*after_impact(device, period)]
    hit += [arb(0)] * (size - len(hit))  # of actuators
    return arb_mat([row[:size] for row in whole[:size]]), newer, older, push, hit


def _above(ball: "acb | arb") -> float:
    return float(ball.abs_upper()) * _UP


def _z() -> "arb_poly":
    return arb_poly([0, 1])


def _size(polynomial: "arb_poly") -> "arb":
    return sum(map(abs, polynomial.coeffs()), arb(0))


def disturbed_responses(
    loop: LoopParameters, stiffness: float, damping: float, causes: Causes
) -> WallResponses | None:
    """Responses of states and forces to disturbances of a stable wall; None if not proved.

    The inputs: an error of the read position at one sample, one of the force, and each of the
    device's states at a sample. The series: these states, the force that acts up to the fraction of
    the delay, and the one from then on.
    """
    ways = (
        lambda wall: wall.responses(wall.disturbed(causes)),
        lambda wall: wall.by_powers(wall.disturbed(causes), 1),
    )
    wall_at = partial(_wall_at, loop, stiffness, damping)
    return _of_wall(wall_at, (stiffness, damping), ways, nothing=None)


def settled_after(
    loop: LoopParameters,
    stiffness: float,
    damping: float,
    excitation: str,
    level: float,
    horizon: int,
) -> float:
    """The sample from which on a wall stays settled: infinite if unstable, NaN if not proved."""
    gains, is_impact = (stiffness, damping), excitation == "impact"
    wall_at = partial(_wall_at, loop, *gains)
    return _settled_after(wall_at, gains, level, horizon, is_impact=is_impact)


def motion_settled_after(
    triple: TripleAt, first: float, second: float, level: float, horizon: int
) -> float:
    """The same of a loop's motion from an impulse, z^n/p(z), beside its largest term."""

    def wall_at() -> _WallPolynomials:
        p = triple().at(first, second)
        return _WallPolynomials(p, p.polynomial())

    return _settled_after(wall_at, (first, second), level, horizon, is_impact=True)


def _settled_after(
    wall_at: "Callable[[], _WallPolynomials]",
    gains: tuple[float, float],
    level: float,
    horizon: int,
    *,
    is_impact: bool,
) -> float:
    def by_modes(wall: _WallPolynomials) -> float | None:
        found = wall.responses(wall.begun(is_impact=is_impact))
        return found and found.settled(level, horizon, is_impact=is_impact)

    def by_powers(wall: _WallPolynomials) -> float | None:
        terms, numerators = 64, wall.begun(is_impact=is_impact)
        while terms < _MOST_POWERS and (found := wall.by_powers(numerators, terms)) is not None:
            if (settled := found.settled(level, horizon, is_impact=is_impact)) is not None:
                return settled
            terms *= 4
        return None

    settled = _of_wall(wall_at, gains, (by_modes, by_powers), nothing=inf)
    return nan if settled is None else settled


def _wall_at(loop: LoopParameters, stiffness: float, damping: float) -> _WallPolynomials:
    if not (damping and stiffness):
        # The filter of a gain that is 0 has poles of its own, which may coincide.
        kept = loop.velocity if damping else None, loop.position if stiffness else None
        loop = replace(loop, velocity=kept[0], position=kept[1])
    return _WallPolynomials.from_loop(loop, stiffness, damping)


def _of_wall(
    wall_at: "Callable[[], _WallPolynomials]",
    gains: tuple[float, float],
    ways: "Iterable[Callable[[_WallPolynomials], Answer | None]]",
    nothing: Answer,
) -> Answer | None:
    """The answer of the first way that has one; ``nothing`` for an unstable wall."""
    if not isfinite(sum(gains)):
        return None  # as where JAX traced the numbers, so that nobody checked them

    def question(way: "Callable[[_WallPolynomials], Answer | None]") -> tuple[Answer | None] | None:
        wall = wall_at()
        is_stable = are_inside(wall.p)
        answer = way(wall) if is_stable else nothing
        return None if is_stable is None or (is_stable and answer is None) else (answer,)

    answers = (decided(partial(question, way)) for way in ways)
    (found,) = next(filter(None, answers), (None,))
    return found
