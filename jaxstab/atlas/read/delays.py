"""The cells of delays of an atlas: which one holds a delay, and how far it reaches. NumPy alone."""

from bisect import bisect_right

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.format.schema import WHOLE_ALPHA, WHOLE_BOTH

Floats = NDArray[np.float64]
Integers = NDArray[np.intp]
Range = tuple[float, float]

_MOST_STEPS = 2**12


class DelayCells:
    """The cells of all delays, ascending.

    Args:
        ends: (delay_cell, 6), the lowest and the highest delay, alpha and beta of cells.
        whole: (delay_cell,), which axes hold the whole stable set (``schema.LIMIT_WHOLE``).
    """

    def __init__(self, ends: Floats, whole: NDArray[np.int32]) -> None:
        self._whole = whole
        lowest, highest = np.ascontiguousarray(ends.T[::2]), np.ascontiguousarray(ends.T[1::2])
        self.ends = dict(
            zip(("delay", "alpha", "beta"), zip(lowest, highest, strict=True), strict=True)
        )
        """The lowest and the highest delay, alpha and beta of the cells."""
        self._early, self._late = self.ends["delay"]
        self._are_joined = np.array_equal(self._late[:-1], self._early[1:])
        self._begins = np.append(self._early, np.inf)
        self._per_delay, self._counts = _steps(self._early)
        self._early_list = self._early.tolist()
        self.span: Range = float(self._early[0]), float(self._late[-1])

    def of(self, delay: Floats) -> Integers:
        """Return the numbers of the last cells that begin at delays or before; -1 for none."""
        if not self._counts.size:
            return np.asarray(np.searchsorted(self._early, delay, "right") - 1)
        place = np.clip((delay - self.span[0]) * self._per_delay, 0.0, self._counts.size - 1.0)
        count = self._counts.take(place.astype(np.intp))
        count += delay >= self._begins.take(count)
        count -= 1
        return np.asarray(count)

    def of_one(self, delay: float) -> int:
        """Return the number of the last cell that begins at a delay or before; -1 for none."""
        return bisect_right(self._early_list, delay) - 1

    def covers(self, delay: Floats) -> NDArray[np.bool_]:
        """Say which delays are in a cell."""
        cell = self.of(delay)
        return np.asarray((cell >= 0) & (delay <= self._late.take(cell)))

    def walls(self, name: str, cell: Integers) -> tuple[Floats, Floats]:
        """Return the lowest and the highest alpha, or beta, of cells."""
        least, most = self.ends[name]
        return np.asarray(least.take(cell)), np.asarray(most.take(cell))

    def beyond(self, cell: Integers, alpha: Floats, beta: Floats) -> NDArray[np.bool_]:
        """Say which walls are beyond axes of cells that hold the whole stable set: unstable."""
        inside = []
        for name, values in (("alpha", alpha), ("beta", beta)):
            least, most = self.walls(name, cell)
            inside.append((values >= least) & (values <= most))
        whole = self._whole.take(cell)
        is_beyond = ((whole >= WHOLE_ALPHA) & ~inside[0] & inside[1]) | (
            (whole == WHOLE_BOTH) & ~inside[1]
        )
        return np.asarray(is_beyond)

    def hold(self, cell: Integers, delay: Floats, **walls: Floats) -> bool:
        """Whether these cells reach to delays that they begin before, and to alphas or betas."""
        inside = self._are_joined or delay <= self._late.take(cell)
        for name, values in walls.items():
            least, most = self.walls(name, cell)
            inside = inside & (values >= least) & (values <= most)
        return bool(np.all(inside))


def _steps(early: Floats) -> tuple[float, Integers]:
    """Return how many even steps there are to a delay, and how many cells begin before each step.

    A step is at most half as long as a cell, and what begins in its last quarter counts for the
    next one. So no more than one cell begins from there to the end of a step, whatever is rounded.
    Without steps cells are so short that they are searched for.
    """
    width = float(early[-1] - early[0])
    if not width:
        return 0.0, np.zeros(1, np.intp)
    count = np.ceil(2.0 * width / np.diff(early).min())
    if count > _MOST_STEPS:
        return 0.0, np.zeros(0, np.intp)
    begins = early[0] + width * (np.arange(count + 1.0) - 0.25) / count
    return float(count / width), np.searchsorted(early, begins, "right")
