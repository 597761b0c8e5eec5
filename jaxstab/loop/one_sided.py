"""One-sided, clipped and hardening forces: which gains are proved to rest, and the largest of them.

A pair of gains is proved by one multiplier (lemma C7, ``exact.sector``), and with it all shares of
both; beside a second gain that is always on, every first one from 0 to it. A row with both gains
behind the function is proved by a fan of triangles, one multiplier each. The largest gain is
searched, next to the limit of the linear loop, else by halving; what is found is proved.
"""

from collections.abc import Callable
from math import inf, isfinite, nan
from typing import Any, NamedTuple

from jaxstab.exact.sector import OneSidedWall, Taps, multiplier
from jaxstab.loop.gains import by_gain
from jaxstab.model.device.parts import FIRST_BITS, working_precision
from jaxstab.model.gain import Gain
from jaxstab.numbers import checked_number, checked_word
from jaxstab.shown import MOST_DIGITS, Printed, exact_text, number_text, stable_pair

_NEXT_TO = 0.9999  # of the limit of the linear loop, which is asked first
_HALVINGS = 10
_NARROWEST = 2.0**-9  # of a row: its shortest triangle

Proof = tuple[Taps, ...] | None


class OneSided(NamedTuple):
    """Whether gains are proved where their force only pushes, is clipped or hardens.

    An answer that is proved is true. Each value has the name of its gain, too: ``stiffness`` and
    ``damping`` of a wall.

    Attributes:
        is_proved: False says nothing: such gains may rest or swing.
        first: the first gain; NaN where a search found none.
        second: the second gain.
        covered: what the proof holds for besides.
        multipliers: the proof, (k, h_k) of each multiplier 1 - sum of h_k z^-k.
        names: those of the gains, and their units.

    Example:
        >>> loop = jaxstab.HapticLoop(
        ...     device_mass=0.25, device_damping=0.1, hand_stiffness=100.0, sample_time=1e-3
        ... )
        >>> answer = loop.one_sided(5000.0, 20.0)
        >>> answer
        OneSided: proved at stiffness = 5000 N/m, damping = 20 N s/m, and all shares of both
        >>> bool(answer), answer.stiffness, bool(loop.one_sided(5000.0, 600.0))
        (True, 5000.0, False)
    """

    is_proved: bool
    first: float
    second: float
    covered: str
    multipliers: tuple[Taps, ...]
    names: tuple[Gain, Gain]

    def __bool__(self) -> bool:
        """True if it is proved."""
        return self.is_proved

    def __getattr__(self, name: str) -> float:
        """A gain by its name."""
        value: float = by_gain(self, name, dict(zip(_names(self.names), self[1:3], strict=True)))
        return value

    def __repr__(self) -> str:
        if not isfinite(self.first):
            return f"OneSided: no {self.names[0].name} above 0 was proved"
        pair = ", ".join(
            f"{gain.name} = {number_text(x, MOST_DIGITS, unit=gain.unit)}"
            for gain, x in zip(self.names, self[1:3], strict=True)
        )
        if not self.is_proved:
            return f"OneSided: not proved at {pair}, which may rest or swing"
        return f"OneSided: proved at {pair}, and {self.covered}"


def _names(gains: tuple[Gain, Gain]) -> list[str]:
    return [gain.name for gain in gains]


def one_sided(loop: Any, pair: tuple[float, float], form: str) -> OneSided:
    """The answer to one pair of gains."""
    walls = _OneSidedWalls(loop, form, pair[1])
    proof = walls.alone(*pair)
    first, second = (Printed(x, exact_text(x)) for x in pair)
    return OneSided(proof is not None, first, second, walls.covered, proof or (), loop.gains)


