"""What a build takes, and which resolution a wish needs: both from small parts that are computed.

A plan must cost less than the build it plans, so no tile is computed here. Each product of an atlas
has parts that need no others: some columns of limits of alpha over one box of hands and one cell of
delays, the verdicts of two hands. Such parts are computed at places that one
additive sequence spreads evenly over the range of delays, hands and beta. Their CPU time and
compressed bytes of a unit (a column, a cell, a hand), times the units of the whole atlas, are its
cost. Limits of alpha also take a time for each call, which a part of one column shows; parts of
them have proved errors, too.

A resolution is a scale: all counts of the given specification grow in proportion to it. Bounds of
limits are second differences over a cell, so errors fall with the square of the scale: an accuracy
is reached in two or three steps from an error to a scale to the next error. A size is reached by
bisection, for which nothing is computed. What is said of a resolution is an estimate; every answer
of an atlas is proved.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, isnan, prod
from time import process_time
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

from jaxstab.atlas.plan import Extents, Grid, Plan, compute_tile, extents_of, lay_out
from jaxstab.atlas.product import LARGEST_ARRAY
from jaxstab.atlas.products.limits import ALPHA_LIMITS, upper_errors
from jaxstab.atlas.products.table import PRODUCTS
from jaxstab.atlas.products.verdicts import VERDICT
from jaxstab.atlas.spec import FEWEST_FITTED, AtlasSpec, FittedAxis
from jaxstab.atlas.write.tiles import packed_tile
from jaxstab.numbers import checked_number
from jaxstab.shown import table_text

Floats = Float64[np.ndarray, "..."]
_PLASTIC = 1.1673039782614187  # the root of x^5 = x + 1: its powers spread four numbers evenly
_FEWEST, _MOST = 3, 24  # parts: of a cost, and of the limits of alpha
_PER_PART = 4  # cells of delays in tiles for each part
_QUANTILE = 0.95  # of the limits of alpha that keep the error that is said
_DRAWS = 50  # of samples of a sample, for its spread
_FILE, _CHUNK = 28_000, 90  # bytes of a file whose arrays are empty, and of a chunk beside values
_NEAR, _AIM = 0.65, 0.85  # of a wish: near enough to it, and aimed at
_ROUNDS = 5
_LEAST_GOAL = 1e-12  # an error
_SCALES = 2.0**-20, 2.0**20  # in units of the given resolution
_ALLOWED = {"accuracy": (1e-9, 1.0), "size": (0.0, inf)}


class Estimate(NamedTuple):
    """The expected CPU seconds of a build here, right to a factor of two, and its size in bytes."""

    seconds: float
    size: float

    def __str__(self) -> str:
        return (
            f"build: about {_duration(self.seconds)} of CPU time on this machine, and a file of "
            f"about {_two_digits(self.size / 1e6)} MB, judged by parts of a few tiles"
        )


class _Cost(NamedTuple):
    """Seconds and compressed bytes of a unit of a product, and seconds of each call."""

    seconds: float
    size: float
    call: float


# ------------------------------------------------------------------------------- parts of products


def _parts(plan: Plan, product: str, most: int) -> list[Grid]:
    """The grids of parts of a product, each once; fewer for an atlas of few tiles."""
    parts = {}
    for index in range(max(_FEWEST, min(most, _calls(plan) // _PER_PART))):
        place = (0.5 + index * _PLASTIC ** -np.arange(1.0, 5.0)) % 1.0
        grid = PRODUCTS[product].small_grid(plan.grid, place)
        axes = grid.limit_range, grid.delay, grid.gamma, grid.delta
        parts[b"".join(axis.tobytes() for axis in axes)] = grid
    return list(parts.values())


def _computed(
    plan: Plan, product: str, grid: Grid
) -> tuple[float, int, Mapping[str, NDArray[Any]]]:
    """Return the seconds, the compressed bytes and the arrays of the first tile of a part."""
    plan = Plan(replace(plan.spec, products=(product,)), grid)
    tile = plan.tiles[0]
    begin = process_time()
    arrays = compute_tile(plan, tile)
    image = packed_tile(plan, tile, arrays)
    seconds = process_time() - begin
    return seconds, sum(image[name].nbytes for name in arrays if name in image), arrays


def _units(grid: Grid, product: str) -> int:
    return prod(grid.lengths[name] for name in PRODUCTS[product].unit)


def _calls(plan: Plan) -> int:
    return len(plan.tiles) * len(plan.grid.limit_range) // plan.grid.delay.size


def _measured(plan: Plan, product: str, extents: Extents | None) -> tuple[_Cost, list[Floats]]:
    """Return the cost of a unit of a product and, with ``extents``, errors of limits by parts."""
    seconds, size, units, errors = 0.0, 0, 0, list[Floats]()
    has_errors = extents is not None and product == ALPHA_LIMITS
    rng = np.random.default_rng(_MOST)
    grids = _parts(plan, product, _MOST if has_errors else _FEWEST)
    for grid in grids:
        of_part, bytes_of_part, arrays = _computed(plan, product, grid)
        seconds, size = seconds + of_part, size + bytes_of_part
        units += _units(grid, product)
        if extents is not None and has_errors:
            errors.append(upper_errors(grid, arrays[ALPHA_LIMITS], extents, rng))
    call = 0.0
    if product == ALPHA_LIMITS:  # parts have fewer units to a call than builds
        column = PRODUCTS[product].small_grid(replace(plan.grid, limit_cells=1), np.full(4, 0.5))
        call = min(_computed(plan, product, column)[0], 0.9 * seconds / len(grids))
    return _Cost((seconds - call * len(grids)) / units, size / units, call), errors


def estimate_build(plan: Plan) -> Estimate:
    """Compute parts of some tiles, and estimate what all of them take."""
    costs = {product: _measured(plan, product, None)[0] for product in plan.spec.products}
    begin = process_time()
    lay_out(plan.spec)
    return _estimate(plan, costs, process_time() - begin)


def _estimate(plan: Plan, costs: Mapping[str, _Cost], seconds_of_layout: float) -> Estimate:
    grid, seconds = plan.grid, seconds_of_layout
    size = _FILE + len(plan.spec.to_toml()) + 1.5 * (grid.alpha.nbytes + grid.beta.nbytes)
    size += _CHUNK * len(plan.tiles) * len(plan.variables)
    for product in plan.spec.products:
        cost, units = costs[product], _units(grid, product)
        calls = _calls(plan) if product == ALPHA_LIMITS else 0
        seconds += cost.seconds * units + cost.call * calls
        size += cost.size * units + _CHUNK * calls
    return Estimate(seconds, size)


def _duration(seconds: float) -> str:
    for unit, length in (("hours", 3600.0), ("minutes", 60.0)):
        if seconds > 2.0 * length:
            return f"{_two_digits(seconds / length)} {unit}"
    return f"{_two_digits(seconds)} seconds"


def _two_digits(value: float) -> str:
    return f"{float(f'{value:.2g}'):g}"


# ------------------------------------------------------------------------- resolutions of one range


class Measured(NamedTuple):
    """A value from a sample, and its standard error."""

    value: float
    spread: float

    def __str__(self) -> str:
        if isnan(self.value):
            return "-"
        return f"{self.value:.2g} +- {self.spread:.1g}" if self.value < inf else "no bound"


@dataclass(frozen=True)
class Resolution:
    """The accuracy and the cost of one resolution of a range, from a sample of its cells.

    Attributes:
        spec: the specification.
        counts: nodes along alpha and beta, cells along gamma and delta, and the ``limit_cells`` and
            ``delay_cells`` of the limits of alpha.
        limit_error: bound that 95 % of the upper limits of alpha keep, over the largest stable
            alpha at their delay, and its standard error; infinite where less than 95 % have a
            bound, NaN without limits.
        seconds: of CPU time of the build on this machine.
        size: of the file in bytes.

    Example:
        >>> spec = jaxstab.AtlasSpec(
        ...     gamma=(0.0,), delta=(0.01,), delay=(1.0,), products=("alpha_limits",)
        ... )
        >>> jaxstab.plan_resolution(spec, size=50_000).given.counts["limit_cells"]
        256
    """

    spec: AtlasSpec
    counts: Mapping[str, int]
    limit_error: Measured
    seconds: float
    size: float


@dataclass(frozen=True)
class ResolutionPlan:
    """The given resolution of a range, and the one that a wish needs (``plan_resolution``).

    Attributes:
        wish: such as "accuracy 0.01".
        given: the specification that was given.
        chosen: the one that meets the wish.

    Example:
        >>> spec = jaxstab.AtlasSpec(
        ...     gamma=(0.0,), delta=(0.01,), delay=(1.0,), products=("alpha_limits",)
        ... )
        >>> plan = jaxstab.plan_resolution(spec, accuracy=0.01)
        >>> plan.chosen.limit_error.value < 0.01, plan.spec.limit_cells < spec.limit_cells
        (True, True)
    """

    wish: str
    given: Resolution
    chosen: Resolution

    @property
    def spec(self) -> AtlasSpec:
        """The specification that meets the wish."""
        return self.chosen.spec

    def __str__(self) -> str:
        rows = [["alpha", "beta", "gamma", "delta", "limits", "delays", "error", "MB", "CPU s", ""]]
        for row, note in ((self.given, "as given"), (self.chosen, f"meets {self.wish}")):
            counts = (str(count or "-") for count in row.counts.values())
            cost = f"{row.size / 1e6:.3g}", f"{row.seconds:.3g}"
            rows.append([*counts, str(row.limit_error), *cost, note])
        return "\n".join([table_text(rows), "", *_LEGEND])


_LEGEND = (
    "error: 95 % of the proved errors of the upper limit of alpha are below this, over the "
    "largest stable alpha at their delay; +- is the standard error of a sample.",
    "Counts are nodes along alpha and beta, cells along gamma and delta, limit_cells and "
    "delay_cells of the limits.",
)


def plan_resolution(
    spec: AtlasSpec, *, accuracy: float | int | None = None, size: float | int | None = None
) -> ResolutionPlan:
    """The specification of the same range that a wish needs, beside the given one.

    The ends of the range, its delays and its products stay. With limits of alpha, the cells along
    gamma, delta, beta and the delay change in proportion, without them the nodes along alpha, beta,
    gamma and delta. Errors and costs are estimates from a sample of cells, while each answer of an
    atlas is proved.

    Args:
        spec: the range and the products.
        accuracy: bound that 95 % of the upper limits of alpha shall keep, over the largest stable
            alpha at their delay; from 1e-9 to 1.
        size: of the file in bytes, at most.

    Raises: see ``jaxstab.conventions``; TypeError also if not exactly one wish is given, ValueError
    if no resolution meets it, or no loop is stable at a delay.

    Example:
        >>> spec = jaxstab.AtlasSpec(
        ...     gamma=(0.0,), delta=(0.01,), delay=(1.0,), products=("alpha_limits",)
        ... )
        >>> jaxstab.plan_resolution(spec, size=100_000).chosen.size < 100_000
        True
    """
    wishes = {"accuracy": accuracy, "size": size}
    given = {name: wish for name, wish in wishes.items() if wish is not None}
    if len(given) != 1:
        words = "both are" if given else "nothing is"
        raise TypeError(f"{words} given; give one of {', '.join(wishes)}.")
    ((name, wish),) = given.items()
    value = checked_number(name, wish, *_ALLOWED[name])
    if name == "accuracy" and ALPHA_LIMITS not in spec.products:
        raise ValueError(f"accuracy is of limits of alpha; add {ALPHA_LIMITS!r} to the products.")
    if not {ALPHA_LIMITS, VERDICT} & {*spec.products}:
        raise ValueError(f"size needs verdicts; add {ALPHA_LIMITS!r} to the products.")
    range_ = _Range(spec)
    chosen = range_.of_accuracy(value) if name == "accuracy" else range_.of_size(value)
    return ResolutionPlan(f"{name} {value:g}", range_.given, chosen)


class _Range:
    """The resolutions of a range: all counts in proportion to those of the given specification."""

    def __init__(self, spec: AtlasSpec) -> None:
        self._spec = spec
        self._extents = extents_of(spec)
        begin = process_time()
        plan = Plan(spec, lay_out(spec))
        self._layout_seconds = process_time() - begin
        self._costs: dict[str, _Cost] = {}
        self.given = self._judged(plan)

    def _judged(self, plan: Plan) -> Resolution:
        """Estimates of a resolution, from parts of its range."""
        error = Measured(np.nan, np.nan)
        for product in plan.spec.products:
            if product == ALPHA_LIMITS or product not in self._costs:
                self._costs[product], errors = _measured(plan, product, self._extents)
                error = _quantile(errors) if product == ALPHA_LIMITS else error
        estimate = _estimate(plan, self._costs, self._layout_seconds)
        return Resolution(plan.spec, counts_of(plan.spec), error, *estimate)

    def _plan_or_none(self, scale: float) -> Plan | None:
        """Return the plan of a resolution, None where its file could not be opened."""
        try:
            spec = scaled(self._spec, scale)
            plan = Plan(spec, lay_out(spec, self._extents))
        except ValueError:
            return None
        return plan if _estimate(plan, self._costs, 0.0).size <= LARGEST_ARRAY else None

    def of_accuracy(self, accuracy: float | int) -> Resolution:
        """The smallest resolution found whose error is not above this."""
        error, scale, coarsest = self.given.limit_error.value, 1.0, self._plan_or_none(_SCALES[0])
        if isnan(error):
            raise ValueError("no alpha is stable in a sample of this range; give a smaller range.")
        met: list[Resolution] = []
        for _ in range(_ROUNDS):
            error = max(error, _LEAST_GOAL)
            scale *= (error / (_AIM * accuracy)) ** 0.5 if error < inf else 2.0
            plan = self._plan_or_none(scale)
            if plan is None:
                raise ValueError(self._refusal(accuracy, scale, error))
            chosen = self._judged(plan)
            error = chosen.limit_error.value
            if error <= accuracy:
                met.append(chosen)
                if error >= _NEAR * accuracy or (coarsest and plan.spec == coarsest.spec):
                    break
        if not met:
            raise ValueError(
                f"accuracy is {accuracy:g}, and resolutions of this range are too irregular to "
                "find one that reaches it; give a smaller range, or the size of the file."
            )
        return min(met, key=lambda resolution: resolution.size)

    def of_size(self, size: float | int) -> Resolution:
        """The finest resolution with a file not larger than this."""
        for attempt in range(_ROUNDS):
            plan = self._plan_or_none(self._scale_within(size, _AIM**attempt))
            if plan is None:
                break
            chosen = self._judged(plan)
            if chosen.size <= size:
                return chosen
        raise ValueError(f"size is {size:g} bytes, and no resolution was found; give more.")

    def _scale_within(self, size: float | int, aim: float = 1.0) -> float:
        """Return the largest scale of which the file takes a share of a size at most."""

        def cost(scale: float) -> float:
            plan = self._plan_or_none(scale)
            return _estimate(plan, self._costs, 0.0).size if plan else inf

        low, high = _SCALES
        least = cost(low)
        if least > aim * size:
            raise ValueError(
                f"size is {size:g} bytes, and the coarsest atlas of this range takes "
                f"{float(f'{least:.3g}'):,g} bytes; give more, or fewer products, delays or nodes."
            )
        for _ in range(40):
            middle = (low * high) ** 0.5
            low, high = (middle, high) if cost(middle) <= aim * size else (low, middle)
        return low

    def _refusal(self, accuracy: float | int, scale: float, error: float) -> str:
        least = error * (scale / self._scale_within(LARGEST_ARRAY)) ** 2
        return (
            f"accuracy is {accuracy:g}, and an atlas of this range that can be opened, with up to "
            f"{LARGEST_ARRAY / 1e9:.1f} GB, reaches about {least:.2g}; give that, or less range."
        )


def _quantile(parts: Sequence[Floats]) -> Measured:
    """Return a quantile of all errors, and its spread by drawing the parts again."""
    filled = [errors for errors in parts if errors.size]
    if not filled:
        return Measured(np.nan, np.nan)
    rng = np.random.default_rng(len(filled))
    drawn = rng.integers(len(filled), size=(_DRAWS, len(filled)))
    value, *values = (
        float(np.quantile(np.concatenate([filled[i] for i in draw]), _QUANTILE, method="higher"))
        for draw in (range(len(filled)), *drawn)
    )
    return Measured(value, float(np.std(values)) if np.isfinite(values).all() else inf)


# The same range with more or fewer nodes and cells: the counts of a specification.


def counts_of(spec: AtlasSpec) -> dict[str, int]:
    """Return the counts of a specification by axis; no cells of delays where only delays are."""
    counts = {name: _length(getattr(spec, name)) for name in ("alpha", "beta", "gamma", "delta")}
    counts |= {name: max(1, counts[name] - 1) for name in ("gamma", "delta")}
    delay_cells = int(spec.delay_cells or 0) if _length(spec.delay) > 1 else 0
    return counts | {"limit_cells": spec.limit_cells, "delay_cells": delay_cells}


def scaled(spec: AtlasSpec, scale: float) -> AtlasSpec:
    """A specification of the same range with counts in proportion, as dense as they were."""
    cells = "limit_cells", "delay_cells"
    walls = cells if ALPHA_LIMITS in spec.products else ("alpha", "beta")
    counts, changed = counts_of(spec), dict[str, Any]()
    for name in (*walls, "gamma", "delta"):
        count, axis = max(1, round(min(counts[name] * scale, 2.0**30))), getattr(spec, name)
        if name in cells:
            changed[name] = count if counts[name] else axis
        elif isinstance(axis, FittedAxis):
            changed[name] = replace(axis, count=max(FEWEST_FITTED, count))
        elif len(axis) > 1 and count != counts[name]:
            count = count + 1 if name in ("gamma", "delta") else max(2, count)
            changed[name] = np.interp(
                np.linspace(0.0, len(axis) - 1.0, count), np.arange(len(axis)), axis
            ).tolist()
    return replace(spec, **changed)


def _length(axis: Any) -> int:
    return axis.count if isinstance(axis, FittedAxis) else len(axis)
