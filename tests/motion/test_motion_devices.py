"""Motion of general devices, against equations of motion that scipy's exponential solves."""

from typing import Any

import jax
import numpy as np
import pytest
import scipy.linalg

import jaxstab
from jaxstab import Device, Filter, HapticLoop, Velocity
from jaxstab.model.device.mechanics import mechanics
from jaxstab.results import SettlingStatus
from tests.truth import devices
from tests.truth.march import Plant, Taps, arriving, difference_taps, low_pass_taps, march_of_plant
from tests.truth.random_loops import device_of

PERIOD = 1e-3
LONG = 3000  # samples

ARM = (1.0, 5.0, 300.0, (4.0, 2000.0))  # mass, damping, stiffness, grip
DRAWN: dict[str, devices.Drawn] = {
    "mass": devices.Drawn(0.25, 0.1, [], None, None, PERIOD, 1.0),
    "glued hand": devices.Drawn(0.25, 0.1, [], (1.0, 5.0, 300.0, None), None, PERIOD, 1.5),
    "mode": devices.Drawn(0.25, 0.1, [(80.0, 0.02, 0.5)], None, None, PERIOD, 0.0),
    "everything": devices.Drawn(0.25, 0.1, [(80.0, 0.02, 0.5)], ARM, 200.0, PERIOD, 1.25),
}
FILTERS: dict[str, tuple[dict[str, Any], list[Taps], list[Taps]]] = {
    "none": ({}, [difference_taps(1)], []),
    "window and low pass": (
        {"velocity": Velocity.difference(window=0.005), "position": Filter.low_pass(150.0)},
        [difference_taps(5)],
        [low_pass_taps(0.15)],
    ),
}
WALL = (300.0, 3.0)


def loop_of(drawn: devices.Drawn, filters: dict[str, Any]) -> HapticLoop:
    device, delay = device_of(drawn), drawn.delay * PERIOD
    return HapticLoop(device=device, sample_time=PERIOD, delay=delay, **filters)


def plant_of(drawn: devices.Drawn) -> Plant:
    """The equations of motion, the unit of time one sample."""
    whole = drawn.mechanism.system()
    handle = drawn._replace(bandwidth=None).mechanism.system()
    a, wall, c = (np.array(one.tolist(), float) for one in whole)
    hand = np.zeros(len(a))
    hand[: handle.b.rows] = np.array(handle.b.tolist(), float).ravel()
    return Plant(a * PERIOD, wall.ravel() * PERIOD, hand * PERIOD, c.ravel())


def settled_since(position: np.ndarray, final: float, band: float) -> int:
    return int(np.flatnonzero(np.abs(position - final) > band)[-1]) + 1


@pytest.mark.parametrize("unilateral", [False, True])
@pytest.mark.parametrize("filters", FILTERS)
@pytest.mark.parametrize("case", DRAWN)
def test_a_simulated_device_moves_as_its_equations_say(
    case: str, filters: str, unilateral: bool
) -> None:
    drawn, (given, velocity, position) = DRAWN[case], FILTERS[filters]
    plant, loop = plant_of(drawn), loop_of(drawn, given)
    found = loop.simulate(
        *WALL, samples=200, force=0.5, initial_velocity=-0.1, unilateral=unilateral
    )
    wall = WALL[0], WALL[1] / PERIOD
    states, forces = march_of_plant(
        plant, drawn.delay, wall, velocity, position, 200,
        push=0.5, start=-0.1 * arriving(drawn), unilateral=unilateral,
    )  # fmt: skip
    expected = states @ plant.c
    assert (expected < 0.0).any()
    np.testing.assert_allclose(found.position, expected, atol=1e-11 * np.abs(expected).max())
    np.testing.assert_allclose(found.force, forces, atol=1e-10 * np.abs(forces).max())
    speeds = states @ plant.a.T @ plant.c / PERIOD
    np.testing.assert_allclose(found.velocity, speeds, atol=1e-10 * np.abs(speeds).max())


