"""Simulated contacts: against scipy with events, closed forms, and the linear simulation."""

import re
import tomllib
from collections.abc import Callable
from itertools import product
from math import inf, pi
from pathlib import Path
from typing import Any

import campaign
import jax
import numpy as np
import pytest
from commands import run
from scipy.linalg import expm

import jaxstab
from docs import contact as study
from jaxstab import HapticLoop, Velocity
from jaxstab.app.pictures.scene import scene_figure
from jaxstab.app.scene import Scene, check_walls, simulate_contacts
from jaxstab.app.scene.scene import ContactTable
from jaxstab.lab.contact.runs import setup_of
from jaxstab.motion import contact as kernel
from jaxstab.results import ContactKind
from tests.truth import contacts as truth
from tests.truth import loop as plants
from tests.truth.march import difference_taps, low_pass_taps, march_through_filters

PERIOD = 1e-3
HELD = {"device_mass": 0.25, "device_damping": 0.1, "sample_time": PERIOD}
WINDOW = HapticLoop(**HELD, delay=PERIOD, velocity=Velocity.difference(window=0.02))
ARM = jaxstab.Hand.mass_spring_damper(1.0, damping=5.0, stiffness=300.0)
MODE = jaxstab.Mode(frequency=80.0, damping_ratio=0.01, modal_mass=0.5)
GENERAL = (
    jaxstab.Device.modes([MODE], mass=0.25, damping=0.1)
    .with_actuator(200.0)
    .held_by(ARM.with_grip(stiffness=2000.0, damping=4.0))
)
FREE = HapticLoop(device_mass=0.5, device_damping=0.0, sample_time=PERIOD)


def random_body(rng: np.random.Generator) -> tuple[dict[str, float], float, dict[str, Any]]:
    """One mass with a hand: fields of the loop, its mass, and the same for the truth."""
    mass, damping = 10.0 ** rng.uniform(-1.7, 0.3), rng.choice([0.0, 0.1, 3.0, 60.0])
    stiffness = rng.choice([0.0, 300.0, 3e4, mass / PERIOD**2])
    fields = {"device_mass": mass, "device_damping": damping, "hand_stiffness": stiffness}
    return fields, mass, {"damping": damping, "stiffness": stiffness}


def random_device(rng: np.random.Generator) -> tuple[dict[str, Any], float, dict[str, Any]]:
    """The same of a device with up to two modes, an actuator and an arm behind a grip."""
    mass, damping = 10.0 ** rng.uniform(-1.0, 0.3), rng.choice([0.0, 0.1, 3.0])
    bodies, modes, arm = [(mass, damping, 0.0)], [], None
    for _ in range(rng.integers(3)):
        moved, frequency, ratio = mass * rng.uniform(0.3, 3.0), rng.uniform(30.0, 400.0), 0.02
        rate = 2.0 * pi * frequency
        bodies.append((moved, 2.0 * ratio * rate * moved, rate**2 * moved))
        modes.append(jaxstab.Mode(frequency=frequency, damping_ratio=ratio, modal_mass=moved))
    device = jaxstab.Device.modes(modes, mass=mass, damping=damping)
    bandwidth = rng.choice([None, 50.0, 300.0])
    if bandwidth:
        device = device.with_actuator(bandwidth)
    if rng.random() < 0.5 or not (modes or bandwidth):
        arm = 1.0, 5.0, 300.0, 4.0, 2000.0
        hand = jaxstab.Hand.mass_spring_damper(arm[0], damping=arm[1], stiffness=arm[2])
        device = device.held_by(hand.with_grip(damping=arm[3], stiffness=arm[4]))
    at_handle = 1.0 / sum(1.0 / body[0] for body in bodies)
    same = {"damping": 0.0, "stiffness": 0.0, "device": truth.structure(bodies, arm, bandwidth)}
    return {"device": device}, at_handle, same


def random_case(
    rng: np.random.Generator, random: Callable[..., Any] = random_body
) -> tuple[HapticLoop, dict[str, Any], truth.Felt]:
    """A loop of any device, estimator and delays, and what disturbs it."""
    mechanics, mass, same = random(rng)
    fields: dict[str, Any] = {"velocity": None, "position": None}
    velocity, position = [difference_taps(1)], []
    kind = rng.integers(4)
    if kind == 1:
        window = int(rng.integers(2, 21))
        fields["velocity"] = Velocity.difference(samples=window)
        velocity = [difference_taps(window)]
    elif kind == 2:
        fields["velocity"] = Velocity.difference(samples=1) * jaxstab.Filter.low_pass(100.0)
        velocity = [difference_taps(1), low_pass_taps(100.0 * PERIOD)]
    elif kind == 3:
        fields["position"] = jaxstab.Filter.low_pass(200.0)
        position = [low_pass_taps(200.0 * PERIOD)]
    delays = rng.choice([0.0, PERIOD, 1.5 * PERIOD, 3.2 * PERIOD], int(rng.integers(1, 4)))
    moving = [*delays.tolist(), inf] if rng.random() < 0.2 else delays.tolist()
    loop = HapticLoop(**mechanics, sample_time=PERIOD, delay=delays[0], **fields)
    unit = mass / PERIOD**2
    size = 10.0 ** rng.uniform(-5.0, -2.0)  # m that it moves in a sample
    wall = unit * rng.uniform(0.0, 0.3), unit * PERIOD * rng.uniform(0.0, 0.5)
    friction = rng.choice([0.0, rng.uniform(0.0, 0.1)]) * size * unit
    felt: dict[str, Any] = {
        "friction": friction,
        "static_friction": friction * rng.choice([1.0, 1.5]),
        "encoder": rng.choice([0.0, 0.3 * size]),
        "phase": rng.uniform(),
        "force_step": rng.choice([0.0, 0.02 * size * unit]),
        "max_force": rng.choice([inf, 0.3 * size * unit]),
        "push": rng.choice([0.0, 0.1 * size * unit]),
        "one_sided": bool(rng.random() < 0.7),
        "pulls": bool(rng.random() < 0.5),
    }
    if felt["phase"] < 0.3:
        felt |= {"one_sided": True, "pulls": False, "gate": "force"}
    own = truth.Felt(
        mass=mass, period=PERIOD, delays=moving, velocity=velocity, position=position, wall=wall,
        **same, **felt,
    )  # fmt: skip
    felt["max_force"] = None if felt["max_force"] == inf else felt["max_force"]
    start = {
        "position": rng.uniform(-1.0, 1.0) * size,
        "speed": rng.uniform(0.2, 1.0) * size / PERIOD,
    }
    return loop, {"stiffness": wall[0], "damping": wall[1], **felt, **start, "delays": moving}, own


