"""Devices whose motor, encoder and hand are at different places, against chains of masses.

The truth closes the hand in the equations of motion, M q'' + C q' + K q = p_motor u + p_hand f, as
mass, damping and stiffness at its place; jaxstab closes it in transfer functions.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from mpmath import mp

from jaxstab import (
    Device,
    Hand,
    HandRange,
    HapticLoop,
    Mode,
    Velocity,
    Verdict,
    build_guard,
)
from jaxstab.boxes.plant import Arms, HeldDevice
from tests.campaign import many
from tests.truth.march import Plant, difference_taps, low_pass_taps, march_of_plant

PERIOD = 1e-3
LOW_PASS = {"velocity": Velocity.low_pass(40.0)}
TWO_BODIES = Device.modes(
    [Mode(frequency=35.0, damping_ratio=0.05, modal_mass=8e-4, encoder=-1.0, handle=-1.0)],
    mass=8e-4,
    damping=2e-3,
)

Arm = tuple[float, float, float]  # mass, damping, stiffness


@dataclass(frozen=True)
class Chain:
    """Masses in a row, springs and dampers between them, a damper to the ground at the first.

    ``places`` are the masses with motor, encoder and hand.
    """

    masses: tuple[float, ...]
    springs: tuple[float, ...]
    dampers: tuple[float, ...]
    ground: float
    places: tuple[int, int, int]

    def matrices(self, arm: Arm = (0.0, 0.0, 0.0)) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """M, C and K, with an arm at the hand's place."""
        count = len(self.masses)
        mass, (damping, stiffness) = np.diag(self.masses), np.zeros((2, count, count))
        bond = np.array([[1.0, -1.0], [-1.0, 1.0]])
        for k, (spring, damper) in enumerate(zip(self.springs, self.dampers, strict=True)):
            stiffness[k : k + 2, k : k + 2] += spring * bond
            damping[k : k + 2, k : k + 2] += damper * bond
        damping[0, 0] += self.ground
        for matrix, value in zip((mass, damping, stiffness), arm, strict=True):
            matrix[self.places[2], self.places[2]] += value
        return mass, damping, stiffness

    def system(self, arm: Arm = (0.0, 0.0, 0.0)) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A, B of motor and hand, C of encoder and handle."""
        mass, damping, stiffness = self.matrices(arm)
        count = len(self.masses)
        motor, encoder, hand = np.eye(count)[list(self.places)]
        nothing = np.zeros((count, count))
        pulls = -np.linalg.solve(mass, np.hstack([stiffness, damping]))
        a = np.vstack([np.hstack([nothing, np.eye(count)]), pulls])
        forces = np.linalg.solve(mass, np.stack([motor, hand], axis=1))
        shown = np.stack([encoder, hand])
        return a, np.vstack([np.zeros((count, 2)), forces]), np.hstack([shown, 0.0 * shown])

    @property
    def device(self) -> Device:
        return Device.state_space(*self.system())

    def radius(self, arm: Arm, wall: tuple[float, float], samples: int) -> float:
        """The largest modulus of the closed loop's eigenvalues, of 40 digits.

        The states are those of the chain, the position before, the velocity's estimate and the
        forces that wait; the estimate is a difference behind a low pass of 40 Hz.
        """
        with mp.workdps(40):
            a, b, c = (mp.matrix(part.tolist()) for part in self.system(arm))
            order = a.rows
            rates = mp.zeros(order + 1)
            rates[:order, :order], rates[:order, order] = a, b[:, 0]
            moved = mp.expm(rates * mp.mpf(PERIOD))
            q = mp.exp(-2 * mp.pi * 40 * mp.mpf(PERIOD))
            size = order + 2 + samples
            loop = mp.zeros(size)
            estimate = [(1 - q) / PERIOD * c[0, k] for k in range(order)]  # of the state, ...
            estimate += [-(1 - q) / PERIOD, q]  # ... the position before and the estimate before
            force = [-wall[1] * value for value in estimate] + [mp.mpf(0)] * samples
            for k in range(order):
                force[k] -= wall[0] * c[0, k]
            acting = force if samples == 0 else [mp.mpf(k == size - 1) for k in range(size)]
            for row in range(order):
                for k in range(size):
                    held = moved[row, order] * acting[k]
                    loop[row, k] = (moved[row, k] if k < order else 0) + held
            for k in range(order):
                loop[order, k] = c[0, k]
            for k, value in enumerate(estimate):
                loop[order + 1, k] = value
            if samples:
                for k in range(size):
                    loop[order + 2, k] = force[k]
                for late in range(1, samples):
                    loop[order + 2 + late, order + 1 + late] = mp.mpf(1)
            return float(max(map(abs, mp.eig(loop, left=False, right=False))))


def loop_of(device: Device, samples: float) -> HapticLoop:
    return HapticLoop(device=device, sample_time=PERIOD, delay=samples * PERIOD, **LOW_PASS)


def held(device: Device, arm: Arm) -> Device:
    mass, damping, stiffness = arm
    return device.held_by(Hand.mass_spring_damper(mass, damping=damping, stiffness=stiffness))


def drawn(rng: np.random.Generator) -> Chain:
    count = int(rng.integers(2, 4))
    masses = tuple(10.0 ** rng.uniform(-4.0, -3.0, count))
    springs = tuple(10.0 ** rng.uniform(0.5, 2.0, count - 1))
    dampers = tuple(10.0 ** rng.uniform(-4.0, -2.5, count - 1))
    places = tuple(int(p) for p in rng.integers(0, count, 3))
    return Chain(masses, springs, dampers, 10.0 ** rng.uniform(-4.0, -2.0), places)  # type: ignore[arg-type]


# ------------------------------------------------------------------------------------------ truths
@pytest.mark.parametrize(
    ("arm", "damping", "limit"),
    [
        ((0.0, 0.005, 0.0), 0.005, 5.47986815848),
        ((0.0, 0.02, 2.0), 0.005, 7.46745411402),
        ((0.0, 0.02, 2.0), 0.015, 8.15711954181),
        ((1e-4, 0.02, 2.0), 0.005, 7.74234066372),
    ],
)
def test_a_mode_of_two_bodies_has_its_hand_where_it_is(
    arm: Arm, damping: float, limit: float
) -> None:
    loop = loop_of(held(TWO_BODIES, arm), 1.0)
    assert loop.stiffness_intervals(damping).intervals[0].high.value == pytest.approx(
        limit, rel=1e-11
    )


def test_the_wall_that_was_called_stable_with_the_hand_at_the_motor_is_not() -> None:
    loop = loop_of(held(TWO_BODIES, (0.0, 0.005, 0.0)), 1.0)
    assert float(loop.spectral_radius(6.0, 0.005).value) == pytest.approx(
        1.00134548778654, abs=1e-14
    )
    assert loop.verdict(6.0, 0.005) == Verdict.UNSTABLE


@pytest.mark.parametrize(
    ("places", "arm", "samples", "low", "high"),
    [
        ((0, 0, 2), "light", 1.0, 0.0, 11.4648821180),
        ((0, 1, 2), "light", 1.0, 0.0, 11.5021084068),
        ((0, 2, 2), "light", 1.0, 0.0, 3.70498004712),
        ((0, 0, 0), "light", 1.0, 0.0, 8.02354386719),
        ((0, 2, 0), "light", 1.0, 0.0, 4.40397424437),
        ((0, 1, 1), "light", 1.0, 0.0, 6.15852842000),
        ((0, 0, 2), "heavy", 1.5, -1.27659574468, 9.98627059489),
        ((0, 1, 2), "heavy", 1.5, -1.42857142857, 9.31284678597),
        ((0, 2, 2), "heavy", 1.5, -2.0, 3.69936350684),
        ((0, 0, 0), "heavy", 1.5, -2.0, 15.0166916963),
        ((0, 2, 0), "heavy", 1.5, -2.0, 4.46734425527),
        ((0, 1, 1), "heavy", 1.5, -2.0, 8.55250493239),
    ],
)
def test_limits_of_a_chain_with_its_ports_at_all_places(
    places: tuple[int, int, int], arm: str, samples: float, low: float, high: float
) -> None:
    chain = Chain((4e-4, 3e-4, 2e-4), (12.0, 5.0), (2e-3, 1e-3), 2e-3, places)
    hand = {"light": (0.0, 0.005, 0.0), "heavy": (5e-5, 0.02, 2.0)}[arm]
    interval = loop_of(held(chain.device, hand), samples).stiffness_intervals(0.005).intervals[0]
    assert interval.high.value == pytest.approx(high, rel=1e-10)
    assert interval.low.value == pytest.approx(low, rel=1e-10, abs=1e-12)


def check_a_chain(seed: int) -> None:
    """Both sides of each end of a row, and of its middles, by eigenvalues of 40 digits."""
    rng = np.random.default_rng([20261127, seed])
    chain = drawn(rng)
    arm = tuple(float(x) for x in 10.0 ** rng.uniform([-5, -3, -1], [-3, -1, 1]))
    arm = tuple(x * (rng.random() < 0.7) for x in arm)
    samples = int(rng.integers(0, 3))
    loop = loop_of(held(chain.device, arm), float(samples))  # type: ignore[arg-type]
    damping = float(10.0 ** rng.uniform(-3.5, -1.5))
    line = loop.stiffness_intervals(damping)
    ends = [end.value for pair in line.intervals for end in pair if np.isfinite(end.value)]
    for end in ends:
        aside = 1e-6 * max(abs(end), 1e-3)  # a free chain's matrices are rounded
        for stiffness in (end - aside, end + aside):
            radius = chain.radius(arm, (stiffness, damping), samples)  # type: ignore[arg-type]
            assert (line.holding(stiffness) is not None) == (radius < 1.0), (seed, stiffness)
    wall = float(10.0 ** rng.uniform(-1, 2)), damping
    radius = chain.radius(arm, wall, samples)  # type: ignore[arg-type]
    assert float(loop.spectral_radius(*wall).value) == pytest.approx(radius, rel=1e-12), seed


@pytest.mark.parametrize("seed", range(6))
def test_random_chains_against_matrix_exponentials(seed: int) -> None:
    check_a_chain(seed)


@pytest.mark.campaign
def test_many_random_chains_against_matrix_exponentials() -> None:
    for seed in range(6, 6 + many(500, small=20)):
        check_a_chain(seed)


def test_modes_with_shapes_are_the_chain_that_they_are_the_modes_of() -> None:
    """Modal masses and shapes by the eigenvectors of M and K, damping in proportion to K."""
    chain = Chain((4e-4, 3e-4, 2e-4), (12.0, 5.0), (1.2e-3, 5e-4), 0.0, (0, 1, 2))
    mass, _, stiffness = chain.matrices()
    squares, vectors = scipy.linalg.eigh(stiffness, mass)
    modes = [
        Mode(
            frequency=np.sqrt(square) / (2.0 * np.pi),
            damping_ratio=0.5e-4 * np.sqrt(square),
            modal_mass=1.0,
            **dict(zip(("motor", "encoder", "handle"), vector, strict=True)),
        )
        for square, vector in zip(squares[1:], vectors.T[1:], strict=True)
    ]
    shapes = Device.modes(modes, mass=float(np.sum(chain.masses)))
    for arm in ((0.0, 0.0, 0.0), (5e-5, 0.02, 2.0)):
        rows = [
            loop_of(held(device, arm), 1.0).stiffness_intervals(0.005).intervals
            for device in (shapes, chain.device)
        ]
        ends = np.array([[end.value for pair in row for end in pair] for row in rows])
        np.testing.assert_allclose(ends[0], ends[1], rtol=1e-9, atol=1e-9)


# ---------------------------------------------------------------------------------- what it is for
@pytest.mark.parametrize("places", [(0, 1, 2), (0, 2, 0), (1, 0, 0), (0, 0, 2)])
@pytest.mark.parametrize("samples", [1.0, 1.4])
def test_the_simulated_chain_moves_as_its_equations_say(
    places: tuple[int, int, int], samples: float
) -> None:
    chain = Chain((4e-4, 3e-4, 2e-4), (12.0, 5.0), (2e-3, 1e-3), 2e-3, places)
    arm = (5e-5, 0.02, 2.0)
    a, b, c = chain.system(arm)
    plant = Plant(a * PERIOD, b[:, 0] * PERIOD, b[:, 1] * PERIOD, c[0])
    loop = loop_of(held(chain.device, arm), samples)
    wall = 2.0, 0.005
    found = loop.simulate(*wall, samples=300, force=0.02)
    states, forces = march_of_plant(
        plant, samples, (wall[0], wall[1] / PERIOD), [difference_taps(1), low_pass_taps(0.04)], [],
        300, push=0.02, start=np.zeros(len(a)),
    )  # fmt: skip
    size = np.abs(states @ c[0]).max()
    np.testing.assert_allclose(found.position, states @ c[0], rtol=0, atol=1e-9 * size)
    np.testing.assert_allclose(found.force, forces, rtol=0, atol=1e-9 * np.abs(forces).max())


def test_settling_and_amplitude_are_those_of_the_push_at_the_handle() -> None:
    chain = Chain((4e-4, 3e-4, 2e-4), (12.0, 5.0), (2e-3, 1e-3), 2e-3, (0, 1, 2))
    arm, wall = (5e-5, 0.02, 2.0), (2.0, 0.01)
    loop = loop_of(held(chain.device, arm), 1.0)
    a, b, c = chain.system(arm)
    plant = Plant(a * PERIOD, b[:, 0] * PERIOD, b[:, 1] * PERIOD, c[0])
    states, _ = march_of_plant(
        plant, 1.0, (wall[0], wall[1] / PERIOD), [difference_taps(1), low_pass_taps(0.04)], [],
        6000, push=1.0, start=np.zeros(len(a)),
    )  # fmt: skip
    position = states @ c[0]
    final = position[-1]
    since = np.flatnonzero(np.abs(position - final) > 0.02 * abs(final))[-1] + 1
    assert float(loop.settling_time(*wall).value) == pytest.approx(since * PERIOD)
    signs = np.sign(np.random.default_rng(1).uniform(-1.0, 1.0, (6000,)))
    error = 1e-4 * signs  # of the read position: what it does is less than the bound
    bound = float(loop.amplitude(*wall, encoder=2e-4).position)
    moved = _disturbed(chain, arm, wall, error)
    assert 0.05 * bound < np.abs(moved).max() <= bound


def _disturbed(chain: Chain, arm: Arm, wall: tuple[float, float], error: np.ndarray) -> np.ndarray:
    """The encoder's position while it is read with an error, one sample late."""
    a, b, c = chain.system(arm)
    rates = np.zeros((len(a) + 1,) * 2)
    rates[:-1] = np.column_stack([a, b[:, 0]]) * PERIOD
    moved = scipy.linalg.expm(rates)[:-1]
    q = np.exp(-2.0 * np.pi * 40.0 * PERIOD)
    state, before, estimate, acting, shown = np.zeros(len(a)), 0.0, 0.0, 0.0, []
    for wrong in error:
        shown.append(c[0] @ state)
        read = shown[-1] + wrong
        estimate = q * estimate + (1.0 - q) * (read - before) / PERIOD
        before = read
        state = moved @ np.append(state, acting)
        acting = -(wall[0] * read + wall[1] * estimate)
    return np.array(shown)


