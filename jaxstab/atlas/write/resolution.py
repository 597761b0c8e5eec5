"""What a build takes, and which resolution a wish needs: both from small parts that are computed.

A plan must cost less than the build it plans, so no tile is computed here. Each product of an atlas
has parts that need no others: some columns of limits of alpha over one box of hands and one cell of
delays, some cells of radii, the verdicts of two hands. Such parts are computed at places that one
additive sequence spreads evenly over the range of delays, hands and beta. A part says three things:

- the CPU time and the compressed bytes of a unit (a column, a cell, a hand), which times the units
  of the whole atlas are its cost; limits of alpha also take a time for each call, which a part of
  one column shows;
- the proved errors, and the undecided share, that an atlas of this resolution has there;
- by its spread over the places, how well these are known.

A resolution is a scale: all counts grow in proportion to it, each in the measure in which it takes
part in the error (``_Range.steps`` doubles each count alone to see that). Bounds of limits are
second differences over a cell, so errors fall with the square of the scale; those of radii fall
with its cube, and the undecided share of cells of verdicts with the scale itself. So an accuracy is
reached in two or three steps from an error to a scale to the next error, and a size by bisection,
for which nothing is computed. What is said of a resolution is an estimate; every answer of an atlas
is proved.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, isnan, prod
from time import process_time
from typing import Any, NamedTuple

import h5py
import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

from jaxstab.atlas.compute.layout import (
    HANDS,
    OF_LIMITS,
    WALLS,
    Grid,
    Reach,
    counts_of,
    is_fixed,
    known_region,
    lay_out,
    least_count,
    reach_of,
    regions_around,
    with_counts,
)
from jaxstab.atlas.compute.plan import Plan, compute_tile
from jaxstab.atlas.format.schema import image_of
from jaxstab.atlas.format.spec import AtlasSpec
from jaxstab.atlas.format.variables import LARGEST_ARRAY
from jaxstab.atlas.products.limits import ALPHA_LIMITS
from jaxstab.atlas.products.radii import SPECTRAL_RADIUS
from jaxstab.atlas.products.table import PRODUCTS
from jaxstab.atlas.products.verdicts import VERDICT
from jaxstab.atlas.write.tiles import encode_tile
from jaxstab.numbers import checked_number

Floats = Float64[np.ndarray, "..."]
Arrays = Mapping[str, NDArray[Any]]
_PLASTIC = 1.1673039782614187  # the root of x^5 = x + 1: its powers spread four numbers evenly
_JUDGES = ALPHA_LIMITS, VERDICT, SPECTRAL_RADIUS  # by the first of them a resolution is judged
_FEW, _SOME, _MANY = 3, 6, 24  # parts: of a cost, of a row, of a promise
_PER_PART = 4  # cells of delays in tiles for each part
_AT_ONCE = 6  # parts between looks at the spread
_ENOUGH = 0.05  # of a value: a spread that needs no more parts
_DRAWS = 50  # of samples of a sample, for its spread
_FILE, _CHUNK = 28_000, 90  # bytes of a file whose arrays are empty, and of a chunk beside values
_NEAR, _AIM = 0.65, 0.85  # of a wish: near enough to it, and aimed at
_ROUNDS = 5
_LEAST_SHARE = 0.02  # of the error, of an axis
_LEAST_GOAL = 1e-12  # an error
_SCALES = 2.0**-20, 2.0**20  # in units of the given resolution
_LADDER = 0.5, 2.0**0.5  # resolutions beside the chosen one, in units of it
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


class Measured(NamedTuple):
    """A value from a sample, and its standard error."""

    value: float
    spread: float


_UNKNOWN = Measured(np.nan, np.nan)


class _Cost(NamedTuple):
    """Seconds and compressed bytes of a unit of a product, and seconds of each call."""

    seconds: float
    size: float
    call: float = 0.0


class _Part(NamedTuple):
    """What one computed part shows: what it took, errors at its points, and its undecided share."""

    seconds: float
    size: int
    units: int
    errors: Floats
    undecided: float


# ------------------------------------------------------------------------------- parts of products


def _units(grid: Grid, product: str) -> int:
    return prod(grid.lengths[name] for name in PRODUCTS[product].unit)


def _calls(plan: Plan) -> int:
    return len(plan.tiles) * len(plan.grid.limit_range) // plan.grid.delay.size


def _parts(plan: Plan, product: str, count: int, reach: Reach | None = None) -> Iterator[_Part]:
    """Yield parts of a product at ``count`` places, fewer for an atlas of few tiles."""
    # A part at which two places are comes once.
    rng = np.random.default_rng(count)
    seen = set()
    for number in range(max(_FEW, min(count, _calls(plan) // _PER_PART))):
        place = (0.5 + number * _PLASTIC ** -np.arange(1.0, 5.0)) % 1.0
        grid = PRODUCTS[product].part(plan.grid, place)
        key = grid.limit_range.tobytes() + grid.radius_range.tobytes() + grid.delay.tobytes()
        key += grid.gamma.tobytes() + grid.delta.tobytes()
        if key not in seen:
            seen.add(key)
            seconds, size, arrays = _computed(plan, product, grid)
            judged = PRODUCTS[product].judged(grid, arrays, reach, rng)
            yield _Part(seconds, size, _units(grid, product), *judged)


def _computed(plan: Plan, product: str, grid: Grid) -> tuple[float, int, Arrays]:
    """Return the seconds, the compressed bytes and the arrays of the first tile of a part."""
    part = Plan(replace(plan.spec, products=(product,)), grid)
    tile = part.tiles[0]
    begin = process_time()
    arrays = compute_tile(part, tile)
    image = encode_tile(part, tile, "", arrays)
    seconds = process_time() - begin
    with h5py.File.in_memory(image_of(image)) as file:
        size = sum(dataset.id.get_storage_size() for dataset in file.values())
    return seconds, size, arrays


def _cost(plan: Plan, product: str, parts: Sequence[_Part]) -> _Cost:
    units = sum(part.units for part in parts)
    seconds, size = sum(part.seconds for part in parts), sum(part.size for part in parts)
    call = 0.0
    if PRODUCTS[product].has_calls:  # parts have fewer units to a call than builds
        one = replace(plan.grid, limit_cells=1)
        grid = PRODUCTS[product].part(one, np.full(4, 0.5))
        call = min(_computed(plan, product, grid)[0], 0.9 * seconds / len(parts))
    return _Cost((seconds - call * len(parts)) / units, size / units, call)


def estimate_build(plan: Plan) -> Estimate:
    """Compute parts of some tiles, and estimate what all of them take."""
    costs = {
        product: _cost(plan, product, list(_parts(plan, product, _FEW)))
        for product in plan.spec.products
    }
    return _estimate(plan, costs, _seconds_of_region(plan))


def _seconds_of_region(plan: Plan) -> float:
    if not regions_around(plan.spec, plan.grid):
        return 0.0
    grid, begin = plan.grid, process_time()
    delay = float(grid.delay[grid.delay.size // 2])
    known_region(float(grid.gamma[-1]), float(grid.delta[-1]), delay, plan.spec.filters)
    return process_time() - begin


def _estimate(plan: Plan, costs: Mapping[str, _Cost], region_seconds: float) -> Estimate:
    grid = plan.grid
    seconds = region_seconds * regions_around(plan.spec, grid)
    size = _FILE + len(plan.spec.to_toml()) + 1.5 * (grid.alpha.nbytes + grid.beta.nbytes)
    size += _CHUNK * len(plan.tiles) * len(plan.variables)
    for product in plan.spec.products:
        cost, units = costs[product], _units(grid, product)
        calls = _calls(plan) if PRODUCTS[product].has_calls else 0
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


@dataclass(frozen=True)
class Resolution:
    """The accuracy and the cost of one resolution of a range, from a sample of its cells.

    Attributes:
        spec: the specification.
        counts: nodes along alpha and beta, cells along gamma and delta, and the ``limit_cells`` and
            ``delay_cells`` of the limits of alpha.
        limit_error: bound that 95 % of the upper limits of alpha keep, over the largest stable
            alpha at their delay; infinite where less than 95 % have one, NaN without limits.
        undecided: share of the range that is undecided; NaN without verdicts.
        radius_error: bound that half of the spectral radii of stable loops keep, NaN without radii.
        seconds: of CPU time of the build on this machine.
        size: of the file in bytes.

    Each of the three errors is a pair: the value and its standard error.

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
    undecided: Measured
    radius_error: Measured
    seconds: float
    size: float


