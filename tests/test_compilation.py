"""What meets a compiler: plain numbers never meet JAX at all, and the rest compiles few programs.

Each question is put to a fresh process, whose programs nobody else has compiled.
"""

import json
import os
import subprocess
import sys
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from calls import COMPUTING_CALLS, as_text, outcome

import jaxstab
from jaxstab.batches import compiled, compiler_options
from jaxstab.model.double_double import two_sum
from jaxstab.point import dominance

ROOT = Path(__file__).resolve().parents[1]

# No JAX array can be given to them: they take names, numbers, a HapticLoop and a HandRange.
WITHOUT_ARRAYS = {
    "limits_of",
    "regions_of",
    "tune_for_all",
    "trace_boundary",
    *(
        f"HapticLoop.{method}"
        for method in ("region", "limits", "tune", "robust_limit", "boundary", "passive_region")
    ),
}

WITH_FLINT = {  # loops, lines of walls and regions are in balls, filters in exact numbers
    *("amplitude", "limits_of", "margins", "paper.linear_validity"),
    *("regions_of", "robust_region", "stable_region", "tune_for_all"),
    *(f"HapticLoop.{walls}" for walls in ("amplitude", "jitter_margin", "margins", "oscillation")),
    *("settling_samples", "HapticLoop.settling_time", "paper.passive_region"),
    *(f"HapticLoop.{walls}" for walls in ("poles", "spectral_radius", "verdict", "worst_delays")),
    *(f"HapticLoop.{line}" for line in ("damping_limits", "stiffness_limits", "limits", "region")),
    *(f"HapticLoop.{line}" for line in ("damping_intervals", "stiffness_intervals", "intervals")),
    *("HapticLoop.boundary_distance", "HapticLoop.robust_limit", "HapticLoop.worst_hand"),
    *("contact", "HapticLoop.frequency_margins", "HapticLoop.is_usable", "HapticLoop.range_of"),
    *("HapticLoop.is_passive", "HapticLoop.passive_region"),
    *("HapticLoop.one_sided", "HapticLoop.one_sided_limit"),
    "HapticLoop.boundary",
    *(
        "HapticLoop.simulate",
        "HapticLoop.tune",
        "minimize_radius",
        "minimize_settling",
    ),
}


@pytest.mark.parametrize("name", COMPUTING_CALLS)
def test_callers_may_let_numpy_raise_its_errors(name: str) -> None:
    with np.errstate(all="raise"):
        assert not outcome(name).startswith("FloatingPointError")


WITHOUT_JAX = """
import json, sys

BLOCKED = sys.argv.pop(1).split()

class NoJax:
    def find_spec(self, name, *_):
        if name.partition(".")[0] in ("jax", "jaxlib", *BLOCKED):
            raise ImportError("JAX was asked for")

sys.meta_path.insert(0, NoJax())
from calls import outcome
print(json.dumps({name: outcome(name) for name in sys.argv[1:]}))
"""

IN_SINGLE_PRECISION = """
import json, sys
import jax.numpy as jnp
from calls import outcome

print(json.dumps({name: outcome(name, jnp.asarray) for name in sys.argv[1:]}))
"""