def one_sided_limit(loop: Any, form: str, ratio: float | None, given: dict[str, float]) -> OneSided:
    """The largest first gain along a ray or a row."""
    first, second = _names(loop.gains)
    if (ratio is None) == (not given) or not set(given) <= {second}:
        words = ", ".join([*given, *([] if ratio is None else ["ratio"])]) or "none"
        raise TypeError(f"given: {words}; give {second}, or its ratio to {first}.")
    if ratio is not None and form == "spring":
        raise ValueError(
            f'ratio is given with form "spring", where {second} is not a share of {first}; give '
            f"{second}."
        )
    slope = 0.0 if ratio is None else checked_number("ratio", ratio)
    base = checked_number(second, given.get(second, 0.0))
    walls = _OneSidedWalls(loop, form, base)
    prove = walls.fan if form == "force" and base else walls.alone
    stable = loop._line((0.0, base), (1.0, slope)).holding(0.0)
    reach = inf if stable is None else stable.high.value
    value, proof = _largest(lambda t: prove(t, base + slope * t), reach)
    if proof is None:
        return OneSided(False, nan, base, "", (), loop.gains)
    pair = stable_pair(
        value,
        base + slope * value,
        (6, 6),
        lambda x, y: (ratio is None and y == base and x <= value) or prove(x, y) is not None,
    )
    covered = walls.covered if ratio is not None else f"every {first} from 0 to it"
    return OneSided(True, *pair, covered, proof, loop.gains)


def _largest(prove: Callable[[float], Proof], reach: float) -> tuple[float, Proof]:
    """The largest t that is proved below the limit of the linear loop, as found, and the proof."""
    if not isfinite(reach):
        return nan, None
    low, high = 0.0, _NEXT_TO * reach
    found = prove(high)
    if found is not None:
        return high, found
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        proof = prove(middle)
        low, high, found = (low, middle, found) if proof is None else (middle, high, proof)
    return low, found


class _OneSidedWalls:
    """The walls of a loop behind functions of one form; ValueError where none can be proved."""

    def __init__(self, loop: Any, form: str, second: float) -> None:
        self.loop = loop
        self.is_spring = checked_word("form", form, ("force", "spring")) == "spring"
        names = _names(loop.gains)
        self.covered = f"every {names[0]} from 0 to it" if self.is_spring else "all shares of both"
        both = " and ".join(names)
        if loop._only_few:
            raise ValueError(
                f"{both} move the leading coefficient of p(z): the force depends on itself "
                "without a sample between, and no one-sided force is proved."
            )
        if not (self.is_spring or loop.parts.is_one_force):
            raise ValueError(
                f"{both} act with delays of their own, so that no one force is one-sided; give "
                'form="spring".'
            )
        with working_precision(FIRST_BITS):
            without, _ = self._wall(0.0, second).sides()
        if without.is_on_circle:
            raise ValueError(
                "without the force a root of p(z) stays on the unit circle: nothing holds the "
                "device, or an integrator goes on. One-sided forces are proved of a device that a "
                "spring holds, however soft: give the hand a stiffness, such as 1e-6 N/m."
            )

    def _wall(self, first: float, second: float) -> OneSidedWall:
        without = 0.0, second if self.is_spring else 0.0
        return OneSidedWall(self.loop._triple, without, (first, second))

    def alone(self, first: float, second: float) -> Proof:
        """The proof of one pair of gains."""
        taps = multiplier([self._wall(first, second)])
        return None if taps is None else (taps,)

    def fan(self, first: float, second: float) -> Proof:
        """The proof of all first gains from 0 to this one, by one multiplier for each part."""
        parts, found = [(0.0, first)], list[Taps]()
        if self.alone(first, second) is None:
            return None
        while parts:
            low, high = parts.pop()
            taps = multiplier([self._wall(low, second), self._wall(high, second)])
            if taps is not None:
                found.append(taps)
            elif high - low < 2.0 * _NARROWEST * first:
                return None
            else:
                parts += [(low, 0.5 * (low + high)), (0.5 * (low + high), high)]
        return tuple(found[::-1])
