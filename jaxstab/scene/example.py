"""An example of a scene, with comments."""

from jaxstab.scene.answers import blocks_of
from jaxstab.scene.scene import Scene

EXAMPLE = """\
# A haptic scene for jaxstab. All quantities are in SI units.

# contact = { push = 1.0, speed = 0.1, one_sided = true, duration = 4.0 }  # N, m/s, true/false, s:
                          # how the simulated device meets each wall (check, contact)

[device]
# preset = "phantom"      # replaces the two values below; `jaxstab scene presets` lists them
mass = 0.1                # kg at the handle, or [lowest, highest] over the postures; for a
                          # rotary device give inertia, in kg m^2
damping = 1.5             # N s/m, viscous damping of the device
# encoder.resolution = 1e-5   # m at the handle; check bounds the chatter it causes
# actuator.bandwidth = 200.0  # Hz, -3 dB bandwidth of motor and amplifier
# friction = 0.1          # N, Coulomb friction; only simulated, as is static_friction
# modes = [{ frequency = 80.0, damping_ratio = 0.02, modal_mass = 1.5 }]  # Hz, -, kg

[hand]                    # omit this table for a device without a hand
mass = [0.0, 0.3]         # kg; each value is a number or a range [lowest, highest]
stiffness = [0.0, 200.0]  # N/m
damping = 1.0             # N s/m
# grip.stiffness = 2000.0 # N/m, between device and hand; without a grip they are rigidly attached
# grip.damping = 4.0      # N s/m

[controller]
sample_time = 0.001       # s
delay_samples = 1.5       # samples, may be fractional; or delay = 0.0015, in s; a range
                          # [lowest, highest] if it changes from sample to sample
# delay_is = "constant"   # the range is of a constant but unknown delay
# max_force = 10.0        # N, saturation; only simulated, as is force_step, in N
# lost_samples = 0        # consecutive samples that may be lost, if the delay changes
# position.cutoff = 400.0 # Hz, position filter; takes the keys of velocity below

[controller.velocity]     # velocity estimator; default: difference over one sample
# preset = "chai3d"       # replaces the others: the estimator of this software
window = 0.005            # s, difference over a window; or window_samples = 5
# cutoff = 100.0          # Hz, low pass after the difference
# order = 1               # of the low pass
# kind = "butterworth"    # default: first-order low passes in series
# factor = 0.5            # exponential smoothing after the difference
# In place of the difference: polynomial, its order, beside window_samples (the slope of a fit);
# acceleration_variance in (m/s^2)^2 with position_variance in m^2 (a Kalman filter).

[walls.soft]              # any number of walls, each with a name
stiffness = 300.0         # N/m
damping = 2.0             # N s/m

[walls.hard]
stiffness = 1500.0
damping = 12.0

[wanted]
# measures = ["margins"]  # check: what to report beside the verdict; default: all of
                          # margins, distance, radius, settling, oscillation, chatter, jitter
# at_damping = 20.0       # N s/m, limits: stiffness limits at this damping
# at_stiffness = 1000.0   # N/m, limits: damping limits at this stiffness
# safety = 0.8            # limits and design: multiply all limits by this
# chatter = 2e-5          # m, tune: chatter that encoder quantisation may cause
# mass_tolerance = 0.1    # tune: for a mass of +-10 %, and for all hands
# delay_tolerance = 2e-4  # s, tune: for delays up to this much shorter or longer
# stiffness = 3000.0      # N/m, design: stiffness that sample time or delay must allow
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
    every = [", ".join(_not_modelled(scene)), *(words.format(delay) for words in left_out)]
    outside = [f"{'' if k else 'outside':{column}}{w}" for k, w in enumerate(every)]
    return "\n".join([DIAGRAM, *blocks, *outside])


def _not_modelled(scene: Scene) -> list[str]:
    """The aspects of device and hand that the scene could describe but does not."""
    device, hand = scene.device, scene.hand
    return [
        "vibration modes other than these" if device.modes else "vibration modes",
        *([] if device.actuator else ["bandwidth of motor and amplifier"]),
        *([] if hand is None or hand.grip else ["a compliant grip"]),
    ]