Rows = list[tuple[np.ndarray, float, float, float]]


def random_structure(rng: np.random.Generator) -> tuple[Device, Rows, np.ndarray, np.ndarray]:
    """A device whose motor, encoder and handle may differ, held by up to three hands.

    Also what it is made of, each a direction in coordinates of body, modes and arms with the mass,
    damping and stiffness along it; the encoder's place, and which coordinates move as it arrives.
    """
    spots = np.array([0.0, 0.4, 1.0, -1.0])
    modes = [
        jaxstab.Mode(
            frequency=rng.choice([35.0, 80.0]), damping_ratio=rng.choice([1e-6, 0.02]),
            modal_mass=rng.choice([0.1, 0.4]), motor=rng.choice(spots), encoder=rng.choice(spots),
            handle=rng.choice(spots),
        )
        for _ in range(rng.integers(4))
    ]  # fmt: skip
    device = Device.modes(modes, mass=0.5, damping=0.2)
    arms, size = int(rng.integers(4)), 1 + len(modes)
    own = np.eye(size + arms)
    handle, encoder = (own[0] + sum(m * own[k] for k, m in enumerate(shape, 1)) for shape in (
        [mode.handle for mode in modes], [mode.encoder for mode in modes]
    ))  # fmt: skip
    parts = [(own[0], 0.5, 0.2, 0.0)]
    for row, mode in zip(own[1:], modes, strict=False):
        rate = 2.0 * np.pi * mode.frequency
        mass, ratio = mode.modal_mass, mode.damping_ratio
        parts.append((row, mass, 2.0 * ratio * rate * mass, rate**2 * mass))
    moving = own[0].copy()
    for place in own[size:]:
        arm = rng.uniform(0.1, 1.0), rng.choice([0.0, 4.0]), rng.choice([0.0, 300.0])
        hand = jaxstab.Hand.mass_spring_damper(arm[0], damping=arm[1], stiffness=arm[2])
        if rng.random() < 0.6:
            parts += [(place, *arm), (handle - place, 0.0, 3.0, 900.0)]
            device, moving = (
                device.held_by(hand.with_grip(stiffness=900.0, damping=3.0)),
                moving + place,
            )
        else:
            parts += [(handle, *arm), (place, 1.0, 0.0, 0.0)]  # the arm's coordinate is not used
            device = device.held_by(hand)
    return device, parts, encoder, moving


