"""Loops of two rates, against frames by another recursion, motions, and loops of one rate."""

from collections.abc import Iterator
from math import inf
from typing import Any, NamedTuple

import numpy as np
import pytest
from campaign import many
from scipy.linalg import expm

import jaxstab
from jaxstab import HapticLoop, Velocity, Verdict, two_rates

T = 1e-3
OMEGA = HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=T)


# -------------------------------------------------------------------- frames by position and speed
class Case(NamedTuple):
    """A device and two branches: numbers, and the loop that jaxstab makes of them."""

    mass: float
    damper: float
    spring: float
    every: int
    slow: str
    fast_late: int
    slow_late: int
    ramp: bool
    window: int
    fast_velocity: bool

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "Case":
        slow = str(rng.choice(["stiffness", "damping", "both"]))
        return cls(
            mass=float(10.0 ** rng.uniform(-1.3, 0.5)),
            damper=float(rng.choice([0.0, rng.uniform(0.0, 2.0)])),
            spring=float(rng.choice([0.0, rng.uniform(0.0, 800.0)])),
            every=int(rng.integers(1, 7)),
            slow=slow,
            fast_late=0 if slow == "both" else int(rng.integers(0, 4)),
            slow_late=int(rng.integers(0, 9)),
            ramp=bool(rng.random() < 0.3),
            window=int(rng.integers(1, 5)),
            fast_velocity=bool(slow != "stiffness" and rng.random() < 0.4),
        )

    @property
    def made(self) -> Any:
        loop = HapticLoop(
            device_mass=self.mass, device_damping=self.damper, hand_stiffness=self.spring,
            sample_time=T, delay=self.fast_late * T, velocity=Velocity.difference(self.window),
        )  # fmt: skip
        return two_rates(
            loop, self.every, slow=self.slow, slow_delay=self.slow_late * T, ramp=self.ramp,
            velocity="fast" if self.fast_velocity else "slow",
        )  # fmt: skip

    def frame(self, stiffness: float, damping: float) -> np.ndarray:
        """The matrix of one frame, by the position and the speed and queues of readings."""
        speeds = [-self.spring / self.mass, -self.damper / self.mass, 1.0 / self.mass]
        step = expm(T * np.array([[0.0, 1.0, 0.0], speeds, [0.0, 0.0, 0.0]]))
        n, w = self.every, self.window
        is_slow = {"K": self.slow != "damping", "B": self.slow != "stiffness"}
        places = w * (1 if not is_slow["B"] or self.fast_velocity else n)  # of a difference
        late = {name: self.slow_late if is_slow[name] else self.fast_late for name in "KB"}
        length = max(late.values()) + 2 * n + 1
        size = 2 + places + 2 * length
        forms = np.eye(size)
        x, v = forms[0], forms[1]
        positions = [*forms[2 : 2 + places]]  # the last one first
        readings = {
            name: [*forms[2 + places + k * length : 2 + places + (k + 1) * length]]
            for k, name in enumerate("KB")
        }
        for sample in range(n):
            velocity = (x - positions[places - 1]) / (places * T)
            for name, now in (("K", x), ("B", velocity)):
                if is_slow[name] and sample:
                    now = readings[name][0]  # what was read at the frame's beginning
                readings[name] = [now, *readings[name][:-1]]
            force = np.zeros(size)
            for name, gain in (("K", stiffness), ("B", damping)):
                value = readings[name][late[name]]
                if is_slow[name] and self.ramp:
                    within = (sample - late[name]) % n
                    before = readings[name][late[name] + within + 1]
                    value = before + (value - before) * (within + 1) / n
                force = force - gain * value
            positions = [x, *positions[:-1]]
            x, v = (step[row, 0] * x + step[row, 1] * v + step[row, 2] * force for row in (0, 1))
        return np.array([x, v, *positions, *readings["K"], *readings["B"]])

    def radius(self, stiffness: float, damping: float) -> float:
        """Of the frame; of a free device at K = 0 without the drift."""
        roots = np.abs(np.linalg.eigvals(self.frame(stiffness, damping)))
        return float(np.max(roots))


