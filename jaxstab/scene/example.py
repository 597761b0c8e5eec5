"""An example of a scene, with comments."""

EXAMPLE = """\
# A haptic scene for jaxstab. All quantities are in SI units.

[device]
# preset = "phantom"      # instead of the two below: phantom, omega or falcon
mass = 0.1                # kg, effective mass at the handle
damping = 1.5             # N s/m, physical damping of the device
# encoder.resolution = 1e-5   # m at the handle: check bounds what its rounding does

[hand]                    # leave this table out for no hand
mass = [0.0, 0.3]         # kg; each of the three is a number or [lowest, highest]
stiffness = [0.0, 200.0]  # N/m
damping = 1.0             # N s/m

[controller]
sample_time = 0.001       # s
delay_samples = 1.5       # samples, whole or not; or: delay = 0.0015, in s

[walls.soft]              # any number of walls, each with a name of its own
stiffness = 300.0         # N/m
damping = 2.0             # N s/m

[walls.hard]
stiffness = 10000.0
damping = 20.0

[wanted]                  # what `jaxstab scene FILE` answers
answers = ["limits", "check"]    # of limits, check, tune, design
# measures = ["margins"]  # check: beside the verdict of a wall; all of them by default:
                          # margins, distance, radius, settling, oscillation, chatter
# at_damping = 20.0       # N s/m, limits: the stiffness allowed at this damping
# at_stiffness = 1000.0   # N/m, limits: the damping allowed at this stiffness
# stiffness = 3000.0      # N/m, design: what the sample time or the delay is to allow
"""