@pytest.mark.parametrize("case", range(12))
def test_all_masses_of_a_device_arrive_at_the_initial_velocity(case: int) -> None:
    """Without a wall; also where two modes are alike but for their shapes."""
    device, parts, encoder, moving = random_structure(np.random.default_rng(case))
    mass, damping, stiffness = (
        sum(part[k] * np.outer(part[0], part[0]) for part in parts) for k in (1, 2, 3)
    )
    size = len(moving)
    pulls = -np.linalg.solve(mass, np.hstack([stiffness, damping]))
    rates = np.vstack([np.eye(2 * size)[size:], pulls])
    start = np.concatenate([np.zeros(size), 0.3 * moving])
    found = HapticLoop(device=device, sample_time=PERIOD).simulate(
        0.0, 0.0, samples=100, initial_velocity=0.3
    )
    expected = [encoder @ (scipy.linalg.expm(rates * time) @ start)[:size] for time in found.time]
    np.testing.assert_allclose(found.position, expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("case", DRAWN)
def test_a_displaced_device_stood_where_it_starts(case: str) -> None:
    """Held there by the hand's force: without it the equations of motion are at rest."""
    drawn = DRAWN[case]
    plant, size = plant_of(drawn), len(plant_of(drawn).c)
    system = np.block([[plant.a, plant.hand[:, None]], [plant.c[None], np.zeros((1, 1))]])
    start = np.linalg.solve(system, np.array([*np.zeros(size), 2e-3]))[:-1]
    found = loop_of(drawn, {}).simulate(*WALL, samples=100, initial_position=2e-3)
    wall = WALL[0], WALL[1] / PERIOD
    states, _ = march_of_plant(plant, drawn.delay, wall, [difference_taps(1)], [], 100, start=start)
    np.testing.assert_allclose(found.position, states @ plant.c, atol=1e-12)


@pytest.mark.parametrize("filters", FILTERS)
@pytest.mark.parametrize("case", DRAWN)
def test_settling_of_a_device_is_that_of_its_equations(case: str, filters: str) -> None:
    drawn, (given, velocity, position) = DRAWN[case], FILTERS[filters]
    plant, loop = plant_of(drawn), loop_of(drawn, given)
    wall, size = (WALL[0], WALL[1] / PERIOD), len(plant.c)
    march: dict[str, Any] = {"velocity": velocity, "position": position, "samples": LONG}
    held = 300.0 if drawn.hand is not None and drawn.hand[3] is None else 0.0
    if drawn.hand is not None and drawn.hand[3] is not None:
        held = 1.0 / (1.0 / 300.0 + 1.0 / 2000.0)  # arm behind its grip
    if drawn.modes:  # of which the mode is a part
        body = np.linalg.solve(
            np.block([[plant.a, plant.hand[:, None]], [plant.c[None], np.zeros((1, 1))]]),
            np.array([*np.zeros(size), 1.0]),
        )
        assert body[-1] == pytest.approx(held, abs=1e-8)
    pushed, _ = march_of_plant(
        plant, drawn.delay, wall, push=WALL[0] + held, start=np.zeros(size), **march
    )
    hit, _ = march_of_plant(plant, drawn.delay, wall, start=arriving(drawn), **march)
    pushed, hit = pushed @ plant.c, hit @ plant.c
    assert abs(pushed[-1] - 1.0) < 1e-3
    expected = {
        "force": settled_since(pushed, 1.0, 0.02),
        "impact": settled_since(hit, 0.0, 0.02 * np.abs(hit).max()),
    }
    for excitation, samples in expected.items():
        found = loop.settling_time(*WALL, excitation=excitation)
        assert int(found.status) == SettlingStatus.SETTLED
        assert float(found.value) == pytest.approx(samples * PERIOD, rel=1e-15)


def struck(
    above: list[float], below: list[float], wall: tuple[float, float], window: int, samples: int
) -> np.ndarray:
    """Positions of a device (T = 1 ms) that stood at 0, after a unit blow that moves it at once.

    Below is monic, above has one degree less. The wall reads positions 0 before the blow.
    """
    order = len(below) - 1
    rates = np.zeros((order + 1, order + 1))  # the observer's form, and the force that is held
    rates[:order, 0] = [-one for one in below[1:]]
    rates[range(order - 1), range(1, order)] = 1.0
    rates[:order, order] = above
    moves = scipy.linalg.expm(rates * PERIOD)[:order]
    state, positions = np.array(above), [0.0] * window
    for _ in range(samples):
        positions.append(state[0])
        speed = (positions[-1] - positions[-1 - window]) / (window * PERIOD)
        state = moves @ [*state, -wall[0] * state[0] - wall[1] * speed]
    return np.array(positions[window:])


STRUCK = {
    "damper": ([1.0], [1.0, 100.0], 1),
    "damper, window": ([1.0], [1.0, 100.0], 5),
    "damper and spring": ([0.5, 30.0], [1.0, 40.0, 900.0], 1),
}


def struck_loop(case: str) -> HapticLoop:
    above, below, window = STRUCK[case]
    device = Device.transfer_function(above, below)
    velocity = Velocity.difference(samples=window)
    return HapticLoop(device=device, sample_time=PERIOD, velocity=velocity)


def time_of_struck(case: str, wall: tuple[float, float]) -> float:
    above, below, window = STRUCK[case]
    positions = struck(above, below, wall, window, LONG)
    return PERIOD * settled_since(positions, 0.0, 0.05 * np.abs(positions).max())


@pytest.mark.parametrize("case", STRUCK)
def test_a_blow_that_moves_a_device_at_once_finds_its_estimator_at_rest(case: str) -> None:
    """The damper was called settled after 0.063 s."""
    found = struck_loop(case).settling_time(244.0, 0.87, excitation="impact", level=0.05)
    assert int(found.status) == SettlingStatus.SETTLED
    assert float(found.value) == pytest.approx(time_of_struck(case, (244.0, 0.87)), rel=1e-12)
    if case == "damper":
        assert float(found.value) == pytest.approx(0.260, rel=1e-12)


@pytest.mark.campaign
def test_walls_that_are_tuned_for_such_a_blow_settle_when_they_say() -> None:
    loop = struck_loop("damper")
    for best in (
        loop.tune("settling", excitation="impact", level=0.05),
        jaxstab.tune_for_all([loop], excitation="impact", level=0.05),
    ):
        wall = best.stiffness, best.damping
        assert best.settling_time == pytest.approx(time_of_struck("damper", wall), rel=1e-12)


def test_a_device_of_one_mass_is_the_loop_of_five_numbers() -> None:
    loop = jaxstab.HapticLoop(
        device_mass=0.25, device_damping=0.1, sample_time=PERIOD, delay=1.5 * PERIOD
    )
    device = Device.transfer_function([1.0], [0.25, 0.1, 0.0])  # of which that is not known
    same = jaxstab.HapticLoop(device=device, sample_time=PERIOD, delay=1.5 * PERIOD)
    assert same.body is None
    options = {"samples": 100, "force": 1.0, "initial_velocity": 0.1, "between": 2}
    for one, other in zip(
        loop.simulate(*WALL, **options), same.simulate(*WALL, **options), strict=True
    ):
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-12 * np.abs(one).max())
    walls = np.array([[200.0], [2000.0], [90_000.0]]), np.array([2.0, 20.0])
    plain = loop.settling_time(*walls)
    general = same.settling_time(*walls)
    np.testing.assert_array_equal(plain.status, general.status)
    np.testing.assert_allclose(plain.value, general.value, rtol=1e-13)


