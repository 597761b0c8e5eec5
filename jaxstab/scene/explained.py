"""The model in words, with the numbers of a scene; docs/model.md says more."""

from jaxstab.scene.answers import IntervalQuantity, Quantity
from jaxstab.scene.basis import basis_of, grip_in_words
from jaxstab.scene.mechanics import Hand, VibrationMode
from jaxstab.scene.scene import Scene
from jaxstab.scene.units import Units

DIAGRAM = """\
  push of the hand                            +-------------+   +---+
       |                                 +--->| filter P(z) |-->| K |--+
       v         x(t)              x_k   |    +-------------+   +---+  |
  +----------+      +---------+          |                             v
  | device   |----->| sampled |----------+                            (+)--+ f_k
  | and hand |      | every T |          |                             ^   |
  +----------+      +---------+          |    +-------------+   +---+  |   |
       ^                                 +--->| velocity    |-->| B |--+   |
       | -f(t)                                | V(z)        |   +---+      |
       |            +---------+               +-------------+              |
       +------------| held    |         +-------+                          |
                    | for T   |<--------| delay |<-------------------------+
                    +---------+         +-------+
"""

_COUNTED = (
    "counts: reading the encoder, transport there and back (USB, network), waiting, computing, DAC",
    "does not count: the hold of half a sample, and the window or filter, which are modelled",
)
_OUTSIDE = (
    "steps of the encoder, but for their chatter in check; steps of the amplifier",
    "Coulomb friction, saturation",
    "a mass, hand, delay or gain that changes while the wall is touched; several axes at once",
    "bouncing off the wall, estimators that adapt, clocks that jitter",
)
_UNITS = ("kg", "N/m", "N s/m")
_NAME = 14  # where what is said of a block begins


def explain_model(scene: Scene) -> str:
    """Return the loop as a diagram, its blocks as the scene has them, and what is outside of it."""
    blocks = [f"{name:{_NAME}}{words}" for name, words in _blocks(scene).items()]
    counted = [f"{'':{_NAME}}{words}" for words in _COUNTED]
    every = [", ".join(_not_modelled(scene)), *_OUTSIDE]
    outside = [f"{'' if number else 'outside':{_NAME}}{w}" for number, w in enumerate(every)]
    return "\n".join([DIAGRAM, *blocks, *counted, *outside])


def _blocks(scene: Scene) -> dict[str, str]:
    device, controller, hand = scene.device, scene.controller, scene.hand or Hand()
    basis, units, time = basis_of(scene), scene.units, Quantity("s")
    held = zip((hand.effective_mass, hand.stiffness, hand.damping), _UNITS, strict=True)
    turning = "" if units is Units.LINE else ", which turns"
    own = _range(device.effective_mass, "kg", units)
    blocks = {"device": f"{own}, {Quantity('N s/m').words(device.damping, units)}{turning}"}
    for number, mode in enumerate(device.modes, 1):
        blocks[f"mode {number}"] = _mode(mode, units)
    if device.actuator is not None:
        blocks["actuator"] = f"a first-order lag of {device.actuator.bandwidth:g} Hz of the force"
    blocks["hand"] = ", ".join(_range(*one, units) for one in held) if scene.hand else "none"
    if hand.grip is not None:
        blocks["grip"] = f"{grip_in_words(hand.grip, units)}, between device and hand"
    return blocks | {
        "T": time.words(controller.sample_time),
        "velocity V(z)": basis.velocity,
        "filter P(z)": basis.position or "none",
        "delay": basis.delay_in_words,
    }


def _range(ends: tuple[float, float], unit: str, units: Units) -> str:
    """Return a number, or the two ends of a range."""
    if ends[0] == ends[1]:
        return Quantity(unit).words(ends[0], units)
    return IntervalQuantity(unit).words(ends, units)


def _not_modelled(scene: Scene) -> list[str]:
    """Return what the scene leaves out of what it might say of device and hand."""
    device, hand = scene.device, scene.hand
    return [
        "vibration modes other than these" if device.modes else "vibration modes",
        *([] if device.actuator else ["bandwidth of motor and amplifier"]),
        *([] if hand is None or hand.grip else ["a grip that gives way"]),
    ]


def _mode(mode: VibrationMode, units: Units) -> str:
    mass = Quantity("kg").words(mode.effective_mass, units)
    return f"{mode.frequency:g} Hz, damping ratio {mode.damping_ratio:g}, {mass}"
