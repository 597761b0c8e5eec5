"""How a general device moves while forces are held, exact up to the rounding of coefficients.

The handle's compliance n(s)/d(s) is realised with the position as its first state (the observer's
canonical form, in units of one sample), each actuator with its force. The exponentials are those of
balls, rounded once.
"""

from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.model.device.device import Device
from jaxstab.model.device.rational import balls_of, exact, turn, working_precision
from jaxstab.model.device.sampling import in_samples

if TYPE_CHECKING:
    from flint import arb, arb_mat

_FIRST_BITS, _MOST_BITS = 256, 1 << 14
_WANTED_BITS = 64  # of each entry
_NOTHING = 2.0**-200  # of the largest entry: one that small may be 0

Rows = Float64[np.ndarray, "offset state column"]


class Mechanics(NamedTuple):
    """A device between samples; x is in m, forces in N, the unit of time is one sample.

    The columns of rows are the states, then the wall's force that acts up to the fraction of the
    delay, the one that acts from then on, and the hand's force, which acts all the time.

    rows: of the states, at times after a sample, the last one at the next sample.
    seen: rows of position and velocity at the same times.
    at_rest: the states of a device that stands at position 1 without a wall's force.
    follows: which states are the forces of actuators; at rest they are the wall's force.
    blow: the states after a unit of the hand's impulse, from 0.
    thrown: the states of a device that moves with unit velocity from 0; None if a blow cannot throw
        it so.
    """

    rows: Rows
    seen: Float64[np.ndarray, "offset 2 column"]
    at_rest: Float64[np.ndarray, " state"]
    follows: np.ndarray
    blow: Float64[np.ndarray, " state"]
    thrown: Float64[np.ndarray, " state"] | None


@lru_cache(maxsize=64)
def mechanics(
    device: Device, sample_time: float, fraction: float, offsets: tuple[float, ...]
) -> Mechanics:
    """Return how a device moves, for a fraction of the delay, at times in [0, 1] after a sample.

    Raises:
        ValueError: the device does not give way to a constant force.
    """
    import flint

    bits = _FIRST_BITS
    while True:
        with working_precision(bits):
            above, below = in_samples(device.handle_compliance(), sample_time)
            matrix = equations(device, above, below, sample_time)
            rows = [_held(matrix, fraction, offset) for offset in offsets]
            if all(map(are_known, rows)) or bits >= _MOST_BITS:
                break
        bits *= 2
    with working_precision(bits):
        if not above[0] != 0:
            raise ValueError(
                "the device does not give way to a constant force: its transfer function in s is 0 "
                "at s = 0; a wall's device does."
            )
        order, size = len(below) - 1, matrix.ncols() - 2
        give = below[0] / above[0]
        rest = [flint.arb(1)]
        for power in range(order - 1, 0, -1):
            rest.append(below[power] - give * above[power])
        at_rest = np.array([*map(_float, rest), *[0.0] * (size - order)])
        blow = np.array([*(_float(one) for one in above[::-1]), *[0.0] * (size - order)])
        velocity = np.array([_float(matrix[0, column]) for column in range(size + 2)])
    values = np.array([[[_float(one) for one in row] for row in part.tolist()] for part in rows])
    early = (np.array(offsets) < fraction)[:, None]
    acting = velocity[size] * np.where(early, [1.0, 0.0], [0.0, 1.0])
    direct = np.concatenate(
        [np.zeros((len(offsets), size)), acting, np.full((len(offsets), 1), velocity[-1])], axis=1
    )
    speeds = np.einsum("s,osc->oc", velocity[:size], values) + direct
    is_thrown = order > 1 and blow[0] == 0.0 and blow[1] != 0.0
    return Mechanics(
        rows=values,
        seen=np.stack([values[:, 0], speeds], axis=1),
        at_rest=at_rest,
        follows=np.arange(size) >= order,
        blow=blow,
        thrown=blow / blow[1] if is_thrown else None,
    )


def equations(
    device: Device, above: list["arb"], below: list["arb"], sample_time: float
) -> "arb_mat":
    """Return [[A, B], [0, 0]] of states, the wall's force and the hand's."""
    import flint

    order, actuators = len(below) - 1, len(device.bandwidths)
    size = order + actuators
    wall, hand = size, size + 1
    pull = size - 1 if actuators else wall  # what pulls at the handle, beside the hand
    matrix = flint.arb_mat(size + 2, size + 2)
    for state in range(order):
        matrix[state, 0] = -below[order - 1 - state]
        if state + 1 < order:
            matrix[state, state + 1] = flint.arb(1)
        matrix[state, pull] = matrix[state, hand] = above[order - 1 - state]
    for number, bandwidth in enumerate(device.bandwidths):
        (rate,) = balls_of(turn(bandwidth))
        rate = rate * flint.arb(exact(sample_time))
        state = order + number
        matrix[state, state] = -rate
        matrix[state, state - 1 if number else wall] = rate
    return matrix


def _held(matrix: "arb_mat", fraction: float, offset: float) -> "arb_mat":
    """Return the rows of the states at a time after a sample."""
    import flint

    size = matrix.ncols() - 2
    whole = (matrix * flint.arb(exact(offset))).exp()
    late = flint.arb(exact(offset)) - flint.arb(exact(fraction))
    after = (matrix * late).exp() if offset > fraction else None
    rows: list[list[arb]] = []
    for row in whole.tolist()[:size]:
        *states, wall, hand = row
        arrived = after[len(rows), size] if after is not None else flint.arb(0)
        rows.append([*states, wall - arrived, arrived, hand])
    return flint.arb_mat(rows)


def are_known(matrix: "arb_mat") -> bool:
    """Return whether entries are known to more digits than float64 has, or next to 0."""
    entries = matrix.entries()
    nothing = max((one.abs_lower() for one in entries), key=float) * _NOTHING
    return all(
        one.rel_accuracy_bits() >= _WANTED_BITS or one.abs_upper() <= nothing for one in entries
    )


def _float(ball: "arb") -> float:
    return float(ball.mid())