def printed_by(script: str, *words: str, **environment: str) -> Any:
    """What a script prints as JSON in a fresh process."""
    path = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
    completed = subprocess.run(
        [sys.executable, "-c", script, *words],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": path} | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert completed.returncode == 0, completed.stderr
    return json.loads(completed.stdout)


@cache
def without_jax() -> dict[str, str]:
    plain = sorted(COMPUTING_CALLS.keys() - WITH_FLINT)  # flint is for few
    answers: dict[str, str] = printed_by(WITHOUT_JAX, "flint", *plain)
    return answers | printed_by(WITHOUT_JAX, "", *sorted(WITH_FLINT))


@cache
def in_single_precision() -> dict[str, str]:
    return printed_by(IN_SINGLE_PRECISION, *sorted(COMPUTING_CALLS), JAX_ENABLE_X64="0")


TRACED_TWICE = """
import json
from collections import Counter
import jax, jax.numpy as jnp
import jaxstab

loop = jaxstab.HapticLoop(device_mass=0.2, device_damping=0.1, sample_time=1e-3)
questions = {
    "limits_of": lambda mass: jaxstab.limits_of(loop, device_mass=mass).stiffness,
    "verdict": lambda mass: loop.verdict(1e4 * mass, 5.0),
    "spectral_radius": lambda mass: loop.spectral_radius(1e4 * mass, 5.0).value,
}
traced = Counter()
for name, question in questions.items():

    def counted(mass):
        traced[name] += 1
        return question(mass)

    program = jax.jit(counted)
    for _ in range(2):
        program(jnp.array([0.2, 0.25]))
print(json.dumps(traced))
"""


@pytest.mark.campaign
def test_a_first_answer_inside_a_program_does_not_have_it_compiled_again() -> None:
    """As importing optimistix there does, which defines options of JAX."""
    assert set(printed_by(TRACED_TWICE, JAX_ENABLE_X64="1").values()) == {1}


@pytest.mark.parametrize("name", sorted(COMPUTING_CALLS.keys() - {"trace_boundary"}))
def test_plain_numbers_are_answered_without_jax_as_with_it(name: str) -> None:
    assert "JAX was asked for" not in without_jax()[name]
    assert without_jax()[name] == outcome(name)


@pytest.mark.parametrize("name", sorted(COMPUTING_CALLS.keys() - WITHOUT_ARRAYS))
def test_jax_arrays_are_refused_without_x64(name: str) -> None:
    kind, _, message = in_single_precision()[name].partition(": ")
    assert kind == "RuntimeError"
    assert "jax_enable_x64" in message
    assert "\n" not in message


def test_the_exceptions_are_names_of_functions_that_compute() -> None:
    assert set(COMPUTING_CALLS) >= WITHOUT_ARRAYS


# --------------------------------------------------------------------------- numbers of programs

# What a first call may compile at most, and each later one of another size. A number that falls
# is good news: put it here.
PROGRAMS = {
    "spectral_radius": (5, 0),
    "boundary_curve": (0, 0),
    "trace_boundary": (5, 0),  # one of ours; constants of optimistix, while it traces
    "verdict": (3, 0),
    "verdict of a grid": (3, 0),
    "verdict of hands": (2, 0),
    "radius of a large grid": (7, 0),
    "build_atlas": (4, 2),  # of fields, whose shape each build has of its own
}

COUNT_PROGRAMS = """
import json, tempfile
import jax
import numpy as np
import jaxstab
from jaxstab import AtlasSpec, FieldSpec, batches

# Verdicts and radii of these sizes are compiled at once, as after some such calls.
batches.pays = lambda program, size, many, shapes=(): size >= (
    many if many == batches.MANY_PLANTS else min(many, 30_000)
)

def walls(count):
    rng = np.random.default_rng(count)
    return rng.uniform(0.0, 0.3, count), rng.uniform(0.0, 0.9, count)

def hands(count):
    return {"gamma": np.full(count, 1e-3), "delta": np.full(count, 0.015), "delay": 1.0}

free = {"gamma": 0.0, "delta": 0.0, "delay": 2.0}

def trace(size):
    fixed = {"beta": 0.1, "gamma": 1e-3, "delta": 0.015, "delay": 1.0}
    axis = list(fixed)[size % 4]
    del fixed[axis]
    jaxstab.trace_boundary(("alpha", axis), ((-0.01, 0.2), (0.0, size / 10)), **fixed)

def write(size):
    fields = FieldSpec(alpha=size, beta=size)
    spec = AtlasSpec(gamma=[0.0, 1e-3], delta=[0.0, 0.015], delay=[0.0], rows=9, fields=fields)
    with tempfile.TemporaryDirectory() as folder:
        jaxstab.build_atlas(spec, folder + "/a.h5")

CALLS = {
    "verdict": (
        lambda size: jaxstab.verdict(*walls(size), **hands(size)), (33_000, 33_001, 34_000)
    ),
    "verdict of a grid": (
        lambda size: jaxstab.verdict(*np.ix_(*walls(size)), **free), (401, 402, 416)
    ),
    "verdict of hands": (
        lambda size: jaxstab.verdict(0.1, walls(size)[1], **hands(size), resolve="exact"),
        (66_000, 66_001, 68_000),
    ),
    "radius of a large grid": (
        # of which 513 to 4,096 points are left to the second try, a list of one length
        lambda size: jaxstab.spectral_radius(*np.ix_(*walls(size)), **free),
        (720, 721, 724),
    ),
    "spectral_radius": (
        lambda size: jaxstab.spectral_radius(*walls(size), **hands(size)),
        (50_000, 50_001, 51_000),
    ),
    "boundary_curve": (
        lambda size: jaxstab.boundary_curve(
            np.linspace(0.1, 3.0, size), gamma=1e-3, delta=0.015, delay=1.0
        ),
        (100_000, 131_000),
    ),
    "trace_boundary": (trace, (10, 11, 12)),
    "build_atlas": (write, (100, 99, 97)),
}
compiled = []
jax.monitoring.register_event_duration_secs_listener(
    lambda name, _, **__: compiled.append(name) if "backend_compile" in name else None
)
counts = {}
for name, (call, sizes) in CALLS.items():
    counts[name] = []
    for size in sizes:
        compiled.clear()
        call(size)
        counts[name].append(len(compiled))
print(json.dumps(counts))
"""


@cache
def programs() -> dict[str, list[int]]:
    # Compiled quickly rather than well: they are only counted.
    quick = "--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true"
    return printed_by(COUNT_PROGRAMS, JAX_ENABLE_X64="1", XLA_FLAGS=quick)


@pytest.mark.campaign
@pytest.mark.parametrize("name", PROGRAMS)
def test_no_more_programs_are_compiled_than_allowed(name: str) -> None:
    first, *others = programs()[name]
    assert first <= PROGRAMS[name][0]
    assert max(others) <= PROGRAMS[name][1]


@pytest.mark.campaign
def test_settings_for_the_code_of_users_change_no_answer_for_numpy() -> None:
    def answers() -> str:
        grid = np.linspace(-0.1, 1.0, 200), np.linspace(-0.1, 1.0, 200)[:, None]
        loop = {"gamma": 0.0, "delta": 0.015, "delay": 1.0}
        window, fixed = ((0.0, 3.0), (0.0, 0.3)), {"beta": 0.2, "gamma": 0.0, "delta": 0.015}
        return as_text(
            [
                jaxstab.verdict(*grid, **loop),
                jaxstab.spectral_radius(*grid, **loop),
                jaxstab.trace_boundary(("delay", "alpha"), window, **fixed),
            ]
        )

    expected = answers()
    with (
        jax.enable_x64(False),
        jax.debug_nans(True),
        jax.debug_infs(True),
        jax.numpy_dtype_promotion("strict"),
        jax.numpy_rank_promotion("raise"),
        jax.transfer_guard("disallow"),
    ):
        assert answers() == expected


ON_TWO_DEVICES = """
import jax, json
import numpy as np
import jaxstab
from jax.sharding import Mesh, NamedSharding, PartitionSpec

loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
stiffness = np.linspace(100.0, 1000.0, 4)
mesh = Mesh(np.array(jax.devices()), ("walls",))
sharded = jax.device_put(stiffness, NamedSharding(mesh, PartitionSpec("walls")))
assert len(sharded.devices()) == 2
answers = [
    [
        loop.settling_time(walls, 10.0).value,
        loop.amplitude(walls, 10.0, encoder=1e-5).position,
        loop.damping_limits(walls),
        loop.margins(walls, 10.0).stiffness_gain,
    ]
    for walls in (stiffness, sharded)
]
print(json.dumps([np.allclose(*pair, rtol=1e-12, atol=0.0) for pair in zip(*answers)]))
"""


@pytest.mark.campaign
def test_arrays_on_several_devices_are_answered_as_those_of_numpy() -> None:
    devices = "--xla_force_host_platform_device_count=2"
    found = printed_by(ON_TWO_DEVICES, JAX_ENABLE_X64="1", XLA_FLAGS=devices)
    assert found == [True] * 4


# ------------------------------------------------------------------------- the cache of programs

COMPILED_WITH = """
import sys
import jaxstab
{setting}
assert "jax" not in sys.modules
import jax

missing = []
jax.monitoring.register_event_listener(
    lambda name, **_: missing.append(name) if name.endswith("cache_misses") else None
)
for factor in (2.0, 3.0):
    jax.jit(lambda x: factor * x)(1.0)
print(len(missing))
"""


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("setting", "environment"),
    [
        ("jaxstab.use_compilation_cache()", {}),
        ("jaxstab.use_compilation_cache()", {"JAX_COMPILATION_CACHE_DIR": "{folder}/of user"}),
        ("jaxstab.use_compilation_cache(r'{folder}/given')", {}),
    ],
    ids=["default", "environment", "given"],
)
def test_a_second_process_finds_all_that_the_first_one_compiled(
    setting: str, environment: dict[str, str], tmp_path: Path
) -> None:
    cleared = {"XDG_CACHE_HOME": str(tmp_path), "JAX_COMPILATION_CACHE_DIR": ""}
    environment = cleared | {
        name: value.format(folder=tmp_path) for name, value in environment.items()
    }
    script = COMPILED_WITH.format(setting=setting.format(folder=tmp_path))
    assert printed_by(script, **environment) == 2
    assert printed_by(script, **environment) == 0
    assert len(list(tmp_path.iterdir())) == 1


