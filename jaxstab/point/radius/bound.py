"""The error bound of a spectral radius, for the loop of the paper.

The verdicts of the ladder are those of the certified recursion on the few coefficients of p that
are not 0 (lemma R3 of docs/proofs.md).

Source: Schur-Cohn criterion (Jury 1964) for p(r z).
"""

from functools import partial

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import Array, namespace
from jaxstab.batches import compiled, over_tiles
from jaxstab.point.radius.ladder import proved_error
from jaxstab.point.verdict.loop import HIGHEST_UNROLLED
from jaxstab.point.verdict.recursion import FLOAT_UNIT, UNDERFLOW, Chain, Ends, decide, size_sum


def radius_error(
    coefficients: Float64[Array, "*grid coefficient"],
    radius: Float64[Array, "*grid"],
    coefficient_error: float = 2.0 * FLOAT_UNIT,
) -> Float64[Array, "*grid"]:
    """Prove how far a spectral radius can be from the true one.

    Bounds from a ladder of ratio 4 are tried, so the result is up to 4 times larger than the
    smallest bound that could be proved, and never smaller than the true error.

    Args:
        coefficients: monic p(z) of degree >= 3, highest power first, as characteristic_polynomial
            gives them for one delay.
        radius: the estimate, > 0.
        coefficient_error: relative uncertainty of each coefficient.

    Returns:
        The absolute error; inf if even 2^-6 radius cannot be proved, as when coefficients other
        than the first three and the last four are not zero.

    Raises:
        ValueError: the degree is below 3.
    """
    degree = coefficients.shape[-1] - 1
    if degree < 3:
        raise ValueError(f"coefficients are of degree {degree}; give polynomials of degree >= 3.")
    return _radius_error(coefficients, radius, coefficient_error=coefficient_error)


@compiled(static=["coefficient_error"])
def _radius_error(coefficients: Array, radius: Array, *, coefficient_error: float) -> Array:
    degree = coefficients.shape[-1] - 1
    xp = namespace(coefficients, radius)
    columns = [coefficients[..., index] for index in range(degree + 1)]
    tail = columns[: max(2, degree - 4) : -1]
    rest = sum(map(abs, columns[3 : degree + 1 - len(tail)]), xp.zeros_like(radius))
    bound = partial(_ladder, degree=degree, coefficient_error=coefficient_error)
    return over_tiles(bound, (tuple(columns[1:3]), tuple(tail), rest, radius))


def _ladder(
    head: tuple[Array, ...],
    tail: tuple[Array, ...],
    rest: Array,
    radius: Array,
    *,
    degree: int,
    coefficient_error: float,
) -> Array:
    def codes(scale: Array) -> Array:
        return _scaled_codes(head, tail, rest, scale, degree, coefficient_error)

    return proved_error(codes, radius)


def _scaled_codes(
    head: tuple[Array, ...],
    tail: tuple[Array, ...],
    rest: Array,
    scale: Array,
    degree: int,
    coefficient_error: float,
) -> Array:
    """Return the codes of p(scale z) / scale^degree, of which ``rest`` is left out."""
    xp = namespace(scale)
    inverse = 1.0 / scale
    head = tuple(value * inverse**power for power, value in enumerate(head, start=1))
    tail = tuple(value * inverse ** (degree - power) for power, value in enumerate(tail))
    head_error = (coefficient_error + 10.0 * FLOAT_UNIT) * size_sum(head)
    tail_error = (coefficient_error + (2 * degree + 6) * FLOAT_UNIT) * size_sum(tail)
    left_out = rest * xp.maximum(inverse**3, inverse**degree)
    error = head_error + 2.0 * tail_error + 2.0 * left_out + 2.0 * FLOAT_UNIT + UNDERFLOW
    chain = Chain(1.0 - head[1], head, tail, 2.0 * head_error, error)
    at_one = sum((*head, *tail), xp.ones_like(scale))
    signs = [(-1.0) ** power for power in range(len(tail))]
    wall = sum(sign * value for sign, value in zip(signs, tail, strict=True))
    at_minus_one = 1.0 - head[0] + head[1] + (-1.0) ** degree * wall
    end_error = error + 8.0 * FLOAT_UNIT * (1.0 + size_sum(head) + size_sum(tail))
    ends = Ends(at_one, end_error, at_minus_one, end_error)
    is_rolled = xp is not np and degree > HIGHEST_UNROLLED
    return decide(chain, ends, FLOAT_UNIT, xp.asarray(degree) if is_rolled else degree)
