"""Sums of moduli of impulse responses, |C b| + |C A b| + |C A^2 b| + ..., proved from above.

A small power of A gives coordinates in which every step is a contraction. In these the errors of
products do not grow, so sums, their rounding and their tails can be bounded even next to the
boundary of stability (lemmas M3 to M5 of docs/proofs.md).
"""

from math import ceil
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

Matrices = Float64[np.ndarray, "_ _ _"]
PerLoop = Float64[np.ndarray, " loop"]

_ROUNDING = 2.0**-53
_SAFETY = 1.0 + 2.0**-20  # on bounds of errors: they are rounded themselves
_SMALL = 2.0**-10  # the norm of a power of A that gives coordinates
_LEAST_SMALL = 2.0**-24  # keeps the contraction of a power that vanishes above 0
_HOPELESS = 1e60  # a power as large as this belongs to an unstable loop
_TAIL = 1e-11  # the norm of a power behind which a sum ends
_FURTHER = 3  # doublings until then, at most
_SUMMED = 22  # doublings, beyond which the tail is bounded as it is
_DOUBLINGS = 40  # after which a loop is given up
_LARGEST = 1e12  # of the squared coordinates, beyond which they are noise
_NUMBERS = 1 << 21  # of an array that is filled at once, about


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

    def chosen(self, which: np.ndarray) -> "Systems":
        """Return some of the systems."""
        arrays = {name: getattr(self, name)[which] for name in self._fields if name != "error"}
        return self._replace(**arrays)


def impulse_sums(systems: Systems) -> Float64[np.ndarray, "loop output input"]:
    """Return upper bounds of the sums of |C A^k b| over k >= 0; infinite where none is proved."""
    count, _, inputs = systems.inputs.shape
    sums = np.full((count, systems.outputs.shape[1], inputs), np.inf)
    lanes, powers = np.arange(count), [systems.transition]
    with np.errstate(all="ignore"):  # what grows overflows, and is never proved
        for _ in range(_DOUBLINGS + 1):
            size = _norm(powers[-1])
            is_small = size <= _SMALL
            if np.any(is_small):
                for some in _parts(np.flatnonzero(is_small), systems, len(powers)):
                    chosen = [power[some] for power in powers]
                    sums[lanes[some]] = _sums(systems.chosen(lanes[some]), chosen, size[some])
            is_open = (size < _HOPELESS) & ~is_small
            if not np.any(is_open):
                break
            lanes, powers = lanes[is_open], [power[is_open] for power in powers]
            powers.append(powers[-1] @ powers[-1])
    return sums


def _parts(loops: np.ndarray, systems: Systems, powers: int) -> list[np.ndarray]:
    """Cut a list of loops so that the vectors of each part fill no more memory than they may."""
    longest = 2.0 ** (0.5 * min(powers + _FURTHER, _SUMMED))
    width = longest * (systems.inputs.shape[2] + systems.outputs.shape[1])
    count = ceil(len(loops) * systems.inputs.shape[1] * width / _NUMBERS)
    return np.array_split(loops, min(count, len(loops)))


class _Contraction(NamedTuple):
    """Systems in coordinates L s in which |A| <= rate < 1 in the spectral norm (lemma M3).

    The errors are of A in the Frobenius norm, and of the columns and rows in the Euclidean one.
    """

    transition: Float64[np.ndarray, "loop state state"]
    inputs: Float64[np.ndarray, "loop state input"]
    outputs: Float64[np.ndarray, "loop output state"]
    transition_error: PerLoop
    inputs_error: Float64[np.ndarray, "loop input"]
    outputs_error: Float64[np.ndarray, "loop output"]
    rate: PerLoop
    is_proved: np.ndarray


def _contraction(systems: Systems, powers: list[Matrices], size: PerLoop) -> _Contraction:
    """Return the coordinates that the powers A, A^2, A^4, ... give; the last one is small."""
    step, inputs, outputs, sizes, output_sizes, error = systems
    last = 2.0 ** (len(powers) - 1)
    rate = np.exp2(np.log2(2.0 * np.maximum(size, _LEAST_SMALL)) / last)
    square = np.broadcast_to(np.eye(step.shape[1]), step.shape).copy()
    for number, power in enumerate(powers[:-1]):
        scaled = power * (rate ** -(2.0**number))[:, None, None]
        square += _transposed(scaled) @ square @ scaled
    is_sound = np.isfinite(square).all(axis=(1, 2)) & (_norm(square) < _LARGEST)
    square = np.where(is_sound[:, None, None], square, np.eye(step.shape[1]))
    upper = _transposed(np.linalg.cholesky(square))
    back = np.linalg.inv(upper)
    lost = _lost(step)
    moved = upper @ step
    norm, norm_moved = _norm(upper), _norm(moved)
    moduli = np.abs(upper) @ sizes
    moved_error = _SAFETY * (error + lost) * _norm(moduli[:, :, : step.shape[1]])
    # What L^T L - A^T L^T L A / rate^2 - 1 is, which must be small.
    defect = _transposed(upper) @ upper - _transposed(moved) @ moved / (rate**2)[:, None, None]
    defect_error = lost * norm_moved**2 + moved_error * (2.0 * norm_moved + moved_error)
    defect_error = _SAFETY * (lost * norm**2 + defect_error / rate**2)
    defect_size = _norm(defect - np.eye(step.shape[1])) + defect_error
    new_step, new_outputs = moved @ back, outputs @ back
    rest, rest_outputs = new_step @ upper - moved, new_outputs @ upper - outputs
    root = 2.0**0.5  # no less than the norm of the inverse of L
    new_error = root * (_norm(rest) + lost * (_norm(new_step) * norm + norm_moved) + moved_error)
    outputs_error = _rows(rest_outputs) + lost[:, None] * _rows(new_outputs) * norm[:, None]
    outputs_error = root * (outputs_error + (error + lost)[:, None] * _rows(output_sizes))
    inputs_error = (error + lost)[:, None] * _columns(moduli[:, :, step.shape[1] :])
    return _Contraction(
        new_step,
        upper @ inputs,
        new_outputs,
        _SAFETY * new_error,
        _SAFETY * inputs_error,
        _SAFETY * outputs_error,
        rate,
        is_sound & (defect_size <= 0.5) & (rate < 1.0),
    )