@dataclass(frozen=True)
class ResolutionPlan:
    """Resolutions of one range, and the one that a wish needs; ``plan_resolution`` makes it.

    Attributes:
        wish: such as "accuracy 0.01".
        rows: from the smallest file to the largest.
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
    rows: tuple[Resolution, ...]
    given: Resolution
    chosen: Resolution

    @property
    def spec(self) -> AtlasSpec:
        """The specification that meets the wish."""
        return self.chosen.spec

    def __str__(self) -> str:
        heading = [*_COUNTS.values(), "limits", "undecided", "radius", "MB", "CPU s"]
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
            notes.get(id(row), ""),
        ]


_COUNTS = dict(zip((*WALLS, *HANDS, *OF_LIMITS), (*WALLS, *HANDS, "limits", "delays"), strict=True))

_WORDS = (
    "limits: 95 % of the proved errors of the upper limit of alpha are below this, over the "
    "largest stable alpha at their delay",
    "undecided: share of the range without a proved verdict",
    "radius: half of the proved errors of stable loops are below this",
    "Counts are nodes along alpha and beta, cells along gamma and delta, limit_cells and "
    "delay_cells of the limits. +- is the standard error of a sample.",
)


def _words(measured: Measured) -> str:
    value, spread = measured
    if isnan(value):
        return "-"
    if isnan(spread):
        return f"{value:.2g}"
    return f"{value:.2g} +- {spread:.1g}" if value < inf else "no bound"


def plan_resolution(
    spec: AtlasSpec, *, accuracy: float | int | None = None, size: float | int | None = None
) -> ResolutionPlan:
    """The specification of the same range that a wish needs, beside other resolutions.

    The ends of the range, its delays and its products stay. Errors and costs are estimates from a
    sample of cells, while each answer of an atlas is proved.

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
        words = " and ".join(given) or "nothing"
        raise TypeError(f"{words} is wished for; give one of {', '.join(wishes)}.")
    ((name, wish),) = given.items()
    value = checked_number(name, wish, *_ALLOWED[name])
    if name == "accuracy" and ALPHA_LIMITS not in spec.products:
        raise ValueError(f"accuracy is of limits of alpha; add {ALPHA_LIMITS!r} to the products.")
    range_ = _Range(spec)
    scale, chosen = range_.of_error(value) if name == "accuracy" else range_.of_size(value)
    rows = [range_.given, chosen]
    for step in _LADDER:
        plan = range_.plan_or_none(scale * step)
        if plan and all(plan.spec != row.spec for row in rows):
            rows.append(range_.judged(plan, _SOME))
    rows.sort(key=lambda row: row.size)
    return ResolutionPlan(f"{name} {value:g}", tuple(rows), range_.given, chosen)


