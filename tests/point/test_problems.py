"""Hard loops: what is computed converges, and never claims more than is true.

Each public function that takes a loop's five numbers meets every problem twice: was the answer
good, and did it keep what it promises? What is known not to be good stands in LIMITS.
"""

from collections.abc import Callable, Iterator
from functools import cache
from operator import attrgetter
from typing import Any

import numpy as np
import pytest
from calls import COMPUTING_CALLS
from mpmath import mp, mpc, mpf

import jaxstab
from jaxstab import Verdict
from jaxstab.model import by_name
from jaxstab.results import SettlingStatus
from tests.truth import loop as truth
from tests.truth import problems
from tests.truth.problems import PROBLEMS, Problem

# What does not converge, and why: a limit that is gone fails the test.
_LOST = "N(z) nearly vanishes: 40 and more of its bits are lost, so no bound of a radius is given"
_MULTIPLE = "half or a third of the digits of a multiple root are there in float64"
_DAMPED = "a strongly damped plant with small poles: not all digits of N(z) are known"
_BEYOND = "the promised accuracy ends at gamma = 40, delta = 10"
_CREEPS = "a pole that rounds to 1 neither decays nor oscillates: 0/0"
LIMITS: dict[str, dict[str, str]] = {
    "spectral_radius": {
        **{f"Nyquist, k = {k}, delta {d}": _LOST for k in (2, 4) for d in ("0", "0.001")},
        **{f"Nyquist, k = {k}, gains 1e{power}": _LOST for k in (2, 24) for power in (16, 32)},
        "triple root, the smallest radius of a free device": _MULTIPLE,
        **{f"nearly triple root, delay {delay}": _MULTIPLE for delay in (1, 2, 5)},
        **{f"double root at {r}, delay {d}": _MULTIPLE for r in ("0.9", "1") for d in (0, 0.5, 1)},
        "free device without wall: a double root at 1": _MULTIPLE,
        "gamma 10000, delta 1000": _DAMPED,
    },
    "dominant_mode": dict.fromkeys(
        (
            "Nyquist, k = 2, delta 0",
            "Nyquist, k = 4, delta 0",
            "root at z = 1, gamma 0.001, delay 0",
            "free device without wall: a double root at 1",
            "line z = 1, +1 ulp",
            "line z = 1, -1 ulp",
        ),
        _CREEPS,
    ),
    "characteristic_polynomial": {
        "gamma 10000, delta 1000": _BEYOND,
        "radius next to its bound, delay 2": _BEYOND,
    },
}

# Functions that are not asked here, and the tests that hold them against independent truth.
ELSEWHERE = {
    "companion_matrix": "test_model: a matrix of given coefficients",
    "evaluate_grid": "test_spectrum: the same answers in chunks",
    "is_schur": "test_polynomials", "radius": "test_polynomials",
    "minimize_radius": "test_tuning",
    "minimize_settling": "test_tuning", "margins": "test_margins",
    "paper.linear_alpha_limit": "test_criteria", "paper.linear_error": "test_criteria",
    "paper.linear_validity": "test_criteria", "paper.passive_region": "test_criteria",
    "stable_region": "test_region",
    "robust_region": "test_robust", "trace_boundary": "test_trace",
    "amplitude": "test_amplitude", "contact": "test_contact",
    "tune_for_all": "test_tuning_ranges", "limits_of": "test_batch", "regions_of": "test_batch",
}  # fmt: skip


