"""The guard of a scene: for the masses of its device and the delays of its loop."""

from collections.abc import Callable

from jaxstab.guard import Guard, build_guard, guard_header
from jaxstab.ranges import HandRange
from jaxstab.scene.basis import basis_of
from jaxstab.scene.loops import hands_of, loop_of
from jaxstab.scene.scene import Scene

Range = tuple[float, float]

_MASSES = 0.8, 1.25  # of the scene's: what postures may make of it
_DELAYS = -1.0, 1.0  # samples beside the scene's


def scene_guard(
    scene: Scene,
    masses: Range | None = None,
    delays: Range | None = None,
    *,
    progress: Callable[[float], None] | None = None,
    **cells: tuple[int, int, int],
) -> Guard:
    """Return the guard of a scene: see ``jaxstab.build_guard``.

    Args:
        scene: the scene; its hands are those of the guard.
        masses: of the device in kg; None for 0.8 to 1.25 times the scene's.
        delays: in s; None for one sample less to one sample more than the scene's.
        progress: is told which share of the proof is done.
        cells: ``cells=`` of ``build_guard``.

    Raises:
        ValueError, NotImplementedError, RuntimeError: as ``build_guard``.
    """
    loop = loop_of(scene)
    hand = loop.hand_mass, loop.hand_stiffness, loop.hand_damping
    hands = hands_of(scene) or HandRange(*((value, value) for value in hand))
    mass, delay, period = scene.device.effective_mass, loop.delay, loop.sample_time
    return build_guard(
        loop,
        hands,
        masses or (_MASSES[0] * mass, _MASSES[1] * mass),
        delays or (max(delay + _DELAYS[0] * period, 0.0), delay + _DELAYS[1] * period),
        progress=progress,
        **cells,
    )


def guard_about(scene: Scene, guard: Guard) -> str:
    """Return what a guard is of, in lines."""
    units, basis, hands = scene.units, basis_of(scene), guard.hands
    filtered = [] if basis.position is None else [f"position: {basis.position}"]
    return "\n".join(
        [
            _line(f"{units.moved} of the device", guard.mass, units.kilogram),
            _line("delay", guard.delay, "s"),
            f"damping of the device: {guard.loop.device_damping:g} {units.damping}",
            f"sample time: {guard.loop.sample_time:g} s",
            f"velocity: {basis.velocity}",
            *filtered,
            _line(f"{units.moved} of the hand", hands.mass, units.kilogram),
            _line("stiffness of the hand", hands.stiffness, units.stiffness),
            _line("damping of the hand", hands.damping, units.damping),
            "",
            f"It grants {100.0 * guard.granted:.1f} % of the stable stiffness, in the mean.",
        ]
    )


def header_of(scene: Scene, guard: Guard, name: str) -> str:
    """Return the header of a scene's guard, with what it is of: ``jaxstab.guard_header``."""
    units = scene.units
    words = units.kilogram, units.stiffness, units.damping
    return guard_header(guard, name, guard_about(scene, guard), words)


def _line(name: str, ends: Range, unit: str) -> str:
    return f"{name}: {ends[0]:g} to {ends[1]:g} {unit}"
