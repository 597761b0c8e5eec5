"""Limits of batches of loops on JAX, against balls of python-flint and single answers."""

import gc
from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction
from functools import partial
from typing import Any
from weakref import ref

import jax.numpy as jnp
import numpy as np
import pytest
from campaign import many as sized
from flint import arb_poly
from jax import jit, vmap
from mpmath import conj, expj, findroot, mpf, polyval, workdps

import jaxstab
from jaxstab import Device, Filter, HapticLoop, Mode, Velocity, Verdict, limits_of, regions_of
from jaxstab.batches import ahead
from jaxstab.loop import many as loops_together
from jaxstab.loop.many import _are_unstable
from jaxstab.model.filters import has_roots_inside
from jaxstab.point.polynomials import codes_in_float64
from jaxstab.region.batch import (
    SLOTS,
    Triples,
    _bisector,
    _Corners,
    _corners_of,
    _ends_of,
    _fall,
    _linked,
    _PieceEnds,
    _rounding,
    _scan,
    _small_walls,
    _vertex,
    _wall,
    program,
)
from jaxstab.region.pieces import Branch
from jaxstab.results import RegionStatus
from tests.truth import loop as true_loop
from tests.truth.devices import DeviceLoop, Mechanism, mode
from tests.truth.filtered import FilteredLoop, average, butterworth, difference, low_pass, times

PERIOD = 1e-3
COUNT = 72  # loops, enough for a batch
MASSES = np.linspace(0.1, 2.0, 6).tolist()  # of those that are undamped and free


def loops(rng: np.random.Generator) -> list[HapticLoop]:
    """Masses with a window of 3 samples and delays to 3 samples, some of them on springs.

    The last ones are undamped and free, with a window of 2 samples and no delay.
    """
    damped = [
        HapticLoop(
            device_mass=float(rng.uniform(0.05, 2.0)),
            device_damping=float(10 ** rng.uniform(-2, 0.5)),
            hand_stiffness=float(rng.choice([0.0, 10 ** rng.uniform(0, 3)])),
            delay=float(rng.choice([0.0, 1.0, 2.0, rng.uniform(0.1, 2.9)])) * PERIOD,
            sample_time=PERIOD,
            velocity=Velocity.difference(samples=3),
        )
        for _ in range(COUNT - len(MASSES))
    ]
    window = Velocity.difference(samples=2)
    return damped + [
        HapticLoop(device_mass=mass, device_damping=0.0, sample_time=PERIOD, velocity=window)
        for mass in MASSES
    ]


def is_wrong(many: jaxstab.results.Limits, index: int, one: jaxstab.results.Limits) -> bool:
    """True if a loop's limits are not those that it has by itself."""
    pairs = (many.stiffness[index], one.stiffness), (many.damping[index], one.damping)
    same = all(np.isclose(*pair, rtol=1e-9, atol=0.0, equal_nan=True) for pair in pairs)
    flags = many.status[index] == one.status and many.is_reachable[index] == one.is_reachable
    return not (same and flags)


@pytest.fixture(scope="module")
def regions() -> tuple[list[HapticLoop], jaxstab.results.ManyRegions]:
    many = loops(np.random.default_rng(33))
    return many, regions_of(many)


@pytest.fixture(scope="module")
def batch(
    regions: tuple[list[HapticLoop], jaxstab.results.ManyRegions],
) -> tuple[list[HapticLoop], jaxstab.results.Limits]:
    return regions[0], regions[1].limits


def test_walls_just_inside_are_stable_and_just_outside_are_not(
    batch: tuple[list[HapticLoop], jaxstab.results.Limits],
) -> None:
    many, limits = batch
    assert np.all(limits.status == RegionStatus.COMPLETE)
    for index, loop in enumerate(many[:24]):
        balls = FilteredLoop(**loop.slice, velocity=difference(3), position=average(1)).balls()

        stiffest, damped = limits.stiffness[index], limits.damping[index]
        # The most damped wall is a corner, most often: inside of it K is a little larger.
        aside = limits.at_stiffness[index] + 1e-6 * stiffest
        walls = [(stiffest * one, limits.at_damping[index]) for one in (1 - 1e-8, 1 + 1e-8)]
        walls += [(aside, damped * one) for one in (1 - 1e-4, 1 + 1e-4)]
        stable = [balls.is_stable(loop.alpha(k), loop.beta(b)) for k, b in walls]
        assert stable == [True, False, True, False]


def test_limits_are_those_of_single_loops(
    batch: tuple[list[HapticLoop], jaxstab.results.Limits],
) -> None:
    many, limits = batch
    assert np.mean(limits.is_single) < 0.05
    assert not any(is_wrong(limits, k, many[k].limits()) for k in range(0, COUNT, 3))


