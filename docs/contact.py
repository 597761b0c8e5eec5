"""Where linear theory can be trusted: simulated contacts of random devices beside what is proved.

Stable walls: the amplitude of contacts with a quantised encoder, a quantised force and friction, on
two-sided walls, from random starts and phases of which the worst are changed again and again. None
may exceed the proved bound of ``HapticLoop.amplitude``.

All walls: one-sided contacts under a push or at a speed. How many rest, of walls that are proved
stable and unstable, by friction; and of the walls that a rule of the literature accepts:

- K T / 2 + |B| < b: passivity (Colgate, Schenkel 1997), for a difference over one sample without
  delay;
- K <= min(2 b / T, 2 f_c / q): Abbott, Okamura (2005), for walls without damping.

Both are applied here beyond their assumptions (windows, delays, damping), as a designer might.

Within them (no wall damping, no delay): contacts by the two ratios that the second rule compares
with 1. K T / (2 b) is what the hold gives beside what viscous damping takes, K q / (2 f_c) what the
encoder gives beside what friction takes. Diolaiti et al. (2006) describe regions of such effects;
theirs were not seen, and these are simulated.

`python -m docs.contact [--small]` writes its record to benchmarks/results and its tables into
docs/contact.md, and draws the picture there; small runs only print.
"""

import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import jaxstab
from benchmarks import record
from benchmarks.table import of_cells, put_between
from jaxstab import HapticLoop, Velocity, Verdict
from jaxstab.results import Contact

PAGE = Path(__file__).with_suffix(".md")
MARKER = "written by python -m docs.contact: {} {}"
_T = 1e-3
_DEVICES, _SMALL_DEVICES = 30, 3
_WALLS, _STARTS = 40, 84  # of a device, and of a wall
_ROUNDS = 3  # of starts, the later ones around the worst
_DURATION = 2.0  # s
_SLOWEST = 0.985  # spectral radius of the stable walls whose amplitudes are judged
_LONG = 8.0  # s, in which bounces end
_ROUNDING = 1e-9
_BINS = (0.0, 0.03, 0.1, 0.3, 1.0)  # N of friction
_RATIOS = 400  # runs of a device, by the ratios of the second rule
_BUZZ = 2.0  # steps of the encoder
_GRID = 90  # walls on an axis of the picture
_RULES = {
    "STABLE in jaxstab": "STABLE",
    "K T/2 + B < b (Colgate, Schenkel 1997)": "passive",
    "K ≤ min(2 b/T, 2 f_c/q) (Abbott, Okamura 2005)": "abbott",
}


class Device(NamedTuple):
    """A device with its encoder, and walls around its limits."""

    loop: HapticLoop
    encoder: float
    stiffness: np.ndarray
    damping: np.ndarray
    verdict: np.ndarray


def main(small: bool) -> int:
    """Count what becomes of contacts; return how many amplitudes exceed their bound."""
    rng = np.random.default_rng(36)
    counts: Counter[str] = Counter()
    widest = 0.0
    for _ in range(_SMALL_DEVICES if small else _DEVICES):
        device = random_device(rng, 12 if small else _WALLS)
        counts["devices"] += 1
        above, runs, share = amplitudes(device, rng, 6 if small else _STARTS)
        counts.update({"above": above, "bounded": runs})
        widest = max(widest, share)
        counts.update(ends(device, rng, 6 if small else _STARTS))
    counts.update(by_ratio(2 if small else _DEVICES, 40 if small else _RATIOS))
    found = {**counts, "above": counts["above"], "largest_share_of_bound": widest}
    print(*tables(found).values(), sep="\n\n")
    print(f"amplitudes above the proved bound: {counts['above']} of {counts['bounded']:,}")
    if not small:
        record.write(record.new_record("contact", small, [found]), record.RESULTS)
        put_between(PAGE, MARKER, tables(found))
        draw()
    return counts["above"]


