"""E1 against exact fractions, roots that were chosen, and mpmath."""

from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from functools import partial

import flint
import numpy as np
import pytest

from jaxstab import Device, Filter, HapticLoop, Mode, Verdict
from jaxstab.conventions import Status
from jaxstab.exact.line import LineStatus
from jaxstab.exact.margins import DelayStatus, SmallGainStatus
from jaxstab.exact.roots import (
    VerdictStatus,
    rational_verdict,
    roots_outside,
    wall_verdict,
)
from jaxstab.model.balls import Factored, Triple, ball_triple
from jaxstab.model.device.parts import FIRST_BITS, MOST_BITS, decided
from tests.truth.plain import Loop, is_stable
from tests.truth.random_loops import DeviceLoop, MassLoop, hostile_walls


def chosen_polynomial(rng: np.random.Generator, pairs: int, reals: int) -> tuple[list[int], int]:
    """Integer coefficients, lowest first, of a polynomial of chosen roots, and those outside."""
    p, outside = flint.fmpz_poly([1]), 0
    for _ in range(pairs):
        x, y = (int(n) for n in rng.integers(-40, 41, 2))
        while x * x + y * y == 1024 or y == 0:  # on the circle
            x, y = (int(n) for n in rng.integers(-40, 41, 2))
        p *= flint.fmpz_poly([x * x + y * y, -2 * 32 * x, 1024])
        outside += 2 * (x * x + y * y > 1024)
    for _ in range(reals):
        x = int(rng.choice([*range(-60, -32), *range(-31, 32), *range(33, 60)]))
        p *= flint.fmpz_poly([-x, 32])
        outside += abs(x) > 32
    return [int(c) for c in p.coeffs()], outside


@pytest.mark.parametrize("seed", range(40))
def test_the_roots_outside_are_those_that_were_chosen(seed: int) -> None:
    rng = np.random.default_rng([521, seed])
    rising, outside = chosen_polynomial(rng, int(rng.integers(0, 20)), int(rng.integers(1, 6)))
    assert decided(lambda: roots_outside(flint.arb_poly(rising))) == outside


@pytest.mark.parametrize("seed", range(40))
def test_exact_numbers_are_always_decided_by_the_roots_that_were_chosen(seed: int) -> None:
    """All inside, or one outside, or one on the circle."""
    rng = np.random.default_rng([523, seed])
    p = flint.fmpz_poly([1])
    for x in rng.integers(-31, 32, rng.integers(1, 9)).tolist():
        y = int(rng.integers(0, int((1023 - x * x) ** 0.5)))
        p *= flint.fmpz_poly([x * x + y * y, -64 * x, 1024] if y else [-x, 32])
    assert rational_verdict(flint.fmpq_poly(p)) == Verdict.STABLE
    for other in ([33, 32], [-5, 4], [1, 1], [25, -14, 25], [40, 0, 32]):
        assert rational_verdict(flint.fmpq_poly(p * flint.fmpz_poly(other))) == Verdict.UNSTABLE


def test_roots_of_which_the_moduli_have_the_product_one_are_counted() -> None:
    mirrored = [(2, 2), (3, 3), (7, 7)]  # roots a and 1/b
    for a, b in mirrored:
        p = flint.fmpz_poly([-a, 1]) * flint.fmpz_poly([-1, b]) * flint.fmpz_poly([-1, 5])
        assert decided(lambda p=p: roots_outside(flint.arb_poly(p))) == 1
    reciprocal = flint.fmpz_poly([-2, 1]) * flint.fmpz_poly([-1, 2])
    assert decided(lambda: roots_outside(flint.arb_poly(reciprocal))) == 1


def test_a_root_on_the_circle_is_never_counted() -> None:
    on_circle = flint.fmpz_poly([25, -14, 25]) * flint.fmpz_poly([-1, 2])
    assert decided(lambda: roots_outside(flint.arb_poly(on_circle))) is None