def test_a_limit_on_the_axis_is_there_to_the_last_digit(
    batch: tuple[list[HapticLoop], jaxstab.results.Limits],
) -> None:
    """For a free mass p(1) is K times a positive factor: every wall with K < 0 is unstable."""
    many, limits = batch
    is_free = np.array([loop.hand_stiffness == 0.0 for loop in many])
    is_at_one = [abs(loop.limits().at_stiffness) < 1e-6 for loop in many[:24]]
    assert np.sum((is_free & ~limits.is_single)[:24] & is_at_one) > 6
    assert np.all(limits.at_stiffness[:24][is_at_one] == 0.0)
    assert not np.signbit(limits.at_stiffness).any()


def test_outlines_are_closed_and_on_the_boundary_of_each_loop(
    regions: tuple[list[HapticLoop], jaxstab.results.ManyRegions],
) -> None:
    many, answer = regions
    assert answer.outline.shape == (COUNT, 295, 2)
    assert np.array_equal(answer.outline[:, 0], answer.outline[:, -1])
    for index, loop in list(enumerate(many))[::6]:
        region = loop.region()
        size = np.array(
            [region.main.stiffest.stiffness, region.main.most_damped.damping]
        )  # of the region
        stiffness, damping = answer.outline[index].T
        assert np.max(region.distance(stiffness, damping)) <= 1e-8 * np.hypot(*size)
        assert answer.area[index] == pytest.approx(region.main.area, rel=1e-7)
        # The polygon runs counter-clockwise; its chords leave out little of the region.
        x, y = (answer.outline[index] / size).T
        polygon = 0.5 * np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]) * np.prod(size)
        assert polygon == pytest.approx(answer.area[index], rel=2e-3)


def test_the_area_of_an_undamped_free_mass_is_the_known_one() -> None:
    """Stable are 0 < alpha < 2 beta (2 - beta)/(beta + 2), 0 < beta < 2."""
    masses = np.linspace(0.1, 2.0, 3)
    loop = HapticLoop(device_mass=0.1, device_damping=0.0, sample_time=PERIOD)
    area = regions_of(loop, device_mass=masses).area
    known = 12.0 - 16.0 * np.log(2.0)
    assert area == pytest.approx(known * masses**2 / PERIOD**3, rel=1e-7)


def test_an_undamped_free_mass_has_the_known_limits(
    batch: tuple[list[HapticLoop], jaxstab.results.Limits],
) -> None:
    known = (6.0 - 4.0 * np.sqrt(2.0)) * np.array(MASSES) / PERIOD**2
    assert batch[1].stiffness[-len(MASSES) :] == pytest.approx(known, rel=1e-9)


def test_regions_of_loops_of_all_kinds_are_those_of_each_and_few_are_asked_alone() -> None:
    """Four loops are left to single answers; four more are resolved when they are scanned again."""
    rng = np.random.default_rng(36)
    drawn = [draw(rng) for draw in (random_loop, hard_loop) for _ in range(50)]
    answer = regions_of(drawn)
    assert np.sum(answer.limits.is_single) <= 4
    for index, loop in list(enumerate(drawn))[1::4]:
        assert not is_wrong(answer.limits, index, loop.limits())
        assert answer.area[index] == pytest.approx(loop.region().main.area, rel=1e-8)


MASS, DAMPING, FREQUENCY, MODAL_MASS, CUTOFF = 0.134, 0.0356, 112.0, 0.152, 57.5


def next_to_modes(rng: np.random.Generator) -> list[HapticLoop]:
    """Devices with a lightly damped mode: a piece of the boundary next to it is narrow."""
    return [
        HapticLoop(
            device=Device.modes(
                [Mode(frequency=FREQUENCY, damping_ratio=ratio, modal_mass=MODAL_MASS)],
                mass=MASS,
                damping=DAMPING,
            ),
            delay=float(rng.uniform(3.1, 3.5)) * PERIOD,
            sample_time=PERIOD,
            velocity=Velocity.low_pass(CUTOFF, order=1),
        )
        for ratio in np.linspace(0.004, 0.014, COUNT).tolist()
    ]


def stiffest_by_roots(loop: HapticLoop, stiffness: float, damping: float) -> list[int]:
    """Codes of certified roots a little inside of the stiffest wall and outside of it."""
    (ratio,) = (one.damping_ratio for one in loop.device.mechanism.modes)
    body = mpf(MASS), mpf(DAMPING), mpf(0)
    system = Mechanism([body, mode(FREQUENCY, ratio, MODAL_MASS)]).system()
    filters = times(difference(1), low_pass(CUTOFF * PERIOD, 1)), average(1)
    truth = DeviceLoop(system, PERIOD, loop.delay / PERIOD, *filters)
    return [truth.code(stiffness * one, damping) for one in (1.0 - 1e-8, 1.0 + 1e-8)]


