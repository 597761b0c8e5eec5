"""Limits of many loops: batches on JAX, and one by one what these leave open.

Loops with the same estimator and filter are a *stack*: one loop with columns in place of numbers,
checked at once and formed together, in pairs of float64, by their whole samples of delay. They are
grouped by the degree of p(z), filled up to one of few degrees, so that few programs are compiled
(``jaxstab.region.batch``). A group is computed as soon as it is large enough, while the next one is
formed, so that few coefficients are held at once. Where the scan of a loop missed a piece
of the boundary, most often a narrow one next to a vibration mode, it is scanned again with angles
that come closer and closer to where that piece begins. What a program does not resolve then, and
groups too small to compile for, are answered as ``HapticLoop.limits`` answers.

Parts of other loops come from their balls one by one, rounded once to pairs of float64. All else is
found for all of one degree at once, in float64, from samples of base and S around the circle:

- *poles*, the angles where Im(conj(S) R) changes its sign: the curve goes to infinity there;
- *roots* of base and of S next to the circle.

A loop of which an angle is missed is not resolved by a batch, and is answered by itself.
"""

from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache, partial, reduce
from itertools import accumulate, chain, islice
from math import prod
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

from jaxstab.arrays import Array, is_any_jax, leaves, namespace, take, tree_map
from jaxstab.batches import ahead, alike, in_float64
from jaxstab.conventions import Verdict
from jaxstab.exact import TripleAt
from jaxstab.exact.roots import are_inside
from jaxstab.loop.affine import Loop
from jaxstab.loop.region import Limits, Region
from jaxstab.model import LoopParameters, require_x64
from jaxstab.model.affine import AdmittanceParts, affine_triple
from jaxstab.model.balls import Factored, ball_triple
from jaxstab.model.device.parts import FIRST_BITS, working_precision
from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.filters import NO_FILTERS, Filters, behind_measured, exact_chain, given_filters
from jaxstab.model.gain import WALL, Gain
from jaxstab.model.linear_loop import companion_matrix, filter_factors, filtered_loop
from jaxstab.model.loop import array_fields, as_one
from jaxstab.numbers import require_together
from jaxstab.point.polynomials import codes_in_float64
from jaxstab.region import RegionStatus
from jaxstab.region.curve import Angles
from jaxstab.region.measures import vertex_roots

if TYPE_CHECKING:
    from jaxstab.region.batch import Extremes, Triples

_VERTICES = 295  # of an outline
_AT_ONCE = 256  # loops that a program takes
_FORMED = 2048  # loops of one mass that are formed at once
_SCANS = 3  # of a loop, at most
_DEGREES = (5, 9, 17, 25, 41, 65)  # up to which p(z) are filled: each program takes memory
_SAMPLES = 512  # of half the circle
_NO_ROOT = 0.0, 0.05  # its angle, and its distance from the circle
_FEWEST = dict(zip(_DEGREES, (400, 400, 400, 400, 200, 100), strict=True))
"""Loops of a degree for which a program is compiled, which takes longer, or is in the cache."""


Indices = Int64[np.ndarray, " _"]
Outlines = tuple[
    Float64[np.ndarray, "*loop vertex 2"],
    Float64[np.ndarray, "*loop vertex 2"],
    Float64[np.ndarray, "*loop"],
]
Units = Float64[np.ndarray, "loop 2"]
Rows = Float64[np.ndarray, "loop power"]
Form = tuple[float, Filters]  # of p(z) for one mass: the delay in samples, estimator and filter


class Formed(NamedTuple):
    """Loops that are formed together, as arrays: while they wait, these take the least memory."""

    members: Indices
    parts: DoubleDouble  # (loop, part, power) coefficients of p(z)
    ends: Float64[Array, "loop 2 3"]
    poles: Float64[np.ndarray, "loop pole"]  # angles where the curve goes to infinity
    roots: Float64[Array, "loop root 2"]  # next to the circle: angles and distances
    units: Units  # of answers, in those of the parts
    turned: Bool[np.ndarray, " loop"]  # the second gain takes the place of the first one
    unstable: Bool[np.ndarray, " loop"]  # with small gains


_Group = tuple[list[Formed], "Triples", Callable[..., Any]]


