"""Scenes as users had them, judged by a polynomial that is formed here.

The device is a matrix in continuous time (``mpmath.expm`` holds the force over a sample), filters
are written out from their definitions, and the criterion of Schur and Cohn decides in 60 digits
whether p(z) is stable. Nothing of jaxstab computes here but what is tested.
"""

import json
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from campaign import first
from commands import run
from mpmath import mp, mpf

from jaxstab import Verdict
from jaxstab.app.scene import DesignStatus, Scene, design_loop, loop_of

DIGITS = 60
Polynomial = list[mpf]  # highest power of z first


class User(NamedTuple):
    """Tables of a scene with one wall (stiffness, damping), and whether that is stable."""

    device: dict[str, Any]
    period: float
    samples: float  # of delay
    velocity: dict[str, Any]
    wall: tuple[float, float]
    is_stable: bool
    hand: dict[str, float] = {}  # noqa: RUF012
    position: dict[str, Any] = {}  # noqa: RUF012

    @property
    def tables(self) -> dict[str, Any]:
        """The scene as a file has it."""
        controller: dict[str, Any] = {
            "sample_time": self.period, "delay_samples": self.samples, "velocity": self.velocity,
        }  # fmt: skip
        if self.position:
            controller["position"] = self.position
        wall = dict(zip(("stiffness", "damping"), self.wall, strict=True))
        tables = {"device": self.device, "controller": controller, "walls": {"wall": wall}}
        return tables | ({"hand": self.hand} if self.hand else {})


def mass(kilograms: float, damping: float, **more: Any) -> dict[str, Any]:
    return {"mass": kilograms, "damping": damping, **more}


def inertia(moment: float, damping: float, **more: Any) -> dict[str, Any]:
    return {"inertia": moment, "damping": damping, **more}


def window(samples: int) -> dict[str, Any]:
    return {"window_samples": samples}


def low_pass(cutoff: float) -> dict[str, Any]:
    return {"cutoff": cutoff}


MS = 1e-3
BUTTERWORTH = {"cutoff": 100.0, "order": 2, "kind": "butterworth"}
PERSON = {"mass": 0.5, "stiffness": 200.0, "damping": 3.0}
HELD = {"mass": 0.2, "stiffness": 300.0, "damping": 5.0}
MODE = {"frequency": 190.0, "damping_ratio": 0.05, "modal_mass": 0.2}
SERVO, STAGE = {"actuator": {"bandwidth": 300.0}}, mass(0.075, 0.3, modes=[MODE])
USERS = {
    # Devices with published or assumed numbers, and the walls that their software allows.
    "omega": User(mass(0.25, 0.1), MS, 1.0, window(20), (5000.0, 30.0), False),
    "omega, soft": User(mass(0.25, 0.1), MS, 1.0, window(20), (1000.0, 15.0), True),
    "falcon": User(mass(0.2, 0.1), MS, 1.0, window(15), (3000.0, 20.0), False),
    "phantom": User(mass(0.1, 1.5), MS, 0.0, window(1), (800.0, 5.0), True),
    "teleoperation": User(mass(0.5, 2.0), MS, 12.35, low_pass(100.0), (150.0, 5.0), True, PERSON),
    # Reports: simulators, a damper, a servo, an arm, a leg.
    "joint at 5 ms": User(inertia(0.01, 0.0), 5e-3, 0.0, window(1), (30.0, 1.0), True),
    "crank at 5 ms": User(inertia(2.216e-5, 0.0), 5e-3, 0.0, window(1), (0.61, 0.00367), False),
    "damper at 200 Hz": User(
        mass(0.5, 0.1), 5e-3, 1.0, window(1), (0.0, 40.0), True, {"stiffness": 50.0, "damping": 1.0}
    ),
    "servo": User(inertia(1e-3, 2e-3, **SERVO), MS, 1.0, low_pass(100.0), (5.0, 0.08), True),
    "arm at 500 Hz": User(inertia(2.0, 0.5), 2e-3, 2.0, low_pass(30.0), (2000.0, 60.0), True),
    "leg": User(inertia(0.00486, 0.02), MS, 1.0, low_pass(100.0), (20.0, 0.5), True),
    # Light, turned, fast or hardly damped.
    "light": User(mass(0.08, 0.05), 2.5e-4, 2.0, BUTTERWORTH, (4000.0, 12.0), True),
    "light, held": User(mass(0.08, 0.05), 2.5e-4, 2.0, BUTTERWORTH, (4000.0, 12.0), True, HELD),
    "turned": User(
        inertia(0.02, 0.02), MS, 2.0, {"window": 5e-3}, (300.0, 2.0), True, {"stiffness": 20.0}
    ),
    "a mode at 40 kHz": User(STAGE, 2.5e-5, 1.0, window(1), (20000.0, 0.0), False),
    "a mode at 40 kHz, smoothed": User(STAGE, 2.5e-5, 1.0, low_pass(500.0), (5000.0, 24.0), True),
    "damped": User(mass(0.05, 5.0), MS, 0.0, window(20), (1000.0, 10.0), True),
    "held, smoothed": User(
        mass(0.025, 0.16), MS, 0.0, window(1), (200.0, 2.0), True, {"stiffness": 1300.0}, window(5)
    ),
    "heavy and damped": User(
        mass(1.0, 77.391), 2.0**-10, 0.87, window(4), (0.0, 97.0), True, {"stiffness": 14114.8}
    ),
}