@pytest.mark.campaign
def test_pieces_that_a_scan_missed_are_found_by_a_second_one(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    many = next_to_modes(rng)
    limits = regions_of(many).limits
    assert not limits.is_single.any()
    for index in range(0, COUNT, 18):
        assert not is_wrong(limits, index, many[index].limits())
        wall = limits.stiffness[index], limits.at_damping[index]
        assert stiffest_by_roots(many[index], *wall) == [Verdict.STABLE, Verdict.UNSTABLE]

    monkeypatch.setattr(loops_together, "_SCANS", 1)
    assert np.mean(regions_of(many).limits.is_single) > 0.05


@pytest.mark.campaign
def test_a_turn_of_the_boundary_next_to_an_axis_is_not_passed_over() -> None:
    """A few angles of the scan cover all of K, B >= 0: the stiffest wall is between two of them."""
    loop = HapticLoop(
        device_mass=0.2,
        device_damping=1.5,
        sample_time=PERIOD,
        delay=1.025e-3,
        velocity=Velocity.butterworth(24.32, order=4),
    )
    masses = np.linspace(0.18, 0.22, COUNT)
    limits = limits_of(loop, device_mass=masses)
    assert np.mean(limits.is_single) < 0.5
    for index, mass in enumerate(masses.tolist()):
        own = replace(loop, device_mass=mass)
        assert not is_wrong(limits, index, own.limits())
        wall = limits.stiffness[index], limits.at_damping[index]
        assert own.verdict(wall[0] * (1.0 - 1e-7), wall[1]) == Verdict.STABLE
        assert own.verdict(wall[0] * (1.0 + 1e-7), wall[1]) == Verdict.UNSTABLE


@pytest.mark.campaign
def test_a_turn_between_a_corner_and_the_nearest_angle_of_the_scan_is_not_passed_over() -> None:
    mode = Mode(frequency=237.72537, damping_ratio=0.012839809, modal_mass=0.046769950)
    loop = HapticLoop(
        device=Device.modes([mode], mass=0.13984057, damping=0.24706771),
        delay=1.62626060e-3,
        sample_time=PERIOD,
        velocity=Velocity.difference(samples=3),
    )
    many = [replace(loop, delay=loop.delay * (1.0 + 1e-6 * k)) for k in range(COUNT)]
    limits = limits_of(many)
    assert not limits.is_single.any()
    for index in range(0, COUNT, 18):
        assert not is_wrong(limits, index, many[index].limits())
        wall = limits.stiffness[index], limits.at_damping[index]
        assert many[index].verdict(wall[0] * (1.0 - 1e-7), wall[1]) == Verdict.STABLE
        assert many[index].verdict(wall[0] * (1.0 + 1e-7), wall[1]) == Verdict.UNSTABLE


def with_three_pieces() -> list[HapticLoop]:
    """Loops whose region has three pieces of the curve, of about one mass."""
    loop = HapticLoop(
        device_mass=0.0346,
        device_damping=0.00655,
        hand_damping=2.839,
        hand_stiffness=2220.7,
        delay=7.74e-5,
        sample_time=PERIOD,
        velocity=Velocity.butterworth(22.2317, order=4),
    )
    return [replace(loop, device_mass=0.0346 * (1.0 + 1e-4 * k)) for k in range(COUNT)]


@pytest.mark.campaign
def test_the_area_of_a_region_with_three_pieces_is_that_of_its_loop() -> None:
    many = with_three_pieces()
    answer = regions_of(many)
    assert not answer.limits.is_single.any()  # else a wrong corner may be noticed and replaced
    for index in range(0, COUNT, 18):
        region = many[index].region()
        assert answer.area[index] == pytest.approx(region.main.area, rel=1e-6)


def test_vertices_of_an_outline_have_roots_at_both_of_their_angles() -> None:
    """By polynomials from balls; at a corner the angles are those of two roots."""
    loop, *others = with_three_pieces()
    stacks = loops_together.stacked([loop, *others])
    ((_, _, (_, outline)),) = loops_together.resolved(stacks, outlines=True)
    velocity = times(difference(1), butterworth(22.2317 * PERIOD, 4))
    balls = FilteredLoop(**loop.slice, velocity=velocity, position=average(1)).balls()
    for wall, angles in zip(outline.vertices[0].tolist(), outline.roots[0], strict=True):
        falling = [float(c.mid()) for c in balls.polynomial(*wall)]
        assert np.max(np.abs(np.polyval(falling, np.exp(1j * angles)))) < 1e-13 * np.sum(
            np.abs(falling)
        )


def families() -> list[list[HapticLoop]]:
    """Loops of degree 9 of three kinds: what their programs have to solve is next to corners."""
    masses = np.linspace(0.04, 0.042, COUNT).tolist()
    slow = Velocity.butterworth(17.0, order=4)  # four poles next to each other
    slower = Velocity.butterworth(16.5521, order=3)  # the stiffest wall has B = 0
    mode = Mode(frequency=165.371, damping_ratio=0.006, modal_mass=0.05)
    shared: dict[str, Any] = {"sample_time": PERIOD}
    return [
        [HapticLoop(device_mass=m, device_damping=1.5, velocity=slow, **shared) for m in masses],
        [
            HapticLoop(
                device_mass=17.0 * m,
                device_damping=11.904,
                delay=2.397e-3,
                velocity=slower,
                **shared,
            )
            for m in masses
        ],
        [
            HapticLoop(
                device=Device.modes([mode], mass=m, damping=0.2431),
                delay=0.4273e-3,
                velocity=Velocity.butterworth(87.8974, order=2),
                **shared,
            )
            for m in masses
        ],
    ]


@pytest.mark.campaign
def test_slow_filters_and_crossings_next_to_corners_are_resolved_by_the_program() -> None:
    kinds = families()
    limits = limits_of([loop for kind in kinds for loop in kind])
    assert np.all(limits.is_single.reshape(3, COUNT).mean(axis=1) < 0.05)
    for start, kind in zip(range(0, 3 * COUNT, COUNT), kinds, strict=True):
        for number in range(0, COUNT, 24):
            loop, index = kind[number], start + number
            assert not is_wrong(limits, index, loop.limits())
            stiffness, damping = limits.stiffness[index], limits.at_damping[index]
            beside = damping * (1.0 + np.linspace(-1e-5, 1e-5, 41))
            assert np.any(loop.verdict(stiffness * (1.0 - 1e-6), beside) == Verdict.STABLE)
            assert np.all(loop.verdict(stiffness * (1.0 + 1e-7), beside) == Verdict.UNSTABLE)


def test_no_two_angles_of_a_scan_are_the_same() -> None:
    """Sampled modes have real zeros, around which angles would be mirrored onto each other."""
    for formed in loops_together._formed(loops_together.stacked(families()[2])):
        angles = loops_together._scans(formed, 9)
        inner = angles[0][angles[0] > 1e-5]
        assert np.min(np.diff(inner)) > 1e-9


def test_devices_that_are_given_twice_have_answers_of_their_own() -> None:
    """Equal loops are one stack, each of its members a loop of the batch."""
    hertz = np.arange(30.0, 110.0).tolist()
    modes = [Mode(frequency=own, damping_ratio=0.02, modal_mass=1.0) for own in hertz]
    loops = [
        HapticLoop(device=Device.modes([one], mass=0.2, damping=0.1), sample_time=1e-3, delay=1e-3)
        for one in modes
    ]
    alone, twice = limits_of(loops), limits_of([*loops[:40], *loops])
    assert not np.any(alone.is_single)
    assert not np.any(twice.is_single)
    np.testing.assert_allclose(twice.stiffness[:40], alone.stiffness[:40], rtol=1e-9)
    np.testing.assert_allclose(twice.stiffness[40:], alone.stiffness, rtol=1e-9)
    assert abs(alone.stiffness[0] - loops[0].limits().stiffness) < 1e-9 * alone.stiffness[0]


@pytest.mark.parametrize("samples", [1, 2, 3, 16, 20, 60])
def test_the_curve_of_a_window_goes_to_infinity_where_its_velocity_is_real(samples: int) -> None:
    """Im V = sin(n theta)/n, also at angles that are among the samples of the circle."""
    angles = loops_together._poles((Velocity.difference(samples), Filter()))
    truth = np.pi * np.arange(1, samples) / samples
    np.testing.assert_allclose(angles, truth, rtol=1e-13)


def test_a_program_is_kept_until_eight_others_are_needed() -> None:
    first = ref(program(101))
    assert program(101) is first()
    for degree in range(102, 110):
        program(degree)
    gc.collect()
    assert first() is None


def test_groups_are_computed_while_the_next_ones_are_made_few_of_them_ahead() -> None:
    made: list[int] = []
    is_used = 0

    def items() -> Iterator[int]:
        for k in range(40):
            made.append(k)
            yield k

    for k, square in ahead(lambda k: k * k, items()):
        assert (k, square) == (is_used, is_used**2)
        assert len(made) - is_used < 20
        is_used += 1
    assert is_used == len(made) == 40


def test_what_float64_says_of_roots_outside_the_circle_is_so_by_fractions(
    rng: np.random.Generator,
) -> None:
    """Some roots are 1e-15 to 0.1 from the circle, some are double, some polynomials end in 0."""
    falling = np.zeros((2000, 8))
    for row in falling:
        pairs = rng.integers(1, 4)
        distance = rng.choice([-1.0, 1.0], 3) * 10.0 ** rng.uniform(-15, -1, 3)
        root = (1.0 + distance) * np.exp(1j * rng.uniform(0.0, np.pi, 3))
        root[1] = root[0] if rng.random() < 0.2 else root[1]
        both = np.append(root[:pairs], root[:pairs].conj())
        row[: 2 * pairs + 2] = np.real(np.poly([*both, rng.uniform(-0.9, 0.9)]))
    codes = codes_in_float64(falling)
    are_unstable = _are_unstable([arb_poly(row[::-1].tolist()) for row in falling])
    for row, code, is_unstable in zip(falling, codes, are_unstable, strict=True):
        exact = [Fraction(float(c)) for c in row]
        assert code == Verdict.UNDECIDED or (code == Verdict.STABLE) == has_roots_inside(exact)
        powers = reversed(range(len(row)))
        around = [c * Fraction(1.0 + 1e-9) ** k for c, k in zip(exact, powers, strict=True)]
        assert is_unstable != has_roots_inside(around)
    assert 0.3 < np.mean(codes == Verdict.UNSTABLE) < 0.9
    assert 0.0 < np.mean(codes == Verdict.UNDECIDED) < 0.3


def test_few_loops_are_answered_one_by_one(rng: np.random.Generator) -> None:
    many = loops(rng)[:2]
    limits = limits_of(many)
    assert limits.is_single.all()
    assert limits.stiffness.tolist() == [loop.limits().stiffness for loop in many]
    assert limits_of([]).stiffness.shape == (0,)


def test_a_loop_of_no_loops_has_no_answers() -> None:
    empty = np.zeros(0)
    for fields in ({"device_mass": empty}, {"sample_time": empty}, {"delay": empty}):
        loop = HapticLoop(
            **{"device_mass": 0.1, "device_damping": 0.1, "sample_time": PERIOD} | fields
        )
        assert loop.verdict(1000.0, 10.0).shape == limits_of(loop).stiffness.shape == (0,)
        more = [[0.0], [1.0]]
        assert jaxstab.regions_of(loop, hand_stiffness=more).outline.shape == (2, 0, 295, 2)


def test_fields_of_one_loop_broadcast() -> None:
    loop = HapticLoop(device_mass=0.1, device_damping=0.1, sample_time=PERIOD)
    delays, windows = np.array([[0.0], [PERIOD]]), [Velocity.difference(samples=n) for n in (1, 3)]
    limits = limits_of(loop, delay=delays, velocity=windows)
    assert limits.stiffness.shape == limits.status.shape == (2, 2)
    for row, delay in enumerate(delays.ravel().tolist()):
        for column, window in enumerate(windows):
            alone = replace(loop, delay=delay, velocity=window).limits()
            assert limits.stiffness[row, column] == alone.stiffness
    assert limits_of(loop).stiffness.shape == ()


@pytest.mark.parametrize(
    "fields",
    [
        {"device_mass": [[0.1], [0.2]], "delay": np.array([0.0, PERIOD, 1.5 * PERIOD])},
        {"sample_time": [1e-3, 2e-3], "velocity": Velocity.difference(window=4e-3)},
        {"device": Device.mass_spring_damper(0.3, damping=0.1), "delay": [0.0, 2e-3]},
    ],
    ids=["mass and delay", "period and window", "device"],
)
def test_a_loop_with_arrays_as_fields_is_many_loops(fields: dict[str, Any]) -> None:
    own = {} if "device" in fields else {"device_mass": 0.1, "device_damping": 0.1}
    many = HapticLoop(**{"sample_time": PERIOD, **own, **fields})
    arrays = {name: np.array(x) for name, x in fields.items() if name not in ("velocity", "device")}
    shape = np.broadcast_shapes(*(x.shape for x in arrays.values()))
    limits, regions = limits_of(many), regions_of(many)
    assert many.shape == limits.stiffness.shape == regions.area.shape == shape
    for index in np.ndindex(shape):
        one = {name: float(np.broadcast_to(x, shape)[index]) for name, x in arrays.items()}
        alone = replace(many, **one).region()
        assert limits.stiffness[index] == regions.limits.stiffness[index]
        assert limits.stiffness[index] == pytest.approx(alone.limits().stiffness, rel=1e-12)
        assert alone.main is not None
        assert regions.area[index] == pytest.approx(alone.main.area, rel=1e-6)


def test_periods_that_vary_decide_windows_in_seconds_and_delays_in_samples() -> None:
    periods = [1e-3, 0.5e-3, 1e-3, 2e-3]
    plain = HapticLoop(device_mass=0.1, device_damping=0.1, sample_time=PERIOD, delay=2e-3)
    for loop in (plain, replace(plain, velocity=Velocity.difference(window=4e-3))):
        limits = limits_of(loop, sample_time=periods, hand_mass=[0.0, 0.1, 0.2, 0.3])
        for index, period in enumerate(periods):
            alone = replace(loop, sample_time=period, hand_mass=0.1 * index).limits()
            assert limits.stiffness[index] == pytest.approx(alone.stiffness, rel=1e-12)
            assert limits.damping[index] == pytest.approx(alone.damping, rel=1e-12)


def test_masses_given_as_numbers_and_as_devices_are_the_same_loops(
    rng: np.random.Generator,
) -> None:
    shared: dict[str, Any] = {"sample_time": PERIOD, "delay": PERIOD}
    numbers = [
        HapticLoop(device_mass=m, device_damping=0.1, **shared) for m in rng.uniform(1, 2, 3)
    ]
    devices = [
        HapticLoop(device=Device.mass_spring_damper(one.device_mass, damping=0.1), **shared)
        for one in numbers
    ]
    found = limits_of(numbers + devices).stiffness
    assert found[:3].tolist() == found[3:].tolist() == [one.limits().stiffness for one in numbers]
    delays = [0.0, PERIOD]
    for loop in (numbers[0], devices[0]):
        alone = [replace(loop, delay=delay).limits().stiffness for delay in delays]
        assert limits_of(loop, delay=delays).stiffness.tolist() == alone


def test_what_is_no_loop_is_refused() -> None:
    with pytest.raises(TypeError, match="loops has 3; give a HapticLoop for each"):
        limits_of([3])  # type: ignore[list-item]
    loop = HapticLoop(device_mass=0.1, device_damping=0.1, sample_time=PERIOD)
    with pytest.raises(TypeError, match="give a list of HapticLoop"):
        limits_of(0.1)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="delay is given beside a list; give one loop"):
        limits_of([loop], delay=[0.0, 1e-3])
    with pytest.raises(TypeError, match="'mass'"):
        limits_of(loop, mass=[0.1, 0.2])
    with pytest.raises(ValueError, match="device_mass is -1"):
        limits_of(loop, device_mass=[0.1, -1.0])
    with pytest.raises(TypeError, match="device_mass is True; give real numbers"):
        limits_of(loop, device_mass=[True, False])
    with pytest.raises(
        ValueError, match="the delay is 1000 samples, 1 s; give 500 samples at most"
    ):
        limits_of(loop, delay=[[0.0], [1.0]], sample_time=[2e-3, 1e-3])
    window = Velocity.difference(window=2e-3)
    with pytest.raises(ValueError, match=r"window is 0.002 s, 6.66667 sampling periods"):
        limits_of(loop, velocity=window, sample_time=[1e-3, 0.3e-3])
    spring = Device.transfer_function([1.0, 0.0], [0.1, 1.0, 10.0])
    with pytest.raises(ValueError, match="zero DC gain"):
        limits_of([HapticLoop(device=spring, sample_time=PERIOD)])


