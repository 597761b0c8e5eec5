"""The points of a grid as they were given, in groups of one form of p(z)."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Int64

from jaxstab.arrays import Numbers, tree_map
from jaxstab.model import TracedDelay

Values = np.ndarray[Any, np.dtype[Any]]


class Form(NamedTuple):
    """What sets the form of p(z)."""

    whole_delay: int
    is_fractional: bool

    @classmethod
    def of(cls, delay: Numbers | TracedDelay) -> "Form":
        """Return the form for one delay in samples; a fraction that is traced may be any."""
        if isinstance(delay, TracedDelay):
            return cls(delay.whole, True)
        number = np.asarray(delay, np.float64).item()
        return cls(int(number), number % 1.0 > 0.0)

    @property
    def degree(self) -> int:
        """The degree of p(z) without filters."""
        return self.whole_delay + 3 + self.is_fractional


class Points(NamedTuple):
    """The five parameters of a grid, as they were given: they broadcast."""

    alpha: Values
    beta: Values
    gamma: Values
    delta: Values
    delay: Values

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape to which they broadcast."""
        return np.broadcast_shapes(*(values.shape for values in self))

    def groups(
        self, chosen: Bool[np.ndarray, "*grid"]
    ) -> list[tuple[Form, Int64[np.ndarray, " point"]]]:
        """Return the form of p(z) and the flat indices of each group of chosen points."""
        twice = np.broadcast_to(np.floor(self.delay) + np.ceil(self.delay), chosen.shape)
        return [
            (Form.of(one / 2.0), np.flatnonzero(chosen & (twice == one)))
            for one in np.unique(twice[chosen]).tolist()
        ]


def gathered(values: Any, shape: tuple[int, ...], indices: Int64[np.ndarray, " point"]) -> Any:
    """Return arrays that broadcast to a grid, at flat indices of it."""
    index = np.unravel_index(indices, shape or (1,))
    return tree_map(lambda value: np.broadcast_to(value, shape or (1,))[index], values)
