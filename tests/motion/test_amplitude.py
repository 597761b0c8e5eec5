"""Proved amplitudes, against 50-digit impulse responses, worst signals and simulated runs."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from campaign import first, many
from mpmath import mp, mpf

import jaxstab
from jaxstab import Filter, HapticLoop, Velocity, amplitude
from jaxstab.app.pictures.scene import scene_figure
from jaxstab.app.scene import Scene, check_walls, tune_walls
from jaxstab.model import by_name
from jaxstab.results import AmplitudeStatus
from jaxstab.tuning import TuningStatus
from tests.truth import impulse
from tests.truth.disturbances import excess_of_runs, excess_of_signals, random_case

Case = tuple[dict[str, Any], list[impulse.Taps], list[impulse.Taps]]

CASES: dict[str, Case] = {
    "plain": ({}, [impulse.difference(1)], []),
    "window": ({"velocity": Velocity.difference(samples=20)}, [impulse.difference(20)], []),
    "low pass": (
        {"velocity": Velocity.low_pass(0.05, order=2)},
        [impulse.difference(1), *[impulse.low_pass(math.exp(-0.1 * math.pi))] * 2],
        [],
    ),
    "chain": (
        {
            "velocity": Velocity.difference(samples=3)
            * Filter.exponential(0.25)
            * Filter.average(samples=2),
            "position": Filter.low_pass(0.2),
        },
        [impulse.difference(3), impulse.smoothing(0.25), impulse.average(2)],
        [impulse.low_pass(math.exp(-0.4 * math.pi))],
    ),
}
LOOPS = [(0.004, 0.06, 1e-3, 0.015, 0.0), (0.004, 0.05, 0.0, 4e-4, 1.0), (0.01, 0.1, 0.1, 0.3, 2.5)]
LONG = 2600  # samples: what comes later is below 1e-9 of the sums


@pytest.mark.parametrize(
    ("case", "loop"), first([*zip(CASES, [*LOOPS, LOOPS[1]], strict=True), ("window", LOOPS[2])], 2)
)
def test_force_is_the_sum_of_moduli_to_50_digits(
    case: str, loop: tuple[float, float, float, float, float]
) -> None:
    """The force is held between samples, so its bound is the l1 norm itself."""
    filters, velocity, position = CASES[case]
    exact = impulse.ExactLoop(*loop, velocity, position)
    for size, cause in (({"encoder": 2.0}, {"error": 1.0}), ({"force_step": 2.0}, {"pushed": 1.0})):
        bound = amplitude(**by_name(*loop), **size, **filters)
        sums = exact.sums(LONG, **cause)
        assert int(bound.status) == AmplitudeStatus.PROVED
        with mp.workdps(impulse.DIGITS):
            assert 0 <= mpf(float(bound.force)) / sums[2] - 1 < 1e-6
            for value, total in zip(bound[:2], sums[:2], strict=True):
                assert 0 <= mpf(float(value)) / total - 1 < 0.35


def test_nothing_exceeds_a_bound_and_signals_reach_it(rng: np.random.Generator) -> None:
    """Friction, force and encoder, at the samples and between them, for any estimator."""
    for _ in range(2):
        excess, tight = excess_of_signals(*random_case(rng))
        assert 1.0 - 1e-5 < excess < 1.0 + 1e-9
        assert tight < 1.4


@pytest.mark.campaign
def test_no_run_with_a_quantised_encoder_and_force_exceeds_a_bound(
    rng: np.random.Generator,
) -> None:
    for _ in range(2):
        excess, share = excess_of_runs(*random_case(rng), 100, rng)
        assert excess < 1.0 + 1e-9
        assert share < 12.0


@pytest.mark.campaign
def test_nothing_exceeds_a_bound_in_many_loops(rng: np.random.Generator) -> None:
    for _ in range(many(100, small=3)):
        case = random_case(rng)
        assert excess_of_signals(*case)[0] < 1.0 + 1e-9
        assert excess_of_runs(*case, 500, rng)[0] < 1.0 + 1e-9


EDGE = 0.1318405943991979  # alpha, of the loop below


@pytest.mark.parametrize(("distance", "looser"), [(1e-3, 1e-3), (1e-6, 4.0)])
def test_next_to_the_boundary_is_still_proved(distance: float, looser: float) -> None:
    """The sum of moduli from the poles: what decays fast is left out after 1000 samples."""
    loop = EDGE * (1.0 - distance), 0.3, 0.0, 4e-4, 1.0
    exact = impulse.ExactLoop(*loop, [impulse.difference(1)])
    first = [float(x) for x, _, _ in exact.response(1000, error=1.0)]
    pole = complex(jaxstab.closed_loop_poles(**by_name(*loop))[0])
    radius = float(jaxstab.spectral_radius(**by_name(*loop)).value)
    angle, (a, b) = abs(np.angle(pole)), first[-2:]
    cosine, sine = a, (b / radius - a * math.cos(angle)) / math.sin(angle)
    later = np.arange(1, 1 << 22, dtype=float)
    moduli = np.abs(cosine * np.cos(angle * later) + sine * np.sin(angle * later))
    total = np.abs(first[:-1]).sum() + moduli.mean() * radius / (1.0 - radius)
    bound = amplitude(**by_name(*loop), encoder=2.0)
    assert total * (1.0 - 1e-4) < float(bound.position) < total * (1.1 + looser)


def test_at_the_boundary_and_beyond_nothing_is_proved() -> None:
    alpha = np.array([0.13, EDGE * (1.0 + 1e-9), 0.2, 10.0, 1e6])
    found = amplitude(alpha, 0.3, gamma=0.0, delta=4e-4, delay=1.0, encoder=1.0, friction=0.1)
    assert found.status.tolist() == [1, 2, 2, 2, 2]
    for values in found[:3]:
        assert np.isfinite(values).tolist() == [True, False, False, False, False]
    creeping = amplitude(0.0, 0.5, gamma=0.0, delta=0.0, delay=0.0, encoder=1.0)
    assert int(creeping.status) == AmplitudeStatus.NOT_PROVED
    assert "too close" in AmplitudeStatus(int(creeping.status)).words


def test_a_grid_has_the_bounds_of_each_loop() -> None:
    window = Velocity.difference(samples=4)
    alpha, delay = np.array([[0.002], [0.02], [0.5]]), np.array([0.0, 1.0, 1.5, 3.0])
    sizes = {"encoder": 1.0, "force_step": 0.01, "friction": np.array([0.0, 0.0, 1e-3, 2e-3])}
    together = amplitude(alpha, 0.1, gamma=1e-3, delta=0.01, delay=delay, **sizes, velocity=window)
    assert together.position.shape == (3, 4)
    for row, column in np.ndindex(3, 4):
        rubbing = {"friction": sizes["friction"][column]}
        wall = alpha[row, 0], 0.1, 1e-3, 0.01, delay[column]
        alone = amplitude(**by_name(*wall), **(sizes | rubbing), velocity=window)
        for one, other in zip(alone, together, strict=True):
            np.testing.assert_allclose(other[row, column], one, rtol=1e-6)


def test_disturbances_add_up_and_errors_of_a_position_are_alike() -> None:
    loop = 0.004, 0.06, 1e-3, 0.015, 1.3
    rounded, noisy = (
        amplitude(**by_name(*loop), encoder=2.0),
        amplitude(**by_name(*loop), noise=1.0),
    )
    assert rounded[:3] == noisy[:3]
    pushed = amplitude(**by_name(*loop), force_step=0.2, friction=0.01)
    both = amplitude(**by_name(*loop), encoder=2.0, force_step=0.2, friction=0.01)
    for one, other, total in zip(rounded[:3], pushed[:3], both[:3], strict=True):
        assert float(total) == pytest.approx(float(one + other), rel=1e-9)


def test_in_si_units_is_the_same_in_other_units() -> None:
    window = Velocity.difference(window=0.005)
    loop = HapticLoop(
        device_mass=0.25, device_damping=0.1, sample_time=1e-3, delay=1e-3, velocity=window
    )
    sizes = {"encoder": 1e-5, "force_step": 0.01, "friction": 0.2, "noise": 1e-6}
    found = loop.amplitude([1000.0, 2000.0], 20.0, **sizes)
    unit = 0.25 / 1e-6
    sizes |= {"force_step": 0.01 / unit, "friction": 0.2 / unit}
    samples = Velocity.difference(samples=5)
    wall = np.array([1000.0, 2000.0]) / unit, 20.0 / 250.0
    same = amplitude(*wall, **loop.slice, **sizes, velocity=samples)
    np.testing.assert_allclose(found.position, same.position, rtol=1e-9)
    np.testing.assert_allclose(found.velocity, same.velocity * 1e3, rtol=1e-9)
    np.testing.assert_allclose(found.force, same.force * unit, rtol=1e-9)


@pytest.mark.campaign
def test_jax_arrays_give_jax_arrays_also_when_compiled() -> None:
    def position(alpha: Any) -> Any:
        return amplitude(alpha, 0.06, gamma=1e-3, delta=0.015, delay=1.0, encoder=1.0).position

    walls = jnp.array([0.004, 0.005, 0.5])
    expected = position(np.asarray(walls))
    for answer in (position(walls), jax.jit(position)(walls), jax.vmap(position)(walls)):
        assert isinstance(answer, jax.Array)
        np.testing.assert_allclose(answer, expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("sizes", "message"),
    [
        ({}, "all 0; give what disturbs the loop"),
        ({"encoder": -1.0}, "encoder is -1.0; allowed are finite values >= 0"),
        ({"friction": np.nan}, "friction is nan"),
    ],
)
def test_refuses_what_is_no_disturbance(sizes: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        amplitude(0.004, 0.06, gamma=1e-3, delta=0.015, delay=1.0, **sizes)


SCENE = {
    "device": {"mass": 0.25, "damping": 0.1, "encoder": {"resolution": 1e-5}},
    "controller": {
        "sample_time": 1e-3,
        "delay_samples": 1.0,
        "velocity": {"window_samples": 20},
    },
    "walls": {
        "soft": {"stiffness": 1000.0, "damping": 10.0},
        "hard": {"stiffness": 5000.0, "damping": 30.0},
    },
}


def test_check_of_a_scene_tells_how_far_its_encoder_drives_it() -> None:
    answer = check_walls(Scene.from_table(SCENE))
    loop = HapticLoop(
        device_mass=0.25,
        device_damping=0.1,
        sample_time=1e-3,
        delay=1e-3,
        velocity=Velocity.difference(samples=20),
    )
    expected = loop.amplitude(1000.0, 10.0, encoder=1e-5)
    soft = answer.walls["soft"]
    assert soft.chatter_at_most == float(expected.position)
    assert soft.force_per_count == pytest.approx((1000.0 + 10.0 / 0.02) * 1e-5, rel=1e-12)
    chatter = [line for line in str(answer).splitlines() if "chatter" in line]
    ends = ["31.2 um", "0.06 N", "not proved", "not proved"]
    assert all(line.endswith(f"  {end}") for line, end in zip(chatter, ends, strict=True))
    assert answer.as_json()["walls"]["hard"]["chatter_at_most"] is None


@pytest.mark.campaign
def test_a_picture_draws_lines_of_equal_amplitude() -> None:
    table = SCENE | {"controller": {"sample_time": 1e-3, "delay_samples": 1.0}}
    scene = Scene.from_table(table)
    figure = scene_figure(scene, tune_walls(scene))
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "encoder of 10 um: chatters by less, proved" in labels
    names = [text.get_text() for text in figure.axes[0].texts]
    assert "10 um" in names


def test_check_of_hands_takes_the_largest_and_of_rotation_the_units() -> None:
    device = {"inertia": 2.5e-4, "damping": 1e-4, "encoder": {"resolution": 1e-4}}
    hand = {"inertia": [0.0, 1e-4]}
    walls = {"stop": {"stiffness": 1.0, "damping": 0.01}}
    scene = SCENE | {"device": device, "hand": hand, "walls": walls}
    text = str(check_walls(Scene.from_table(scene)))
    assert "urad" in text
    assert "N m\n" in text
    assert "the worst of 2 hands" in text


def test_a_scene_refuses_what_is_no_resolution() -> None:
    device = SCENE["device"] | {"encoder": {"resolution": 0.0}}
    with pytest.raises(ValueError, match=r"device.encoder.resolution is 0.*give a finite number"):
        Scene.from_table(SCENE | {"device": device})


@pytest.mark.campaign
@pytest.mark.parametrize("goal", ["settling", "radius"])
def test_the_fastest_calm_wall_is_not_beaten_by_a_grid(goal: Any) -> None:
    loop = HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3, delay=1e-3)
    limit = 8e-6
    free, calm = loop.tune(goal, encoder=1e-5), loop.tune(goal, encoder=1e-5, chatter=limit)
    assert free.chatter > limit >= calm.chatter
    wall = calm.stiffness, calm.damping
    amplitude = float(loop.amplitude(*wall, encoder=1e-5).position)
    assert calm.chatter == pytest.approx(amplitude, rel=1e-9)
    stiffness, damping = np.linspace(200.0, 12_000.0, 60)[:, None], np.linspace(5.0, 120.0, 60)
    is_calm = loop.amplitude(stiffness, damping, encoder=1e-5).position <= limit
    if goal == "settling":
        times = np.asarray(loop.settling_time(stiffness, damping).value)
        assert free.settling_time < calm.settling_time <= times[is_calm].min() + 1e-9
    else:
        radii = np.asarray(loop.spectral_radius(stiffness, damping).value)
        assert free.radius < calm.radius <= radii[is_calm].min()


@pytest.mark.campaign
def test_tuning_keeps_to_a_limit_or_says_that_none_does() -> None:
    loop = HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3, delay=1e-3)
    assert loop.tune(encoder=1e-5, chatter=1.0) == loop.tune(encoder=1e-5)
    assert loop.tune(encoder=1e-5, chatter=1e-6).status == TuningStatus.NOT_CALM
    given = loop.tune(stiffness=8000.0, encoder=1e-5, chatter=1.2e-5)
    assert given.stiffness == pytest.approx(8000.0, rel=1e-12)
    assert given.chatter <= 1.2e-5
    with pytest.raises(TypeError, match="chatter is 1e-05 without encoder"):
        loop.tune(chatter=1e-5)


def test_tune_of_a_scene_keeps_to_its_limit() -> None:
    wanted = {"chatter": 1.2e-5}
    controller = {"sample_time": 1e-3, "delay_samples": 1.0}
    scene = SCENE | {"wanted": wanted, "walls": {}, "controller": controller}
    tuned = tune_walls(Scene.from_table(scene))
    rounded = tuned.least_settling.rounded
    assert rounded is not None
    assert rounded.chatter_at_most is not None
    assert rounded.chatter_at_most <= 1.2e-5
    assert "chatter at most" in str(tuned)
    device = {"mass": 0.25, "damping": 0.1}
    with pytest.raises(ValueError, match=r"wanted.chatter is 1.2e-05, but no encoder is known"):
        Scene.from_table(SCENE | {"wanted": wanted, "device": device})


def test_jax_refuses_derivatives_that_are_not_known() -> None:
    def position(alpha: jax.Array, encoder: jax.Array) -> jax.Array:
        return amplitude(alpha, 0.5, gamma=0.0, delta=0.015, delay=0.0, encoder=encoder).position

    wall, resolution = jnp.asarray(0.1), jnp.asarray(2.0)
    by_resolution = jax.grad(position, argnums=1)(wall, resolution)
    assert by_resolution == pytest.approx(float(position(wall, resolution)) / 2.0)
    with pytest.raises(ValueError, match="do not support JVP"):
        jax.grad(position)(wall, resolution)