@pytest.mark.campaign
def test_a_limit_that_is_small_beside_its_component_is_right_to_1e_9() -> None:
    """A stiff hand, hardly damped: the stable set extends to K = -2,000 N/m, and to 0.2 N/m."""
    loop = HapticLoop(
        sample_time=0.001,
        device_mass=0.08803426979152712,
        device_damping=0.0010136982565741267,
        delay=0.013968140957988793,
        velocity=Velocity.difference(samples=20),
    )
    hands = 2214.0404342545435 * (1.0 + np.linspace(-1e-4, 1e-4, COUNT))
    limits = limits_of(loop, hand_stiffness=hands)
    assert np.all(limits.stiffness < 0.22)
    for hand, limit in zip(hands.tolist(), limits.stiffness, strict=True):
        held = replace(loop, hand_stiffness=hand)
        codes = held.verdict(limit * np.array([1.0 - 1e-9, 1.0 + 1e-9]), 0.0)
        assert codes.tolist() == [Verdict.STABLE, Verdict.UNSTABLE]


WINDOWS = (1, 2, 3, 5, 8, 10, 15, 20)


def random_loop(rng: np.random.Generator) -> HapticLoop:
    """Return a loop as it may be in a laboratory, with any estimator and delay."""
    delay = float(rng.choice([float(rng.integers(0, 31)), rng.uniform(0, 30), rng.uniform(0, 4)]))
    mass, damping = float(10 ** rng.uniform(-1.5, 0.5)), float(10 ** rng.uniform(-3, 1))
    shared: dict[str, Any] = {
        "sample_time": PERIOD,
        "delay": delay * PERIOD,
        "velocity": _estimator(rng),
        "position": _position(rng),
    }
    if rng.uniform() < 0.25:
        mode = Mode(
            frequency=float(rng.uniform(20, 300)),
            damping_ratio=float(10 ** rng.uniform(-2.5, -0.5)),
            modal_mass=mass * float(10 ** rng.uniform(-0.5, 1.5)),
        )
        return HapticLoop(device=Device.modes([mode], mass=mass, damping=damping), **shared)
    return HapticLoop(
        device_mass=mass,
        device_damping=damping,
        hand_damping=float(rng.choice([0.0, 10 ** rng.uniform(-1, 1.5)])),
        hand_stiffness=float(rng.choice([0.0, 10 ** rng.uniform(0, 3.5)])),
        **shared,
    )


