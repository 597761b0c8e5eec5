"""C6. Passive walls of every estimator, filter and delay, whole or not, as one cosine sum.

The force K P(z) + B V(z) = H(z) times the position, H of stable filters with V(1) = 0 and
P(1) > 0, comes n + f samples late, 0 <= f < 1, and is held for a period T. A damper b > 0 is at
the point where it acts. Together they draw no energy from any motion of the hand, whatever it does
between the samples, if and only if K >= 0 and for all angles (lemma C6)

    b >= R + f (1 - f) T^2 |H|^2/(4 b),
    R = T/(2 - 2 cos(theta)) Re((1 - 1/z) z^-n (1 - f + f/z) H),    z = e^(i theta).

The mass, and whatever is passive behind it, plays no part. With H = N/D all is multiplied by
|D|^2. Nothing is divided: in Re((1 - 1/z) z^k)/(2 - 2 cos) is -D_(k-1)/2 for k >= 1 and D_(-k)/2
for k <= 0, D_j = 1 + 2 cos(theta) + ... + 2 cos(j theta), so that the left side less the right one
is a cosine sum, which is positive (``circle``) or not proved to be.

For one angle the condition describes a convex set of (K, B), which grows in proportion to b: the
larger eigenvalue of a Hermitian form is at most b. ``needed`` has that eigenvalue, in float64.
"""

from collections.abc import Callable
from functools import cached_property
from math import floor, pi
from typing import Any

import numpy as np
from flint import arb, arb_poly
from jaxtyping import Float64

from jaxstab.exact.circle import is_positive
from jaxstab.exact.floats import FloatValues
from jaxstab.exact.margins import squared
from jaxstab.exact.roots import are_inside, sign_of
from jaxstab.model.balls import Factored, LoopFactors
from jaxstab.model.device.parts import FIRST_BITS, decided, working_precision

Angles = Float64[np.ndarray, " angle"]


def are_covered(own: LoopFactors) -> bool | None:
    """True if both filters are stable, V(1) = 0 and P(1) > 0; None where balls do not tell."""
    (above, below), (velocity, _) = own.position, own.velocity
    if not velocity.at_one:
        return False
    is_stable = are_inside(_below(own))
    sign = sign_of(above.at_end(1)) * sign_of(below.at_end(1))
    return None if is_stable is None or not sign else bool(is_stable and sign > 0)


def _below(own: LoopFactors) -> Factored:
    """The denominator of H."""
    return own.position[1].times(own.velocity[1])


class Wall:
    """A wall behind its filters, a delay and a hold, beside a damper.

    Args:
        factors: makes the filters P and V of a loop, in balls of the precision that is set.
        delay: in samples.
        period: T in s.
        damper: b in N s/m, > 0.
    """

    def __init__(
        self, factors: Callable[[], LoopFactors], delay: float, period: float, damper: float
    ) -> None:
        self.factors, self.delay, self.period, self.damper = factors, delay, period, damper

    def is_passive(self, stiffness: float, damping: float) -> bool | None:
        """True if the wall (K, B) is proved passive, False if not; None where it is not told."""
        if stiffness < 0.0:
            return False
        if stiffness == damping == 0.0 or self.damper == 0.0:
            return stiffness == damping == 0.0  # the mean of R is T K P(1)/2, so that some R > 0

        def answer() -> bool | None:
            own = self.factors()
            return is_positive(self._cosines(own.wall(stiffness, damping), _below(own)))

        return decided(answer)

    def _cosines(self, above: Factored, below: Factored) -> list[arb]:
        """The damper times |D|^2, less what the damper has to take times |D|^2, as a cosine sum."""
        whole, period = floor(self.delay), arb(self.period)
        late = arb(self.delay) - whole
        n, d = above.polynomial(), below.polynomial()
        late_force = n * arb_poly(d.coeffs()[::-1]) * arb_poly([late, 1 - late])
        shift = whole + 1 + int(d.degree())
        orders = [k - shift for k in range(len(late_force.coeffs()))]
        kernels = [arb(0)] * (max(map(abs, orders)) + 1)  # by the orders of Dirichlet's
        for order, c in zip(orders, late_force.coeffs(), strict=True):
            kernels[max(order - 1, -order)] += -c if order >= 1 else c
        size = max(len(kernels), d.length(), n.length())
        total, tail = [arb(0)] * size, arb(0)
        for order in reversed(range(len(kernels))):
            tail += kernels[order]
            total[order] -= tail * period / (1 if order else 2)
        fold = period**2 * late * (1 - late) / (4 * arb(self.damper))
        for weight, side in ((arb(self.damper), below), (-fold, above)):
            for lag, c in enumerate(squared(side)):
                total[lag] += weight * c * (2 if lag else 1)
        return total

    # What follows suggests.

    @cached_property
    def _values(self) -> list[FloatValues]:
        with working_precision(FIRST_BITS):
            own = self.factors()
            return [FloatValues(side) for side in (*own.position, *own.velocity)]

    @cached_property
    def angles(self) -> Angles:
        """Angles in (0, pi], of which some are next to the poles of the filters."""
        terms = 16 * (floor(self.delay) + 2 + sum(len(side.plain) for side in self._values))
        found = [np.linspace(1e-9, pi, terms), np.geomspace(1e-6, 1e-2, 25)]
        found += [own for side in self._values for own in side.angles()]
        every = np.unique(np.concatenate(found))
        return every[(every > 0.0) & (every <= pi)]

    def parts(self, theta: Angles) -> tuple[Any, ...]:
        """At angles: what K and B add to R, and P and V."""
        whole, half = floor(self.delay), 0.5 * theta
        late, z = self.delay - whole, np.exp(1j * theta)
        shape = np.shape(theta)
        sides = [side(np.ravel(theta)).reshape(shape) for side in self._values]
        p, v = sides[0] / sides[1], sides[2] / sides[3]
        lag = 0.5j * self.period * np.exp(-1j * (half + whole * theta)) / np.sin(half)
        lag = lag * (1.0 - late + late / z)
        return (lag * p).real, (lag * v).real, p, v

    def needed(self, walls: Any, parts: tuple[Any, ...]) -> np.ndarray:
        """The damping that walls (K, B) need at angles, of which ``parts`` are those."""
        late = self.delay - floor(self.delay)
        of_stiffness, of_damping, p, v = parts
        real = walls[0] * of_stiffness + walls[1] * of_damping
        size = self.period * np.abs(walls[0] * p + walls[1] * v)
        need: np.ndarray = 0.5 * (real + np.sqrt(real**2 + late * (1.0 - late) * size**2))
        return need