def wrong(seed: int) -> Iterator[str]:
    """Ends of a row of the slow gain that the frames deny, and verdicts beside them."""
    rng = np.random.default_rng([863, seed])
    case = Case.drawn(rng)
    made = case.made
    names = ["stiffness", "damping"]
    slow = "stiffness" if case.slow == "both" else case.slow
    fast = names[slow == "stiffness"]
    size = {
        "stiffness": case.mass / (case.every * T) ** 2 / (1.0 + case.slow_late),
        "damping": case.mass / (case.every * T) / (1.0 + case.slow_late),
    }
    given = float(size[fast] * 10.0 ** rng.uniform(-2.0, 0.0))
    row = made.intervals(**{fast: given})
    if row.status.name != "PROVED":
        yield f"{seed} {case}: {row.status.name}"
    tried = [*(size[slow] * 10.0 ** rng.uniform(-3.0, 0.5, 6))]
    for low, high in row.intervals:
        for end, way in ((low.value, 1.0), (high.value, -1.0)):
            if abs(end) < inf and end != 0.0:
                tried += [end + way * share * abs(end) for share in (1e-6, -1e-6, 1e-2, -1e-2)]
    for gain in tried:
        inside = any(low.value < gain < high.value for low, high in row.intervals)
        pair = {slow: float(gain), fast: given}
        radius = case.radius(**pair)
        if abs(radius - 1.0) > 1e-11 and inside != (radius < 1.0):
            yield f"{seed} {case}: {pair} has {radius!r}, inside {inside}"
        code = made.verdict(**pair)
        if code != Verdict.UNDECIDED and inside != (code == Verdict.STABLE):
            yield f"{seed} {case}: {pair} is {code!r}, inside {inside}"


@pytest.mark.parametrize("seed", range(25))
def test_rows_end_where_frames_of_another_recursion_have_a_root_on_the_circle(seed: int) -> None:
    assert list(wrong(seed)) == []


@pytest.mark.campaign
def test_no_row_of_random_loops_is_denied_by_frames() -> None:
    assert [text for seed in range(many(300, small=60)) for text in wrong(1000 + seed)] == []


# ------------------------------------------------------------------------------------ one rate, too
def test_frames_of_one_sample_are_the_loop_of_one_rate() -> None:
    loop = HapticLoop(
        device_mass=0.25, device_damping=0.1, hand_stiffness=100.0, sample_time=T, delay=2 * T,
        velocity=Velocity.low_pass(60.0),
    )  # fmt: skip
    for slow in ("stiffness", "damping"):
        made = two_rates(loop, 1, slow=slow, slow_delay=2 * T)
        fast = {"stiffness": {"damping": 15.0}, "damping": {"stiffness": 900.0}}[slow]
        [(low, high)] = made.intervals(**fast).intervals  # type: ignore[union-attr, arg-type]
        [(least, most)] = loop.intervals(**fast).intervals  # type: ignore[arg-type]
        assert [low.value, high.value] == pytest.approx([least.value, most.value], rel=1e-12)


@pytest.mark.parametrize("samples", [0, 1, 3, 7])
def test_both_slow_is_the_loop_at_the_slow_rate_delays_between_its_samples_too(
    samples: int,
) -> None:
    estimator = Velocity.difference(2)
    loop = HapticLoop(device_mass=0.3, device_damping=0.2, sample_time=T, velocity=estimator)
    slow = HapticLoop(
        device_mass=0.3, device_damping=0.2, sample_time=4 * T, delay=samples * T,
        velocity=estimator,
    )  # fmt: skip
    made = two_rates(loop, 4, slow_delay=samples * T)
    found, known = made.limits(), slow.limits()
    assert found.first == pytest.approx(known.stiffness, rel=1e-9)
    assert found.second == pytest.approx(known.damping, rel=1e-9)
    margin = made.frequency_margins(stiffness=200.0, damping=3.0).phase.value
    assert margin == pytest.approx(slow.frequency_margins(200.0, 3.0).phase.value, rel=1e-9)


