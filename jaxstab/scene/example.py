"""An example of a scene, with comments."""

EXAMPLE = """\
# A haptic scene for jaxstab. All quantities are in SI units.

[device]
# preset = "phantom"      # instead of the two below; `jaxstab scene presets` lists them
mass = 0.1                # kg at the handle, or [lowest, highest] over the postures; inertia in
                          # kg m^2 for one that turns
damping = 1.5             # N s/m, physical damping of the device
# encoder.resolution = 1e-5   # m at the handle: check bounds what its rounding does
# actuator.bandwidth = 200.0  # Hz, at which motor and amplifier lose 3 dB
# modes = [{ frequency = 80.0, damping_ratio = 0.02, modal_mass = 1.5 }]  # Hz, 1, kg: it vibrates

[hand]                    # leave this table out for no hand
mass = [0.0, 0.3]         # kg; each of the three is a number or [lowest, highest]
stiffness = [0.0, 200.0]  # N/m
damping = 1.0             # N s/m
# grip.stiffness = 2000.0 # N/m, between the device and the hand, which is glued to it otherwise
# grip.damping = 4.0      # N s/m

[controller]
sample_time = 0.001       # s
delay_samples = 1.5       # samples, whole or not; or: delay = 0.0015, in s
# position.cutoff = 400.0 # Hz, a filter of the position, with the keys of velocity below

[controller.velocity]     # how the velocity is estimated; without it, over one sample
# preset = "chai3d"       # instead of the others: what a software does
window = 0.005            # s, the difference over a window; or: window_samples = 5
# cutoff = 100.0          # Hz, a low pass behind it
# order = 1               # of the low pass
# kind = "butterworth"    # of the low pass, instead of first-order ones in a row
# factor = 0.5            # exponential smoothing behind it

[walls.soft]              # any number of walls, each with a name of its own
stiffness = 300.0         # N/m
damping = 2.0             # N s/m

[walls.hard]
stiffness = 1500.0
damping = 12.0

[wanted]                  # what `jaxstab scene FILE` answers
answers = ["limits", "check"]    # of limits, check, tune, design
# measures = ["margins"]  # check: beside the verdict of a wall; all of them by default:
                          # margins, distance, radius, settling, oscillation, chatter
# at_damping = 20.0       # N s/m, limits: the stiffness allowed at this damping
# at_stiffness = 1000.0   # N/m, limits: the damping allowed at this stiffness
# safety = 0.8            # limits and design: what limits are multiplied by
# chatter = 2e-5          # m, tune: how far the encoder's rounding may drive a wall
# mass_tolerance = 0.1    # tune: over the device's mass +-10 %, and over all hands
# delay_tolerance = 2e-4  # s, tune: over delays so far to both sides
# stiffness = 3000.0      # N/m, design: what the sample time or the delay is to allow
"""