def hard_loop(rng: np.random.Generator) -> HapticLoop:
    """Return a loop whose stable set has many pieces, islands or thin parts more often."""
    delay = float(rng.choice([float(rng.integers(0, 13)), rng.uniform(0, 12)]))
    return HapticLoop(
        device_mass=float(10 ** rng.uniform(-2.0, -0.5)),
        device_damping=float(10 ** rng.uniform(-4, 0)),
        hand_damping=float(rng.choice([0.0, 10 ** rng.uniform(0.5, 2)])),
        hand_stiffness=float(rng.choice([0.0, 10 ** rng.uniform(2, 4.5)])),
        sample_time=PERIOD,
        delay=delay * PERIOD,
        velocity=_estimator(rng),
        position=_position(rng),
    )


def _estimator(rng: np.random.Generator) -> Velocity:
    cutoff = float(10 ** rng.uniform(1.2, 2.5))
    kind = rng.integers(4)
    if kind == 0:
        return Velocity.low_pass(cutoff, order=int(rng.integers(1, 3)))
    if kind == 1:
        return Velocity.butterworth(cutoff, order=int(rng.integers(2, 5)))
    return Velocity.difference(samples=int(rng.choice(WINDOWS)))


def _position(rng: np.random.Generator) -> Filter | None:
    kind = rng.integers(8)
    if kind == 0:
        return Filter.average(samples=int(rng.integers(2, 6)))
    if kind == 1:
        return Filter.low_pass(float(10 ** rng.uniform(1.5, 2.5)), order=1)
    return None


