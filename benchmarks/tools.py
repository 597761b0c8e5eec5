"""How far may one gain go: what people use in place of jaxstab, each as short as it goes.

`python -m benchmarks.tools NAME` answers ``EXAMPLE`` in a fresh process. A tool imports what it
needs when it is asked. All but the simulation are given p(z), whose forming (hold, delay, filters)
would be theirs, too; bisections end at neighbouring numbers. None of them proves an answer but
``by_fractions``, and that about coefficients that were rounded.
"""

import sys
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np


class Line(NamedTuple):
    """p(z) = base + t first + other second, stable at t = start: how far may t go?

    Coefficients have the highest power first; ``towards`` is 2 for the largest t, 0.5 for the
    least. The simulation reads ``joint`` in their place: ``Joint``.
    """

    base: np.ndarray
    first: np.ndarray
    second: np.ndarray
    other: float
    start: float
    towards: float = 2.0
    joint: Any = None

    def at(self, t: Any, other: Any = None) -> np.ndarray:
        """Coefficients in the last axis."""
        u = self.other if other is None else other
        parts = (
            np.multiply.outer(gain, part) for gain, part in ((t, self.first), (u, self.second))
        )
        return self.base + sum(parts)


class Joint(NamedTuple):
    """A joint of MuJoCo, its integrator, and how its torque is computed: inside or outside."""

    inertia: float
    damping: float
    step: float
    integrator: str
    substeps: int = 0  # inside
    delay_steps: int = 0


MUJOCO = "MuJoCo, bisection"
EXAMPLE = Line(  # one mass, one sample of delay: alpha at beta = 0.15
    np.array([1.0, -2.0, 1.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.5, 0.5, 0.0]),
    np.array([0.0, 0.0, 0.5, 0.0, -0.5]), 0.15, 1e-3, 2.0, Joint(1.0, 0.0, 1.0, "Euler"),
)  # fmt: skip

IsStable = Callable[[Line, Any], bool]


def bracketed(line: Line, is_stable: IsStable) -> tuple[float, float]:
    """The last stable and the first unstable of start, start towards, start towards^2 .."""
    t = line.start
    while is_stable(line, t * line.towards):
        t *= line.towards
    return t, t * line.towards


def bisected(line: Line, is_stable: IsStable, halvings: int = 52) -> float:
    stable, unstable = bracketed(line, is_stable)
    for _ in range(halvings):
        middle = 0.5 * (stable + unstable)
        stable, unstable = (middle, unstable) if is_stable(line, middle) else (stable, middle)
    return stable


def by_numpy(line: Line, t: float) -> bool:
    return bool(np.abs(np.roots(line.at(t))).max() < 1.0)


def scipy_brentq(line: Line) -> float:
    from scipy.optimize import brentq

    ends = bracketed(line, by_numpy)
    return float(brentq(lambda t: np.abs(np.roots(line.at(t))).max() - 1.0, *ends, xtol=1e-300))


def _opened(line: Line) -> Any:
    import control

    return control.tf(np.trim_zeros(line.first, "f"), line.at(0.0), dt=True)


def by_control(line: Line, t: float) -> bool:
    return bool(np.abs((t * _opened(line)).feedback().poles()).max() < 1.0)


def control_margins(line: Line, method: str) -> float:
    """The crossings of the phase by -180 degrees, as gains."""
    import control

    gains = control.stability_margins(_opened(line), returnall=True, method=method)[0]
    beyond = gains[gains > line.start] if line.towards > 1.0 else gains[gains < line.start]
    return float(beyond.min() if line.towards > 1.0 else beyond.max())


def control_root_locus(line: Line) -> float:
    import control

    gains = np.linspace(*bracketed(line, by_control), 1000)
    loci = control.root_locus_map(_opened(line), gains=gains).loci
    return float(gains[np.argmax(np.abs(loci).max(axis=1) >= 1.0)])


