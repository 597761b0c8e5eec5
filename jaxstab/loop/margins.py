"""Margins of a wall: the changes of stiffness, damping or delay before it loses stability.

One quantity is changed, starting from a wall that is proved stable. Along a gain all stable
intervals are known (``exact.line``), and the one that holds the wall counts; along the delay, the
first root on the circle (``exact.margins``, lemma B5 of docs/proofs.md).

In the language of frequency, margins say how far the open loop stays from -1, and where. It is
opened at its force (an admittance at its acceleration), L = N/D, and L(e^(i theta)) is looked at in
balls (``exact.margins``, lemma E5). An angle of theta is a frequency of theta/(2 pi T) Hz. The
margin of the delay of a held device is that above: an extra delay is no lag alone, for the force
then acts between the samples.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from decimal import ROUND_CEILING, ROUND_FLOOR
from functools import partial
from math import degrees, inf, isfinite, isnan, log10, nan, nextafter, pi, ulp
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Int8

from jaxstab.arrays import Array, Numbers, are_numbers, float_arrays, is_jax, named, namespace
from jaxstab.batches import asked_of_lanes
from jaxstab.conventions import Verdict
from jaxstab.exact import (
    DelayMargin,
    DelayStatus,
    Reading,
    Readings,
    TripleAt,
    delay_margin,
    readings,
    stable_line,
    wall_verdict,
)
from jaxstab.loop.gains import TwoGains, by_gain
from jaxstab.model import checked_delta, checked_gain, checked_gamma
from jaxstab.model.balls import ball_loop, ball_triple
from jaxstab.model.device.device import in_steps
from jaxstab.model.device.sampling import one_sample
from jaxstab.model.filters import Filter, Velocity, known_filters
from jaxstab.model.gain import ALPHA_BETA, WALL, Gain
from jaxstab.model.loop import LoopParameters, refuses_loops, unit_loops
from jaxstab.model.plant import LONGEST_DELAY, wall_grid
from jaxstab.numbers import checked, require_together, without_noise
from jaxstab.rounding import UNIT
from jaxstab.shown import number_text, rounded_text, table_text

WAYS = ((0, -1.0), (0, 1.0), (1, -1.0), (1, 1.0), (4, 1.0))
"""The axes (alpha, beta, delay) along which a wall is changed, and the signs."""

_NOT_KNOWN = nan, nan  # an end, and the angle / pi of the root that is on the circle there


def loop_margins(
    loop: TwoGains, codes: Int8[np.ndarray, "*grid"], pairs: Float64[np.ndarray, "*grid 2"]
) -> "Margins":
    """The margins of pairs of gains of one loop with these verdicts."""
    ends, delays, held = np.full((codes.size, 3, 2), nan), np.full(codes.size, nan), loop._held
    for k, pair in stable_pairs(codes, pairs):
        ways = ends_of_gains(loop._triple, pair)
        ways += _ends(loop._triple, 1.0, (0.0, 0.0), pair) if any(pair) else [(inf, nan)] * 2
        ends[k] = np.reshape([end for end, _ in ways], (3, 2))
        if held is not None:
            delays[k] = longer_delay(held, pair).samples * loop.sample_time
    ends = ends.reshape(*codes.shape, 3, 2)
    both = np.maximum(ends[..., 2, :], 0.0)
    later = None if held is None and not loop.has_delay else delays.reshape(codes.shape)
    return margins_of(pairs, codes, ends[..., :2, :], both, later, loop.gains)


def crossings_of(loop: LoopParameters, wall: tuple[float, float]) -> list[float]:
    """The verdict on a wall (K, B) of a loop and then, each way of ``WAYS``, end and angle.

    They are in SI units, the delay in samples; NaN for a wall that is not proved stable.
    """
    code = wall_verdict(partial(ball_triple, loop), *wall).verdict
    ways = [_NOT_KNOWN] * len(WAYS)
    if code == Verdict.STABLE:
        ways[:-1] = ends_of_gains(partial(ball_triple, loop), wall)
        if not in_steps(loop.held_device):  # which has no delays between its steps
            later = longer_delay(loop, wall)
            ways[-1] = later.samples, later.angle / pi
    return [float(code), *(number for way in ways for number in way)]


def longer_delay(loop: LoopParameters, wall: tuple[float, float]) -> DelayMargin:
    """By how many samples the delay of a stable wall of a held device may grow."""
    sample = partial(one_sample, loop.held_device, float(loop.sample_time))
    return delay_margin(partial(ball_loop, loop), sample, float(loop.delay_samples), wall)


def ends_of_gains(triple: TripleAt, gains: tuple[float, float]) -> list[tuple[float, float]]:
    """Up to where a stable pair stays so, each gain changed alone, down and up, and angles / pi.

    An end is infinite if no root ever reaches the circle; the angle is NaN where it is not known.
    """
    first, second = gains
    along_first = _ends(triple, first, (0.0, second), (1.0, 0.0))
    return [*along_first, *_ends(triple, second, (first, 0.0), (0.0, 1.0))]


def _ends(
    triple: TripleAt, here: float, start: tuple[float, float], along: tuple[float, float]
) -> Iterator[tuple[float, float]]:
    """The ends of the interval of a line that holds a place, less their errors; or the place."""
    line = stable_line(triple, start, along)
    interval = line.holding(here)
    if interval is None:  # that place alone
        yield from [(here, nan)] * 2
        return
    for end, inwards in zip(interval, (1.0, -1.0), strict=True):
        value = end.value + inwards * end.error
        if not isfinite(value):
            value = -inwards * line.horizon
        elif value:  # an end that is 0 is where the root at 1 is, and is said so
            value = nextafter(value, inwards * inf)
        yield value, end.angle / pi


# Margins as a table for people: limits rounded inwards, and 0 if they are 0 but for rounding.

_DIGITS = 5


def verdict_words(verdict: Numbers) -> list[str]:
    """The names of verdicts, in a list."""
    return [Verdict(int(code)).name.lower() for code in np.ravel(verdict)]


def many_text(title: str, kind: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of many walls, a row for each of the first: its verdict, and what is below heads."""
    most = 8
    table = table_text([("verdict", *heads), *rows[:most]])
    more = f"\n... and {len(rows) - most} more" if len(rows) > most else ""
    return f"{title} of {len(rows)} {kind}\n{table}{more}"


