"""Studies of scenes: their keys vary, and ``jaxstab.lab.study`` computes the loops.

Combinations of the mass, damping and stiffness of device and hand, and of delays, are one loop that
has arrays (``_NUMBERS``); every other key makes a loop of its own.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from functools import cached_property
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxstab import tables as t
from jaxstab.answers import Units
from jaxstab.app.scene.answers import delay_notes
from jaxstab.app.scene.gains import KEYS, GainScene, any_scene
from jaxstab.app.scene.loops import loop_of
from jaxstab.app.scene.scene import INNER, TABLES, Scene
from jaxstab.app.scene.scene import walls_in as checked_walls
from jaxstab.lab.study import Source, plan_study
from jaxstab.loop import HapticLoop
from jaxstab.model.gain import Gain
from jaxstab.shown import shortened

if TYPE_CHECKING:
    from xarray import Dataset


# Studies of scenes.

_NUMBERS = {  # keys of a scene that are numbers of a loop: its fields
    "device.mass": "device_mass",
    "device.inertia": "device_mass",
    "device.damping": "device_damping",
    "hand.mass": "hand_mass",
    "hand.inertia": "hand_mass",
    "hand.stiffness": "hand_stiffness",
    "hand.damping": "hand_damping",
    "controller.delay": "delay",
    "controller.delay_samples": "delay_samples",
}


def study(
    of: "HapticLoop | Mapping[str, Any] | str | PathLike[str]",
    over: Mapping[str, Any],
    *,
    answers: Sequence[str] | None = None,
    walls: Mapping[str, tuple[float, float]] | None = None,
    samples: int | None = None,
    seed: int = 0,
    rng: "int | np.random.Generator | None" = None,
    part: tuple[int, int] = (1, 1),
) -> "Dataset":
    """Answer for many devices, people and controllers, as one labelled table.

    dask computes it block by block: in this process, in others after
    ``dask.config.set(scheduler="processes")``, or by the workers of the ``distributed.Client``
    that is open. The values are the same.

    Args:
        of: a scene (a file, or its tables) or a loop.
        over: variations, by keys of the scene such as "hand.stiffness", or by fields of the loop:
            a list of values, (low, high, count), a frozen distribution of ``scipy.stats``, or a
            text such as "0.1:0.5:20", "csv:hands.csv:stiffness" or "normal:300:100". Lists span a
            grid; distributions are drawn together, ``samples`` times at each of its points.
        answers: one or more of "limits", "verdict", "margins", "settling_time", "spectral_radius";
            all but the first are of walls. By default limits, and verdicts if there are walls.
        walls: stiffness and damping in SI units by name; those of the scene by default.
        samples: the number of draws; by default 10,000, or as many as take about a minute.
        seed: of the draws, a whole number >= 0.
        rng: in place of it, what ``numpy.random.default_rng`` takes: a seed, or a generator, from
            which a seed is drawn (SPEC 7). Parts of one study need the same seed.
        part: (3, 64) computes the third of 64 parts, a piece of the longest dimension.

    Returns:
        ``xarray.Dataset`` with the dimensions of the lists, ``sample`` and ``wall``; names, units
        and the meaning of codes are attributes. Its ``to_netcdf`` stores it.

    Raises:
        ValueError: a key is unknown, a value is refused by the scene, or a distribution reaches
            where the scene forbids. OSError: a file cannot be read. RuntimeError: xarray, dask or
            h5netcdf is missing, or a worker died.

    Source: the answers' own, see ``HapticLoop``.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> study = jaxstab.study(loop, over={"device_mass": [0.1, 0.2]})
        >>> study.largest_stiffness.round().values.tolist()
        [70643.0, 139265.0]
        >>> study.largest_stiffness.dims, study.at_damping.units
        (('device_mass',), 'N s/m')
    """
    if rng is not None:
        seed = int(np.random.default_rng(rng).integers(2**32))
    table, _ = plan_study(
        source_of(of), over, answers=answers, walls=walls, samples=samples, seed=seed, part=part
    )
    return t.computed(table)


def source_of(of: Any) -> Source:
    """Return the source of the loops of a study; TypeError for what is none."""
    if isinstance(of, HapticLoop):
        return Source(of.in_floats())
    if isinstance(of, Mapping):
        return SceneSource(dict(of))
    if isinstance(of, str | PathLike):
        return SceneSource(t.read_table(of, "scene"))
    raise TypeError(f"of is {shortened(of)}; give a scene (file or tables) or a HapticLoop.")


@dataclass(frozen=True)
class SceneSource(Source):
    """The tables of a scene, whose keys vary."""

    @cached_property
    def _of_gains(self) -> GainScene | None:
        """The scene, if it is of another loop than that of a wall."""
        scene = any_scene(self.table) if "loop" in self.table else None
        return scene if isinstance(scene, GainScene) else None

    @property
    def has_gains(self) -> bool:  # type: ignore[override]
        """Whether the pairs that are judged are called gains, not walls."""
        return self._of_gains is not None

    @property
    def gains(self) -> tuple[Gain, Gain]:
        """The gains of the loops."""
        return self._of_gains.loop.gains if self._of_gains else super().gains

    @property
    def numbers(self) -> Mapping[str, str]:
        """The fields of a loop that are numbers, by their keys."""
        return {} if self._of_gains else _NUMBERS

    @property
    def answers(self) -> dict[str, dict[str, t.Variable]]:
        """The answers that may be asked for, by name."""
        every = super().answers
        names = ("verdict", "limits", "spectral_radius") if self._of_gains else every
        return {name: every[name] for name in names}

    @property
    def units(self) -> Units:
        """The units of the answers."""
        return Units.ROTATION if "inertia" in self.table.get("device", {}) else Units.LINE

    @property
    def walls(self) -> dict[str, tuple[float, float]]:
        """The walls of the scene, or its pairs of gains."""
        if self._of_gains:
            return {name: (*pair.values(),) for name, pair in self._of_gains.pairs.items()}  # type: ignore[misc]
        walls = checked_walls(self.table.get("walls", {}))
        return {name: (wall.stiffness, wall.damping) for name, wall in walls.items()}

    @property
    def ranges(self) -> dict[str, str]:
        """The ranges of the hand and of the device's mass, as uniform distributions."""
        ranges = dict[str, str]()
        if self._of_gains and self._of_gains.is_range:
            return {"loop.environment": "uniform:{}:{}".format(*self._of_gains.environment)}
        for key in _NUMBERS:
            section, _, name = key.partition(".")
            if section == "controller" or key == "device.damping":
                continue  # a range of delays is the longest one, and there is one damping
            match self.table.get(section):
                case {**keys} if isinstance(keys.get(name), list | tuple):
                    with suppress(ValueError):  # the scene refuses it later
                        low, high = t.IntervalCheck("")(keys[name])
                        ranges |= {key: f"uniform:{low!r}:{high!r}"} if low < high else {}
        return ranges

    def check_key(self, key: str) -> None:
        """Refuse a key that cannot vary: ValueError."""
        if (section := key.partition(".")[0]) in ("walls", "gains"):
            what = "pair of gains" if section == "gains" else "wall"
            raise ValueError(f"{key} cannot vary in a study; give a {what} for each value.")
        if key == "loop.kind" or section in ("wanted", "contact"):
            raise ValueError(f"{key} cannot vary in a study; leave it out.")

    def described(self, key: str) -> tuple[str, str]:
        """The description and the unit of a key."""
        return _described(key)

    def made(self, values: Mapping[str, Any]) -> Any:
        """The loop with these values in place of those of the scene."""
        scene = self._scene(values)
        return scene.loop if isinstance(scene, GainScene) else loop_of(scene.at_longest_delay)

    def notes(self, outer: Sequence[Mapping[str, Any]]) -> list[str]:
        """The sentences of the scene on the lowest and the highest values."""
        scenes = [*map(self._scene, outer)]
        walls = (scene for scene in scenes if isinstance(scene, Scene))
        notes = [f"{note}." for scene in walls for note in delay_notes(scene)]
        wanted = self.table.get("wanted", {})
        if "safety" in wanted:
            notes.append(f"wanted.safety is {wanted['safety']}: limits are given without it.")
        unusual = [words for scene in scenes for words in scene.unusual()]
        notes += [f"warning: {said}{'' if said.endswith('?') else '.'}" for said in unusual]
        return list(dict.fromkeys(notes))

    def _scene(self, values: Mapping[str, Any]) -> Scene | GainScene:
        table: Any = self.table
        if any(key.startswith("controller.delay") for key in values):  # in place of either unit
            own = table.get("controller", {})
            if isinstance(own, Mapping):  # the scene refuses all else
                kept = {k for k in own if not k.startswith("delay") and k != "lost_samples"}
                table = {**table, "controller": {k: own[k] for k in kept}}
        if "controller.velocity.preset" in values:  # in place of all that the scene says
            table = t.with_value(table, "controller.velocity", {}, ["controller", "velocity"])
        for key, value in values.items():
            is_whole = isinstance(value, float) and value.is_integer()  # as a window in samples
            table = t.with_value(table, key, int(value) if is_whole else value, key.split("."))
        return any_scene(table)


def _described(key: str) -> tuple[str, str]:
    """The description and the unit of a key of a scene."""
    *_, section, name = key.split(".")
    section = key.split(".")[-3] if section.isdigit() else section
    table = {**TABLES, **INNER}.get(section, t.Table)
    entry = {entry.name: entry for entry in fields(table)}.get(name)
    match key.split("."):
        case ["loop", "second", _, *_] as names:
            words, unit = _described(".".join(["device", *names[2:]]))
            return f"{words}, the second one", unit
        case ["loop", _, *_]:
            return KEYS.get(name, (key, ""))
    return (key, "1") if entry is None else (entry.metadata["words"] or key, t.unit_of(entry))
