"""Questions to an atlas, checked, and its answers. No JAX."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jaxstab.conventions import AXES, NOT_COMPUTED, UNDECIDED, Status
from jaxstab.numbers import checked

Floats = NDArray[np.float64]
Numbers = ArrayLike | float | int


class QueryStatus(Status):
    """How an atlas knows what it answers for a point.

    Example:
        >>> [status.name for status in jaxstab.QueryStatus]
        ['NODE', 'CELL', 'UNDECIDED_CELL', 'BETWEEN_DELAYS', 'OUTSIDE', 'EXACT']
    """

    NODE = 1, "a node: the verdict, if any, is that of this very point"
    CELL = 2, "between nodes: the verdict is proved for a cell or column around the point"
    UNDECIDED_CELL = 3, "between nodes: no verdict is proved"
    BETWEEN_DELAYS = 4, "between two delays of an atlas that says nothing there"
    OUTSIDE = 5, "outside of the atlas: it says nothing here"
    EXACT = 6, "not decided by the atlas: the verdict was computed for this very point"


@dataclass(frozen=True)
class AtlasAnswer:
    """What an atlas says about points; four arrays of the broadcast shape of the query.

    Attributes:
        verdict: int8 codes of ``jaxstab.Verdict``. STABLE and UNSTABLE are proved; UNDECIDED where
            the atlas cannot decide; NOT_COMPUTED if it holds no verdicts.
        spectral_radius: the middle of the interval in which it is proved to be; NaN where the
            atlas knows none.
        radius_error: proved bound of the error of ``spectral_radius``; infinite without one.
        status: int8 codes of ``QueryStatus``: how this is known.

    Example:
        >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
        >>> answer = atlas.query([0.05, 0.18], 0.3, gamma=0.0005, delta=0.01, delay=1.0)
        >>> [jaxstab.QueryStatus(int(code)).name for code in answer.status]
        ['CELL', 'CELL']
    """

    verdict: NDArray[np.int8]
    spectral_radius: Floats
    radius_error: Floats
    status: NDArray[np.int8]

    def reshaped(self, shape: tuple[int, ...]) -> "AtlasAnswer":
        """Return the same answer with arrays of another shape."""
        return AtlasAnswer(
            self.verdict.reshape(shape),
            self.spectral_radius.reshape(shape),
            self.radius_error.reshape(shape),
            self.status.reshape(shape),
        )


def no_answer(size: int, *, has_verdicts: bool) -> AtlasAnswer:
    """Return an answer that says nothing yet."""
    return AtlasAnswer(
        verdict=np.full(size, UNDECIDED if has_verdicts else NOT_COMPUTED, np.int8),
        spectral_radius=np.full(size, np.nan),
        radius_error=np.full(size, np.inf),
        status=np.full(size, QueryStatus.BETWEEN_DELAYS, np.int8),
    )


def all_checked(values: Sequence[Numbers], names: Sequence[str] = AXES) -> list[Floats]:
    """Return real, finite numbers, or raise TypeError or ValueError for the first others."""
    return [np.asarray(checked(*pair), np.float64) for pair in zip(names, values, strict=False)]


def check_inside(
    name: str, values: Floats, low: Floats | float, high: Floats | float, at: Floats | None = None
) -> None:
    """Raise ValueError for the first value beyond the ends of an atlas, perhaps at some delays."""
    beyond = np.flatnonzero(~((values >= low) & (values <= high)))
    if beyond.size:
        first, least, most = (
            float(np.broadcast_to(v, values.shape).flat[beyond[0]]) for v in (values, low, high)
        )
        where = "" if at is None else f" at delay {float(at.flat[beyond[0]]):g}"
        raise ValueError(
            f"{name} is {first!r}, and this atlas reaches from {least!r} to {most!r}{where}; "
            "ask inside of it, or set outside to 'undecided'."
        )


def checked_range(name: str, ends: Any) -> Floats:
    """Return the lowest and the highest value of a range, or raise TypeError or ValueError."""
    values = np.asarray(checked(name, ends), np.float64)
    if values.shape != (2,):
        raise TypeError(f"{name} is {ends!r}; give its lowest and its highest value.")
    if values[0] > values[1]:
        raise ValueError(f"{name} is {ends!r}; give its lowest and its highest value.")
    return values


def settle(where: Mapping[str, Floats], answer: AtlasAnswer, filters: Mapping[str, Any]) -> None:
    """Compute what the atlas left open inside of it; the filters are keywords of ``verdict``."""
    is_open = (answer.verdict == UNDECIDED) & (answer.status != QueryStatus.OUTSIDE)
    left = np.flatnonzero(is_open)
    if left.size:
        # By name at run time, so that reading an atlas imports no JAX.
        verdict: Callable[..., NDArray[np.int8]] = import_module("jaxstab.point").verdict
        points = {name: where[name][left] for name in AXES}
        answer.verdict[left] = np.asarray(verdict(**points, resolve="exact", **filters))
        answer.status[left] = QueryStatus.EXACT
