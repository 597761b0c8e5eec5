"""Any real polynomials: are all roots inside the unit circle, and how large is the largest one?

The kernels of walls (``verdicts``, ``radius``) take coefficients as they are, divided by the first
one: a rounding each, which lemmas V10 and R3 of docs/proofs.md count. What float64 leaves open is
asked in balls, one polynomial after the other, and roots that are exactly on the circle in
fractions. Where JAX has the coefficients, float64 is all there is.
"""

from functools import partial

import numpy as np
from jaxtyping import Bool, Float64, Int8

from jaxstab.arrays import Array, Numbers, constant, float_arrays, is_any_jax, named, namespace
from jaxstab.batches import MANY_COEFFICIENTS, compiled
from jaxstab.conventions import Verdict
from jaxstab.exact import spectral_radius
from jaxstab.exact.roots import affine_verdict
from jaxstab.model.affine import GivenParts, affine_triple
from jaxstab.numbers import require_unmasked, require_x64
from jaxstab.point.poles import companion_poles
from jaxstab.point.radius import SpectralRadius, radius_error, with_status
from jaxstab.point.schur_cohn import UNDERFLOW, Ends, polynomial_codes
from jaxstab.rounding import SAFETY, UNIT
from jaxstab.shown import shortened


def is_schur(coefficients: Numbers) -> Verdict | Int8[Array, "*grid"]:
    """Prove for each polynomial whether all its roots lie inside the unit circle.

    Args:
        coefficients: of shape (..., n + 1), real, the highest power first; the first one is not 0.
            An array of JAX is answered by one compiled program, also under jit and vmap.

    Returns:
        int8 codes of ``jaxstab.Verdict``, of shape (...): STABLE or UNSTABLE for the numbers as
        they are. Of JAX arrays, what float64 leaves open is UNDECIDED: roots within about 1e-12 of
        the circle, or closer together, and polynomials whose first coefficient is 0, or below
        1e-270.

    Raises: ValueError for less than two coefficients, one that is not finite or that float64
        rounds, and a first one of 0 (arrays of JAX apart); TypeError without float64, and for what
        is not a number.

    Source: the criterion of Schur and Cohn (Jury 1964); lemmas V2, V4, V10 and E1 of
    docs/proofs.md.

    Example:
        >>> jaxstab.is_schur([[1.0, -0.5, 0.06], [1.0, -2.5, 1.0], [1.0, 0.0, 1.0]]).tolist()
        [1, 2, 2]
    """
    given = _checked(coefficients)
    if is_any_jax(given):
        return codes_in_float64(given)
    codes = np.array(codes_in_float64(given))
    for place in np.flatnonzero(codes == Verdict.UNDECIDED):
        row = given.reshape(-1, given.shape[-1])[place].tolist()
        codes.flat[place] = affine_verdict(_parts(row), 0.0, 0.0)
    return named(codes, Verdict)


def radius(coefficients: Numbers) -> SpectralRadius:
    """The largest modulus of a root of each polynomial, with a proved bound of its error.

    Args:
        coefficients: as for ``is_schur``. JAX differentiates ``value`` by them where the largest
            root is simple.

    Returns:
        SpectralRadius of shape (...). Of JAX arrays the bound is infinite where float64 proves
        none, as for multiple roots, and a first coefficient below 1e-270.

    Raises: as ``is_schur``: ValueError, TypeError.

    Source: the criterion of Schur and Cohn on two circles; lemmas R3 and E2 of docs/proofs.md.

    Example:
        >>> jaxstab.radius([1.0, -0.5, 0.06])
        0.30000000000000... +/- ... (proved)
        >>> jaxstab.radius([[1.0, 0.0, -0.25], [1.0, -1.0, 0.25]]).value.round(9).tolist()
        [0.5, 0.5]
    """
    coarse = 1e-9  # bounds beyond it are asked for in balls
    given = _checked(coefficients)
    value, error = _radii(given)
    if not is_any_jax(given):
        value, error = np.array(value), np.array(error)
        rows = given.reshape(-1, given.shape[-1])
        for place in np.flatnonzero(~(error <= coarse * value)):
            triple = partial(affine_triple, _parts(rows[place].tolist()))
            found = spectral_radius(triple, 0.0, 0.0)
            value.flat[place], error.flat[place] = found.value, found.error
    return with_status(value, error)


