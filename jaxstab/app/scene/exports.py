"""Exports of a scene to other programs: a guard for C, an atlas, a certificate of its walls.

A guard and an atlas are for all masses, hands and delays of the scene. Of an atlas gamma and delta
have their extremes at the corners of the ranges of mass and hand, for they are monotone in each.

A certificate has, for each wall, the numbers of the loop that decides about it as exact fractions:
of ranges that of the worst hand and mass. Its claims are the verdict, and between which stiffnesses
walls are stable at this damping: proved here (``exact``), and confirmed by a program of 250 lines
without jaxstab, ``jaxstab files check_wall.py``. Filters are those that run, of rounded parameters.
"""

from collections.abc import Callable
from decimal import ROUND_FLOOR
from fractions import Fraction
from itertools import product
from math import prod
from typing import Any

import numpy as np

from jaxstab import lab
from jaxstab.answers import GainAnswer, Quantity
from jaxstab.app.scene import loops
from jaxstab.app.scene.answers import basis_of, blocks_of
from jaxstab.app.scene.limits import stable_intervals
from jaxstab.app.scene.scene import Scene, range_in_words
from jaxstab.atlas import Atlas, AtlasSpec
from jaxstab.conventions import Verdict
from jaxstab.loop import HapticLoop
from jaxstab.model import Filter, Velocity
from jaxstab.model.filters import exact_chain
from jaxstab.shown import printable


def scene_guard(
    scene: Scene, *, lost: int, progress: Callable[[float], None], cells: tuple[int, int, int]
) -> "lab.guard.Guard":
    """The guard of a scene, for its hands, masses and delays: see ``jaxstab.build_guard``.

    Of a single mass it covers 0.8 to 1.25 times it. Of a single delay it covers that one to one
    sample more, and one sample less to one sample more if it is constant. For a device with modes,
    an actuator or a grip it is 0.96 to 1.04, and a tenth of a sample. ``progress`` is called with
    the completed share of the proof.
    """
    most = lab.guard.LARGEST_HEADER // 6  # letters of a number with its comma
    if prod(count + 1 for count in cells) > most:
        raise ValueError(
            f"cells are {','.join(map(str, cells))}; give fewer: the table may have {most} numbers."
        )
    loop, delays = loops.loops_over_delays(scene)[0], scene.controller.delays
    is_constant = scene.controller.delay_is == "constant"
    # What postures may make of the mass; samples beside the delay if it is constant, and beyond it.
    shares, beside = ((0.8, 1.25), 1.0) if loops.is_one_mass(scene) else ((0.96, 1.04), 0.1)
    mass, aside = scene.device.effective_mass[0], beside * loop.sample_time
    low, high = (float(f"{share * mass:.12g}") for share in shares)  # 0.056, no digits of rounding
    if delays[0] == delays[1]:
        shortest = max(delays[0] - aside, 0.0) if is_constant else delays[0]
        delays = shortest, delays[0] + aside
    return lab.guard.build_guard(
        loop,
        loops.range_of_hands(scene),
        mass=loops.masses_of(scene) or (low, high),
        delay=delays,
        lost=lost or scene.controller.lost_samples,
        constant_delay=is_constant,
        progress=progress,
        cells=cells,
    )


def cells_of(scene: Scene) -> tuple[int, int, int]:
    """The usual cells of a guard along mass, delay and damping."""
    if not loops.is_one_mass(scene):
        return 1, 1, 16
    return lab.guard.CONSTANT_CELLS if scene.controller.delay_is == "constant" else lab.guard.CELLS


def guard_about(scene: Scene, guard: "lab.guard.Guard") -> str:
    """The loop and the ranges of a guard, and what it grants, in lines."""
    units, blocks = scene.units, blocks_of(scene)
    damping = Quantity("N s/m").words(scene.device.effective_damping, units)
    blocks["device"] = f"{range_in_words(guard.mass)} {units.kilogram}, {damping}"
    del blocks["delay"]
    motion, stable = "constant during contact", "the stable stiffness"
    if not guard.is_delay_constant:
        motion, stable = "varying from sample to sample", "what constant delays allow"
        motion += f", up to {guard.lost} in a row lost" if guard.lost else ""
    blocks[f"delay, {motion}"] = f"{range_in_words(guard.delay)} s"
    lines = [f"{name}: {words}" for name, words in blocks.items()]
    lines += ["", f"It grants {100.0 * guard.granted:.1f} % of {stable}, on average."]
    left = 100.0 * (1.0 - float(np.diff(guard.rows).mean()) / guard.grid.cells[2])
    if left > 0.0:
        lines.append(f"{left:.1f} % of the table is not proved; there both gains are set to 0.")
    least, stiffness = guard.costliest, Quantity("N/m", 4, ROUND_FLOOR)
    at = "any delay" if least.delay is None else f"a delay of {Quantity('s').words(least.delay)}"
    at += f", for {loops.OneHand(*least.hand).in_words(units)}" if any(least.hand) else ""
    granted, exact = (stiffness.words(K, units) for K in (least.granted, least.exact))
    words = f"It is least at {least.mass:g} {units.kilogram} and {at}: {granted} of {exact}."
    return "\n".join([*lines, words])


# An atlas: its specification, and its answers about walls.


