"""Systems of python-control and of scipy.signal as numbers; neither of them is imported."""

from typing import Any

import numpy as np


def matrices_of(system: Any) -> tuple[Any, Any, Any] | None:
    """Return A, B and C of a state space, None for a system of another kind.

    Raises:
        ValueError: it is sampled, or has a direct way from force to position, or is no system of
            one force and one position.
    """
    if not all(hasattr(system, name) for name in "ABCD"):
        return None
    _refuse_sampled(system)
    a, b, c, d = (np.atleast_2d(getattr(system, name)) for name in "ABCD")
    _refuse_many(b.shape[1], c.shape[0])
    if np.any(d):
        raise ValueError(
            f"D is {d.tolist()}; position over force is strictly proper in s: give D = 0."
        )
    return a, b, c


def coefficients_of(system: Any) -> tuple[Any, Any]:
    """Return numerator and denominator of a transfer function, highest power first.

    Raises:
        TypeError: it is no system.
        ValueError: it is sampled, or no system of one force and one position.
    """
    if all(hasattr(system, name) for name in ("zeros", "poles", "gain", "to_tf")):  # of scipy
        system = system.to_tf()
    if not (hasattr(system, "num") and hasattr(system, "den")):
        raise TypeError(
            f"system is {system!r}; give a TransferFunction or StateSpace of python-control or "
            "scipy.signal."
        )
    _refuse_sampled(system)
    numerator, denominator = system.num, system.den
    if isinstance(numerator, list):  # python-control: a row of lists for each output
        _refuse_many(len(numerator[0]), len(numerator))
        numerator, denominator = numerator[0][0], denominator[0][0]
    return np.atleast_1d(numerator), np.atleast_1d(denominator)


def _refuse_sampled(system: Any) -> None:
    if getattr(system, "dt", None) not in (None, 0):
        raise ValueError(
            f"the system is sampled, with dt = {system.dt}; give the device itself, in s, not in z."
        )


def _refuse_many(inputs: int, outputs: int) -> None:
    if (inputs, outputs) != (1, 1):
        raise ValueError(
            f"the system has {inputs} inputs and {outputs} outputs; give one force, one position."
        )