@pytest.mark.campaign
def test_motions_of_a_device_go_through_jit_and_have_derivatives() -> None:
    """The derivative against differences; each lane of vmap against its own wall."""
    loop = loop_of(DRAWN["everything"], FILTERS["window and low pass"][0])

    def end(stiffness: Any) -> Any:
        return loop.simulate(stiffness, WALL[1], force=1.0, samples=50).position[-1]

    slope = (end(300.5) - end(299.5)).item()
    assert float(jax.grad(end)(300.0)) == pytest.approx(slope, rel=1e-5)
    lanes = jax.jit(jax.vmap(end))(jax.numpy.array([300.0, 400.0]))
    np.testing.assert_allclose(lanes, [end(300.0), end(400.0)], rtol=1e-12)


def test_what_a_blow_cannot_throw_or_a_force_not_hold_is_refused() -> None:
    damper = Device.transfer_function([1.0], [1.0, 5.0])
    with pytest.raises(ValueError, match="a blow does not throw"):
        HapticLoop(device=damper, sample_time=PERIOD).simulate(1.0, 0.0, initial_velocity=0.1)
    washed = Device.transfer_function([1.0, 0.0], [1.0, 2.0, 5.0])
    loop = HapticLoop(device=washed, sample_time=PERIOD)
    with pytest.raises(ValueError, match="zero DC gain"):
        loop.simulate(1.0, 0.0, force=1.0)
    with pytest.raises(ValueError, match="zero DC gain"):
        loop.settling_time(1.0, 0.0)
    moves = mechanics(damper, PERIOD, (0.0,), (0.0, 1.0))
    np.testing.assert_allclose(moves.seen[0, 1], [-5.0 * PERIOD, PERIOD, PERIOD], rtol=1e-14)
