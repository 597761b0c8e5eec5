"""Thirty loops answered by what people use, and by jaxstab: how far may one gain go, and verdicts.

Ten walls of one mass, ten estimators of velocity, five simulated joints, five admittances. The
question is the end of the stable interval around a small gain (of an admittance: the least damping
at a mass), and the verdict at ``SHARES`` on either side of it. Tools (``benchmarks.tools``) are
given p(z) in float64, rounded once from the truth: what forming it costs is not in their times.
jaxstab has the numbers of the device. The truth is mpmath's: equations of motion, difference
equations or the rule of the engine, and the criterion of Schur and Cohn in 120 digits, halved
between neighbours of a scan of eigenvalues.

A row is a tool on a group of loops: ``error`` is the largest relative error of an end (1 where none
is found), ``wrong`` counts verdicts, ``lines`` those that a user writes, ``first_seconds`` the CPU
time of a fresh process. "jaxstab, batched" is ``limits_of`` and ``HapticLoop.verdict`` for arrays:
it finds the stiffest wall over all dampings, judged at its own damping. "jaxstab, atlas" looks up
walls in the table of the default range. MuJoCo joins where it can, in joints.
"""

import inspect
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from statistics import median
from typing import Any, NamedTuple

import numpy as np
from mpmath import mp, mpf

import jaxstab
from benchmarks import latency
from benchmarks.record import Row
from benchmarks.timing import Timing, interleaved
from benchmarks.tools import EXAMPLE, MUJOCO, TOOLS, IsStable, Joint, Line, Tool
from jaxstab import HapticLoop, Loop, Velocity, Verdict
from jaxstab.atlas.nodes import table_of
from tests.truth import filtered, plain
from tests.truth.devices import Mechanism
from tests.truth.filtered import Rational

MEASURE = "largest relative error of the end of a stable interval, by mpmath"
SHARES = tuple(side * 10.0**-k for k in (3, 6, 9, 12) for side in (-1, 1))
_EXAMPLE = (
    "import jaxstab\n"
    "loop = jaxstab.HapticLoop(device_mass=1, device_damping=0, sample_time=1, delay=1)\n"
    f"print(loop.stiffness_intervals({EXAMPLE.other}).intervals[0].high.value)"
)
_T = 1e-3  # s
_BATCH, _RUNS = 1000, 3
MISSED = 0.01  # an end this far off is another crossing, or none
_SCAN = 1000  # eigenvalues between two doublings of the gain

Parts = list[plain.Falling]
Walls = list[list[float]]


class Case(NamedTuple):
    """One loop: as jaxstab has it, the names of its gains, its parts, and what is asked."""

    loop: HapticLoop | Loop
    names: tuple[str, str]
    parts: Parts
    line: Line

    @classmethod
    def of(
        cls, loop: HapticLoop | Loop, names: tuple[str, str], parts: Parts, *asked: Any
    ) -> "Case":
        """Tools have the parts in float64."""
        rounded = np.array([[float(c) for c in part] for part in parts])
        return cls(loop, names, parts, Line(*rounded, *asked))

    def interval(self) -> float:
        """The end by jaxstab."""
        if isinstance(self.loop, HapticLoop):
            found = self.loop.stiffness_intervals(self.line.other)
        else:
            found = self.loop.intervals(**{self.names[1]: self.line.other})
        low, high = next(
            (low.value, high.value)
            for low, high in found.intervals
            if low.value <= self.line.start <= high.value
        )
        return high if self.line.towards > 1.0 else low

    def verdict(self, gain: Any) -> Any:
        """The verdict by jaxstab; of a ``Loop`` gains have names."""
        loop: Any = self.loop
        return loop.verdict(**dict(zip(self.names, (gain, self.line.other), strict=True)))

    def is_stable(self, gain: Any) -> bool:
        """The truth."""
        with mp.workdps(plain.DIGITS):
            t, u = mpf(gain), mpf(self.line.other)
            falling = [b + t * f + u * s for b, f, s in zip(*self.parts, strict=True)]
            return bool(plain.is_stable_in_digits(falling))

    def end(self) -> mpf:
        """The true end: next to the first unstable of a scan by eigenvalues, halved from there."""
        low, high = self.line.start, self.line.start * self.line.towards
        while True:
            scan = np.geomspace(low, high, _SCAN)
            radii = [np.abs(np.roots(p)).max() for p in self.line.at(scan)]
            if max(radii) > 1.0 + 1e-9:
                break
            low, high = high, high * self.line.towards
        first = int(np.argmax(np.array(radii) > 1.0 + 1e-9))
        with mp.workdps(50):
            stable, unstable = mpf(scan[max(first - 2, 0)]), mpf(scan[first])
            if not self.is_stable(stable) or self.is_stable(unstable):
                raise ArithmeticError(f"no end between {stable} and {unstable}: {self.loop}")
            for _ in range(100):
                middle = (stable + unstable) / 2
                if self.is_stable(middle):
                    stable = middle
                else:
                    unstable = middle
            return stable