class ManyRegions(NamedTuple):
    """The stable walls of each loop that are connected to zero gains, without islands.

    Attributes:
        outline: closed polygons of walls (K, B) on the exact boundary, counter-clockwise, of the
            shape (*loop, 295, 2); the last walls repeat the first. NaN where there is no region.
        area: of the exact regions, in N/m times N s/m; NaN where there is none.
        limits: the stiffest and the most damped wall, as ``limits_of`` returns them.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> regions = jaxstab.regions_of(loop, delay=[0.0, 1e-3])
        >>> regions.outline.shape, f"{regions.area[0]:.4g}", bool(regions.limits.is_single[0])
        ((2, 295, 2), '9.526e+06', True)
    """

    outline: Float64[Array, "*loop vertex 2"]
    area: Float64[Array, "*loop"]
    limits: Limits[Array]


def computed(
    many: Any, fields: dict[str, Any], shape: tuple[int, ...], *, outlines: bool
) -> ManyRegions:
    """The limits of loops that JAX does not trace and, with ``outlines``, outlines and areas."""
    if isinstance(many, list) and many and all(isinstance(loop, Loop) for loop in many):
        stacks, kinds = [Stack(np.arange(len(many)), many)], {loop.gains for loop in many}
        gains = kinds.pop() if len(kinds) == 1 else (Gain("first"), Gain("second"))
        answer = _searched(stacks, gains, outlines=outlines)
    else:
        answer = _searched(_stacks(many, fields, shape), WALL, outlines=outlines)
    return in_shape(answer, shape)


def in_shape(answer: ManyRegions, shape: tuple[int, ...]) -> ManyRegions:
    """Answers to a list of loops in the shape of their fields."""
    return tree_map(lambda column: column.reshape((*shape, *column.shape[1:])), answer)


def empty_outlines(*shape: int) -> Outlines:
    """Return outlines of no regions: vertices (alpha, beta), angles of their roots, and areas."""
    return *np.full((2, *shape, _VERTICES, 2), np.nan), np.full(shape, np.nan)


def outline_of(region: Region) -> Outlines:
    """Return the outline of the component that holds small gains, as a batch returns outlines."""
    if region.main is None:
        return empty_outlines()
    main = region.main.region
    roots, is_corner = vertex_roots(main.curve, main.outline)
    roots = roots if main.loops == 1 else np.full_like(roots, np.nan)  # moves no region with holes
    corners, others = np.flatnonzero(is_corner), np.flatnonzero(~is_corner)
    spread = np.linspace(0, len(others) - 1, _VERTICES - len(corners)).round().astype(int)
    chosen = np.sort(np.append(corners, others[spread]))
    return main.points[chosen], roots[chosen], main.area


def _limits_alone(loop: Any) -> tuple[Sequence[float], RegionStatus, bool]:
    """Limits, status and reach of one loop; admittances follow from one with T = 1 and Ke = 1."""
    if not isinstance(loop, Loop):
        values = loop.limits()
        return values[:4], values.status, values.is_reachable
    mass = damping = 1.0
    if isinstance(loop.parts, AdmittanceParts):
        parts, (mass, damping) = loop.parts.in_units()
        loop = replace(loop, parts=parts, sample_time=1.0, words="")
    found = _limits_of(loop)
    values = np.multiply(found[:4], [mass, damping, damping, mass]).tolist()
    return values, found.status, found.is_reachable


@lru_cache(1024)
def _limits_of(loop: Loop) -> Limits[float]:
    return loop.limits()


class Stack(NamedTuple):
    """Loops with one estimator, filter and device: ``loop`` has columns in place of some numbers.

    With filters the sampling period is one number; a device that is not one mass has no columns.
    Loops of any two gains are one stack, ``loop`` their list.
    """

    members: Indices
    loop: Any


def singles(stacks: list[Stack], chosen: Bool[np.ndarray, " loop"]) -> Iterator[tuple[int, Any]]:
    """Yield the indices of the chosen loops, and these one by one."""
    for members, loop in stacks:
        if isinstance(loop, list):
            yield from ((int(k), loop[k]) for k in np.flatnonzero(chosen))
            continue
        columns = {name: value for name, value in vars(loop).items() if np.ndim(value)}
        for place in np.flatnonzero(chosen[members]).tolist():
            one = {name: float(value[place]) for name, value in columns.items()}
            yield int(members[place]), replace(loop, **one)


