"""What is left to the campaigns, and how large they are.

They have a tenth of their full size, or JAXSTAB_CAMPAIGN times that size. Where a tenth takes
minutes, a test names a smaller size for `.ci/run`.
"""

import os
from collections.abc import Iterable
from typing import Any

import pytest

_SHARE = os.environ.get("JAXSTAB_CAMPAIGN")


def many(full: int, small: int | None = None) -> int:
    """The number of tries of a full campaign, one at least: a tenth, or a small number."""
    if _SHARE is None and small is not None:
        return small
    return max(round(float(_SHARE or 0.1) * full), 1)


def some(cases: Iterable[Any], few: int) -> list[Any]:
    """Return all cases of a full campaign, and the first few of them for `.ci/run`."""
    return list(cases)[: None if _SHARE else few]


def first(cases: Iterable[Any], few: int) -> list[Any]:
    """Return all cases, of which the default tests try the first few.

    A tuple has the values of several parameters; one that is a value itself is given in a tuple.
    """
    values = [case if isinstance(case, tuple) else (case,) for case in cases]
    own = [pytest.param(*value) for value in values[:few]]
    return own + [pytest.param(*value, marks=pytest.mark.campaign) for value in values[few:]]