@pytest.mark.campaign
@pytest.mark.parametrize("draw", [random_loop, hard_loop])
def test_limits_of_random_loops_are_those_of_each(draw: Callable[..., HapticLoop]) -> None:
    """Any estimator, filter and mode, delays to 30 samples; light devices in stiff hands."""
    rng = np.random.default_rng(33)
    drawn = [draw(rng) for _ in range(sized(3000, 64))]
    limits = limits_of(drawn)
    assert not any(is_wrong(limits, index, loop.limits()) for index, loop in enumerate(drawn))
    assert np.mean(limits.is_single) < 0.1 or len(drawn) < 1000


def test_the_rounding_of_a_wall_is_no_more_than_the_bound_that_extremes_are_held_to(
    rng: np.random.Generator,
) -> None:
    """Against 50 digits, on curves of windows and of slow filters; next to z = 1 no coarser one."""
    shares: dict[bool, list[mpf]] = {True: [], False: []}
    two = [loops(rng)[0], families()[0][0]]
    for one in loops_together._formed(loops_together.stacked(two)):
        triples = loops_together._triples([one], one.parts.hi.shape[2] - 1)
        loop = Triples(*(part[0] for part in triples))
        theta = np.concatenate([np.geomspace(1e-3, 0.3, 8), rng.uniform(0.3, 3.1, 8)])
        walls = np.asarray(_wall(loop, theta))
        bound = vmap(partial(_rounding, loop), (0, 1, None))
        bounds = [bound(theta, walls, k).tolist() for k in (0, 1)]
        with workdps(50):
            for index, angle in enumerate(theta.tolist()):
                base, stiffness, damping = (
                    polyval([mpf(a) + mpf(b) for a, b in rows], expj(mpf(angle)), asc=True)
                    for rows in np.stack([one.parts.hi, one.parts.lo], -1)[0, :, ::-1].tolist()
                )
                det = (conj(stiffness) * damping).imag
                true = (conj(damping) * base).imag / det, -(conj(stiffness) * base).imag / det
                for k, value in enumerate(true):
                    share = abs(mpf(float(walls[k, index])) - value) / bounds[k][index]
                    shares[angle < 0.01].append(share)
    assert all(0.05 < max(own) <= 1.0 for own in shares.values())


