"""Two rates: a held device at samples of T, and forces that are computed once a frame of n samples.

A branch, K behind the filter P or B behind the estimator V, is computed at each sample, or once a
frame, at its first one. What is read once is one number, linear in the state at the beginning of
the frame; it acts some samples later and is held for n samples, or goes there in n stairs from the
number before. So the gain g of a slow branch stands before a matrix of rank one, A + g b c', and
the characteristic polynomial of a frame is affine in g; in both gains where both are slow (lemma
F1). All motions decay, also within the frames, if and only if its roots are inside the unit circle.

The frame is run once on linear forms in the state: the last positions and forces of the device, in
difference equations of its plant and of the filters, and the forces on their way. These have roots
at 0 more than a state in fewer numbers, and no others. A root at 1 of a device that nothing holds
is known by structure, as in ``balls``.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil
from typing import TYPE_CHECKING, Any

from jaxstab.model.affine import AffineParts
from jaxstab.model.balls import (
    Factored,
    LoopFactors,
    SampledDevice,
    Triple,
    known_out,
    plant_in_balls,
)
from jaxstab.model.device.parts import flint
from jaxstab.model.filters import NO_FILTERS, given_filters

if TYPE_CHECKING:
    from flint import arb, arb_poly

    from jaxstab.model.loop import LoopParameters


@dataclass(frozen=True)
class ForcePath:
    """How a gain acts: at each sample or once a frame, so many samples late, held or in stairs.

    ``is_fast_inside`` is a filter that runs at each sample, though its output is read once a frame.
    """

    is_slow: bool
    late: int = 0
    is_ramp: bool = False
    is_fast_inside: bool = False


@dataclass(frozen=True)
class FrameParts(AffineParts):
    """A device, its estimator and filter at the rate of samples, and frames of ``every`` samples.

    ``loop`` has no delay: that of each branch is its own.
    """

    loop: "LoopParameters"
    every: int
    stiffness: ForcePath
    damping: ForcePath

    def triple(self) -> Triple:
        """The parts of p(z) of a frame, where both gains are slow."""
        frame = _Frame(self)
        base, by_stiffness, by_damping = (
            frame.polynomial(*pair) for pair in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
        )
        return Triple(
            _known(base, frame.rigid),
            Factored(by_stiffness - base),
            _known(by_damping - base, min(frame.rigid, 1)),
        )

    def pencil(self, slow: str, fast: float) -> tuple[Factored, Factored]:
        """p(z) = p0 + g q by the slow gain g, the fast one given."""
        frame = _Frame(self)
        if slow == "stiffness":
            p0, p1 = (frame.polynomial(gain, fast) for gain in (0.0, 1.0))
            return _known(p0, min(frame.rigid, 1) if fast else frame.rigid), Factored(p1 - p0)
        p0, p1 = (frame.polynomial(fast, gain) for gain in (0.0, 1.0))
        at_one = 0 if fast else frame.rigid
        return _known(p0, at_one), _known(p1 - p0, min(at_one, 1))

    def filter_of(self, name: str, plant: SampledDevice) -> "tuple[list[arb], list[arb]]":
        """Numerator and denominator of the filter of a branch, the highest power of z first."""
        branch: ForcePath = getattr(self, name)
        is_slow = branch.is_slow and not branch.is_fast_inside
        period = float(self.loop.sample_time) * (self.every if is_slow else 1)
        filters = given_filters(self.loop.velocity, self.loop.position) or NO_FILTERS
        own = LoopFactors.from_plant(plant, period, filters)
        return _equation(*(own.position if name == "stiffness" else own.velocity))


def _known(p: "arb_poly", at_one: int) -> Factored:
    return Factored(known_out(p, 1, at_one), at_one=at_one)


def _equation(above: Factored, below: Factored) -> "tuple[list[arb], list[arb]]":
    """The coefficients of a difference equation, those of the output over its first one."""
    n, d = above.polynomial(), below.polynomial()
    order = int(d.degree())
    leading = d[order]
    return [n[order - k] / leading for k in range(order + 1)], [
        d[order - k] / leading for k in range(order + 1)
    ]


class _Frame:
    """Linear forms in the state at a frame's beginning, by the names of states."""

    def __init__(self, parts: FrameParts) -> None:
        self.parts, period = parts, float(parts.loop.sample_time)
        plant = plant_in_balls(parts.loop.held_device, period, 0.0)
        self.rigid = plant.denominator.at_one  # roots at 1 of the device alone
        below = plant.denominator._replace(power=plant.denominator.power + plant.lag)
        self.device = _equation(plant.numerator, below)
        self.filters = {name: parts.filter_of(name, plant) for name in ("stiffness", "damping")}
        self.names = [f"{kind}{k}" for kind in "xu" for k in range(1, len(self.device[0]))]
        for name, (numerator, _) in self.filters.items():
            orders = range(1, len(numerator))
            self.names += [f"{name}{side}{k}" for side in ("_in", "_out") for k in orders]
            self.names += [f"{name}_kept{k}" for k in range(1, self.depth(name) + 1)]

    def depth(self, name: str) -> int:
        """How many earlier numbers of a branch are kept."""
        branch: ForcePath = getattr(self.parts, name)
        if not branch.is_slow:
            return branch.late
        return ceil(branch.late / self.parts.every) + branch.is_ramp

    def polynomial(self, stiffness: float, damping: float) -> "arb_poly":
        """The characteristic polynomial of the matrix."""
        return flint.arb_poly(flint.arb_mat(self.rows(stiffness, damping)).charpoly())

    def rows(self, stiffness: float, damping: float) -> "list[list[arb]]":
        """The matrix of one frame."""
        gains = {"stiffness": flint.arb(stiffness), "damping": flint.arb(damping)}
        zero, one = flint.arb(0), flint.arb(1)
        now: dict[str, list[arb]] = {
            name: [one if i == k else zero for i in range(len(self.names))]
            for k, name in enumerate(self.names)
        }
        kept: dict[str, list[list[arb]]] = {}
        for sample in range(self.parts.every):
            position = self._output(now, *self.device, "u", "x", None)
            force = [zero] * len(self.names)
            for name, gain in gains.items():
                for share, value in self._acting(now, kept, name, sample, position):
                    force = _sum(force, value, -gain * share)
            _push(now, "x", len(self.device[0]) - 1, position)
            _push(now, "u", len(self.device[0]) - 1, force)
        for name, values in kept.items():
            for k in range(self.depth(name), 0, -1):
                now[f"{name}_kept{k}"] = values[k - 1]
        return [now[name] for name in self.names]

    def _acting(
        self, now: dict[str, Any], kept: dict[str, Any], name: str, sample: int, position: Any
    ) -> "list[tuple[arb, list[arb]]]":
        """What a branch has acting at a sample, with its share; its filter goes on."""
        branch: ForcePath = getattr(self.parts, name)
        one, n = flint.arb(1), self.parts.every
        if sample == 0 or not branch.is_slow or branch.is_fast_inside:
            order = len(self.filters[name][0]) - 1
            output = self._output(now, *self.filters[name], f"{name}_in", f"{name}_out", position)
            _push(now, f"{name}_in", order, position)
            _push(now, f"{name}_out", order, output)
        earlier = [now[f"{name}_kept{k}"] for k in range(1, self.depth(name) + 1)]
        if not branch.is_slow:
            values = [output, *earlier]
            for k in range(branch.late, 0, -1):
                now[f"{name}_kept{k}"] = values[k - 1]
            return [(one, values[branch.late])]
        if sample == 0:
            kept[name] = [output, *earlier]
        frames, within = divmod(sample - branch.late, n)
        if not branch.is_ramp:
            return [(one, kept[name][-frames])]
        share = flint.arb(within + 1) / n
        return [(share, kept[name][-frames]), (one - share, kept[name][1 - frames])]

    def _output(
        self,
        now: Mapping[str, Any],
        numerator: "list[arb]",
        denominator: "list[arb]",
        inputs: str,
        outputs: str,
        given: Any,
    ) -> "list[arb]":
        """The output of a difference equation; ``given`` is its input now, None if it has none."""
        total = [flint.arb(0)] * len(self.names)
        if given is not None:
            total = _sum(total, given, numerator[0])
        for k in range(1, len(numerator)):
            total = _sum(total, now[f"{inputs}{k}"], numerator[k])
            total = _sum(total, now[f"{outputs}{k}"], -denominator[k])
        return total


def _sum(total: "list[arb]", form: "list[arb]", weight: "arb") -> "list[arb]":
    return [x + weight * y for x, y in zip(total, form, strict=True)]


def _push(now: dict[str, Any], name: str, count: int, value: Any) -> None:
    """Let a history of so many values end with a new one."""
    for k in range(count, 1, -1):
        now[f"{name}{k}"] = now[f"{name}{k - 1}"]
    if count:
        now[f"{name}1"] = value
