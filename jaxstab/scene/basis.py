"""The basis of a scene's answers, stated in front of them."""

from jaxstab.scene.answers import Basis, IntervalQuantity, Quantity
from jaxstab.scene.mechanics import Grip
from jaxstab.scene.scene import Scene
from jaxstab.scene.units import Units

_ASSUMED = "the difference over one sample (assumed: the scene names no estimator)"
_NO_DELAY = "assumed: the scene names none"


def basis_of(scene: Scene) -> Basis:
    """Return what the answers hold for: estimator, filter, delay, device, hand, and what moves."""
    controller, device, hand = scene.controller, scene.device, scene.hand
    is_given = controller.delay is not None or controller.delay_samples is not None
    return Basis(
        velocity=_ASSUMED if controller.velocity is None else str(controller.velocity),
        position=None if controller.position is None else str(controller.position_filter),
        sample_time=controller.sample_time,
        delay=controller.time_delay,
        delay_samples=controller.samples,
        delay_is=None if is_given else _NO_DELAY,
        mass=device.effective_mass,
        damping=device.damping,
        hand_mass=None if hand is None else hand.effective_mass,
        hand_stiffness=None if hand is None else hand.stiffness,
        hand_damping=None if hand is None else hand.damping,
        mechanics=_beside_one_mass(scene),
        postures=_postures(scene),
        motion=None if scene.units is Units.LINE else "rotation",
    )


def grip_in_words(grip: Grip, units: Units) -> str:
    """Return stiffness and damping of a grip."""
    spring = Quantity("N/m").words(grip.stiffness, units)
    return f"{spring}, {Quantity('N s/m').words(grip.damping, units)}"


def _postures(scene: Scene) -> str | None:
    """Return the range of the device's mass in words; None for a single mass."""
    if not scene.device.varies:
        return None
    words = IntervalQuantity("kg").words(scene.device.effective_mass, scene.units)
    return f"a device of {words}, constant while a wall is touched"


def _beside_one_mass(scene: Scene) -> str | None:
    """Return in words what moves beside the mass of device and hand; None for nothing."""
    device, grip, units = scene.device, scene.hand.grip if scene.hand else None, scene.units
    words = []
    if device.modes:
        words.append(f"modes at {', '.join(f'{mode.frequency:g}' for mode in device.modes)} Hz")
    if device.actuator is not None:
        words.append(f"an actuator of {device.actuator.bandwidth:g} Hz")
    if grip is not None:
        words.append(f"a grip of {grip_in_words(grip, units)}")
    return "; ".join(words) or None