# ----------------------------------------------------------------------------------- worked numbers
@pytest.mark.parametrize(
    ("every", "slow", "late", "fast", "ends"),
    [
        (5, "stiffness", 0, 5.0, (0.0, 2066.0803546)),
        (5, "stiffness", 0, 20.0, (0.0, 8490.0242001)),
        (5, "stiffness", 5, 5.0, (0.0, 697.97063899)),
        (5, "stiffness", 5, 20.0, (0.0, 2947.5208669)),
        (16, "stiffness", 0, 5.0, (0.0, 673.84788555)),
        (16, "stiffness", 16, 20.0, (0.0, 1053.9811148)),
        (5, "damping", 0, 2000.0, (1.0165153951, 90.512784386)),
    ],
)
def test_a_wall_of_two_rates(
    every: int, slow: str, late: int, fast: float, ends: tuple[float, float]
) -> None:
    given = {"damping" if slow == "stiffness" else "stiffness": fast}
    made = two_rates(OMEGA, every, slow=slow, slow_delay=late * T)
    [(low, high)] = made.intervals(**given).intervals  # type: ignore[union-attr, arg-type]
    assert [low.value, high.value] == pytest.approx(ends, rel=1e-9, abs=1e-30)


def test_a_ramp_in_stairs_is_later_by_half_a_period_and_not_by_one() -> None:
    held, ramp = (
        two_rates(OMEGA, 16, ramp=ramp).intervals(damping=9.0).intervals[0][1].value  # type: ignore[union-attr]
        for ramp in (False, True)
    )
    assert ramp == pytest.approx(284.46716093, rel=1e-9)
    later, latest = (
        HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=16 * T, delay=late * T)
        .intervals(damping=9.0)
        .intervals[0][1]
        .value
        for late in (8, 16)
    )
    assert latest < later < ramp < held
    assert ramp - later < 0.2 * (ramp - latest)


def test_motions_decay_just_inside_of_the_limit_and_grow_beyond_it() -> None:
    case = Case(0.25, 0.1, 0.0, 5, "stiffness", 1, 5, False, 3, fast_velocity=False)
    [(_, high)] = case.made.intervals(damping=12.0).intervals
    for share, decays in ((0.98, True), (1.02, False)):
        frame = case.frame(share * high.value, 12.0)
        first, last = (np.abs(np.linalg.matrix_power(frame, n)).max() for n in (2000, 4000))
        assert (last < 0.5 * first) == decays
        assert (last > 2.0 * first) != decays


def test_limits_are_a_row_that_is_proved() -> None:
    made = two_rates(OMEGA, 5, slow="stiffness", slow_delay=5 * T)
    found = made.limits()
    assert isinstance(found, jaxstab.results.RateLimits)
    for text in repr(found).splitlines()[1:]:
        numbers = [float(word) for word in text.split() if word[0].isdigit()]
        pair = numbers if "largest  stiffness" in text else numbers[::-1]
        assert made.verdict(*pair) == Verdict.STABLE
    beyond = made.verdict(1.0001 * found.stiffness, found.at_damping)
    assert beyond == Verdict.UNSTABLE
    rng = np.random.default_rng(5)
    for damping in rng.uniform(0.0, 1.2 * found.damping, 40).tolist():
        tops = [end.value for _, end in made.intervals(damping=damping).intervals]  # type: ignore[union-attr]
        assert max(tops, default=0.0) <= found.stiffness * (1.0 + 1e-9)


# ---------------------------------------------------------------------------------------- refusals
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"every": 16.67}, "every is 16.67; give a whole number of samples: .* 16 and 17"),
        ({"every": 0}, "every is 0"),
        ({"every": 5, "slow": "position"}, "slow is 'position'"),
        ({"every": 5, "slow_delay": 2.5e-4}, "slow_delay is 0.00025 s, 0.25 samples"),
        ({"every": 5, "slow_delay": -1.0}, "slow_delay is -1"),
        ({"every": 5, "slow": "stiffness", "velocity": "fast"}, 'velocity is "fast"'),
    ],
)
def test_what_is_no_frame_is_refused(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        two_rates(OMEGA, **arguments)


def test_a_fast_delay_needs_a_fast_force_and_whole_samples() -> None:
    late = HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=T, delay=T)
    with pytest.raises(ValueError, match="no force is fast; give it as slow_delay"):
        two_rates(late, 5)
    between = HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=T, delay=0.5 * T)
    with pytest.raises(ValueError, match=r"0\.5 samples"):
        two_rates(between, 5, slow="damping")
    with pytest.raises(TypeError, match="give damping"):
        two_rates(OMEGA, 5, slow="stiffness").intervals(stiffness=100.0)  # type: ignore[union-attr, call-arg]