class Asked(NamedTuple):
    """A tool on a group: ends of so many loops, and verdicts on so many walls, in one call each."""

    ends: Callable[[], Any]
    loops: int
    lines: int
    verdicts: Callable[[], Any] | None = None
    walls: int = 0
    process: tuple[str, ...] = ()  # words for a Python that answers the example


def rows(small: bool) -> Iterator[Row]:
    for group, cases in groups().items():
        if small:
            yield from _rows(group, cases[:1], 0.05, 8, runs=int(group == "walls"))
        else:
            yield from _rows(group, cases, 0.3, _BATCH, runs=_RUNS)


def _rows(group: str, cases: list[Case], budget: float, batch: int, *, runs: int) -> Iterator[Row]:
    truths = [case.end() for case in cases]
    walls = [[float(end * (1 + mpf(share))) for share in SHARES] for end in truths]
    pairs = zip(cases, walls, strict=True)
    stable = np.array([[case.is_stable(gain) for gain in row] for case, row in pairs])
    asked = _jaxstab(group, cases, walls, batch) | {
        name: _tool(name, tool, group == "walls" or name == MUJOCO, cases, walls)
        for name, tool in TOOLS.items()
        if name != MUJOCO or group == "simulators"
    }
    ends = interleaved({name: one.ends for name, one in asked.items()}, budget=budget, least=1)
    verdicts = {name: one.verdicts for name, one in asked.items() if one.verdicts}
    judged = interleaved(verdicts, budget=budget, least=1)
    for name, one in asked.items():
        errors = [_error(*each) for each in zip(cases, truths, ends[name].answer, strict=True)]
        fresh = [latency.run(one.process).seconds for _ in range(runs) if one.process]
        yield ends[name].row(
            group,
            name,
            max(errors),
            MEASURE,
            points=one.loops,
            cpu_seconds_per_loop=ends[name].cpu_median / one.loops,
            missed=sum(error > MISSED for error in errors),
            judged=len(cases),
            largest_error_found=max((e for e in errors if e <= MISSED), default=1.0),
            lines=one.lines,
            **(_verdicts(one, judged[name], stable) if one.verdicts else {}),
            **({"first_seconds": median(fresh)} if fresh else {}),
        )


def _error(case: Case, end: mpf, answer: Any) -> float:
    """Relative, 1 at most; the stiffest wall over all dampings is judged at its own."""
    gain, *other = np.atleast_1d(answer).tolist()
    if other:
        end = case._replace(line=case.line._replace(other=other[0])).end()
    return float(min(abs(mpf(gain) / end - 1), mpf(1))) if np.isfinite(gain) else 1.0


def _verdicts(one: Asked, timing: Timing, stable: np.ndarray) -> Row:
    codes = np.reshape(timing.answer, stable.shape)
    right = codes == np.where(stable, Verdict.STABLE, Verdict.UNSTABLE)
    is_open = codes == Verdict.UNDECIDED
    return {
        "cpu_seconds_per_verdict": timing.cpu_median / one.walls,
        "verdicts": stable.size,
        "wrong": int(np.sum(~right & ~is_open)),
        "open": int(np.sum(is_open)),
    }


