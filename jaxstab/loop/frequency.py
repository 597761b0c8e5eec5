"""Margins in the language of frequency: how far the open loop stays from -1, and where.

The loop is opened at its force (an admittance at its acceleration), L = N/D, and what is asked of
L(e^(i theta)) is answered in balls (``exact.frequency``, lemma E5 of docs/proofs.md). An angle of
theta is a frequency of theta/(2 pi T) Hz. The margin of the delay of a held device is that of
``margins``: an extra delay is no lag alone, for the force then acts between the samples.
"""

from collections.abc import Callable
from dataclasses import replace
from decimal import ROUND_CEILING, ROUND_FLOOR
from functools import partial
from math import degrees, inf, isfinite, isnan, log10, nan, pi, ulp
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Int8

from jaxstab.arrays import Numbers, named
from jaxstab.conventions import Verdict
from jaxstab.exact import DelayStatus, Reading, delay_margin, readings, wall_verdict
from jaxstab.model.balls import Factored, ball_loop, ball_triple
from jaxstab.model.device.device import in_steps
from jaxstab.model.device.sampling import one_sample
from jaxstab.model.loop import LoopParameters
from jaxstab.model.parameters import LONGEST_DELAY, wall_grid
from jaxstab.rounding import UNIT
from jaxstab.shown import number_text, rounded_text, table_text


class AtFrequency(NamedTuple):
    """A number, a bound of its error, and the frequency in Hz where it is, if it is somewhere.

    The number is NaN where it is not proved. It is proved to be no smaller, and no more, where the
    bound is infinite.

    Example:
        >>> loop = jaxstab.simulated_pd(0.1, step=2e-3)
        >>> peak = loop.frequency_margins(kp=1000.0, kd=20.0).sensitivity
        >>> round(float(peak.value), 6), bool(peak.error < 1e-15), round(float(peak.frequency), 3)
        (1.170..., True, ...)
    """

    value: Float64[np.ndarray, "*grid"]
    error: Float64[np.ndarray, "*grid"]
    frequency: Float64[np.ndarray, "*grid"]


class FrequencyMargins(NamedTuple):
    """How far the open loop L of a stable loop stays from -1; NaN for one that is not proved stable.

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
        Frequency margins: stable
    """

    verdict: Int8[np.ndarray, "*grid"]
    least_gain: AtFrequency
    largest_gain: AtFrequency
    phase: AtFrequency
    delay: AtFrequency
    sensitivity: AtFrequency
    complementary: AtFrequency
    disk: AtFrequency

    def __repr__(self) -> str:
        """A table: a row for each margin of one pair of gains, or one for each of several pairs."""
        codes = [Verdict(int(code)).name.lower() for code in np.ravel(self.verdict)]
        if codes == ["unstable"]:
            return "Frequency margins: none, the loop is unstable"
        columns = [[_words(k, float(v)) for v in np.ravel(x.value)] for k, x in enumerate(self[1:])]
        if np.ndim(self.verdict) == 0:
            places = [number_text(float(x.frequency), 5, unit="Hz") for x in self[1:]]
            rows = [(f"Frequency margins: {codes[0]}", "", "at")]
            for (name, _), column, place in zip(_ROWS, columns, places, strict=True):
                rows.append((name, column[0], place.replace("none", "")))
            return table_text(rows)
        most_rows = 8  # of many pairs
        rows = [("verdict", *(name for name, _ in _ROWS))]
        rows += [
            (code, *(["none"] * len(_ROWS) if code == "unstable" else own))
            for code, *own in zip(codes, *columns, strict=True)
        ]
        more = f"\n... and {len(codes) - most_rows} more" if len(codes) > most_rows else ""
        table = table_text(rows[: 1 + most_rows])
        return f"Frequency margins of {len(codes)} pairs of gains\n{table}{more}"


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


def _words(row: int, value: float) -> str:
    """A margin, rounded to its safe side, the gain margin also in dB."""
    name, rounding = _ROWS[row]
    text = number_text(max(value, 0.0), 5, rounding)
    if not isfinite(value):
        return "not proved" if isnan(value) else text
    if name == "gain margin":
        return f"{text} ({rounded_text(20.0 * log10(value), 3, ROUND_FLOOR)} dB)"
    return text


def margins_at_frequencies(
    opened: Callable[[float, float], tuple[Factored, Factored]],
    codes: Int8[np.ndarray, "*grid"],
    pairs: Float64[np.ndarray, "*grid 2"],
    period: float,
    delay: Callable[[float, float], Reading] | None = None,
) -> FrequencyMargins:
    """The margins of pairs of gains with these verdicts; ``delay`` has its own in samples."""
    found = np.full((7, 3, codes.size), nan)
    for k in np.flatnonzero(codes == Verdict.STABLE):
        pair = pairs.reshape(-1, 2)[k].tolist()
        own = readings(partial(opened, *pair))
        found[..., k] = own._replace(delay=delay(*pair)) if delay else own
    units = np.array([1.0, 1.0, degrees(1.0), period, 1.0, 1.0, 1.0])[:, None]
    values, errors, angles = np.moveaxis(found, 1, 0)
    values, errors = values * units, errors * units
    is_rounded = np.isfinite(values) & (units != 1.0)
    errors += np.where(is_rounded, 4.0 * UNIT * np.abs(values), 0.0)
    columns = np.stack([values, errors, angles / (2.0 * pi * period)], axis=1)
    columns = columns.reshape(7, 3, *codes.shape)
    return FrequencyMargins(named(codes, Verdict), *(AtFrequency(*own) for own in columns))


def wall_frequency_margins(
    loop: LoopParameters, verdict: Callable[..., Any], stiffness: Numbers, damping: Numbers
) -> FrequencyMargins:
    """The margins of walls (K, B) of a loop with a function that judges them."""
    grid = wall_grid(stiffness=stiffness, damping=damping)
    codes = np.asarray(verdict(grid[..., 0], grid[..., 1]))

    def opened(*wall: float) -> tuple[Factored, Factored]:
        triple = ball_triple(loop)
        return triple.base, triple.stiffness.scaled(wall[0]).plus(triple.damping.scaled(wall[1]))

    delay = None if in_steps(loop.held_device) else partial(_delay, loop)
    return margins_at_frequencies(opened, codes, grid, float(loop.sample_time), delay)


def _delay(loop: LoopParameters, *wall: float) -> Reading:
    """The delay margin in samples: proved from below, and by an unstable loop from above."""
    short = 2.0**-29  # of a margin, beyond which the loop is tried
    sample = partial(one_sample, loop.held_device, float(loop.sample_time))
    now, (K, B) = float(loop.delay_samples), wall
    most, angle, status = delay_margin(partial(ball_loop, loop), sample, now, (K, B))
    if status == DelayStatus.UNLIMITED:
        return Reading(most, 0.0)
    beyond = now + most + max(short * most, 16.0 * ulp(now + most))
    if status == DelayStatus.PROVED and beyond < LONGEST_DELAY:
        later = replace(loop, delay=beyond * loop.sample_time)
        if wall_verdict(partial(ball_triple, later), K, B).verdict == Verdict.UNSTABLE:
            return Reading(most, beyond - now - most + 4.0 * ulp(beyond), angle)
    return Reading(most, inf, angle)
