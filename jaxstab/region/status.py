"""What is known about a stable region."""

from jaxstab.conventions import Status


class RegionStatus(Status):
    """What is known of a stable region.

    COMPLETE: the pieces that were found join up to closed loops. EMPTY: the scan found no piece; a
    root on the circle that walls move by rounding alone may count as one that stays there (seen:
    undamped hands at an odd multiple of the Nyquist frequency, gamma up to 6e-14 of itself beside
    it). UNRESOLVED: the pieces do not join up, there are more of them than the arrays hold or, for
    a loop with filters, they fail the audit: a proved verdict contradicts them or, with an undamped
    mode, no verdict decides. Such a region claims nothing: it has no points, its numbers are NaN
    and ``contains`` is False everywhere, which does not mean that the points are unstable.

    Example:
        >>> jaxstab.RegionStatus(2).words
        'the boundary was not resolved: nothing is claimed'
    """

    COMPLETE = 0, "the boundary closes to loops"
    EMPTY = 1, "no (alpha, beta) is stable"
    UNRESOLVED = 2, "the boundary was not resolved: nothing is claimed"