@pytest.mark.parametrize("seed", range(60))
def test_small_integers_and_all_their_accidents_are_as_fractions_have_them(seed: int) -> None:
    rng = np.random.default_rng([522, seed])
    rising = [int(n) for n in rng.integers(-3, 4, rng.integers(2, 7))]
    rising[-1] = rising[-1] or 1
    outside = decided(lambda: roots_outside(flint.arb_poly(rising), most=0))
    if outside is not None:
        assert (outside == 0) == is_stable([Fraction(c) for c in rising[::-1]])
    else:  # only where a root is on the circle, or as good as
        assert min(abs(abs(np.roots(rising[::-1])) - 1.0)) < 1e-6


@pytest.mark.parametrize("draw", [MassLoop.drawn, DeviceLoop.drawn, DeviceLoop.hardly_moved])
@pytest.mark.parametrize("seed", range(2))
def test_walls_next_to_the_boundary_are_as_mpmath_has_them(draw: object, seed: int) -> None:
    rng = np.random.default_rng([523, seed])
    drawn = draw(rng)  # type: ignore[operator]
    truth = Loop.of(drawn)
    units = (1.0, 1.0)
    if isinstance(drawn, DeviceLoop):
        units = drawn.units
    walls = hostile_walls(rng, drawn.balls, 12) / units
    decided_walls = 0
    for stiffness, damping in walls.tolist():
        verdict, status = wall_verdict(lambda: ball_triple(truth.loop), stiffness, damping)
        expected = truth.is_stable(stiffness, damping)
        if expected is not None:
            assert verdict == (Verdict.STABLE if expected else Verdict.UNSTABLE)
            assert status == VerdictStatus.PROVED
            decided_walls += 1
    assert decided_walls > 6


@pytest.mark.parametrize("beta", [1e-6, 0.3, 0.8284271247461903, 1.9999])
@pytest.mark.parametrize("share", [1.0 - 1e-12, 1.0 + 1e-12])
def test_the_closed_form_of_a_free_mass_without_delay(beta: float, share: float) -> None:
    loop = HapticLoop(device_mass=1.0, device_damping=0.0, sample_time=1.0)
    alpha = 2.0 * beta * (2.0 - beta) / (beta + 2.0) * share
    verdict, _ = wall_verdict(lambda: ball_triple(loop), alpha, beta)
    assert verdict == (Verdict.STABLE if share < 1.0 else Verdict.UNSTABLE)


def test_a_free_device_without_stiffness_drifts_by_structure() -> None:
    loop = HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
    for damping in (0.0, 10.0, -0.1):
        answer = wall_verdict(lambda: ball_triple(loop), 0.0, damping)
        assert answer == (Verdict.UNSTABLE, VerdictStatus.ON_CIRCLE)


def test_one_root_at_1_may_drift_if_that_is_allowed() -> None:
    damped = HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
    undamped = HapticLoop(device_mass=0.25, device_damping=0.0, sample_time=1e-3)
    for loop, damping, expected in (
        (damped, 10.0, Verdict.STABLE),
        (damped, 1e4, Verdict.UNSTABLE),
        (undamped, 10.0, Verdict.STABLE),
        (undamped, 0.0, Verdict.UNSTABLE),  # the velocity stays anywhere, too
    ):
        triple = partial(ball_triple, loop)
        assert wall_verdict(triple, 0.0, damping, may_drift=True).verdict == expected
        assert wall_verdict(triple, 0.0, damping).verdict == Verdict.UNSTABLE


