"""The same bits from every process, whatever its threads and devices are."""

import os
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import jax
import numpy as np
import pytest

import jaxstab
from jaxstab.app.cli.options import processes
from jaxstab.model import by_name
from tests.truth.problems import PROBLEMS

DELAY = 0.0  # one, for each is compiled in each process
COUNT = 2**16 + 3  # enough for threads to share it, and no multiple of what they share it by
SOME = 257
OTHER_MACHINE = "--xla_force_host_platform_device_count=2 --xla_cpu_multi_thread_eigen=false"

Answers = dict[str, np.ndarray]


def loops() -> np.ndarray:
    """Hard loops of the registry, and loops around them; shape (4, loop)."""
    rng = np.random.default_rng(7)
    hard = np.array([problem.point[:4] for problem in PROBLEMS]).T
    around = hard[:, rng.integers(0, hard.shape[1], COUNT)]
    around = around * (1.0 + rng.choice([0.0, 1e-15, 1e-6, 0.3], around.shape))
    most = np.array([1e150, 1e150, 1e4, 1e3])[:, None]
    return np.clip(around, -most, most)


def answers(device: int) -> Answers:
    """What is said of the loops, on one of the devices of a process."""
    points = loops()
    with jax.default_device(jax.devices()[device]):
        radius = jaxstab.spectral_radius(**by_name(*points, DELAY))
        by_matrices = jaxstab.spectral_radius(
            **by_name(*points[:, :SOME], DELAY), method="companion"
        )
        curve = jaxstab.boundary_curve(
            np.linspace(0.1, 3.0, COUNT), gamma=0.001, delta=0.015, delay=DELAY
        )
        found = {
            "verdict": jaxstab.verdict(**by_name(*points, DELAY)),
            "radius": radius.value,
            "radius_error": radius.error,
            "radius by matrices": by_matrices.value,
            "its error": by_matrices.error,
            "alpha": curve[0],
            "beta": curve[1],
        }
        return {name: np.asarray(values) for name, values in found.items()}


@pytest.fixture(scope="module")
def here() -> Answers:
    return answers(0)


def _start_on_one_core() -> None:
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    jax.config.update("jax_enable_x64", True)


@pytest.fixture
def other_machine() -> Iterator[Executor]:
    """A process with one core, no threads within a computation, and two devices."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XLA_FLAGS", f"{os.environ.get('XLA_FLAGS', '')} {OTHER_MACHINE}")
        with ProcessPoolExecutor(1, get_context("spawn"), _start_on_one_core) as executor:
            yield executor


@pytest.mark.campaign
def test_threads_and_devices_change_no_bit(here: Answers, other_machine: Executor) -> None:
    there = other_machine.submit(answers, 1).result()
    for name, values in here.items():
        np.testing.assert_array_equal(there[name], values, name, strict=True)


@pytest.mark.campaign
def test_a_single_loop_and_a_few_get_the_same_bits_and_many_agree_with_them(here: Answers) -> None:
    points, some = loops(), np.arange(240).reshape(4, 3, 20)
    few = jaxstab.spectral_radius(**by_name(*points[:, some], DELAY))
    np.testing.assert_array_equal(
        jaxstab.verdict(**by_name(*points[:, some], DELAY)), here["verdict"][some]
    )
    for number in range(40):
        alone = jaxstab.spectral_radius(**by_name(*points[:, number], DELAY))
        assert jaxstab.verdict(**by_name(*points[:, number], DELAY)) == here["verdict"][number]
        assert alone.value == few.value.flat[number]
        assert alone.error == few.error.flat[number]
    # The many are computed in another way: their radii lie within the errors of both.
    difference = np.abs(few.value - here["radius"][some])
    assert np.all(~(difference > few.error + here["radius_error"][some]))
    assert np.isfinite(few.error).mean() > 0.9


def test_a_worker_process_that_sets_nothing_answers_plain_numbers_as_this_one() -> None:
    loop = by_name(0.1, 0.2, 0.001, 0.015, 1.0)
    with processes(1) as executor:
        verdict = executor.submit(jaxstab.verdict, **loop).result()
        radius = executor.submit(jaxstab.spectral_radius, **loop).result()
    assert verdict == jaxstab.verdict(**loop)
    assert (radius.value, radius.error) == tuple(jaxstab.spectral_radius(**loop)[:2])


@pytest.mark.campaign
def test_a_worker_process_that_sets_nothing_writes_the_same_atlas(tmp_path: Path) -> None:
    spec = jaxstab.AtlasSpec(
        gamma=[0.0, 0.001],
        delta=[0.0, 0.015],
        delay=[0.0],
        fields=jaxstab.FieldSpec(alpha=[0.0, 0.1], beta=[0.1, 0.2]),
    )
    jaxstab.build_atlas(spec, tmp_path / "here.h5")
    with processes(1) as executor:
        executor.submit(jaxstab.build_atlas, spec, tmp_path / "there.h5").result()
    assert (tmp_path / "there.h5").read_bytes() == (tmp_path / "here.h5").read_bytes()