def toml_of(value: Any) -> str:
    """A value as TOML has it, tables within one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name} = {toml_of(entry)}" for name, entry in value.items()) + "}"
    return (
        "[" + ", ".join(map(toml_of, value)) + "]" if isinstance(value, list) else json.dumps(value)
    )


# --------------------------------------------------------------------------------- the judge


def times(*factors: Polynomial) -> Polynomial:
    product = [mpf(1)]
    for factor in factors:
        whole = [mpf(0)] * (len(product) + len(factor) - 1)
        for i, a in enumerate(product):
            for j, b in enumerate(factor):
                whole[i + j] += a * b
        product = whole
    return product


def added(*terms: Polynomial) -> Polynomial:
    length = max(map(len, terms))
    return [sum(c) for c in zip(*([mpf(0)] * (length - len(t)) + t for t in terms), strict=True)]


def device(user: User) -> tuple[mp.matrix, mp.matrix, mp.matrix]:
    """x' = A x + B u, position C x: the mass with its hand, modes beside it, a lag before all."""
    hand, table = user.hand, user.device
    mass = mpf(table.get("mass", table.get("inertia"))) + mpf(hand.get("mass", 0.0))
    parts = [(mass, table["damping"] + mpf(hand.get("damping", 0)), mpf(hand.get("stiffness", 0)))]
    for mode in table.get("modes", []):
        turn, own = 2 * mp.pi * mpf(mode["frequency"]), mpf(mode["modal_mass"])
        parts.append((own, 2 * own * turn * mpf(mode["damping_ratio"]), own * turn**2))
    size = 2 * len(parts)
    a, b, c = mp.zeros(size + 1), mp.zeros(size + 1, 1), mp.zeros(1, size + 1)
    for k, (m, damping, stiffness) in enumerate(parts):
        a[2 * k, 2 * k + 1], c[0, 2 * k] = 1, 1
        a[2 * k + 1, 2 * k], a[2 * k + 1, 2 * k + 1] = -stiffness / m, -damping / m
        if "actuator" in table:
            a[2 * k + 1, size] = 1 / m
        else:
            b[2 * k + 1, 0] = 1 / m
    if "actuator" in table:
        lag = 2 * mp.pi * mpf(table["actuator"]["bandwidth"])
        a[size, size], b[size, 0] = -lag, lag
    else:
        a, b, c = a[:size, :size], b[:size, :], c[:, :size]
    return a, b, c


