"""How far a wall can be changed before it loses stability: in stiffness, damping or delay.

One quantity is changed, starting from a wall that is proved stable. Until the first root reaches
the unit circle no root can have crossed it, so the loop is proved stable that far (lemma B5 of
docs/proofs.md). The delay is changed continuously, through all fractions of a sample.
"""

from math import inf
from typing import Any, NamedTuple

from jaxtyping import Float64, Int8

from jaxstab.arrays import Array, Numbers, float_arrays, is_jax, namespace
from jaxstab.model import checked_delta, checked_gain, checked_gamma, require_x64
from jaxstab.model.filters import Filter, Velocity, known_filters
from jaxstab.model.loop import refuses_loops
from jaxstab.model.parameters import LONGEST_DELAY
from jaxstab.numbers import checked
from jaxstab.ranges.first_crossings import MOST_DELAY as MOST_DELAY
from jaxstab.ranges.first_crossings import WAYS, first_crossings
from jaxstab.ranges.shown import DIMENSIONLESS, IN_SI_UNITS, margins_text

_ROUNDING = 2.0**-52


class Margins(NamedTuple):
    """How much a wall may change; NaN throughout for a wall that is not proved stable.

    All numbers are proved: the wall stays stable that far. They fall short of the first root on the
    circle by at most about 1e-9 of the way there, or by what rounding hides: where |p(z)| somewhere
    on the circle is below about 1e-13 of its largest term, per sample of delay, it cannot be told
    from 0. With filters rounding hides about ten times as much. A few extra delays of tens of
    samples fall short by more, because the search is given up for a wall whose roots stay next to
    the circle at nearly all angles.
    The table rounds limits inwards, and prints 0 for one below 1e-9 of its interval, such as a
    least stiffness that the root at z = 1 sets.

    Attributes:
        verdict: certified codes of ``Verdict``.
        stiffness: the smallest and the largest K between which the wall stays stable at this B.
        damping: the smallest and the largest B between which it stays stable at this K.
        stiffness_gain: the factor by which K may be multiplied; infinite for K <= 0.
        damping_gain: the factor by which B may be multiplied; infinite for B <= 0.
        extra_delay: the time by which the delay may grow; infinite if no delay is too long, or none
            of up to 1024 further samples (MOST_DELAY).

    Example:
        >>> jaxstab.margins(0.1, 0.2, gamma=0.0, delta=0.015, delay=1.0)
        Margins: stable        least   largest  factor
        alpha                  0       0.11185  1.1185
        beta                   0.1689  0.6702   3.351
        extra delay (samples)          0.15444
    """

    verdict: Int8[Array, "*grid"]
    stiffness: Float64[Array, "*grid 2"]
    damping: Float64[Array, "*grid 2"]
    stiffness_gain: Float64[Array, "*grid"]
    damping_gain: Float64[Array, "*grid"]
    extra_delay: Float64[Array, "*grid"]

    def __repr__(self) -> str:
        """Return a table: a row for each quantity of one wall, or one for each of some walls."""
        return margins_text(self, DIMENSIONLESS)


class WallMargins(Margins):
    """Margins in SI units, with these units in their printed table."""

    def __repr__(self) -> str:
        """Return the table of ``Margins`` with units."""
        return margins_text(self, IN_SI_UNITS)


@refuses_loops("margins(K, B)")
def margins(
    alpha: Numbers,
    beta: Numbers,
    *,
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> Margins:
    """Return how far alpha, beta and delay may change, one at a time, before a loop is unstable.

    With JAX arrays the search is called back from JAX, so it works under jit and vmap. It is
    differentiable once in every argument, the delay too. Where two crossings come first at once,
    the derivative is that of one of them; it is NaN where the margin is infinite or the loop not
    stable.

    Args:
        alpha: wall stiffness K T^2/m, any shape; like all arguments it broadcasts.
        beta: wall damping B T/m.
        gamma: physical stiffness k T^2/m in [0, 1e4].
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, whole or fractional.
        velocity: the velocity estimator in units of one sample; None for the difference over one.
        position: the position filter in units of one sample; None for none.

    Returns:
        Margins: intervals of alpha and beta, and samples.

    Raises:
        ValueError: an argument is outside its range, infinite or NaN.
        TypeError: velocity or position is no estimator or filter, or JAX traces its parameters.
        RuntimeError: JAX arrays are given without x64.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) on the unit circle; lemmas B5 and B10 of
    docs/proofs.md.

    Example:
        >>> window = jaxstab.Velocity.difference(samples=20)
        >>> found = margins(0.003, 0.04, gamma=0.0, delta=0.001, delay=1.0, velocity=window)
        >>> float(found.stiffness_gain)
        2.7159...
    """
    filters = known_filters(velocity, position)
    values = (
        checked_gain("alpha", alpha),
        checked_gain("beta", beta),
        checked_gamma(gamma),
        checked_delta(delta),
        checked("delay", delay, 0.0, LONGEST_DELAY),
    )
    require_x64(*values)
    arrays = float_arrays(*values)
    xp = namespace(arrays)
    point: Array = xp.stack(xp.broadcast_arrays(*arrays), axis=-1)
    if is_jax(point):
        from jaxstab.ranges.margin_slopes import moving_steps

        code, steps = moving_steps(point, filters)
    else:
        rows: Array = first_crossings(point.reshape(-1, len(values)), filters)
        found = rows.reshape(*point.shape[:-1], rows.shape[-1])
        code, steps = found[..., 0], found[..., 1::2]
    return _margins(point, code.astype(xp.int8), steps)


def _margins(point: Array, code: Array, steps: Array) -> Margins:
    xp = namespace(point)
    ends = [_end(xp, point[..., axis], steps[..., way]) for way, (axis, _) in enumerate(WAYS[:-1])]
    alphas, betas = xp.stack(ends[:2], axis=-1), xp.stack(ends[2:], axis=-1)
    return Margins(
        code,
        alphas,
        betas,
        _factor(xp, alphas[..., 1], point[..., 0]),
        _factor(xp, betas[..., 1], point[..., 1]),
        steps[..., -1],
    )


def _end(xp: Any, gain: Array, step: Array) -> Array:
    """Return gain + step, but not a rounding error farther."""
    end = gain + step
    return xp.where(xp.isfinite(end), end - xp.sign(step) * _ROUNDING * abs(end), end)


def _factor(xp: Any, most: Array, gain: Array) -> Array:
    without = xp.where(xp.isnan(most), most, inf)
    is_positive = gain > 0.0
    return xp.where(is_positive, most / xp.where(is_positive, gain, 1.0), without)
