"""Which walls of a held device no hand can draw energy from: what ``exact.passive`` is asked."""

from functools import partial
from math import inf

from jaxstab.exact.passive import Wall, are_covered
from jaxstab.model import LoopParameters
from jaxstab.model.balls import ball_loop
from jaxstab.model.device.parts import FIRST_BITS, MassSpringDamper, working_precision


def passive_wall(loop: LoopParameters) -> Wall:
    """The filters, the delay and the device's own damper of a loop of single numbers; ValueError.

    The mass, the spring and the hand, passive themselves, play no part; the hand's damper does not
    count, for other hands have none.
    """
    damper = loop.device_damping
    if loop.device is not None:
        body = loop.device.mechanism
        if not isinstance(body, MassSpringDamper) or min(loop.device.bandwidths, default=inf) < inf:
            raise ValueError(
                f"the device is {loop.device}; passive walls are known of one mass alone, at whose "
                "handle force and position are the motor's and the encoder's. Give device_mass and "
                "device_damping."
            )
        damper = body.damping

    factors = partial(ball_loop, loop)
    with working_precision(FIRST_BITS):
        is_covered = are_covered(factors())
    if not is_covered:
        raise ValueError(
            "a filter of the loop is not stable, or the velocity of a position at rest is not 0, "
            "or a constant position is not passed with its sign; no wall is known to be passive."
        )
    assert damper is not None  # beside device_mass
    return Wall(factors, float(loop.delay_samples), float(loop.sample_time), float(damper))