def given_loops(loops: Any, fields: dict[str, Any]) -> tuple[Any, dict[str, Any], tuple[int, ...]]:
    """Return a list of loops, or one and the fields that vary, and the shape of the answers."""
    if isinstance(loops, LoopParameters):
        own = array_fields(loops)
        if not prod(loops.shape):
            return [], {}, require_together(**own, **fields)
        first = {name: namespace(x).ravel(x)[0] for name, x in own.items()}
        fields = own | fields
        return replace(loops, **first), fields, require_together(**fields)
    if not isinstance(loops, Iterable):
        raise TypeError(f"loops is {loops!r}; give a list of HapticLoop, or one.")
    if fields:
        raise TypeError(f"{next(iter(fields))} is given beside a list; give one loop that varies.")
    many = list(loops)
    return many, {}, (len(many),)


def varied_loops(given: Any, fields: dict[str, Any], shape: tuple[int, ...]) -> list[Any]:
    """Return loops one by one."""
    if isinstance(given, list):
        return given
    arrays = (column_of(x, shape) for x in fields.values())
    columns = (x.tolist() if isinstance(x, np.ndarray) else list(x) for x in arrays)
    rows = zip(*columns, strict=True) if fields else [()]
    return [replace(given, **dict(zip(fields, row, strict=True))) for row in rows]


def column_of(values: Any, shape: tuple[int, ...]) -> Array:
    """The values of a field for each of many loops."""
    column: Array = namespace(values).broadcast_to(values, shape).ravel()
    return column


def _stacks(given: Any, fields: dict[str, Any], shape: tuple[int, ...]) -> list[Stack]:
    """Return loops that JAX does not trace, in stacks."""
    filters = "velocity", "position"
    if isinstance(given, list) or given.device is not None or "device" in fields:
        return stacked(varied_loops(given, fields, shape))
    require_x64(*leaves(fields, plain=False))
    loop = in_floats(given)
    columns = {name: np.broadcast_to(np.asarray(x), shape).ravel() for name, x in fields.items()}
    is_plain = not (loop.velocity or loop.position) and set(filters).isdisjoint(fields)
    shared = [name for name in ("sample_time", *filters) if name in fields and not is_plain]
    kinds = zip(*(columns[name].tolist() for name in shared), strict=True)
    stacks = []
    for members in map(np.array, alike(kinds if shared else [()] * prod(shape))):
        one = {name: values[members[:1]].tolist()[0] for name, values in columns.items()}
        first = replace(loop, **one)  # an error names one value
        varied = {name: values[members] for name, values in columns.items() if name not in shared}
        stacks.append(Stack(members, replace(first, **varied)))
    return stacks


def stacked(many: Sequence[Any]) -> list[Stack]:
    """Return a list of loops that JAX does not trace, in stacks."""
    loops = list(map(in_floats, many))
    stacks = []
    for members in alike(map(_kind, loops)):
        first, is_one = loops[members[0]], len(members) == 1
        one = first if is_one or first.body is None else as_one([loops[k] for k in members])
        stacks.append(Stack(np.array(members), one))
    return stacks


def in_floats(loop: Any) -> Any:
    """Return a loop with floats; TypeError for what is no loop."""
    if not isinstance(loop, LoopParameters):
        raise TypeError(f"loops has {loop!r}; give a HapticLoop for each.")
    return loop.in_floats()


def _searched(stacks: list[Stack], gains: tuple[Gain, Gain], *, outlines: bool) -> ManyRegions:
    """The answers to loops that JAX does not trace, of these gains."""
    count = sum(len(members) for members, _ in stacks)
    found: Any = empty_outlines(count) if outlines else (None,) * 3
    vertices, _, area = found
    walls, status = np.full((count, 4), np.nan), np.full(count, RegionStatus.UNRESOLVED, np.int8)
    is_reachable, is_single = np.zeros(count, bool), np.ones(count, bool)
    for members, units, (extremes, outline) in resolved(stacks, outlines=outlines):
        stiffest, damped = np.moveaxis(extremes.walls * units[:, None], 1, 0)
        walls[members] = np.hstack([stiffest, damped[:, ::-1]])
        status[members], is_single[members] = RegionStatus.COMPLETE, False
        is_reachable[members] = extremes.failures == 0
        if outlines:
            vertices[members] = outline.vertices * units[:, None]
            area[members] = outline.area * units.prod(axis=1)
    is_open = is_single & outlines
    if outlines and gains != WALL:  # the batch has some of these in other coordinates
        is_single |= [not loop._chart.are_gains for loop in stacks[0].loop]
    for index, loop in singles(stacks, is_single):
        walls[index], status[index], is_reachable[index] = _limits_alone(loop)
        if is_open[index]:
            region = loop.region()
            vertices[index], _, area[index] = outline_of(region)
            vertices[index] *= region.units
            area[index] *= prod(region.units)
    one, at_two, two, at_one = walls.T
    limits = Limits(one, at_two, two, at_one, status, is_reachable, is_single, names=gains)
    return ManyRegions(vertices, area, limits)