def atlas_spec(scene: Scene) -> AtlasSpec:
    """The specification of an atlas for all loops of a scene's ranges."""
    corners = loops.corner_loops(loops.with_tolerances(scene))
    if corners[0].body is None:
        raise TypeError(
            "an atlas covers devices that are one mass with their hand; leave out device.modes, "
            "device.actuator and hand.grip."
        )
    shortest, *_, longest = sorted(float(loop.delay_samples) for loop in 2 * corners)
    delay_nodes = 8  # to a sample, along a range of delays
    count = int(delay_nodes * (longest - shortest)) + 2

    def nodes(values: Any) -> list[float]:
        low, *_, high = sorted(2 * [*values])
        return np.unique([low, 0.5 * (low + high), high]).tolist()

    return AtlasSpec(
        gamma=nodes(loop.gamma for loop in corners),
        delta=nodes(loop.delta for loop in corners),
        delay=np.unique(np.linspace(shortest, longest, count)).tolist(),
        **corners[0].filters,
    )


def ask_atlas(scene: Scene, atlas: Atlas) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Ask ``Atlas.query`` about the walls of a scene, at each corner of its ranges.

    Returns inputs and units as JSON has them, and a row for each wall and corner.
    """
    scene.require_walls()
    walls, si, moved = loops.walls_of(scene), scene.units, scene.units.moved
    units = {
        "stiffness": si.stiffness,
        "damping": si.damping,
        moved: si.kilogram,
        f"hand_{moved}": si.kilogram,
        "hand_stiffness": si.stiffness,
        "hand_damping": si.damping,
        "delay": "s",
    }
    views, rows = [*map(atlas.for_loop, loops.corner_loops(loops.with_tolerances(scene)))], []
    for (name, gains), view in product(walls.items(), views):
        answer, loop = view.query(*gains), view.loop
        hand = loop.hand_mass, loop.hand_stiffness, loop.hand_damping
        values = *gains, loop.device_mass, *hand, loop.delay
        row = {"wall": name, **dict(zip(units, values, strict=True))}
        row["verdict"] = answer.verdict.name.lower()
        row["status"] = answer.status.name.lower()
        rows.append(row)
    stated = GainAnswer({"inputs": basis_of(scene)}).as_json()
    stated["inputs"] |= {"created_by": atlas.created_by}
    stated["units"] |= units
    return stated, rows


def spec_text(scene: Scene, name: str) -> str:
    """The text of a scene's specification, which begins with a description."""
    text = atlas_spec(scene).to_toml()
    blocks = blocks_of(loops.with_tolerances(scene))
    lines = [name, *(f"{block}: {words}" for block, words in blocks.items())]
    # A control character would end the comment.
    return "".join(f"# {printable(line)}\n" for line in lines) + "\n" + text


# The claims about walls, for a reader that does not trust them: ``check_wall.py``.


def certificate(scene: Scene) -> dict[str, Any]:
    """The claims about the walls of a scene; ValueError for one that the reader cannot follow."""
    scene.require_walls()
    scene.controller.require_one_delay("a certificate")
    if not loops.is_one_mass(scene):
        raise ValueError(
            "a certificate is of one mass and the hand that holds it; leave out modes, actuator "
            "and grip, or ask check without --certificate, whose verdicts are proved, too."
        )
    walls, claims = loops.walls_of(scene), dict[str, Any]()
    found = loops.worst_on(scene, [*walls.values()])
    for (name, wall), (judged, loop) in zip(walls.items(), found, strict=True):
        verdict = Verdict(int(loop.verdict(*wall)))
        if verdict == Verdict.UNDECIDED or (verdict == Verdict.STABLE and judged.hands_are):
            raise ValueError(f"the wall {tuple(wall)} is not decided; there is nothing to certify.")
        line = loop.stiffness_intervals(wall.damping)
        intervals = stable_intervals([line], 1.0, wall.stiffness)
        hand = f" with {judged.worst_hand.in_words(scene.units)}" if judged.worst_hand else ""
        claims[printable(f"{name}{hand}")] = {
            "loop": _exact_loop(loop),
            **{key: str(Fraction(gain)) for key, gain in wall._asdict().items()},
            "verdict": verdict.name.lower(),
            "stiffness_intervals": [[repr(a), repr(b)] for a, b in intervals if a < b],
        }
    return {"format": "jaxstab wall 2", "walls": claims}


def _exact_loop(loop: HapticLoop) -> dict[str, Any]:
    """The numbers of a loop of one mass, and its filters in powers of 1/z, as fractions."""
    numbers = {
        "mass": (loop.device_mass, loop.hand_mass),
        "damping": (loop.device_damping, loop.hand_damping),
        "stiffness": (loop.hand_stiffness,),
        "sample_time": (loop.sample_time,),
        "delay_samples": (loop.delay_samples,),
    }
    exact = {name: str(sum(Fraction(float(x)) for x in own)) for name, own in numbers.items()}
    chains = loop.position or Filter(), (loop.velocity or Velocity()).filter
    sides = (exact_chain(chain.per_sample(loop.sample_time).sections) for chain in chains)
    position, (above, below) = sides
    rising = {"position": position, "velocity": (above - above.left_shift(1), below)}
    return exact | {name: [[*map(str, x.coeffs())] for x in own] for name, own in rising.items()}
