"""The walls of a scene in its picture: marks by their verdicts, names, and responses."""

from collections.abc import Mapping
from itertools import product
from math import isfinite
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.transforms import Bbox

from jaxstab.conventions import Verdict
from jaxstab.pictures.style import BLACK, BLUE, RED, plain
from jaxstab.scene.answers import in_words
from jaxstab.scene.check import WallCheck
from jaxstab.scene.loops import OneHand, loop_of
from jaxstab.scene.scene import Scene

Walls = Mapping[str, WallCheck]

_FEWEST, _MOST = 100, 2000  # samples of a response
_LEVEL = 0.02
_GONE = 5.0  # final positions: an unstable response is drawn no further
_MARK = 14.0  # pixels: a wall's mark
_LIFTS = (0, 10, -10, 20, -20, 32, -32, 44, -44)  # points: how far names are moved up


class _Look(NamedTuple):
    """How a wall of a verdict is drawn: told apart by colour and by form."""

    colour: str
    marker: str
    line: str


_LOOKS = {
    Verdict.STABLE: _Look(BLUE, "o", "-"),
    Verdict.UNSTABLE: _Look(RED, "X", ":"),
    Verdict.UNDECIDED: _Look(BLACK, "s", "--"),
}


def draw_walls(panel: Axes, checked: Walls) -> None:
    """Draw a mark for each wall, by its verdict."""
    for verdict, look in _LOOKS.items():
        walls = [wall for wall in checked.values() if wall.verdict == verdict]
        if walls:
            panel.plot(
                [wall.stiffness for wall in walls],
                [wall.damping for wall in walls],
                look.marker,
                color=look.colour,
                ms=9,
                mec=BLACK,
                ls="",
                zorder=5,
                label=f"wall, {in_words(verdict)}",
            )


def name_walls(panel: Axes, checked: Walls) -> None:
    """Write the name of each wall beside it, where no other name or mark is."""
    lines = [line for line in panel.get_lines() if line.get_marker() != "None"]
    marks = np.concatenate([panel.transData.transform(line.get_xydata()) for line in lines])
    taken = [Bbox.from_bounds(x - _MARK / 2, y - _MARK / 2, _MARK, _MARK) for x, y in marks]
    for name, wall in checked.items():
        position = (wall.stiffness, wall.damping)
        if not panel.bbox.contains(*panel.transData.transform(position)):
            continue
        text = panel.annotate(
            plain(name),
            position,
            xytext=(8, 0),
            textcoords="offset points",
            va="center",
            fontsize=9,
            zorder=6,
            bbox={"boxstyle": "round,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.75},
        )
        for across, along in product((1, -1), _LIFTS):
            text.set(ha="left" if across > 0 else "right")
            text.xyann = (8 * across, along)
            box = text.get_window_extent()
            is_inside = panel.bbox.containsx(box.x0) and panel.bbox.containsx(box.x1)
            if is_inside and not box.count_overlaps(taken):
                break
        taken.append(box)


def draw_responses(panel: Axes, scene: Scene, checked: Walls) -> None:
    """Draw the response to a step of force, relative to the final displacement."""
    period = scene.controller.sample_time
    times = [wall.settling.settling_time_2_percent for wall in checked.values() if wall.settling]
    settled = [time for time in times if isfinite(time)] or [0.0]
    longest = min(1.2 * max(settled), 6.0 * min(settled))
    samples = int(np.clip(longest / period, _FEWEST, _MOST))
    for name, wall in checked.items():
        hand = wall.worst_hand
        held = loop_of(scene, None if hand is None else OneHand(*vars(hand).values()))
        spring = held.device.static_stiffness() if held.device else held.hand_stiffness
        response = held.simulate(
            wall.stiffness, wall.damping, samples=samples, force=1.0, between=_MOST // samples
        )
        relative = np.asarray(response.position) * (wall.stiffness + spring)
        gone = np.logical_or.accumulate(np.abs(relative) > _GONE)
        shown = np.where(gone, np.nan, relative)
        panel.plot(np.asarray(response.time), shown, _LOOKS[wall.verdict].line, label=plain(name))
    panel.axhspan(1.0 - _LEVEL, 1.0 + _LEVEL, color=BLACK, alpha=0.12, lw=0)
    panel.set(xlim=(0.0, samples * period), ylim=(-0.3, 2.3))
    panel.set(xlabel="time (s)", ylabel="position / final position")
    panel.legend(fontsize=8, frameon=True)
