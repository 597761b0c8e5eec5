"""General devices: coefficients within their bounds, verdicts, radii, what devices may be.

The truth: equations of motion in mpmath (``tests.truth.devices``) and certified roots.
"""

import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import control
import flint
import numpy as np
import pytest
import scipy.linalg
import scipy.signal
from mpmath import mpf

import jaxstab
from jaxstab import Device, Filter, Hand, Mode, Velocity, Verdict
from jaxstab.model import by_name
from jaxstab.model.device.sampling import gain_units
from jaxstab.point.poles import linear_poles
from jaxstab.point.radius import linear_spectral_radius
from jaxstab.point.verdicts import linear_verdict
from tests.truth import devices as truth
from tests.truth import filtered
from tests.truth.random_loops import device_of

MODE = Mode(frequency=80.0, damping_ratio=0.01, modal_mass=0.5)
ARM = Hand.mass_spring_damper(mass=1.0, damping=5.0, stiffness=300.0)
FILTERS = Velocity.difference(samples=4), Filter.low_pass(200.0)
TRUE_FILTERS = filtered.difference(4), filtered.low_pass(0.2, order=1)


def loop_of(
    device: Device,
    sample_time: float,
    delay_samples: float,
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> jaxstab.HapticLoop:
    return jaxstab.HapticLoop(
        device=device,
        sample_time=sample_time,
        delay=delay_samples * sample_time,
        velocity=velocity,
        position=position,
    )


@pytest.mark.parametrize("seed", range(6))
def test_verdicts_and_radii_against_certified_roots(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    drawn = truth.drawn(rng)
    loop = loop_of(device_of(drawn), drawn.sample_time, drawn.delay, *FILTERS)
    system = drawn.mechanism.system()
    period = drawn.sample_time
    # Butterworth's and low passes are given in Hz: those of the truth belong to a period of 1.
    position = filtered.low_pass(200.0 * period, order=1)
    true = truth.DeviceLoop(system, period, drawn.delay, filtered.difference(4), position)
    walls = rng.uniform(-0.02, 0.2, 8), rng.uniform(-0.02, 0.4, 8)
    stiffness, damping = loop.stiffness(walls[0]), loop.damping(walls[1])
    codes = linear_verdict(*walls, loop.linear)
    expected = [true.code(*wall) for wall in zip(stiffness, damping, strict=True)]
    assert codes.tolist() == expected
    radius = linear_spectral_radius(*walls, loop.linear)
    poles = linear_poles(*walls, loop.linear)
    np.testing.assert_allclose(np.abs(poles[:, 0]), radius.value, 1e-3)
    for k, wall in enumerate(zip(stiffness, damping, strict=True)):
        assert abs(true.radius(*wall) - float(radius.value[k])) <= float(radius.error[k])


def test_a_mass_has_the_verdicts_of_five_numbers() -> None:
    period, mass = 2.0**-10, 0.25  # powers of two: the gains are the same numbers
    hand = Hand.mass_spring_damper(mass=0.75, damping=4.0, stiffness=512.0)
    device = Device.mass_spring_damper(mass, damping=2.0).held_by(hand)
    rng = np.random.default_rng(1)
    for delay in (0.0, 0.5, 3.0, 7.25):
        loop = loop_of(device, period, delay)
        slice_ = 512.0 * period**2, 6.0 * period, delay
        alpha, beta = rng.uniform(-0.01, 0.4, 2000), rng.uniform(-0.1, 0.9, 2000)
        codes = linear_verdict(alpha, beta, loop.linear)  # of a mass of 1 kg
        np.testing.assert_array_equal(codes, jaxstab.verdict(alpha, beta, **by_name(*slice_)))
        assert {Verdict.STABLE, Verdict.UNSTABLE} <= set(codes.tolist())


def largest_stable(device: Device, damping: float = 4.0) -> float:
    """The largest stiffness, by bisection from 0."""
    loop = loop_of(device, 1e-3, 1.0)
    linear, beta = loop.linear, loop.beta(damping)
    low, high = 1.0, 1e6
    for _ in range(60):
        middle = np.sqrt(low * high)
        is_stable = linear_verdict(loop.alpha(middle), beta, linear) == Verdict.STABLE
        low, high = (middle, high) if is_stable else (low, middle)
    return low


@pytest.mark.campaign
def test_a_stiff_grip_is_a_glued_hand_and_a_fast_actuator_is_none() -> None:
    device = Device.mass_spring_damper(0.25, damping=0.1)
    glued, free = largest_stable(device.held_by(ARM)), largest_stable(device)
    grips = [
        largest_stable(device.held_by(ARM.with_grip(stiffness=10.0**k, damping=1e2)))
        for k in (6, 8, 10)
    ]
    errors = [abs(stiffness / glued - 1.0) for stiffness in grips]
    assert errors[2] < 2e-4
    assert errors[2] < errors[0]
    motors = [largest_stable(device.with_actuator(10.0**k)) for k in (2, 4, 6)]
    errors = [abs(stiffness / free - 1.0) for stiffness in motors]
    assert errors[0] > 0.05
    assert errors[2] < 2e-4


def test_units_are_exact_and_near_the_size_of_the_plant() -> None:
    for mass in (1e-3, 0.1, 30.0):
        units = gain_units(Device.mass_spring_damper(mass), 1e-3, 0.0)
        assert 0.25 < units[0] / (1e-6 / mass) < 4.0
        assert 0.1 < units[1] / (1e-3 / mass) < 8.0
        assert (np.log2(units) % 1.0 == 0.0).all()


# ---------------------------------------------------------------------------- what a device is


def response(device: Device, frequency: float) -> complex:
    """Position over force by the poles and the static value or, for a free mass, by scipy."""
    function = device.compliance()
    s = 2j * np.pi * frequency
    above, below = (
        sum(float(c.str(30, radius=False)) * s**k for k, c in enumerate(polynomial))
        for polynomial in map(coefficients, function)
    )
    return complex(above / below)


def coefficients(polynomial: Any) -> list[Any]:
    from jaxstab.model.device.parts import balls_of

    return balls_of(polynomial)


def test_devices_respond_as_the_formulas_say() -> None:
    s = 2j * np.pi * 30.0
    w = 2.0 * np.pi * 80.0
    bare = 1.0 / (0.25 * s**2 + 0.1 * s) + 1.0 / (0.5 * (s**2 + 0.02 * w * s + w**2))
    arm, grip, motor = s**2 + 5.0 * s + 300.0, 2000.0 + 4.0 * s, 1.0 / (1.0 + s / (400.0 * np.pi))
    device = Device.modes([MODE], mass=0.25, damping=0.1)
    for one, expected in (
        (device, bare),
        (device.held_by(ARM), bare / (1.0 + bare * arm)),
        (
            device.held_by(ARM.with_grip(stiffness=2000.0, damping=4.0)),
            bare / (1.0 + bare / (1 / arm + 1 / grip)),
        ),
        (device.with_actuator(200.0), motor * bare),
        (device.with_actuator(200.0).held_by(ARM), motor * bare / (1.0 + bare * arm)),
        (device.held_by(Hand.transfer_function([1.0, 5.0, 300.0], [1.0])), bare / (1 + bare * arm)),
        (Device.modes([MODE]), bare - 1.0 / (0.25 * s**2 + 0.1 * s)),
    ):
        assert response(one, 30.0) == pytest.approx(expected, rel=1e-12)
    assert device.with_actuator(200.0).held_by(ARM) == device.held_by(ARM).with_actuator(200.0) or (
        device.with_actuator(200.0).held_by(ARM).compliance()
        == device.held_by(ARM).with_actuator(200.0).compliance()
    )


def test_state_spaces_that_are_not_minimal_are_reduced() -> None:
    minimal = Device.mass_spring_damper(0.5, damping=2.0, stiffness=8.0)
    a, b, c = [[0.0, 1.0], [-16.0, -4.0]], [0.0, 2.0], [1.0, 0.0]
    assert Device.state_space(a, b, c).compliance() == minimal.compliance()
    hidden = np.zeros((3, 3))
    hidden[:2, :2], hidden[2, 2] = a, -7.0
    moved, shown = Device.state_space(hidden, [*b, 1.0], [*c, 0.0]), [*c, 1.0]
    assert moved.compliance() == minimal.compliance()
    assert Device.state_space(hidden, [*b, 0.0], shown).compliance() == minimal.compliance()
    hidden[2, 2] = 7.0
    with pytest.raises(ValueError, match="does not decay by itself"):
        Device.state_space(hidden, [*b, 1.0], [*c, 0.0])
    assert Device.state_space(hidden, [*b, 1.0], shown).stability == "unstable"


def test_what_a_device_does_without_a_wall_is_said() -> None:
    assert Device.mass_spring_damper(1.0).stability == "marginal"
    assert Device.mass_spring_damper(1.0, damping=1.0).stability == "marginal"
    assert Device.mass_spring_damper(1.0, damping=1.0, stiffness=1.0).stability == "stable"
    assert Device.mass_spring_damper(1.0).held_by(ARM).stability == "stable"
    assert Device.transfer_function([1.0], [1.0, 0.0, -9.0]).stability == "unstable"
    undamped = Mode(frequency=3.0, damping_ratio=0.0, modal_mass=1.0)
    assert Device.modes([undamped]).stability == "marginal"
    poles = Device.modes([MODE], mass=1.0, damping=2.0).poles()
    w = 2.0 * np.pi * 80.0
    expected = [0.0, w * (-0.01 + 1j * np.sqrt(1 - 1e-4)), w * (-0.01 - 1j * np.sqrt(1 - 1e-4)), -2]
    assert len(poles) == 4
    for pole in expected:
        assert np.min(np.abs(poles - pole)) <= 1e-12 * w


@pytest.mark.parametrize(
    "system",
    [
        control.tf([2.0], [1.0, 4.0, 16.0]),
        control.ss([[0.0, 1.0], [-16.0, -4.0]], [[0.0], [2.0]], [[1.0, 0.0]], 0.0),
        scipy.signal.lti([2.0], [1.0, 4.0, 16.0]),
        scipy.signal.StateSpace([[0.0, 1.0], [-16.0, -4.0]], [[0.0], [2.0]], [[1.0, 0.0]], 0.0),
    ],
)
def test_systems_of_control_and_scipy_are_taken(system: Any) -> None:
    expected = Device.mass_spring_damper(0.5, damping=2.0, stiffness=8.0)
    assert Device.from_control(system).compliance() == expected.compliance()


def test_zeros_and_poles_of_scipy_are_taken() -> None:
    system = scipy.signal.lti([-3.0], [-1.0, -2.0, -5.0], 0.5)
    assert response(Device.from_control(system), 0.7) == pytest.approx(
        scipy.signal.freqresp(system, [1.4 * np.pi])[1][0], rel=1e-12
    )


def test_devices_and_hands_are_values_that_print_themselves() -> None:
    device = Device.mass_spring_damper(0.25, damping=0.1).with_actuator(200.0)
    held = device.held_by(ARM.with_grip(stiffness=2000.0, damping=4.0))
    assert held == device.held_by(ARM.with_grip(stiffness=2000.0, damping=4.0))
    assert len({held, device, device}) == 2
    assert str(held) == (
        "0.25 kg, 0.1 N s/m; an actuator of 200 Hz; "
        "a hand of 1 kg, 5 N s/m, 300 N/m behind a grip of 4 N s/m, 2000 N/m"
    )
    assert str(Device.modes([MODE], mass=0.25)) == "0.25 kg with modes at 80 Hz"


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: Device.mass_spring_damper(0.0), "mass is 0.0"),
        (lambda: Device.mass_spring_damper(1.0, damping=np.nan), "damping is nan"),
        (lambda: Device.transfer_function([1.0, 0.0], [1.0, 2.0]), "not in z"),
        (lambda: Device.transfer_function([0.0], [1.0, 2.0]), "not all of them 0"),
        (lambda: Device.transfer_function([1.0], [0.0, 0.0]), "denominator is"),
        (lambda: Device.transfer_function([np.inf], [1.0, 2.0]), "numerator is inf"),
        (lambda: Device.transfer_function([1.0], [1.0] * 42), "40 at most"),
        (lambda: Device.state_space(np.eye(2), [1.0], [1.0, 0.0]), "B and C have shapes"),
        (lambda: Device.state_space([[0.0]], [1.0], [0.0]), "transfer function 0"),
        (lambda: Device.modes([]), "give at least one"),
        (lambda: Device.modes([MODE], damping=1.0), "give mass, too"),
        (lambda: Mode(frequency=1.0, damping_ratio=0.1, modal_mass=0.0), "modal_mass is 0.0"),
        (lambda: Mode(frequency=0.0, damping_ratio=0.1, modal_mass=1.0), "frequency is 0.0"),
        (lambda: Hand.transfer_function([1.0, 0.0, 0.0, 0.0], [1.0]), "two degrees"),
        (lambda: ARM.with_grip(stiffness=0.0), "holds something"),
        (lambda: ARM.with_grip(stiffness=1.0).with_grip(stiffness=1.0), "has a grip"),
        (lambda: Device.mass_spring_damper(1.0).with_actuator(0.0), "bandwidth is 0.0"),
        (lambda: Device.from_control(control.tf([1.0], [1.0, 2.0], True)), "dt = True"),
        (lambda: Device.from_control(scipy.signal.lti([1.0, 0.0], [1.0, 2.0])), "not in z"),
        (
            lambda: gain_units(
                Device.mass_spring_damper(1.0, damping=0.0, stiffness=1e280), 1e-3, 0.0
            ),
            "a pole",
        ),
        (lambda: gain_units(Device.mass_spring_damper(1e280), 1e-3, 0.0), "give SI units"),
        (lambda: gain_units(Device.transfer_function([1], [1, -1e3]), 1.0, 0.0), "unstable"),
    ],
)
def test_bad_input_is_refused_in_one_sentence(call: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words) as refusal:
        call()
    assert "\n" not in str(refusal.value)


