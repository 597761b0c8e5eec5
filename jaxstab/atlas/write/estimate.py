"""How long a build takes and how large its file is, from parts of a few tiles that are computed."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from math import inf, prod
from time import process_time
from typing import Any, NamedTuple

import h5py
import numpy as np
from jaxtyping import Float64

from jaxstab.atlas.compute.layout import (
    HANDS,
    OF_LIMITS,
    WALLS,
    counts_of,
    ends_of,
    is_fixed,
    known_region,
    lay_out,
    least_count,
    reach_of,
    regions_around,
    with_counts,
    with_known_nodes,
)
from jaxstab.atlas.compute.plan import Plan, Tile
from jaxstab.atlas.format.schema import (
    ALPHA_LIMITS,
    LARGEST_ARRAY,
    LIMITS,
    RADIUS_CELL,
    SPECTRAL_RADIUS,
    VARIABLES,
    VERDICT,
    image_of,
)
from jaxstab.atlas.format.spec import AtlasSpec
from jaxstab.atlas.write.build import tile_image
from jaxstab.atlas.write.resolution import (
    Enough,
    Resolution,
    ResolutionPlan,
    Sample,
    has_small_spreads,
    sample_of_cells,
    sample_of_limits,
    sample_of_radii,
)
from jaxstab.numbers import checked_number

_RADII = 24, 64  # cells of radii along alpha and beta that are computed at once, at most

_SHARES = (0.1, 0.5, 0.9), (0.5, 0.9, 0.1), (0.9, 0.1, 0.5)  # of the delays, gammas and deltas

_REGIONS = 0.1, 0.3, 0.5, 0.7, 0.9  # of the way through the delays

_CALLS = (1, 32), (16, 512)  # boxes of hands and columns along beta, at most

_FILE, _CHUNK = 28_000, 90  # bytes of a file whose arrays are empty, and of a chunk beside values

_WITHOUT_CELLS = 0.4  # of the work of a tile: at the last of several hands no cells begin


class Estimate(NamedTuple):
    """The expected cost of a build, in our experience right to a factor of two.

    Attributes:
        seconds: of CPU time, on this machine.
        size: of the file in bytes.
    """

    seconds: float
    size: float

    def __str__(self) -> str:
        return (
            f"build: about {_duration(self.seconds)} of CPU time on this machine, and a file of "
            f"about {_two_digits(self.size / 1e6)} MB, judged by parts of a few tiles"
        )


class Costs(NamedTuple):
    """What parts of an atlas take, by which the cost of any resolution of its range follows.

    Attributes:
        region_seconds: of a stable region around which axes are laid.
        start: seconds that the first tile of a delay takes more than others.
        slice_seconds: of a hand at one delay, but for the limits of alpha and the radii.
        node_bytes: of its compressed values, but for those of cells, limits and radii.
        cell_bytes: of the values of cells that begin at a hand.
        call_seconds: of the limits of alpha in one tile and one cell of delays, whatever they are.
        column_seconds: that each column of limits takes more.
        radius_seconds: of a cell of radii.
        radius_bytes: of its compressed values.
    """

    region_seconds: float
    start: float
    slice_seconds: float
    node_bytes: float
    cell_bytes: float
    call_seconds: float
    column_seconds: float
    radius_seconds: float
    radius_bytes: float

    def of(self, plan: Plan, of_limits: float = 1.0) -> Estimate:
        """Return what a build takes; nodes along alpha and beta are those that were measured.

        Args:
            plan: of the build.
            of_limits: how many times what was measured its limits of alpha take.
        """
        length = plan.grid.lengths
        cells = length["gamma_cell"] * length["delta_cell"] * length["delay"]
        tiles = plan.tiles
        hands = sum(
            len(tile.delta) * (1.0 if _has_cells(plan, tile) else _WITHOUT_CELLS) for tile in tiles
        )
        seconds = self.region_seconds * regions_around(plan.spec, plan.grid)
        seconds += self.start * length["delay"] + self.slice_seconds * hands
        size = _FILE + self.node_bytes * prod(plan.grid.shape[2:]) + self.cell_bytes * cells
        size += _CHUNK * len(tiles) * len(plan.variables) + len(plan.spec.to_toml())
        size += 1.5 * (plan.grid.alpha.nbytes + plan.grid.beta.nbytes)  # and their scales
        if ALPHA_LIMITS in plan.spec.products:
            gammas, deltas, delays = (length[name] for name in LIMITS[1:4])
            columns = plan.grid.limit_cells * gammas * deltas * delays
            calls = gammas * -(-deltas // plan.deltas_of_a_tile) * delays
            seconds += of_limits * self.limit_seconds(calls, columns)
            size += calls * (_CHUNK + 4.0 * prod(plan.chunk(ALPHA_LIMITS)))
        if SPECTRAL_RADIUS in plan.spec.products:
            radii = prod(length[name] for name in RADIUS_CELL)
            seconds += self.radius_seconds * radii
            size += self.radius_bytes * radii + _CHUNK * length[RADIUS_CELL[-1]]
        return Estimate(seconds, size)

    def limit_seconds(self, calls: int, columns: int) -> float:
        """Return what limits of alpha take, so many tiles of so many columns in all."""
        return self.call_seconds * calls + self.column_seconds * columns


def estimate_build(plan: Plan) -> Estimate:
    """Compute parts of some tiles, and say what all of them take.

    Raises:
        ValueError: as for a build.
    """
    return costs_of(plan).of(plan)


def costs_of(plan: Plan) -> Costs:
    """Compute parts of a tile of the first and of the last delay, and some limits of alpha.

    Raises:
        ValueError: as for a build.
    """
    delays = sorted({0, plan.grid.delay.size - 1})
    slices = np.mean([_of_slices(plan, delay) for delay in delays], axis=0)
    limits = radii = [0.0, 0.0]
    if ALPHA_LIMITS in plan.spec.products:
        limits = limit_costs(plan)
    if SPECTRAL_RADIUS in plan.spec.products:
        radii = np.mean([_of_radii(plan, along) for along, *_ in _SHARES], axis=0).tolist()
    return Costs(_of_region(plan), *slices.tolist(), *limits, *radii)


def limit_costs(plan: Plan) -> list[float]:
    """Return ``call_seconds`` and ``column_seconds`` of a plan with limits of alpha."""
    found: list[float] = np.mean([_of_limits(plan, *one) for one in _SHARES], axis=0).tolist()
    return found


def _of_region(plan: Plan) -> float:
    """Return the seconds of a stable region, of a few hands and delays."""
    grid = plan.grid
    delays = [_at(grid.limit_range[:, 0], share) for share in _REGIONS]
    begin = process_time()
    for end in (0, -1):
        for delay in delays:
            known_region(float(grid.gamma[end]), float(grid.delta[end]), delay, plan.spec.filters)
    return (process_time() - begin) / (2 * len(delays))


def _at(nodes: Float64[np.ndarray, " node"], share: float) -> float:
    """Return the node at a share of the way through all of them."""
    return float(nodes[round(share * (nodes.size - 1))])


def _has_cells(plan: Plan, tile: Tile) -> bool:
    return all(plan.numbers(name, tile) for name in ("gamma_cell", "delta_cell"))


def _of_slices(plan: Plan, delay: int) -> tuple[float, ...]:
    """Return the seconds that a tile takes more if it is the first, and what a hand takes.

    These are its seconds and the bytes of its nodes and of its cells.

    Verdicts and what belongs to slices take a second at most.
    """
    tile = next(tile for tile in plan.tiles if tile.delay == delay)
    start, taken = 0.0, np.zeros(3)
    others = (ALPHA_LIMITS, SPECTRAL_RADIUS)
    for product in (name for name in plan.spec.products if name not in others):
        part = Plan(replace(plan.spec, products=(product,)), plan.grid)
        (slow, *_), (quick, *stored) = (_timed(part, tile) for _ in range(2))
        start += max(0.0, slow - quick)  # XLA compiles once
        taken += [quick, *stored]
    return start, *(taken / len(tile.delta)).tolist()


def _of_limits(plan: Plan, along: float, of_gamma: float, of_delta: float) -> tuple[float, float]:
    """Return the seconds of limits of alpha at shares of the way through delays and hands.

    Few columns in the middle of one box of hands are computed, and many of several boxes.
    """
    grid = plan.grid
    row = grid.limit_range[int(along * (len(grid.limit_range) - 1))]
    gamma = int(of_gamma * max(0, grid.gamma.size - 2))
    taken: list[tuple[int, float]] = []
    for boxes, most in _CALLS:
        columns = min(most, grid.limit_cells)
        before = (grid.limit_cells - columns) // 2
        ends = np.array([before, before + columns]) / grid.limit_cells
        delta = int(of_delta * max(0, grid.delta.size - 1 - boxes))
        part = replace(
            grid,
            alpha=grid.alpha[:, :1],
            beta=grid.beta[:, :1],
            gamma=grid.gamma[gamma : gamma + 2],
            delta=grid.delta[delta : delta + boxes + 1],
            delay=row[:1],
            limit_cells=columns,
            limit_range=np.array([[*row[:4], *(row[4] + (row[5] - row[4]) * ends)]]),
        )
        asked = Plan(replace(plan.spec, products=(ALPHA_LIMITS,)), part)
        whole = min(part.delta.size, asked.deltas_of_a_tile)
        tile = Tile(0, range(whole), 0)
        boxes = len(asked.numbers("delta_cell", tile))
        taken.append((boxes * columns, _timed(asked, tile)[0]))
    (few, quick), (many, slow) = taken
    column = max(0.0, slow - quick) / max(1, many - few)
    return max(0.0, quick - few * column), column


def _of_radii(plan: Plan, share: float) -> tuple[float, float]:
    """Return seconds and bytes of a cell of radii at a share of the way through the delays."""
    grid = plan.grid
    row = grid.radius_range[int(share * (len(grid.radius_range) - 1))]
    alphas, betas = map(min, grid.radius_cells[:2], _RADII)
    cells = alphas, betas, 1, 1
    part = replace(
        grid,
        alpha=grid.alpha[:, :1],
        beta=grid.beta[:, :1],
        delay=row[:1],
        radius_cells=cells,
        radius_range=row[None],
    )
    asked = Plan(replace(plan.spec, products=(SPECTRAL_RADIUS,)), part)
    seconds, stored, _ = min(_timed(asked, asked.tiles[0]) for _ in range(2))
    return seconds / prod(cells), stored / prod(cells)


def _timed(plan: Plan, tile: Tile) -> tuple[float, int, int]:
    """Return the seconds that a tile takes, and the bytes of its nodes' and its cells' values."""
    begin = process_time()
    image = tile_image(plan, tile, key="")
    seconds = process_time() - begin
    stored = [0, 0]
    with h5py.File.in_memory(image_of(image)) as file:
        for name, dataset in file.items():
            of_cells = "gamma_cell" in VARIABLES[name].dimensions
            stored[of_cells] += dataset.id.get_storage_size()
    return seconds, stored[False], stored[True]


def _duration(seconds: float) -> str:
    for unit, length in (("hours", 3600.0), ("minutes", 60.0)):
        if seconds > 2.0 * length:
            return f"{_two_digits(seconds / length)} {unit}"
    return f"{_two_digits(seconds)} seconds"


def _two_digits(value: float) -> str:
    return f"{float(f'{value:.2g}'):g}"


# The resolution that a wish needs: finer and finer atlases, judged by samples of their cells.
#
# The counts along the axes grow together, in the proportion in which each takes part in the error.
# Bounds of limits are second differences over a cell: squares of the sum of what its sides
# contribute; those of radii are cubes of it. The share of cells that a surface passes through is
# itself such a sum.

_OF_ERRORS = "accuracy", "decided"

_LIMITS = {
    "accuracy": (1e-9, 1.0),
    "decided": (0.0, 1.0 - 1e-9),
    "size": (0.0, inf),
    "time": (0.0, inf),
}

_UNITS = {"size": " bytes", "time": " s"}

_FEW, _SOME, _MANY = 3, 6, 40  # parts of a sample: to find the way, of a row, of what is promised

_FAR = 2.0  # spreads from all that is wished for

_NEAR = 0.65  # of a wish: a smaller error is more than was wished for

_AIM = 0.85  # of a wish

_ROUNDS = 7

_LEAST_SHARE = 0.02  # of the error, of an axis

_LEAST_GOAL = 1e-12  # an error

_SCALES = 2.0**-20, 2.0**20  # resolutions, in units of the given one

_LADDER = 0.5, 0.5**0.5, 2.0**0.5  # resolutions beside the chosen one, in units of it


def plan_resolution(
    spec: AtlasSpec,
    *,
    accuracy: float | int | None = None,
    decided: float | int | None = None,
    size: float | int | None = None,
    time: float | int | None = None,
) -> ResolutionPlan:
    """Return the specification of the same range that a wish needs, beside other resolutions.

    The ends of the range, its delays and its products stay. Some cells of each resolution are
    computed and asked: what is said of it is an estimate, while each answer of an atlas is proved.

    Args:
        spec: the range and the products.
        accuracy: bound that 95 % of the upper limits of alpha shall keep, over the largest stable
            alpha at their delay; from 1e-9 to 1.
        decided: share of the range that shall be decided, below 1.
        size: of the file in bytes, at most.
        time: of the build in seconds of CPU time on this machine, at most.

    Raises:
        TypeError: not exactly one wish is given, or it is no number.
        ValueError: it is out of range, or no resolution meets it; at a delay no loop is stable.

    Example:
        >>> hand = {"gamma": (0.0,), "delta": (0.01,), "delay": (1.0,)}
        >>> spec = jaxstab.AtlasSpec(**hand, products=("alpha_limits",))
        >>> jaxstab.plan_resolution(spec, size=100_000).chosen.size < 100_000
        True
    """
    wishes = {"accuracy": accuracy, "decided": decided, "size": size, "time": time}
    name, value = _only_wish({key: wish for key, wish in wishes.items() if wish is not None})
    range_ = _Range(spec, name)
    if name in _OF_ERRORS:
        scale, chosen = range_.of_error(name, value)
    else:
        scale, chosen = range_.of_cost(name, value)
    rows = [range_.given, chosen]
    for step in _LADDER:
        plan = range_.plan_or_none(scale * step)
        if plan and all(plan.spec != row.spec for row in rows):
            rows.append(range_.judged(plan, _SOME))
    rows.sort(key=lambda row: row.size)
    return ResolutionPlan(f"{name} {value:g}", tuple(rows), range_.given, chosen)


def _only_wish(wishes: Mapping[str, float | int]) -> tuple[str, float]:
    if len(wishes) != 1:
        given = " and ".join(wishes) or "nothing"
        raise TypeError(f"{given} is wished for; give one of {', '.join(_LIMITS)}.")
    ((name, value),) = wishes.items()
    return name, checked_number(name, value, *_LIMITS[name])


class _Range:
    """The resolutions of a range along one line, on which all counts grow in proportion.

    Attributes:
        given: the resolution as it was given.
    """

    given: Resolution

    def __init__(self, spec: AtlasSpec, wish: str) -> None:
        self._spec = with_known_nodes(spec)
        self._judge = _judge_of(self._spec, wish)
        begin = process_time()
        self._reach = reach_of(self._spec)
        hands = prod(len(ends_of(getattr(self._spec, name))) for name in HANDS)
        self._region_seconds = (process_time() - begin) / (hands * self._reach.delay.size)
        self._costs: dict[tuple[int, ...], Costs] = {}
        self._of_limits = 1.0  # of the seconds of limits of alpha that its costs say
        self._radii: dict[tuple[Any, ...], Sample] = {}
        first = Plan(self._spec, lay_out(self._spec, self._reach))
        self.given = self.judged(first, _SOME)
        self._counts, self._error = counts_of(self._spec), self._error_of(self.given)
        while self._error == inf:
            self._counts |= {knob: 2 * self._counts[knob] for knob in self._judge.knobs}
            self._error = self._error_of(self.judged(self._plan({}), _SOME))
        self._error = max(self._error, _LEAST_GOAL)

    @cached_property
    def _steps(self) -> dict[str, float]:
        """How many of each count there are at the resolution 1: each takes an equal part then."""
        if len(self._judge.knobs) == 1:
            return {self._judge.knobs[0]: float(self._counts[self._judge.knobs[0]])}
        parts = {}
        whole_error = self._mean_error({})
        for knob in self._judge.knobs:
            ratio = self._mean_error({knob: 2 * self._counts[knob]}) / whole_error
            part = 2.0 * (1.0 - min(1.0, ratio) ** (1.0 / self._judge.power))
            parts[knob] = max(_LEAST_SHARE, part)
        whole = sum(parts.values()) / len(parts)
        return {knob: self._counts[knob] * part / whole for knob, part in parts.items()}

    def plan(self, scale: float) -> Plan:
        """Return the plan of a resolution; ValueError where it is too large for any atlas."""
        steps = self._steps.items()
        counts = {
            knob: max(least_count(self._spec, knob), round(min(step * scale, 2.0**30)))
            for knob, step in steps
        }
        return self._plan(counts)

    def plan_or_none(self, scale: float) -> Plan | None:
        """Return the plan of a resolution, None where its file could not be opened."""
        try:
            plan = self.plan(scale)
        except ValueError:
            return None
        return plan if self.estimate(plan).size <= LARGEST_ARRAY else None

    def estimate(self, plan: Plan) -> Estimate:
        """Return what the build of a plan takes; limits of alpha as at the last resolution seen."""
        return self._costs_of(plan).of(plan, self._of_limits)

    def _costs_of(self, plan: Plan) -> Costs:
        walls = plan.grid.shape[:2]
        if walls not in self._costs:
            costs = costs_of(plan)
            self._costs[walls] = costs._replace(region_seconds=self._region_seconds)
        return self._costs[walls]

    def judged(self, plan: Plan, places: int) -> Resolution:
        """Return what a resolution is like, by so many places of its range, or as will do."""
        return self._row(plan, self._sample(self._judge.product, plan, places), places)

    def _row(self, plan: Plan, sample: Sample, places: int) -> Resolution:
        if SPECTRAL_RADIUS in plan.spec.products:
            of_radii = self._sample(SPECTRAL_RADIUS, plan, places)
            sample = sample._replace(radius_error=of_radii.radius_error)
        if sample.timed.calls:
            calls, columns, seconds = sample.timed
            costs = self._costs_of(plan)
            if places == _MANY:  # wide columns take longer than narrow ones
                call, column = limit_costs(plan)
                costs = costs._replace(call_seconds=call, column_seconds=column)
                self._costs[plan.grid.shape[:2]] = costs
            self._of_limits = seconds / costs.limit_seconds(calls, columns)
        known = sample.limit_error, sample.undecided, sample.radius_error, sample.query_seconds
        return Resolution(plan.spec, counts_of(plan.spec), *known, *self.estimate(plan))

    def _sample(
        self, product: str, plan: Plan, places: int, enough: Enough = has_small_spreads
    ) -> Sample:
        if product == ALPHA_LIMITS:
            return sample_of_limits(plan, self._reach, places, enough)
        if product == VERDICT:
            return sample_of_cells(plan, places // 2)
        key = (plan.grid.radius_cells, len(plan.grid.radius_range), places)
        if key not in self._radii:
            self._radii[key] = sample_of_radii(plan, places // 2)
        return self._radii[key]

    def of_error(self, name: str, value: float | int) -> tuple[float, Resolution]:
        """Return the resolution at which an error is as wished for, and what it is like."""
        wanted = value if name == "accuracy" else 1.0 - value
        scale, error = 1.0, self._error
        met: list[tuple[float, Plan, Sample]] = []
        for _ in range(_ROUNDS):
            scale *= (error / (_AIM * wanted)) ** (1.0 / self._judge.power)
            plan = self.plan_or_none(scale)
            if plan is None:
                raise ValueError(self._refusal(name, value, scale, error))
            shown = partial(self._is_shown, wanted)
            sample = self._sample(self._judge.product, plan, _MANY, shown)
            error = max(self._error_of(sample), _LEAST_GOAL)
            if error <= wanted:
                met.append((scale, plan, sample))
                if error >= _NEAR * wanted or plan.spec == self.plan(_SCALES[0]).spec:
                    break
        if not met:
            raise ValueError(
                f"{name} is {value:g}, and resolutions of this range are too irregular to find one "
                "that reaches it; give a plainer range, or the size of the file."
            )
        scale, plan, sample = min(met, key=lambda one: self.estimate(one[1]).size)
        return scale, self._row(plan, sample, _MANY)

    def of_cost(self, name: str, value: float | int) -> tuple[float, Resolution]:
        """Return the finest resolution that takes no more than is wished for, and what it is like.

        How long its limits of alpha take is known when some of them are computed.
        """
        for number in range(_ROUNDS):
            scale = self.scale_within(name, value, _AIM**number)
            chosen = self.judged(self.plan(scale), _MANY)
            if name == "size" or chosen.seconds <= value:
                break
        return scale, chosen

    def scale_within(self, name: str, value: float | int, aim: float = 1.0) -> float:
        """Return the largest resolution that takes a share of the wished size or time at most."""

        def cost(scale: float) -> float:
            plan = self.plan_or_none(scale)
            if plan is None:
                return inf
            estimate = self.estimate(plan)
            return estimate.size if name == "size" else estimate.seconds

        low, high = _SCALES
        least = cost(low)
        if least > aim * value:
            rounded = float(f"{least:.3g}")
            raise ValueError(
                f"{name} is {value:g}{_UNITS[name]}, and the coarsest atlas of this range takes "
                f"{rounded:,g}{_UNITS[name]}; give more, or fewer products, delays or nodes."
            )
        for _ in range(40):
            middle = (low * high) ** 0.5
            low, high = (middle, high) if cost(middle) <= aim * value else (low, middle)
        return low

    def _plan(self, counts: Mapping[str, int]) -> Plan:
        spec = with_counts(self._spec, {**self._counts, **counts})
        return Plan(spec, lay_out(spec, self._reach))

    def _error_of(self, sample: Sample | Resolution) -> float:
        error: float = getattr(sample, self._judge.goal).value
        return error

    def _is_shown(self, wanted: float, sample: Sample) -> bool:
        """Whether an error is known well, or is clearly not the one that is wished for."""
        value, spread = getattr(sample, self._judge.goal)
        is_finer = value + _FAR * spread < _NEAR * wanted
        return is_finer or value - _FAR * spread > wanted or has_small_spreads(sample)

    def _mean_error(self, counts: Mapping[str, int]) -> float:
        """Return an error that few places show: with limits of alpha, the undecided share.

        A limit's error is half the height of what it leaves undecided.
        """
        sample = self._sample(self._judge.product, self._plan(counts), _FEW)
        error: float = getattr(sample, self._judge.mean).value
        return max(error, _LEAST_GOAL)

    def _refusal(self, name: str, value: float, scale: float, error: float) -> str:
        largest = self.scale_within("size", LARGEST_ARRAY)
        least = error * (scale / largest) ** self._judge.power
        nearest = f"{least:.2g}" if name == "accuracy" else f"{1.0 - least:.6g}"
        return (
            f"{name} is {value:g}, and an atlas of this range that can be opened, with up to "
            f"{LARGEST_ARRAY / 1e9:.1f} GB, reaches about {nearest}; give that, or less range."
        )


class _Judge(NamedTuple):
    """By what the resolutions of a range are judged.

    Attributes:
        product: of which cells are sampled.
        mean: the error that few of them show.
        goal: the error that is to fall.
        knobs: the counts that it depends on.
        power: of its fall.
    """

    product: str
    mean: str
    goal: str
    knobs: Sequence[str]
    power: float


_JUDGES = (
    _Judge(ALPHA_LIMITS, "undecided", "limit_error", (*HANDS, *OF_LIMITS), 2.0),
    _Judge(VERDICT, "undecided", "undecided", (*WALLS, *HANDS), 1.0),
    _Judge(SPECTRAL_RADIUS, "radius_error", "radius_error", (*WALLS, *HANDS), 3.0),
)


def _judge_of(spec: AtlasSpec, wish: str) -> _Judge:
    """Return by what the resolutions of a range are judged for a wish.

    Raises:
        ValueError: the specification has no product to which the wish applies.
    """
    if wish == "accuracy" and ALPHA_LIMITS not in spec.products:
        raise ValueError(f"accuracy is of limits of alpha; add {ALPHA_LIMITS!r} to the products.")
    judge = next((judge for judge in _JUDGES if judge.product in spec.products), None)
    if judge is None or (wish == "decided" and judge.product == SPECTRAL_RADIUS):
        raise ValueError(f"{wish} needs verdicts; add {ALPHA_LIMITS!r} to the products.")
    knobs = tuple(name for name in judge.knobs if not is_fixed(spec, name))
    goal = "undecided" if wish == "decided" else judge.goal
    return judge._replace(goal=goal, knobs=knobs)