def of_a_free_mass() -> Triples:
    mass = HapticLoop(device_mass=0.1, device_damping=0.1, sample_time=PERIOD)
    (one,) = loops_together._formed(loops_together.stacked([mass]))
    triples = loops_together._triples([one], one.parts.hi.shape[2] - 1)
    return Triples(*(jnp.asarray(part[0]) for part in triples))


def test_ends_of_pieces_are_bracketed_to_a_256th_of_a_step_of_the_scan() -> None:
    """The one piece of a free mass goes from z = 1 to where a root is at 1 again: alpha is 0."""
    loop = of_a_free_mass()
    ends, has_room = jit(lambda: _ends_of(loop, _scan(loop)))()
    end = findroot(lambda theta: true_loop.boundary_point(theta, 0.0, PERIOD, 0.0)[0], 1.57)
    after = int(np.searchsorted(loop.angles, float(end)))
    step = float(loop.angles[after] - loop.angles[after - 1])
    assert has_room
    assert ends.exists.tolist() == [True, *[False] * (SLOTS - 1)]
    assert ends.next_to[:, 0].tolist() == [0, after - 1]
    assert ends.pinned[:, 0].tolist() == [True, False]
    assert ends.branch[:, 0].tolist() == [Branch.Z_PLUS_ONE] * 2
    assert ends.width[:, 0].tolist() == pytest.approx([0.0, step / 256.0], rel=1e-9)
    assert abs(float(ends.theta[1, 0]) - float(end)) <= float(ends.width[1, 0]) / 2.0