def grid_and_contour(line: Line, count: int) -> float:
    """The contour of the spectral radius in the plane of both gains, where it crosses the line."""
    import contourpy

    t, u = (np.linspace(*ends, count) for ends in (sorted(bracketed(line, by_numpy)), (0.9, 1.1)))
    p = line.at(t, line.other * u[:, None] + 0.0 * t)
    companion = np.zeros((*p.shape[:-1], p.shape[-1] - 1, p.shape[-1] - 1))
    companion[...] = np.eye(p.shape[-1] - 1, k=-1)
    companion[..., 0, :] = -p[..., 1:] / p[..., :1]
    radius = np.abs(np.linalg.eigvals(companion)).max(axis=-1)
    crossings = [
        x0 + (1.0 - y0) / (y1 - y0) * (x1 - x0)
        for polyline in contourpy.contour_generator(t, u, radius).lines(1.0)
        for (x0, y0), (x1, y1) in pairwise(polyline.tolist())
        if (y0 < 1.0) != (y1 < 1.0)
    ]
    return min(crossings) if line.towards > 1.0 else max(crossings)


def by_fractions(line: Line, t: float) -> bool:
    """The recursion of Schur and Cohn in exact fractions, of python-flint."""
    from flint import fmpq

    base, first, second = (
        [fmpq(*c.as_integer_ratio()) for c in part.tolist()] for part in line[:3]
    )
    gains = [fmpq(*gain.as_integer_ratio()) for gain in (float(t), line.other)]
    p = [b + gains[0] * f + gains[1] * s for b, f, s in zip(base, first, second, strict=True)]
    while len(p) > 1:
        k = p[-1] / p[0]
        if abs(k) >= 1:
            return False
        p = [a - k * b for a, b in zip(p[:-1], p[:0:-1], strict=True)]
    return True


def by_simulation(line: Line, t: float) -> bool:
    """True if a joint comes closer to rest within 5,000 steps of MuJoCo."""
    import mujoco

    joint, held = line.joint, line.joint.substeps > 0
    gains = f'kp="{t!r}" kv="{line.other!r}"'
    model = mujoco.MjModel.from_xml_string(f"""
        <mujoco><option timestep="{joint.step!r}" integrator="{joint.integrator}" gravity="0 0 0">
          <flag autoreset="disable" contact="disable"/></option>
          <worldbody><body><joint name="j" type="hinge" damping="{joint.damping!r}"/>
            <inertial pos="0 0 0" mass="1" diaginertia="{3 * f"{joint.inertia!r} "}"/>
          </body></worldbody>
          <actuator>{'<motor joint="j"/>' if held else f'<position joint="j" {gains}/>'}</actuator>
        </mujoco>""")
    data, late, count = mujoco.MjData(model), [0.0] * joint.delay_steps, joint.substeps or 10
    data.qpos[0] = 1e-3
    for _ in range(5000 // count):
        if held:
            late.append(float(-t * data.qpos[0] - line.other * data.qvel[0]))
            data.ctrl[0] = late.pop(0)
        mujoco.mj_step(model, data, nstep=count)
        if abs(data.qpos[0]) > 1.0:
            return False
    return bool(abs(data.qpos[0]) + joint.step * abs(data.qvel[0]) < 1e-3)


class Tool(NamedTuple):
    """The end of a line, the functions that a user writes for it, and a verdict of its own."""

    end: Callable[[Line], float]
    written: tuple[Callable[..., Any], ...]
    is_stable: IsStable | None = None


def _by_bisection(is_stable: IsStable, halvings: int = 52) -> Tool:
    end = partial(bisected, is_stable=is_stable, halvings=halvings)
    return Tool(end, (bracketed, bisected, is_stable), is_stable)


TOOLS = {
    "numpy.roots, bisection": _by_bisection(by_numpy),
    "scipy brentq": Tool(scipy_brentq, (scipy_brentq, bracketed, by_numpy)),
    "python-control margins": Tool(
        partial(control_margins, method="best"), (_opened, control_margins), by_control
    ),
    "python-control margins, poly": Tool(
        partial(control_margins, method="poly"), (_opened, control_margins)
    ),
    "python-control root locus": Tool(
        control_root_locus, (_opened, bracketed, by_control, control_root_locus)
    ),
    **{
        f"grid of {count} x {count}, contourpy": Tool(
            partial(grid_and_contour, count=count), (bracketed, by_numpy, grid_and_contour)
        )
        for count in (16, 50, 160)
    },
    "python-flint, exact fractions": _by_bisection(by_fractions),
    MUJOCO: _by_bisection(by_simulation, 20),
}

if __name__ == "__main__":
    print(TOOLS[sys.argv[1]].end(EXAMPLE))
