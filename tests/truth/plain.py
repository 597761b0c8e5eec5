"""Truths without balls: polynomials of loops in mpmath, the criterion of Jury in exact fractions.

A loop is drawn by ``random_loops``; its plant is the equations of motion in mpmath (``devices``),
its filters are difference equations in exact fractions (``filtered``)."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from fractions import Fraction
from functools import reduce
from itertools import combinations
from typing import NamedTuple

import numpy as np
from flint import fmpq_poly
from mpmath import mp, mpf

import jaxstab
from tests.truth import devices
from tests.truth.loop import evaluate
from tests.truth.random_loops import DeviceLoop, MassLoop

DIGITS = 120
_UNKNOWN = mpf(10) ** -60  # next to 1, a reflection coefficient tells nothing

Falling = list[mpf]  # coefficients, highest power first


def is_stable(falling: Sequence[Fraction | mpf], unknown: Fraction | mpf = 0) -> bool | None:
    """True if all roots lie inside the circle (Jury 1964), exactly where all numbers are fractions.

    None if the degree is less, or where a decision is closer than what is unknown.
    """
    rest = list(falling)
    if rest[0] == 0:
        return None
    while len(rest) > 1:
        k = rest[-1] / rest[0]
        if abs(abs(k) - 1) < unknown:
            return None
        if abs(k) >= 1:
            return False
        rest = [a - k * b for a, b in zip(rest[:-1], rest[:0:-1], strict=True)]
    return True


class Loop(NamedTuple):
    """One loop: as jaxstab is asked for it, and base, stiffness and damping in mpmath, in SI."""

    loop: jaxstab.HapticLoop
    base: Falling
    stiffness: Falling
    damping: Falling

    @classmethod
    def of(cls, drawn: MassLoop | DeviceLoop) -> "Loop":
        """A loop that was drawn; gains of one of one mass are alpha and beta."""
        if isinstance(drawn, MassLoop):
            gamma, delta, delay = drawn.plant
            system = devices.Mechanism([(mpf(1), mpf(delta), mpf(gamma))]).system()
        else:
            delay, system = drawn.device.delay, drawn.device.mechanism.system()
        return cls.from_parts(drawn.loop, system, delay, drawn.filters.truths)

    @classmethod
    def from_parts(
        cls,
        loop: jaxstab.HapticLoop,
        system: devices.System,
        delay: float,
        truths: tuple[tuple[fmpq_poly, fmpq_poly], tuple[fmpq_poly, fmpq_poly]],
    ) -> "Loop":
        """A loop with its device's equations of motion, and T V(z) and P(z) in fractions."""
        plant = devices.sampled(system, loop.sample_time, delay)
        with mp.workdps(DIGITS):
            (nv, dv), (np_, dp) = (tuple(map(_falling, pair)) for pair in truths)
            base = product(plant.denominator, dp, dv) + [mpf(0)] * plant.lag
            stiffness = product(plant.numerator, np_, dv)
            damping = [c / mpf(loop.sample_time) for c in product(plant.numerator, nv, dp)]
            size = len(base)
            parts = ([mpf(0)] * (size - len(p)) + p for p in (base, stiffness, damping))
            return cls(loop, *parts)

    def polynomial(self, stiffness: mpf | float, damping: mpf | float) -> Falling:
        """p(z) of a wall, without roots at 0."""
        with mp.workdps(DIGITS):
            k, b = mpf(stiffness), mpf(damping)
            falling = [x + k * y + b * z for x, y, z in zip(*self[1:], strict=True)]
            while falling[-1] == 0:
                falling.pop()
            return falling

    def is_stable(self, stiffness: mpf | float, damping: mpf | float) -> bool | None:
        """True if a wall is stable; None where 60 digits do not tell."""
        return is_stable_in_digits(self.polynomial(stiffness, damping))


def is_stable_in_digits(falling: Falling) -> bool | None:
    """The same as ``is_stable`` in 120 digits; None where a decision is closer than 1e-60."""
    with mp.workdps(DIGITS):
        return is_stable(falling, _UNKNOWN)


def radius(falling: Falling) -> mpf:
    """The largest modulus of a root, by Aberth's iteration from eigenvalues, in 60 digits."""
    with mp.workdps(60):
        return max(map(abs, _roots(falling)))


def outside(falling: Falling) -> int:
    """The number of roots outside the circle, by the roots themselves."""
    with mp.workdps(60):
        return sum(abs(root) > 1 for root in _roots(falling))