class _Range:
    """The resolutions of a range, with all counts in proportion to those of ``given``."""

    given: Resolution

    def __init__(self, spec: AtlasSpec) -> None:
        judge = next((name for name in _JUDGES if name in spec.products), None)
        if judge is None:
            raise ValueError(f"size needs verdicts; add {ALPHA_LIMITS!r} to the products.")
        self._judge = judge
        self._spec = spec
        self._knobs = [n for n in PRODUCTS[judge].knobs if not is_fixed(self._spec, n)]
        begin = process_time()
        self._reach = reach_of(self._spec)
        first = Plan(self._spec, lay_out(self._spec, self._reach))
        regions = max(1, regions_around(self._spec, first.grid))
        self._region_seconds = (process_time() - begin) / regions
        self._costs = {
            product: _cost(first, product, list(_parts(first, product, _FEW)))
            for product in spec.products
            if product not in (judge, SPECTRAL_RADIUS)
        }
        self.given = self.judged(first, _SOME)
        self._counts, self._error = counts_of(self._spec), self._error_of(self.given)
        while self._error == inf:  # where less than 95 % of the limits have a bound
            self._counts |= {knob: 2 * self._counts[knob] for knob in self._knobs}
            self._error = self._error_of(self.judged(self._plan({}), _SOME))

    @cached_property
    def steps(self) -> dict[str, float]:
        """How many of each count there are at the scale 1: each takes an equal part then."""
        # A few places show the undecided share well, and an error of a limit is half the height of
        # what it leaves undecided: so parts are judged by this share.
        if len(self._knobs) == 1:
            return {self._knobs[0]: float(self._counts[self._knobs[0]])}
        whole, power, parts = self._mean_error({}), PRODUCTS[self._judge].power, {}
        for knob in self._knobs:
            ratio = self._mean_error({knob: 2 * self._counts[knob]}) / whole
            parts[knob] = max(_LEAST_SHARE, 2.0 * (1.0 - min(1.0, ratio) ** (1.0 / power)))
        mean = sum(parts.values()) / len(parts)
        return {knob: self._counts[knob] * part / mean for knob, part in parts.items()}

    def plan_or_none(self, scale: float) -> Plan | None:
        """Return the plan of a resolution, None where its file could not be opened."""
        counts = {
            knob: max(least_count(self._spec, knob), round(min(step * scale, 2.0**30)))
            for knob, step in self.steps.items()
        }
        try:
            plan = self._plan(counts)
        except ValueError:
            return None
        return plan if self._estimate(plan).size <= LARGEST_ARRAY else None

    def judged(self, plan: Plan, places: int) -> Resolution:
        """Estimates of a resolution, from ``count`` places of its range or fewer."""
        known = dict.fromkeys(("limit_error", "undecided", "radius_error"), _UNKNOWN)
        sampled = {self._judge: places}
        if SPECTRAL_RADIUS in plan.spec.products:
            sampled.setdefault(SPECTRAL_RADIUS, _SOME)
        for name, count in sampled.items():
            parts: list[_Part] = []
            drawn = _parts(plan, name, count, self._reach)
            while some := list(itertools.islice(drawn, _AT_ONCE)):
                parts += some
                product = PRODUCTS[name]
                if not isnan(parts[0].undecided):
                    known["undecided"] = _mean([part.undecided for part in parts])
                if product.quantile:
                    errors = [part.errors for part in parts]
                    known[product.error] = _quantile(errors, product.quantile)
                if all(s <= _ENOUGH * v or not v < inf for v, s in known.values()):
                    break
            self._costs[name] = _cost(plan, name, parts)
        limit, undecided, radius = known.values()
        estimate = self._estimate(plan)
        return Resolution(plan.spec, counts_of(plan.spec), limit, undecided, radius, *estimate)

    def of_error(self, wanted: float | int) -> tuple[float, Resolution]:
        """The scale at which an error is as wished for, and the resolution there."""
        if isnan(self._error):
            raise ValueError("no alpha is stable in a sample of this range; give a smaller range.")
        scale, error = 1.0, max(self._error, _LEAST_GOAL)
        met: list[tuple[float, Resolution]] = []
        for _ in range(_ROUNDS):
            scale *= (error / (_AIM * wanted)) ** (1.0 / PRODUCTS[self._judge].power)
            plan = self.plan_or_none(scale)
            if plan is None:
                raise ValueError(self._refusal(wanted, scale, error))
            chosen = self.judged(plan, _MANY)
            error = max(self._error_of(chosen), _LEAST_GOAL)
            if error <= wanted:
                met.append((scale, chosen))
                least = self.plan_or_none(_SCALES[0])
                if error >= _NEAR * wanted or (least and plan.spec == least.spec):
                    break
        if not met:
            raise ValueError(
                f"accuracy is {wanted:g}, and resolutions of this range are too irregular to find "
                "one that reaches it; give a plainer range, or the size of the file."
            )
        return min(met, key=lambda one: one[1].size)

    def of_size(self, size: float | int) -> tuple[float, Resolution]:
        """The finest scale with a file not larger than this, and the resolution there."""
        for number in range(_ROUNDS):
            scale = self._scale_within(size, _AIM**number)
            plan = self.plan_or_none(scale)
            if plan is None:
                break
            chosen = self.judged(plan, _MANY)
            if chosen.size <= size:
                return scale, chosen
        raise ValueError(f"size is {size:g} bytes, and no resolution was found; give more.")

    def _scale_within(self, size: float | int, aim: float = 1.0) -> float:
        """Return the largest scale of which the file takes a share of a size at most."""

        def cost(scale: float) -> float:
            plan = self.plan_or_none(scale)
            return self._estimate(plan).size if plan else inf

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

    def _plan(self, counts: Mapping[str, int]) -> Plan:
        spec = with_counts(self._spec, {**self._counts, **counts})
        return Plan(spec, lay_out(spec, self._reach))

    def _estimate(self, plan: Plan) -> Estimate:
        return _estimate(plan, self._costs, self._region_seconds)

    def _error_of(self, row: Resolution) -> float:
        error: float = getattr(row, PRODUCTS[self._judge].error).value
        return error

    def _mean_error(self, counts: Mapping[str, int]) -> float:
        parts = list(_parts(self._plan(counts), self._judge, _FEW, self._reach))
        if isnan(parts[0].undecided):
            share = PRODUCTS[self._judge].quantile
            return max(_quantile([part.errors for part in parts], share).value, _LEAST_GOAL)
        return max(_mean([part.undecided for part in parts]).value, _LEAST_GOAL)

    def _refusal(self, accuracy: float | int, scale: float, error: float) -> str:
        largest = self._scale_within(LARGEST_ARRAY)
        least = error * (scale / largest) ** PRODUCTS[self._judge].power
        return (
            f"accuracy is {accuracy:g}, and an atlas of this range that can be opened, with up to "
            f"{LARGEST_ARRAY / 1e9:.1f} GB, reaches about {least:.2g}; give that, or less range."
        )


def _quantile(parts: Sequence[Floats], share: float) -> Measured:
    """Return a quantile of all values, and its spread by drawing the parts again."""
    filled = [part for part in parts if part.size]
    if not filled:
        return _UNKNOWN
    rng = np.random.default_rng(len(filled))
    drawn = rng.integers(len(filled), size=(_DRAWS, len(filled)))
    values = np.array([_at_share([filled[i] for i in some], share) for some in drawn])
    spread = float(np.std(values)) if np.isfinite(values).all() else inf
    return Measured(_at_share(filled, share), spread)


def _at_share(parts: Sequence[Floats], share: float) -> float:
    return float(np.quantile(np.concatenate(parts), share, method="higher"))


def _mean(values: Sequence[float]) -> Measured:
    spread = np.std(values, ddof=1) / len(values) ** 0.5 if len(values) > 1 else np.nan
    return Measured(float(np.mean(values)), float(spread))
