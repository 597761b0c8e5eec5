"""Delays that move: proofs under attack, and the share of the stiffness that is proved.

Random loops and walls. A wall that is STABLE for a range of delays is attacked by an independent
simulation (``tests.truth.moving``): random and periodic sequences, of which those that decay
most slowly are changed again and again; none may grow. A wall that is UNSTABLE is replayed there
with the delays that were found, as far as these are whole parts of a sample; all must grow. With a
range of one delay the verdicts are those of the constant delay.

The table has the largest stiffness that is proved at some dampings, beside that of the best
sequence found against it and of every constant delay. The first row of the record has the counts of
the attacks, the others are those of the table.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

import jaxstab
from benchmarks import record
from benchmarks.table import DAMPINGS, moving_delays
from jaxstab import HapticLoop, Velocity, Verdict
from jaxstab.app.pictures.scene import draw_moving
from jaxstab.drawing import DAMPING_LABEL, STIFFNESS_LABEL
from jaxstab.loop.jitter import Jitter
from tests.truth.moving import LOST, Moving, growth

PICTURE = Path(__file__).resolve().parents[1] / "docs" / "moving_delays.png"
_PARTS = 8  # of a sample: delays are whole numbers of them
_SIDE_BY_SIDE, _TURN, _TURNS = 24, 12, 40  # sequences, samples of a turn, turns
_ROUNDS = 3  # of changes
_T = 1e-3
_QUICK, _THOROUGH = 10, 4  # bisections towards the lowest stiffness that grows
_LOOPS = 300
_NEAR = (0.8, 0.98, 1.2, 1.6)  # times the largest stiffness proved: walls that are judged


class Case(NamedTuple):
    """A loop, the same for the simulation, and a range of delays in parts of a sample."""

    loop: HapticLoop
    truth: Moving
    low: int
    high: int
    lost: int

    @property
    def delays(self) -> tuple[float, float]:
        """The range in s."""
        return self.low * _T / _PARTS, self.high * _T / _PARTS


def main(small: bool, points: int | None, folder: Path) -> int:
    """Attack, write the record and the table of docs/accuracy.md; the number of wrong verdicts."""
    rng = np.random.default_rng(34)
    counts: Counter[str] = Counter()
    for _ in range(2 if small else points or _LOOPS):
        counts["loops"] += 1
        counts.update(judged(random_case(rng), rng))
    wrong = counts["STABLE that grow"] + counts["UNSTABLE that decay"] + counts["constant, differ"]
    print(", ".join(f"{name}: {count:,}" for name, count in sorted(counts.items())))
    made = record.new_record("jitter", small, [dict(counts), *shares(small)])
    print(moving_delays([made]))
    record.write(made, folder)
    if not small:
        picture()
    return wrong


def picture(path: Path = PICTURE) -> None:
    """Draw the proved walls of some loops, and walls that are proved unstable, for the docs."""
    figure = Figure(figsize=(9.0, 5.4), layout="constrained")
    for row, (low, high) in zip(figure.subplots(2, 3), ((0.8, 1.2), (1.0, 2.0)), strict=True):
        for panel, window in zip(row, (1, 5, 20), strict=True):
            loop = omega(window, low)
            draw_moving(Jitter.from_loop(loop, (low * _T, high * _T)), panel)
            panel.set(xlim=(0.0, None), ylim=(0.0, None))
            panel.set(xlabel=STIFFNESS_LABEL, ylabel=DAMPING_LABEL)
            panel.set_title(f"window {window}, delays {low:g} to {high:g}", fontsize=9)
    figure.legend(*panel.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    figure.savefig(path, dpi=110)


def omega(window: int, delay: float) -> HapticLoop:
    """Return the loop of an omega-like device, with a delay in samples."""
    velocity = Velocity.difference(samples=window)
    held = {"device_mass": 0.25, "device_damping": 0.1, "sample_time": _T}
    return HapticLoop(**held, delay=delay * _T, velocity=velocity)


def random_case(rng: np.random.Generator) -> Case:
    """Return a loop of one mass with a window and a low pass, and delays of up to 3 samples."""
    mass, damping = float(10 ** rng.uniform(-1.3, 0.3)), float(10 ** rng.uniform(-2, 0.5))
    spring = float(rng.choice([0.0, 10 ** rng.uniform(0, 3)]))
    window, is_smooth = int(rng.choice([1, 1, 2, 5, 10, 20])), rng.random() < 0.3
    cutoff = float(10 ** rng.uniform(1.5, 2.5))
    low = int(rng.integers(0, 2 * _PARTS + 1))
    velocity = Velocity.difference(samples=window)
    if is_smooth:
        velocity = velocity * jaxstab.Filter.low_pass(cutoff)
    loop = HapticLoop(
        device_mass=mass,
        device_damping=damping,
        hand_stiffness=spring,
        sample_time=_T,
        delay=low * _T / _PARTS,
        velocity=velocity,
    )
    smoothing = float(np.exp(-2.0 * np.pi * cutoff * _T)) if is_smooth else 0.0
    truth = Moving((1.0,), (mass, damping, spring), _T, window, smoothing, _PARTS)
    lost = int(rng.random() < 0.2)
    return Case(loop, truth, low, low + int(rng.integers(0, _PARTS + 1)), lost)


def judged(case: Case, rng: np.random.Generator) -> Counter[str]:
    """Judge walls of a loop next to what is proved at a damping, and counts of constant delays."""
    counts: Counter[str] = Counter()
    loop, options = case.loop, {"delays": case.delays, "lost": case.lost}
    limits = loop.limits()
    damping = float(limits.at_damping * rng.uniform(0.2, 1.5))
    stiffest = largest(lambda k: loop.verdict(k, damping, **options), limits.stiffness)
    for stiffness in [share * (stiffest or 0.5 * limits.stiffness) for share in _NEAR]:
        wall = stiffness, damping
        code = Verdict(int(loop.verdict(*wall, **options)))
        counts[code.name] += 1
        if code == Verdict.STABLE:
            fastest, samples = attacked(case, wall, rng)
            counts["samples"] += samples
            counts["STABLE that grow"] += int(fastest >= 1.0)
        worst = loop.worst_delays(*wall, **options)
        counts["STABLE that grow"] += int(worst.growth >= 1.0 and code == Verdict.STABLE)
        if worst.is_proved:
            counts["sequences that grow"] += 1
            counts["UNSTABLE that decay"] += int(replayed(case, wall, worst.delays) <= 1.0)
    gains = limits.stiffness * rng.uniform(0.0, 1.2, 50), damping * rng.uniform(0.2, 1.5, 50)
    known = loop.verdict(*gains)
    same = loop.verdict(*gains, delays=(loop.delay, loop.delay))
    is_decided = (known != Verdict.UNDECIDED) & (same != Verdict.UNDECIDED)
    counts["constant"] += int(np.count_nonzero(is_decided))
    counts["constant, differ"] += int(np.count_nonzero(is_decided & (known != same)))
    return counts


def attacked(case: Case, wall: tuple[float, float], rng: np.random.Generator) -> tuple[float, int]:
    """Return the fastest growth of sequences that are changed to grow faster, and the samples."""
    turns = rng.integers(case.low, case.high + 1, (_SIDE_BY_SIDE, _TURN))
    switched = [  # between the ends of the range, for some samples of each turn
        np.where(np.arange(_TURN) % length < early, case.low, case.high)
        for length in (2, 3, 4, 6, 12)
        for early in {1, length // 2, length - 1}
    ]
    turns[: len(switched)] = switched
    if case.lost:
        turns[:, ::4] = np.where(rng.random(turns[:, ::4].shape) < 0.5, LOST, turns[:, ::4])
    growths, samples = _growths(case, wall, turns)
    for _ in range(_ROUNDS):
        best = turns[np.argsort(-growths)[: _SIDE_BY_SIDE // 4]]
        others = np.repeat(best, 4, axis=0)
        place = rng.integers(0, _TURN, len(others))
        if case.lost:
            place -= place % 4 == 0  # a lost sample stays between two that arrive
        others[np.arange(len(others)), place] = rng.integers(case.low, case.high + 1, len(others))
        others[::4] = best
        turns = others
        growths, more = _growths(case, wall, turns)
        samples += more
    return float(growths.max()), samples


def _growths(case: Case, wall: tuple[float, float], turns: np.ndarray) -> tuple[np.ndarray, int]:
    sequences = np.tile(turns, (1, _TURNS))
    return growth(case.truth.positions(*wall, sequences), _TURN), sequences.size


def replayed(case: Case, wall: tuple[float, float], delays: tuple[float, ...]) -> float:
    """Return the growth of delays in turn, each a quarter of the range or a lost sample."""
    samples = np.array(delays) / _T
    samples[np.isinf(samples)] = LOST
    is_coarse = np.allclose(_PARTS * samples, np.round(_PARTS * samples), atol=1e-6)
    truth = case.truth if is_coarse else replace(case.truth, parts=4 * _PARTS)
    whole = np.where(samples < 0.0, LOST, np.round(truth.parts * samples))
    assert np.allclose(np.where(samples < 0.0, LOST, truth.parts * samples), whole, atol=1e-6)
    sequence = np.tile(whole.astype(int), (1, max(8, 2400 // len(delays))))
    return float(growth(truth.positions(*wall, sequence), len(delays))[0])


def largest(verdict: Callable[[float], Any], most: float) -> float:
    """Return the largest stiffness that is STABLE, by bisection from 0."""
    low, high = 0.0, 2.0 * most
    for _ in range(14):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if verdict(middle) == Verdict.STABLE else (low, middle)
    return low


def shares(small: bool) -> Iterator[record.Row]:
    """Yield rows of the table: the stiffness proved, and that of the best sequence found."""
    for window in (20,) if small else (1, 5, 10, 20):
        for low, high in ((0.8, 1.2),) if small else ((1.0, 1.1), (0.8, 1.2), (1.0, 2.0)):
            loop = omega(window, low)
            stiffest = replace(loop, delay=high * _T).limits()
            for factor in DAMPINGS:
                damping = factor * stiffest.at_damping
                proved, grows = stiffnesses(loop, (low * _T, high * _T), damping)
                yield {
                    "window": window,
                    "delays": f"{low:g} to {high:g}",
                    "factor": factor,
                    "damping": damping,
                    "proved": proved,
                    "grows": grows,
                }


def stiffnesses(
    loop: HapticLoop, delays: tuple[float, float], damping: float
) -> tuple[float, float]:
    """The largest K that is proved at this damping, and the least with a sequence that grows."""
    proved = largest(lambda k: loop.verdict(k, damping, delays=delays), loop.limits().stiffness)
    low, high = proved, 2.0 * loop.limits().stiffness
    for number in range(_QUICK + _THOROUGH):
        middle = 0.5 * (low + high)
        if number < _QUICK:
            grows = loop.verdict(middle, damping, delays=delays) == Verdict.UNSTABLE
        else:
            grows = loop.worst_delays(middle, damping, delays=delays).is_proved
        low, high = (low, middle) if grows else (middle, high)
        low = proved if number == _QUICK - 1 else low
    return proved, high
