"""Resolutions of one range beside each other: what each gives and what it takes, as a table."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isnan

from jaxstab.atlas.format.spec import AtlasSpec
from jaxstab.atlas.write.sampled import Measured

_COUNTS = {
    "alpha": "alpha",
    "beta": "beta",
    "gamma": "gamma",
    "delta": "delta",
    "limit_cells": "limits",
    "delay_cells": "delays",
}
_WORDS = (
    "limits: 95 % of the proved errors of the upper limit of alpha are below this, over the "
    "largest stable alpha at their delay",
    "undecided: share of the range without a proved verdict",
    "radius: half of the proved errors of stable loops are below this",
    "Counts are nodes along alpha and beta, cells along gamma and delta, limit_cells and "
    "delay_cells of the limits. +- is the standard error of a sample.",
)


@dataclass(frozen=True)
class Resolution:
    """What one resolution of a range gives and takes, by a sample of its cells.

    Attributes:
        spec: the specification.
        counts: nodes along alpha and beta, cells along gamma and delta, and the ``limit_cells``
            and ``delay_cells`` of the limits of alpha.
        limit_error: bound that 95 % of the upper limits of alpha keep, over the largest stable
            alpha at their delay; infinite where less than 95 % have one, NaN without limits.
        undecided: share of the range that is undecided; NaN without verdicts.
        radius_error: bound that half of the spectral radii of stable loops keep, NaN without radii.
        query_seconds: of CPU time of a verdict, asked for many at once.
        seconds: of CPU time of the build on this machine.
        size: of the file in bytes.

    Each of the three errors is a pair: the value and its standard error.

    Example:
        >>> hand = {"gamma": (0.0,), "delta": (0.01,), "delay": (1.0,)}
        >>> spec = jaxstab.AtlasSpec(**hand, products=("alpha_limits",))
        >>> given = jaxstab.plan_resolution(spec, size=50_000).given
        >>> given.counts["limit_cells"]
        256
    """

    spec: AtlasSpec
    counts: Mapping[str, int]
    limit_error: Measured
    undecided: Measured
    radius_error: Measured
    query_seconds: float
    seconds: float
    size: float


@dataclass(frozen=True)
class ResolutionPlan:
    """Resolutions of one range, and the one that a wish needs; ``plan_resolution`` makes it.

    Attributes:
        wish: what was asked for, such as "accuracy 0.01".
        rows: from the smallest file to the largest.
        given: which of them is the specification that was given.
        chosen: which of them meets the wish.

    Example:
        >>> hand = {"gamma": (0.0,), "delta": (0.01,), "delay": (1.0,)}
        >>> spec = jaxstab.AtlasSpec(**hand, products=("alpha_limits",))
        >>> plan = jaxstab.plan_resolution(spec, accuracy=0.01)
        >>> plan.chosen.limit_error.value < 0.01
        True
        >>> plan.spec.limit_cells < spec.limit_cells
        True
    """

    wish: str
    rows: tuple[Resolution, ...]
    given: Resolution
    chosen: Resolution

    @property
    def spec(self) -> AtlasSpec:
        """The specification that meets the wish."""
        return self.chosen.spec

    def __str__(self) -> str:
        heading = [*_COUNTS.values(), "limits", "undecided", "radius", "MB", "CPU s", "ns a query"]
        table = [[*heading, ""], *(self._cells(row) for row in self.rows)]
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        lines = [
            "  ".join(f"{cell:>{width}}" for cell, width in zip(row, widths, strict=True)).rstrip()
            for row in table
        ]
        return "\n".join([*lines, "", *_WORDS])

    def _cells(self, row: Resolution) -> list[str]:
        notes = {id(self.given): "as given", id(self.chosen): f"meets {self.wish}"}
        return [
            *(str(row.counts[name] or "-") for name in _COUNTS),
            *map(_words, (row.limit_error, row.undecided, row.radius_error)),
            f"{row.size / 1e6:.3g}",
            f"{row.seconds:.3g}",
            "-" if isnan(row.query_seconds) else f"{row.query_seconds * 1e9:.0f}",
            notes.get(id(row), ""),
        ]


def _words(measured: Measured) -> str:
    value, spread = measured
    if isnan(value):
        return "-"
    return f"{value:.2g} +- {spread:.1g}" if value < float("inf") else "no bound"
