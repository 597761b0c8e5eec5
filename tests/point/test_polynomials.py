"""Any polynomials: all roots inside, and the largest one, against fractions and mpmath."""

from decimal import Decimal
from fractions import Fraction
from typing import Any

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from campaign import first, many

import jaxstab
from jaxstab import Verdict
from jaxstab.results import RadiusStatus

Polynomial = list[float]


def has_roots_inside(p: Polynomial) -> bool:
    """Schur and Cohn in fractions: the truth about float64 coefficients."""
    own = [Fraction(c) / Fraction(p[0]) for c in p]
    while len(own) > 1:
        k = own[-1]
        if abs(k) >= 1:
            return False
        own = [(a - k * b) / (1 - k * k) for a, b in zip(own[:-1], own[:0:-1], strict=True)]
    return True


def drawn(rng: np.random.Generator, degree: int) -> Polynomial:
    """Roots anywhere, next to the circle, or close together; any scale and sign."""
    pairs, spread = degree // 2, 10.0 ** rng.uniform(-9.0, 0.3)
    centre = rng.uniform(0.0, 1.0) if rng.integers(2) else 1.0
    moduli = np.abs(centre + spread * rng.standard_normal(pairs))
    roots = moduli * np.exp(1j * rng.uniform(0.0, np.pi, pairs))
    alone = [float(rng.uniform(-1.1, 1.1))] * (degree % 2)
    scale = float(rng.choice([-1.0, 1.0])) * 10.0 ** rng.uniform(-9.0, 9.0)
    return (scale * np.poly([*roots, *roots.conj(), *alone]).real).tolist()


def radius_of(p: Polynomial) -> mpmath.mpf:
    with mpmath.workdps(60):
        rising = [mpmath.mpf(c) for c in p[::-1]]
        roots = mpmath.polyroots(rising, maxsteps=500, extraprec=800, asc=True)
        return max(abs(root) for root in roots)


@pytest.mark.parametrize("degree", [1, 3, 4, 12])
def test_verdicts_are_those_in_fractions(degree: int) -> None:
    rng = np.random.default_rng(degree)
    polynomials = [drawn(rng, degree) for _ in range(60)]
    truth = [Verdict.STABLE if has_roots_inside(p) else Verdict.UNSTABLE for p in polynomials]
    assert jaxstab.is_schur(polynomials).tolist() == truth
    in_jax = np.asarray(jax.jit(jaxstab.is_schur)(jnp.array(polynomials)))
    is_said = in_jax != Verdict.UNDECIDED
    assert np.mean(is_said) > 0.5
    assert in_jax[is_said].tolist() == np.array(truth)[is_said].tolist()


@pytest.mark.campaign
def test_verdicts_are_those_in_fractions_at_large() -> None:
    rng = np.random.default_rng(56)
    for _ in range(many(100, 2)):
        polynomials = [drawn(rng, int(rng.integers(1, 41)))]
        polynomials = [*polynomials, *(drawn(rng, len(polynomials[0]) - 1) for _ in range(99))]
        truth = [Verdict.STABLE if has_roots_inside(p) else Verdict.UNSTABLE for p in polynomials]
        assert jaxstab.is_schur(polynomials).tolist() == truth
        in_jax = np.asarray(jaxstab.is_schur(jnp.array(polynomials)))
        is_wrong = (in_jax != Verdict.UNDECIDED) & (in_jax != np.array(truth))
        assert not np.any(is_wrong)


@pytest.mark.parametrize("degree", first([2, 5, 12], 2))
def test_radii_are_within_their_bounds_of_mpmath(degree: int) -> None:
    rng = np.random.default_rng([1, degree])
    polynomials = [drawn(rng, degree) for _ in range(6)]
    found, in_jax = jaxstab.radius(polynomials), jaxstab.radius(jnp.array(polynomials))
    assert np.all(found.error <= 1e-9 * found.value)
    for k, polynomial in enumerate(polynomials):
        truth = radius_of(polynomial)
        for value, error in ((found.value, found.error), (in_jax.value, in_jax.error)):
            assert abs(truth - float(value[k])) <= float(error[k])


