"""The loop of one mass on the unit circle, in float64 that NumPy and JAX share.

With z = e^(i theta), m = floor(delay) + 1 and the notation of ``jaxstab.region.closed_form``,

    g = D/z + z^-m (N/z) H,      H = alpha P + beta V,

P = 1 and V = 1 - 1/z without filters; then g = p(z) / z^(m + 2). ``quick_plant`` computes D and N
by a Taylor series of the step response and doublings of its time; ``Responses`` has P
and V as numbers that a compiled program takes, and ``circle_equations`` the two real equations of a
root on the circle. Nothing here is a bound: searches and derivatives start from it.
"""

from collections.abc import Iterable
from math import pi
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import PI_REST, Array, Numbers, namespace, repeat
from jaxstab.model.filters import Filters
from jaxstab.model.plant import PlantCoefficients

OverSine = tuple[Array, Array]

"""Re f and Im f / sin(theta) of a function with real coefficients at e^(i theta)."""


class Responses(NamedTuple):
    """P and V as numbers that a compiled program takes: V is (1 - z^-n) / n times its chain.

    They are JAX's where JAX traces the filters.

    chains: of P and of V, its stages, each a numerator and a denominator in powers of 1/z, lowest
        power first. Stages and coefficients are filled up to powers of two: few shapes.
    """

    samples: Float64[Array, ""]
    chains: Float64[Array, "2 stage 2 power"]

    @classmethod
    def from_filters(cls, filters: Filters | None) -> "Responses":
        """Return the responses of filters in units of one sample; None has no stages."""
        if filters is None:
            return cls(np.array(1.0), np.zeros((2, 0, 2, 1)))
        velocity, position = filters
        samples, stages = velocity.stages()
        both = position.stages(), stages
        longest = max([4, *(len(side) for chain in both for stage in chain for side in stage)])
        count = _power_of_two(max(2, *map(len, both))) if any(both) else 0
        power = _power_of_two(longest)

        def filled(side: tuple[Array, ...]) -> list[Array]:
            return [*side, *[0.0] * (power - len(side))]

        unit = (1.0,), (1.0,)
        rows = [
            [[filled(side) for side in stage] for stage in (*chain, *[unit] * (count - len(chain)))]
            for chain in both
        ]
        chains = namespace(filters).asarray(rows).reshape(2, count, 2, power)
        return cls(np.array(float(samples)), chains)

    def over_sine(self, theta: Array) -> tuple[OverSine, OverSine]:
        """Return P and V at z = e^(i theta), smooth in theta at 0 and pi."""
        xp = namespace(self, theta)
        versine = 2.0 * xp.sin(0.5 * self.samples * theta) ** 2
        ratio = turns_over_sine(self.samples, theta)[1]
        position = xp.ones_like(theta), xp.zeros_like(theta)
        velocity = versine / self.samples, ratio / self.samples
        if not self.chains.shape[1]:
            return position, velocity
        square = xp.sin(theta) ** 2
        cosines, ratios = turns_over_sine(xp.arange(self.chains.shape[-1]), theta[..., None])

        def through(value: OverSine, chain: Array) -> OverSine:
            for above, below in chain:
                numerator, denominator = ((cosines @ p, -(ratios @ p)) for p in (above, below))
                size = denominator[0] ** 2 + square * denominator[1] ** 2
                conjugate = denominator[0], -denominator[1]
                value = _product(_product(value, numerator, square), conjugate, square)
                value = value[0] / size, value[1] / size
            return value

        return through(position, self.chains[0]), through(velocity, self.chains[1])


def turns_over_sine(count: Array, theta: Array) -> OverSine:
    """Return cos(count theta) and sin(count theta) / sin(theta) for whole counts."""
    xp = namespace(count, theta)
    upper = theta > 0.5 * np.pi
    folded = xp.where(upper, (np.pi - theta) + PI_REST, theta)
    sine, is_end = xp.sin(folded), folded == 0.0
    ratio = xp.where(is_end, count, xp.sin(count * folded) / xp.where(is_end, 1.0, sine))
    sign = xp.where(upper, 1.0 - 2.0 * (count % 2.0), 1.0)
    return sign * xp.cos(count * folded), xp.where(upper, -sign, 1.0) * ratio


def _product(a: OverSine, b: OverSine, square: Array) -> OverSine:
    real = a[0] * b[0] - square * a[1] * b[1]
    return real, a[0] * b[1] + a[1] * b[0]


def _power_of_two(count: int) -> int:
    return 1 << max(count - 1, 0).bit_length()


def responses_at(filters: Filters, theta: Array) -> tuple[Array, Array]:
    """Return P and V at e^(i theta), of NumPy or JAX, without a bound."""
    turn = 1j * namespace(theta).sin(theta)
    position, velocity = Responses.from_filters(filters).over_sine(theta)
    return position[0] + turn * position[1], velocity[0] + turn * velocity[1]


