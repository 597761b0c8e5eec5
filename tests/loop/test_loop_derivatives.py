"""A loop as a pytree: derivatives by all that it is made of, against differences in 50 digits."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from campaign import many, some
from mpmath import mp, mpc, mpf

from jaxstab import Filter, HandRange, HapticLoop, Velocity, Verdict, limits_of, regions_of
from jaxstab.arrays import solved
from tests.truth.loop import evaluate, sampled_plant

Numbers = dict[str, Any]

PLAIN = HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3, delay=1e-3)
HELD = HapticLoop(
    device_mass=0.2, device_damping=0.1, hand_mass=0.3, hand_damping=3.0, hand_stiffness=150.0,
    sample_time=2e-3, delay=3.5e-3,
)  # fmt: skip
SMOOTH = replace(HELD, velocity=Velocity.low_pass(40.0), position=Filter.low_pass(150.0))
WINDOW = replace(PLAIN, velocity=Velocity.difference(samples=20), delay=1.3e-3)
COEFFICIENTS = replace(PLAIN, velocity=Velocity.transfer_function([400.0, -400.0], [1.0, -0.6]))
LOOPS = {
    "plain": PLAIN,
    "held": HELD,
    "low passes": SMOOTH,
    "window": WINDOW,
    "coefficients": COEFFICIENTS,
}
WALL = (1500.0, 12.0)
STEP = mpf(10) ** -18  # of a number
_FIELDS = (
    "device_mass", "device_damping", "sample_time", "hand_mass", "hand_damping", "hand_stiffness",
    "delay",
)  # fmt: skip


def numbers_of(loop: HapticLoop) -> Numbers:
    """All that may move, in 50 digits."""
    found = {name: mpf(getattr(loop, name)) for name in _FIELDS}
    if loop.velocity == SMOOTH.velocity:
        found |= {"velocity": mpf(40), "position": mpf(150)}
    return found


def gradient(loop: HapticLoop) -> dict[str, float]:
    """The numbers of a loop of derivatives."""
    found = {name: float(getattr(loop, name)) for name in _FIELDS}
    for name in ("velocity", "position"):
        filter_ = getattr(getattr(loop, name), "filter", getattr(loop, name))
        if filter_ is not None and hasattr(filter_.sections[0], "cutoff"):
            found[name] = float(filter_.sections[0].cutoff)
    return found


def product(*factors: list[mpf]) -> list[mpf]:
    result = [mpf(1)]
    for factor in factors:
        rows = [[a * b for b in factor] for a in result]
        result = [
            mp.fsum(rows[i][k - i] for i in range(len(rows)) if 0 <= k - i < len(factor))
            for k in range(len(rows) + len(factor) - 1)
        ]
    return result


def parts(loop: HapticLoop, numbers: Numbers) -> tuple[list[mpf], list[mpf], list[mpf]]:
    """p(z) = base + K stiffness + B damping, from the definitions, times T^2/m."""
    n, T = numbers, numbers["sample_time"]
    mass = n["device_mass"] + n["hand_mass"]
    gamma = n["hand_stiffness"] * T**2 / mass
    delta = (n["device_damping"] + n["hand_damping"]) * T / mass
    whole = int(loop.delay_samples)
    plant = sampled_plant(gamma, delta, n["delay"] / T - whole)
    one, samples = mpf(1), 1
    dv, dp, nv, np_ = [one], [one], [one], [one]
    if loop.velocity == SMOOTH.velocity:
        q, r = (mp.exp(-2 * mp.pi * n[name] * T) for name in ("velocity", "position"))
        dv, nv, dp, np_ = [one, -q], [1 - q, 0 * one], [one, -r], [1 - r, 0 * one]
    if loop.velocity == WINDOW.velocity:
        samples = 20
    if loop.velocity == COEFFICIENTS.velocity:
        dv, nv = [one, -mpf(0.6)], [400 * T, 0 * one]
    difference = [one / samples, *[0 * one] * (samples - 1), -one / samples]
    shift = [one, *[0 * one] * samples]  # z^n
    numerator = [plant.n2, plant.n1, plant.n0]
    denominator = [one, plant.d1, plant.d0]
    lag = [one, *[0 * one] * (whole + 1)]
    base = product(lag, shift, denominator, dp, dv)
    scale = T**2 / mass
    stiffness = [c * scale for c in product(shift, numerator, np_, dv)]
    damping = [c * scale / T for c in product(difference, numerator, nv, dp)]
    length = len(base)
    return base, *([mpf(0)] * (length - len(part)) + part for part in (stiffness, damping))


def radius(loop: HapticLoop, numbers: Numbers) -> mpf:
    base, stiffness, damping = parts(loop, numbers)
    p = [
        b + mpf(WALL[0]) * s + mpf(WALL[1]) * d
        for b, s, d in zip(base, stiffness, damping, strict=True)
    ]
    largest = max(np.roots([float(c) for c in p]), key=abs)
    z = mpc(largest)
    for _ in range(8):  # Newton, to all digits
        value, slope = mpc(0), mpc(0)
        for c in p:
            slope = slope * z + value
            value = value * z + c
        z -= value / slope
    return abs(z)


def difference(function: Callable[[Numbers], mpf], numbers: Numbers, name: str) -> float:
    step = STEP * (numbers[name] or 1)
    ahead, behind = (function(numbers | {name: numbers[name] + h}) for h in (step, -step))
    return float((ahead - behind) / (2 * step))


@pytest.mark.campaign
@pytest.mark.parametrize("name", some(LOOPS, 2))
def test_the_slopes_of_a_radius_are_those_of_50_digits(name: str) -> None:
    loop = LOOPS[name]
    found = gradient(jax.grad(lambda one: one.spectral_radius(*WALL).value)(loop))
    with mp.workdps(50):
        numbers = numbers_of(loop)
        truth = {key: difference(lambda n: radius(loop, n), numbers, key) for key in numbers}
    assert found.keys() == truth.keys()
    for key, slope in truth.items():
        assert found[key] == pytest.approx(slope, rel=1e-8, abs=1e-12 * abs(truth["delay"])), key


def extreme(loop: HapticLoop, numbers: Numbers, start: list[float], axis: int) -> mpf:
    """The largest K (axis 0) or B next to a start (K, B, angle), where the boundary turns."""
    columns = parts(loop, numbers)

    def equations(stiffness: mpf, damping: mpf, angle: mpf) -> list[mpf]:
        z = mpc(mp.cos(angle), mp.sin(angle))
        values = [evaluate(column, z) for column in columns]
        slopes = [
            sum(
                1j * (len(column) - 1 - k) * c * z ** (len(column) - 1 - k)
                for k, c in enumerate(column)
            )
            for column in columns
        ]
        gains = (1, stiffness, damping)
        value = mp.fdot(gains, values)
        turn = mp.fdot(gains, slopes)
        return [value.real, value.imag, (mp.conj(values[2 - axis]) * turn).imag]

    return mp.findroot(equations, start, tol=mpf(10) ** -60)[axis]


def stacked(loops: list[HapticLoop]) -> HapticLoop:
    """Loops as one whose leaves are arrays."""
    together: HapticLoop = jax.tree.map(lambda *leaves: jnp.stack(leaves), *loops)
    return together


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("name", "count"), some([("plain", 64), *((name, 1) for name in reversed(LOOPS))], 1)
)
def test_the_slopes_of_limits_are_those_of_50_digits(name: str, count: int) -> None:
    loop = LOOPS[name]
    limits = loop.limits()
    slopes = jax.grad(lambda one: one.limits().stiffness)
    if count > 1:  # by the program of a batch
        others = np.linspace(0.1, 0.5, count - 1).tolist()
        loops = stacked([loop, *(replace(loop, device_mass=mass) for mass in others)])
        found = gradient(jax.tree.map(lambda column: column[0], jax.vmap(slopes)(loops)))
    else:
        found = gradient(slopes(loop))
    wall = (limits.stiffness, limits.at_damping)
    poles = loop.poles(*wall)
    angle = float(np.abs(np.angle(poles[np.argmin(np.abs(np.abs(poles) - 1.0))])))
    with mp.workdps(50):
        numbers, start = numbers_of(loop), [*wall, angle]
        assert float(extreme(loop, numbers, start, 0)) == pytest.approx(wall[0], rel=1e-10)
        truth = {
            key: difference(lambda n: extreme(loop, n, start, 0), numbers, key) for key in numbers
        }
    for key, slope in truth.items():
        assert found[key] == pytest.approx(slope, rel=1e-6), key


@pytest.mark.campaign
def test_limits_of_many_loops_have_the_slopes_of_50_digits() -> None:
    """Whole delays and fractions of samples in one array: each p(z) has its own degree."""
    masses, delays = np.array([0.1, 0.4, 0.25]), np.array([1e-3, 1.7e-3, 2e-3])

    def limits(mass: Any, delay: Any) -> Any:
        return limits_of(WINDOW, device_mass=mass, delay=delay).stiffness

    def limit(mass: Any, delay: Any) -> Any:
        return replace(WINDOW, device_mass=mass, delay=delay).limits().stiffness

    by_batch = [np.diag(slopes) for slopes in jax.jacrev(limits, (0, 1))(masses, delays)]
    by_vmap = jax.vmap(jax.grad(limit, (0, 1)))(masses, delays)
    for index, (mass, delay) in enumerate(zip(masses.tolist(), delays.tolist(), strict=True)):
        loop = replace(WINDOW, device_mass=mass, delay=delay)
        wall = loop.limits()[:2]
        poles = loop.poles(*wall)
        start = [*wall, float(np.abs(np.angle(poles[np.argmin(np.abs(np.abs(poles) - 1.0))])))]
        with mp.workdps(50):
            numbers = numbers_of(loop)
            stiffest = partial(extreme, loop, start=start, axis=0)
            truth = [difference(stiffest, numbers, key) for key in ("device_mass", "delay")]
        for slopes in (by_batch, by_vmap):
            assert [slope[index] for slope in slopes] == pytest.approx(truth, rel=1e-6)


Point = list[mpf]
CROSSED = replace(WINDOW, device_mass=0.02, hand_damping=3.0, delay=0.3e-3)


def on_curve(loop: HapticLoop, numbers: Numbers, angle: mpf) -> Point:
    """The wall (K, B) with a root at this angle on the circle."""
    z = mpc(mp.cos(angle), mp.sin(angle))
    base, stiffness, damping = (evaluate(column, z) for column in parts(loop, numbers))
    det = (mp.conj(stiffness) * damping).imag
    return [(mp.conj(damping) * base).imag / det, (mp.conj(stiffness) * base).imag / -det]


def at_corner(loop: HapticLoop, numbers: Numbers, angles: list[float]) -> Point:
    """The wall (K, B) at which the curve meets itself at two angles, or the line z = 1 at one."""

    def gaps(*turned: mpf) -> list[mpf]:
        first, *others = (on_curve(loop, numbers, angle) for angle in turned)
        if others:
            return [a - b for a, b in zip(first, *others, strict=True)]
        base, stiffness, damping = (mp.fsum(column) for column in parts(loop, numbers))
        return [base + first[0] * stiffness + first[1] * damping]

    start = angles if len(angles) > 1 else angles[0]
    root = mp.findroot(gaps if len(angles) > 1 else lambda x: gaps(x)[0], start, tol=1e-60)
    return on_curve(loop, numbers, root[0] if len(angles) > 1 else root)


def coordinate(place: Callable[[Numbers], Point], axis: int, numbers: Numbers) -> mpf:
    return place(numbers)[axis]


def angles_on_circle(loop: HapticLoop, wall: Any) -> list[float]:
    poles = loop.poles(*wall.tolist())
    return [float(x) for x in np.angle(poles[np.abs(np.abs(poles) - 1.0) < 1e-7]) if x > -1e-7]


def test_small_systems_are_solved_with_pivots(rng: np.random.Generator) -> None:
    """Rows of any size, leading zeros, several right-hand sides: against LAPACK."""
    matrices = rng.normal(size=(300, 4, 4)) * 10.0 ** rng.uniform(-6.0, 6.0, (300, 4, 1))
    matrices[::3, 0, 0] = 0.0
    values = rng.normal(size=(300, 4, 2))
    found = jax.jit(jax.vmap(solved))(matrices, values)
    exact = np.linalg.solve(matrices, values)
    size = np.abs(exact).max(axis=(1, 2)) * np.linalg.cond(matrices)
    assert np.all(np.abs(found - exact).max(axis=(1, 2)) <= 1e-15 * size)


@pytest.mark.campaign
@pytest.mark.parametrize(("loop", "count"), some([(HELD, 1), (CROSSED, 64)], 1))
def test_outlines_move_as_the_boundary_does_in_50_digits(loop: HapticLoop, count: int) -> None:
    """Corners move as corners do, all other vertices with the boundary, as seen across it."""
    masses = loop.device_mass * np.linspace(1.0, 1.01, count)
    delays = np.full(count, loop.delay)

    def outlines(mass: Any, delay: Any) -> Any:
        return regions_of(loop, device_mass=mass, delay=delay).outline

    steps = (np.ones(count), 0.0 * delays), (0.0 * delays, np.ones(count))
    moves = [jax.jvp(outlines, (masses, delays), step)[1][0] for step in steps]
    regions = regions_of(loop, device_mass=masses)
    assert bool(regions.limits.is_single[0]) == (count == 1)
    corners = 0
    for index, wall in enumerate(regions.outline[0]):
        angles = angles_on_circle(loop, wall)
        is_corner = len(angles) == 2 and max(angles) > 1e-3
        corners += is_corner
        if not is_corner and (index % 20 or min(angles) < 1e-2):
            continue
        with mp.workdps(50):
            here, turned = numbers_of(loop), [angle for angle in angles if angle > 1e-3]
            if is_corner:
                place = partial(at_corner, loop, angles=turned)
            else:
                place = partial(on_curve, loop, angle=mpf(turned[0]))
            assert np.array(place(here), float) == pytest.approx(wall, rel=1e-8, abs=1e-8)
            truth = [
                [difference(partial(coordinate, place, axis), here, key) for axis in (0, 1)]
                for key in ("device_mass", "delay")
            ]
            ends = [on_curve(loop, here, turned[0] + step) for step in (-STEP, STEP)]
            along = np.array([(b - a) / STEP for a, b in zip(*ends, strict=True)], float)
        for move, true in zip(moves, np.array(truth), strict=True):
            size = np.full(2, 1e-6 * np.max(np.abs(true)))
            if is_corner:
                assert np.all(np.abs(move[index] - true) <= size)
            else:
                across = np.array([-along[1], along[0]])
                assert abs(across @ (move[index] - true)) <= np.abs(across) @ size
    assert corners >= 1


@pytest.mark.campaign
def test_the_region_of_an_undamped_free_mass_grows_as_its_closed_form() -> None:
    """0 < alpha < 2 beta (2 - beta)/(beta + 2), 0 < beta < 2 has the area 12 - 16 ln 2."""
    free = replace(PLAIN, device_damping=0.0, delay=0.0)
    for count in some((64, 1), 1):
        masses, periods = np.linspace(0.25, 0.5, count), np.full(count, 1e-3)

        def regions(mass: Any, period: Any) -> Any:
            return regions_of(free, device_mass=mass, sample_time=period)[:2]

        steps = (np.ones(count), 0.0 * periods), (0.0 * periods, np.ones(count))
        answers = [jax.jvp(regions, (masses, periods), step) for step in steps]
        outline, area = map(np.asarray, answers[0][0])
        (by_mass, more), (by_period, less) = (map(np.asarray, moves) for _, moves in answers)
        assert area == pytest.approx((12.0 - 16.0 * np.log(2.0)) * masses**2 * 1e9, rel=1e-7)
        assert more == pytest.approx(2.0 * area / masses, rel=1e-7)
        assert less == pytest.approx(-3.0 * area / 1e-3, rel=1e-7)
        top = np.argmax(outline[0, :, 1])  # K = 0, B = 2 m/T
        assert by_mass[0, top] == pytest.approx([0.0, 2e3], abs=1e-5)
        assert by_period[0, top] == pytest.approx([0.0, -2e6 * masses[0]], abs=1e-2)


@pytest.mark.campaign
def test_limits_of_loops_in_a_list_move_by_all_that_they_are_made_of() -> None:
    """Low passes and a window beside each other; derivatives are loops as well."""
    loops = [SMOOTH, WINDOW]
    answers = limits_of(loops)
    found = jax.grad(lambda many: limits_of(many).damping.sum())(loops)
    assert jax.grad(lambda many: limits_of(many).stiffness[1])(loops)[0].device_mass == 0.0
    for loop, slopes, damping in zip(loops, found, answers.damping, strict=True):
        alone = jax.grad(lambda one: one.limits().damping)(loop)
        assert gradient(slopes) == pytest.approx(gradient(alone), rel=1e-9)
        step = 1e-5 * loop.device_damping
        ahead = replace(loop, device_damping=loop.device_damping + step).limits().damping
        assert gradient(slopes)["device_damping"] == pytest.approx(
            (ahead - damping) / step, rel=1e-3
        )


@pytest.mark.campaign
@pytest.mark.parametrize("count", some([1, 64], 1))
def test_limits_on_an_axis_move_as_its_crossing_does(count: int) -> None:
    """A held device has its largest K at B = 0 and its largest B at K = 0."""
    loop = replace(WINDOW, device_mass=0.1, hand_damping=9.0, hand_stiffness=200.0)
    limits = loop.limits()
    assert limits.at_damping == limits.at_stiffness == 0.0
    slopes = jax.jacrev(lambda one: jnp.stack(one.limits()[:4]))
    masses = np.linspace(0.1, 0.12, count).tolist()
    found = jax.vmap(slopes)(stacked([replace(loop, device_mass=mass) for mass in masses]))
    for axis, gain in enumerate((limits.stiffness, limits.damping)):
        poles = loop.poles(*np.where(np.arange(2) == axis, gain, 0.0).tolist())
        angle = float(np.abs(np.angle(poles[np.argmin(np.abs(np.abs(poles) - 1.0))])))

        def crossing(numbers: Numbers, axis: int = axis, start: Any = (gain, angle)) -> mpf:
            base, *columns = parts(loop, numbers)

            def on_circle(size: mpf, turn: mpf) -> list[mpf]:
                z = mpc(mp.cos(turn), mp.sin(turn))
                value = evaluate(base, z) + size * evaluate(columns[axis], z)
                return [value.real, value.imag]

            return mp.findroot(on_circle, start, tol=mpf(10) ** -60)[0]

        with mp.workdps(50):
            numbers = numbers_of(loop)
            assert float(crossing(numbers)) == pytest.approx(gain, rel=1e-10)
            for key in numbers:
                own = getattr(found, key)[0]
                assert own[2 * axis] == pytest.approx(difference(crossing, numbers, key), rel=1e-6)
                assert own[2 * axis + 1] == 0.0


@pytest.mark.campaign
def test_the_largest_damping_moves_as_a_corner_does() -> None:
    """Without delay, hand and stiffness p = (z - 1) (z^2 + a z + B n1), a pair at B n1 = 1."""
    loop = replace(PLAIN, delay=0.0)
    slopes = jax.jacobian(lambda one: one.limits()[2:4])(loop)
    with mp.workdps(40):

        def largest(numbers: Numbers) -> mpf:
            return -1 / parts(loop, numbers)[2][3]

        numbers = numbers_of(loop)
        assert float(largest(numbers)) == pytest.approx(loop.limits().damping, rel=1e-12)
        for key in ("device_mass", "device_damping", "sample_time"):
            own = difference(largest, numbers, key)
            assert float(getattr(slopes[0], key)) == pytest.approx(own, rel=1e-7)
    assert float(slopes[1].hand_stiffness) == pytest.approx(-1.0, rel=1e-9)


@pytest.mark.campaign
def test_limits_move_in_a_batch_as_they_do_alone() -> None:
    """Smooth extremes, corners of two pairs, corners on a line, and loops that are left open."""
    loops = [
        replace(HELD, device_mass=mass, device_damping=damping, hand_stiffness=stiffness)
        for mass in (0.02, 0.1, 0.2, 0.6)
        for damping in (0.0, 0.01, 0.1, 2.0)
        for stiffness in (0.0, 1.0, 150.0, 4000.0)
    ]
    slopes = jax.jacrev(lambda loop: jnp.stack(loop.limits()[:4]))
    together = jax.vmap(slopes)(stacked(loops))
    for index in (3, 22, 41, 60):
        own = slopes(loops[index])
        for key in ("device_mass", "device_damping", "hand_stiffness", "delay"):
            here, alone = getattr(together, key)[index], np.asarray(getattr(own, key))
            size = np.max(np.abs(alone))
            np.testing.assert_allclose(here, alone, rtol=1e-6, atol=1e-9 * size, err_msg=key)


# Random loops of every kind that JAX takes, one for each program that it compiles.

KINDS: dict[str, Callable[[np.random.Generator], Numbers]] = {
    "a window of 20": lambda _: {"velocity": Velocity.difference(samples=20)},
    "an average of 5": lambda _: {"position": Filter.average(samples=5)},
    "coefficients": lambda _: {
        "velocity": Velocity.transfer_function([420.0, -400.0, -20.0], [1.0, -0.7, 0.12])
    },
    "one sample": lambda _: {},
    "a window of 2": lambda _: {"velocity": Velocity.difference(samples=2)},
    "an average of 4": lambda _: {"position": Filter.average(samples=4)},
    "a window and an average": lambda _: {
        "velocity": Velocity.difference(samples=9),
        "position": Filter.average(samples=2),
    },
    "a low pass": lambda rng: {"velocity": Velocity.low_pass(cutoff(rng))},
    "a low pass of order 2": lambda rng: {
        "velocity": Velocity.low_pass(cutoff(rng), order=2),
        "position": Filter.average(samples=3),
    },
    "two low passes": lambda rng: {
        "velocity": Velocity.low_pass(cutoff(rng)),
        "position": Filter.low_pass(2.0 * cutoff(rng)),
    },
    "Butterworth's": lambda rng: {"velocity": Velocity.butterworth(cutoff(rng), order=3)},
    "smoothing": lambda rng: {"velocity": Velocity.exponential(float(rng.uniform(0.05, 1.0)))},
}
KNOWN = {  # a loop, which of its limits, and its derivative by the mass
    "a window of 20": (0.05, {"device_damping": 5.0, "sample_time": 1e-3}, 2, 813.949),
    "an average of 5": (
        0.025, {"device_damping": 0.16, "sample_time": 1e-3, "hand_stiffness": 1300.0}, 0, 1768230.0
    ),
    "an average of 4": (
        0.025292899536456383,
        {"device_damping": 0.16366336004010465, "sample_time": 2.0**-10,
         "hand_stiffness": 1307.039142883671},
        0, 2795811.0,
    ),
}  # fmt: skip
OF_A_KIND = many(84, 4)


def cutoff(rng: np.random.Generator) -> float:
    return float(10 ** rng.uniform(1.2, 2.5))


def random_loop(rng: np.random.Generator, kind: str) -> HapticLoop:
    period = float(rng.choice([1e-3, 2.0**-10, 5e-4]))
    delay = rng.choice([float(rng.integers(4)), rng.uniform(0.0, 4.0), rng.uniform(0.0, 12.0)])
    return HapticLoop(
        device_mass=float(10 ** rng.uniform(-1.7, 0.5)),
        device_damping=float(10 ** rng.uniform(-3.0, 1.0)),
        hand_damping=float(rng.choice([0.0, 10 ** rng.uniform(-1.0, 1.5)])),
        hand_stiffness=float(rng.choice([0.0, 10 ** rng.uniform(0.0, 3.5)])),
        sample_time=period,
        delay=float(delay) * period,
        **KINDS[kind](rng),
    )


def slopes_by_differences(loop: HapticLoop, direction: Any) -> Any:
    """Slopes of the four limits along a direction; NaN where differences of no step agree."""
    numbers, structure = jax.tree.flatten(loop)

    def limits(step: float) -> Any:
        moved = [float(x + step * by) for x, by in zip(numbers, direction, strict=True)]
        return np.array(jax.tree.unflatten(structure, moved).limits()[:4])

    here, slopes = limits(0.0), np.full(4, np.nan)
    for step in (1e-5, 1e-6, 1e-7):
        ahead, behind = limits(step), limits(-step)
        slope = (ahead - behind) / (2.0 * step)
        nearer = (limits(0.25 * step) - limits(-0.25 * step)) / (0.5 * step)
        size = abs(slope) + 1e-3 * abs(here)
        is_smooth = abs(ahead - 2.0 * here + behind) <= 1e-2 * step * size
        is_trusted = is_smooth & (abs(slope - nearer) <= 3e-5 * size)
        slopes = np.where(np.isnan(slopes) & is_trusted, nearer, slopes)
        if not np.isnan(slopes).any():
            break
    return slopes


@pytest.mark.campaign
@pytest.mark.parametrize("kind", some(KINDS, 2))
def test_limits_of_random_loops_move_as_differences_do(kind: str, rng: np.random.Generator) -> None:
    """Corners and turns of the boundary, crossings of an axis: each has other derivatives."""
    loops = [random_loop(rng, kind) for _ in range(OF_A_KIND)]
    if kind in KNOWN:
        mass, fields, which, slope = KNOWN[kind]
        loops[0] = HapticLoop(device_mass=mass, **fields, **KINDS[kind](rng))
    every = [jax.tree.flatten(loop) for loop in loops]
    steps = [np.array(numbers) * rng.choice([-1.0, 1.0], len(numbers)) for numbers, _ in every]

    def slopes(directions: Any) -> Any:
        rows = zip(every, directions, strict=True)
        ways = [jax.tree.unflatten(structure, own.tolist()) for (_, structure), own in rows]
        return jax.jvp(lambda many: jnp.stack(limits_of(many)[:4]), (loops,), (ways,))[1].T

    found, untrusted = np.asarray(slopes(steps)), 0
    for loop, direction, own in zip(loops, steps, found, strict=True):
        truth, limits = slopes_by_differences(loop, direction), np.array(loop.limits()[:4])
        size = abs(truth) + 1e-3 * abs(limits) + 1e-9 * limits[[0, 2, 2, 0]]
        assert np.all((abs(own - truth) <= 1e-4 * size) | np.isnan(truth)), loop
        untrusted += int(np.sum(np.isnan(truth)))
    assert untrusted <= 0.02 * found.size
    if kind in KNOWN:
        heavier = [replace(loop, device_mass=loop.device_mass + 1.0) for loop in loops]
        ways = [
            np.subtract(jax.tree.leaves(more), numbers)
            for more, (numbers, _) in zip(heavier, every, strict=True)
        ]
        assert float(slopes(ways)[0, which]) == pytest.approx(slope, rel=1e-6)


MANY_MASSES = np.geomspace(0.05, 5.0, 512)


@pytest.mark.campaign
def test_many_loops_inside_jit_need_no_callback() -> None:
    loop = replace(PLAIN, velocity=Velocity.difference(samples=3))

    def outlines(masses: Any) -> Any:
        return regions_of(loop, device_mass=masses).outline

    assert "callback" not in str(jax.make_jaxpr(outlines)(MANY_MASSES))
    assert "callback" in str(jax.make_jaxpr(outlines)(MANY_MASSES[:3]))  # these are too few


@pytest.mark.campaign
def test_many_loops_inside_jit_are_those_of_a_batch_with_their_slopes() -> None:
    def limit(mass: Any) -> Any:
        return limits_of(PLAIN, device_mass=mass).stiffness

    inside = jax.jit(jax.vmap(jax.value_and_grad(limit)))
    stiffness, slope = inside(MANY_MASSES)
    batch = limits_of(PLAIN, device_mass=MANY_MASSES)
    np.testing.assert_allclose(stiffness, batch.stiffness, rtol=1e-12)
    assert not batch.is_single.any()
    step = 1e-6 * MANY_MASSES
    ends = [limits_of(PLAIN, device_mass=MANY_MASSES + by).stiffness for by in (step, -step)]
    np.testing.assert_allclose(slope, (ends[0] - ends[1]) / (2.0 * step), rtol=1e-6)


@pytest.mark.campaign
def test_a_loop_goes_through_jit_and_vmap_as_an_argument() -> None:
    masses = np.array([0.1, 0.2, 0.4])
    loops = stacked([replace(HELD, device_mass=mass) for mass in masses])
    radii = jax.jit(jax.vmap(lambda loop: loop.spectral_radius(*WALL).value))(loops)
    codes = jax.vmap(lambda loop: loop.verdict(*WALL))(loops)
    most = jax.vmap(lambda loop: loop.limits().stiffness)(loops)
    for index, mass in enumerate(masses):
        own = replace(HELD, device_mass=mass)
        assert radii[index] == pytest.approx(float(own.spectral_radius(*WALL).value), rel=1e-12)
        assert codes[index] == own.verdict(*WALL)
        assert most[index] == pytest.approx(own.limits().stiffness, rel=1e-12)


def test_a_loop_comes_back_from_jax_as_it_was_but_for_windows_in_samples() -> None:
    loop = replace(HELD, velocity=Velocity.difference(window=0.02) * Filter.low_pass(30.0))
    leaves, structure = jax.tree.flatten(loop)
    again = jax.tree.unflatten(structure, leaves)
    assert len(leaves) == 8  # the cut-off among them
    assert str(again.velocity).startswith("the difference over a window of 10 samples")
    assert again.delay_samples == loop.delay_samples
    assert again.limits() == loop.limits()
    assert jax.tree.unflatten(structure, [None] * 8).device_mass is None  # of anything


@pytest.mark.campaign
def test_a_loop_is_made_of_traced_fields_without_checks() -> None:
    def value(mass: Any, cutoff: Any) -> Any:
        loop = replace(HELD, device_mass=mass, velocity=Velocity.low_pass(cutoff))
        return loop.spectral_radius(*WALL).value

    slopes = jax.jit(jax.grad(value, (0, 1)))(0.2, 40.0)
    alone = jax.jit(jax.grad(lambda loop: loop.spectral_radius(*WALL).value))(
        replace(HELD, velocity=Velocity.low_pass(40.0))
    )
    assert float(slopes[0]) == pytest.approx(float(alone.device_mass), rel=1e-12)
    assert float(slopes[1]) == pytest.approx(gradient(alone)["velocity"], rel=1e-12)
    with pytest.raises(ValueError, match=r"device_mass is -1\.0"):
        replace(HELD, device_mass=jnp.asarray(-1.0))


@pytest.mark.parametrize(
    "call",
    [
        lambda loop: loop.settling_time(*WALL).value,
        lambda loop: loop.tune().stiffness,
        lambda loop: loop.robust_limit(HandRange()).stiffness,
        lambda loop: loop.worst_hand(HandRange(), *WALL).radius,
        lambda loop: loop.simulate(*WALL, force=1.0).position,
        lambda loop: replace(loop, hand_mass=0.1).spectral_radius(*WALL).value,
    ],
)
def test_what_is_searched_outside_of_jax_refuses_traced_loops_in_a_sentence(
    call: Callable[[HapticLoop], Any],
) -> None:
    with pytest.raises(TypeError, match="outside of jit, vmap and grad") as caught:
        jax.jit(call)(HELD)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("loop", [HELD, SMOOTH])
def test_the_region_of_a_traced_loop_names_what_jax_may_trace(loop: HapticLoop) -> None:
    for call in (lambda one: one.region().stiffest, lambda one: one.stiffness_limits(1.0)):
        with pytest.raises(TypeError, match=r"^[^\n]*call limits or jaxstab\.regions_of"):
            jax.jit(call)(loop)


@pytest.mark.campaign
def test_a_traced_whole_delay_is_a_fraction_of_zero() -> None:
    poles = jax.jit(lambda loop: loop.poles(*WALL))(PLAIN)
    own = PLAIN.poles(*WALL)
    np.testing.assert_allclose(np.sort(np.abs(poles))[1:], np.sort(np.abs(own)), rtol=1e-9)
    assert np.abs(poles).min() < 1e-12
    assert jax.jit(lambda loop: loop.verdict(*WALL))(PLAIN) == Verdict.STABLE


@pytest.mark.campaign
def test_jax_may_be_imported_after_jaxstab() -> None:
    """In a process of its own: what a loop is made of is known to JAX by the first use."""
    code = (
        "from dataclasses import replace\n"
        "import jaxstab\n"
        "loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)\n"
        "loop.limits()\n"
        "import jax\n"
        "jax.config.update('jax_enable_x64', True)\n"
        "print(jax.grad(lambda mass: replace(loop, device_mass=mass).limits().stiffness)(0.25))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    own = jax.grad(lambda mass: replace(PLAIN, device_mass=mass, delay=0.0).limits().stiffness)
    assert float(done.stdout) == pytest.approx(float(own(0.25)), rel=1e-12)
