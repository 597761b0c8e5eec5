"""Backwards: the values of one quantity with which given gains are stable.

p(z) is affine in two gains, and all stable intervals of these are known (lemma E3 of
docs/proofs.md). Each mass, delay or cut-off makes another plant or filter, and no theorem tells its
crossings of the circle beforehand. So values are scanned, evenly in their logarithm, and every end
is enclosed by halving, between a value that is proved stable and one that is proved unstable (lemma
E1). Windows and steps are whole: all of them are tried. An interval, or a gap, that is narrower
than a step of the scan may be missed; an answer says how many values were tried.

Where a value makes no loop, as a cut-off above half of the sampling rate, an interval ends without
a proof of instability beyond. A root at 1 that a damper alone leaves there, of a device that
nothing holds, does not count: the intervals are those of all other roots.

Of a range of hands those at its corners are scanned. A value at each end, or next to it, is then
proved for all hands in boxes (``loop.hands``); a hand that refutes one joins the corners.
"""

from collections.abc import Callable
from dataclasses import replace
from decimal import ROUND_CEILING, ROUND_FLOOR
from functools import cache, partial
from math import nan
from typing import Any, NamedTuple

import numpy as np

from jaxstab.boxes import HandRange
from jaxstab.conventions import Range, Verdict
from jaxstab.exact import wall_verdict
from jaxstab.loop.hands import HandFamily
from jaxstab.loop.region import Gains
from jaxstab.model.balls import ball_triple
from jaxstab.model.device.device import in_steps
from jaxstab.model.device.parts import FIRST_BITS, MassSpringDamper, Modes, working_precision
from jaxstab.model.filters import Velocity, dividing_periods, sections_of, with_number
from jaxstab.model.plant import DELTA_LIMIT, GAMMA_LIMIT, LONGEST_DELAY
from jaxstab.numbers import checked_count, checked_word, two_ends
from jaxstab.shown import number_text

UNITS = {
    "device_mass": "kg",
    "device_damping": "N s/m",
    "hand_mass": "kg",
    "hand_damping": "N s/m",
    "hand_stiffness": "N/m",
    "sample_time": "s",
    "delay": "s",
    "cutoff": "Hz",
    "window": "samples",
}
"""The quantities of a held device and its controller, and their units."""

_ROBOT = {"environment": "N/m", "stiffness": "N/m", "delay_samples": "samples"}
_WHOLE = {"delay_samples": 0, "substeps": 1, "delay_steps": 0}  # from which value on
_STEPS = {"step": "s", "substeps": "steps", "delay_steps": "steps"}
_JOINT = {"inertia": "kg m^2", "damping": "N m s/rad", "stiffness": "N m/rad", **_STEPS}


class StableEnd(NamedTuple):
    """The last stable value, and the first one beyond that is unstable: each proved.

    The second is NaN where the scan ends, and where values beyond make no loop.

    Example:
        >>> jaxstab.results.StableEnd(stable=12.0, unstable=13.0).stable
        12.0
    """

    stable: float
    unstable: float


class StableValues(NamedTuple):
    """The intervals of a quantity that a scan found stable, from the lowest to the highest.

    Attributes:
        quantity: its name.
        unit: its unit.
        intervals: the low and the high end of each. The two sides of an end are less than 1e-9 of
            it apart, or neighbours where values are whole.
        between: the lowest and the highest value tried.
        tried: how many were.
        is_complete: whether these are all that there are.
        is_proved: whether the stable side of each end is proved, for all hands where there is a
            range of them; it then lies inside of what the hands that were tried allow. Else no hand
            that was tried refutes it.
        drift: whether nothing holds the position: the intervals are those of all other roots.

    Example:
        >>> joint = jaxstab.HapticLoop(
        ...     device_mass=1.0, device_damping=0.0, sample_time=2e-3, delay=2e-3
        ... )
        >>> found = joint.range_of("device_mass", 40.0, 2.0)
        >>> found.largest == found.between[1]  # the scan ends, not what is stable
        True
        >>> print(f"{found.least:.8g} kg, {found.scan}")
        0.0051069302 kg, no other end found by a scan of 5,000 values from 4e-06 to 4000 kg
    """

    quantity: str
    unit: str
    intervals: tuple[tuple[StableEnd, StableEnd], ...]
    between: Range
    tried: int
    is_complete: bool
    is_proved: bool = True
    drift: bool = False

    @property
    def least(self) -> float:
        """The lowest stable value; NaN if none is."""
        return self.intervals[0][0].stable if self.intervals else nan

    @property
    def largest(self) -> float:
        """The highest stable value; NaN if none is."""
        return self.intervals[-1][1].stable if self.intervals else nan

    @property
    def scan(self) -> str:
        """The values that were tried, in words."""
        low, high = (number_text(end, 4) for end in self.between)
        found = "no other end found by" if self.intervals else "none found by"
        words = "of all" if self.is_complete else f"{found} a scan of"
        return f"{words} {self.tried:,} values from {low} to {high} {self.unit}".rstrip()

    def __repr__(self) -> str:
        lines = list[str]()
        for low, high in self.intervals:
            text = number_text(low.stable, 10, ROUND_CEILING)
            if low.stable != high.stable:
                text += f" to {number_text(high.stable, 10, ROUND_FLOOR)}"
            lines.append(f"  {text} {self.unit}".rstrip())
        doubt = [] if self.is_proved else ["  not proved for every hand"]
        exception = ", but for the position, which nothing holds" if self.drift else ""
        head = f"StableValues of {self.quantity}{exception}:"
        return "\n".join([head, *(lines or ["  none"]), *doubt, f"  {self.scan}"])