@pytest.mark.parametrize("hand", [(0.0, 0.003, 0.0), (1e-4, 0.003, 5.0)])
def test_boxes_have_the_plant_of_the_chain(hand: Arm) -> None:
    """N/D at the handle's arm, and its bound at high frequencies, by C (s - A)^-1 B."""
    chain = Chain((4e-4, 3e-4, 2e-4), (12.0, 5.0), (2e-3, 1e-3), 2e-3, (0, 1, 2))
    a, b, c = chain.system(hand)
    plants = [HeldDevice.from_device(chain.device, PERIOD)]
    arms = Arms(hand[0], hand[2] * PERIOD**2, hand[1] * PERIOD)
    for plant in plants:
        most = plant.largest_compliance((1.0, 1.0), (arms.stiffness, arms.damping), 2.0)
        for w in (0.01, 0.3, 2.0, 5.0, 40.0):
            truth = c[0] @ np.linalg.solve(1j * w / PERIOD * np.eye(len(a)) - a, b[:, 0])
            above, below = plant.parts(1j * w, 1.0, arms)
            assert above / below == pytest.approx(truth / PERIOD**2, rel=1e-9)
            assert w < 2.0 or w**2 * abs(above / below) <= most


def test_all_hands_of_a_range_are_proved_where_they_are() -> None:
    """The wall that most hands allow is stable for all of them, a stiffer one is not."""
    loop = loop_of(TWO_BODIES, 1.0)
    hands = HandRange(mass=(0.0, 1e-4), stiffness=(0.0, 2.0), damping=(0.005, 0.02))
    limit = loop.robust_limit(hands=hands)
    assert limit.is_proved
    tried = [(m, b, k) for m in (0.0, 1e-4) for b in (0.005, 0.02) for k in (0.0, 2.0)]
    rows = [
        loop_of(held(TWO_BODIES, arm), 1.0).stiffness_intervals(limit.damping).intervals[0].high
        for arm in tried
    ]
    least = min(row.value for row in rows)
    assert 0.95 * least < limit.stiffness <= least
    worst = loop.worst_hand(hands, 1.01 * least, limit.damping)
    assert worst.verdict == Verdict.UNSTABLE