def assert_runs_are_true(
    rng: np.random.Generator, runs: int, samples: int, random: Callable[..., Any] = random_body
) -> None:
    compared = events = balanced = 0
    for _ in range(runs):
        loop, options, felt = random_case(rng, random)
        start = options["position"], options["speed"]
        contact = jaxstab.contact(loop, **options, duration=samples * PERIOD)
        longer = jaxstab.contact(loop, **options, duration=(samples + 1) * PERIOD)
        true = truth.run(felt, start, samples)
        assert contact.path is not None
        assert longer.path is not None
        known = slice(true.certain)
        compared, events = compared + true.certain, events + true.events
        for ours, theirs in zip(contact.path[1:], true.path, strict=True):
            scale = np.maximum.accumulate(np.abs(theirs))[known]
            assert np.all(np.abs(ours - theirs)[known] <= 1e-11 * scale)
        if true.certain == samples:
            deepest = max(true.highest, 0.0)
            assert abs(contact.penetration - deepest) <= 1e-11 * np.abs(true.path[0]).max()
            given = abs(true.given) + felt.mass * start[1] ** 2
            assert abs(contact.energy - true.given) <= 1e-9 * given
            if felt.device is None:
                # Our energy and our last state, and what scipy's friction and damping took.
                x, v = float(longer.path.position[-1]), float(longer.path.velocity[-1])
                moved = felt.push * (x - start[0]) - 0.5 * felt.stiffness * (x**2 - start[0] ** 2)
                kinetic = 0.5 * felt.mass * (v**2 - start[1] ** 2)
                balance = float(contact.energy) + moved - true.lost - kinetic
                size = abs(float(contact.energy)) + felt.mass * start[1] ** 2 + true.lost
                assert abs(balance) <= 1e-9 * size
            balanced += 1
    assert compared > 0.9 * runs * samples
    assert balanced > 0.8 * runs
    assert events > runs


def test_random_runs_are_those_of_scipy_with_events(rng: np.random.Generator) -> None:
    assert_runs_are_true(rng, 8, 40)


@pytest.mark.parametrize("delay", [0.0, 1e-9, 0.3])
def test_the_pieces_of_one_mass_are_its_motion_to_the_last_digits(delay: float) -> None:
    for gamma, delta in ((0.0, 0.0), (1e-3, 0.015), (0.25, 1.0), (2.0, 6.0), (9.9, 0.1)):
        plant = kernel.SwitchedMass.from_delays(gamma, delta, (delay,))
        assert sum(length for length, *_ in plant.flows[0]) == pytest.approx(1.0, rel=1e-15)
        for length, *found in plant.flows[0]:
            step, impulse = plants.motion(gamma, delta, length)
            slope = 1 - delta * impulse - gamma * step
            for mine, right in zip(found, (impulse, slope, step), strict=True):
                assert plants.ulps(mine, right) <= 4


@pytest.mark.campaign
def test_200_random_runs_are_those_of_scipy_with_events(rng: np.random.Generator) -> None:
    assert_runs_are_true(rng, campaign.many(200, 12), 60)


def test_random_devices_move_as_in_scipy_with_events(rng: np.random.Generator) -> None:
    assert_runs_are_true(rng, 4, 30, random_device)


@pytest.mark.campaign
def test_200_random_devices_move_as_in_scipy_with_events(rng: np.random.Generator) -> None:
    assert_runs_are_true(rng, campaign.many(200, 12), 40, random_device)


def test_no_walls_have_no_contacts_and_no_responses() -> None:
    loop = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
    contact = jaxstab.contact(loop, [], 10.0, push=1.0, duration=0.1)
    assert contact.kind.shape == (0,)
    assert contact.path.position.shape == (0, 100)
    assert loop.simulate([], 10.0, force=1.0, samples=50).position.shape == (0, 50)


def test_a_free_mass_slides_until_friction_stops_it() -> None:
    speed, friction = 0.3, 0.7
    contact = jaxstab.contact(
        FREE, 1.0, 0.0, position=-1.0, speed=speed, friction=friction, duration=0.4
    )
    assert contact.path is not None
    deceleration = friction / FREE.mass
    stop = speed / deceleration
    time = np.minimum(contact.path.time, stop)
    true = -1.0 + speed * time - 0.5 * deceleration * time**2
    assert np.allclose(contact.path.position, true, rtol=1e-14, atol=1e-15)
    assert contact.kind == ContactKind.UNTOUCHED  # it stops before the wall
    assert contact.penetration == 0.0
    assert contact.time_to_rest == pytest.approx(stop, abs=5e-3)  # the last um takes 1.2 ms
    assert contact.energy == 0.0
    assert contact.largest_force == 0.0


def test_the_first_touch_is_that_of_the_formula() -> None:
    stiffness, damping, speed = 800.0, 5.0, 0.2
    contact = jaxstab.contact(FREE, stiffness, damping, speed=speed, duration=0.016)
    assert contact.path is not None
    first = speed * PERIOD  # at time 0 the mass is at the surface, and feels nothing
    force = -(stiffness * first + damping * speed)
    assert contact.path.force[:2].tolist() == [0.0, pytest.approx(force, rel=1e-13)]
    second = 2.0 * first + 0.5 * force / FREE.mass * PERIOD**2
    assert contact.path.position[2] == pytest.approx(second, rel=1e-13)


def test_a_push_up_to_the_static_friction_moves_nothing() -> None:
    friction = {"friction": 0.2, "static_friction": 0.5}
    still = jaxstab.contact(WINDOW, 1000.0, 3.0, push=0.5, **friction)
    assert (still.kind, still.time_to_rest, still.penetration) == (ContactKind.RESTS, 0.0, 0.0)
    moved = jaxstab.contact(FREE, 1.0, 0.0, push=0.51, position=-1.0, **friction, duration=0.1)
    assert moved.path is not None
    true = -1.0 + 0.5 * (0.51 - 0.2) / FREE.mass * moved.path.time**2
    assert np.allclose(moved.path.position, true, rtol=1e-13)