class TestRegistry:
    def test_has_at_least_eighty_problems_of_different_names_and_points(self) -> None:
        assert len(PROBLEMS) >= 80
        assert len({p.name for p in PROBLEMS}) == len({p.point for p in PROBLEMS}) == len(PROBLEMS)

    def test_every_problem_says_why_it_is_hard_and_has_a_tag(self) -> None:
        assert all(p.tags and len(p.why.split()) > 3 for p in PROBLEMS)

    def test_every_limit_names_a_function_and_a_problem_that_there_are(self) -> None:
        assert set(LIMITS) <= {function for function, _ in ASSERTIONS}
        assert set().union(*LIMITS.values()) <= {p.name for p in PROBLEMS}

    @pytest.mark.parametrize("problem", PROBLEMS, ids=lambda p: p.name)
    def test_the_exact_answer_has_the_root_that_the_problem_was_built_from(
        self, problem: Problem
    ) -> None:
        if problem.root is not None:
            distance = min(abs(_centre(ball) - problem.root) for ball in problem.roots)
            # A rounding of the gains moves a root of multiplicity k by its k-th root.
            assert distance < 10 * mpf(2) ** -(52 / problem.multiplicity) * (1 + abs(problem.root))
        if problem.code is not None:
            assert problem.exact_code == problem.code

    @pytest.mark.parametrize("problem", PROBLEMS[::7], ids=lambda p: p.name)
    def test_the_exact_roots_are_those_of_the_reference_route(self, problem: Problem) -> None:
        try:
            others = truth.roots(*problem.point)
        except truth.NotCertain:
            pytest.skip("the reference route cannot tell the roots apart")
        for own, other in zip(problem.roots, others, strict=True):
            assert abs(abs(_centre(own)) - abs(other)) < mpf(10) ** -25

    def test_every_public_function_is_asked_here_or_elsewhere(self) -> None:
        here = {function for function, _ in ASSERTIONS}
        functions = {name for name in COMPUTING_CALLS if not name.startswith("HapticLoop.")}
        assert here | set(ELSEWHERE) == functions
        assert not here & set(ELSEWHERE)


# ------------------------------------------------------ functions of a loop, asked in one call


@cache
def answers(name: str, **options: Any) -> Any:
    """What a function says of all problems, in one call."""
    return attrgetter(name)(jaxstab)(**by_name(*problems.points().T), **options)


def _verdict_of(number: int, **options: Any) -> int:
    return int(np.asarray(answers("verdict", **options))[number])


def _is_true(code: int, problem: Problem) -> bool:
    """UNSTABLE means a root outside or on the circle."""
    on_circle = problem.exact_code == Verdict.UNDECIDED and code == Verdict.UNSTABLE
    return code in (problem.exact_code, Verdict.UNDECIDED) or on_circle


def verdict_is_good(number: int, problem: Problem) -> bool:
    code = _verdict_of(number, resolve="exact")
    return code != Verdict.UNDECIDED or problem.exact_code == Verdict.UNDECIDED


def verdict_is_honest(number: int, problem: Problem) -> bool:
    codes = _verdict_of(number), _verdict_of(number, resolve="exact")
    return all(_is_true(code, problem) for code in codes)


def spectral_radius_is_good(number: int, problem: Problem) -> bool:
    found = answers("spectral_radius")
    return float(found.error[number]) <= 1e-9 * float(found.value[number])


def spectral_radius_is_honest(number: int, problem: Problem) -> bool:
    low, high = problem.radius
    for method in ("fast", "companion"):
        found = answers("spectral_radius", method=method)
        value, error = mpf(float(found.value[number])), mpf(float(found.error[number]))
        no_claim = np.isnan(float(value)) and np.isinf(float(error))
        if not (no_claim or low - error <= value <= high + error):
            return False
    return True


def closed_loop_poles_are_good(number: int, problem: Problem) -> bool:
    """The largest pole has the modulus of the largest root, up to its sensitivity."""
    pole = abs(complex(answers("closed_loop_poles")[number, 0]))
    digits = 52 / (3 if {"multiple", "zero", "tiny"} & problem.tags else 2)
    return abs(pole - float(problem.radius[0])) <= 100 * 2.0**-digits * (1 + pole)


def closed_loop_poles_are_honest(number: int, problem: Problem) -> bool:
    """As many poles as roots, zeros after them, the largest first."""
    poles = np.abs(np.asarray(answers("closed_loop_poles")[number]))
    own = poles[: len(problem.roots)]
    return bool(np.all(np.diff(own) <= 1e-14 * own[0]) and not poles[len(own) :].any())


def dominant_mode_is_good(number: int, problem: Problem) -> bool:
    found = answers("dominant_mode")
    return bool(np.isfinite(found.damping_ratio[number]) and np.isfinite(found.frequency[number]))


def dominant_mode_is_honest(number: int, problem: Problem) -> bool:
    """The sign of the damping is that of the verdict, where this is clear."""
    ratio = float(answers("dominant_mode").damping_ratio[number])
    radius = float(problem.radius[0])
    return abs(radius - 1) < 1e-4 or (ratio > 0) == (radius < 1)


