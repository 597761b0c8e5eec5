"""Intervals of theta, each for a box of hands, and parts of them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

Patch = Float64[np.ndarray, " patch"]
Box = Int64[np.ndarray, " patch"]


class Intervals(NamedTuple):
    """Intervals of theta, each for a box of hands."""

    box: Box
    first: Patch
    last: Patch

    def some(self, which: Bool[np.ndarray, " patch"] | Box | slice) -> "Intervals":
        """Return some of them."""
        return Intervals(self.box[which], self.first[which], self.last[which])

    def parts(self, halvings: Box) -> tuple[Box, "Intervals"]:
        """Return the equal parts after so many halvings, but none for 0, and whose part each is."""
        count = np.where(halvings > 0, 1 << halvings, 0)
        owner = np.repeat(np.arange(count.size), count)
        number = np.arange(owner.size) - np.repeat(np.cumsum(count) - count, count)
        whole, counts = self.some(owner), count[owner]

        def edge(number: Box) -> Patch:  # neighbours have the same one
            inside = whole.first + (whole.last - whole.first) * (number / counts)
            return np.where(number == counts, whole.last, inside)

        return owner, Intervals(whole.box, edge(number), edge(number + 1))
