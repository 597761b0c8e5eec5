"""An example of a scene, with comments."""

from jaxstab.scene.answers import IntervalQuantity, Quantity, basis_of, grip_in_words
from jaxstab.scene.scene import Hand, Scene, Units

EXAMPLE = """\
# A haptic scene for jaxstab. All quantities are in SI units.

# contact = { push = 1.0, speed = 0.1, one_sided = true, duration = 4.0 }  # N, m/s, 1, s: check
                          # simulates how the device meets each wall

[device]
# preset = "phantom"      # instead of the two below; `jaxstab scene presets` lists them
mass = 0.1                # kg at the handle, or [lowest, highest] over the postures; inertia in
                          # kg m^2 for one that turns
damping = 1.5             # N s/m, physical damping of the device
# encoder.resolution = 1e-5   # m at the handle: check bounds what its rounding does
# actuator.bandwidth = 200.0  # Hz, at which motor and amplifier lose 3 dB
# friction = 0.1          # N, Coulomb's, of simulated contacts; static_friction, too
# modes = [{ frequency = 80.0, damping_ratio = 0.02, modal_mass = 1.5 }]  # Hz, 1, kg: it vibrates

[hand]                    # leave this table out for no hand
mass = [0.0, 0.3]         # kg; each of the three is a number or [lowest, highest]
stiffness = [0.0, 200.0]  # N/m
damping = 1.0             # N s/m
# grip.stiffness = 2000.0 # N/m, between the device and the hand, which is glued to it otherwise
# grip.damping = 4.0      # N s/m

[controller]
sample_time = 0.001       # s
delay_samples = 1.5       # samples, whole or not; or: delay = 0.0015, in s; [lowest, highest]
                          # for one that moves from sample to sample (limits, check, guard)
# delay_is = "constant"   # a range of delays is of one that is constant, but not known
# max_force = 10.0        # N, of simulated contacts; force_step in N, too
# lost_samples = 0        # samples in a row that never arrive, with a delay that moves
# position.cutoff = 400.0 # Hz, a filter of the position, with the keys of velocity below

[controller.velocity]     # how the velocity is estimated; without it, over one sample
# preset = "chai3d"       # instead of the others: what a software does
window = 0.005            # s, the difference over a window; or: window_samples = 5
# cutoff = 100.0          # Hz, a low pass behind it
# order = 1               # of the low pass
# kind = "butterworth"    # of the low pass, instead of first-order ones in a row
# factor = 0.5            # exponential smoothing behind it

[walls.soft]              # any number of walls, each with its own name
stiffness = 300.0         # N/m
damping = 2.0             # N s/m

[walls.hard]
stiffness = 1500.0
damping = 12.0

[wanted]
# measures = ["margins"]  # check: beside the verdict of a wall; all of them by default:
                          # margins, distance, radius, settling, oscillation, chatter, jitter
# at_damping = 20.0       # N s/m, limits: the stiffness allowed at this damping
# at_stiffness = 1000.0   # N/m, limits: the damping allowed at this stiffness
# safety = 0.8            # limits and design: what limits are multiplied by
# chatter = 2e-5          # m, tune: how far the encoder's rounding may drive a wall
# mass_tolerance = 0.1    # tune: over the device's mass +-10 %, and over all hands
# delay_tolerance = 2e-4  # s, tune: over delays so far to both sides
# stiffness = 3000.0      # N/m, design: what the sample time or the delay is to allow
"""


# A description of the model with the numbers of a scene; docs/model.md says more.

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
    "Coulomb friction, saturation, but for simulated contacts",
    "a mass, hand{} or gain that changes while the wall is touched; several axes at once",
    "bouncing off the wall, estimators that adapt, clocks that jitter",
)

_UNITS = ("kg", "N/m", "N s/m")
_NAME = 14  # column of the values of a block


def explain_model(scene: Scene) -> str:
    """The loop as a diagram, the values of its blocks, and limits of the model."""
    blocks = [f"{name:{_NAME}}{words}" for name, words in _blocks(scene).items()]
    counted = [f"{'':{_NAME}}{words}" for words in _COUNTED]
    delay = "" if scene.controller.moves else ", delay"
    every = [", ".join(_not_modelled(scene)), *(words.format(delay) for words in _OUTSIDE)]
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
        mass = Quantity("kg").words(mode.effective_mass, units)
        words = f"{mode.frequency:g} Hz, damping ratio {mode.damping_ratio:g}, {mass}"
        blocks[f"mode {number}"] = words
    if device.actuator is not None:
        blocks["actuator"] = f"a first-order lag of {device.actuator.bandwidth:g} Hz of the force"
    blocks["hand"] = ", ".join(_range(*one, units) for one in held) if scene.hand else "none"
    if hand.grip is not None:
        blocks["grip"] = f"{grip_in_words(hand.grip, units)}, between device and hand"
    return blocks | {
        "T": time.words(controller.sample_time),
        "velocity V(z)": basis.velocity,
        "filter P(z)": basis.position or "none",
        "delay": "; ".join(filter(None, [basis.delay_in_words, basis.range_of_delays])),
    }


def _range(ends: tuple[float, float], unit: str, units: Units) -> str:
    if ends[0] == ends[1]:
        return Quantity(unit).words(ends[0], units)
    return IntervalQuantity(unit).words(ends, units)


def _not_modelled(scene: Scene) -> list[str]:
    """Return what the scene leaves out of what it might say of device and hand."""
    device, hand = scene.device, scene.hand
    return [
        "vibration modes other than these" if device.modes else "vibration modes",
        *([] if device.actuator else ["bandwidth of motor and amplifier"]),
        *([] if hand is None or hand.grip else ["a compliant grip"]),
    ]
