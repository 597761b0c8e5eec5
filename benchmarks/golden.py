"""Golden record: does today's code give the bits of the code that was recorded, answer by answer?

    python -m benchmarks golden --record     records the answers of the code as committed
    python -m benchmarks golden              compares, names what changed, and exits with 1 if so

Every public function that computes is called as ``benchmarks.calls`` calls it, with its numbers
drawn at random: hands from none to the stiffest, whole and fractional delays, walls in and around
the stable set, estimators, filters, devices with modes, ranges of hands. A question is one call.
Its seed is the name of the function, its form (plain numbers, NumPy arrays or JAX arrays) and its
number. The record has a short hash of each answer: of its floats (every NaN the same), integers
and texts.

For the first changed question of a function, the recorded commit is taken from git and asked in a
process of its own, so that both answers can be shown. Bits also depend on the machine: BLAS and XLA
choose their kernels by the CPU. The record names its machine, and a comparison says if it is
another one.
"""

import hashlib
import json
import os
import pickle
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from inspect import signature
from io import BytesIO
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np

import jaxstab
from benchmarks import record
from benchmarks.calls import COMPUTING_CALLS, OBJECTS
from jaxstab.arrays import leaves

ROOT = Path(__file__).resolve().parents[1]
PATH = record.RESULTS / "golden" / "golden.json"
ATLASES = ("haptic", "window")

Answer = list[np.ndarray | str]

_WALLS = 100  # walls, angles or hands in a question with arrays
_DIGITS = 6  # of a hash, in hexadecimal
_SEED = 20081012


class Counts(NamedTuple):
    """Numbers of questions: with plain numbers, with NumPy arrays, with JAX arrays."""

    plain: int
    arrays: int = 0
    jax: int = 0


FORMS = Counts._fields
_OF_WALLS = Counts(200, 200)  # 20,200 answers
COUNTS = dict.fromkeys(COMPUTING_CALLS, _OF_WALLS) | {
    # Compiled for arrays of JAX, about ten seconds each.
    "characteristic_polynomial": Counts(200, 200, 1),
    "spectral_radius": Counts(200, 200, 1),
    "verdict": Counts(200, 200, 1),
    # Regions, proofs and searches: as many as take a few seconds.
    "HapticLoop.amplitude": Counts(100, 2),
    "HapticLoop.boundary_distance": Counts(60, 20),
    "HapticLoop.contact": Counts(40, 2),
    "HapticLoop.damping_limits": Counts(60, 20),
    "HapticLoop.jitter_margin": Counts(100, 4),
    "HapticLoop.limits": Counts(100),
    "HapticLoop.margins": Counts(100, 2),
    "HapticLoop.region": Counts(100),
    "HapticLoop.robust_limit": Counts(8),
    "HapticLoop.settling_time": Counts(200, 100),
    "HapticLoop.stiffness_limits": Counts(60, 20),
    "HapticLoop.tune": Counts(3),
    "HapticLoop.worst_hand": Counts(60),
    "amplitude": Counts(200, 1),
    "contact_map": Counts(20, 2),
    "paper.linear_validity": Counts(100, 20),
    "margins": Counts(200, 8),
    "minimize_radius": Counts(60, 1),
    "minimize_radius_damping": Counts(20),
    "minimize_settling": Counts(6),
    "paper.passive_region": Counts(100),
    "robust_region": Counts(2),
    "settling_samples": Counts(200, 100),
    "stable_region": Counts(200),
    "trace_boundary": Counts(16),
    "tune_for_all": Counts(8),
}
"""Functions that are not named here are asked 20,000 walls, angles or hands."""
_QUICK = 40  # the part of the questions that a quick run asks
SLOW = {  # a question takes a second or so: a quick run leaves them out
    "HapticLoop.amplitude",
    "HapticLoop.margins",
    "HapticLoop.robust_limit",
    "HapticLoop.tune",
    "amplitude",
    "margins",
    "minimize_radius",
    "minimize_radius_damping",
    "minimize_settling",
    "robust_region",
    "trace_boundary",
    "tune_for_all",
}


