"""Passive walls of the difference over one sample, in the paper's numbers alpha and beta.

A passive wall may be touched by any passive hand, whatever the mass and stiffness (lemma C6, of
``exact.passive``). Of whole delays it is Colgate's condition, the paper's (28) at d = 0; Colgate's
formula with a fractional delay errs to either side.
"""

from jaxstab.exact.passive import Wall
from jaxstab.model import checked_delay, checked_delta
from jaxstab.model.balls import Factored, LoopFactors, SampledDevice
from jaxstab.model.device.parts import flint
from jaxstab.model.filters import NO_FILTERS
from jaxstab.numbers import checked_number, require_together
from jaxstab.region.passive import PassiveRegion, passive_region_of


def passive_region(
    *, delta: int | float, delay: int | float = 0.0, tolerance: int | float = 1e-4
) -> PassiveRegion:
    """The set of walls that are passive whatever the mass, stiffness and hand.

    A passive wall is stable with every passive environment, so the region lies in every robustly
    stable region of this damping and delay.

    Args:
        delta, delay: see ``jaxstab.conventions``.
        tolerance: the bulge of the region beyond the chords of its outline, times delta; at least
            1e-8.

    Raises: see ``jaxstab.conventions``; TypeError also for an array.

    Example:
        >>> region = passive_region(delta=0.7)
        >>> region.contains([1.3, 1.5], 0.0).tolist()
        [True, False]

    Source: eq. (28) of Hulin, Preusche, Hirzinger (2008) at d = 0; Colgate and Schenkel (1997) for
    whole delays; for fractional ones the Hermitian form of lemma C6 in docs/proofs.md.
    """
    require_together(delta=delta, delay=delay)
    delta = checked_number("delta", checked_delta(delta))
    delay = checked_number("delay", checked_delay(delay))
    tolerance = checked_number("tolerance", tolerance, 1e-8)
    return passive_region_of(Wall(_difference, delay, 1.0, delta), tolerance)


def _difference() -> LoopFactors:
    """The factors of the wall alone: the position, and its difference over one sample."""
    one = Factored(flint.arb_poly([1]))
    return LoopFactors.from_plant(SampledDevice(one, one, 0), 1.0, NO_FILTERS)
