"""What is known about a stable region."""

from jaxstab.conventions import Status


class RegionStatus(Status):
    """What is known of a stable region.

    COMPLETE: the pieces that were found close to loops. EMPTY: the scan found none.
    UNRESOLVED: the pieces do not close, more are there than arrays hold, or, of loops with filters,
    a proved verdict says otherwise. Such a region claims nothing: it has no points, its numbers are
    NaN, ``contains`` is False everywhere; that does not mean that points are unstable.

    Example:
        >>> jaxstab.RegionStatus(2).words
        'the boundary was not resolved: nothing is claimed'
    """

    COMPLETE = 0, "the boundary closes to loops"
    EMPTY = 1, "no (alpha, beta) is stable"
    UNRESOLVED = 2, "the boundary was not resolved: nothing is claimed"
