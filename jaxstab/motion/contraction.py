"""Coordinates in which no sample of a stable loop lengthens its state (lemma M3 of docs/proofs.md).

With P = 1 + A^T A + (A^2)^T A^2 + ... = L^T L, the length |L s| shrinks with every sample, as
|L A s|^2 = |L s|^2 - |s|^2. Sums and tails can be bounded in the coordinates L s even next to the
boundary of stability, for the errors of products do not grow. P is summed without a bound of its
error, twice as many terms with each square of A. That L is good enough is proved afterwards, from
the norm of L^T L - (L A)^T L A - 1, which may be up to 1/2.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int

from jaxstab.rounding import RAISED_MANY, UNIT

Matrices = Float64[np.ndarray, "_ _ _"]
PerLoop = Float64[np.ndarray, " loop"]

_SMALL = 0.25  # the norm of a power of A behind which the sum of squares ends
_HOPELESS = 1e60  # a power as large as this belongs to an unstable loop
_DOUBLINGS = 40  # after which a loop is given up
_LARGEST = 1e12  # of the squared coordinates, beyond which they are noise
_INVERSE = 2.0**0.5  # no less than the norm of the inverse of L
_POWERS = 11  # of A that units make small: A, A^2, A^4 ...
_SWEEPS = 8  # that look for units
_SMALLEST = 1e-30  # of the units


class Systems(NamedTuple):
    """Linear systems side by side, s -> A s + B e with outputs C s.

    The entries of A and B, and of C, are wrong by at most ``error`` times the entries of ``sizes``
    and ``output_sizes``, which are at least as large as the moduli of the entries themselves.
    """

    transition: Float64[np.ndarray, "loop state state"]
    inputs: Float64[np.ndarray, "loop state input"]
    outputs: Float64[np.ndarray, "loop output state"]
    sizes: Float64[np.ndarray, "loop state column"]
    output_sizes: Float64[np.ndarray, "loop output state"]
    error: float

    def in_units(self, units: Float64[np.ndarray, "loop state"]) -> "Systems":
        """Return the systems with other units of the states, powers of two."""
        size = units.shape[1]
        columns = np.ones((len(units), self.sizes.shape[2]))
        columns[:, :size] = units
        return self._replace(
            transition=self.transition * units[:, None, :] / units[:, :, None],
            inputs=self.inputs / units[:, :, None],
            outputs=self.outputs * units[:, None, :],
            sizes=self.sizes * columns[:, None, :] / units[:, :, None],
            output_sizes=self.output_sizes * units[:, None, :],
        )


class Contraction(NamedTuple):
    """Systems in coordinates L s in which the spectral norm of A is at most 1 (lemma M3).

    The errors are of A in the Frobenius norm, and of the columns and rows in the Euclidean one.

    norms: no less than the sum of the norms of 1, A, A^2, ...
    doublings: of A until the sum of squares ended; -1 where nothing is proved.
    """

    transition: Float64[np.ndarray, "loop state state"]
    inputs: Float64[np.ndarray, "loop state input"]
    outputs: Float64[np.ndarray, "loop output state"]
    transition_error: PerLoop
    inputs_error: Float64[np.ndarray, "loop input"]
    outputs_error: Float64[np.ndarray, "loop output"]
    norms: PerLoop
    doublings: Int[np.ndarray, " loop"]


def contraction(systems: Systems) -> Contraction:
    """Return systems in coordinates in which each sample is a contraction, where one is proved."""
    with np.errstate(all="ignore"):  # what grows overflows, and is never proved
        step, inputs, outputs, sizes, output_sizes, error = systems.in_units(
            balance(systems.transition)
        )
        size, rounding = step.shape[1], rounding_in(step)
        upper, doublings = _coordinates(step)
        moved = upper @ step
        moduli = np.abs(upper) @ sizes
        wrong = (error + rounding)[:, None] * rows(moduli[:, :, :size])
        moved_error, moved_norm, length = (
            RAISED_MANY * norm(wrong[:, None]),
            norm(moved),
            norm(upper),
        )
        # What L^T L - A^T L^T L A - 1 is, which must be small.
        defect = transposed(upper) @ upper - transposed(moved) @ moved - np.eye(size)
        defect_error = rounding * (length**2 + moved_norm**2)
        defect_error += moved_error * (2.0 * moved_norm + moved_error)
        is_proved = norm(defect) + RAISED_MANY * defect_error <= 0.5
        # Rows of L A and of C times the inverse of L, however it is computed.
        given = np.concatenate([moved, outputs], axis=1)
        wrong = np.concatenate([wrong, (error + rounding)[:, None] * rows(output_sizes)], axis=1)
        new = given @ np.linalg.inv(upper)
        wrong += rows(new @ upper - given) + (rounding * length)[:, None] * rows(new)
        wrong *= _INVERSE * RAISED_MANY
    return Contraction(
        transition=new[:, :size],
        inputs=upper @ inputs,
        outputs=new[:, size:],
        transition_error=norm(wrong[:, None, :size]),
        inputs_error=RAISED_MANY * (error + rounding)[:, None] * columns(moduli[:, :, size:]),
        outputs_error=wrong[:, size:],
        norms=4.0 * RAISED_MANY * length**2,
        doublings=np.where(is_proved, doublings, -1),
    )


def _coordinates(step: Matrices) -> tuple[Matrices, Int[np.ndarray, " loop"]]:
    """Return L, and how often A was squared; 1 and -1 where no power of A became small."""
    count, size = step.shape[:2]
    upper = np.broadcast_to(np.eye(size), step.shape).copy()
    doublings = np.full(count, -1)
    lanes, power, square = np.arange(count), step, upper.copy()
    for doubling in range(_DOUBLINGS + 1):
        length = norm(power)
        is_small = (length <= _SMALL) & (norm(square) < _LARGEST)
        upper[lanes[is_small]] = transposed(np.linalg.cholesky(square[is_small]))
        doublings[lanes[is_small]] = doubling
        is_open = (length < _HOPELESS) & ~(length <= _SMALL)
        if not np.any(is_open):
            break
        lanes, power, square = lanes[is_open], power[is_open], square[is_open]
        square = square + transposed(power) @ square @ power
        power = power @ power
    return upper, doublings


def error_of_square(power: Matrices, error: PerLoop) -> PerLoop:
    """Return a bound of the error of the square of a power of A, by that of the power (M5)."""
    rounding = rounding_in(power) * norm(power) ** 2
    return RAISED_MANY * (error * (2.0 * decay(power, error) + error) + rounding)


def decay(power: Matrices, error: PerLoop) -> PerLoop:
    """Return a bound of the norm of a power of A by its computed value, at most 1."""
    return np.minimum(1.0, RAISED_MANY * (norm(power) + error))


def rounding_in(matrices: Matrices) -> PerLoop:
    """A bound of the rounding error of a product with such matrices, relative to its norms."""
    return np.full(len(matrices), (matrices.shape[1] + 8) * UNIT)


def transposed(matrices: Matrices) -> Matrices:
    """Return the transposed matrices."""
    return np.swapaxes(matrices, 1, 2)


def norm(matrices: Matrices) -> PerLoop:
    """Return Frobenius norms."""
    return np.sqrt(np.einsum("lij,lij->l", matrices, matrices))


def columns(matrices: Matrices) -> Float64[np.ndarray, "loop column"]:
    """Return the Euclidean norms of columns."""
    return np.sqrt(np.einsum("lij,lij->lj", matrices, matrices))


def rows(matrices: Matrices) -> Float64[np.ndarray, "loop row"]:
    """Return the Euclidean norms of rows."""
    return np.sqrt(np.einsum("lij,lij->li", matrices, matrices))


def balance(step: Matrices) -> Float64[np.ndarray, "loop state"]:
    """Powers of two, the first one 1, in whose units all powers of A are nearly small."""
    # The unit of a state is how large it becomes, after 1, 2, 4 ... samples, from other states of
    # unit size; repeated, this comes close to the units with the smallest norms. Any units are
    # correct, but these give the smallest rounding bounds.
    units = np.ones(step.shape[:2])
    sizes, power = [], step
    for _ in range(_POWERS):
        sizes.append(np.abs(power))
        power = power @ power
    for sweep in range(_SWEEPS):
        largest = np.max([(size @ units[:, :, None])[:, :, 0] for size in sizes], axis=0)
        mixed = largest if sweep < _SWEEPS // 2 else np.sqrt(largest * units)
        units = np.maximum(mixed / mixed.max(axis=1, keepdims=True), _SMALLEST)
    units = np.exp2(np.rint(np.log2(np.where(np.isfinite(units), units, 1.0))))
    return units / units[:, :1]