def _checked(coefficients: Numbers) -> Float64[Array, "*grid coefficient"]:
    require_x64(coefficients)
    require_unmasked("coefficients", coefficients)
    given = float_arrays(coefficients)[0] if is_any_jax(coefficients) else _floats(coefficients)
    if given.ndim == 0 or given.shape[-1] < 2:
        raise ValueError(
            f"coefficients have the shape {given.shape}; give (..., n + 1), n >= 1, the highest "
            "power first."
        )
    if is_any_jax(given):
        return given
    if not np.all(np.isfinite(given)):
        raise ValueError("coefficients holds a number that is not finite; leave such ones out.")
    if np.any(given[..., 0] == 0.0):
        raise ValueError("the first coefficient is 0; give polynomials of one degree.")
    return given


def _floats(coefficients: Numbers) -> Float64[np.ndarray, "..."]:
    """Numbers as the float64 that they are."""
    try:
        numbers = np.asarray(coefficients)
        if numbers.dtype.kind not in "biufO":
            raise TypeError  # complex numbers, text
        given = numbers.astype(np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise TypeError(
            f"coefficients is {shortened(coefficients)}; give real numbers that float64 holds, as "
            "an array of shape (..., n + 1)."
        ) from error
    # Python compares a float64 with what is none exactly, NumPy with its own integers does not.
    kept, real = (x if numbers.dtype.kind == "f" else x.astype(object) for x in (given, numbers))
    is_rounded = np.isfinite(given) & (kept != real)
    if np.any(is_rounded):
        raise ValueError(
            f"coefficients holds {numbers[is_rounded][0]}, which float64 rounds, and with it the "
            "roots; round it yourself, or give fractions to jaxstab.Loop.from_coefficients."
        )
    return given


def _is_held(coefficients: Array) -> Bool[Array, "*grid"]:
    """True where no number that XLA takes for 0, below 2.3e-308, counts beside the first one."""
    return abs(coefficients[..., 0]) > 1e-270


def _monic(coefficients: Array) -> Array:
    """Polynomials with the first coefficient 1, with roots at 0 where the degree is low."""
    least_degree = 3  # of the kernels
    xp = namespace(coefficients)
    given = coefficients / coefficients[..., :1]
    missing = max(0, least_degree + 1 - given.shape[-1])
    return xp.concatenate([given, xp.zeros((*given.shape[:-1], missing))], axis=-1)


@compiled(static=("roundings",), many=MANY_COEFFICIENTS)
def codes_in_float64(coefficients: Array, *, roundings: float = 0.0) -> Array:
    """The codes of ``is_schur``, and UNDECIDED where float64 leaves that open.

    Coefficients may be right to so many roundings.
    """
    xp = namespace(coefficients)
    with np.errstate(all="ignore"):
        columns = xp.moveaxis(_monic(coefficients), -1, 0)
        degree = len(columns) - 1
        size = xp.sum(abs(columns), axis=0)
        error = SAFETY * (1.0 + roundings) * UNIT * size + UNDERFLOW
        even, odd = xp.sum(columns[::2], axis=0), xp.sum(columns[1::2], axis=0)
        end_error = error + degree * UNIT * size
        ends = Ends(even + odd, end_error, even - odd, end_error)  # (-1)^n p(-1)
        codes = polynomial_codes(columns, error, ends, UNIT, degree)
        is_one = xp.all(xp.isfinite(coefficients), axis=-1) & _is_held(coefficients)
    return xp.where(is_one, codes, np.int8(Verdict.UNDECIDED))


@compiled(many=1 << 21)  # of which LAPACK finds roots in the time
def _radii(coefficients: Array) -> tuple[Array, Array]:
    xp = namespace(coefficients)
    monic = _monic(coefficients)
    if xp is np:
        value = np.abs(companion_poles(monic)[..., 0])
    else:
        from jaxstab.point.traced_radius import largest_modulus

        value = largest_modulus(monic)
    with np.errstate(all="ignore"):
        error = radius_error(*constant((monic, value)))
        return value, namespace(error).where(_is_held(constant(coefficients)), error, np.inf)


def _parts(coefficients: list[float]) -> GivenParts:
    return GivenParts(tuple(coefficients), (1.0,), (1.0,))