@pytest.mark.parametrize(
    ("roots", "verdict"),
    [
        ([0.5, 0.5, 0.5, 0.5, 0.5, 0.5], Verdict.STABLE),
        ([1.0, 0.5, 0.25, 0.125], Verdict.UNSTABLE),
        ([-1.0, -1.0, -1.0, 0.5], Verdict.UNSTABLE),
        ([0.0, 0.0, 0.0, 0.0], Verdict.STABLE),
        ([2.0, 0.5, 0.5], Verdict.UNSTABLE),
        ([2.0, 0.5], Verdict.UNSTABLE),  # reciprocal
    ],
)
def test_roots_that_coincide_or_are_on_the_circle(roots: Polynomial, verdict: Verdict) -> None:
    polynomial = np.poly(roots)  # exact
    found = jaxstab.radius(polynomial)
    assert jaxstab.is_schur(polynomial) == verdict
    assert abs(found.value - max(map(abs, roots))) <= found.error < 1e-9
    assert found.status == RadiusStatus.PROVED


@pytest.mark.campaign
def test_axes_broadcast_under_vmap_and_of_each_input() -> None:
    rng = np.random.default_rng(3)
    grid = rng.uniform(-0.5, 0.5, (3, 4, 6))
    grid[..., 0] = 1.0
    codes = jaxstab.is_schur(grid)
    assert codes.shape == (3, 4)
    assert jaxstab.is_schur(grid[1, 2]) == codes[1, 2]
    assert repr(jaxstab.is_schur(grid[1, 2])).startswith("<Verdict.")
    by_vmap = jax.vmap(jax.vmap(jaxstab.is_schur))(jnp.array(grid))
    assert np.array_equal(by_vmap, codes)
    radii = jax.vmap(jaxstab.radius)(jnp.array(grid)).value
    assert np.allclose(radii, jaxstab.radius(grid).value, rtol=1e-12)


def test_derivatives_are_those_of_the_largest_root() -> None:
    polynomial = jnp.array([2.0, -1.0, 0.5, 0.25, -0.125])
    slope = jax.grad(lambda c: jaxstab.radius(c).value)(polynomial)
    for k in range(5):
        step = np.zeros(5)
        step[k] = 1e-6
        sides = [jaxstab.radius(np.asarray(polynomial) + s * step).value for s in (1.0, -1.0)]
        assert slope[k] == pytest.approx((sides[0] - sides[1]) / 2e-6, rel=1e-6, abs=1e-9)


def test_arrays_of_jax_without_an_answer_claim_nothing() -> None:
    bad = jnp.array([[0.0, 1.0, 0.5, 0.1], [1.0, jnp.nan, 0.0, 0.0], [1.0, jnp.inf, 0.0, 0.0]])
    assert np.all(np.asarray(jaxstab.is_schur(bad)) == Verdict.UNDECIDED)
    assert np.all(np.isinf(jaxstab.radius(bad).error))


def test_coefficients_of_any_size_are_told_apart() -> None:
    for scale in (1e-300, 1e300):
        assert jaxstab.is_schur([scale, -0.5 * scale, 0.06 * scale]) == Verdict.STABLE
    assert jaxstab.is_schur([1e-300, 1e300]) == Verdict.UNSTABLE
    assert jaxstab.is_schur([1e300, 1e-300]) == Verdict.STABLE