def random_device(rng: np.random.Generator, walls: int) -> Device:
    """A device of 0.02 to 2 kg with an encoder of 1 to 50 um; few windows, so few programs."""
    mass, damping = 10.0 ** rng.uniform(-1.7, 0.3), 10.0 ** rng.uniform(-2.0, 0.5)
    loop = HapticLoop(
        device_mass=mass,
        device_damping=damping,
        sample_time=_T,
        delay=float(rng.choice([0.0, _T])),
        velocity=Velocity.difference(int(rng.choice([1, 5, 20]))),
    )
    of_wall = loop.limits().damping * rng.uniform(0.01, 0.99, walls)
    stiffest = loop.stiffness_limits(of_wall)[:, 1]
    stiffness = stiffest * np.where(
        np.arange(walls) % 2, rng.uniform(0.05, 1.0, walls), rng.uniform(1.0, 3.0, walls)
    )
    verdict = np.asarray(loop.verdict(stiffness, of_wall))
    encoder = 10.0 ** rng.uniform(-6.0, -4.3)
    return Device(loop, encoder, stiffness, of_wall, verdict)


def amplitudes(device: Device, rng: np.random.Generator, starts: int) -> tuple[int, int, float]:
    """How many simulated amplitudes exceed the proved bound, of how many, and the largest share."""
    radius = np.asarray(device.loop.spectral_radius(device.stiffness, device.damping).value)
    chosen = (device.verdict == Verdict.STABLE) & (radius < _SLOWEST)
    if not chosen.any():
        return 0, 0, 0.0
    wall = device.stiffness[chosen][:, None], device.damping[chosen][:, None]
    shape = len(wall[0]), max(1, starts // _ROUNDS)
    friction = rng.choice([0.0, 0.01, 0.1], (shape[0], 1))
    causes = {"encoder": device.encoder, "friction": friction, "force_step": 0.01}
    bound = np.asarray(device.loop.amplitude(*wall, **causes).position)
    push, speed = 10.0 ** rng.uniform(-1.0, 0.7, shape), 10.0 ** rng.uniform(-3.0, -1.0, shape)
    phase = rng.uniform(size=shape)
    above, share = 0, 0.0
    for _ in range(_ROUNDS):
        runs = jaxstab.contact(device.loop,
            *wall, **causes, push=push, speed=speed, phase=phase,
            one_sided=False, duration=_DURATION, path=False,
        )  # fmt: skip
        shares = runs.amplitude / bound
        above += int(np.count_nonzero(shares > 1.0 + _ROUNDING))
        share = max(share, float(shares.max()))
        best = np.argsort(shares, axis=1)[:, -max(1, shape[1] // 4) :]
        parents = best[:, rng.integers(best.shape[1], size=shape[1])]
        push, speed, phase = (np.take_along_axis(a, parents, 1) for a in (push, speed, phase))
        push, speed = (a * 10.0 ** rng.normal(0.0, 0.05, shape) for a in (push, speed))
        phase = phase + rng.normal(0.0, 0.05, shape)
    return above, _ROUNDS * int(np.prod(shape)), share


def ends(device: Device, rng: np.random.Generator, starts: int) -> Iterator[str]:
    """Name what is to be counted of one-sided contacts: verdict, friction, rules; do they rest."""
    shape = len(device.stiffness), starts
    friction = np.where(rng.random(shape) < 0.2, 0.0, 10.0 ** rng.uniform(-2.5, 0.0, shape))
    push, speed = 10.0 ** rng.uniform(-1.0, 0.7, shape), rng.uniform(0.0, 0.3, shape)
    wall = device.stiffness[:, None], device.damping[:, None]
    contact = jaxstab.contact(device.loop,
        *wall, friction=friction, encoder=device.encoder,
        phase=rng.uniform(size=shape), push=push, speed=speed, duration=_DURATION, path=False,
    )  # fmt: skip
    rests = _does_rest(contact)
    own = float(device.loop.device_damping)
    passive = np.broadcast_to(0.5 * wall[0] * _T + wall[1] < own, shape)
    abbott = wall[0] <= np.minimum(2.0 * own / _T, 2.0 * friction / device.encoder)
    bins = np.searchsorted(_BINS, friction)
    verdicts = np.broadcast_to(device.verdict[:, None], shape)
    for rest, code, number, is_passive, is_abbott in zip(
        *(a.ravel().tolist() for a in (rests, verdicts, bins, passive, abbott)), strict=True
    ):
        yield "runs"
        names = [f"{Verdict(code).name} {number}", Verdict(code).name, "all"]
        names += ["passive"] * is_passive + ["abbott"] * is_abbott
        for name in names:
            yield name
            if rest:
                yield f"{name} rests"


def by_ratio(devices: int, runs: int) -> Iterator[str]:
    """Name what is to be counted of undamped walls without delay: the ratios' region, the end."""
    rng = np.random.default_rng(37)
    for _ in range(devices):
        mass, hold = 10.0 ** rng.uniform(-1.7, 0.3), 10.0 ** rng.uniform(-1.0, 1.0, runs)
        damping, encoder = mass / _T * 10.0 ** rng.uniform(-3.0, -1.0), 1e-5
        stiffness = hold * 2.0 * damping / _T
        count = 10.0 ** rng.uniform(-1.0, 1.0, runs)
        contact = jaxstab.contact(
            HapticLoop(device_mass=mass, device_damping=damping, sample_time=_T),
            stiffness, 0.0,
            friction=stiffness * encoder / (2.0 * count), encoder=encoder,
            phase=rng.uniform(size=runs), duration=_LONG,
            push=stiffness * encoder * 10.0 ** rng.uniform(0.0, 3.0, runs), path=False,
        )  # fmt: skip
        small = contact.amplitude <= _BUZZ * encoder
        ends = np.where(_does_rest(contact), "rests", np.where(small, "buzzes", "moves"))
        for is_held, is_counted, end in zip(hold <= 1.0, count <= 1.0, ends, strict=True):
            yield f"ratios {int(is_held)}{int(is_counted)}"
            yield f"ratios {int(is_held)}{int(is_counted)} {end}"


def _does_rest(contact: Contact) -> np.ndarray:
    return np.isfinite(contact.time_to_rest)


def tables(counts: Mapping[str, Any]) -> dict[str, str]:
    """The tables of the page in Markdown, by name."""
    frictions = []
    for number, high in enumerate(_BINS):
        name = "0" if number == 0 else f"{_BINS[number - 1]:g} to {high:g}"
        frictions.append(
            (name, *(_share(counts, f"{code} {number}") for code in ("STABLE", "UNSTABLE")))
        )
    accepted = []
    for words, name in _RULES.items():
        share = counts.get(name, 0) / counts["all"]
        found = counts.get(f"{name} rests", 0) / counts["all rests"]
        accepted.append((words, f"{share:.1%}", _share(counts, name), f"{found:.1%}"))
    ratios = []
    for is_held in (1, 0):
        for is_counted in (1, 0):
            name = f"ratios {is_held}{is_counted}"
            sides = ("up to 1" if is_small else "above 1" for is_small in (is_held, is_counted))
            ends = (_share(counts, name, end) for end in ("rests", "buzzes", "moves"))
            ratios.append((*sides, *ends))
    buzz = f"buzz by {_BUZZ:g} steps at most"
    return {
        "frictions": of_cells(("friction in N", "stable, rests", "unstable, rests"), frictions),
        "rules": of_cells(
            ("rule", "walls that it accepts", "of these, rest", "of those that rest, accepted"),
            accepted,
        ),
        "ratios": of_cells(("K T/(2 b)", "K q/(2 f_c)", "rest", buzz, "move further"), ratios),
    }


def _share(counts: Mapping[str, Any], name: str, end: str = "rests") -> str:
    total = counts.get(name, 0)
    return f"{counts.get(f'{name} {end}', 0) / total:.1%} of {total:,}" if total else "none"


def draw() -> None:
    """Draw where a device like the omega rests, for some frictions."""
    from jaxstab.app.pictures.scene import contact_figure
    from jaxstab.app.scene.contact import walls_around

    loop = HapticLoop(
        device_mass=0.25, device_damping=0.1, sample_time=_T, delay=_T,
        velocity=Velocity.difference(window=0.02),
    )  # fmt: skip
    walls = walls_around(loop, _GRID)
    maps = {
        f"friction {friction:g} N, push 1 N": jaxstab.contact(
            loop,
            *walls,
            friction=friction,
            push=1.0,
            encoder=1e-5,
            path=False,
        )
        for friction in (0.0, 0.03, 0.1)
    }
    contact_figure(loop, walls, maps).savefig(PAGE.with_suffix(".png"), dpi=130)


if __name__ == "__main__":
    sys.exit(main("--small" in sys.argv))
