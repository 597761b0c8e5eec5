"""Loops of two rates: forces that a slow thread computes, and those of the haptic rate.

A slow gain is affine in p(z) of a frame (``model.frames``): all its stable values beside a given
fast gain are known and proved. Where both gains are slow they are so together, and the loop is a
``Loop`` like any other, with its region, limits and margins. The largest value of both gains, one
of them fast, is searched: the fast one is scanned, each row of the slow one is proved.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from math import floor, inf, isfinite, nan
from typing import Any, NamedTuple

import numpy as np

from jaxstab.conventions import Verdict
from jaxstab.exact import StableLine
from jaxstab.exact.floats import highest
from jaxstab.exact.line import stable_pencil
from jaxstab.exact.roots import wall_verdict
from jaxstab.loop.affine import Loop
from jaxstab.loop.loop import HapticLoop
from jaxstab.model.balls import Factored, Triple
from jaxstab.model.device.parts import flint
from jaxstab.model.filters import behind_measured
from jaxstab.model.frames import ForcePath, FrameParts
from jaxstab.model.gain import Gain
from jaxstab.numbers import checked_count, checked_number, checked_word, require_kind
from jaxstab.shown import Printed, number_text, shortened, stable_pair

_GAINS = Gain("stiffness", "N/m"), Gain("damping", "N s/m")
_MOST = 200  # of a frame, and of a delay
_ROWS = 40  # of a scan, on a scale of numbers and on one of logarithms each
_STEPS = 50  # of golden sections, and of halving


class RateLimits(NamedTuple):
    """The largest stiffness and damping of a loop of two rates, each with the other one there.

    Each row of the slow gain is proved, and each pair is stable with the digits that are printed;
    that no row between those that were tried has a larger gain is not proved. NaN if no row has
    stable gains.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
        >>> jaxstab.two_rates(loop, 5, slow="damping").limits()
        RateLimits: searched over rows
          largest  stiffness = 11666... N/m at damping = 25.45... N s/m
          largest  damping = 100.1... N s/m at stiffness = ... N/m
    """

    stiffness: float
    at_damping: float
    damping: float
    at_stiffness: float

    def __repr__(self) -> str:
        if not isfinite(self.stiffness):
            return "RateLimits: no stable gains were found"
        stiffness, at_damping, damping, at_stiffness = (number_text(x, 6) for x in self)
        return (
            "RateLimits: searched over rows\n"
            f"  largest  stiffness = {stiffness} N/m at damping = {at_damping} N s/m\n"
            f"  largest  damping = {damping} N s/m at stiffness = {at_stiffness} N/m"
        )


@dataclass(frozen=True, repr=False)
class TwoRates:
    """A wall whose stiffness, or damping, is computed once a frame, and the other at each sample.

    ``jaxstab.two_rates`` makes it.

    Source: lemma F1 of docs/proofs.md.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
        >>> jaxstab.two_rates(loop, 5, slow="stiffness")
        TwoRates: stiffness once in 5 samples, damping at each
    """

    parts: FrameParts
    slow: str
    fast: HapticLoop  # of one rate, whose limits tell how far to scan

    @property
    def _fast(self) -> str:
        return "damping" if self.slow == "stiffness" else "stiffness"

    def __repr__(self) -> str:
        return f"TwoRates: {self.slow} once in {self.parts.every} samples, {self._fast} at each"

    def verdict(self, stiffness: float, damping: float) -> Verdict:
        """Whether a wall is stable, K in N/m and B in N s/m: proved, or UNDECIDED.

        Raises: see ``jaxstab.conventions``.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
            >>> jaxstab.two_rates(loop, 5, slow="stiffness").verdict(8000.0, 20.0).name
            'STABLE'
        """
        gains = {
            "stiffness": checked_number("stiffness", stiffness),
            "damping": checked_number("damping", damping),
        }
        fast = gains[self._fast]

        def triple() -> Triple:
            base, by_slow = self.parts.pencil(self.slow, fast)
            return Triple(base, by_slow, Factored(flint.arb_poly([])))

        return wall_verdict(triple, gains[self.slow], 0.0).verdict

    def intervals(
        self, *, stiffness: float | None = None, damping: float | None = None
    ) -> StableLine:
        """All stable values of the slow gain at a value of the fast one: proved.

        Args:
            stiffness: K in N/m, where the damping is slow.
            damping: B in N s/m, where the stiffness is slow.

        Raises: see ``jaxstab.conventions``; TypeError if it is not the fast gain that is given.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
            >>> row = jaxstab.two_rates(loop, 5, slow="stiffness").intervals(damping=20.0)
            >>> [(low.told, round(high.value, 4)) for low, high in row.intervals]
            [(0.0, 8490.0242)]
        """
        given, fast = {"stiffness": stiffness, "damping": damping}, self._fast
        if given[fast] is None or given[self.slow] is not None:
            raise TypeError(f"intervals are those of the {self.slow}, which is slow; give {fast}.")
        return self._row(checked_number(fast, given[fast]))

    def limits(self) -> RateLimits:
        """The largest stiffness and damping >= 0 that a scan of the fast gain finds.

        Raises: as ``HapticLoop.limits``, of the loop of one rate.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
            >>> late = jaxstab.two_rates(loop, 5, slow="stiffness", slow_delay=5e-3)
            >>> round(late.limits().stiffness) > 2948
            True
        """
        limits = self.fast.limits()
        most = 2.0 * (limits.damping if self.slow == "stiffness" else limits.stiffness)
        if not isfinite(most):
            return RateLimits(nan, nan, nan, nan)

        def top(fast: float) -> float:
            ends = [high.value - high.error for _, high in self._row(fast).intervals]
            return max((end for end in ends if 0.0 <= end < inf), default=-inf)

        places = np.r_[0.0, np.geomspace(1e-6 * most, most, _ROWS), np.linspace(0.0, most, _ROWS)]
        places = np.unique(places)
        tops = np.array([top(place) for place in places.tolist()])
        stable = np.flatnonzero(tops > -inf)
        if not stable.size:
            return RateLimits(nan, nan, nan, nan)
        best = int(np.argmax(tops))
        low, high = places[max(best - 1, 0)], places[min(best + 1, len(places) - 1)]
        found = highest(top, float(low), float(high), _STEPS)
        _, at_fast = max(found, (float(tops[best]), float(places[best])))
        last = _last(top, places, int(stable[-1]))

        def is_stable(slow: float, fast: float) -> bool:
            return self._row(fast).holding(slow) is not None

        of_slow = of_fast = nan, nan
        for back in (1e-2, 1e-3, 1e-4, 1e-6, 0.0):  # the narrower a tip, the more digits
            near = at_fast * (1.0 - back)
            pair = stable_pair(top(near), near, (6, 6), is_stable)
            of_slow = pair if isinstance(pair[0], Printed) else of_slow
            fast = last * (1.0 - back)
            pair = stable_pair(fast, top(fast), (6, 6), lambda fast, slow: is_stable(slow, fast))
            of_fast = pair if isinstance(pair[0], Printed) else of_fast
        return (
            RateLimits(*of_slow, *of_fast)
            if self.slow == "stiffness"
            else RateLimits(*of_fast, *of_slow)
        )

    def _row(self, fast: float) -> StableLine:
        return stable_pencil(partial(self.parts.pencil, self.slow, fast))


def _last(top: Callable[[float], float], places: Any, stable: int) -> float:
    """The largest place with stable gains beside it, by halving beyond the last one that has."""
    low, high = places[stable], places[min(stable + 1, len(places) - 1)]
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if top(float(middle)) > -inf else (low, middle)
    return float(low)


def two_rates(
    loop: HapticLoop,
    every: int | float,
    *,
    slow: str = "both",
    slow_delay: float = 0.0,
    ramp: bool = False,
    velocity: str = "slow",
) -> Loop | TwoRates:
    """A wall of which one gain, or both, are computed once in some samples of the loop.

    The physics thread of a simulation may compute the contact force at 60 to 200 Hz, and a damper
    run at the haptic rate, or in the drive. Proved are whole ratios of both rates alone; of another
    one ask those next to it, which is no proof.

    Args:
        loop: the fast loop, a ``HapticLoop``; its delay is that of the fast force.
        every: samples of a frame: the slow rate is that much lower.
        slow: what the slow thread computes: "stiffness", "damping" or "both".
        slow_delay: from its reading to its action in s, a whole number of samples.
        ramp: True for a slow force that goes to its new value in ``every`` stairs.
        velocity: of a slow damping, "slow" for the loop's estimator at the slow rate, "fast" for
            one that runs at each sample and is read once a frame. The position filter runs at the
            rate of the stiffness.

    Returns:
        A ``Loop`` of the gains ``stiffness`` and ``damping`` if both are slow, whose samples are
        frames; else ``TwoRates``, with verdicts, rows of the slow gain and limits.

    Raises: see ``jaxstab.conventions``; ValueError also for a ratio or a delay that is not whole,
    for a fast delay without a fast force, and for a measured velocity.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008), of a frame; lemma F1 of docs/proofs.md.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
        >>> row = jaxstab.two_rates(loop, 5, slow_delay=1e-3).intervals(damping=5.0)
        >>> [(low.told, round(high.value, 4)) for low, high in row.intervals]
        [(0.0, 1318.1965)]
        >>> row = jaxstab.two_rates(loop, 5, slow="damping").intervals(stiffness=2000.0)
        >>> [(round(low.value, 4), round(high.value, 4)) for low, high in row.intervals]
        [(1.0165, 90.5128)]
    """
    require_kind("loop", loop, HapticLoop)
    plain = loop.in_floats()
    checked_word("slow", slow, ("both", "stiffness", "damping"))
    checked_word("velocity", velocity, ("slow", "fast"))
    ratio = checked_number("every", every, 1.0, float(_MOST))
    if ratio != round(ratio):
        raise ValueError(
            f"every is {ratio:g}; give a whole number of samples: of another ratio ask for its "
            f"neighbours, {floor(ratio)} and {floor(ratio) + 1}, which is no proof."
        )
    every = round(ratio)
    if not isinstance(ramp, bool):
        raise TypeError(f"ramp is {shortened(ramp)}; give True or False.")
    if plain.velocity is not None and behind_measured(plain.velocity) is not None:
        raise ValueError(
            "the velocity of the loop is measured by the device; of two rates give an estimator."
        )
    late = _samples("slow_delay", checked_number("slow_delay", slow_delay, 0.0, unit="s"), plain)
    fast = _samples("the delay of the loop", float(plain.delay), plain)
    if slow == "both" and fast:
        raise ValueError(
            f"the delay of the loop is {plain.delay:g} s, but no force is fast; give it as "
            "slow_delay."
        )
    if slow == "stiffness" and velocity == "fast":
        raise ValueError('velocity is "fast", as the damping is; leave it out.')
    rates = {
        "stiffness": ForcePath(True, late, ramp),
        "damping": ForcePath(True, late, ramp, is_fast_inside=velocity == "fast"),
    }
    for name in rates:
        if slow not in (name, "both"):
            rates[name] = ForcePath(False, fast)
    parts = FrameParts(replace(plain, delay=0.0), every, **rates)
    if slow != "both":
        return TwoRates(parts, slow, plain)
    made = partial(
        two_rates, loop=plain, every=every, slow_delay=slow_delay, ramp=ramp, velocity=velocity
    )
    words = f"a wall computed once in {every} samples"
    return Loop(parts, _GAINS, every * float(plain.sample_time), words, made=made)


def _samples(name: str, delay: float, loop: HapticLoop) -> int:
    """A delay in whole samples; ValueError."""
    close = 1e-9
    samples = delay / float(loop.sample_time)
    if abs(samples - round(samples)) > close * max(samples, 1.0):
        raise ValueError(
            f"{name} is {delay:g} s, {samples:g} samples of {loop.sample_time:g} s; give a whole "
            "number of samples."
        )
    return checked_count(f"{name} in samples", round(samples), 0, _MOST)