def _interval(ends: Sequence[float], most: float = 1.0) -> tuple[str, str]:
    """Two ends; what is 1e-9 of their distance, and of ``most``, is 0."""
    least, largest = without_noise(ends, min(ends[1] - ends[0], most)).tolist()
    return _least(least), _largest(largest)


def _stable(ends: Sequence[float]) -> tuple[str, str]:
    endless = 1e12  # is as good as unlimited: then the other end is not 0
    return _interval(ends, inf if ends[1] < endless else 1.0)


def _least(value: float) -> str:
    return number_text(float(value), _DIGITS, ROUND_CEILING).replace("unlimited", "-unlimited")


def _largest(value: float) -> str:
    return number_text(float(value), _DIGITS, ROUND_FLOOR)


class Margins(NamedTuple):
    """The changes that two gains allow; NaN throughout for a pair that is not proved stable.

    All numbers are proved: the loop is stable between any two. Intervals end at the first root on
    the circle, to the last digits; an extra delay falls short of it by about 1e-9 of the way at
    most, or by more where the search is given up, for a wall whose roots stay next to the circle at
    nearly all angles. A factor is 0 where a gain may be turned down to 0, or beyond; with 0 times a
    gain nothing changes. The table rounds limits inwards, and prints 0 for one below 1e-9 of its
    interval, such as a least stiffness that the root at z = 1 sets. By the name of a gain, as in
    ``stiffness`` and ``stiffness_gain``, stand its interval and its largest factor.

    Attributes:
        verdict: codes of ``Verdict``.
        first: the smallest and the largest first gain between which the loop stays stable at this
            second one.
        second: the same of the second gain.
        first_factors: the least and the largest factor by which the first gain may be multiplied.
        second_factors: the same of the second gain.
        both_factors: the factors of both at once: the gain margins of the open loop; None of
            ``jaxstab.margins``.
        extra_delay: the time by which the delay may grow; infinite if no delay is too long, NaN
            for a device in z, None for a loop that is known at its samples alone.
        names: those of the gains, and their units.

    Example:
        >>> jaxstab.margins(0.1, 0.2, gamma=0.0, delta=0.015, delay=1.0)
        Margins: stable        least   largest  factors
        alpha                  0       0.11185  0 to 1.1185
        beta                   0.1689  0.6702   0.8445 to 3.351
        extra delay (samples)          0.15444
        >>> jaxstab.simulated_pd(0.1, step=2e-3, substeps=4).margins(kp=500.0, kd=10.0)
        Margins: stable  least  largest  factors
        kp (N m/rad)     0      3333.3   0 to 6.6666
        kd (N m s/rad)   1.5    24.5     0.15 to 2.45
        both                             0 to 2.3809
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> margins = loop.margins(1000.0, 10.0)
        >>> margins.stiffness.round(1).tolist(), round(float(margins.stiffness_gain), 3)
        ([0.0, 20877.5], 20.878)
        >>> margins.damping.round(3).tolist(), round(float(margins.damping_gain), 3)
        ([-1.006, 201.014], 20.101)
    """

    verdict: Int8[Array, "*grid"]
    first: Float64[Array, "*grid 2"]
    second: Float64[Array, "*grid 2"]
    first_factors: Float64[Array, "*grid 2"]
    second_factors: Float64[Array, "*grid 2"]
    both_factors: Float64[Array, "*grid 2"] | None
    extra_delay: Float64[Array, "*grid"] | None
    names: tuple[Gain, Gain]

    @property
    def stiffness(self) -> Float64[Array, "*grid 2"]:
        """The stable interval of the stiffness, of loops with that gain."""
        return self._of("stiffness")

    @property
    def damping(self) -> Float64[Array, "*grid 2"]:
        """The stable interval of the damping, of loops with that gain."""
        return self._of("damping")

    @property
    def stiffness_gain(self) -> Float64[Array, "*grid"]:
        """The largest factor of the stiffness; infinite for K = 0."""
        return self._of("stiffness_gain")

    @property
    def damping_gain(self) -> Float64[Array, "*grid"]:
        """The largest factor of the damping; infinite for B = 0."""
        return self._of("damping_gain")

    def __getattr__(self, name: str) -> Any:
        """The interval or the largest factor of a gain by its name."""
        return self._of(name)

    def _of(self, name: str) -> Any:
        values: dict[str, Array] = {}
        for gain, ends, factors in zip(self.names, self[1:3], self[3:5], strict=True):
            values |= {gain.name: ends, f"{gain.name}_gain": factors[..., 1]}
        return by_gain(self, name, values)

    def __repr__(self) -> str:
        """A table: a row for each gain of one pair, or one for each of several pairs."""
        if not are_numbers(self[:-1]):
            return f"Margins{tuple(self)}"
        codes, many = verdict_words(self.verdict), range(np.size(self.verdict))
        sides = [np.reshape(own, (-1, 2)).tolist() for own in self[1:5]]
        both, delays = (None if x is None else np.ravel(x).tolist() for x in self[5:7])
        delay_name = f"extra delay ({'s' if self.names[0].unit else 'samples'})"

        def rows_of(k: int) -> list[tuple[str, str, str, str]]:
            rows = [
                (gain.label, *_stable(ends[k]), _factors(factors[k]))
                for gain, ends, factors in zip(self.names, sides[:2], sides[2:], strict=True)
            ]
            if both is not None:
                rows.append(("both", "", "", _factors(both[2 * k : 2 * k + 2])))
            if delays is not None:
                is_open = codes[k] == "stable" and isnan(delays[k])
                rows.append((delay_name, "", "not known" if is_open else _largest(delays[k]), ""))
            return rows

        if np.ndim(self.verdict) == 0:
            head = f"Margins: {codes[0]}", "least", "largest", "factors"
            return table_text([head, *rows_of(0)])
        heads = [gain.label for gain in self.names]
        heads = [head for own in heads for head in (own, "to", "factors")]
        heads += ["both"] * (both is not None) + [delay_name] * (delays is not None)
        every = [
            (codes[k], *(cell for row in rows_of(k) for cell in row[1:] if cell)) for k in many
        ]
        return many_text("Margins", "pairs of gains", heads, every)