@pytest.mark.campaign
def test_a_guard_holds_for_masses_of_a_device_with_shapes() -> None:
    loop = loop_of(TWO_BODIES, 1.0)
    hands = HandRange(damping=(0.005, 0.02), stiffness=(0.0, 2.0))
    guard = build_guard(loop, hands, mass=(7.5e-4, 8.5e-4), delay=(1e-3, 1.1e-3), cells=(2, 1, 8))
    rng = np.random.default_rng(3)
    for _ in range(200):
        mass, delay = rng.uniform(7.5e-4, 8.5e-4), rng.uniform(1e-3, 1.1e-3)
        arm = 0.0, float(rng.uniform(0.005, 0.02)), float(rng.uniform(0.0, 2.0))
        damping = float(rng.uniform(0.0, float(guard.grid.top.max())))
        body: Any = TWO_BODIES.mechanism
        device = held(replace(TWO_BODIES, mechanism=replace(body, mass=float(mass))), arm)
        granted = guard.largest_stiffness(damping, mass=float(mass))
        if granted > 0.0:
            assert (
                loop_of(device, float(delay) / PERIOD).verdict(granted, damping) == Verdict.STABLE
            )


# --------------------------------------------------------------------------------------- bad input
@pytest.mark.parametrize("shapes", [(0.0, 1.0), (1.0, 0.0), (0.0, 0.0), (1.0, 1.0)])
@pytest.mark.parametrize("damping", [-0.05, 0.0, 1e-3])
def test_what_no_wall_damps_and_does_not_decay_is_refused(
    shapes: tuple[float, float], damping: float
) -> None:
    """A wall of 500 N/m, 5 N s/m a sample late, and a mode that is hidden where a shape is 0.

    The mode of negative damping is a state space, and a damped mode that an active hand holds.
    """
    (motor, encoder), w = shapes, 2.0 * np.pi * 40.0
    a = np.array([[0, 1, 0, 0], [0, -2, 0, 0], [0, 0, 0, 1], [0, 0, -(w**2), -2 * damping * w]])
    b, c = np.array([0.0, 4.0, 0.0, 5.0 * motor]), np.array([1.0, 0.0, encoder, 0.0])
    held = scipy.linalg.expm(PERIOD * np.block([[a, b[:, None]], [np.zeros((1, 5))]]))[:4]
    seen, rate = np.append(c, [0.0, 0.0]), 5.0 / PERIOD  # of the states, the force, the last x
    force = rate * np.eye(6)[5] - (500.0 + rate) * seen
    radius = max(abs(np.linalg.eigvals([*held @ np.eye(5, 6), force, seen])))
    mode = Mode(
        frequency=40.0, damping_ratio=abs(damping), modal_mass=0.2, motor=motor, encoder=encoder
    )
    devices = [lambda: Device.state_space(a, b, c)]
    if damping >= 0.0:
        devices.append(lambda: Device.modes([mode], mass=0.25, damping=0.5))
    for device in devices:
        if 0.0 in shapes and damping <= 0.0:
            assert radius > 1.0 - 1e-12
            with pytest.raises(ValueError, match="does not decay by itself and that no wall damps"):
                device()
        else:
            wall = HapticLoop(device=device(), sample_time=PERIOD, delay=PERIOD)
            assert wall.verdict(500.0, 5.0) == (Verdict.STABLE if radius < 1 else Verdict.UNSTABLE)