class Sweep(NamedTuple):
    """Values to try in their order, and whether there are no others."""

    values: list[float]
    is_complete: bool = False

    @classmethod
    def of(cls, low: float, high: float, count: int, *before: float) -> "Sweep":
        """Some values, and others between two ends, evenly in their logarithm, or from 0 on."""
        spread = np.geomspace if low > 0.0 else np.linspace
        return cls([*before, *spread(low, high, count - len(before)).tolist()])

    def within(self, between: Range | None, count: int) -> "Sweep":
        """The scan in other limits, if these are given."""
        if between is None:
            return self
        low, high = two_ends("between", between, 0.0)
        kept = [value for value in self.values if low <= value <= high]
        if not low < high or (self.is_complete and not kept):
            raise ValueError(f"between is {between}; give the lowest value, and a higher one.")
        return Sweep(kept, is_complete=True) if self.is_complete else Sweep.of(low, high, count)


def stable_values(
    named: tuple[str, str], scan: Sweep, judge: Callable[[float], Verdict], known: Any = None
) -> StableValues:
    """The stable intervals of a quantity of some name and unit; ValueError: no value makes a loop.

    Verdicts on the scan that are ``known`` only suggest.
    """
    refusals: list[ValueError] = []

    @cache
    def judged(value: float) -> Verdict:
        try:
            return judge(value)
        except ValueError as error:
            refusals.append(error)
            return Verdict.NOT_COMPUTED

    def end(index: int, step: int) -> StableEnd:
        close, (stable, beyond) = 2.0**-40, (values[index], values[index])
        if 0 <= index + step < len(values):
            beyond = values[index + step]
        while not scan.is_complete and abs(beyond - stable) > close * max(stable, beyond):
            middle = 0.5 * (stable + beyond)
            code = judged(middle) if middle > tiny else Verdict.UNDECIDED
            if code == Verdict.UNDECIDED:
                break
            stable, beyond = (middle, beyond) if code == Verdict.STABLE else (stable, middle)
        return StableEnd(stable, beyond if judged(beyond) == Verdict.UNSTABLE else nan)

    values, intervals = scan.values, []
    tiny = 2.0**-80 * max(map(abs, values))  # so near 0 nothing is enclosed
    pairs = zip(values, known or [Verdict.UNDECIDED] * len(values), strict=True)
    codes = [judged(value) if code == Verdict.UNDECIDED else code for value, code in pairs]
    if len(refusals) == len(values):
        raise refusals[0]
    edges = np.flatnonzero(np.diff(np.pad(np.equal(codes, Verdict.STABLE), 1)))
    for first, behind in edges.reshape(-1, 2).tolist():
        low, high = end(first, -1), end(behind - 1, 1)
        if judged(low.stable) == judged(high.stable) == Verdict.STABLE:
            intervals.append((low, high))
    ends = values[0], values[-1]
    return StableValues(*named, tuple(intervals), ends, len(values), scan.is_complete)