def test_a_piece_is_solved_only_if_both_of_its_ends_are() -> None:
    """From z = 1, where it is pinned, to the line of a root at 1, within its bracket alone."""
    loop = of_a_free_mass()
    is_first = jnp.arange(SLOTS) == 0
    corners = jit(lambda ends: _corners_of(loop, ends, jnp.ones(SLOTS), jnp.ones(2)))
    for theta, is_solved in ((1.5714, True), (1.45, False)):
        ends = _PieceEnds(
            exists=is_first,
            next_to=jnp.zeros((2, SLOTS), int),
            theta=jnp.stack([jnp.full(SLOTS, 1e-6), jnp.full(SLOTS, theta)]),
            branch=jnp.full((2, SLOTS), Branch.Z_PLUS_ONE),
            width=jnp.full((2, SLOTS), 2e-4),
            pinned=jnp.array([[True], [False]]) & is_first,
        )
        assert bool(corners(ends).is_solved[0]) == is_solved


def between_lines() -> Triples:
    """A loop by its lines alone: stable are alpha > 0 and beta < 1."""
    ends = jnp.array([[0.0, 1.0, 0.0], [1.0, 0.0, -1.0]])
    return Triples(jnp.eye(3, 4), jnp.eye(3, 4), jnp.zeros(3), ends, jnp.linspace(0.1, 3.0, 8))


def test_behind_the_crossing_of_both_lines_the_next_piece_begins_on_the_other_line() -> None:
    """A curve from (0, 0.3) to (0.5, 1) bounds the stable set, too.

    A piece inside, between two others, begins nearer to the crossing.
    """
    loop, nothing = between_lines(), jnp.zeros(SLOTS)
    number = jnp.arange(SLOTS)
    branch = jnp.zeros((2, SLOTS), int)  # of curves
    branch = branch.at[1, 0].set(Branch.Z_MINUS_ONE).at[0, 1].set(Branch.Z_PLUS_ONE)
    begins = jnp.array([[0.2, 0.0, 0.3], [0.5, 0.3, 0.8]])
    stops = jnp.array([[0.5, 0.2, 0.4], [1.0, 0.5, 0.9]])
    walls = jnp.stack([jnp.pad(side, ((0, 0), (0, SLOTS - 3))) for side in (begins, stops)], 1)
    known = (number < 3, nothing, branch, walls, walls, number, number)
    links = jit(_linked)(loop, _Corners(*known, nothing, nothing, nothing))
    assert links.crossing.tolist() == [0.0, 1.0]
    assert bool(links.via[0])
    assert int(links.successor[0]) == 1


def test_the_stable_set_is_to_the_left_of_both_pieces_at_their_corner() -> None:
    """Piece 0 arrives along alpha, piece 1 leaves along beta: seen from the end and the begin."""
    loop, nothing = between_lines(), jnp.zeros(SLOTS)
    along = jnp.ones((2, 2, SLOTS))
    slopes = along.at[:, 1, 0].set(jnp.array([2.0, 0.0])).at[:, 0, 1].set(jnp.array([0.0, 3.0]))
    other = 1 - jnp.minimum(jnp.arange(SLOTS), 1)
    curves = jnp.zeros((2, SLOTS), int)
    corners = _Corners(nothing, nothing, curves, along, slopes, other, other, *[nothing] * 3)
    toward = jit(lambda corner: _bisector(loop, corners, corner, jnp.ones(2)))
    begin_of_1, end_of_0 = 1, SLOTS
    assert toward(begin_of_1).tolist() == toward(end_of_0).tolist() == [-1.0, 1.0]


def test_the_top_of_a_parabola_is_no_farther_than_its_outer_points() -> None:
    angles = np.array([0.1, 0.4, 0.5])
    for top, expected in ((0.3, 0.3), (0.7, 0.5), (-0.2, 0.1)):
        low, middle, high = 2.0 - 3.0 * (angles - top) ** 2
        found = _vertex(jnp.array(angles), middle, jnp.array([low, high]))
        assert float(found) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize(("start", "is_there"), [(0.1, True), (2.9, True), (0.1, False)])
def test_a_zero_is_found_where_newtons_steps_lead_out_of_its_limits(
    start: float, is_there: bool
) -> None:
    """Of the cosine: from these angles the tangent leads to 10 and to -1."""
    limits = jnp.array([0.0, 3.0 if is_there else 1.0])
    values = lambda theta: (jnp.cos(theta), -jnp.sin(theta))  # noqa: E731
    theta, is_reached = jit(partial(_fall, values))(jnp.array(start), *limits)
    assert bool(is_reached) == is_there
    assert not is_there or float(theta) == pytest.approx(np.pi / 2.0, rel=1e-14)


@pytest.mark.parametrize(("least", "count"), [(0.0, 6), (3e-6, 0), (-0.5, 6)])
def test_there_are_no_small_walls_where_the_smallest_are_unstable(least: float, count: int) -> None:
    """Stable are alpha > least and beta < 1, in a set of size 1: stiffness may be least, too."""
    loop = between_lines()
    loop = loop._replace(ends=loop.ends.at[0, 0].set(-least))
    walls, found = jit(_small_walls)(loop, jnp.ones(2))
    assert int(found) == count
    assert np.all(walls > 0.0)
    if count:
        assert walls[1].tolist() == [0.03, 0.01]