def settling_is_good(number: int, problem: Problem) -> bool:
    found = answers("settling_samples")
    quick = float(problem.radius[1]) < 0.97 and "long" not in problem.tags
    return not quick or int(found.status[number]) == SettlingStatus.SETTLED


def settling_is_honest(number: int, problem: Problem) -> bool:
    found = answers("settling_samples")
    status, value = int(found.status[number]), float(found.value[number])
    if status == SettlingStatus.SETTLED:
        return problem.exact_code == Verdict.STABLE and np.isfinite(value)
    if status == SettlingStatus.UNSTABLE:
        return problem.exact_code != Verdict.STABLE and np.isinf(value)
    return bool(np.isnan(value))


def polynomial_is_good(number: int, problem: Problem) -> bool:
    """Each coefficient within an ulp, or flushed; more is lost where N(z) nearly vanishes."""
    found = np.asarray(answers("characteristic_polynomial")[number])
    exact = truth.polynomial(*problem.point)
    allowed = 2.0**-20 if "cancellation" in problem.tags else 2.0
    return all(
        truth.ulps(float(value), coefficient) <= 2 or abs(float(value) - coefficient) <= (
            1e-300 + (allowed if allowed < 1 else 0) * abs(coefficient))
        for value, coefficient in zip(found, exact, strict=False)
    )  # fmt: skip


def polynomial_is_honest(number: int, problem: Problem) -> bool:
    """Monic, finite, of the degree that it says, with zeros at the end of lower degrees."""
    found = np.asarray(answers("characteristic_polynomial")[number])
    own = truth.degree(problem.delay) + 1
    return bool(found[0] == 1 and np.isfinite(found).all() and not found[own:].any())


def linear_condition_is_good(number: int, problem: Problem) -> bool:
    alpha, beta, gamma, delta, delay = map(mpf, problem.point)
    room = beta + delta - alpha * (mpf("0.5") + delay)
    is_clear = abs(room) > 1e-12 * (abs(beta) + delta + abs(alpha) * (1 + delay))
    expected = alpha + gamma > 0 and room > 0
    return not is_clear or bool(answers("paper.linear_condition")[number]) == expected


def routh_hurwitz_condition_is_good(number: int, problem: Problem) -> bool:
    """The third-order model t s^3 + (1 + delta t) s^2 + (beta + delta + gamma t) s + alpha + gamma
    is stable when all coefficients are positive and the inner product exceeds the outer one."""
    alpha, beta, gamma, delta, delay = map(mpf, problem.point)
    lag = mpf("0.5") + delay
    inner = (1 + delta * lag) * (beta + delta + gamma * lag)
    outer = lag * (alpha + gamma)
    is_clear = abs(inner - outer) > 1e-12 * (abs(inner) + abs(outer) + abs(alpha) * lag)
    expected = alpha + gamma > 0 and beta + delta + gamma * lag > 0 and inner > outer
    return not is_clear or bool(answers("paper.routh_hurwitz_condition")[number]) == expected


# ------------------------------------------- functions of a plant: gamma and delta, and a delay


_THETAS = np.array([0.01, 0.5, 2.5])


@cache
def plants() -> Any:
    gamma, delta, delay = problems.points().T[2:]
    return jaxstab.paper.plant_coefficients(gamma=gamma, delta=delta, delay=delay)


@cache
def curves() -> tuple[np.ndarray, np.ndarray]:
    gamma, delta, delay = (column[:, None] for column in problems.points().T[2:])
    return tuple(
        map(np.asarray, jaxstab.boundary_curve(_THETAS, gamma=gamma, delta=delta, delay=delay))
    )


def plant_coefficients_are_good(number: int, problem: Problem) -> bool:
    """Within 3 ulp where that is promised."""
    gamma, delta, delay = problem.point[2:]
    exact = truth.plant(gamma, delta, truth.split_delay(delay)[1] or 0)
    found = [float(value[number]) for value in plants()[:5]]
    return gamma > 40 or delta > 10 or all(
        truth.ulps(value, true) <= 3 or abs(value - true) < 1e-300
        for value, true in zip(found, exact[:5], strict=True)
    )  # fmt: skip