def _sums(
    systems: Systems, powers: list[Matrices], size: PerLoop
) -> Float64[np.ndarray, "loop output input"]:
    """Return the bounds of systems of which the same power is the first small one."""
    new = _contraction(systems, powers, size)
    power, error, length = new.transition, new.transition_error, 1
    lost = _lost(power)
    levels: list[tuple[Matrices, PerLoop, PerLoop]] = []
    most = min(len(powers) - 1 + _FURTHER, _SUMMED)
    while True:
        norm = _norm(power)
        decay = np.minimum(1.0, new.rate**length)
        if len(levels) >= most or (levels and np.all(norm <= _TAIL)):
            break
        levels.append((power, decay, error + lost * norm))
        error = _SAFETY * (2.0 * decay * error + error**2 + lost * norm**2)
        power, length = power @ power, 2 * length
    half = len(levels) // 2
    rows = _Family.begun(_transposed(new.outputs), new.outputs_error)
    states = _Family.begun(new.inputs, new.inputs_error)
    for level in levels[:half]:
        rows = rows.doubled(_transposed(level[0]), *level[1:])
    for level in levels[half:]:
        states = states.doubled(*level)
    sums = _sum_of_moduli(rows.vectors, states.vectors, new.outputs.shape[1], new.inputs.shape[2])
    sums *= 1.0 + 2.0 * _ROUNDING * length
    one, two = rows.size[:, :, None], states.size[:, None, :]
    one_error, two_error = rows.error[:, :, None], states.error[:, None, :]
    wrong = one_error * (two + two_error) + one * two_error + lost[:, None, None] * one * two
    tail = _tail(new, *levels[-1])
    return np.where(new.is_proved[:, None, None], sums + _SAFETY * (wrong + tail), np.inf)


def _tail(
    new: _Contraction,
    power: Matrices,
    decay: PerLoop,
    error: PerLoop,
) -> Float64[np.ndarray, "loop output input"]:
    """Return bounds of the sums behind twice as many samples as a power has.

    The power is applied from either side, so that only what is slow is left of rows and columns.
    """
    rows = _rows(new.outputs @ power) + decay[:, None] * new.outputs_error
    rows += error[:, None] * (_rows(new.outputs) + new.outputs_error)
    columns = _columns(power @ new.inputs) + decay[:, None] * new.inputs_error
    columns += error[:, None] * (_columns(new.inputs) + new.inputs_error)
    return rows[:, :, None] * columns[:, None, :] / (1.0 - new.rate)[:, None, None]


class _Family(NamedTuple):
    """Vectors v, A v, A^2 v, ... of several v, the sums of their norms, and of their errors."""

    vectors: Matrices  # side by side, those of one power together
    size: Float64[np.ndarray, "loop vector"]
    error: Float64[np.ndarray, "loop vector"]

    @classmethod
    def begun(cls, vectors: Matrices, error: np.ndarray) -> "_Family":
        """Return the vectors alone."""
        return cls(vectors, _columns(vectors), error)

    def doubled(self, power: Matrices, decay: PerLoop, power_error: PerLoop) -> "_Family":
        """Return as many again, by a power with its error and a bound of its norm (lemma M5)."""
        further = power @ self.vectors
        shape = (*further.shape[:2], -1, self.size.shape[1])
        size = self.size + np.sum(_columns(further).reshape(shape[0], *shape[2:]), axis=1)
        error = self.error * (1.0 + decay[:, None]) + power_error[:, None] * (
            self.size + self.error
        )
        return _Family(np.concatenate([self.vectors, further], axis=2), size, _SAFETY * error)


def _sum_of_moduli(
    rows: Matrices, states: Matrices, outputs: int, inputs: int
) -> Float64[np.ndarray, "loop output input"]:
    """Return the sums of the moduli of all products of an output and of an input."""
    loops, _, width = rows.shape
    rows = _transposed(rows)
    total = np.zeros((loops, outputs, inputs))
    length = inputs * max(1, _NUMBERS // (loops * width * inputs))
    for part in range(0, states.shape[2], length):
        terms = np.abs(rows @ states[:, :, part : part + length])
        total += terms.reshape(loops, width // outputs, outputs, -1, inputs).sum(axis=(1, 3))
    return total


def _lost(matrices: Matrices) -> PerLoop:
    """Return what a product with such matrices may lose, as a share of the product of norms."""
    return np.full(len(matrices), (matrices.shape[1] + 8) * _ROUNDING)


def _transposed(matrices: Matrices) -> Matrices:
    return np.swapaxes(matrices, 1, 2)


def _norm(matrices: Matrices) -> PerLoop:
    """Return Frobenius norms."""
    return np.sqrt(np.einsum("lij,lij->l", matrices, matrices))


def _columns(matrices: Matrices) -> Float64[np.ndarray, "loop column"]:
    return np.sqrt(np.einsum("lij,lij->lj", matrices, matrices))


def _rows(matrices: Matrices) -> Float64[np.ndarray, "loop row"]:
    return np.sqrt(np.einsum("lij,lij->li", matrices, matrices))
