"""Random loops of any two gains, each with its recursion: float64, and exact where asked.

The exact recursion of engines and admittances is one of fractions. Held masses move by exponentials
of 60 digits. Its characteristic polynomial is that of a matrix of fractions; whether all roots are
inside is the recursion of Schur and Cohn in numbers of 120 digits. Nothing of it is jaxstab's.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import lru_cache, partial
from typing import Any, NamedTuple

import mpmath
import numpy as np

import jaxstab
from jaxstab.results import RegionStatus
from tests.truth import recursions

Rng = np.random.Generator


class Case(NamedTuple):
    """A loop, how its intervals at a value of one of two gains are asked, and its recursion."""

    loop: Any
    gains: tuple[str, str]
    intervals: Callable[..., Any]
    matrix: Callable[..., np.ndarray]  # of both gains, exact with exact=True
    is_affine: bool
    scale: tuple[float, float]


def _of(loop: jaxstab.Loop, matrix: Callable[..., np.ndarray], *, is_affine: bool) -> Case:
    from jaxstab.loop.affine import _units

    first, second = (gain.name for gain in loop.gains)
    scale = _units(loop.parts)
    return Case(loop, (first, second), loop.intervals, matrix, is_affine, scale)


def simulator(rng: Rng) -> Case:
    inside = bool(rng.integers(2))
    rules = ["explicit", "semi-implicit", "implicit-joint"]
    rules += ["implicit-damping", "implicit"] if inside else ["rk4"]
    engine = {"inertia": 10 ** rng.uniform(-5, 1), "step": 10 ** rng.uniform(-4, -2)}
    size = engine["inertia"] / engine["step"]
    engine["damping"] = float(rng.choice([0.0, 0.01, 0.1])) * size
    engine["stiffness"] = float(rng.choice([0.0, 0.001, 0.1])) * size / engine["step"]
    rule, timing = str(rng.choice(rules)), {"substeps": 1, "delay_steps": 0}
    if not inside:
        substeps = int(rng.integers(1, 9))
        timing = {"substeps": substeps, "delay_steps": int(rng.integers(0, 27 * substeps))}
    loop = jaxstab.simulated_pd(**engine, integrator=rule, outside=not inside, **timing)

    def matrix(kp: float, kd: float, *, exact: bool = False) -> np.ndarray:
        number, one = (Fraction, Fraction(1)) if exact else (float, 1.0)
        own = {name: number(value) for name, value in engine.items()}
        gains = number(kp), number(kd)
        return recursions.simulated(
            *gains, inside=inside, integrator=rule, **timing, **own, one=one
        )

    return _of(loop, matrix, is_affine=not inside)


def admittance(rng: Rng) -> Case:
    given = {"environment": 10 ** rng.uniform(2, 5), "sample_time": 10 ** rng.uniform(-4, -2)}
    given["stiffness"] = float(rng.choice([0.0, 0.01, 0.1])) * given["environment"]
    rule = str(rng.choice(["forward", "backward", "explicit", "trapezoid"]))
    late = int(rng.integers(rule == "trapezoid", 28))
    loop = jaxstab.admittance(**given, delay_samples=late, rule=rule)

    def matrix(mass: float, damping: float, *, exact: bool = False) -> np.ndarray:
        number, one = (Fraction, Fraction(1)) if exact else (float, 1.0)
        own: dict[str, Any] = {name: number(value) for name, value in given.items()}
        gains = number(mass), number(damping)
        return recursions.admittance(*gains, **own, delay_samples=late, rule=rule, one=one)

    case = _of(loop, matrix, is_affine=False)
    period, wall = given["sample_time"], given["environment"]
    delay = period * (late + 1)
    return case._replace(scale=(wall * delay * period, wall * delay))


def _body(rng: Rng, *, damping: float | None = None, stiffness: float | None = None) -> list[float]:
    mass = 10 ** rng.uniform(-2, 1)
    damping = float(rng.choice([0.0, 0.1, 10.0])) if damping is None else damping
    stiffness = float(rng.choice([0.0, 100.0])) if stiffness is None else stiffness
    return [mass, damping * mass, stiffness * mass]


def _device(body: list[float]) -> jaxstab.Device:
    mass, damping, stiffness = body
    return jaxstab.Device.mass_spring_damper(mass, damping=damping, stiffness=stiffness)


def _delay(rng: Rng, longest: int) -> float:
    return float(rng.integers(0, longest)) + float(rng.choice([0.0, 0.0, 0.5, 0.25]))


@lru_cache(16)
def _held(*numbers: float, exact: bool) -> recursions.HeldMass:
    if not exact:
        return recursions.HeldMass(*numbers)
    *own, delay = numbers
    return recursions.HeldMass(*map(mpmath.mpf, own), delay, exponential=_exponential)


def _exponential(rates: np.ndarray) -> np.ndarray:
    matrix = mpmath.matrix(rates.tolist())
    return np.array(mpmath.expm(matrix).tolist(), object).reshape(rates.shape)


def _pid(rng: Rng, given: str) -> Case:
    body, period = _body(rng), 10 ** rng.uniform(-4, -2)
    window = int(rng.integers(1, 13))
    delay = _delay(rng, 28 - window - 4)
    velocity = jaxstab.Velocity.difference(samples=window)
    held = jaxstab.HapticLoop(
        device=_device(body), sample_time=period, delay=delay * period, velocity=velocity
    )
    size, lags = body[0] / period, delay + window
    value = float(rng.choice([0.01, 0.1, 0.3])) * size / lags
    value *= {"kd": 1.0, "kp": 0.1 / (period * lags), "ki": 0.1 / (period * lags) ** 2}[given]
    rule = str(rng.choice(["backward", "forward", "trapezoid"]))
    options = {given: value}

    def matrix(*gains: float, exact: bool = False, is_open: bool = False) -> np.ndarray:
        number, one = (mpmath.mpf, mpmath.mpf(1)) if exact else (float, 1.0)
        others = [name for name in ("kp", "ki", "kd") if name != given]
        every = dict(zip(others, gains, strict=True)) | ({given: 0.0} if is_open else options)
        every = {name: number(x) for name, x in every.items()}
        plant = _held(*body, period, held.delay_samples, exact=exact)
        own = {"period": number(period), "rule": rule, "window": window, "one": one}
        return recursions.pid(**every, plant=plant, **own)

    return _of(jaxstab.pid(held, **options, rule=rule), matrix, is_affine=True)  # type: ignore[arg-type]


def coupled(
    bodies: Sequence[Sequence[float] | None],
    delays: Sequence[float],
    period: float,
    window: int,
    *gains: float,
    exact: bool = False,
) -> np.ndarray:
    number, one = (mpmath.mpf, mpmath.mpf(1)) if exact else (float, 1.0)
    plants: list[Any] = [
        recursions.Wall() if body is None else _held(*body, period, delay, exact=exact)
        for body, delay in zip(bodies, delays, strict=True)
    ]
    rigid = [2 if body is None else (body[2] == 0.0) * (1 + (body[1] == 0.0)) for body in bodies]
    drift = 2 if bodies[1] is None else min(rigid)
    own = {"period": number(period), "window": window, "drift": drift, "one": one}
    return recursions.coupling(*map(number, gains), *plants, **own)


def wall(rng: Rng) -> Case:
    body, period, window = _body(rng), 10 ** rng.uniform(-4, -2), int(rng.integers(1, 15))
    velocity = jaxstab.Velocity.difference(samples=window)
    delay = _delay(rng, 28 - window) * period
    held = jaxstab.HapticLoop(
        device_mass=body[0],
        device_damping=body[1],
        hand_stiffness=body[2],
        sample_time=period,
        delay=delay,
        velocity=velocity,
    )
    matrix = partial(coupled, [body, None], [held.delay_samples, 0.0], period, window)
    scale = held.stiffness(1.0) / (held.delay_samples + window) ** 2, held.damping(1.0)

    def intervals(**gain: float) -> Any:
        (name, value) = next(iter(gain.items()))
        ask = held.stiffness_intervals if name == "damping" else held.damping_intervals
        return ask(value)

    return Case(held, ("stiffness", "damping"), intervals, matrix, True, scale)


def _coupling(rng: Rng, bodies: list[list[float]], longest: int) -> Case:
    period, window = 10 ** rng.uniform(-4, -2), int(rng.integers(1, 7))
    delays = [_delay(rng, longest), _delay(rng, 8)]
    velocity = jaxstab.Velocity.difference(samples=window)
    devices = [_device(body) for body in bodies]
    loop = jaxstab.coupling(
        devices[0], devices[1], sample_time=period, delays_samples=delays, velocity=velocity
    )
    matrix = partial(coupled, list(bodies), delays, period, window)
    return _of(loop, matrix, is_affine=True)


def to_a_tool(rng: Rng) -> Case:
    """A device and a free tool: both drift."""
    damping = None if rng.integers(2) else 0.0
    bodies = [_body(rng, stiffness=0.0, damping=damping) for _ in range(2)]
    return _coupling(rng, bodies, 16)


def two_devices(rng: Rng) -> Case:
    return _coupling(rng, [_body(rng), _body(rng, stiffness=100.0)], 14)


KINDS = {
    "wall": wall,
    "simulator": simulator,
    "admittance": admittance,
    "kp-ki": partial(_pid, given="kd"),
    "kp-kd": partial(_pid, given="ki"),
    "coupling": to_a_tool,
    "two devices": two_devices,
    "ki-kd": partial(_pid, given="kp"),
}


def polynomial_exactly(matrix: np.ndarray) -> list[Any]:
    """The characteristic polynomial in fractions, as numbers of mpmath, the highest power first."""
    from flint import fmpq, fmpq_mat

    def rational(number: Any) -> Any:
        if isinstance(number, Fraction | int):
            return fmpq(number.numerator, number.denominator)
        sign, mantissa, exponent, _ = mpmath.mpf(number)._mpf_
        whole = -int(mantissa) if sign else int(mantissa)
        return fmpq(whole * 2 ** max(exponent, 0), 2 ** max(-exponent, 0))

    size = len(matrix)
    coefficients = fmpq_mat(size, size, [rational(x) for x in matrix.ravel()]).charpoly().coeffs()
    return [mpmath.mpf(int(c.p)) / int(c.q) for c in coefficients[::-1]]


def is_stable_exactly(matrix: np.ndarray) -> bool | None:
    """True if all eigenvalues are inside; None within 1e-40 of the circle."""
    rising = polynomial_exactly(matrix)[::-1]
    while rising[0] == 0:
        rising = rising[1:]
    while len(rising) > 1:
        k = rising[0] / rising[-1]
        if abs(abs(k) - 1) < mpmath.mpf(10) ** -40:
            return None
        if abs(k) > 1:
            return False
        rising = [a - k * b for a, b in zip(rising[1:], rising[-2::-1], strict=True)]
    return True


def judged(kind: str, loops: int, gains: int, *, exactly: int = 4, seed: int = 54) -> Counter[str]:
    """Count the verdicts on random gains of random loops of a kind, and the wrong ones.

    Half of the gains are next to ends of proved intervals, 1e-12 to 0.1 beside them. All are asked
    as one grid, some also one by one. Eigenvalues judge where they are far from the circle; next to
    it, and where they disagree, exact numbers do, for ``exactly`` gains of a loop at most.
    """
    counts: Counter[str] = Counter()
    rng = np.random.default_rng([seed, list(KINDS).index(kind)])
    for index in range(loops):
        case = KINDS[kind](rng)
        points = _points(case, rng, gains)
        asked = dict(zip(case.gains, points.T, strict=True))
        codes = np.asarray(case.loop.verdict(**asked))
        radii = _radii(case, points)
        is_far = abs(radii - 1.0) > 1e-4
        counts["loops"] += 1
        counts["by eigenvalues"] += int(np.sum(is_far & (codes != 3)))
        counts["undecided"] += int(np.sum(codes == 3))
        claims = codes == 1
        near = rng.permutation(np.flatnonzero(~is_far))[:exactly]
        doubted = np.flatnonzero(is_far & (codes != 3) & (claims != (radii < 1.0)))
        for k in (*near, *doubted):
            first, second = points[k].tolist()
            with mpmath.workdps(120):
                truth = is_stable_exactly(case.matrix(first, second, exact=True))
            alone = case.loop.verdict(**dict(zip(case.gains, (first, second), strict=True)))
            if truth is None:
                continue
            for code in (codes[k], int(alone)):
                counts["exactly"] += 1
                counts["undecided of these"] += int(code == 3)
                if code != 3 and (code == 1) != truth:
                    counts["wrong"] += 1
                    counts[f"wrong: {kind} {index} {first!r} {second!r} {code} {truth}"] += 1
    return counts


def judged_regions(kind: str, loops: int, gains: int, *, seed: int = 55) -> Counter[str]:
    """Count the regions of random loops of a kind, and the gains that they hold or miss wrongly.

    Half of the gains are vertices moved by up to 30 %. Those with an eigenvalue within 1e-4 of the
    circle are left out.
    """
    counts: Counter[str] = Counter()
    rng = np.random.default_rng([seed, list(KINDS).index(kind)])
    for index in range(loops):
        case = KINDS[kind](rng)
        region, points = case.loop.region(), _points(case, rng, gains)
        counts[region.status.name] += 1
        if region.status != RegionStatus.COMPLETE:
            continue
        vertices = rng.choice(region.outline, gains // 2)
        points[: gains // 2] = vertices * (1.0 + rng.uniform(-0.3, 0.3, vertices.shape))
        if not case.is_affine:  # a recursion divides by its mass
            points = points[points.all(axis=1)]
        holds = np.asarray(region.contains(**dict(zip(case.gains, points.T, strict=True))))
        radii = _radii(case, points)
        is_far = abs(radii - 1.0) > 1e-4
        is_wrong = is_far & (holds != (radii < 1.0))
        counts["gains"] += int(np.sum(is_far))
        counts["stable"] += int(np.sum(is_far & holds))
        counts["wrong"] += int(np.sum(is_wrong))
        for k in np.flatnonzero(is_wrong)[:1]:
            counts[f"wrong: {kind} {index} {points[k].tolist()} {radii[k]}"] += 1
    return counts


def _points(case: Case, rng: Rng, count: int) -> np.ndarray:
    """Gains of a size that matters, and such next to the ends of intervals."""
    lines, scale = 4, np.array(case.scale)
    points = scale * 10 ** rng.uniform(-3, 0.5, (count, 2)) * rng.choice([1, 1, 1, -1], (count, 2))
    points[: count // 16, 1 if case.gains[0] == "mass" else rng.integers(2)] = 0.0
    rows = np.array_split(np.arange(count // 2, count), lines)
    for row in rows:
        axis = int(rng.integers(2))
        given = float(scale[1 - axis] * 10 ** rng.uniform(-2, 0))
        line = case.intervals(**{case.gains[1 - axis]: given})
        ends = [end.value for pair in line.intervals for end in pair if np.isfinite(end.value)]
        if ends:
            aside = 10 ** rng.uniform(-12, -1, row.size) * rng.choice([-1, 1], row.size)
            points[row, 1 - axis] = given
            points[row, axis] = rng.choice(ends, row.size) * (1 + aside)
    return points


def _radii(case: Case, points: np.ndarray) -> np.ndarray:
    if not case.is_affine:
        matrices = np.array([case.matrix(*pair) for pair in points.tolist()])
    else:
        base, *sides = (case.matrix(*pair) for pair in np.diag([0.0, *case.scale])[:, 1:].tolist())
        parts = [(side - base) / size for side, size in zip(sides, case.scale, strict=True)]
        matrices = base + np.einsum("pg,gij->pij", points, np.array(parts))
    return np.abs(np.linalg.eigvals(matrices)).max(axis=1)
