"""Margins in the language of frequency: how far the open loop stays from -1, and where.

The loop is opened at its force (an admittance at its acceleration), L = N/D, and what is asked of
L(e^(i theta)) is answered in balls (``exact.frequency``, lemma E5 of docs/proofs.md). An angle of
theta is a frequency of theta/(2 pi T) Hz. The margin of the delay of a held device is that of
``margins``: an extra delay is no lag alone, for the force then acts between the samples.
"""

from dataclasses import replace
from decimal import ROUND_CEILING, ROUND_FLOOR
from functools import partial
from math import degrees, inf, isfinite, isnan, log10, nan, pi, ulp
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Int8

from jaxstab.arrays import Numbers, named
from jaxstab.conventions import Verdict
from jaxstab.exact import DelayStatus, Reading, readings, wall_verdict
from jaxstab.loop.margins import longer_delay, many_text, stable_pairs, verdict_words
from jaxstab.model.balls import ball_triple
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
    loop: Any, first: Numbers, second: Numbers, *, in_full: bool = True
) -> FrequencyMargins:
    """The margins of pairs of gains of a loop; not ``in_full`` phase and sensitivity alone."""
    names = [gain.name for gain in loop.gains]
    pairs = wall_grid(**dict(zip(names, (first, second), strict=True)))
    codes = np.asarray(loop.verdict(**dict(zip(names, np.moveaxis(pairs, -1, 0), strict=True))))
    delay = loop._delay_margin if in_full else None
    found = np.full((7, 3, codes.size), nan)
    for k, pair in stable_pairs(codes, pairs):
        own = readings(partial(loop._opened, *pair), in_full=in_full)
        found[..., k] = own._replace(delay=delay(*pair)) if delay else own
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