def test_a_hand_that_makes_grow_what_no_wall_damps_is_refused() -> None:
    """The hand acts on a mode of its own: 0.2 (s^2 + 3.77 s + w^2) - 5 s grows."""
    modes = [
        Mode(frequency=40.0, damping_ratio=0.01, modal_mass=0.2, handle=0.0),
        Mode(frequency=30.0, damping_ratio=0.01, modal_mass=0.2, motor=0.0, encoder=0.0),
    ]
    with pytest.raises(ValueError, match="does not decay by itself"):
        Device.modes(modes).held_by(Hand.transfer_function([-5.0, 0.0], [1.0]))
    Device.modes(modes).held_by(Hand.transfer_function([-0.7, 0.0], [1.0]))


def test_a_handle_with_a_negative_mass_is_refused() -> None:
    """Signs of a port that do not fit: a force at the handle moves it backwards."""
    chain = Chain((4e-4, 3e-4), (12.0,), (2e-3,), 2e-3, (0, 0, 1))
    a, b, c = chain.system()
    device = Device.state_space(a, b * [1.0, -1.0], c)
    with pytest.raises(ValueError, match="as a negative mass would"):
        held(device, (1e-3, 0.0, 0.0))


@pytest.mark.parametrize(
    ("b", "c"),
    [([[0.0, 0.0], [1.0, 1.0]], [[1.0, 0.0]]), ([[0.0] * 3, [1.0] * 3], [[1.0, 0.0]] * 3)],
)
def test_ports_that_do_not_fit_are_named(b: Any, c: Any) -> None:
    with pytest.raises(ValueError, match=r"have shapes .* of the hand B is of \(n, 2\)"):
        Device.state_space([[0.0, 1.0], [0.0, -1.0]], b, c)