def test_a_handle_breaks_loose_when_the_actuator_has_got_up_enough_force() -> None:
    """Within the first sample the wall's force is constant; the actuator approaches it."""
    mass, bandwidth, force, static, friction = 0.5, 300.0, 4.0, 2.0, 1.0
    device = jaxstab.Device.mass_spring_damper(mass).with_actuator(bandwidth)
    loop = HapticLoop(device=device, sample_time=PERIOD)
    contact = jaxstab.contact(loop,
        4000.0, 0.0, position=1e-3, friction=friction, static_friction=static, one_sided=False,
        duration=0.016,
    )  # fmt: skip
    assert contact.path is not None
    rate = 2.0 * pi * bandwidth
    loose = -np.log(1.0 - static / force) / rate
    rest, late, early = PERIOD - loose, np.exp(-rate * PERIOD), np.exp(-rate * loose)
    assert 0.0 < loose < PERIOD
    impulse = (force - friction) * rest - force * (early - late) / rate
    way = 0.5 * (force - friction) * rest**2 + force * ((early - late) / rate - early * rest) / rate
    assert contact.path.velocity[1] == pytest.approx(-impulse / mass, rel=1e-12)
    assert contact.path.position[1] == pytest.approx(1e-3 - way / mass, rel=1e-13)


def relay_cycle(delay: float, force: float, friction: float, mass: float) -> tuple[float, float]:
    """Amplitude and period of a mass with friction under a relay of its delayed position.

    It passes 0 with the speed v, is still pushed for the delay, is then braked to rest, and returns
    to 0 with the speed v: 2 v^2 = (v + a t)^2 (1 + a / c).
    """
    a, c = (force - friction) / mass, (force + friction) / mass
    share = np.sqrt(0.5 * (1.0 + a / c))
    speed = a * delay * share / (1.0 - share)
    fastest = speed + a * delay
    peak = speed * delay + 0.5 * a * delay**2 + 0.5 * fastest**2 / c
    return float(peak), float(2.0 * (delay + fastest / c + np.sqrt(2.0 * peak / a)))


def test_a_relay_with_delay_and_friction_has_the_limit_cycle_of_the_formula() -> None:
    samples, force, friction = 200, 2.0, 0.8
    loop = HapticLoop(device_mass=0.5, device_damping=0.0, sample_time=1e-4, delay=samples * 1e-4)
    contact = jaxstab.contact(
        loop,
        1e9,
        0.0,
        max_force=force,
        friction=friction,
        one_sided=False,
        position=1e-3,
        duration=3.0,
    )
    # The relay looks once per sample: the delay is between 200 and 201 samples.
    low, high = (
        relay_cycle(count * 1e-4, force, friction, 0.5) for count in (samples, samples + 1)
    )
    assert contact.kind == ContactKind.OSCILLATES
    assert low[0] <= contact.amplitude <= high[0]
    assert 1.0 / high[1] <= contact.frequency <= 1.0 / low[1]


@pytest.mark.parametrize("one_sided", [False, True])
@pytest.mark.parametrize("random", [random_body, random_device])
@pytest.mark.parametrize("case", range(8))
def test_without_friction_and_encoder_a_contact_is_simulate(
    case: int, random: Callable[..., Any], one_sided: bool
) -> None:
    loop, options, felt = random_case(np.random.default_rng(case), random)
    wall = felt.wall[0], felt.wall[1]
    start = {"initial_position": options["position"], "initial_velocity": options["speed"]}
    linear = loop.simulate(
        *wall, **start, force=felt.push, samples=50, unilateral=one_sided, delays=options["delays"]
    )
    contact = jaxstab.contact(loop,
        *wall, position=options["position"], speed=options["speed"], push=felt.push,
        one_sided=one_sided, pulls=True, duration=50 * PERIOD, delays=options["delays"],
    )  # fmt: skip
    assert contact.path is not None
    for ours, theirs in zip(contact.path[1:3], linear[1:3], strict=True):
        assert np.all(np.abs(ours - theirs) <= 1e-11 * np.maximum.accumulate(np.abs(theirs)))


def many_conditions(rng: np.random.Generator, count: int) -> dict[str, Any]:
    friction = rng.uniform(0.0, 0.4, count)
    return {
        "stiffness": rng.uniform(100.0, 6000.0, count),
        "damping": rng.uniform(0.0, 40.0, count),
        "friction": friction,
        "static_friction": friction * rng.uniform(1.0, 1.5, count),
        "encoder": rng.choice([0.0, 1e-5, 5e-5], count),
        "phase": rng.uniform(size=count),
        "force_step": rng.choice([0.0, 0.01], count),
        "max_force": rng.choice([5.0, 1e9], count),
        "push": rng.uniform(0.0, 2.0, count),
        "speed": rng.uniform(0.01, 0.5, count),
    }


LOOPS = {
    "window": WINDOW,
    "hand": HapticLoop(**HELD, hand_mass=0.1, hand_stiffness=400.0, hand_damping=3.0, delay=1.4e-3),
    "fast": HapticLoop(**HELD, hand_stiffness=1e6, position=jaxstab.Filter.low_pass(150.0)),
    "damped": HapticLoop(device_mass=0.02, device_damping=50.0, sample_time=PERIOD),
    "device": HapticLoop(device=GENERAL, sample_time=PERIOD, delay=1.4e-3),
}


MOVING = (0.2e-3, 1e-3, inf, 1.7e-3)