# ----------------------------------------------------------------------------------- held devices
def range_of(
    loop: Any,
    quantity: str,
    wall: Gains,
    *,
    hands: HandRange | None = None,
    mass: Range | None = None,
    between: Range | None = None,
    count: int | None = None,
    in_samples: bool = False,
) -> StableValues:
    """The values of a quantity with which a wall is stable; a delay ``in_samples`` goes with T."""
    rounds = 4  # in which hands join the corners
    checked_word("quantity", quantity, UNITS)
    varied = {"hand" if hands else "", "device_mass" if mass else ""}
    if (mass and not hands) or varied & {quantity, quantity.partition("_")[0]}:
        raise ValueError(f"quantity is {quantity!r} beside a range of it, or mass without hands.")
    change = partial(_changed, quantity, in_samples)
    every: Any = None if hands is None else HandFamily(loop, hands, mass)
    loops = [loop] if every is None else every.corners
    is_of_mechanics = quantity.partition("_")[0] in ("device", "hand")  # p(z) keeps its degree
    at_once = is_of_mechanics and loop.device is None and wall.stiffness != 0.0
    tried = (5000 if at_once else 500) if count is None else checked_count("count", count, 2)
    may_drift = wall.stiffness == 0.0 and quantity != "hand_stiffness"
    scan = _scan(loop, quantity, wall, tried).within(between, tried)
    if is_of_mechanics and loop.device is None:
        scan = _held(loops, quantity, scan)

    @cache  # a hand that joins leaves the verdicts on the others
    def verdict(each: Any, value: float) -> Verdict:
        triple = partial(ball_triple, change(each, value))
        return wall_verdict(triple, *wall, may_drift=may_drift).verdict

    def judge(value: float) -> Verdict:
        codes = []
        for each in [*loops]:
            codes.append(verdict(each, value))
            if codes[-1] == Verdict.UNSTABLE:
                loops.remove(each)
                loops.insert(0, each)  # it mostly refutes the next value as well
                return Verdict.UNSTABLE
        return max(codes)

    @cache  # and the proofs of ends that it does not move
    def worst(value: float) -> Any:
        return replace(every, loop=change(loop, value)).worst(*wall)

    def scanned() -> StableValues:
        known = _verdicts(loops, quantity, wall, scan) if at_once else None
        found = stable_values((quantity, UNITS[quantity]), scan, judge, known)
        stable = [change(each, found.least) for each in loops if may_drift and found.intervals]
        with working_precision(FIRST_BITS):
            drift = any(ball_triple(own).at(*wall).at_one for own in stable)
        return found._replace(drift=drift)

    if every is None:
        return scanned()
    for is_last in [*[False] * rounds, True]:
        found, refuting = _for_all(scanned(), worst, is_last=is_last)
        if found.is_proved or not refuting:
            return found
        loops += refuting
    found = scanned()
    return found._replace(is_proved=not found.intervals)


def _for_all(
    found: StableValues, worst: Callable[[float], Any], *, is_last: bool = False
) -> tuple[StableValues, list[Any]]:
    """The intervals with ends that are proved for all hands, or the hands that refute some.

    The last time ends that are refuted move inwards as those do that are not decided.
    """
    shares = (0.0,) if found.is_complete else (0.0, 1e-6, 1e-4, 1e-2, 0.05)  # of an end, inwards
    intervals, is_proved, refuting = [], True, list[Any]()
    for low, high in found.intervals:
        ends = list[StableEnd]()
        for own, way in ((low, 1.0), (high, -1.0)):
            for share in shares:
                value = own.stable * (1.0 + way * share)
                value = min(max(value, (ends or [low])[0].stable), high.stable)
                hand = worst(value)
                if hand.verdict == Verdict.UNSTABLE:
                    refuting.append(hand.loop)
                if hand.verdict == Verdict.STABLE or (refuting and not is_last):
                    break
            is_proved &= hand.verdict == Verdict.STABLE
            ends.append(own._replace(stable=value))
        intervals.append((ends[0], ends[1]))
    return found._replace(intervals=tuple(intervals), is_proved=is_proved), refuting


def _held(loops: list[Any], quantity: str, scan: Sweep) -> Sweep:
    """The values of a scan at which loops of one mass are within what can be computed."""
    values = np.array(scan.values)
    are_held = np.full(values.shape, quantity != "device_mass") | (values > 0.0)
    for each in loops:
        own = replace(each, **{quantity: values[are_held]})
        are_held[are_held] = (own.gamma <= GAMMA_LIMIT) & (own.delta <= DELTA_LIMIT)
    return scan._replace(values=values[are_held | (values == 0.0)].tolist() or scan.values)


def _verdicts(loops: list[Any], quantity: str, wall: Gains, scan: Sweep) -> Any:
    """Verdicts on a scan, all at once."""
    no_mass = int(quantity == "device_mass" and scan.values[0] == 0.0)  # makes no loop
    values = np.array(scan.values[no_mass:])
    codes = [np.asarray(replace(each, **{quantity: values}).verdict(*wall)) for each in loops]
    is_unstable = np.any(np.equal(codes, Verdict.UNSTABLE), axis=0)
    found = np.where(is_unstable, Verdict.UNSTABLE, np.max(codes, axis=0)).tolist()
    return [Verdict.UNDECIDED] * no_mass + found