def radius_with_a_hand(acts: float, moves: float) -> float:
    """The radius of two masses of 8e-4 kg m^2 and a wall (6, 0.005), from matrices of this test.

    Motor at x0 + x1, encoder at x0 - x1, 35 Hz; one sample of delay of 1 ms, a pole-matched low
    pass of 40 Hz, and a hand of 0.005 N m s/rad that moves with x0 + ``moves`` x1 and whose torque
    is at x0 + ``acts`` x1.
    """
    moved, damping, hand, (k, b), period = 8e-4, 2e-3, 0.005, (6.0, 0.005), 1e-3
    w = 2.0 * np.pi * 35.0
    brake = np.diag([damping, 0.1 * w * moved]) + hand * np.outer([1.0, acts], [1.0, moves])
    rates = np.zeros((5, 5))  # x0, x1, their speeds, and the torque that is held
    rates[0:2, 2:4], rates[3, 1] = np.eye(2), -(w**2)
    rates[2:4, 2:4], rates[2:4, 4] = -brake / moved, 1.0 / moved
    flow, pole = scipy.linalg.expm(rates * period), np.exp(-2.0 * np.pi * 40.0 * period)
    encoder = np.array([1.0, -1.0, 0.0, 0.0])
    step = np.zeros((7, 7))  # the four, the torque of the sample before, x before, the low pass
    step[:4, :4], step[:4, 4] = flow[:4, :4], flow[:4, 4]
    speed = np.concatenate([encoder, np.zeros(3)]) * (1.0 - pole) / period
    speed[5:] -= (1.0 - pole) / period, -pole
    step[4] = -b * speed
    step[4, :4] -= k * encoder
    step[5, :4], step[6] = encoder, speed
    return float(np.abs(np.linalg.eigvals(step)).max())


