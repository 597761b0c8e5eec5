"""The triple of a loop in balls holds what mpmath finds from the equations of motion."""

import flint
import numpy as np
import pytest
from mpmath import mp, mpf

import jaxstab
from jaxstab import Device, HapticLoop, Mode, Velocity
from jaxstab.model.balls import Factored, Triple, ball_triple
from jaxstab.model.device.parts import working_precision
from tests.truth.plain import Loop
from tests.truth.random_loops import DeviceLoop, MassLoop, long_window

WALLS = (0.0, 0.0), (0.25, 0.0), (0.0, 0.5), (-0.125, 2.0)


def as_mpf(ball: flint.arb) -> mpf:
    mantissa, exponent = ball.mid().man_exp()
    return mp.ldexp(mpf(int(mantissa)), int(exponent))


def monic(values: list[mpf]) -> list[mpf]:
    return [value / values[0] for value in values]


@pytest.mark.parametrize("draw", [MassLoop.drawn, DeviceLoop.drawn, DeviceLoop.hardly_moved])
@pytest.mark.parametrize("seed", range(3))
def test_the_polynomial_of_a_wall_is_that_of_mpmath(draw: object, seed: int) -> None:
    truth = Loop.of(draw(np.random.default_rng([52, seed])))  # type: ignore[operator]
    with mp.workdps(100), working_precision(1024):
        for stiffness, damping in WALLS:
            balls = ball_triple(truth.loop).at(stiffness, damping).polynomial().coeffs()[::-1]
            while balls[-1] == 0:
                balls.pop()
            found = monic([as_mpf(ball) for ball in balls])
            expected = monic(truth.polynomial(stiffness, damping))
            assert len(found) == len(expected)
            size = max(map(abs, expected))
            assert max(abs(a - b) for a, b in zip(found, expected, strict=True)) < size * 1e-60


def pushed(below: list[float], delay: float) -> HapticLoop:
    """A device 1/D(s)."""
    device = Device.transfer_function([1.0], below)
    return HapticLoop(device=device, sample_time=1e-3, delay=delay)


def free(**fields: object) -> HapticLoop:
    numbers = {"device_mass": 0.25, "device_damping": 0.0, "sample_time": 1e-3}
    return HapticLoop(**{**numbers, **fields})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("loop", "orders"),
    [
        (free(), [(2, 0), (0, 1), (1, 1)]),
        (free(delay=0.5e-3), [(2, 0), (0, 0), (1, 0)]),
        (free(device_damping=0.1), [(1, 0), (0, 0), (1, 0)]),
        (free(hand_stiffness=10.0), [(0, 0), (0, 1), (1, 1)]),
        (free(velocity=Velocity.difference(samples=6)), [(2, 0), (0, 1), (1, 2)]),
        (free(velocity=Velocity.butterworth(100.0, order=3)), [(2, 0), (0, 1), (1, 4)]),
        (pushed([2.0, 0.0], 1e-3), [(1, 0), (0, 0), (1, 0)]),
        (pushed([2.0, 0.0], 1.5e-3), [(1, 0), (0, 1), (1, 1)]),
        (pushed([1.0, 0.0, 9e4, 0.0], 2.5e-3), [(1, 0), (0, 1), (1, 1)]),
        (pushed([1.0, 0.0, 9e4], 0.5e-3), [(0, 0), (0, 0), (1, 0)]),
    ],
)
def test_roots_at_one_and_minus_one_are_known_by_structure(
    loop: HapticLoop, orders: list[tuple[int, int]]
) -> None:
    with working_precision(256):
        parts = ball_triple(loop)
        assert [(part.at_one, part.order_at_minus_one) for part in parts] == orders
        for part in parts:
            plain = part.polynomial()
            for place, order in ((1, part.at_one), (-1, part.order_at_minus_one)):
                shifted = plain(flint.arb_poly([place, 1])).coeffs()
                assert all(abs(c) < 1e-60 for c in shifted[:order])
                assert abs(shifted[order]) > 1e-20


@pytest.mark.parametrize("modes", [1, 2])
def test_undamped_devices_behind_whole_delays_have_a_root_of_n_at_minus_one(modes: int) -> None:
    undamped = [Mode(frequency=60.0 + k, damping_ratio=0.0, modal_mass=0.3) for k in range(modes)]
    loop = HapticLoop(device=Device.modes(undamped, mass=0.2), sample_time=1e-3, delay=2e-3)
    with working_precision(256):
        parts = ball_triple(loop)
        assert (parts.base.at_one, parts.stiffness.at_minus_one) == (2, 1)


def test_windows_are_kept_apart_until_they_are_added() -> None:
    with working_precision(128):
        whole = ball_triple(free(velocity=Velocity.difference(samples=20)))
        assert whole.damping.windows == (20,)
        assert whole.at(0.0, 1.0).windows == ()
        assert whole.degree == whole.at(3.0, 1.0).degree == 22


def test_factors_are_multiplied_added_and_evaluated_as_polynomials_are() -> None:
    p = Factored(flint.arb_poly([2, 3]), power=1, at_one=1, windows=(3,))
    q = Factored(flint.arb_poly([5]), at_one=2, at_minus_one=1, windows=(2,))
    z = flint.fmpq_poly([0, 1])
    plain_p = z * (z - 1) * (z**2 + z + 1) * (3 * z + 2)
    plain_q = 5 * (z - 1) ** 2 * (z + 1) ** 2
    for found, expected in (
        (p, plain_p),
        (q, plain_q),
        (p.times(q), plain_p * plain_q),
        (p.plus(q), plain_p + plain_q),
        (p.scaled(4), 4 * plain_p),
    ):
        assert list(map(float, found.polynomial().coeffs())) == list(map(int, expected.coeffs()))
        assert found.degree == expected.degree()
        for place in (1, -1):
            assert found.at_end(place) == expected(place)
    assert p.plus(q).at_one == 1
    assert p.scaled(0).is_zero
    assert p.plus(p.scaled(0)) == p
    assert Factored.from_rational(plain_q)[1:4] == (0, 2, 2)


def test_a_triple_is_refused_where_a_loop_is_many() -> None:
    loops = HapticLoop(device_mass=[0.1, 0.2], device_damping=0.1, sample_time=1e-3)
    with pytest.raises(TypeError, match="one loop is needed"), working_precision(128):
        ball_triple(loops)


def test_long_windows_are_of_the_degree_that_they_have() -> None:
    truth = Loop.of(long_window(np.random.default_rng(7)))
    with working_precision(128):
        triple: Triple = ball_triple(truth.loop)
        assert triple.degree == len(truth.polynomial(1.0, 1.0)) - 1
    assert isinstance(truth.loop, jaxstab.HapticLoop)