def held(a: mp.matrix, b: mp.matrix, time: mpf) -> tuple[mp.matrix, mp.matrix]:
    """The state after a force that is held for a time: its own part, and that of the force."""
    size = a.rows
    both = mp.zeros(size + 1)
    both[:size, :size], both[:size, size] = a * time, b * time
    whole = mp.expm(both)
    return whole[:size, :size], whole[:size, size]


def numerator_and_denominator(a: mp.matrix, b: mp.matrix, c: mp.matrix) -> tuple[Polynomial, ...]:
    """C (z - A)^-1 B by the method of Faddeev and Le Verrier."""
    size = a.rows
    adjugate, above, below = mp.eye(size), list[mpf](), [mpf(1)]
    for k in range(1, size + 1):
        above.append((c * adjugate * b)[0])
        product = a * adjugate
        below.append(-sum(product[i, i] for i in range(size)) / k)
        adjugate = product + below[-1] * mp.eye(size)
    return above, below


def smoothing(table: dict[str, Any], period: mpf) -> tuple[Polynomial, Polynomial]:
    """The low pass of a table."""
    if "cutoff" not in table:
        return [mpf(1)], [mpf(1)]
    cutoff, order = mpf(table["cutoff"]) * period, table.get("order", 1)
    if table.get("kind") == "butterworth":  # of order 2, by z = (1 + s) / (1 - s)
        w = mp.tan(mp.pi * cutoff)
        plus, minus = [mpf(1), mpf(1)], [mpf(1), mpf(-1)]
        root = mp.sqrt(2) * w
        below = added(
            times(minus, minus),
            times([root], minus, plus),
            times([w**2], plus, plus),
        )
        return times([w**2], plus, plus), below
    pole = mp.exp(-2 * mp.pi * cutoff)
    return times(*[[1 - pole, mpf(0)]] * order), times(*[[mpf(1), -pole]] * order)


def windows(table: dict[str, Any], period: mpf) -> int:
    """The samples of the window of a table."""
    return (
        int(mp.nint(mpf(table["window"]) / period))
        if "window" in table
        else table.get("window_samples", 1)
    )


@cache
def parts(name: str, samples: float | None = None) -> tuple[Polynomial, Polynomial, Polynomial]:
    """p(z) without a wall, and what 1 N/m and 1 N s/m add; with another delay if it is given."""
    user = USERS[name]
    period, delay = mpf(user.period), mpf(user.samples if samples is None else samples)
    whole = int(mp.floor(delay))
    rest = delay - whole
    a, b, c = device(user)
    # Of a sample, the force of the sample before the last acts for the fraction of the delay.
    early, force_before = held(a, b, rest * period)
    late, force = held(a, b, (1 - rest) * period)
    above_now, below = numerator_and_denominator(late * early, force, c)
    above_before, _ = numerator_and_denominator(late * early, late * force_before, c)
    above = added([*above_now, mpf(0)], above_before)  # over z^(n + 1) D
    n, m = windows(user.velocity, period), windows(user.position, period)
    v_above, v_below = smoothing(user.velocity, period)
    v_above = times(v_above, [mpf(1), *[mpf(0)] * (n - 1), mpf(-1)])
    v_below = times(v_below, [n * period, *[mpf(0)] * n])
    p_above, p_below = smoothing(user.position, period)
    p_above, p_below = times(p_above, [mpf(1)] * m), times(p_below, [mpf(m), *[mpf(0)] * (m - 1)])
    base = times([mpf(1), *[mpf(0)] * (whole + 1)], below, v_below, p_below)
    return base, times(above, p_above, v_below), times(above, v_above, p_below)