@pytest.mark.parametrize(
    ("name", "delays"),
    [
        ("hand", None),
        *(
            pytest.param(name, delays, marks=pytest.mark.campaign)
            for name, delays in product(LOOPS, [None, MOVING])
            if (name, delays) != ("hand", None)
        ),
    ],
)
def test_numbers_numpy_and_jax_agree(
    name: str, delays: Any, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop, count = LOOPS[name], 5 if name == "device" else 20
    options = many_conditions(rng, count)
    fixed = {"duration": 0.04, "delays": delays}
    by_numpy = jaxstab.contact(loop, **options, **fixed, path=False)
    monkeypatch.setattr(kernel, "_MANY", 0)
    by_jax = jaxstab.contact(loop, **options, **fixed, path=False)
    single = [
        jaxstab.contact(loop, **{key: value[k] for key, value in options.items()}, **fixed)
        for k in range(count)
    ]
    for name_of in ("amplitude", "penetration", "largest_force", "energy"):
        numpy = getattr(by_numpy, name_of)
        scale = 1e-12 * np.abs(numpy).max()
        assert np.allclose(getattr(by_jax, name_of), numpy, rtol=1e-12, atol=scale)
        ours = [float(getattr(one, name_of)) for one in single]
        assert np.allclose(ours, numpy, rtol=1e-12, atol=scale)
    assert np.array_equal(by_jax.kind, by_numpy.kind)


@pytest.mark.parametrize(("name", "loops"), [("window", 0), ("device", 3)])
def test_a_map_is_one_program_that_never_returns_to_the_host(name: str, loops: int) -> None:
    """One loop over samples; of any device, in each piece one over legs and two that search."""
    given: dict[str, Any] = {"friction": 0.1, "push": 1.0}
    setup = setup_of(LOOPS[name], np.full(64, 1000.0), 3.0, **given)
    plant = setup.plant
    arrays = plant._replace(ages=np.array(plant.ages), flows=np.array(plant.flows))

    def summed(samples: Any, arrays: Any, controller: Any, runs: Any) -> Any:
        own = arrays._replace(oldest=plant.oldest)
        return kernel._summary(own, controller, runs, samples, kernel.Sides(True, False))

    text = jax.jit(summed).lower(4000, arrays, setup.controller, setup.runs).as_text()
    assert text.count("stablehlo.while") == 1 + loops * len(plant.flows[0])
    assert not re.search("custom_call|callback|infeed|outfeed|stablehlo.send", text)


def test_maps_larger_than_a_tile_keep_their_order(monkeypatch: pytest.MonkeyPatch) -> None:
    stiffness = np.linspace(500.0, 6000.0, 23)[:, None] * np.ones(101)
    friction = np.linspace(0.0, 0.4, 101)
    given = {"friction": friction, "push": 1.0, "duration": 0.03}
    monkeypatch.setattr(kernel, "_MANY", inf)
    by_numpy = jaxstab.contact(WINDOW, stiffness, 10.0, **given, path=False)
    monkeypatch.setattr(kernel, "_MANY", 0)
    by_jax = jaxstab.contact(WINDOW, stiffness, 10.0, **given, path=False)
    assert by_jax.penetration.shape == (23, 101)
    assert np.allclose(by_jax.penetration, by_numpy.penetration, rtol=1e-12)
    assert np.allclose(by_jax.energy, by_numpy.energy, rtol=1e-9, atol=1e-18)


def test_friction_holds_walls_that_are_unstable() -> None:
    walls = [(5000.0, 30.0)] * 3 + [(3000.0, 15.0)] * 2
    friction = [0.3, 0.1, 0.0, 0.1, 0.0]
    contact = jaxstab.contact(WINDOW, *np.transpose(walls), friction=friction, push=1.0, path=False)
    assert (contact.kind == ContactKind.RESTS).tolist() == [True, False, False, True, False]
    does_move = np.isin(contact.kind, [ContactKind.BOUNCES, ContactKind.GROWS])
    assert does_move.tolist() == [False, True, True, False, True]
    assert np.all(contact.amplitude[does_move] > 1e-3)
    assert np.all(WINDOW.verdict([5000.0, 3000.0], [30.0, 15.0]) == jaxstab.Verdict.UNSTABLE)


def test_every_kind_of_end_has_its_name() -> None:
    held = HapticLoop(**HELD, hand_stiffness=200.0)
    two_sided = jaxstab.contact(held, 40000.0, 0.0, speed=0.1, one_sided=False, duration=8.0)
    assert two_sided.kind == ContactKind.GROWS
    assert two_sided.amplitude == two_sided.penetration == two_sided.largest_force == inf
    assert two_sided.time_to_rest == inf
    assert np.isnan(two_sided.energy)
    assert jaxstab.contact(WINDOW, 1000.0, 3.0, speed=0.1).kind == ContactKind.OUTSIDE
    free = HapticLoop(device_mass=0.25, device_damping=0.02, sample_time=PERIOD)
    decaying = jaxstab.contact(free, 1000.0, 1.0, speed=0.1, push=0.5, one_sided=False)
    assert decaying.kind == ContactKind.DECAYS
    still = jaxstab.contact(free, 10.0, 0.005, speed=0.1, one_sided=False, duration=8.0)
    assert still.kind == ContactKind.OSCILLATES
    assert still.frequency == pytest.approx(np.sqrt(10.0 / 0.25) / (2.0 * pi), rel=1e-2)


def own_run(
    loop: HapticLoop, wall: tuple[float, float], start: tuple[float, float], samples: int, *,
    push: float, most: float, delay: int = 1, one_sided: bool = True, fine: int = 4,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Positions, some in each sample, and forces: a recursion with a matrix exponential."""
    rates = [[0.0, 1.0, 0.0], [0.0, -loop.device_damping / loop.mass, 1.0 / loop.mass], [0.0] * 3]
    step = expm(np.array(rates) * PERIOD / fine)[:2]
    state, before = np.array(start), start[0]
    forces, places = [0.0] * delay, []
    for sample in range(samples):
        place = state[0]
        force = -wall[0] * place - wall[1] * (place - before) / PERIOD
        if one_sided:
            force = min(force, 0.0) if place > 0.0 else 0.0
        forces.append(min(max(force, -most), most))
        before = place
        for _ in range(fine):
            state = step @ [*state, forces[sample] + push]
            places.append(state[0])
    return np.array(places), np.array(forces[delay:])


BARE = HapticLoop(**HELD, delay=PERIOD)


@pytest.mark.parametrize(
    "count", [40, pytest.param(campaign.many(3000, 120), marks=pytest.mark.campaign)]
)
def test_a_kind_says_what_an_own_recursion_saw(count: int, rng: np.random.Generator) -> None:
    """Outside in the last quarter, never at the wall, or pushed more than the wall can hold."""
    kinds, samples = [], 320
    for _ in range(count):
        wall = 10.0 ** rng.uniform(2.0, 3.8), 10.0 ** rng.uniform(-1.0, 1.3)
        push = float(rng.choice([0.0, 10.0 ** rng.uniform(-1.5, 1.0)]))
        most = float(rng.choice([inf, (push or 1.0) * rng.choice([0.5, 1.0, 2.0])]))
        start = float(rng.choice([0.0, -0.05])), 10.0 ** rng.uniform(-2.0, 0.0)
        one_sided = bool(rng.random() < 0.8)
        places, forces = own_run(
            BARE, wall, start, samples, push=push, most=most, one_sided=one_sided
        )
        contact = jaxstab.contact(BARE,
            *wall, position=start[0], speed=start[1], push=push, one_sided=one_sided,
            max_force=None if most == inf else most, duration=samples * PERIOD,
        )  # fmt: skip
        late = forces[-samples // 4 - 1 :]  # the last quarter and the sample before
        if abs(late[0]) == most and np.all(late == late[0]):
            expected = ContactKind.PUSHED_THROUGH
        elif one_sided and places.max() < 0.0:
            expected = ContactKind.UNTOUCHED
        elif one_sided and places[-samples:].max() < 0.0:
            expected = ContactKind.OUTSIDE
        else:
            expected = ContactKind.NOT_COMPUTED  # of the others
        kinds.append(expected)
        others = {kind for kind in ContactKind if kind < ContactKind.OUTSIDE}
        assert contact.kind in (others if expected == ContactKind.NOT_COMPUTED else {expected})
        deepest = max(places.max(), start[0], 0.0)
        assert -1e-9 * deepest <= contact.penetration - deepest <= 1e-3 * deepest + 1e-5
    assert min(map(kinds.count, set(kinds))) >= count // 20
    assert len(set(kinds)) == 4


def test_what_returns_later_is_outside_and_not_said_to_stay_there() -> None:
    """It returns once, at 2.949 s, and is outside in the last quarter of 4 s."""
    wall, start = (3000.0, 2.0), (0.0, 0.3)
    places, _ = own_run(BARE, wall, start, 4000, push=0.05, most=inf)
    enters = np.flatnonzero((places[1:] > 0.0) & (places[:-1] <= 0.0))
    assert [place * PERIOD / 4 for place in enters] == [pytest.approx(2.949, abs=1e-3)]
    contact = jaxstab.contact(BARE, *wall, push=0.05, speed=start[1])
    assert contact.kind == ContactKind.OUTSIDE
    assert ContactKind.OUTSIDE.words == "outside of the wall at the end"


THROWN = (
    HapticLoop(
        device_mass=1.4742,
        device_damping=1.6797,
        hand_stiffness=528.99,
        sample_time=PERIOD,
        delay=2.0 * PERIOD,
        velocity=Velocity.low_pass(16.56),
    ),
    (12028.0, 227.271),
    (-1e-3, 0.05),  # m, m/s
)


def test_a_stable_wall_that_acts_where_x_is_positive_may_bounce_higher_for_ever() -> None:
    """The wall of docs/contact.md: held from both sides it calms down, from one side it grows."""
    loop, wall, start = THROWN
    assert loop.verdict(*wall) == jaxstab.Verdict.STABLE
    assert float(loop.spectral_radius(*wall).value) == pytest.approx(0.99725, abs=5e-6)
    largest = {}
    for is_one_sided in (False, True):
        states, _ = march_through_filters(
            (528.99 * PERIOD**2 / 1.4742, 1.6797 * PERIOD / 1.4742, 2.0),
            (wall[0] * PERIOD**2 / 1.4742, wall[1] * PERIOD / 1.4742),
            [difference_taps(1), low_pass_taps(16.56 * PERIOD)], [], 10_000,
            start=(start[0], start[1] * PERIOD), unilateral=is_one_sided,
        )  # fmt: skip
        largest[is_one_sided] = abs(states[:, 0]).reshape(10, -1).max(axis=1)  # of each second
    assert np.all(np.diff(largest[False]) < 0.0)
    assert largest[False][-1] < 1e-12
    assert np.all(largest[True][1:] > 1.1 * largest[True][:-1])
    contact = jaxstab.contact(loop, *wall, position=start[0], speed=start[1], duration=20.0)
    assert contact.kind == ContactKind.GROWS


@pytest.mark.parametrize("push", [2.0, 1.0])
def test_a_push_of_the_largest_force_or_more_goes_through_the_wall(push: float) -> None:
    """The force is 1 N at most: then the speed goes to (push - 1 N) / b, where the wall ends."""
    loop = HapticLoop(device_mass=0.25, device_damping=1.0, sample_time=PERIOD, delay=PERIOD)
    wall, limited = (1000.0, 5.0), {"max_force": 1.0}
    places, forces = own_run(loop, wall, (0.0, 0.1), 4000, push=push, most=1.0)
    assert np.all(forces[-1000:] == -1.0)
    assert places[-1] - places[-4001] == pytest.approx(push - 1.0, abs=1e-5)  # m in 1 s
    contact = jaxstab.contact(loop, *wall, push=push, speed=0.1, **limited)
    assert contact.kind == ContactKind.PUSHED_THROUGH
    assert contact.penetration == pytest.approx(places.max(), rel=1e-9)
    assert jaxstab.contact(loop, *wall, push=0.9, speed=0.1, **limited).kind == ContactKind.RESTS


def test_a_wall_gated_by_its_force_rests_where_one_gated_by_the_position_grows() -> None:
    loop, wall, (position, speed) = THROWN
    assert loop.one_sided(*wall)
    start: dict[str, Any] = {"position": position, "speed": speed, "duration": 10.0}
    kinds = [
        jaxstab.contact(loop, *wall, **start, **gate).kind
        for gate in ({}, {"pulls": True}, {"gate": "force"})
    ]
    assert kinds[0] == ContactKind.GROWS
    assert kinds[1] in (ContactKind.GROWS, ContactKind.BOUNCES)
    assert kinds[2] == ContactKind.RESTS
    many = jaxstab.contact(loop, *wall, gate="force", path=False, **start | {"speed": [0.02, 0.05]})
    assert (many.kind == ContactKind.RESTS).all()
    # It brakes before the surface, so that it may turn back without having touched it.
    slow = jaxstab.contact(
        loop, *wall, gate="force", **start | {"position": -5e-3, "speed": 0.1, "duration": 0.3}
    )
    assert slow.penetration == 0.0
    assert slow.largest_force > 1.0
    assert slow.kind == ContactKind.OUTSIDE


@pytest.mark.parametrize("odd", [{"pulls": True}, {"one_sided": False}])
def test_a_wall_gated_by_its_force_only_pushes(odd: dict[str, bool]) -> None:
    with pytest.raises(ValueError, match='gate is "force", of a wall that only pushes'):
        jaxstab.contact(BARE, 1000.0, 1.0, push=1.0, gate="force", **odd)
    with pytest.raises(ValueError, match='give one of "position", "force"'):
        jaxstab.contact(BARE, 1000.0, 1.0, push=1.0, gate="side")


def test_what_bounced_away_and_stopped_has_left_the_wall() -> None:
    """Viscous damping stops it within m v / b of where it left."""
    loop = HapticLoop(device_mass=0.25, device_damping=5.0, sample_time=PERIOD, delay=PERIOD)
    places, _ = own_run(loop, (3000.0, 2.0), (0.0, 0.3), 4000, push=0.0, most=inf)
    assert places[-1] < -1e-3
    assert np.ptp(places[-4000:]) < 1e-6
    contact = jaxstab.contact(loop, 3000.0, 2.0, speed=0.3)
    assert contact.kind == ContactKind.OUTSIDE
    assert contact.time_to_rest < 3.0


def test_no_run_of_a_stable_wall_passes_the_proved_amplitude(rng: np.random.Generator) -> None:
    count, wall = 300, (1000.0, 10.0)
    causes = {"encoder": 2e-5, "friction": 1e-3, "force_step": 0.02}
    proved = WINDOW.amplitude(*wall, **causes)
    contact = jaxstab.contact(WINDOW,
        *wall, **causes, one_sided=False, push=rng.uniform(0.0, 2.0, count),
        speed=rng.uniform(0.0, 0.1, count), phase=rng.uniform(size=count), path=False,
    )  # fmt: skip
    assert np.all(contact.amplitude <= proved.position)
    assert contact.amplitude.max() > 0.0


@pytest.mark.campaign
def test_the_campaign_finds_no_amplitude_above_its_bound(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert study.main(small=True) == 0
    last = capsys.readouterr().out.splitlines()[-1]
    found = re.match(r"amplitudes above the proved bound: 0 of ([\d,]+)", last)
    assert found
    assert int(found[1].replace(",", "")) > 20


def test_walls_below_the_rule_of_abbott_and_okamura_come_to_rest() -> None:
    """K < 2 b / T and K < 2 f_c / q, without damping and delay: passive, so it rests."""
    damping, encoder = 2.0, 4e-5
    loop = HapticLoop(device_mass=0.1, device_damping=damping, sample_time=PERIOD)
    friction = np.array([0.01, 0.02, 0.05, 0.1])[:, None]
    largest = np.minimum(2.0 * damping / PERIOD, 2.0 * friction / encoder)
    push = np.linspace(0.2, 3.0, 7)
    below = jaxstab.contact(
        loop,
        0.9 * largest,
        0.0,
        friction=friction,
        encoder=encoder,
        push=push,
        speed=0.05,
        path=False,
    )
    assert np.all(below.kind == ContactKind.RESTS)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"friction": -0.1}, "friction is -0.1; allowed are finite values >= 0"),
        ({"friction": 0.2, "static_friction": 0.1}, "static_friction is 0.1 N, below friction"),
        ({"encoder": -1e-5}, "encoder is -1e-05"),
        ({"max_force": 0.0}, "max_force is 0.0"),
        ({"stiffness": 0.0}, "nothing holds the device"),
        ({"push": 0.0}, "nothing moves"),
        ({"duration": 1e-3}, "give 16 samples at least"),
        ({"duration": 1e300}, "and 1e\\+08 at most"),
        ({"delays": (inf,)}, "one at least finite"),
    ],
)
def test_bad_input_is_refused_in_one_sentence(options: dict[str, Any], sentence: str) -> None:
    given = {"stiffness": 1000.0, "damping": 3.0, "push": 1.0, **options}
    with pytest.raises(ValueError, match=sentence):
        jaxstab.contact(WINDOW, **given)


def test_a_device_that_is_one_mass_in_disguise_moves_as_that_mass(
    rng: np.random.Generator,
) -> None:
    """A transfer function takes the way of any device: two routes, one answer."""
    options = many_conditions(rng, 40) | {"duration": 0.04, "delays": (0.2e-3, 1e-3, inf, 1.7e-3)}
    fields = {"sample_time": PERIOD, "velocity": Velocity.difference(window=0.02)}
    device = jaxstab.Device.transfer_function([1.0], [0.25, 0.1, 200.0])
    assert device.one_mass() is None
    mass = HapticLoop(device_mass=0.25, device_damping=0.1, hand_stiffness=200.0, **fields)
    ours = jaxstab.contact(HapticLoop(device=device, **fields), **options, path=False)
    theirs = jaxstab.contact(mass, **options, path=False)
    for name in ("amplitude", "penetration", "largest_force", "energy"):
        one, other = getattr(ours, name), getattr(theirs, name)
        assert np.allclose(one, other, rtol=1e-11, atol=1e-11 * np.abs(other).max())
    assert np.array_equal(ours.kind, theirs.kind)


APART = jaxstab.Device.modes(  # the encoder and the handle move against each other
    [jaxstab.Mode(frequency=35.0, damping_ratio=0.05, modal_mass=8e-4, encoder=-1.0)],
    mass=8e-4,
    damping=2e-3,
)


@pytest.mark.parametrize(
    ("loop", "sentence"),
    [
        (
            HapticLoop(device_mass=0.01, device_damping=1000.0, sample_time=PERIOD),
            "moves at 100 rad per sample",
        ),
        (
            HapticLoop(device=jaxstab.Device.transfer_function([1.0], [1.0, 9.0]), sample_time=1.0),
            "has no mass at its handle",
        ),
        (
            HapticLoop(
                device=jaxstab.Device.transfer_function([1.0, 0.0], [1.0, 9.0, 1.0, 1.0]),
                sample_time=PERIOD,
            ),
            "zero DC gain",
        ),
        (
            HapticLoop(device=jaxstab.Device.simulated(0.1, step=2e-3), sample_time=2e-3),
            "at its steps alone",
        ),
        (
            HapticLoop(device=APART, sample_time=1e-3),
            "does not show the handle",
        ),
    ],
)
def test_devices_that_are_too_fast_or_have_no_mass_are_refused(
    loop: HapticLoop, sentence: str
) -> None:
    with pytest.raises(ValueError, match=sentence):
        jaxstab.contact(loop, 1000.0, 3.0, push=1.0)


def test_a_run_can_be_drawn_and_a_map_cannot() -> None:
    axes = jaxstab.contact(WINDOW, 1000.0, 3.0, push=1.0, friction=0.1).plot()
    assert axes.get_title() == "simulated: rests"
    with pytest.raises(ValueError, match="no single path"):
        jaxstab.contact(WINDOW, [1000.0, 2000.0], 3.0, push=1.0).plot()


SCENE = """
[device]
mass = 0.25
damping = 0.1
friction = 0.1
encoder.resolution = 1e-5
[controller]
sample_time = 0.001
delay = 0.001
velocity.window = 0.02
[walls.soft]
stiffness = 1000.0
damping = 10.0
[walls.hard]
stiffness = 5000.0
damping = 30.0
[contact]
push = 1.0
speed = 0.1
duration = 1.0
"""


def scene_with(**changes: dict[str, Any]) -> Scene:
    table = tomllib.loads(SCENE)
    for name, keys in changes.items():
        table[name] = table.get(name, {}) | keys
    return Scene.from_table(table)


def test_a_mass_behind_a_stiff_grip_arrives_with_the_device() -> None:
    """As one mass of both; a transfer function, whose masses are not known, is struck alone."""
    hand = jaxstab.Hand.mass_spring_damper(1.0).with_grip(stiffness=1e5, damping=20.0)
    light = jaxstab.Device.mass_spring_damper(0.05, damping=0.1)
    whole = jaxstab.Device.mass_spring_damper(1.05, damping=0.1)
    unknown = jaxstab.Device.transfer_function([1.0], [0.05, 0.1, 0.0])
    one, both, struck = (
        jaxstab.contact(
            HapticLoop(device=device, sample_time=PERIOD, delay=PERIOD),
            500.0,
            5.0,
            speed=0.1,
            duration=0.1,
        )
        for device in (whole, light.held_by(hand), unknown.held_by(hand))
    )
    assert both.penetration == pytest.approx(one.penetration, rel=1e-2)
    assert both.largest_force == pytest.approx(one.largest_force, rel=1e-2)
    assert struck.penetration < 0.1 * one.penetration


def test_a_scene_answers_with_the_worst_of_its_starts() -> None:
    contacts = simulate_contacts(scene_with())
    hard, soft = contacts.walls["hard"], contacts.walls["soft"]
    assert soft.contact == ContactKind.RESTS
    assert hard.contact in (ContactKind.BOUNCES, ContactKind.GROWS)
    assert not contacts.all_stable
    causes: dict[str, Any] = {"friction": 0.1, "encoder": 1e-5}
    runs = [
        jaxstab.contact(WINDOW, 1000.0, 10.0, **causes, push=push, speed=speed, phase=phase)
        for push, speed in [(1.0, 0.0), (0.0, 0.1), (1.0, 0.1)]
        for phase in (0.0, 0.25, 0.5, 0.75)
    ]
    resting = [one for one in runs if one.kind == ContactKind.RESTS]
    longest = max(float(one.time_to_rest) for one in resting)
    assert soft.time_to_rest == longest
    slowest = [float(one.penetration) for one in resting if one.time_to_rest == longest]
    assert np.isclose(soft.penetration, slowest, rtol=1e-12, atol=0.0).any()
    assert "at 0.1 m/s" in soft.worst_start
    assert soft.contact_is == "1 s, not proved"


def test_check_adds_the_simulated_contact_below_what_is_proved() -> None:
    check = check_walls(scene_with())
    assert check.walls["hard"].simulated == simulate_contacts(scene_with()).walls["hard"]
    lines = str(check).splitlines()
    assert lines.index("  simulated") > next(k for k, one in enumerate(lines) if "verdict" in one)
    table = tomllib.loads(SCENE)
    del table["contact"], table["device"]["friction"]
    assert check_walls(Scene.from_table(table)).walls["hard"].simulated is None


@pytest.mark.campaign
def test_ranges_are_simulated_at_their_lowest_hand_and_longest_delay() -> None:
    scene = scene_with(
        hand={"mass": [0.1, 0.3]}, controller={"delay": [1e-3, 2e-3], "max_force": 12.0}
    )
    soft = simulate_contacts(scene).walls["soft"]
    words = "the longest delay, held constant; hand and device at their lowest values"
    assert soft.contact_is.endswith(words)
    assert f"; {words})\n" in check_walls(scene).in_short()
    loop = HapticLoop(**HELD, hand_mass=0.1, delay=2e-3, velocity=Velocity.difference(window=0.02))
    runs = jaxstab.contact(loop,
        1000.0, 10.0, push=[1.0, 0.0, 1.0], speed=[0.0, 0.1, 0.1], friction=0.1,
        phase=np.array([0.0, 0.25, 0.5, 0.75])[:, None], encoder=1e-5, max_force=12.0, path=False,
    )  # fmt: skip
    assert soft.penetration in runs.penetration


def test_a_scene_may_gate_its_walls_by_the_force() -> None:
    hard = simulate_contacts(scene_with(contact={"speed": 0.0, "gate": "force"})).walls["hard"]
    starts = {"push": 1.0, "phase": np.array([0.0, 0.25, 0.5, 0.75]), "friction": 0.1}
    options = starts | {"encoder": 1e-5, "duration": 1.0, "path": False}
    by_force = jaxstab.contact(WINDOW, 5000.0, 30.0, gate="force", **options)
    by_position = jaxstab.contact(WINDOW, 5000.0, 30.0, **options)
    assert hard.largest_force in by_force.largest_force
    assert hard.largest_force not in by_position.largest_force


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"contact": {"push": 0.0, "speed": 0.0}}, "push and speed are 0, so nothing moves"),
        ({"contact": {"one_sided": 1.0}}, "one_sided is 1.0; give true or false"),
        ({"contact": {"gate": "side"}}, "gate is 'side'; give position, force"),
        ({"contact": {"gate": "force", "one_sided": False}}, "of a wall that only pushes"),
        ({"device": {"static_friction": 0.01}}, "static_friction is 0.01 beside a friction of 0.1"),
        ({"device": {"friction": -1.0}}, "friction is -1.0"),
    ],
)
def test_odd_scenes_are_refused(changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        scene_with(**changes)


def test_scenes_with_modes_actuators_and_grips_are_simulated() -> None:
    mode = {"frequency": 80.0, "damping_ratio": 0.01, "modal_mass": 0.5}
    scene = scene_with(
        device={"actuator": {"bandwidth": 200.0}, "modes": [mode]},
        hand={"mass": 1.0, "damping": 5.0, "stiffness": 300.0,
              "grip": {"stiffness": 2000.0, "damping": 4.0}},
        contact={"duration": 0.2},
    )  # fmt: skip
    soft = simulate_contacts(scene).walls["soft"]
    loop = HapticLoop(
        device=GENERAL, sample_time=PERIOD, delay=PERIOD, velocity=Velocity.difference(window=0.02)
    )
    runs = jaxstab.contact(loop,
        1000.0, 10.0, push=[1.0, 0.0, 1.0], speed=[0.0, 0.1, 0.1], friction=0.1,
        phase=np.array([0.0, 0.25, 0.5, 0.75])[:, None], encoder=1e-5, duration=0.2, path=False,
    )  # fmt: skip
    assert np.isclose(soft.penetration, runs.penetration, rtol=1e-12, atol=0.0).any()


def test_friction_without_a_start_meets_the_push_of_a_finger() -> None:
    table = tomllib.loads(SCENE)
    del table["contact"]
    scene = Scene.from_table(table)
    assert (scene.contact, scene.start) == (ContactTable(), (1.0, 0.1))  # N, m/s
    assert (
        simulate_contacts(scene).walls["soft"].worst_start.startswith("at 0.1 m/s, pushed with 1 N")
    )
    table["device"]["friction"] = 3.0
    assert Scene.from_table(table).start == (6.0, 0.1)  # it overcomes the friction
    del table["device"]["friction"]
    with pytest.raises(ValueError, match=r"contact is missing; give contact\.push"):
        simulate_contacts(Scene.from_table(table))


def with_contact(**contact: Any) -> Scene:
    return Scene.from_table(tomllib.loads(SCENE) | {"contact": contact})


def test_a_start_that_is_given_in_part_keeps_the_rest_of_the_default_one() -> None:
    """So a speed alone is pushed back to the wall, and a side alone is simulated as well."""
    assert with_contact(speed=0.5).start == (1.0, 0.5)
    assert with_contact(push=0.2).start == (0.2, 0.1)
    assert with_contact(push=0.0).start == (0.0, 0.1)
    table = tomllib.loads(SCENE.replace("mass", "inertia").replace("friction = 0.1\n", ""))
    assert Scene.from_table(table | {"contact": {"one_sided": False}}).start == (0.05, 1.0)


def test_the_approach_finds_what_a_push_from_rest_does_not() -> None:
    """Pushed from rest the device comes to rest; when it arrives at 0.1 m/s it bounces on."""
    causes, scene = {"friction": 0.1, "push": 1.0}, throwing(friction=0.1)
    assert jaxstab.contact(BARE, 3000.0, 2.0, **causes).kind == ContactKind.RESTS
    assert jaxstab.contact(BARE, 3000.0, 2.0, **causes, speed=0.1).kind == ContactKind.BOUNCES
    hard = simulate_contacts(scene).walls["hard"]
    assert (hard.contact, hard.worst_start) == (ContactKind.BOUNCES, "at 0.1 m/s, pushed with 1 N")


def throwing(friction: float, **contact: float) -> Scene:
    return Scene.from_table(
        {
            "device": {"mass": 0.25, "damping": 0.1, "friction": friction},
            "controller": {"sample_time": 1e-3, "delay": 1e-3},
            "walls": {"hard": {"stiffness": 3000.0, "damping": 2.0}},
            "contact": contact,
        }
    )


def test_a_wall_that_throws_off_what_pushes_is_not_at_rest() -> None:
    contacts = simulate_contacts(throwing(0.02, push=0.05, speed=0.3))
    assert contacts.walls["hard"].contact == ContactKind.OUTSIDE
    assert contacts.walls["hard"].worst_start == "at 0.3 m/s, pushed with 0.05 N"
    assert not contacts.all_stable


@pytest.mark.parametrize(
    "command", ["limits", pytest.param("guard", marks=pytest.mark.campaign), "contact"]
)
def test_a_joint_that_is_held_from_both_sides_needs_no_other_key(
    command: str, tmp_path: Path
) -> None:
    path = tmp_path / "joint.toml"
    path.write_text(SCENE.split("[contact]")[0] + "[contact]\none_sided = false\n")
    output = ["-o", tmp_path / "guard.h", "--cells", "1,1,8"] if command == "guard" else []
    answer = run(command, path, *output)
    assert answer.exit_code == int(command != "guard"), answer.stderr  # of the hard wall


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        (
            {"device": {"mass": 0.02, "damping": 2000.0}},
            "the device without a wall moves at 100 rad per sample",
        ),
        (
            {"device": {"modes": [{"frequency": 3e4, "damping_ratio": 0.02, "modal_mass": 0.5}]}},
            "the device without a wall moves at",
        ),
        (
            {"device": {"modes": [{"frequency": 300.0, "damping_ratio": 0.02,
                                   "modal_mass": -0.1}]}},
            "has no mass at its handle, or a negative one",
        ),
    ],
)  # fmt: skip
def test_check_proves_what_it_cannot_simulate(changes: dict[str, Any], reason: str) -> None:
    """The proofs do not depend on friction: they are those of the scene without it."""
    check = check_walls(scene_with(**changes))
    table = tomllib.loads(SCENE)
    table["device"] |= changes["device"]
    del table["contact"], table["device"]["friction"]
    proved = check_walls(Scene.from_table(table))
    for name, wall in check.walls.items():
        assert reason in wall.simulated
        assert wall.simulated.startswith("not simulated: ")
        del wall.values["simulated"]
        assert str(wall) == str(proved.walls[name])


def test_a_motion_without_an_end_has_no_size() -> None:
    """Pushed through a wall whose force is limited, only the duration ends the penetration."""
    scene = scene_with(controller={"max_force": 0.4})
    (wall, *_) = simulate_contacts(scene).walls.values()
    assert wall.contact == ContactKind.PUSHED_THROUGH
    assert 0.0 < wall.penetration < inf
    text = "\n".join(wall.lines())
    assert re.search(r"(?m)^penetration +unlimited$", text)
    assert wall.in_words(scene.units).startswith("pushed through the wall, whose force stays at ")


@pytest.mark.campaign
def test_a_motion_that_grows_has_the_size_that_it_reached() -> None:
    mode = {"frequency": 40.0, "damping_ratio": 0.05, "modal_mass": 0.5}
    table = {
        "device": {"mass": 0.3, "damping": 0.2, "modes": [mode]},
        "controller": {"sample_time": 1e-3, "delay": 1e-3},
        "walls": {"hard": {"stiffness": 1e5, "damping": 50.0}},
        "contact": {"push": 0.5, "speed": 1.0},
    }
    (wall,) = simulate_contacts(Scene.from_table(table)).walls.values()
    assert wall.contact == ContactKind.GROWS
    assert wall.largest_force < inf
    assert not re.search("unlimited", "\n".join(wall.lines()))


@pytest.mark.campaign
def test_contacts_are_said_to_be_of_one_constant_delay(tmp_path: Path) -> None:
    scene = scene_with(controller={"delay": [0.0, 1e-3]})
    answer = simulate_contacts(scene)
    words = "varies between 0 and 1 ms; the most recent sample that has arrived is used; here "
    words += "constant, the longest"
    assert f"the delay {words}\n" in str(answer)
    title = scene_figure(scene, answer).get_suptitle().replace("\n", " ")
    assert f"delay {words}" in title
    file = tmp_path / "scene.toml"
    file.write_text(SCENE, encoding="utf-8")
    mapped = run("contact", file, "--delay", "0:0.001", "-o", tmp_path / "map.nc", "--count", "2")
    assert f"the delay {words}." in mapped.stderr


def test_a_wall_that_cannot_be_simulated_leaves_the_others() -> None:
    table = tomllib.loads(SCENE)
    walls = table.pop("walls")
    whole = check_walls(Scene.from_table(table | {"walls": walls}))
    walls["damper"] = {"stiffness": 0.0, "damping": 5.0}
    check = check_walls(Scene.from_table(table | {"walls": walls}))
    assert "nothing holds the device" in check.walls.pop("damper").simulated
    assert str(check) == str(whole)


def test_the_map_of_a_scene_names_its_walls() -> None:
    figure = scene_figure(scene_with(), simulate_contacts(scene_with()))
    panel = figure.axes[0]
    assert {text.get_text() for text in panel.texts} == {"soft", "hard"}
    assert panel.get_xlim()[1] > 5000.0
