"""Gains that an atlas lowers to walls that are proved stable; none is raised. No JAX."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.format import schema
from jaxstab.atlas.read.answer import Floats, Numbers, all_checked, check_inside
from jaxstab.atlas.read.limits import LimitTable
from jaxstab.atlas.read.shown import ShownAtlas
from jaxstab.conventions import STABLE, UNDECIDED
from jaxstab.numbers import checked_word

Outside = Literal["error", "undecided"]

_EPS = float(np.finfo(np.float64).eps)
_ASIDE = 2.0**-44  # of a beta: as far from the edge of its cell is an end of it
_BELOW = 2.0**-30  # of an alpha: so far above it a limit is looked for that grants it
_NONE = -1.0  # in place of an alpha


class ClampedGains(NamedTuple):
    """Walls that are proved stable, by an atlas, of gains no larger than those wanted.

    Attributes:
        alpha: wall stiffness K T^2/m.
        beta: wall damping B T/m.
        verdict: int8 codes of ``jaxstab.Verdict``: STABLE, or UNDECIDED where no wall of smaller
            gains is proved stable; both gains are 0 there.

    Example:
        >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
        >>> left = atlas.clamp(0.2, beta=0.5, gamma=0.0005, delta=0.01, delay=1.0)
        >>> print(f"{left.alpha:.4f} {left.beta:.4f}", jaxstab.Verdict(left.verdict).name)
        0.1486 0.4343 STABLE
    """

    alpha: Floats
    beta: Floats
    verdict: NDArray[np.int8]


class ClampsGains(ShownAtlas):
    """An atlas that lowers gains to what it proves stable."""

    def clamp(
        self,
        alpha: Numbers,
        beta: Numbers,
        *,
        gamma: Numbers,
        delta: Numbers,
        delay: Numbers,
        outside: Outside = "error",
    ) -> ClampedGains:
        """Lower gains to those of a wall that is proved stable; walls that are stay as they are.

        Gains are never raised. Where alpha is too large for beta, beta is lowered until alpha is
        granted; if no smaller beta grants it, the wall becomes the stiffest one that is found, at
        an edge of a cell of the atlas. ``jaxstab_clamp`` in C and Octave gives the same bits.

        Args:
            alpha: wall stiffness K T^2/m >= 0, also above those of the atlas; any shape, like all.
            beta: wall damping B T/m >= 0, also above those of the atlas.
            gamma: physical stiffness k T^2/m.
            delta: physical damping b T/m.
            delay: time delay t_d/T in samples.
            outside: "error" to refuse what is outside of the atlas, "undecided" to leave no gains.

        Raises:
            TypeError: an argument is not made of real numbers.
            ValueError: a value is NaN, infinite or, unless ``outside`` is "undecided", outside of
                the atlas; a gain is negative; or this holds no limits of alpha.

        Source: ``jaxstab.boxes.columns``.

        Example:
            >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
            >>> gains = atlas.clamp([0.05, 0.2], 0.3, gamma=0.0005, delta=0.01, delay=1.0)
            >>> gains.alpha.round(3).tolist(), gains.beta.round(3).tolist()
            ([0.05, 0.136], [0.3, 0.298])
        """
        checked_word("outside", outside, ("error", "undecided"))
        table: LimitTable | None = getattr(self, "_table", None)
        if table is None:
            raise ValueError(
                "this atlas holds no limits of alpha; build one with the product "
                f"{schema.ALPHA_LIMITS!r}."
            )
        points = np.broadcast_arrays(*all_checked((alpha, beta, gamma, delta, delay)))
        refuse_negative(alpha=points[0], beta=points[1])
        shape = points[0].shape
        inside = _inside(table, points, refuse=outside == "error")
        left = np.zeros((2, points[0].size))
        codes = np.full(points[0].size, UNDECIDED, np.int8)
        here = np.flatnonzero(inside)
        left[:, here] = clamped(table, *(point.reshape(-1)[here] for point in points))
        is_proved = left[0] != _NONE
        left[:, ~is_proved] = 0.0
        codes[inside & is_proved] = STABLE
        return ClampedGains(left[0].reshape(shape), left[1].reshape(shape), codes.reshape(shape))


def refuse_negative(**gains: Floats) -> None:
    """Raise ValueError for the first gain that is negative."""
    for name, values in gains.items():
        if np.any(values < 0.0):
            first = float(values[values < 0.0].flat[0])
            raise ValueError(f"{name} is {first!r}; give a gain >= 0 to clamp.")


def _inside(table: LimitTable, points: Sequence[Floats], *, refuse: bool) -> NDArray[np.bool_]:
    """Say which walls, of any size, are of the plants of a table, or refuse the first other."""
    wall, plant = points[:2], points[2:]
    inside, names = np.ones(wall[0].size, bool), ("gamma", "delta", "delay")
    for name, values, (low, high) in zip(names, plant, table.plants, strict=True):
        if refuse:
            check_inside(name, values, low, high)
        inside &= ((values >= low) & (values <= high)).reshape(-1)
    delay = plant[2].reshape(-1)
    inside &= table.delays.covers(delay)
    if refuse and not inside.all():
        raise ValueError(
            f"delay is {float(delay[~inside][0])!r}; this atlas has no limits there, between its "
            "delays."
        )
    cell = np.maximum(table.delays.of(delay), 0)
    for name, values in zip(("alpha", "beta"), wall, strict=True):
        least, _ = table.delays.walls(name, cell)
        if refuse:
            check_inside(name, values.reshape(-1), least, np.inf, delay)
        inside &= values.reshape(-1) >= least
    return inside


def clamped(
    table: LimitTable, alpha: Floats, beta: Floats, gamma: Floats, delta: Floats, delay: Floats
) -> Floats:
    """Return alphas and betas (2, point) of walls inside of a table, but for large gains.

    Alpha is -1 where nothing is proved. The cells along beta are passed downwards from that of each
    beta. Within one the limits are linear, so that the ends of a cell, and where the line between
    them meets the alpha, say what it grants.
    """
    cell = table.delays.of(delay)
    lowest, most = table.delays.walls("alpha", cell)
    wanted, highest = np.minimum(alpha, most), table.delays.walls("beta", cell)[1]
    high = np.where(beta > highest, highest * (1.0 - _ASIDE), beta)
    row = table.beta_cell(cell, high)
    best = np.stack([np.full(alpha.size, _NONE), np.zeros(alpha.size)])
    here = np.arange(alpha.size)
    while here.size:
        plant = gamma[here], delta[here], delay[here]
        edge = table.beta_edge(cell[here], row[here])
        low = np.minimum(np.maximum(edge, 0.0) * (1.0 + _ASIDE), high[here])
        limits = wanted[here], lowest[here], table
        at_high, above = proved_alpha(high[here], *plant, *limits)
        at_low, below = proved_alpha(low, *plant, *limits)
        better = at_high > best[0, here]
        best[:, here[better]] = at_high[better], high[here][better]
        better = at_low > best[0, here]
        best[:, here[better]] = at_low[better], low[better]
        crossed = np.flatnonzero((at_low == wanted[here]) & (at_high != wanted[here]))
        among = here[crossed]
        middle = _crossing(low[crossed], high[among], below[crossed], above[crossed], wanted[among])
        plant = gamma[among], delta[among], delay[among]
        granted, _ = proved_alpha(middle, *plant, wanted[among], lowest[among], table)
        is_granted = granted == wanted[among]
        best[1, among[is_granted]] = middle[is_granted]
        further = (best[0, here] != wanted[here]) & (row[here] > 0) & (edge > 0.0)
        here = here[further]
        high[here] = edge[further] * (1.0 - _ASIDE)
        row[here] -= 1
    return best


@np.errstate(invalid="ignore", divide="ignore", over="ignore")
def _crossing(low: Floats, high: Floats, below: Floats, above: Floats, alpha: Floats) -> Floats:
    """Return where a line from low to high has nearly come down to an alpha; low for nowhere."""
    share = (below - (alpha + _BELOW * alpha)) / (below - above)
    middle = low + share * (high - low)
    return np.asarray(np.where(middle > low, np.minimum(middle, high), low))


@np.errstate(invalid="ignore")  # infinite limits may have infinite errors
def proved_alpha(
    beta: Floats,
    gamma: Floats,
    delta: Floats,
    delay: Floats,
    wanted: Floats,
    lowest: Floats,
    table: LimitTable,
) -> tuple[Floats, Floats]:
    """Return the largest alphas up to wanted ones that are proved, -1 for none, and the limits."""
    at = table.limits(beta, gamma, delta, delay)
    top = at.upper - at.upper_error
    alpha = np.where(wanted < top, wanted, top - np.abs(top) * _EPS)
    holds = (alpha >= lowest) & (alpha >= 0.0) & (alpha < top)
    return np.where(holds & (alpha > at.lower + at.lower_error), alpha, _NONE), top