def test_a_hand_beside_a_mode_of_negative_mass_is_refused() -> None:
    """From encoder to motor it would calm a wall that it cannot calm at the link."""
    assert radius_with_a_hand(acts=1.0, moves=-1.0) < 1.0
    assert np.isclose(radius_with_a_hand(-1.0, -1.0), 1.001345488, rtol=0.0, atol=1e-9)
    mode = Mode(frequency=35.0, damping_ratio=0.05, modal_mass=-8e-4)
    free = Device.modes([mode], mass=8e-4, damping=2e-3)
    assert free.held_by(Hand.mass_spring_damper()).compliance() == free.compliance()  # no hand
    loop = jaxstab.HapticLoop(device=free, sample_time=1e-3)
    held = jaxstab.HandRange(damping=(0.0, 0.005))
    for call in (
        lambda: free.held_by(Hand.mass_spring_damper(damping=0.005)),
        lambda: free.held_by(ARM.with_grip(stiffness=2000.0)).with_actuator(200.0),
        lambda: loop.worst_hand(held, 6.0, 0.005),
        lambda: loop.robust_limit(held),
    ):
        with pytest.raises(ValueError, match=r"modal_mass is -0\.0008 beside a hand"):
            call()


def test_what_is_no_device_is_refused() -> None:
    with pytest.raises(TypeError, match="TransferFunction or StateSpace"):
        Device.from_control("device")
    with pytest.raises(TypeError, match="fitted to the data if they are a frequency response"):
        Device.from_control(control.frd([1.0, 0.5j], [1.0, 2.0]))
    with pytest.raises(TypeError, match="Hand"):
        Device.mass_spring_damper(1.0).held_by(1.0)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="Mode"):
        Device.modes([(1.0, 2.0, 3.0)])  # type: ignore[list-item]


