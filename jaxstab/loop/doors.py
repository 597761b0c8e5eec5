"""The doors to loops of two gains: a simulator, an admittance, PID, two coupled devices.

Each checks numbers that its users know, and makes the parts of p(z) (``model.affine``) with the
names and units of the gains.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxstab.loop.affine import Loop
from jaxstab.loop.gains import Gain
from jaxstab.model import LoopParameters
from jaxstab.model.affine import RULES, AdmittanceParts, CouplingParts, PidParts, SimulatedParts
from jaxstab.model.device import Device
from jaxstab.model.device.device import in_steps
from jaxstab.model.filters import Filter, Velocity, filter_on
from jaxstab.model.parameters import LONGEST_DELAY
from jaxstab.numbers import checked_count, checked_number, checked_word, require_kind

if TYPE_CHECKING:
    from jaxstab.loop.loop import HapticLoop


def simulated_pd(
    inertia: float,
    *,
    step: float,
    damping: float = 0.0,
    stiffness: float = 0.0,
    integrator: str = "semi-implicit",
    outside: bool = False,
    substeps: int = 1,
    delay_steps: int = 0,
) -> Loop:
    """PD control of a joint in a physics engine; the gains are ``kp`` and ``kd``.

    The torque is -kp q - kd v, v the engine's own velocity. By default the PD is part of the
    engine's step, as a position actuator is. With ``outside``, ``substeps`` or ``delay_steps`` it
    is computed outside: its torque is held through ``substeps`` steps and acts ``delay_steps``
    later.

    Args:
        inertia: of the joint with its armature in kg m^2, > 0 (or a mass in kg). Of several joints
            under the same gains: 1 over the largest eigenvalue of the inverse mass matrix, not the
            diagonal.
        step: of the engine in s, > 0.
        damping: of the joint in N m s/rad, >= 0.
        stiffness: of a passive spring in N m/rad, >= 0.
        integrator: "semi-implicit", MuJoCo's Euler with eulerdamp disabled; "implicit-joint", its
            Euler as shipped, in which joint damping is implicit; "implicit-damping", its implicit
            and implicitfast, in which kd is implicit, too; "implicit", kp and kd both, the stable
            PD of Tan, Liu, Turk (2011), a passive spring explicit; "explicit", forward Euler;
            "rk4", Runge-Kutta, outside only.
        outside: True for a PD that is computed outside of the engine.
        substeps: engine steps per control step, from 1 on; more than 1 is outside.
        delay_steps: engine steps by which the torque is late, 0 or more; not 0 is outside.

    Raises: see ``jaxstab.conventions``; ValueError also for "rk4" inside of the engine: p(z) is not
    affine in the gains there.

    Source: eq. (9), likewise, with an engine's step in place of the exact one.

    Example:
        >>> loop = jaxstab.simulated_pd(2.216e-5, step=5e-3)
        >>> round(loop.limits().first.value, 2)
        3.55
    """
    joint: Any = Device.simulated(
        inertia, step=step, damping=damping, stiffness=stiffness, integrator=integrator
    ).mechanism
    substeps = checked_count("substeps", substeps, 1, 1000)
    delay_steps = checked_count("delay_steps", delay_steps, 0, int(LONGEST_DELAY) * substeps)
    is_outside = outside or substeps > 1 or delay_steps > 0
    if integrator == "rk4" and not is_outside:
        raise ValueError(
            'integrator is "rk4" and the PD is inside of the engine, whose stages ask for it '
            "again: p(z) is not affine in the gains; give outside=True if the torque is held, or "
            "another integrator."
        )
    parts = SimulatedParts(joint, is_outside, substeps, delay_steps)
    gains = Gain("kp", "N m/rad"), Gain("kd", "N m s/rad")
    where = f"outside of it, every {substeps} steps" if is_outside else "inside its step"
    words = f"PD of a simulated joint ({integrator}), {where}"
    return Loop(parts, gains, joint.step * substeps, words)


def admittance(
    environment: float,
    *,
    sample_time: float,
    delay_samples: int = 0,
    rule: str = "forward",
    stiffness: float = 0.0,
    robot: Filter | None = None,
    force_filter: Filter | None = None,
) -> Loop:
    """A robot that moves like a mass and a damper under the measured force: ``mass``, ``damping``.

    At every sample the force of an environment of stiffness Ke moves the virtual mass, and the
    robot follows it ``delay_samples`` later: F = -Ke x. Stiff environments ask for a large mass and
    damping; below a damping of Ke times the whole delay in s the mass has a largest value, too.

    Args:
        environment: its stiffness Ke in N/m, > 0.
        sample_time: T in s, > 0.
        delay_samples: samples by which the robot follows its command, 0 or more.
        rule: "forward", v + T/M (F - D v), then x + T v with the new v; "backward", with the new v
            in the damper's force; "explicit", x with the old v; "trapezoid", Tustin's rule, which
            takes the mean of old and new for v, x and F. The exact exponential of D T/M is not
            affine in the gains.
        stiffness: of a virtual spring beside mass and damper in N/m, >= 0.
        robot: its response from command to position, a filter; None for the delay alone.
        force_filter: of the measured force; None for none.

    Raises: see ``jaxstab.conventions``.

    Source: eq. (9), likewise; the virtual mass in place of the device's.

    Example:
        >>> loop = jaxstab.admittance(1e3, sample_time=2e-3, delay_samples=10)
        >>> line = loop.intervals(mass=10.0)
        >>> [(round(low.value, 6), round(high.value, 6)) for low, high in line.intervals]
        [(19.870572, 9999.0)]
    """
    wall = checked_number("environment", environment, 0.0, is_open=True, unit="N/m")
    period = checked_number("sample_time", sample_time, 0.0, is_open=True, unit="s")
    late = checked_count("delay_samples", delay_samples, 0, int(LONGEST_DELAY))
    checked_word("rule", rule, RULES)
    spring = checked_number("stiffness", stiffness, 0.0, unit="N/m")
    filters = [_filter("robot", robot, period), _filter("force_filter", force_filter, period)]
    parts = AdmittanceParts(wall, period, late, rule, spring, filters[0], filters[1])
    gains = Gain("mass", "kg", "least"), Gain("damping", "N s/m", "least")
    sides = {"backward": " + T damping", "trapezoid": " + T damping/2"}.get(rule, "")
    sides += " + T^2 stiffness/4" if spring and rule == "trapezoid" else ""
    mass = f"(mass{sides})" if sides else "mass"
    chart = Gain(f"1/{mass}", "1/kg"), Gain(f"damping/{mass}", "1/s")
    return Loop(parts, gains, period, f"admittance control against {wall:g} N/m", chart)


def _filter(name: str, value: Any, period: float) -> Filter:
    if value is None:
        return Filter()
    require_kind(name, value, Filter)
    value.checked(period)
    return value


def pid(
    loop: "HapticLoop",
    *,
    kp: float | None = None,
    ki: float | None = None,
    kd: float | None = None,
    rule: str = "backward",
    kd_delay: float | None = None,
) -> Loop:
    """PID control of a held device, one gain given; the gains are the two others.

    The force is -(kp x + ki I + kd v), x the position, filtered if there is a filter, v the
    estimated velocity, and I the sum of T x by a rule of integration. Without a spring a free
    device has no stable integrator alone: kp must exceed about (m/(kd + b)) ki. Given ki = 0 there
    is no integrator: kp and kd are those of a wall, and may have delays of their own.

    Args:
        loop: device, sample time, delay, estimator and filter; its hand belongs to the device.
        kp: in N/m, if it is the gain that is given.
        ki: in N/(m s), if it is.
        kd: in N s/m, if it is.
        rule: of the integrator: "backward" adds the new sample, "forward" the last one,
            "trapezoid" the mean of both.
        kd_delay: delay of the derivative's force in s; None for that of the loop.

    Raises: TypeError unless one gain is given; see also ``jaxstab.conventions``.

    Source: eq. (9), likewise.

    Example:
        >>> device = jaxstab.HapticLoop(
        ...     device_mass=0.25, device_damping=0.1, sample_time=1e-3, delay=1e-3
        ... )
        >>> line = jaxstab.pid(device, kd=50.0).intervals(kp=5000.0)
        >>> [(low.value, round(high.value, 4)) for low, high in line.intervals]
        [(0.0, 1024414.8031)]
        >>> fast = jaxstab.pid(device, ki=0.0, kd_delay=0.0)  # the drive adds the damping itself
        >>> [round(loop.limits().first.value) for loop in (jaxstab.pid(device, ki=0.0), fast)]
        [36168, 171706]
    """
    require_kind("loop", loop, LoopParameters, "HapticLoop")
    given = {
        name: value for name, value in (("kp", kp), ("ki", ki), ("kd", kd)) if value is not None
    }
    if len(given) != 1:
        raise TypeError(
            f"gains given: {', '.join(given) or 'none'}; give one of kp, ki and kd, the two others "
            "are the gains of the loop."
        )
    ((name, value),) = given.items()
    number = checked_number(name, value)
    checked_word("rule", rule, tuple(rule for rule in RULES if rule != "explicit"))
    units = {"kp": "N/m", "ki": "N/(m s)", "kd": "N s/m"}
    others = [Gain(other, unit) for other, unit in units.items() if other != name]
    plain = loop.in_floats()
    late = plain if kd_delay is None else replace(plain, delay=kd_delay)
    parts = PidParts(plain, late, name, number, rule)
    words = f"PID with {name} = {number:g} {units[name]}"
    return Loop(parts, (others[0], others[1]), float(parts.loop.sample_time), words)


def coupling(
    first: Device,
    second: Device,
    *,
    sample_time: float,
    delays_samples: Sequence[float] = (1.0, 0.0),
    velocity: Velocity | None = None,
) -> Loop:
    """A virtual spring and damper between two devices; the gains are ``stiffness`` and ``damping``.

    Both devices are computed in one place: the force on the one is the opposite of that on the
    other, each behind its own hold and delay. A rigid motion that both share, a common
    drift, is moved by no gain: it is left out, and the answers are about all other roots.

    Args:
        first: a device, hands included, or one in z, such as a tool of a simulation.
        second: the other one.
        sample_time: T in s, > 0.
        delays_samples: of each device, from its position to its force, in samples.
        velocity: the estimator of the relative velocity; None for the difference over one sample,
            ``Velocity.measured()`` if both devices have a velocity of their own.

    Raises: see ``jaxstab.conventions``.

    Source: eq. (9), likewise, for the plant G1 + G2.

    Example:
        >>> left = jaxstab.Device.mass_spring_damper(mass=0.25, damping=0.1)
        >>> right = jaxstab.Device.mass_spring_damper(mass=0.5, damping=0.2)
        >>> loop = jaxstab.coupling(left, right, sample_time=1e-3, delays_samples=(1.0, 2.0))
        >>> line = loop.intervals(damping=30.0)
        >>> [(low.value, round(high.value, 6)) for low, high in line.intervals]
        [(0.0, 12779.059143)]
        >>> tool = jaxstab.Device.simulated(0.05, step=1e-3)
        >>> line = jaxstab.coupling(left, tool, sample_time=1e-3).intervals(damping=8.0)
        >>> [(round(low.value), round(high.value)) for low, high in line.intervals]
        [(0, 34312), (130060, 184003)]
    """
    for name, device in (("first", first), ("second", second)):
        require_kind(name, device, Device)
    period = checked_number("sample_time", sample_time, 0.0, is_open=True, unit="s")
    if np.shape(delays_samples) != (2,):
        raise ValueError(f"delays_samples is {delays_samples}; give one delay for each device.")
    delays = [
        checked_number("delays_samples", delay, 0.0, LONGEST_DELAY) for delay in delays_samples
    ]
    if velocity is not None:
        require_kind("velocity", velocity, Velocity)
        filter_on(velocity, first.mechanism, second.mechanism).checked(period)
    for device, delay in zip((first, second), delays, strict=True):
        if own := in_steps(device):
            own.steps(period, delay)
    parts = CouplingParts((first, second), period, (delays[0], delays[1]), velocity)
    gains = Gain("stiffness", "N/m"), Gain("damping", "N s/m")
    return Loop(parts, gains, period, "a coupling between two devices")
