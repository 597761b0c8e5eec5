"""What the answers of a scene hold for, said in front of them."""

from jaxstab.scene.answers import Basis
from jaxstab.scene.scene import Scene
from jaxstab.scene.units import Units

_ASSUMED = "the difference over one sample (assumed: the scene names no estimator)"


def basis_of(scene: Scene) -> Basis:
    """Return the estimator, the filter and the kind of motion of a scene, in words."""
    controller = scene.controller
    return Basis(
        velocity=_ASSUMED if controller.velocity is None else str(controller.velocity),
        position=None if controller.position is None else str(controller.position_filter),
        motion=None if scene.units is Units.LINE else "rotation",
    )