def is_stable(name: str, stiffness: float, damping: float, samples: float | None = None) -> bool:
    """True if all roots of p(z) are inside the unit circle (Schur 1917, Cohn 1922)."""
    with mp.workdps(DIGITS):
        base, position, velocity = parts(name, samples)
        falling = added(
            base, [mpf(stiffness) * c for c in position], [mpf(damping) * c for c in velocity]
        )
        while len(falling) > 1:
            ratio = falling[-1] / falling[0]
            if abs(ratio) >= 1:
                return False
            falling = [p - ratio * q for p, q in zip(falling[:-1], falling[:0:-1], strict=True)]
        return True


def assert_largest(
    name: str, stiffness: float, damping: float, samples: float | None = None
) -> None:
    """A little softer is stable at about this damping, and a little stiffer is not."""
    near = [factor * damping for factor in (0.9, 0.99, 0.999, 1.0, 1.001, 1.01, 1.1)]
    assert any(is_stable(name, 0.999 * stiffness, each, samples) for each in near)
    assert not any(is_stable(name, 1.001 * stiffness, each, samples) for each in near)


# --------------------------------------------------------------------------------- the scenes


@pytest.mark.parametrize("name", USERS)
def test_the_verdict_of_the_wall_is_that_of_the_judge(name: str) -> None:
    user = USERS[name]
    assert is_stable(name, *user.wall) == user.is_stable
    code = loop_of(Scene.from_table(user.tables)).verdict(*user.wall)
    assert code == (Verdict.STABLE if user.is_stable else Verdict.UNSTABLE)


@pytest.mark.parametrize("name", first(USERS, 8))
def test_the_commands_give_the_limit_and_the_verdict_of_the_judge(
    name: str, tmp_path: Path
) -> None:
    user, path = USERS[name], tmp_path / "scene.toml"
    lines = (f"{name} = {toml_of(table)}" for name, table in user.tables.items())
    path.write_text("\n".join(lines), encoding="utf-8")
    limits = run("limits", path, "--json")
    assert limits.exit_code == int(not user.is_stable), limits.stderr
    best = json.loads(limits.stdout)["best"]
    assert_largest(name, best["largest_stiffness"], best["at_damping"])
    check = run("check", path)
    assert check.exit_code == (0 if user.is_stable else 1), check.stdout + check.stderr
    assert ("unstable" in check.stdout) == (not user.is_stable)


def test_a_crank_of_a_simulator_has_the_limit_of_the_exact_hold() -> None:
    """12 - 8 sqrt(2) times J/T^2; a semi-implicit Euler step of the same gains allows 3.55."""
    user = USERS["crank at 5 ms"]
    limit = loop_of(Scene.from_table(user.tables)).limits().stiffness
    exact = (12.0 - 8.0 * 2.0**0.5) * 2.216e-5 / 5e-3**2
    assert limit == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize(
    "samples",
    [
        60.0,
        *(
            pytest.param(x, marks=pytest.mark.campaign)
            for x in (63.5, 64.0, 90.0, 105.79979179173486)
        ),
    ],
)
def test_slow_loops_of_a_device_with_a_mode_are_resolved(samples: float) -> None:
    """So close to a corner rounding decides which roots are inside: no piece ends where it does."""
    name = "a mode at 40 kHz, smoothed"
    tables = USERS[name].tables
    tables["controller"]["delay_samples"] = samples
    limits = loop_of(Scene.from_table(tables)).limits()
    assert_largest(name, limits.stiffness, limits.at_damping, samples)


@pytest.mark.campaign
def test_design_answers_at_40_khz_with_a_slow_filter() -> None:
    name, wanted = "a mode at 40 kHz, smoothed", 9000.0
    designed = design_loop(
        Scene.from_table({**USERS[name].tables, "wanted": {"stiffness": wanted}})
    )
    longest, damping = designed.delay.largest_delay, designed.delay.at_damping
    assert designed.delay.status == designed.sample_time.status == DesignStatus.FOUND
    assert damping is not None
    assert_largest(name, wanted, damping, longest / USERS[name].period)