@pytest.mark.campaign
def test_few_walls_are_undecided_next_to_the_boundary() -> None:
    device = Device.modes([MODE], mass=0.25, damping=0.1).held_by(
        ARM.with_grip(stiffness=2000.0, damping=4.0)
    )
    loop = loop_of(device, 1e-3, 1.5, *FILTERS)
    linear, beta = loop.linear, loop.beta(2.0)
    low, high = 0.0, 0.2
    for _ in range(60):
        middle = 0.5 * (low + high)
        is_stable = linear_verdict(middle, beta, linear) == Verdict.STABLE
        low, high = (middle, high) if is_stable else (low, middle)
    walls = low * (1.0 + np.array([-1e-9, -1e-11, 1e-11, 1e-9]))
    codes = linear_verdict(walls, beta, linear)
    assert Verdict.UNDECIDED not in codes
    mechanism = truth.Mechanism(
        [(mpf(0.25), mpf(0.1), mpf(0)), truth.mode(80.0, 0.01, 0.5)],
        [(1.0, 5.0, 300.0, (4.0, 2000.0))],
    )
    true = truth.DeviceLoop(mechanism.system(), 1e-3, 1.5, *TRUE_FILTERS)
    assert codes.tolist() == [true.code(loop.stiffness(wall), 2.0) for wall in walls]


