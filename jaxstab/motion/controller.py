"""What the controller runs at each sample: the estimator and the filter as difference equations.

The velocity is a difference over a window, then a chain of filters of low orders; the position goes
through another chain. The coefficients are those of ``jaxstab.model``, rounded to float64.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import Array, fixed, is_traced, pytree
from jaxstab.model.filters import Filters
from jaxstab.model.transfer import Polynomial, Transfer

Memory = tuple[Array, ...]


class Equation(NamedTuple):
    """y_k = b_0 u_k + ... + b_n u_(k-n) - a_1 y_(k-1) - ... - a_n y_(k-n).

    Coefficients that are 0 are None, so that nothing is computed with them. The memory from sample
    to sample is the n sums from which the next outputs are made (transposed direct form II).
    """

    inputs: tuple[Array | None, ...]  # b_0 ... b_n
    outputs: tuple[Array | None, ...]  # a_1 ... a_n

    @classmethod
    def of(cls, transfer: Transfer) -> "Equation":
        """Return the difference equation of a proper transfer function."""
        above, below, lag, _ = transfer
        delay = lag + len(below) - len(above)
        order = max(delay + len(above), len(below)) - 1
        inputs = (None,) * delay + _rounded(above)
        outputs = _rounded(below)[1:]
        return cls(
            inputs + (None,) * (order + 1 - len(inputs)),
            outputs + (None,) * (order - len(outputs)),
        )

    def step(self, value: Array, memory: Memory) -> tuple[Array, Memory]:
        """Return the output for an input, and the new memory."""
        output = _plus(memory[0] if memory else 0.0, self.inputs[0], value)
        return output, self._sums(value, output, (*memory[1:], 0.0))

    def at_rest(self, value: Array) -> tuple[Array, Memory]:
        """Return the output for an input that never changed, and the memory then."""
        output = value * (_sum(self.inputs) / (1.0 + _sum(self.outputs)))
        memory: Memory = ()
        for order in range(len(self.outputs), 0, -1):
            below = self.outputs[order - 1]
            last = memory[0] if memory else 0.0 * value
            memory = (_less(_plus(last, self.inputs[order], value), below, output), *memory)
        return output, memory

    def moduli(self) -> "Equation":
        """Return the equation with the moduli of its coefficients, in which nothing cancels."""
        return Equation(
            tuple(one if one is None else abs(one) for one in self.inputs),
            tuple(one if one is None else -abs(one) for one in self.outputs),
        )

    def _sums(self, value: Array, output: Array, waiting: Memory) -> Memory:
        triples = zip(waiting, self.inputs[1:], self.outputs, strict=False)
        return tuple(
            _less(_plus(later, above, value), below, output) for later, above, below in triples
        )


Chain = tuple[Equation, ...]


@pytree
@dataclass(frozen=True)
class Controller:
    """A velocity estimator, times the sampling period, and a position filter.

    Attributes:
        velocity: the chain behind the difference.
        position: the chain of the position filter.
        window: samples over which the difference is taken.
    """

    velocity: Chain
    position: Chain
    window: int = fixed()

    @classmethod
    def of(cls, filters: Filters, sample_time: float = 1.0) -> "Controller":
        """Return the difference equations of an estimator and a filter."""
        window, behind = filters[0].stages(sample_time)
        chains = behind, filters[1].stages(sample_time)
        velocity, position = (tuple(map(Equation.of, chain)) for chain in chains)
        return cls(velocity, position, window)

    def at_rest(self, position: Array) -> Any:
        """Return the memory after a device has always stood at one position."""
        _, behind = _rest_of_chain(self.velocity, 0.0 * position)
        return (position,) * self.window, behind, _rest_of_chain(self.position, position)[1]

    def step(self, position: Array, memory: Any) -> tuple[Array, Array, Any]:
        """Return the filtered position, the velocity times the period, and the new memory."""
        past, behind, beside = memory
        difference = (position - past[-1]) / self.window
        velocity, behind = run(self.velocity, difference, behind)
        filtered, beside = run(self.position, position, beside)
        return filtered, velocity, ((position, *past[:-1]), behind, beside)


class Bank(NamedTuple):
    """The controller as matrices; columns: position, last difference, memory.

    The memory holds the differences before the last one, as far as the window reaches, then the
    memory of the velocity's and the position's chains.

    outputs: rows for the filtered position and for the velocity.
    steps: rows for the memory at the next sample.
    at_rest: the memory for a device that always stood at position 1.
    is_velocity: which entries of the memory are velocities.
    roundings: how often an entry is rounded at most, including the coefficients' own rounding.
    sizes: outputs and steps again, with moduli in place of the numbers that make up an entry.
    """

    outputs: Float64[np.ndarray, "2 column"]
    steps: Float64[np.ndarray, "memory column"]
    at_rest: Float64[np.ndarray, " memory"]
    is_velocity: np.ndarray
    roundings: int
    sizes: tuple[Float64[np.ndarray, "2 column"], Float64[np.ndarray, "memory column"]]


PLAIN = Bank(
    outputs=np.eye(2),
    steps=np.zeros((0, 2)),
    at_rest=np.zeros(0),
    is_velocity=np.zeros(0, bool),
    roundings=0,
    sizes=(np.eye(2), np.zeros((0, 2))),
)


def bank_of(controller: Controller) -> Bank:
    """Return the matrices of a controller, column by column from its difference equations."""
    one, zero = np.ones(()), np.zeros(())
    chains = controller.velocity, controller.position
    rests = [_rest_of_chain(chain, at) for chain, at in zip(chains, (zero, one), strict=True)]
    earlier = controller.window - 1
    memories = rests[0][1], rests[1][1]
    outputs, steps = _rows(controller.window, chains, memories)
    moduli = [tuple(equation.moduli() for equation in chain) for chain in chains]
    at_rest = [np.zeros(earlier), *(np.array(value).ravel() for m in memories for value in m)]
    velocities = earlier + sum(map(len, memories[0]))
    return Bank(
        outputs,
        steps,
        at_rest=np.concatenate(at_rest),
        is_velocity=np.arange(len(steps)) < velocities,
        roundings=2 + 4 * sum(map(len, chains)),
        sizes=_rows(controller.window, (moduli[0], moduli[1]), memories),
    )


def _rows(
    window: int, chains: tuple[Chain, Chain], memories: tuple[Any, Any]
) -> tuple[Float64[np.ndarray, "2 column"], Float64[np.ndarray, "memory column"]]:
    """Return the outputs and the steps of a bank; the memories tell how much is remembered."""
    lengths = [window - 1, *(sum(map(len, memory)) for memory in memories)]
    units = np.eye(2 + sum(lengths))
    splits = np.split(units[2:], np.cumsum(lengths)[:2])
    total = units[1] + splits[0].sum(axis=0)
    inputs = total / window, units[0]
    runs = [
        run(chain, value, _like(memory, split))
        for chain, value, memory, split in zip(chains, inputs, memories, splits[1:], strict=True)
    ]
    steps = [*units[1:window], *(row for _, memory in runs for one in memory for row in one)]
    return np.array([runs[1][0], runs[0][0]]), np.array(steps).reshape(-1, len(units))


def run(
    chain: Chain, value: Array, memories: tuple[Memory, ...]
) -> tuple[Array, tuple[Memory, ...]]:
    """Return the output of a chain for an input, and its new memory."""
    after = []
    for equation, memory in zip(chain, memories, strict=True):
        value, kept = equation.step(value, memory)
        after.append(kept)
    return value, tuple(after)


def _rest_of_chain(chain: Chain, value: Array) -> tuple[Array, tuple[Memory, ...]]:
    memories = []
    for equation in chain:
        value, memory = equation.at_rest(value)
        memories.append(memory)
    return value, tuple(memories)


def _like(memories: tuple[Memory, ...], rows: np.ndarray) -> tuple[Memory, ...]:
    """Return rows in the grouping of memories."""
    rest = iter(rows)
    return tuple(tuple(next(rest) for _ in memory) for memory in memories)


def _rounded(polynomial: Polynomial) -> tuple[Array | None, ...]:
    values = (coefficient.rounded() for coefficient in polynomial)
    return tuple(one if is_traced(one) else _float_or_none(one) for one in values)


def _float_or_none(value: Array) -> float | None:
    return float(value) or None


def _plus(total: Array, coefficient: Array | None, value: Array) -> Array:
    return total if coefficient is None else total + coefficient * value


def _less(total: Array, coefficient: Array | None, value: Array) -> Array:
    return total if coefficient is None else total - coefficient * value


def _sum(coefficients: tuple[Array | None, ...]) -> Array:
    return sum((one for one in coefficients if one is not None), 0.0)