def _scan(loop: Any, quantity: str, wall: Gains, count: int) -> Sweep:
    """The values to try: around those at which numbers such as K T^2/m are of size 1."""
    most = 128.0  # samples of delay, where it is not longer now
    period, (spring, damper), counts = loop.sample_time, map(abs, wall), range(1, 201)
    body = loop.device and in_steps(loop.device)
    whole: list[float] | None = [float(n) for n in counts] if quantity == "window" else None
    if quantity == "delay":
        most = min(max(most, 2.0 * loop.delay_samples), LONGEST_DELAY) * period
        whole = [n * body.step for n in range(round(most / body.step) + 1)] if body else None
    elif quantity == "sample_time":  # few have whole samples in a window in s, or whole steps
        periods = dividing_periods(sections_of(loop.velocity, loop.position))
        whole = [n * body.step for n in counts] if body else None
        whole = periods[::-1] if periods else whole
    if whole:
        return Sweep(whole, is_complete=True)
    damping, stiffness = loop.damping(1.0), loop.stiffness(1.0)
    mass = max(spring * period**2, damper * period) or damping * period
    low = 1e-3
    if quantity == "device_mass" and loop.body:  # below, it swings above half of the sampling rate
        low = max(low, loop.body.stiffness * period**2 / mass / 10.0)
    size, low, high = {
        "mass": (mass, low, 1e6),
        "damping": (max(damper, spring * period, damping), 1e-7, 1e2),
        "stiffness": (max(spring, stiffness), 1e-7, 5.0),
        "cutoff": (1.0 / period, 1e-4, 1e2),
        "delay": (period, 1e-2, most / period),
        "time": (period, max(2.0**-10, loop.delay_samples / most), 2.0**10),
    }[quantity.rpartition("_")[2]]
    zero = [] if quantity in ("device_mass", "sample_time", "cutoff") else [0.0]
    return Sweep.of(low * size, high * size, count, *zero)


def _changed(quantity: str, in_samples: bool, loop: Any, value: float) -> Any:
    """The loop with another value of a quantity."""
    if quantity in ("cutoff", "window"):
        velocity = loop.velocity or Velocity()
        return replace(loop, velocity=with_number(velocity, quantity, value))
    if quantity == "sample_time" and in_samples:
        return replace(loop, sample_time=value, delay=loop.delay_samples * value)
    if loop.device is None or quantity in ("sample_time", "delay"):
        return replace(loop, **{quantity: value})
    owner, _, name = quantity.partition("_")
    body = loop.device.mechanism
    if owner != "device" or not isinstance(body, MassSpringDamper | Modes) or body.mass is None:
        raise ValueError(
            f"quantity is {quantity!r}, which the device ({loop.device}) does not have as one "
            "number; give numbers of one mass, or a device that is a mass with or without modes."
        )
    changed: Any = {name: value}
    return replace(loop, device=replace(loop.device, mechanism=replace(body, **changed)))


# --------------------------------------------------------------------------- any loop of two gains
def range_of_number(
    loop: Any, quantity: str, pair: Gains, between: Range | None, count: int
) -> StableValues:
    """The values of a number of a loop, of its device or engine, with which gains are stable."""
    given = loop.made.keywords if loop.made else {}
    held = given["loop"].in_floats() if "loop" in given else None
    units = UNITS | (_JOINT if "inertia" in given else _ROBOT)
    numbers = {
        name: value
        for name, value in (given if held is None else vars(held)).items()
        if isinstance(value, int | float | np.number) and name in units
    }
    if not numbers:
        raise ValueError(f"quantity is {quantity!r}, but {loop.words} have no number that varies.")
    now = float(numbers[checked_word("quantity", quantity, numbers)])
    # What is 0 now is scanned around what acts like it.
    alike = {"stiffness": pair.stiffness, "damping": pair.damping, "delay": loop.sample_time}
    size = now or numbers.get("environment") or abs(alike.get(quantity, 0.0)) or 1.0
    others = Sweep.of(1e-4 * size, 1e4 * size, checked_count("count", count, 2) - 1).values
    scan = Sweep(sorted([now, *others]))
    if quantity in _WHOLE:
        scan = Sweep([float(n) for n in range(_WHOLE[quantity], 201)], is_complete=True)

    def judge(value: float) -> Verdict:
        number = int(value) if quantity in _WHOLE else value
        changed = {"loop": replace(held, **{quantity: value})} if held else {quantity: number}
        verdict: Verdict = loop.made(**changed)._verdict(*pair)
        return verdict

    return stable_values((quantity, units[quantity]), scan.within(between, count), judge)
