"""Dense grids whose arrays stay on the device: an accelerator beside two cores of its machine.

Each side is a process of its own, since JAX chooses the device when it starts: first one with two
cores of the CPU, then one with the device that JAX prefers, which is the CPU again where there is
no other. A call takes arrays of JAX and ends when its result is on the device. ``error`` is the
share of answers that the two sides prove and that contradict each other: verdicts of walls within
1e-16 to 1e-8 of the boundary, radii apart by more than both bounds.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.record import Row

DELAYS = (0.0, 1.0, 2.0, 5.0, 10.0, 20.0)
RADII = (1.0, 2.0, 5.0, 20.0)
MEASURE = "share of proved answers that contradict those of two cores"
PLANT = {"gamma": 1e-3, "delta": 0.015}
_CORES = 2
_HOST_POINTS, _DEVICE_POINTS = 4e6, 1e8
_SHARES = {"spectral_radius": 0.1}  # of the points
_JUDGED = 1 << 15
_WINDOW = 20  # samples

Call = Callable[[], Any]


def rows(small: bool) -> Iterator[Row]:
    with TemporaryDirectory() as name:
        host = _of_process(small, Path(name) / "host.npz", is_host=True)
        device = _of_process(small, Path(name) / "device.npz", is_host=False)
        with np.load(Path(name) / "host.npz") as known, np.load(Path(name) / "device.npz") as new:
            errors = {task: _contradictions(known[task], new[task]) for task in known}
    for one, other in zip(host, device, strict=True):
        task = f"{one['section']} {one['delay']:g}"
        ratio = one["seconds_per_point"] / other["seconds_per_point"]
        yield one | {"times_two_cores": 1.0}
        yield other | {"error": errors[task], "times_two_cores": ratio}


def _of_process(small: bool, path: Path, *, is_host: bool) -> list[Row]:
    """Return the rows of one side, as its process prints them."""
    environment = dict(os.environ, XLA_PYTHON_CLIENT_PREALLOCATE="false")
    if is_host:
        environment["JAX_PLATFORMS"] = "cpu"
    points = 4e4 if small else _HOST_POINTS if is_host else _DEVICE_POINTS
    command = [sys.executable, "-m", "benchmarks.accelerator", str(path), str(points)]
    cores = sorted(os.sched_getaffinity(0))[:_CORES]
    done = subprocess.run(
        [*command, *(map(str, cores) if is_host else ())],
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    rows: list[Row] = json.loads(done.stdout.splitlines()[-1])
    return rows


def _contradictions(known: np.ndarray, new: np.ndarray) -> float:
    if known.ndim == 1:  # codes of verdicts
        is_decided = (known != 3) & (new != 3)
        return float(np.mean(is_decided & (known != new)))
    (value, error), (own, bound) = known, new
    return float(np.mean(abs(value - own) > error + bound))


def main(path: str, points: str, *cores: str) -> int:
    """Measure one side: answers of judged points go to a file, rows to the standard output."""
    if cores:
        os.sched_setaffinity(0, set(map(int, cores)))
    import jax

    from benchmarks.timing import interleaved

    device = jax.devices()[0]
    name = f"{_CORES} cores" if cores else device.device_kind
    count = float(points)
    timed, judged = _tasks(count)
    np.savez(path, **{task: np.asarray(call()) for task, call in judged.items()})
    timings = interleaved(timed, budget=0.5 if count > 1e5 else 0.05, most=20)
    rows = []
    for task, timing in timings.items():
        section, delay = task.rsplit(" ", 1)
        own = int(_side(count, section) ** 2)
        per_point = {"seconds_per_point": timing.median / own}
        rows.append(
            timing.row(section, name, 0.0, MEASURE, delay=float(delay), points=own, **per_point)
        )
    print(json.dumps(rows))
    return 0


def _side(points: float, section: str) -> int:
    return int((points * _SHARES.get(section, 1.0)) ** 0.5)


def _tasks(points: float) -> tuple[dict[str, Call], dict[str, Call]]:
    """Return what is timed, and what is judged."""
    import jax
    import jax.numpy as jnp

    import jaxstab

    window = jaxstab.Velocity.difference(samples=_WINDOW)
    in_window = jax.jit(partial(jaxstab.verdict, **PLANT, delay=1.0, velocity=window))
    timed: dict[str, Call] = {}
    judged: dict[str, Call] = {}

    def grid(section: str, alpha: float, beta: float) -> tuple[Any, Any]:
        side = _side(points, section)
        return jnp.linspace(0.0, alpha, side), jnp.linspace(0.0, beta, side)[:, None]

    def radius(*gains: Any, delay: float) -> Any:
        answer = jaxstab.spectral_radius(*gains, **PLANT, delay=delay)
        return answer.value, answer.error

    for delay in DELAYS:
        verdict = partial(jaxstab.verdict, **PLANT, delay=delay)
        axes = grid("verdict", 2.0 / (1.0 + delay) ** 2, 1.5 / (1.0 + delay))
        timed[f"verdict {delay:g}"] = partial(verdict, *axes)
        judged[f"verdict {delay:g}"] = partial(verdict, *_near_boundary(delay))
    axes = grid("window of 20 samples", 0.01, 0.1)
    timed["window of 20 samples 1"] = partial(in_window, *axes)
    judged["window of 20 samples 1"] = partial(in_window, *_near_boundary(1.0, window))
    for delay in RADII:
        own = partial(radius, delay=delay)
        axes = grid("spectral_radius", 2.0 / (1.0 + delay) ** 2, 1.5 / (1.0 + delay))
        timed[f"spectral_radius {delay:g}"] = partial(own, *axes)
        judged[f"spectral_radius {delay:g}"] = partial(own, *_near_boundary(delay))
    return timed, judged


def _near_boundary(delay: float, velocity: Any = None) -> tuple[Any, Any]:
    import jax.numpy as jnp

    import jaxstab

    rng = np.random.default_rng(33)
    loop = jaxstab.HapticLoop(
        device_mass=1.0,
        device_damping=PLANT["delta"],
        hand_stiffness=PLANT["gamma"],
        sample_time=1.0,
        delay=delay,
        velocity=velocity,
    )
    region = loop.region()
    damping = region.most_damped.damping * rng.uniform(0.01, 0.99, _JUDGED // 64)
    limits = np.repeat(region.stiffness_limits(damping)[:, 1], 64)
    aside = rng.choice([-1.0, 1.0], limits.size) * 10.0 ** rng.uniform(-16.0, -8.0, limits.size)
    return jnp.asarray(limits * (1.0 + aside)), jnp.asarray(np.repeat(damping, 64))


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
