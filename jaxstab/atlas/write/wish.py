"""The resolution that a wish needs: finer and finer atlases, judged by samples of their cells.

The counts along the axes grow together, in the proportion in which each takes part in the error.
Bounds of limits are second differences over a cell: squares of the sum of what its sides
contribute; those of radii are cubes of it. The share of cells that a surface passes through is
itself such a sum.
"""

from collections.abc import Mapping
from functools import cached_property
from math import inf
from typing import Any

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
from jaxstab.atlas.compute.layout import lay_out, reach_of
from jaxstab.atlas.compute.plan import Plan
from jaxstab.atlas.format.schema import ALPHA_LIMITS, LARGEST_ARRAY, SPECTRAL_RADIUS, VERDICT
from jaxstab.atlas.format.spec import AtlasSpec
from jaxstab.atlas.write.estimate import Costs, Estimate, costs_of
from jaxstab.atlas.write.resolution import Resolution, ResolutionPlan
from jaxstab.atlas.write.sampled import (
    Measured,
    Sample,
    sample_of_cells,
    sample_of_limits,
    sampled_radius_error,
)
from jaxstab.numbers import checked_number

_GOALS = {"accuracy": "limit_error", "decided": "undecided"}
_LIMITS = {
    "accuracy": (1e-9, 1.0),
    "decided": (0.0, 1.0 - 1e-9),
    "size": (0.0, inf),
    "time": (0.0, inf),
}
_UNITS = {"size": " bytes", "time": " s"}