def resolved(
    stacks: list[Stack], *, outlines: bool
) -> "Iterator[tuple[Indices, Units, tuple[Extremes, Any]]]":
    """Yield loops that the program of a batch resolved, and its answers in units of their gains."""
    are_walls = not any(isinstance(loop, list) for _, loop in stacks)
    formed: Iterable[Formed] = _formed(stacks, in_charts=outlines)
    compiled: set[int] = set()
    for _ in range(_SCANS):
        again: list[Formed] = []
        for (parts, *_), answer in ahead(_answer, _grouped(formed, compiled, outlines=outlines)):
            from jaxstab.region.batch import ISLAND

            accepted = [0] if outlines or are_walls else [0, ISLAND]
            members = np.concatenate([part.members for part in parts])
            units, turned, unstable = map(np.concatenate, list(zip(*parts, strict=True))[5:])
            extremes, outline = take(answer, np.arange(len(members)))
            extremes.failures[(extremes.failures == 0) & unstable] = ISLAND
            is_open = ~np.isin(extremes.failures, accepted)
            is_open |= np.any(np.diagonal(extremes.walls, axis1=1, axis2=2) < 0.0, axis=1)
            units[turned] = units[turned, ::-1]
            extremes.walls[turned] = extremes.walls[turned, ::-1, ::-1]
            if outlines:
                outline.vertices[turned] = outline.vertices[turned, ::-1, ::-1]
            own = np.flatnonzero(~is_open)
            if own.size:
                yield members[own], units[own], take((extremes, outline), own)
            again += _with_missed(parts, np.where(is_open[:, None], extremes.missed, np.nan))
        formed = again


def _answer(group: _Group) -> "tuple[Extremes, Any]":
    """Return the answers of a program, to copies behind the loops of the group."""
    _, triples, program = group
    return in_float64(program, take(triples, np.arange(_AT_ONCE) % len(triples.angles)))


def _grouped(formed: Iterable[Formed], compiled: set[int], *, outlines: bool) -> Iterator[_Group]:
    """Yield groups as soon as there are enough loops, filled up to one degree, and their program.

    Loops that are too few to compile for are filled up to the next degree.
    """
    fewest_compiled = 4  # loops for a program that is compiled
    waiting: dict[int, list[Formed]] = {degree: [] for degree in _DEGREES}

    def groups(own: list[Formed], degree: int, fewest: int) -> Iterator[_Group]:
        while _count(own) >= fewest:
            from jaxstab.region.batch import program  # few loops need no JAX

            compiled.add(degree)
            piece, own[:] = _cut(own, _AT_ONCE)
            yield piece, _triples(piece, degree), program(degree, outlines=outlines)

    for part in formed:
        degree = _filled_degree(part)
        if degree is not None:
            waiting[degree].append(part)
            yield from groups(waiting[degree], degree, _AT_ONCE)
    few, share = list[Formed](), 0.0  # of the time to compile, that they take one by one
    for degree in _DEGREES:
        few += waiting[degree]
        share += _count(waiting[degree]) / _FEWEST[degree]
        if share >= 1.0 or (degree in compiled and _count(few) >= fewest_compiled):
            yield from groups(few, degree, 1)
            share = 0.0


def _count(formed: list[Formed]) -> int:
    return sum(len(part.members) for part in formed)


def _cut(formed: list[Formed], count: int) -> tuple[list[Formed], list[Formed]]:
    """Return so many loops, and the others."""
    sides: tuple[list[Formed], list[Formed]] = [], []
    for part in formed:
        for side, own in zip(sides, (slice(count), slice(count, None)), strict=True):
            piece = take(part, own)
            side += [piece] if len(piece.members) else []
        count = max(0, count - len(part.members))
    return sides


