"""The guard of a scene: for the masses of its device and the delays of its loop."""

from collections.abc import Callable
from decimal import ROUND_FLOOR
from math import prod

import numpy as np

from jaxstab.guard import Guard, build_guard
from jaxstab.guard.build import CELLS, CONSTANT_CELLS, plan_guard
from jaxstab.guard.guard import LARGEST_HEADER
from jaxstab.loop import HapticLoop
from jaxstab.scene.answers import Quantity, blocks_of
from jaxstab.scene.loops import OneHand, is_one_mass, loop_of, masses_of, range_of_hands, with_delay
from jaxstab.scene.scene import Scene, range_in_words


def scene_guard(
    scene: Scene,
    *,
    lost: int = 0,
    progress: Callable[[float], None] | None = None,
    cells: tuple[int, int, int] | None = None,
) -> Guard:
    """The guard of a scene, for its hands, masses and delays: see ``jaxstab.build_guard``.

    Of a single mass it covers 0.8 to 1.25 times it. Of a single delay it covers that one to one
    sample more, and one sample less to one sample more if it is constant. For a device with modes,
    an actuator or a grip it is 0.96 to 1.04, and a tenth of a sample. The cells are by default
    those of ``build_guard``, a single one of mass and delay for such a device. ``progress`` is
    called with the completed share of the proof.
    """
    most = LARGEST_HEADER // 6  # letters of a number with its comma
    if cells and prod(count + 1 for count in cells) > most:
        raise ValueError(
            f"cells are {','.join(map(str, cells))}; give fewer: the table may have {most} numbers."
        )
    loop, delays = _loop_of(scene), scene.controller.delays
    is_constant = scene.controller.delay_is == "constant"
    # What postures may make of the mass; samples beside the delay if it is constant, and beyond it.
    shares, beside = ((0.8, 1.25), 1.0) if is_one_mass(scene) else ((0.96, 1.04), 0.1)
    mass, aside = scene.device.effective_mass[0], beside * loop.sample_time
    if delays[0] == delays[1]:
        shortest = max(delays[0] - aside, 0.0) if is_constant else delays[0]
        delays = shortest, delays[0] + aside
    return build_guard(
        loop,
        range_of_hands(scene),
        mass=masses_of(scene) or (shares[0] * mass, shares[1] * mass),
        delay=delays,
        lost=lost or scene.controller.lost_samples,
        constant_delay=is_constant,
        progress=progress,
        cells=cells or _cells_of(scene),
    )


def guard_plan(scene: Scene, cells: tuple[int, int, int] | None) -> str:
    """Describe what ``scene_guard`` will compute, and about how long that takes."""
    return str(plan_guard(_loop_of(scene), cells or _cells_of(scene)))


def _loop_of(scene: Scene) -> HapticLoop:
    """Return the loop of a scene with its shortest delay."""
    return loop_of(with_delay(scene, scene.controller.delays[0]))


def _cells_of(scene: Scene) -> tuple[int, int, int]:
    if not is_one_mass(scene):
        return 1, 1, 16
    return CONSTANT_CELLS if scene.controller.delay_is == "constant" else CELLS


def guard_about(scene: Scene, guard: Guard) -> str:
    """The loop and the ranges of a guard, and what it grants, in lines."""
    units, blocks = scene.units, blocks_of(scene)
    damping = Quantity("N s/m").words(scene.device.damping, units)
    blocks["device"] = f"{range_in_words(guard.mass)} {units.kilogram}, {damping}"
    del blocks["delay"]
    lost = f", up to {guard.lost} in a row lost" if guard.lost else ""
    motion = (
        "constant during contact"
        if guard.is_delay_constant
        else f"varying from sample to sample{lost}"
    )
    blocks[f"delay, {motion}"] = f"{range_in_words(guard.delay)} s"
    lines = (f"{name}: {words}" for name, words in blocks.items())
    return "\n".join([*lines, "", *_granted(scene, guard)])


def _granted(scene: Scene, guard: Guard) -> list[str]:
    """The share of the stable walls that is granted, and where it is least, in lines."""
    units, least, stiffness = scene.units, guard.costliest, Quantity("N/m", 4, ROUND_FLOOR)
    limited = f", for {OneHand(*least.hand).in_words(units)}" if any(least.hand) else ""
    proved = float(np.diff(guard.rows).mean()) / guard.grid.cells[2]
    left = (
        f"{100.0 * (1.0 - proved):.1f} % of the table is not proved; there both gains are set to 0."
    )
    at = "any delay" if least.delay is None else f"a delay of {Quantity('s').words(least.delay)}"
    stable = "the stable stiffness" if guard.is_delay_constant else "what constant delays allow"
    granted, exact = (stiffness.words(K, units) for K in (least.granted, least.exact))
    return [
        f"It grants {100.0 * guard.granted:.1f} % of {stable}, on average.",
        *([left] if proved < 1.0 else []),
        f"It is least at {least.mass:g} {units.kilogram} and {at}{limited}: {granted} of {exact}.",
    ]