def test_a_cache_is_switched_on_after_the_first_program_too(tmp_path: Path) -> None:
    options = ("compilation_cache_dir", "persistent_cache_min_compile_time_secs")
    before = os.environ["JAX_COMPILATION_CACHE_DIR"]
    jax.jit(lambda x: x + 5.0)(1.0)
    try:
        assert jaxstab.use_compilation_cache(tmp_path / "new") == tmp_path / "new"
        jax.jit(lambda x: x + 6.0)(1.0)
        assert any((tmp_path / "new").iterdir())
        assert [getattr(jax.config, f"jax_{name}") for name in options] == [
            str(tmp_path / "new"), 0.0
        ]  # fmt: skip
    finally:
        jaxstab.use_compilation_cache(before)


COMMAND = """
import jax
from jaxstab.app.cli import main, options
from jaxstab.app.scene import scene

def computing(kind):
    options.keep_programs()
    jax.jit(lambda x: x + 7.0)(1.0)
    return {}

scene.presets = computing
main.main(["scene", "presets"])
"""


def test_a_damaged_program_is_compiled_again_and_the_remedy_is_named(tmp_path: Path) -> None:
    told = []
    for _ in range(2):
        command = [sys.executable, "-c", COMMAND]
        given: Any = {"env": os.environ | {"JAX_COMPILATION_CACHE_DIR": str(tmp_path)}}
        done = subprocess.run(command, capture_output=True, text=True, check=False, **given)
        assert done.returncode == 0
        told.append(done.stderr)
        for entry in tmp_path.glob("*-cache"):
            entry.write_bytes(entry.read_bytes()[:100])  # as a full disk leaves it
    assert told[0] == ""
    assert told[1].endswith(f"; delete {tmp_path}.\n")
    assert told[1].count("\n") == 1


