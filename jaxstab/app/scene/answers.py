"""The basis of a scene's answers, stated in front of them, and its model in words."""

from jaxstab.answers import ASSUMED, Basis, Quantity, Units
from jaxstab.app.scene.scene import ControllerTable, Grip, HandTable, Scene


def _delay_is(controller: ControllerTable, constant: str | None) -> str | None:
    """Describe a range of delays and for which of them answers hold; None for one delay."""
    if controller.has_one_delay:
        is_given = controller.delay is not None or controller.delay_samples is not None
        return None if is_given else ASSUMED
    low, high = controller.delays
    ends = Quantity("s").words((low, high)).replace(" to ", " and ")
    every = "sequence" if controller.moves else "constant delay"
    hold = f"here constant, {constant}" if constant else f"verdicts cover every {every}"
    hold += ", no sample lost" if constant and controller.lost_samples else ""
    if not controller.moves:
        return f"is constant, somewhere between {ends}; {hold}"
    losses = (
        f", up to {controller.lost_samples} in a row are lost" if controller.lost_samples else ""
    )
    motion = f"varies between {ends}" if low < high else f"is {Quantity('s').words(low)}"
    return f"{motion}; the most recent sample that has arrived is used{losses}; {hold}"


def delay_notes(scene: Scene) -> list[str]:
    """Say that answers are for the longest delay, if a scene has a range of them."""
    words = basis_of(scene, at_longest=True).range_of_delays
    return [f"the delay {words}"] if words else []


def basis_of(scene: Scene, *, at_longest: bool = False, constant: str = "the longest") -> Basis:
    """The inputs that the answers hold for: estimator, filter, delay, device, hand, motion.

    ``at_longest``: of answers for the longest delay of a range, as a constant one, or ``constant``.
    """
    controller, device, hand = scene.controller, scene.device, scene.hand
    low, high = (controller.delays[1],) * 2 if at_longest else controller.delays
    samples = low / controller.sample_time, controller.samples
    estimator = controller.velocity or (
        "the difference over one sample (assumed: the scene names no estimator)"
    )
    masses = Quantity("kg").words(device.effective_mass, scene.units)
    grip, moving = hand.grip if hand else None, list[str]()  # beside the mass of device and hand
    if device.modes:
        moving.append(f"modes at {', '.join(f'{mode.frequency:g}' for mode in device.modes)} Hz")
    if device.actuator is not None:
        moving.append(f"an actuator of {device.actuator.bandwidth:g} Hz")
    if grip is not None:
        moving.append(f"a grip of {_grip_in_words(grip, scene.units)}")
    postures = f"a device of {masses}, constant while a wall is touched"
    return Basis(
        {
            "velocity": str(estimator),
            "position": None if controller.position is None else str(controller.position_filter),
            "sample_time": controller.sample_time,
            "delay": (low, high) if low < high else low,
            "delay_samples": samples if low < high else samples[1],
            "delay_is": _delay_is(controller, constant if at_longest else None),
            "lost_samples": None if at_longest else controller.lost_samples or None,
            "mass": device.effective_mass,
            "damping": device.effective_damping,
            "damping_is": ASSUMED if device.damping is None else None,
            "hand_mass": None if hand is None else hand.effective_mass,
            "hand_stiffness": None if hand is None else hand.stiffness,
            "hand_damping": None if hand is None else hand.damping,
            "mechanics": "; ".join(moving) or None,
            "postures": postures if device.varies else None,
            "motion": None if scene.units is Units.LINE else "rotation",
        }
    )


def blocks_of(scene: Scene) -> dict[str, str]:
    """The blocks of a scene's model in words: device, hand, controller."""
    device, controller, hand = scene.device, scene.controller, scene.hand or HandTable()
    basis, units = basis_of(scene), scene.units
    mass, *own = (
        words.words(ends if ends[0] < ends[1] else ends[0], units)
        for words, ends in (
            (Quantity("kg"), device.effective_mass),
            (Quantity("kg"), hand.effective_mass),
            (Quantity("N/m"), hand.stiffness),
            (Quantity("N s/m"), hand.damping),
        )
    )
    turning = "" if units is Units.LINE else ", which turns"
    blocks = {
        "device": f"{mass}, {Quantity('N s/m').words(device.effective_damping, units)}{turning}",
        "hand": ", ".join(own) if scene.hand else "none",
    }
    for index, mode in enumerate(device.modes, 1):
        modal = Quantity("kg").words(mode.effective_mass, units)
        words = f"{mode.frequency:g} Hz, damping ratio {mode.damping_ratio:g}, {modal}"
        shapes = {name: getattr(mode, name) for name in ("motor", "encoder", "handle")}
        if {*shapes.values()} != {1.0}:
            words += f", {', '.join(f'{value:g} at the {name}' for name, value in shapes.items())}"
        blocks[f"mode {index}"] = words
    if device.actuator is not None:
        blocks["actuator"] = f"a first-order lag of {device.actuator.bandwidth:g} Hz of the force"
    if hand.grip is not None:
        blocks["grip"] = f"{_grip_in_words(hand.grip, units)}, between device and hand"
    return blocks | {
        "sample time T": Quantity("s").words(controller.sample_time),
        "velocity V(z)": basis.velocity,
        "filter P(z)": basis.position or "none",
        "delay": "; ".join(filter(None, [basis.delay_in_words, basis.range_of_delays])),
    }


def _grip_in_words(grip: Grip, units: Units) -> str:
    spring = Quantity("N/m").words(grip.stiffness, units)
    return f"{spring}, {Quantity('N s/m').words(grip.damping, units)}"


# A description of the model with the numbers of a scene; docs/model.md says more.

_DIAGRAM = """\
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


def explain_model(scene: Scene) -> str:
    """The loop as a diagram, the values of its blocks, and what the model leaves out."""
    column = 14  # of the values of a block
    blocks = [f"{name:{column}}{words}" for name, words in blocks_of(scene).items()]
    counted = (
        "includes: encoder reading, transport both ways (USB, network), waiting, computation, DAC",
        "excludes: the zero-order hold and the window or filter, which are modelled separately",
    )
    blocks += [f"{'':{column}}{words}" for words in counted]
    delay = "" if scene.controller.moves else ", delay"
    left_out = (
        "quantisation of encoder and force (check bounds the chatter that an encoder causes)",
        "Coulomb friction, saturation, bouncing off the wall (simulated by check and contact)",
        "a mass, hand{} or gain that changes while the wall is touched; several axes at once",
        "adaptive velocity estimators, a jittering sampling clock",
    )
    device, hand = scene.device, scene.hand
    could = ["vibration modes" + " other than these" * bool(device.modes)]
    could += [] if device.actuator else ["bandwidth of motor and amplifier"]
    could += [] if hand is None or hand.grip else ["a compliant grip"]
    every = [", ".join(could), *(words.format(delay) for words in left_out)]
    outside = [f"{'' if k else 'outside':{column}}{w}" for k, w in enumerate(every)]
    return "\n".join([_DIAGRAM, *blocks, *outside])