def _with_missed(formed: list[Formed], missed: Float64[np.ndarray, "loop 2"]) -> Iterator[Formed]:
    """Yield the loops of which a piece was missed: their scans will be finer next to it."""
    first_angles = np.array([1e-5, 3e-5])  # their distances from where a piece was missed
    more = np.stack(np.broadcast_arrays(missed, first_angles), axis=-1)
    ends = np.cumsum([len(part.members) for part in formed])
    for part, added in zip(formed, np.split(more, ends[:-1]), strict=True):
        own = np.flatnonzero(np.isfinite(added[:, 0, 0]))
        if own.size:
            roots = np.concatenate([part.roots[own], added[own]], axis=1)
            yield take(part, own)._replace(roots=roots)


def _formed(stacks: list[Stack], *, in_charts: bool = False) -> Iterator[Formed]:
    """Yield loops that differ in mass, damping, stiffness and fraction of the delay alone.

    Those with filters that leave float64 few digits are left out.
    """
    for members, loop in stacks:
        if isinstance(loop, list) or loop.body is None:
            continue
        filters = given_filters(**loop.filters) or NO_FILTERS
        values = *loop.slice.values(), loop.stiffness(1.0), loop.damping(1.0), members
        gamma, delta, delay, *scale, _ = np.broadcast_arrays(*values)
        units = np.stack(scale, axis=-1)
        for alone in map(np.array, alike(zip(delay // 1.0, delay % 1.0 == 0.0, strict=True))):
            for part in np.split(alone, range(_FORMED, len(alone), _FORMED)):
                own = members[part], units[part], gamma[part], delta[part], delay[part]
                yield from _masses(*own, filters)
    others = _by_balls(stacks, in_charts=in_charts)
    while block := list(islice(others, _AT_ONCE)):
        indices, triples = zip(*block, strict=True)
        yield from sampled_loops(np.array(indices), triples)


def _by_balls(stacks: list[Stack], *, in_charts: bool) -> Iterator[tuple[int, TripleAt]]:
    """Yield other devices, and loops of any two gains if these are those of the chart, or all."""
    for members, loop in stacks:
        if isinstance(loop, list):
            pairs = zip(members.tolist(), loop, strict=True)
            chosen = ((k, one) for k, one in pairs if in_charts or one._chart.are_gains)
            yield from ((k, partial(affine_triple, one._chart)) for k, one in chosen)
        elif loop.body is None and _poles(given_filters(**loop.filters) or NO_FILTERS) is not None:
            yield from ((k, partial(ball_triple, loop)) for k in members.tolist())


def _masses(
    members: Indices,
    units: Units,
    gamma: Array,
    delta: Array,
    delay: Float64[np.ndarray, " loop"] | float,
    filters: Filters,
) -> list[Formed]:
    """Loops of one mass with the same whole samples of delay.

    None if their filters leave float64 few digits.
    """
    poles, count = _poles(filters), len(members)
    if poles is None:
        return []
    whole = int(np.min(delay))
    fraction = 0.0 if np.all(delay == whole) else delay - whole
    linear = filtered_loop(gamma, delta, whole, fraction, filters)
    parts, ends = (_columns(rows, count) for rows in (linear[:3], linear[3:5]))
    every, roots = np.broadcast_to(poles, (count, poles.size)), _resonances(gamma, delta)
    flags = np.zeros((2, count), bool)
    return [Formed(members, parts, ends.rounded(), every, roots, units, *flags)]


def common_form(many: Sequence[LoopParameters]) -> Form | None:
    """Return the form that loops have in common; None if they have none, or JAX traces it."""
    if is_any_jax([(loop.delay, loop.sample_time, loop.velocity, loop.position) for loop in many]):
        return None
    forms = {(float(x.delay_samples), given_filters(**x.filters) or NO_FILTERS) for x in many}
    return forms.pop() if len(forms) == 1 else None


def triples_of_masses(gamma: Array, delta: Array, form: Form) -> "Triples | None":
    """Return the triples of loops of one form, also inside of jit; None where none are formed."""
    count = len(gamma)
    formed = _masses(np.arange(count), np.ones((count, 2)), gamma, delta, *form)
    degree = _filled_degree(formed[0]) if formed else None
    return None if degree is None else _triples(formed, degree)


def _kind(loop: LoopParameters) -> Hashable:
    """The kind that loops of a stack share: a device that is not one mass is by itself."""
    if loop.body is None:
        return loop
    is_filtered = loop.velocity is not None or loop.position is not None
    return loop.velocity, loop.position, loop.sample_time if is_filtered else None


def _resonances(gamma: Array, delta: Array) -> Float64[Array, "loop 1 2"]:
    """Return angle and distance from the circle of the poles of masses on springs."""
    narrowest, no_resonance = 1e-6, 0.05  # distances from the circle
    xp = namespace(gamma, delta)
    angle = xp.sqrt(xp.maximum(gamma - 0.25 * delta**2, 0.0))
    width = xp.where(angle > 0.0, xp.maximum(0.5 * delta, narrowest), no_resonance)
    return xp.stack([angle, width], axis=1)[:, None]


def _filled_degree(formed: Formed) -> int | None:
    """Return the degree up to which p(z) is filled; None where that or its poles are too many."""
    enough = (degree for degree in _DEGREES if degree >= formed.parts.hi.shape[-1] - 1)
    poles, roots = formed.poles.shape[-1], formed.roots.shape[1]
    return next((degree for degree in enough if poles + roots <= degree + 2), None)


def _triples(formed: list[Formed], degree: int) -> "Triples":
    from jaxstab.region.batch import Triples

    straight = _joined([group.parts for group in formed], degree)
    xp = namespace(straight)
    ends = xp.concatenate([group.ends for group in formed])
    scans = [_scans(group, degree) for group in formed]
    shifted, rounded = _shifted(straight), straight.rounded()
    return Triples(rounded, shifted, _close(rounded, shifted), ends, xp.concatenate(scans))


def _close(
    straight: Float64[Array, "loop part power"], shifted: Float64[Array, "loop part power"]
) -> Float64[Array, "loop part"]:
    """Return up to which abs(z - 1) powers of z - 1 have the smaller terms, by bisection."""
    farthest, halvings = 1.5, 8  # of z - 1, for which its powers may have the smaller terms
    xp = namespace(straight, shifted)
    most, sizes = xp.sum(abs(straight), axis=-1), xp.moveaxis(abs(shifted), -1, 0)
    low, high = xp.zeros_like(most), xp.full_like(most, farthest)
    for _ in range(halvings):
        middle = 0.5 * (low + high)
        is_less = reduce(lambda total, size: total * middle + size, sizes) < most
        low, high = xp.where(is_less, middle, low), xp.where(is_less, high, middle)
    return low


def _joined(groups: list[DoubleDouble], degree: int) -> DoubleDouble:
    """Join coefficients, each p(z) times a power of z that makes it one of the given degree."""
    xp = namespace(groups)

    def joined(*values: Array) -> Array:
        zeros = [((0, 0), (0, 0), (0, degree + 1 - x.shape[-1])) for x in values]
        return xp.concatenate(list(map(xp.pad, values, zeros)))

    return tree_map(joined, *groups)


def _columns(rows: Sequence[Sequence[DoubleDouble]], count: int) -> DoubleDouble:
    """Return numbers of a number of loops as one pair of arrays (loop, row, column)."""
    xp = namespace(rows)

    def stacked(*values: Array) -> Array:
        columns = xp.array([xp.broadcast_to(x, count) for x in values])
        return xp.moveaxis(columns.reshape(len(rows), -1, count), 2, 0)

    return tree_map(stacked, *chain(*rows))


def _shifted(falling: DoubleDouble) -> Float64[Array, "loop part power"]:
    """Return the coefficients in powers of z - 1, by Horner's rule, in float64."""
    quotient, rising = [falling[..., k] for k in range(falling.hi.shape[-1])], []
    while quotient:
        *quotient, value = accumulate(quotient, DoubleDouble.__add__)
        rising.append(value.rounded())
    return namespace(falling).stack(rising[::-1], axis=-1)


@lru_cache(64)
def _poles(filters: Filters) -> Angles | None:
    """Return the angles in (0, pi) where V/P is real; None for filters left to single answers.

    These are filters that leave float64 few digits, those with P(1) = 0, and measured velocities.
    """
    ill_conditioned = 1e8  # a denominator's coefficients, over its least size on the circle
    if behind_measured(filters[0]) is not None:
        return None
    rows, _ = filter_factors(filters)
    parts = np.zeros((1, 3, max(map(len, rows))))
    for part, row in zip(parts[0], rows, strict=True):
        part[: len(row)] = [float(c.rounded()) for c in row]
    least = np.min(np.abs(np.fft.rfft(parts[0, 0], 2 * _SAMPLES)))
    size = np.sum(np.abs(parts[0, 0]))
    if size >= ill_conditioned * least or exact_chain(filters[1].sections)[0](1) == 0:
        return None
    poles: Angles = _infinite(parts)[0]
    return poles[np.isfinite(poles)]


def _scans(formed: Formed, degree: int) -> Float64[Array, "loop angle"]:
    """Return the angles of the scans: even steps, finer to both ends, to poles and resonances."""
    first, closest = 1e-6, 1e-7  # angles of a scan, and their distances from poles
    to_ends, to_poles, to_roots = 12, 6, 8  # angles that come closer and closer
    beyond = 0.97  # angles beyond an end, so that none is there twice
    roots, count = formed.roots.shape[1], 2 * to_ends + 24 + (8 + 2 * to_poles) * degree
    poles = formed.poles.shape[-1] * (2 * to_poles + 1)
    even_count = count - 2 * to_ends - poles - roots * 2 * to_roots
    step = np.pi / even_count
    even = step * (np.arange(even_count) + 0.5)
    to_end = np.geomspace(first, even[0], to_ends, endpoint=False)
    to_pole = np.geomspace(closest, step, to_poles)
    shared = np.concatenate([to_end, even, np.pi - to_end])
    near = formed.poles[..., None] + np.concatenate([-to_pole, [0.0], to_pole])
    xp = namespace(formed.roots)
    angle, width = xp.moveaxis(formed.roots, 2, 0)[..., None]
    growth = np.linspace(-1.0, 1.0, 2 * to_roots)
    reach = xp.maximum(angle, 2.0 * step) * (1.0 + 0.01 * np.arange(roots))[:, None]
    farthest = xp.maximum(xp.arcsinh(reach / width), 1.0)  # no two angles are the same
    around = angle + width * xp.sinh(farthest * growth)
    mirrored = xp.where(around < 0.0, -beyond * around, around)
    mirrored = xp.where(around > np.pi, np.pi - beyond * (around - np.pi), mirrored)
    own = xp.clip(mirrored, 2.0 * first, np.pi - 2.0 * first).reshape(len(angle), -1)
    near = near.reshape(len(own), poles)
    return xp.sort(xp.concatenate([xp.tile(shared, (len(own), 1)), near, own], axis=1))


def sampled_loops(members: Indices, triples: Sequence[TripleAt]) -> Iterator[Formed]:
    """Loops by their balls, filled up to one of the degrees, those with as many poles together.

    Gains are in units that make them of size 1. Where the second one alone moves p(1), it takes the
    place of the first.
    """
    every = list(map(_rounded, triples))
    filled = [min((n for n in _DEGREES if n >= len(row[0][0]) - 1), default=0) for row in every]
    for own in map(np.array, alike(filled)):
        degree = filled[own[0]]
        if not degree:
            continue
        rows = np.zeros((2, own.size, 3, degree + 1))
        for k, place in enumerate(own):
            rows[:, k, :, : len(every[place][0][0])] = every[place][:2]
        scale = 2.0 ** -np.round(np.log2(np.abs(rows[0]).sum(axis=-1)))
        scale[:, 0] = 1.0
        parts, ends = rows * scale[..., None], np.array([every[k][2] for k in own]) * scale[:, None]
        turned = (ends[:, 0, 1] == 0.0) & (ends[:, 0, 2] != 0.0)
        for rest in (parts[0], parts[1], scale, ends.transpose(0, 2, 1)):
            rest[turned, 1:] = rest[turned, :0:-1]
        unstable = _are_unstable([every[k][3] for k in own])
        with np.errstate(all="ignore"):  # NaN tells where nothing is found
            poles = _infinite(parts[0])
        roots = _near(parts[0, :, :2]).reshape(own.size, -1, 2)
        order = np.argsort(roots[..., 1], axis=1)[..., None]
        roots = np.take_along_axis(roots, order, axis=1)
        counts = np.sum(np.isfinite(poles), axis=1)
        for kind in map(np.array, alike(counts.tolist())):
            there = np.any(roots[kind, :, 0] != 0.0, axis=0)
            yield Formed(
                members[own[kind]],
                DoubleDouble(*parts[:, kind]),
                ends[kind],
                poles[kind, : counts[kind[0]]],
                roots[kind, : max(1, int(np.sum(there)))],
                scale[kind, 1:],
                turned[kind],
                unstable[kind],
            )


def _rounded(triple_at: TripleAt) -> tuple[Any, Any, Any, Any]:
    """Coefficients of the parts, highest power first, what rounding took from them, and ends.

    Last the factor of base without roots at 0, 1 and -1.
    """
    with working_precision(FIRST_BITS):
        triple = triple_at().monic()
        degree, sign = triple.degree, (-1) ** triple.degree
        wholes = [part.polynomial() for part in triple]
        rows = [[whole[power] for power in range(degree, -1, -1)] for whole in wholes]
        high = [list(map(float, row)) for row in rows]
        pairs = [zip(*own, strict=True) for own in zip(rows, high, strict=True)]
        low = [[float(ball - number) for ball, number in own] for own in pairs]
        ends = [[float(part.at_end(z)) * s for part in triple] for z, s in ((1, 1), (-1, sign))]
    return high, low, ends, triple.base.rest


def _are_unstable(rests: list[Any]) -> Bool[np.ndarray, " loop"]:
    """True where roots of base are outside, so far that small gains do not bring them in."""
    radius, roundings = 1.0 + 1e-9, 4.0  # of a coefficient, of a power of the radius, a product
    count = max(2, *map(len, rests))
    falling = np.zeros((len(rests), count))
    for k, rest in enumerate(rests):
        falling[k, : len(rest)] = rest.coeffs()[::-1]
    codes = codes_in_float64(falling * radius ** np.arange(count)[::-1], roundings=roundings)
    is_outside = codes == Verdict.UNSTABLE
    for k in np.flatnonzero(codes == Verdict.UNDECIDED).tolist():
        with working_precision(FIRST_BITS):
            is_outside[k] = are_inside(Factored(rests[k]).of_radius(radius)) is False
    return is_outside


def _infinite(parts: Float64[np.ndarray, "loop 3 power"]) -> Float64[np.ndarray, "loop _"]:
    """The angles where Im(conj(S) R) changes its sign, and NaN behind them."""
    values = np.fft.rfft(parts, 2 * _SAMPLES)[..., 1:-1]  # in (0, pi), but for a power of z
    det = values[:, 1].real * values[:, 2].imag - values[:, 1].imag * values[:, 2].real
    loop, place = np.nonzero((det[:, 1:] > 0.0) != (det[:, :-1] > 0.0))
    share = det[loop, place] / (det[loop, place] - det[loop, place + 1])
    step, low = np.pi / _SAMPLES, (place + 1) * (np.pi / _SAMPLES)
    angle, order = low + share * step, np.arange(parts.shape[-1])[::-1]
    for _ in range(4):  # steps of Newton's method
        terms = parts[loop, 1:] * np.vander(np.exp(1j * angle), order.size)[:, None]
        (s, r), (s_slope, r_slope) = terms.sum(axis=-1).T, (terms @ order).T
        slope = (s.conj() * r_slope - s_slope.conj() * r).real  # d/dtheta is iz d/dz
        angle = np.clip(angle - (s.conj() * r).imag / slope, low, low + step)
    found = np.full_like(det[:, 1:], np.nan)
    found[loop, place] = angle
    return np.sort(found, axis=1)[:, : np.max(np.bincount(loop), initial=0)]


def _near(falling: Float64[np.ndarray, "loop part power"]) -> Any:
    """Angles in (0, pi) of the roots of polynomials, and their distances from the circle.

    Far from it, or real, they are none. What is missing before the highest power are roots at 0.
    """
    narrowest, farthest, real, count = 1e-9, _NO_ROOT[1], 1e-6, falling.shape[-1]
    first = np.argmax(falling != 0.0, axis=-1)[..., None]
    led = np.take_along_axis(falling, (np.arange(count) + first) % count, axis=-1)
    with np.errstate(all="ignore"):  # a part that is 0 has no roots
        monic = np.nan_to_num(led / led[..., :1], posinf=0.0, neginf=0.0)
        roots = np.linalg.eigvals(companion_matrix(monic))
        angle, distance = np.angle(roots), np.abs(np.log(np.abs(roots)))
    is_one = (angle > real) & (angle < np.pi - real) & (distance < farthest)
    places = np.stack([angle, np.maximum(distance, narrowest)], axis=-1)
    return np.where(is_one[..., None], places, _NO_ROOT)
