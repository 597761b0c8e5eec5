"""The resolution that a wish needs: finer and finer atlases, judged by samples of their cells.

The counts along the axes grow together, in the proportion in which each takes part in the error.
Bounds of limits are second differences over a cell: squares of the sum of what its sides
contribute; those of radii are cubes of it. The share of cells that a surface passes through is
itself such a sum.
"""

from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from math import inf, prod
from time import process_time
from typing import Any, NamedTuple

from jaxstab.atlas.compute.counts import (
    HANDS,
    OF_LIMITS,
    WALLS,
    counts_of,
    is_fixed,
    least_count,
    with_counts,
    with_known_nodes,
)
from jaxstab.atlas.compute.layout import ends_of, lay_out, reach_of
from jaxstab.atlas.compute.plan import Plan
from jaxstab.atlas.format.schema import ALPHA_LIMITS, LARGEST_ARRAY, SPECTRAL_RADIUS, VERDICT
from jaxstab.atlas.format.spec import AtlasSpec
from jaxstab.atlas.write.estimate import Costs, Estimate, costs_of, limit_costs
from jaxstab.atlas.write.resolution import Resolution, ResolutionPlan
from jaxstab.atlas.write.sampled import (
    Enough,
    Sample,
    has_small_spreads,
    sample_of_cells,
    sample_of_limits,
    sample_of_radii,
)
from jaxstab.numbers import checked_number

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