@pytest.mark.parametrize("scale", [1e-307, 1e-300, 1e-250, 1e300])
def test_numbers_that_xla_takes_for_zero_are_not_left_out(scale: float) -> None:
    """Roots at -0.96 and -0.29; without the last coefficient one is at -1.25."""
    falling = scale * np.array([0.296, 0.3703, 0.08216])
    code, found = (question(jnp.array(falling)) for question in (jaxstab.is_schur, jaxstab.radius))
    assert code == (Verdict.STABLE if scale > 1e-270 else Verdict.UNDECIDED)
    assert abs(found.value - float(jaxstab.radius(falling).value)) <= found.error + 1e-12


@pytest.mark.parametrize("degree", first([8, 7, 9], 1))
def test_a_batch_of_any_degree_is_compiled(rng: np.random.Generator, degree: int) -> None:
    """At degree 8, modulus and Horner's rule in one kernel took XLA minutes."""
    given = rng.standard_normal((5, degree + 1))
    found = jax.jit(jaxstab.radius)(jnp.array(given))
    roots = [np.max(np.abs(np.roots(p))) for p in given]
    np.testing.assert_allclose(found.value, roots, rtol=1e-11)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (1.0, r"give \(\.\.\., n \+ 1\)"),
        ([1.0], "give"),
        ([0.0, 1.0], "first coefficient is 0"),
        ([[1.0, 2.0], [0.0, 1.0]], "first coefficient is 0"),
        ([1.0, np.nan], "not finite"),
        ([1.0, np.inf], "not finite"),
        ([Fraction(1), Fraction(-4, 3), Fraction(1, 3)], "holds -4/3, which float64 rounds"),
        ([2**53 + 1, 2**53], "holds 9007199254740993, which float64 rounds"),
        (np.array([2**63 + 1, 1], np.uint64), "which float64 rounds"),
        ([Decimal("0.1"), Decimal(1)], "holds 0.1, which float64 rounds"),
        ([1, 1j], "give real numbers"),
        ([1, 10**400], "give real numbers"),
        (["1", "2"], "give real numbers"),
        ([[1.0, 2.0], [1.0]], "give real numbers"),
    ],
)
def test_bad_coefficients_get_a_sentence(given: Any, words: str) -> None:
    for question in (jaxstab.is_schur, jaxstab.radius):
        with pytest.raises((TypeError, ValueError), match=words):
            question(given)
    with pytest.raises((TypeError, ValueError)):
        jaxstab.is_schur("1")  # type: ignore[arg-type]


@pytest.mark.parametrize("degree", [1, 2, 5, pytest.param(20, marks=pytest.mark.campaign)])
def test_the_iteration_of_accelerators_finds_the_largest_root(degree: int) -> None:
    """Roots of all sizes, many at 0, and delays; judged by certified roots."""
    from jaxstab.point.traced_radius import iterated_root

    rng = np.random.default_rng(degree)
    rows = []
    for _ in range(20 if degree < 9 else 5):
        heads = [1.0, *rng.normal(size=min(2, degree)), *np.zeros(degree)][: degree + 1]
        late = np.array(heads) + 1e-3 * rng.normal() * (np.arange(degree + 1) == degree)
        rows += [heads, late, [1.0, *rng.normal(size=degree)]]
        rows += [np.array([1.0, *rng.normal(size=degree)]) * 10.0 ** rng.uniform(0, 5, degree + 1)]
    monic = np.array([np.array(row) / row[0] for row in rows])
    found = np.abs(jax.jit(iterated_root)(jnp.asarray(monic)))
    truth = [float(radius_of(np.trim_zeros(row, "b").tolist())) for row in monic]
    assert found == pytest.approx(truth, rel=1e-9)


def test_programs_of_accelerators_have_no_eigenvalues() -> None:
    """They find those of one matrix after the other."""
    radii = jax.jit(jax.vmap(jax.value_and_grad(lambda p: jaxstab.radius(p).value)))
    program = {
        platform: radii.trace(jnp.ones((4, 6))).lower(lowering_platforms=(platform,)).as_text()
        for platform in ("cpu", "cuda")
    }
    assert {name: "geev" in text for name, text in program.items()} == {"cpu": True, "cuda": False}
