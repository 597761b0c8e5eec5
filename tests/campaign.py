"""How large the campaigns are: a tenth of their full size, or JAXSTAB_CAMPAIGN times that size."""

import os

_SHARE = float(os.environ.get("JAXSTAB_CAMPAIGN", "0.1"))


def many(full: int) -> int:
    """Return how many of a full campaign are tried, one at least."""
    return max(round(_SHARE * full), 1)