@dataclass(frozen=True)
class Question:
    """One call of a public function: a number is the how manieth of its form."""

    name: str
    form: str
    number: int

    def answer(self) -> Answer:
        """Return the numbers and texts that the function answers, or the name of the error."""
        given, options = self.arguments
        try:
            answer = attrgetter(self.name)(jaxstab)(*given, **options)
            answer = list(answer) if isinstance(answer, Iterator) else answer
        except Exception as error:  # noqa: BLE001
            return [type(error).__name__]
        return [canonical(leaf) for leaf in leaves(answer)]

    @cached_property
    def arguments(self) -> tuple[list[Any], dict[str, Any]]:
        """The arguments of the call in ``benchmarks.calls``, their numbers drawn."""
        function = attrgetter(self.name)(jaxstab)
        given = list(COMPUTING_CALLS[self.name])
        options = given.pop() if isinstance(given[-1], dict) else {}
        names = list(signature(function).parameters)
        drawn = _Drawn(self)
        positional = [drawn.value(*pair) for pair in zip(names, given, strict=False)]
        named = {name: drawn.value(name, value) for name, value in options.items()}
        if "velocity" in names and self.form != "jax":
            named |= drawn.filters
        return positional, named

    def __str__(self) -> str:
        given, options = self.arguments
        words = [*map(_shown, given), *(f"{k}={_shown(v)}" for k, v in options.items())]
        return f"{self.name}({', '.join(words)})"