def stiffest_walls(loop: Loop, stiffness: float, damping: float) -> Iterator[tuple[mpf, mpf]]:
    """Walls next to a wall where K may be largest, in 60 digits, the likely ones first.

    A root is on the circle there, and its modulus does not change with B, or B is 0, or another
    root is on the circle too; or two roots are at 1, or at -1.
    """
    near = 1e-5
    with mp.workdps(DIGITS):
        roots, _ = _aberth(loop.polynomial(stiffness, damping))
        close = [z for z in roots if abs(abs(z) - 1) < near and mp.im(z) > -(near**4)]
        close.sort(key=lambda z: abs(abs(z) - 1))
    alone = [(z, None) for z in close]
    for one, other in [*alone[:1], *combinations(close, 2), *alone[1:]]:
        with suppress(ValueError, ZeroDivisionError):  # they do not meet
            yield _stiffest_at(loop, (stiffness, damping), one, other)
    for z in (mpf(1), mpf(-1)):
        with suppress(ZeroDivisionError):
            yield _stiffest_at_double(loop, z)


def _stiffest_at(
    loop: Loop, wall: tuple[float, float], one: mp.mpc, other: mp.mpc | None
) -> tuple[mpf, mpf]:
    nothing = 1e-14  # B that changes K by less is not changed
    with mp.workdps(DIGITS):
        k, b = map(mpf, wall)
        unit = b or k * mpf(loop.loop.sample_time)
        is_kept = abs(_beyond(loop, one, k, b)[1] * b) < nothing

        def conditions(x: mpf, y: mpf) -> list[mpf]:
            beyond, change = _beyond(loop, one, x * k, y * unit)
            if other is not None:
                return [beyond, _beyond(loop, other, x * k, y * unit)[0]]
            return [beyond, y - b / unit if is_kept else change * unit]

        x, y = mp.findroot(conditions, (mpf(1), b / unit), tol=1e-70, maxsteps=20)
        return x * k, y * unit


def _stiffest_at_double(loop: Loop, z: mpf) -> tuple[mpf, mpf]:
    with mp.workdps(DIGITS):
        base, k, b = ((evaluate(p, z), evaluate(_slopes(p), z)) for p in loop[1:])
        det = k[0] * b[1] - k[1] * b[0]
        return (base[1] * b[0] - base[0] * b[1]) / det, (k[1] * base[0] - k[0] * base[1]) / det


def _beyond(loop: Loop, root: mp.mpc, stiffness: mpf, damping: mpf) -> tuple[mpf, mpf]:
    """How far a root is from the circle, and by how much more it is for each unit of B."""
    base, k, b = loop[1:]
    falling = [x + stiffness * y + damping * z for x, y, z in zip(base, k, b, strict=True)]
    slopes = _slopes(falling)
    for _ in range(60):
        move = evaluate(falling, root) / evaluate(slopes, root)
        root -= move
        if abs(move) < mpf(10) ** -60:  # twice as many digits are right
            break
    moved = -evaluate(b, root) / evaluate(slopes, root)
    return abs(root) - 1, mp.re(mp.conj(root) * moved) / abs(root)


def _slopes(falling: Falling) -> Falling:
    return [c * (len(falling) - 1 - k) for k, c in enumerate(falling[:-1])]


def _roots(falling: Falling) -> list[mp.mpc]:
    roots, moved = _aberth(falling)
    if moved > mpf(10) ** -40:
        raise ArithmeticError("roots that coincide; take others")
    return roots


def _aberth(falling: Falling) -> tuple[list[mp.mpc], mpf]:
    """Roots by the simultaneous iteration of Aberth (1973), and how far they moved last."""
    guesses = np.roots(np.array([complex(c) for c in falling]))
    roots, slopes = [mp.mpc(complex(z)) for z in guesses], _slopes(falling)
    for _ in range(40):
        largest = mpf(0)
        for index, z in enumerate(roots):
            ratio = evaluate(falling, z) / evaluate(slopes, z)
            pull = sum(1 / (z - other) for k, other in enumerate(roots) if k != index)
            move = ratio / (1 - ratio * pull)
            roots[index] = z - move
            largest = max(largest, abs(move))
        if largest < mpf(10) ** -40:
            break
    return roots, largest


def product(*factors: Falling) -> Falling:
    """The product of polynomials."""
    return list(reduce(np.convolve, (np.array(factor, dtype=object) for factor in factors)))


def _falling(polynomial: fmpq_poly) -> Falling:
    return [mpf(int(c.p)) / int(c.q) for c in polynomial.coeffs()[::-1]]