# g is continuous in all six variables, in the delay too. Re g and Im g / sin(theta) are even and 2
# pi-periodic in theta, so the equations Re g = 0, Im g / sin(theta) = 0 of a pair of roots go on
# smoothly to theta = 0 and pi, where the pair meets a real root.

_DOUBLINGS = 12  # enough for the stiffest and most damped hands
_TERMS = 13  # the last power of a time in which the plant moves by 1/4


class Motion(NamedTuple):
    """Position and velocity after a unit step of force on the plant at rest.

    The velocity is the plant's response h to an impulse, the position its integral.
    """

    position: Float64[Array, "*grid"]
    velocity: Float64[Array, "*grid"]


def motion(gamma: Array, delta: Array, time: Array) -> Motion:
    """Sum a Taylor series for a small time and double that time.

    The smallest terms are added first.
    """
    xp = namespace(gamma, delta, time)
    short = time * 2.0**-_DOUBLINGS
    terms = [xp.zeros_like(short), 0.5 * short**2]  # of the position, from the first power on
    for k in range(2, _TERMS):
        following = delta * short * terms[-1] + gamma * short**2 * terms[-2] / k
        terms.append(-following / (k + 1))
    position = moment = terms[0]
    for power in range(_TERMS, 1, -1):
        term = terms[power - 1]
        position, moment = position + term, moment + power * term

    def doubled(half: Motion) -> Motion:
        p, v = half
        return Motion(2 * p - gamma * p**2 + v**2, 2 * v - delta * v**2 - 2 * gamma * p * v)

    start = Motion(position, moment / xp.where(short == 0.0, 1.0, short))
    return repeat(_DOUBLINGS, doubled, start)


def quick_plant(gamma: Array, delta: Array, delay: Array) -> PlantCoefficients:
    """Return the sampled plant in plain float64, good to about 1e-14 of one."""
    xp = namespace(gamma, delta, delay)
    rest_of_sample = xp.floor(delay) + 1.0 - delay
    times = xp.stack(xp.broadcast_arrays(xp.ones_like(gamma + delta), rest_of_sample))
    full, held = map(Motion, *motion(gamma, delta, times))
    impulse_rate = 1.0 - delta * full.velocity - gamma * full.position
    total = full.position + full.velocity**2 - impulse_rate * full.position
    later = full.position - held.position
    n2, early = held
    n1 = later + full.velocity * early - impulse_rate * n2
    n0 = full.velocity * (full.velocity - early) - impulse_rate * later
    d1, d0 = gamma * full.position - 1.0 - impulse_rate, xp.exp(-delta)
    return PlantCoefficients(d1, d0, n2, n1, n0, total, n2 - n1 + n0, gamma * total)


def circle_equations(
    hand: Iterable[Array],
    alpha: Numbers,
    beta: Numbers,
    theta: Array,
    responses: Responses,
    plant: PlantCoefficients | None = None,
) -> tuple[Array, Array]:
    """Return Re g and Im g / sin(theta); differentiable, and smooth in theta at 0 and pi.

    ``hand`` is gamma, delta and the delay, of a plant that is quick to compile if none is given.
    """
    gamma, delta, delay = hand
    c = quick_plant(gamma, delta, delay) if plant is None else plant
    xp = namespace(c, alpha, beta, theta)
    upper = theta > pi / 2
    folded = xp.where(upper, (pi - theta) + PI_REST, theta)
    square = xp.sin(folded) ** 2
    cosine_m, ratio_m = turns_over_sine(xp.floor(delay) + 1.0, theta)
    near, far = 2.0 * xp.sin(0.5 * folded) ** 2, 2.0 * xp.cos(0.5 * folded) ** 2
    h, mirror_h = xp.where(upper, far, near), xp.where(upper, near, far)  # 1 -+ cos(theta)
    kappa, eps, sigma, nu = 1.0 + c.d0, -xp.expm1(-delta), c.n2 + c.n0, c.n2 - c.n0
    d = xp.where(upper, kappa * mirror_h - (1.0 - c.d1 + c.d0), c.den_at_one - kappa * h)
    q = xp.where(upper, sigma * mirror_h - c.difference, c.sum - sigma * h)
    position, velocity = responses.over_sine(theta)
    wall, wall_turned = (alpha * p + beta * v for p, v in zip(position, velocity, strict=True))
    # (N/z) H = push + i sin(theta) turned
    push = q * wall - nu * wall_turned * square
    turned = q * wall_turned + nu * wall
    real = d + cosine_m * push + ratio_m * square * turned
    imaginary = eps + cosine_m * turned - ratio_m * push
    return real, imaginary
