"""What is known about the best gains."""

from typing import NamedTuple

from jaxtyping import Float64, Int8

from jaxstab.arrays import Array
from jaxstab.conventions import Status


class TuningStatus(Status):
    """How the best gains are known; small integers, so that arrays store int8.

    None of them proves that no other gains are better. With filters the stable set may have several
    components: the search covers the one that holds small positive gains, which is reached by
    turning gains up from 0, and other components only where the status says so.

    Example:
        >>> jaxstab.TuningStatus(1).words
        'the best found: a triple real pole, solved for to full precision'
    """

    NOT_COMPUTED = 0, "not computed"
    TRIPLE_ROOT = 1, "the best found: a triple real pole, solved for to full precision"
    DOUBLE_PAIR = 2, "the best found: a double pair of poles, solved for to full precision"
    SCANNED = 3, "the best found: a point of a scan, of which 0.01 % may be missing"
    NO_STABLE_GAINS = 4, "no gains found that make the loop stable"
    ISLAND = 5, "the best found, of a scan: in an island, for small gains are not stable"
    ANY_COMPONENT = 6, "the best found, of a scan: perhaps in an island, the region is unresolved"
    NOT_CALM = 7, "no gains found that the encoder drives no further than the limit"


class OptimalGains(NamedTuple):
    """The best gains, what they achieve (a radius, or samples) and how they are known.

    Example:
        >>> best = jaxstab.minimize_radius(gamma=0.0, delta=0.0, delay=0.0)
        >>> round(float(best.value), 9)  # 4^(1/3) - 1
        0.587401052
    """

    alpha: Float64[Array, "*grid"]
    beta: Float64[Array, "*grid"]
    value: Float64[Array, "*grid"]
    status: Int8[Array, "*grid"]