def _factors(ends: Sequence[float]) -> str:
    return "none" if isnan(ends[0]) else " to ".join(_interval(ends))


@refuses_loops("margins(K, B)")
def margins(
    alpha: Numbers,
    beta: Numbers,
    *,
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> Margins:
    """The changes of alpha, beta and delay, one at a time, before a loop is unstable.

    With JAX arrays the search is called back from JAX, so it works under jit and vmap. It is
    differentiable once in every argument, the delay too. Where two crossings come first at once,
    the derivative is that of one of them; it is NaN where the margin is infinite or the loop not
    stable. Each wall takes some hundredths of a second.

    Args and Raises: see ``jaxstab.conventions``; here JAX may trace the delay.

    Returns:
        Margins: intervals of alpha and beta, and samples.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) on the unit circle; E3 and lemma B5 of
    docs/proofs.md.

    Example:
        >>> window = jaxstab.Velocity.difference(samples=20)
        >>> wall = {"gamma": 0.0, "delta": 0.001, "delay": 1.0, "velocity": window}
        >>> float(margins(0.003, 0.04, **wall).stiffness_gain)
        2.7159...
    """
    filters = known_filters(velocity, position)
    values = (
        checked_gain("alpha", alpha),
        checked_gain("beta", beta),
        checked_gamma(gamma),
        checked_delta(delta),
        checked("delay", delay, 0.0, LONGEST_DELAY),
    )
    require_together(alpha=alpha, beta=beta, gamma=gamma, delta=delta, delay=delay)
    arrays = float_arrays(*values)
    xp = namespace(arrays)
    point: Array = xp.stack(xp.broadcast_arrays(*arrays), axis=-1)

    def ask(loop: LoopParameters, alpha: float, beta: float) -> list[float]:
        return crossings_of(loop, (alpha, beta))

    loop_of, count = unit_loops(velocity, position), 1 + 2 * len(WAYS)
    code, *found = asked_of_lanes(ask, loop_of, arrays, count, is_count=True)
    ends = xp.stack(found[::2], axis=-1)
    if is_jax(point):
        from jaxstab.loop.crossings import moving_ends  # which imports JAX

        axes = np.array([axis for axis, _ in WAYS])
        ends = moving_ends(point, ends, xp.stack(found[1::2], axis=-1), axes, filters)
    alone = ends[..., :4].reshape(*ends.shape[:-1], 2, 2)
    return margins_of(point[..., :2], code, alone, None, ends[..., 4], ALPHA_BETA)


def margins_of(
    pairs: Array,
    codes: Array,
    ends: Array,
    both: Array | None,
    later: Array | None,
    gains: tuple[Gain, Gain],
) -> Margins:
    """The margins of pairs of gains, from the ends up to which each of them is stable."""
    xp = namespace(pairs, ends)
    is_none = pairs[..., None] == 0.0
    factors = xp.sort(ends / xp.where(is_none, 1.0, pairs[..., None]), axis=-1)
    without = xp.where(xp.isnan(ends), ends, xp.asarray([0.0, inf]))
    factors = xp.maximum(xp.where(is_none, without, factors), 0.0)
    columns = ends[..., 0, :], ends[..., 1, :], factors[..., 0, :], factors[..., 1, :]
    return Margins(named(codes.astype(xp.int8), Verdict), *columns, both, later, gains)


def in_si_units(
    margins: Margins, stiffness: Numbers, damping: Numbers, sample_time: Numbers
) -> Margins:
    """Margins in units of one sample, by K in N/m and B in N s/m of alpha = 1 and beta = 1.

    Those of many loops are arrays.
    """
    per_alpha, per_beta = (u[..., None] if np.ndim(u) else u for u in (stiffness, damping))
    return margins._replace(
        first=margins.first * per_alpha,
        second=margins.second * per_beta,
        extra_delay=sample_time * margins.extra_delay,
        names=WALL,
    )


def stable_pairs(codes: Array, pairs: Array) -> Iterator[tuple[int, tuple[float, float]]]:
    """The numbers of the pairs of gains that are proved stable, and these."""
    every = pairs.reshape(-1, 2).tolist()
    return ((k, (*every[k],)) for k in np.flatnonzero(codes == Verdict.STABLE).tolist())


# Margins in the language of frequency.


class AtFrequency(NamedTuple):
    """A number, a bound of its error, and the frequency in Hz where it is, if it is somewhere.

    The number is NaN where it is not proved. It is proved to be no smaller, and no more, where the
    bound is infinite.

    Example:
        >>> loop = jaxstab.simulated_pd(0.1, step=2e-3)
        >>> peak = loop.frequency_margins(kp=1000.0, kd=20.0).sensitivity
        >>> float(peak.value), bool(peak.error < 1e-15), round(float(peak.frequency), 9)
        (1.26582278481..., True, 250.0)
    """

    value: Float64[np.ndarray, "*grid"]
    error: Float64[np.ndarray, "*grid"]
    frequency: Float64[np.ndarray, "*grid"]


class FrequencyMargins(NamedTuple):
    """The distances of the open loop L of a stable loop from -1; NaN for one not proved stable.

    Attributes:
        verdict: certified codes of ``Verdict``.
        least_gain: the factor down to which L may be multiplied; <= 0 where it may be turned off.
        largest_gain: the gain margin: the factor up to which L may be multiplied.
        phase: the phase margin in degrees: the least lag or lead with which L is -1.
        delay: the delay margin in s; of a loop that is known at its samples alone the loop is
            stable with every whole number of samples below it.
        sensitivity: the peak of |S|, S = 1/(1 + L).
        complementary: the peak of |T|, T = L/(1 + L).
        disk: the disk margin a = 2/max |S - T|: gain and phase may change at once by any complex
            factor (1 + e)/(1 - e), |e| < a/2.

    Example:
        >>> jaxstab.simulated_pd(0.1, step=2e-3, substeps=4).frequency_margins(kp=500.0, kd=10.0)
        Frequency margins: stable                         at
        least gain factor               0
        gain margin                     2.3809 (7.53 dB)  62.5 Hz
        phase margin (degrees)          42.559            18.534 Hz
        delay margin (s)                0.0063786         18.534 Hz
        peak sensitivity                1.7242            62.5 Hz
        peak complementary sensitivity  1.4863            13.106 Hz
        disk margin                     0.77135           22.132 Hz
    """

    verdict: Int8[Array, "*grid"]
    least_gain: AtFrequency
    largest_gain: AtFrequency
    phase: AtFrequency
    delay: AtFrequency
    sensitivity: AtFrequency
    complementary: AtFrequency
    disk: AtFrequency

    def __repr__(self) -> str:
        """A table: a row for each margin of one pair of gains, or one for each of several pairs."""
        codes = verdict_words(self.verdict)
        if codes == ["unstable"]:
            return "Frequency margins: none, the loop is unstable"
        names = [name for name, _ in _ROWS]
        columns = [_words(*row, own) for row, own in zip(_ROWS, self[1:], strict=True)]
        if np.ndim(self.verdict) == 0:
            rows = [(f"Frequency margins: {codes[0]}", "", "at")]
            for name, [text], own in zip(names, columns, self[1:], strict=True):
                is_there = own.frequency >= 0.0 and text != "0"
                place = number_text(float(own.frequency), 5, unit="Hz") if is_there else ""
                rows.append((name, text, place))
            return table_text(rows)
        every = [
            (code, *(words if code == "stable" else ["none"] * len(words)))
            for code, *words in zip(codes, *columns, strict=True)
        ]
        return many_text("Frequency margins", "pairs of gains", names, every)


_ROWS = (
    ("least gain factor", ROUND_CEILING),
    ("gain margin", ROUND_FLOOR),
    ("phase margin (degrees)", ROUND_FLOOR),
    ("delay margin (s)", ROUND_FLOOR),
    ("peak sensitivity", ROUND_CEILING),
    ("peak complementary sensitivity", ROUND_CEILING),
    ("disk margin", ROUND_FLOOR),
)
"""The names of the margins, and the safe side of each."""


def _words(name: str, rounding: str, own: AtFrequency) -> list[str]:
    """Margins to the safe side of their errors, the gain margin also in dB."""
    texts = []
    for value, error in zip(*map(np.ravel, own[:2]), strict=True):
        is_bound = error == inf and isfinite(value)
        moved = error if isfinite(error) else 0.0
        safe = max(float(value + (moved if rounding == ROUND_CEILING else -moved)), 0.0)
        text = "not proved" if isnan(value) else number_text(safe, 5, rounding)
        if name == "gain margin" and isfinite(value):
            text += f" ({rounded_text(20.0 * log10(safe), 3, ROUND_FLOOR)} dB)"
        texts.append(f"at least {text}" if is_bound else text)
    return texts


def wall_frequency_margins(
    loop: TwoGains, first: Numbers, second: Numbers, *, in_full: bool = True
) -> FrequencyMargins:
    """The margins of pairs of gains of a loop; not ``in_full`` phase and sensitivity alone."""
    names = [gain.name for gain in loop.gains]
    pairs = wall_grid(**dict(zip(names, (first, second), strict=True)))
    codes = np.asarray(loop.verdict(**dict(zip(names, np.moveaxis(pairs, -1, 0), strict=True))))
    held = loop._held if in_full else None
    asked = Readings._fields if in_full else ("phase", "sensitivity")
    found = np.full((7, 3, codes.size), nan)
    for k, pair in stable_pairs(codes, pairs):
        own = readings(partial(loop._opened, *pair), asked=asked)
        found[..., k] = own._replace(delay=delay_reading(held, *pair)) if held else own
    units = np.array([1.0, 1.0, degrees(1.0), loop.sample_time, 1.0, 1.0, 1.0])[:, None]
    values, errors, angles = np.moveaxis(found, 1, 0)
    values, errors = values * units, errors * units
    is_rounded = np.isfinite(values) & (units != 1.0)
    errors += np.where(is_rounded, 4.0 * UNIT * np.abs(values), 0.0)
    columns = np.stack([values, errors, angles / (2.0 * pi * loop.sample_time)], axis=1)
    columns = columns.reshape(7, 3, *codes.shape)
    return FrequencyMargins(named(codes, Verdict), *(AtFrequency(*own) for own in columns))


def delay_reading(loop: LoopParameters, *wall: float) -> Reading:
    """The delay margin in samples: proved from below, and by an unstable loop from above."""
    short = 2.0**-29  # of a margin, beyond which the loop is tried
    now, (K, B) = float(loop.delay_samples), wall
    most, angle, status = longer_delay(loop, (K, B))
    if status == DelayStatus.UNLIMITED:
        return Reading(most, 0.0)
    beyond = now + most + max(short * most, 16.0 * ulp(now + most))
    if status == DelayStatus.PROVED and beyond < LONGEST_DELAY:
        later = replace(loop, delay=beyond * loop.sample_time)
        if wall_verdict(partial(ball_triple, later), K, B).verdict == Verdict.UNSTABLE:
            return Reading(most, beyond - now - most + 4.0 * ulp(beyond), angle)
    return Reading(most, inf, angle)