_FEW, _MANY = 8, 40  # places of a sample: to find the way, and of what is promised
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
    if name in _GOALS:
        scale, chosen = range_.of_error(name, value)
    else:
        scale = range_.scale_within(name, value)
        chosen = range_.judged(range_.plan(scale), _MANY)
    rows = [range_.given, chosen]
    for step in _LADDER:
        plan = range_.plan_or_none(scale * step)
        if plan and all(plan.spec != row.spec for row in rows):
            rows.append(range_.judged(plan, _FEW))
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
        self._goal, self._knobs, self._power = _goal(self._spec, wish)
        self._reach = reach_of(self._spec)
        self._costs: dict[tuple[int, ...], Costs] = {}
        self._radii: dict[tuple[Any, ...], Measured] = {}
        first = Plan(self._spec, lay_out(self._spec, self._reach))
        self.given = self.judged(first, _FEW)
        self._counts, self._error = counts_of(self._spec), self._error_of(self.given)
        while self._error == inf:
            self._counts |= {knob: 2 * self._counts[knob] for knob in self._knobs}
            self._error = self._error_of(self.judged(self._plan({}), _FEW))
        self._error = max(self._error, _LEAST_GOAL)

    @cached_property
    def _steps(self) -> dict[str, float]:
        """How many of each count there are at the resolution 1: each takes an equal part then."""
        if len(self._knobs) == 1:
            return {self._knobs[0]: float(self._counts[self._knobs[0]])}
        parts = {}
        whole_error = self._mean_error({})
        for knob in self._knobs:
            ratio = self._mean_error({knob: 2 * self._counts[knob]}) / whole_error
            part = 2.0 * (1.0 - min(1.0, ratio) ** (1.0 / self._power))
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
        """Return what the build of a plan takes."""
        walls = plan.grid.shape[:2]
        if walls not in self._costs:
            self._costs[walls] = costs_of(plan)
        return self._costs[walls].of(plan)

    def judged(self, plan: Plan, places: int) -> Resolution:
        """Return what a resolution is like, by so many places of its range."""
        sample, products = Sample(), plan.spec.products
        if ALPHA_LIMITS in products:
            sample = sample_of_limits(plan, self._reach, places)
        elif VERDICT in products:
            sample = sample_of_cells(plan, places // 2)
        if SPECTRAL_RADIUS in products:
            key = (plan.grid.radius_cells, len(plan.grid.radius_range), places)
            if key not in self._radii:
                self._radii[key] = sampled_radius_error(plan, places // 2)
            sample = sample._replace(radius_error=self._radii[key])
        return Resolution(plan.spec, counts_of(plan.spec), *sample, *self.estimate(plan))

    def of_error(self, name: str, value: float | int) -> tuple[float, Resolution]:
        """Return the resolution at which an error is as wished for, and what it is like."""
        wanted = value if name == "accuracy" else 1.0 - value
        scale, error, places = 1.0, self._error, _FEW
        met: list[tuple[float, Resolution]] = []
        for _ in range(_ROUNDS):
            scale *= (error / (_AIM * wanted)) ** (1.0 / self._power)
            plan = self.plan_or_none(scale)
            if plan is None:
                raise ValueError(self._refusal(name, value, scale, error))
            chosen = self.judged(plan, places)
            error = max(self._error_of(chosen), _LEAST_GOAL)
            if places == _MANY and error <= wanted:
                met.append((scale, chosen))
                if error >= _NEAR * wanted or plan.spec == self.plan(_SCALES[0]).spec:
                    break
            places = _MANY
        if not met:
            raise ValueError(
                f"{name} is {value:g}, and resolutions of this range are too irregular to find one "
                "that reaches it; give a plainer range, or the size of the file."
            )
        return min(met, key=lambda one: one[1].size)

    def scale_within(self, name: str, value: float | int) -> float:
        """Return the largest resolution whose file, or build, is not larger than wished for."""

        def cost(scale: float) -> float:
            plan = self.plan_or_none(scale)
            if plan is None:
                return inf
            estimate = self.estimate(plan)
            return estimate.size if name == "size" else estimate.seconds

        low, high = _SCALES
        least = cost(low)
        if least > value:
            rounded = float(f"{least:.3g}")
            raise ValueError(
                f"{name} is {value:g}{_UNITS[name]}, and the coarsest atlas of this range takes "
                f"{rounded:,g}{_UNITS[name]}; give more, or fewer products, delays or nodes."
            )
        for _ in range(40):
            middle = (low * high) ** 0.5
            low, high = (middle, high) if cost(middle) <= value else (low, middle)
        return low

    def _plan(self, counts: Mapping[str, int]) -> Plan:
        spec = with_counts(self._spec, {**self._counts, **counts})
        return Plan(spec, lay_out(spec, self._reach))

    def _error_of(self, row: Resolution) -> float:
        error: float = getattr(row, self._goal).value
        return error

    def _mean_error(self, counts: Mapping[str, int]) -> float:
        """Return an error that few places show: with limits of alpha, the undecided share.

        A limit's error is half the height of what it leaves undecided.
        """
        plan = self._plan(counts)
        if ALPHA_LIMITS in plan.spec.products:
            error = sample_of_limits(plan, self._reach, _FEW).undecided.value
        elif VERDICT in plan.spec.products:
            error = sample_of_cells(plan, _FEW).undecided.value
        else:
            error = sampled_radius_error(plan, _FEW).value
        return max(float(error), _LEAST_GOAL)

    def _refusal(self, name: str, value: float, scale: float, error: float) -> str:
        largest = self.scale_within("size", LARGEST_ARRAY)
        least = error * (scale / largest) ** self._power
        nearest = f"{least:.2g}" if name == "accuracy" else f"{1.0 - least:.6g}"
        return (
            f"{name} is {value:g}, and an atlas of this range that can be opened, with up to "
            f"{LARGEST_ARRAY / 1e9:.1f} GB, reaches about {nearest}; give that, or less range."
        )


def _goal(spec: AtlasSpec, wish: str) -> tuple[str, list[str], float]:
    """Return which error is to fall, the counts that it depends on and the power of its fall.

    Raises:
        ValueError: the specification has no product to which the wish applies.
    """
    if wish == "accuracy" and ALPHA_LIMITS not in spec.products:
        raise ValueError(f"accuracy is of limits of alpha; add {ALPHA_LIMITS!r} to the products.")
    if ALPHA_LIMITS in spec.products:
        goal, knobs, power = _GOALS.get(wish, "limit_error"), (*HANDS, *OF_LIMITS), 2.0
    elif VERDICT in spec.products:
        goal, knobs, power = "undecided", (*WALLS, *HANDS), 1.0
    elif SPECTRAL_RADIUS in spec.products and wish != "decided":
        goal, knobs, power = "radius_error", (*WALLS, *HANDS), 3.0
    else:
        raise ValueError(f"{wish} needs verdicts; add {ALPHA_LIMITS!r} to the products.")
    return goal, [name for name in knobs if not is_fixed(spec, name)], power