def boundary_curve_is_good(number: int, problem: Problem) -> bool:
    """A point of the curve has a root on the circle: p vanishes there, to rounding."""
    _, _, gamma, delta, delay = problem.point
    if gamma > 40 or delta > 10 or delay > 100:
        return True
    for place, theta in enumerate(_THETAS.tolist()):
        true = truth.boundary_point(theta, gamma, delta, delay)
        found = [float(axis[number, place]) for axis in curves()]
        size = abs(true[0]) + abs(true[1])
        allowed = (1e-2 if "cancellation" in problem.tags else 1e-13 * (1 + delay)) * size
        if not all(abs(f - t) <= allowed for f, t in zip(found, true, strict=True)):
            return False
    return True


def plus_line_is_good(number: int, problem: Problem) -> bool:
    _, beta, gamma, delta, delay = problem.point
    return (
        abs(float(jaxstab.paper.plus_line(beta, gamma=gamma, delta=delta, delay=delay)) + gamma)
        < 1e-300
    )  # denormals


def minus_line_is_good(number: int, problem: Problem) -> bool:
    """The gains on the line make p(-1) vanish."""
    _, beta, gamma, delta, delay = problem.point
    whole, fraction = truth.split_delay(delay)
    with mp.workdps(300):
        plant = truth.sampled_plant(gamma, delta, fraction if fraction else 0)
        found = float(jaxstab.paper.minus_line(beta, gamma=gamma, delta=delta, delay=delay))
        if plant.difference == 0:
            return not np.isfinite(found)
        offset = (-1) ** whole * (1 - plant.d1 + plant.d0) / plant.difference
        true = offset - 2 * mpf(beta)
        if abs(offset) > 1e300 or gamma > 40 or delta > 10:
            return True
        size = abs(offset) + 2 * abs(mpf(beta))
        return abs(found - true) <= (1e-3 if "nyquist" in problem.tags else 1e-14) * size


ASSERTIONS = {
    ("verdict", "converged"): verdict_is_good,
    ("verdict", "honest"): verdict_is_honest,
    ("spectral_radius", "converged"): spectral_radius_is_good,
    ("spectral_radius", "honest"): spectral_radius_is_honest,
    ("closed_loop_poles", "converged"): closed_loop_poles_are_good,
    ("closed_loop_poles", "honest"): closed_loop_poles_are_honest,
    ("dominant_mode", "converged"): dominant_mode_is_good,
    ("dominant_mode", "honest"): dominant_mode_is_honest,
    ("settling_samples", "converged"): settling_is_good,
    ("settling_samples", "honest"): settling_is_honest,
    ("characteristic_polynomial", "converged"): polynomial_is_good,
    ("characteristic_polynomial", "honest"): polynomial_is_honest,
    # These have no bound and no status of their own: to be right is all they promise.
    ("paper.plant_coefficients", "converged"): plant_coefficients_are_good,
    ("boundary_curve", "converged"): boundary_curve_is_good,
    ("paper.plus_line", "converged"): plus_line_is_good,
    ("paper.minus_line", "converged"): minus_line_is_good,
    ("paper.linear_condition", "converged"): linear_condition_is_good,
    ("paper.routh_hurwitz_condition", "converged"): routh_hurwitz_condition_is_good,
}


def _cases() -> Iterator[Any]:
    """What an assertion is asked about: all that it holds for at once, each known limit alone."""
    for (function, kind), holds in ASSERTIONS.items():
        limits = LIMITS.get(function, {}) if kind == "converged" else {}
        every = dict(enumerate(PROBLEMS))
        sound = {n: problem for n, problem in every.items() if problem.name not in limits}
        yield pytest.param(holds, sound, id=f"{function}, {kind}")
        for number in every.keys() - sound.keys():
            problem = every[number]
            marks = pytest.mark.xfail(reason=limits[problem.name])
            name = f"{function}, {kind}: {problem.name}"
            yield pytest.param(holds, {number: problem}, id=name, marks=marks)


@pytest.mark.parametrize(("holds", "asked"), list(_cases()))
def test_hard_loops_are_answered_well_and_honestly(
    holds: Callable[[int, Problem], bool], asked: dict[int, Problem]
) -> None:
    wrong = [f"{one.name}: {one.why}" for number, one in asked.items() if not holds(number, one)]
    assert not wrong


def _centre(ball: Any) -> mpc:
    return mpc(truth.as_mpf(ball.real.mid()), truth.as_mpf(ball.imag.mid()))