COUNTED_ON_A_PAGE = """
import contextlib, json, re, sys
import jax

compiled = []
jax.monitoring.register_event_duration_secs_listener(
    lambda name, _, **__: compiled.append(name) if "backend_compile" in name else None
)
import jaxstab
code = re.findall("^```python\\n(.*?)^```", open(sys.argv[1]).read(), re.DOTALL | re.MULTILINE)
counts = []
for lines in code:
    if "jax" in lines.split():
        compiled.clear()
        with contextlib.redirect_stdout(sys.stderr):
            exec(lines)
        counts.append(len(compiled))
print(json.dumps(counts))
"""


@pytest.mark.campaign
@pytest.mark.parametrize("page", ["README.md", "docs/mapper.md"])
def test_what_a_page_says_is_compiled_is(page: str) -> None:
    counts = printed_by(COUNTED_ON_A_PAGE, page, JAX_ENABLE_X64="1").pop()
    assert counts > 0


@pytest.fixture
def programs_run(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many points each call gave to XLA, of a kernel that NumPy computes up to 3,000 times."""
    given: list[int] = []

    def counted(function: Any, *arguments: Any, **options: Any) -> Any:
        given.append(max(map(np.size, arguments)))
        return function(*arguments, **options)

    monkeypatch.setattr("jaxstab.batches.in_float64", counted)
    return given


def test_xla_answers_once_numpy_has_computed_as_long_as_compiling_takes(
    programs_run: list[int],
) -> None:
    kernel = compiled(static=["power"], many=3000)(lambda x, *, power: x**power)
    for size in (1000, 1000, 999, 900, 255):  # of one program, of another shape, and few
        kernel(np.ones(size), power=2)
    assert programs_run == []
    kernel(np.ones(1001), power=3)
    assert programs_run == []
    kernel(np.ones(1001), power=2)
    assert programs_run == [1001]
    kernel(np.ones(1000), power=2)
    kernel(np.ones(3000), power=4)  # at once
    assert programs_run == [1001, 1000, 3000]


def test_a_folder_that_cannot_be_made_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file"):
        jaxstab.use_compilation_cache(tmp_path / "file" / "folder")


def test_options_that_a_release_of_jax_does_not_have_are_not_asked_for() -> None:
    known, unknown = {"xla_cpu_prefer_vector_width": 512}, {"xla_cpu_is_not_an_option": True}
    assert compiler_options(known | unknown) == known


@pytest.mark.parametrize("delay", [0.0, 2.0, 5.5])
def test_the_roots_of_a_dense_grid_are_corrected_and_proved_by_one_kernel(delay: float) -> None:
    """More than one write what they share to memory, and take two to four times as long."""
    loop = jax.tree.map(
        jax.numpy.asarray,
        dominance.loop_of([np.full(shape, 0.1) for shape in ((64, 1), (1, 64), (1,), (1,))], delay),
    )
    degree = jaxstab.model.polynomial_degree(delay)
    program = jax.jit(lambda t, loop: dominance.polished(t, loop, degree=degree, corrections=2))
    compiled = program.lower(np.full((64, 64), -0.1 + 0.1j), loop).compile().as_text()
    assert compiled[compiled.index("ENTRY") :].count(" fusion(") == 1


def test_compilers_leave_the_rounding_of_a_sum_as_it_is(rng: np.random.Generator) -> None:
    b = rng.normal(size=1000) * 2.0 ** rng.integers(-60, 60, 1000)
    constant = jax.jit(lambda b: two_sum(jax.numpy.full_like(b, 0.1), b))  # XLA moves constants
    totals, errors = map(np.asarray, constant(b))
    sums = [Fraction(total) + Fraction(error) for total, error in zip(totals, errors, strict=True)]
    assert sums == [Fraction(0.1) + Fraction(x) for x in b]