@pytest.mark.parametrize("delay", [0.0, 0.4e-3, 2e-3])
@pytest.mark.parametrize(
    ("position", "stiffness"),
    [
        (None, 300.0),
        (None, 0.1),
        (Filter.low_pass(100.0), 0.1),
        (Filter.transfer_function([1.0, 0.0], [1.0, -0.5]), 150.0),  # its gain at rest is 2
    ],
)
def test_a_wall_that_takes_all_stiffness_has_a_root_at_one(
    position: Filter | None, stiffness: float, delay: float
) -> None:
    held = 300.0 if stiffness == 150.0 else stiffness
    device = Device.mass_spring_damper(0.25, damping=5.0, stiffness=held)
    loop = HapticLoop(device=device, sample_time=1e-3, delay=delay, position=position)
    triple = partial(ball_triple, loop)
    for damping in (0.0, 3.0, 1e4):
        answer = wall_verdict(triple, -stiffness, damping)
        assert answer == (Verdict.UNSTABLE, VerdictStatus.ON_CIRCLE)
    above, below = (np.nextafter(-stiffness, side) for side in (np.inf, -np.inf))
    assert wall_verdict(triple, above, 3.0) == (Verdict.STABLE, VerdictStatus.PROVED)
    assert wall_verdict(triple, below, 3.0) == (Verdict.UNSTABLE, VerdictStatus.PROVED)


def test_a_stiffness_that_no_float_takes_away_is_decided_on_both_sides() -> None:
    device = Device.modes([Mode(frequency=40.0, damping_ratio=0.1, modal_mass=0.25)])
    triple = partial(ball_triple, HapticLoop(device=device, sample_time=1e-3))
    assert triple().yielding is None
    stiffness = -0.25 * (2.0 * np.pi * 40.0) ** 2
    near = [np.nextafter(stiffness, side) for side in (-np.inf, np.inf)]
    codes = [wall_verdict(triple, wall, 3.0).verdict for wall in near]
    assert codes == [Verdict.UNSTABLE, Verdict.STABLE]


def test_an_undamped_spring_without_a_wall_is_undecided_and_says_why() -> None:
    device = Device.mass_spring_damper(0.25, stiffness=100.0)
    loop = HapticLoop(device=device, sample_time=1e-3)
    verdict, status = wall_verdict(lambda: ball_triple(loop), 0.0, 0.0)
    assert verdict == Verdict.UNDECIDED
    assert status.words == "3,072 bits do not tell on which side of the circle a root is"


def test_a_leading_coefficient_that_vanishes_is_no_loop() -> None:
    z_squared, one = Factored(flint.arb_poly([1]), power=2), Factored(flint.arb_poly([0.5, 0, 1]))
    triple = Triple(one, z_squared, Factored(flint.arb_poly([])))
    answer = wall_verdict(lambda: triple, -1.0, 0.0)
    assert answer == (Verdict.UNDECIDED, VerdictStatus.ALGEBRAIC)
    assert wall_verdict(lambda: triple, -0.25, 0.0).verdict == Verdict.STABLE


def test_threads_ask_at_the_same_time_and_the_precision_is_restored() -> None:
    loop = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3, delay=3e-3)
    limit = 7000.0

    def verdicts(index: int) -> list[int]:
        walls = [(limit * (k + index) / 20.0, 10.0) for k in range(20)]
        return [int(wall_verdict(lambda: ball_triple(loop), *wall).verdict) for wall in walls]

    before = flint.ctx.prec
    alone = [verdicts(index) for index in range(8)]
    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(verdicts, range(8))) == alone
    assert flint.ctx.prec == before
    assert {1, 2} <= {code for codes in alone for code in codes}


@pytest.mark.parametrize("status", [VerdictStatus, LineStatus, DelayStatus, SmallGainStatus])
def test_statuses_are_numbered_from_1(status: type[Status]) -> None:
    """0 is that of an array that nobody has filled; 1 is proved."""
    assert [int(member) for member in status] == list(range(1, len(status) + 1))
    assert status.PROVED == 1  # type: ignore[attr-defined]


def test_bits_are_doubled_up_to_the_most() -> None:
    asked = []
    assert decided(lambda: asked.append(flint.ctx.prec)) is None
    assert asked == [FIRST_BITS << k for k in range(len(asked))]
    assert asked[-1] == MOST_BITS
