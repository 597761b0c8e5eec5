"""The slowest mode of the loop, as damping ratio and frequency."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64

from jaxstab.arrays import Array, Numbers, namespace
from jaxstab.model import by_name, require_x64
from jaxstab.model.filters import Filter, Velocity
from jaxstab.point.poles import closed_loop_poles


class Oscillation(NamedTuple):
    """The mode of the pole with the largest modulus.

    ``damping_ratio`` is 1 for a mode that creeps without oscillating, 0 on the edge of stability
    and negative where the oscillation grows. ``frequency`` is that of the damped oscillation,
    between 0 and the Nyquist frequency; a pole on the negative axis is at the Nyquist frequency.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> mode = loop.oscillation(20000.0, 20.0)
        >>> print(f"damping ratio {mode.damping_ratio:.3f}, {mode.frequency:.1f} Hz")
        damping ratio 0.109, 77.5 Hz
    """

    damping_ratio: Float64[Array, "*grid"]
    frequency: Float64[Array, "*grid"]


def dominant_mode(
    alpha: Numbers,
    beta: Numbers,
    *,
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> Oscillation:
    """Return damping ratio and frequency of the slowest pole z = exp(s), in samples.

    The damping ratio is -Re s / |s|, the frequency |Im s| in rad per sample, at most pi. Near a
    double real pole the companion eigenvalues may split into a pair with a tiny frequency.

    Args:
        alpha: wall stiffness K T^2/m, any shape; like all arguments it broadcasts.
        beta: wall damping B T/m.
        gamma: physical stiffness k T^2/m in [0, 1e4].
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, concrete.
        velocity: the velocity estimator in units of one sample; None for the difference over one.
        position: the position filter in units of one sample; None for none.

    Returns:
        Oscillation of arrays of the broadcast shape.

    Raises:
        ValueError: a concrete argument is outside its range, infinite or NaN.
        TypeError: the delay is traced.
        RuntimeError: JAX arrays are given without x64.

    Source: the poles of eq. (9); z = exp(s T).

    Example:
        >>> mode = jaxstab.dominant_mode(0.2, 0.2, gamma=0.0, delta=0.015, delay=0.0)
        >>> round(float(mode.damping_ratio), 4)
        0.1086
    """
    require_x64(alpha, beta, gamma, delta)
    point = alpha, beta, gamma, delta, delay
    return mode_of(closed_loop_poles(**by_name(*point), velocity=velocity, position=position))


def mode_of(poles: Complex128[Array, "*grid degree"]) -> Oscillation:
    """Return damping ratio and frequency in rad per sample of the first pole of each loop."""
    xp, pole = namespace(poles), poles[..., 0]
    with np.errstate(all="ignore"):  # a pole at 0 or at 1
        decay, frequency = -xp.log(abs(pole)), abs(xp.angle(pole))
        return Oscillation(decay / xp.hypot(decay, frequency), frequency)