class _Drawn:
    """What is drawn for a question: one loop, and numbers that suit it."""

    def __init__(self, question: Question) -> None:
        name = question.name.removeprefix("paper.")
        key = crc32(f"{name} {question.form}".encode())
        self.rng = np.random.default_rng([_SEED, key, question.number])
        self.form = question.form
        self.delay = self._delay()
        self.is_one_hand = question.form == "plain" or question.number % 2 == 1

    def value(self, name: str, value: Any) -> Any:
        """Return what is drawn in place of a value of the call."""
        if isinstance(value, str):
            return self._object(value)
        if isinstance(value, tuple) and name in ("gamma", "delta"):
            low = float(self._numbers(name, ()))
            return low, low * float(self.rng.uniform(1.0, 1.5))
        if name == "delay":
            return self.delay
        if not isinstance(value, float | list):
            return value
        if self.form == "plain" or (name in ("gamma", "delta") and self.is_one_hand):
            return self._numbers(name, ()).tolist()
        numbers = self._numbers(name, (_WALLS,))
        if self.form == "jax":
            import jax.numpy as jnp

            return jnp.asarray(numbers)
        return numbers

    @cached_property
    def filters(self) -> dict[str, Any]:
        """Velocity estimator and position filter per sample, for two of five questions."""
        if self.rng.random() < 0.6:
            return {}
        position = self._filter(1.0) if self.rng.random() < 0.3 else None
        return {"velocity": self._velocity(1.0), "position": position}

    def _numbers(self, name: str, shape: tuple[int, ...]) -> np.ndarray:
        rng, scale = self.rng, 1.0 / (1.0 + self.delay)

        def spread(low: float, high: float) -> np.ndarray:
            return np.asarray(10.0 ** rng.uniform(low, high, shape))

        match name:
            case "alpha":
                return np.asarray(rng.uniform(-0.2, 1.0, shape) * spread(-1.5, 0.0) * scale**2)
            case "beta":
                return np.asarray(rng.uniform(-0.1, 2.0, shape) * spread(-1.0, 0.0) * scale)
            case "gamma" | "delta":
                firm, extreme = (12.0, 4.0) if name == "gamma" else (0.6, 3.0)
                kinds = np.zeros(shape), spread(-9.0, -1.0), rng.uniform(0.0, firm, shape)
                kind = np.searchsorted(_LIKELY, rng.random(shape))
                return np.choose(kind, [*kinds, spread(0.0, extreme)])
            case "theta":
                return np.asarray(rng.uniform(0.0, np.pi, shape))
            case "level":
                return np.asarray(rng.uniform(0.005, 0.1, shape))
            case "coefficients":
                others = rng.normal(size=(*shape, 5))
                return np.concatenate([np.ones((*shape, 1)), others], axis=-1)
            case "stiffness":  # in N/m
                return self._numbers("alpha", shape) * self._mass / self._period**2
            case "damping":  # in N s/m
                return self._numbers("beta", shape) * self._mass / self._period
            case "encoder" | "friction" | "force_step" | "force" | "push":
                return spread(-5.0, 0.0)
        raise ValueError(f"{name} is an argument that golden does not know; say how to draw it.")

    @property
    def _mass(self) -> float:
        return float(self._parts["device_mass"])

    @property
    def _period(self) -> float:
        return float(self._parts["sample_time"])

    def _delay(self) -> float:
        rng = self.rng
        whole = float(rng.integers(0, 4) if rng.random() < 0.8 else rng.integers(4, 16))
        kinds = 0.0, rng.uniform(), 10.0 ** rng.uniform(-9.0, -1.0)
        return whole + float(rng.choice(kinds, p=[0.5, 0.4, 0.1]))

    def _object(self, name: str) -> Any:
        match name:
            case "loop":
                return self.loop
            case "loops":
                return [self.loop, self._loop(float(self.rng.uniform(1.0, 1.5)))]
            case "hands":
                rng = self.rng
                return jaxstab.HandRange(
                    mass=(0.0, float(rng.uniform(0.1, 1.0))),
                    stiffness=(0.0, float(rng.uniform(10.0, 700.0))),
                    damping=(0.0, float(rng.uniform(0.1, 12.0))),
                )
        return OBJECTS[name]()

    @cached_property
    def loop(self) -> Any:
        """A loop in SI units."""
        return self._loop(1.0)

    @cached_property
    def _parts(self) -> dict[str, Any]:
        rng = self.rng
        period = float(rng.choice([1e-3, 2.5e-4]))
        parts = {
            "sample_time": period,
            "delay": float(min(self.delay, 4.0) * period),
            "device_mass": float(10.0 ** rng.uniform(-1.3, 0.5)),
            "device_damping": float(rng.choice([0.0, 10.0 ** rng.uniform(-2.0, 0.5)])),
        }
        if rng.random() < 0.4:
            parts |= {"hand_stiffness": float(rng.uniform(0.0, 700.0)), "hand_damping": 3.0}
        if rng.random() < 0.5:
            parts["velocity"] = self._velocity(period)
        if rng.random() < 0.2:
            parts["position"] = self._filter(period)
        return parts

    @cached_property
    def _modes(self) -> tuple[float, float] | None:
        """Frequency in Hz and modal mass in kg of a device with a mode, for one loop of five."""
        rng = self.rng
        drawn = float(10.0 ** rng.uniform(1.0, 2.5)), float(10.0 ** rng.uniform(-1.0, 1.0))
        return drawn if rng.random() < 0.2 else None

    def _loop(self, heavier: float) -> Any:
        parts = self._parts | {"device_mass": self._mass * heavier}
        if self._modes is not None:
            frequency, modal_mass = self._modes
            mode = jaxstab.Mode(frequency=frequency, damping_ratio=0.02, modal_mass=modal_mass)
            mass, damping = parts.pop("device_mass"), parts.pop("device_damping")
            parts = {name: part for name, part in parts.items() if not name.startswith("hand")}
            parts["device"] = jaxstab.Device.modes([mode], mass=mass, damping=damping)
        return jaxstab.HapticLoop(**parts)

    def _velocity(self, period: float) -> Any:
        rng = self.rng
        kinds = (
            jaxstab.Velocity.difference(int(rng.integers(1, 21))),
            jaxstab.Velocity.low_pass(float(rng.uniform(0.01, 0.4)) / period),
            jaxstab.Velocity.butterworth(float(rng.uniform(0.02, 0.4)) / period, order=2),
            jaxstab.Velocity.exponential(float(rng.uniform(0.05, 1.0))),
        )
        return kinds[rng.integers(len(kinds))]

    def _filter(self, period: float) -> Any:
        rng = self.rng
        kinds = (
            jaxstab.Filter.average(int(rng.integers(1, 9))),
            jaxstab.Filter.low_pass(float(rng.uniform(0.05, 0.4)) / period),
        )
        return kinds[rng.integers(len(kinds))]