def _tool(name: str, tool: Tool, is_first: bool, cases: list[Case], walls: Walls) -> Asked:
    lines = [case.line for case in cases]

    def end(line: Line) -> float:
        try:
            return tool.end(line)
        except ValueError:  # no crossing is found
            return np.nan

    def codes(is_stable: IsStable) -> list[Verdict]:
        pairs = ((line, gain) for line, row in zip(lines, walls, strict=True) for gain in row)
        return [Verdict.STABLE if is_stable(*pair) else Verdict.UNSTABLE for pair in pairs]

    return Asked(
        lambda: list(map(end, lines)), len(lines), sum(map(_length, tool.written)),
        partial(codes, tool.is_stable) if tool.is_stable else None, len(lines) * len(SHARES),
        ("-W", "ignore", "-m", "benchmarks.tools", name) if is_first else (),
    )  # fmt: skip


def _length(function: Callable[..., Any]) -> int:
    """Lines of a function without its docstring."""
    source, words = inspect.getsource(function), function.__doc__ or ""
    return len(source.splitlines()) - len(words.splitlines())


def _jaxstab(group: str, cases: list[Case], walls: Walls, batch: int) -> dict[str, Asked]:
    count = len(cases)
    pairs = [pair for case, row in zip(cases, walls, strict=True) for pair in product([case], row)]
    found = {
        "jaxstab": Asked(
            lambda: [case.interval() for case in cases], count, 3,
            lambda: [int(case.verdict(gain)) for case, gain in pairs], len(pairs),
            ("-c", _EXAMPLE) if group == "walls" else (),
        )
    }  # fmt: skip
    loops = [case.loop for case in cases if isinstance(case.loop, HapticLoop)]
    if not loops:
        return found
    spread = np.linspace(1.0, 2.0, batch)
    batches = [replace(loop, device_mass=loop.device_mass * spread) for loop in loops]

    def stiffest() -> list[tuple[float, float]]:
        answers = map(jaxstab.limits_of, batches)
        return [(float(one.stiffness[0]), float(one.at_damping[0])) for one in answers]

    many = [np.tile(row, batch) for row in walls]

    def dense() -> list[Any]:
        each = zip(cases, many, strict=True)
        return [np.asarray(case.verdict(gains))[: len(SHARES)] for case, gains in each]

    found["jaxstab, batched"] = Asked(
        stiffest, count * batch, 3, dense, sum(gains.size for gains in many)
    )
    if group == "walls":
        table = table_of(jaxstab.AtlasSpec())
        numbers = [
            (one.device_mass, case.line.other, one.hand_stiffness, one.device_damping, one.delay)
            for case, one in zip(cases, loops, strict=True)
        ]
        mass, *others = np.repeat(np.array(numbers, float), batch, axis=0).T
        units = _T / mass, _T**2 / mass, _T / mass, 1.0 / _T
        place = [number * unit for number, unit in zip(others, units, strict=True)]
        found["jaxstab, atlas"] = Asked(
            lambda: (table.limits(*place).upper * mass / _T**2)[::batch], mass.size, 4
        )
    return found


# ---------------------------------------------------------------------------------------- the loops


def groups() -> dict[str, list[Case]]:
    walls = (
        (0.1, 0.1, 0.0, 0.0), (0.25, 0.1, 0.0, 0.0), (0.5, 2.0, 100.0, 0.5), (0.1, 1.0, 50.0, 1.0),
        (0.25, 0.1, 0.0, 1.0), (0.4, 5.0, 300.0, 1.0), (1.0, 0.5, 0.0, 1.5), (0.25, 2.0, 0.0, 2.0),
        (0.7, 0.1, 400.0, 2.0), (0.25, 0.1, 0.0, 3.0),
    )  # fmt: skip
    windows = (
        (2, 1.0, 0.2), (5, 1.0, 0.1), (10, 1.0, 0.06), (20, 1.0, 0.03), (20, 0.0, 0.03),
        (40, 0.5, 0.015),
    )  # fmt: skip
    smooth = (
        (Velocity.low_pass(100.0), filtered.low_pass(0.1, 1), 1.0, 0.2),
        (Velocity.low_pass(20.0), filtered.low_pass(0.02, 1), 1.0, 0.12),
        (Velocity.butterworth(50.0, order=2), filtered.butterworth(0.05, 2), 2.0, 0.05),
        (Velocity.exponential(0.2), filtered.exponential(0.2), 0.0, 0.2),
    )
    one, omega, step = Velocity.difference(samples=1), (0.25, 0.1, 0.0), filtered.difference(1)
    estimators = [
        *((Velocity.difference(samples=n), filtered.difference(n), *rest) for n, *rest in windows),
        *((velocity, filtered.times(step, own), *rest) for velocity, own, *rest in smooth),
    ]
    return {
        "walls": [_wall(body, one, step, delay, 0.3 / (1.0 + delay)) for *body, delay in walls],
        "estimators": [_wall(omega, *estimator) for estimator in estimators],
        "simulators": [_joint(*joint) for joint in _JOINTS],
        "admittance": [_admittance(*robot) for robot in _ROBOTS],
    }