@pytest.fixture
def hasty_threads() -> Iterator[None]:
    """Threads that take turns every ten microseconds."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    yield
    sys.setswitchinterval(before)


@pytest.mark.usefixtures("hasty_threads")
def test_threads_that_ask_devices_agree_and_restore_the_precision() -> None:
    """``flint.ctx.prec`` is afterwards what it was."""

    def poles_and_plant(frequency: float, order: int = 1) -> tuple[list[complex], Any]:
        modes = [Mode(frequency=f, damping_ratio=0.01, modal_mass=0.3) for f in (frequency, 90.0)]
        device = Device.modes(modes[::order], mass=0.2)
        return device.poles().tolist(), loop_of(device, 1e-3, 1.5).linear

    frequencies = np.linspace(30.0, 60.0, 64).tolist()
    with flint.ctx.workprec(77), ThreadPoolExecutor(8) as pool:
        before = flint.ctx.cap
        asked = list(pool.map(poles_and_plant, frequencies))
        pool.shutdown()
        assert (flint.ctx.prec, flint.ctx.cap) == (77, before)
    # The same device, which nothing remembers.
    assert asked == [poles_and_plant(frequency, order=-1) for frequency in frequencies]


def test_one_mode_needs_no_list() -> None:
    mode = Mode(frequency=100.0, damping_ratio=0.01, modal_mass=0.1)
    assert Device.modes(mode, mass=0.2) == Device.modes([mode], mass=0.2)