_LIKELY = (0.2, 0.7, 0.9)  # up to here a hand is none, weak, firm; beyond it is extreme


def canonical(leaf: Any) -> np.ndarray | str:
    values = np.asarray(leaf)
    if values.dtype.kind in "biu":
        return values.astype(np.int64)
    if values.dtype.kind == "f":
        values = values.astype(np.float64)
        return np.where(np.isnan(values), np.nan, values)
    if values.dtype.kind == "c":
        values = values.astype(np.complex128)
        return canonical(np.stack([values.real, values.imag]))
    return str(leaf)


def hash_of(answer: Answer) -> str:
    digest = hashlib.sha256()
    for leaf in answer:
        if isinstance(leaf, str):
            digest.update(leaf.encode())
        else:
            digest.update(f"{leaf.dtype.kind}{leaf.shape}".encode() + leaf.tobytes())
    return digest.hexdigest()[:_DIGITS]


# -------------------------------------------------------------------------- recording, comparing


def questions(quick: bool = False) -> Iterator[Question]:
    """All questions, or the first ones of each function."""
    for name, counts in sorted(COUNTS.items()):
        for form, count in zip(FORMS, counts, strict=True):
            if quick and (form == "jax" or name in SLOW):
                continue
            asked = -(-count // _QUICK) if quick else count
            yield from (Question(name, form, number) for number in range(asked))


def hashes(asked: Iterable[Question]) -> dict[str, dict[str, str]]:
    """Return the hashes of answers, in a row for each function and form."""
    rows: dict[str, dict[str, str]] = {}
    for question in asked:
        row = rows.setdefault(question.name, {})
        with np.errstate(all="ignore"):
            row[question.form] = row.get(question.form, "") + hash_of(question.answer())
    return rows


def atlases() -> dict[str, dict[str, str]]:
    """Build the atlases of ``data/specs`` and return the hash of each of their arrays."""
    digests: dict[str, dict[str, str]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name in ATLASES:
            spec = jaxstab.AtlasSpec.from_file(ROOT / "data" / "specs" / f"{name}.toml")
            atlas = jaxstab.build_atlas(spec, Path(folder) / f"{name}.h5")
            arrays = atlas.table.arrays | (atlas.fields if atlas.has_fields else {})
            print(f"{name} atlas built", flush=True)
            digests[name] = {k: hash_of([canonical(v)]) for k, v in sorted(arrays.items())}
    return digests


class Change(NamedTuple):
    """The first question of a function and form whose answer is not the recorded one."""

    question: Question
    changed: int  # questions
    asked: int


def changes(recorded: dict[str, Any], found: dict[str, dict[str, str]]) -> Iterator[Change]:
    """Yield the first change of each function and form."""
    for name, rows in found.items():
        for form, row in rows.items():
            old = recorded.get(name, {}).get(form, "")
            starts = range(0, len(row), _DIGITS)
            differ = [
                start // _DIGITS
                for start in starts
                if old[start : start + _DIGITS] != row[start : start + _DIGITS]
            ]
            if differ:
                yield Change(Question(name, form, differ[0]), len(differ), len(starts))


def first_difference(old: Answer, new: Answer) -> str:
    """Say in which value two answers differ first."""
    if len(old) != len(new):
        return f"it had {len(old)} values and has {len(new)}"
    for number, (before, after) in enumerate(zip(old, new, strict=True)):
        if isinstance(before, str) or isinstance(after, str):
            if not (isinstance(before, str) and isinstance(after, str)) or before != after:
                return f"value {number} was {before!r} and is {after!r}"
        elif before.shape != after.shape:
            return f"value {number} had the shape {before.shape} and has {after.shape}"
        elif before.tobytes() != after.tobytes():
            bits = [np.atleast_1d(part).ravel().view(np.int64) for part in (before, after)]
            place = int(np.flatnonzero(bits[0] != bits[1])[0])
            was, is_now = (np.atleast_1d(part).ravel()[place].item() for part in (before, after))
            return f"value {number}, element {place}, was {was!r} and is {is_now!r}"
    return "they are the same when asked alone: the answer depends on what was asked before"


def recorded_answers(commit: str, asked: list[Question]) -> list[Answer | None] | None:
    """Return what the code of a commit answers; None where git does not have it.

    None, too, for the answer of a function that has another name there.
    """
    archive = ["git", "archive", commit, "jaxstab", "benchmarks", "data/presets"]
    tree = subprocess.run(archive, cwd=ROOT, capture_output=True, check=False)
    if tree.returncode != 0:
        return None
    script = (
        "import pickle, sys; from benchmarks.golden import Question\n"
        "asked = [Question(*key) for key in pickle.load(sys.stdin.buffer)]\n"
        "def answer(question):\n"
        "    try:\n"
        "        return question.answer()\n"
        "    except AttributeError:\n"
        "        return None\n"
        "answers = [answer(question) for question in asked]\n"
        "sys.stdout.buffer.write(pickle.dumps(answers))"
    )
    keys = [(question.name, question.form, question.number) for question in asked]
    with tempfile.TemporaryDirectory() as folder:
        with tarfile.open(fileobj=BytesIO(tree.stdout)) as archive_of_commit:
            archive_of_commit.extractall(folder, filter="data")
        completed = subprocess.run(
            [sys.executable, "-c", script],
            input=pickle.dumps(keys),
            cwd=folder,
            env=os.environ | {"PYTHONPATH": folder},
            stdout=subprocess.PIPE,
            check=True,
        )
    answers: list[Answer | None] = pickle.loads(completed.stdout)
    return answers


def take(path: Path = PATH) -> int:
    """Write the record of the code as committed."""
    if _git("status", "--porcelain", "jaxstab", "benchmarks", "data/specs"):
        raise SystemExit("jaxstab or benchmarks has changes that are not committed; commit them.")
    found = {
        "commit": _git("rev-parse", "HEAD"),
        "machine": record.machine(),
        "versions": record.versions(),
        "answers": hashes(questions()),
        "atlases": atlases(),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(path)
    return 0


def compare(quick: bool, path: Path = PATH) -> int:
    """Print what changed since the record, and return 1 if anything did."""
    if not path.exists():
        raise SystemExit(f"{path} does not exist; run `python -m benchmarks golden --record`.")
    recorded = json.loads(path.read_text(encoding="utf-8"))
    for name, now in (("machine", record.machine()), ("versions", record.versions())):
        differ = [k for k, v in recorded[name].items() if now.get(k) != v]
        for key in differ:
            print(f"note: {key} was {recorded[name][key]} and is {now.get(key)}; bits may differ")
    known = recorded["answers"]
    for name in sorted(set(COUNTS) - set(known)):
        print(f"note: {name} is not recorded yet")
    asked = (question for question in questions(quick) if question.name in known)
    found = list(changes(known, hashes(asked)))
    old = recorded_answers(recorded["commit"], [one.question for one in found]) if found else []
    if old is None:
        print(f"note: git does not have {recorded['commit']}; recorded values cannot be shown")
    for number, change in enumerate(found):
        print(f"{change.question.name}: {change.changed} of {change.asked} answers changed")
        print(f"  first: {change.question.form} {change.question.number}: {change.question}")
        new, before = change.question.answer(), old[number] if old else None
        if before is not None:
            print(f"  {first_difference(before, new)}")
    gone = sorted(set(recorded["answers"]) - set(COUNTS))
    for name in gone:
        print(f"{name}: recorded, and not asked any more")
    lines = [] if quick else list(_changed_arrays(recorded["atlases"], atlases()))
    print(*lines, sep="\n", end="\n" if lines else "")
    if found or gone or lines:
        return 1
    print("no answer changed")
    return 0


def _changed_arrays(old: dict[str, Any], new: dict[str, dict[str, str]]) -> Iterator[str]:
    for name, arrays in new.items():
        before = old[name]
        for key in sorted(before.keys() | arrays.keys()):
            if before.get(key) != arrays.get(key):
                yield f"{name} atlas: {key} changed"


def _git(*words: str) -> str:
    completed = subprocess.run(
        ["git", *words], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return completed.stdout.strip()


def _shown(value: Any) -> str:
    if isinstance(value, np.ndarray) and value.size > 3:
        return f"[{value.flat[0]!r}, ... {value.size} numbers]"
    return repr(value)