def _wall(
    body: Sequence[float], velocity: Velocity, truth: Rational, delay: float, share: float
) -> Case:
    """A wall on one mass, damping and stiffness; B is a share of m/T."""
    mass, damping, stiffness = body
    loop = HapticLoop(
        device_mass=mass, device_damping=damping, hand_stiffness=stiffness, sample_time=_T,
        delay=delay * _T, velocity=velocity,
    )  # fmt: skip
    system = Mechanism([(mpf(mass), mpf(damping), mpf(stiffness))]).system()
    parts = plain.Loop.from_parts(loop, system, delay, (truth, filtered.average(1)))[1:]
    return Case.of(loop, ("stiffness", "damping"), list(parts), share * mass / _T, 10.0)


_JOINTS = (
    # rule of jaxstab and of MuJoCo, kd in units of J/step
    (Joint(0.1, 0.5, 2e-3, "Euler"), 0.3),
    (Joint(2.2e-5, 1e-4, 5e-3, "Euler"), 0.5),
    (Joint(0.1, 0.5, 2e-3, "implicitfast"), 0.3),
    (Joint(0.1, 0.0, 2e-3, "Euler", substeps=4), 0.1),
    (Joint(1.5, 0.0, 1e-3, "Euler", substeps=1, delay_steps=2), 0.1),
)


def _joint(joint: Joint, share: float) -> Case:
    """A simulated joint: J' v+ = J v + h torque, J' = J + h c, and + h kd where kd is implicit.

    Those that hold their torque for n steps have no damping: x + n h v + n (n + 1)/2 h^2 torque/J.
    """
    rules = {"Euler": "implicit-joint", "implicitfast": "implicit-damping"}
    loop = jaxstab.simulated_pd(
        joint.inertia, step=joint.step, damping=joint.damping, integrator=rules[joint.integrator],
        outside=joint.substeps > 0, substeps=max(joint.substeps, 1), delay_steps=joint.delay_steps,
    )  # fmt: skip
    with mp.workdps(plain.DIGITS):
        inertia, step, n = mpf(joint.inertia), mpf(joint.step), max(joint.substeps, 1)
        heavy = inertia + step * mpf(joint.damping)
        base = [heavy, -heavy - inertia, inertia] + [mpf(0)] * joint.delay_steps
        kp = [step**2 * n * (n + 1) / 2, step**2 * n * (n - 1) / 2]
        kd = [step * n, -step * n] + [mpf(0)] * (joint.integrator == "implicitfast")
        parts = _padded(base, kp, kd)
    kd_given, start = share * joint.inertia / joint.step, 1e-3 * joint.inertia / joint.step**2
    return Case.of(loop, ("kp", "kd"), parts, kd_given, start, 2.0, joint)


_ROBOTS = (  # environment in N/m, T in s, samples of delay, mass in kg: the least damping
    (1e3, 2e-3, 10, 10.0), (1e4, 1e-3, 4, 2.0), (1e5, 8e-3, 3, 20.0), (5e3, 1e-3, 1, 1.0),
    (2e4, 4e-3, 2, 5.0),
)  # fmt: skip


def _admittance(environment: float, period: float, delay: int, mass: float) -> Case:
    loop = jaxstab.admittance(environment, sample_time=period, delay_samples=delay)
    with mp.workdps(plain.DIGITS):
        late, inverse = [mpf(0)] * delay, 1 / mpf(period)
        parts = _padded(
            [mpf(environment) * mpf(period), mpf(0)], [mpf(1), mpf(-1), *late],
            [inverse, -2 * inverse, inverse, *late],
        )  # fmt: skip
    start = 1.25 * environment * period * delay
    return Case.of(loop, ("damping", "mass"), parts, mass, start, 0.5)


def _padded(*parts: plain.Falling) -> Parts:
    size = max(map(len, parts))
    return [[mpf(0)] * (size - len(part)) + part for part in parts]
