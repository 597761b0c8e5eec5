"""Limits and outlines of many loops: by batches (``loop.many``), under JAX by ``loop.implicit``."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from jaxstab.arrays import Array, is_any_traced
from jaxstab.loop.many import ManyRegions, computed, given_loops
from jaxstab.loop.region import Limits

if TYPE_CHECKING:
    from jaxstab.loop.affine import Loop
    from jaxstab.loop.loop import HapticLoop


def limits_of(
    loops: "Sequence[HapticLoop] | Sequence[Loop] | HapticLoop", **fields: Any
) -> Limits[Array]:
    """Return the largest stiffness and the largest damping that each of many loops allows.

    Give a list of loops, or one whose fields are arrays that broadcast; or a list of ``Loop``, of
    any two gains each.

    The answers are those of ``HapticLoop.limits`` to 1e-9, without islands. Batches of at least 400
    loops of about the same degree (200 above degree 25, 100 above 41) are computed by one program
    of JAX, in float64 whatever its flag says, and first compiled in 10 to 20 s
    (``use_compilation_cache`` keeps that). Loops that it does not resolve, and those of smaller
    batches, are answered one by one.

    Where JAX traces loops or fields, the answers are arrays of JAX, differentiable once: by all
    numbers of loops of one mass and their filters, by the implicit function theorem. Inside jit,
    512 or more loops of one delay, estimator and filter, none of them traced, are computed by the
    program of a batch as part of the caller's; those that it cannot resolve are UNRESOLVED. All
    others are searched one by one there, by a callback.

    A batch has tests in place of the proved lines of a single region: what none of them would
    notice is a stable set that is cut or dented between two of the 148 to 1,348 angles of its scan.
    Of 9,200 loops drawn to be hard (strongly damped hands, windows to 20, filters, delays to 12
    samples) and 36,000 random ones (modes too, delays to 30) none was wrong.

    Args:
        loops: any number of loops, of any estimators, filters, devices and delays. Batches of loops
            with the same estimator and filter are the fastest.
        **fields: beside one loop, fields of ``HapticLoop`` that replace its own, as arrays or
            lists that broadcast with the others: numbers, estimators or devices.

    Returns:
        Limits of arrays in the order of the loops, or of the shape of the fields; those of loops of
        different gains are ``first`` and ``second`` alone. Admittances that differ in T and Ke
        alone, or in a spring in proportion to Ke, are computed once.

    Raises:
        TypeError: this is no list, or an item is no HapticLoop; a field is unknown, or beside a
            list; JAX traces a loop whose device is not one mass.
        ValueError: as ``HapticLoop.region``, for any of the loops.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) by the D-decomposition.

    Example:
        >>> loops = [
        ...     jaxstab.HapticLoop(device_mass=mass, device_damping=0.1, sample_time=1e-3)
        ...     for mass in (0.1, 0.2)
        ... ]
        >>> jaxstab.limits_of(loops).stiffness.round().tolist()
        [68763.0, 137392.0]
        >>> delays = np.array([[0.0], [1e-3]])
        >>> loop = jaxstab.HapticLoop(
        ...     device_mass=[0.1, 0.2], device_damping=0.1, sample_time=1e-3, delay=delays
        ... )
        >>> jaxstab.limits_of(loop).stiffness.round()
        array([[ 68763., 137392.],
               [ 14498.,  28945.]])
    """
    return _answered(loops, fields, outlines=False).limits


def regions_of(
    loops: "Sequence[HapticLoop] | Sequence[Loop] | HapticLoop", **fields: Any
) -> ManyRegions:
    """Return outlines and areas of the stable regions of many loops.

    They are those of ``HapticLoop.region().main``, computed as ``limits_of`` computes limits; see
    there for the batches, what they cost, and what their tests do not notice. Areas agree to 1e-6.

    Where JAX traces loops or fields, the answers are differentiable once, as those of ``limits_of``
    are. A vertex at a corner moves with that corner. Any other vertex moves at a right angle to the
    boundary, in units of alpha and beta: how it moves along the boundary changes no region. All is
    NaN there for a region with holes.

    Args and Raises: as ``limits_of``.

    Returns:
        ManyRegions in the order of the loops, or of the shape of the fields.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) by the D-decomposition.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=0.1, sample_time=1e-3)
        >>> regions = jaxstab.regions_of(loop, device_mass=[0.1, 0.2])
        >>> stiffness, damping = regions.outline[1].T
        >>> round(float(stiffness.max() / regions.limits.stiffness[1]), 9)
        1.0
    """
    return _answered(loops, fields, outlines=True)


def _answered(loops: Any, fields: dict[str, Any], *, outlines: bool) -> ManyRegions:
    many, fields, shape = given_loops(loops, fields)
    if is_any_traced(many, fields):
        from jaxstab.loop.implicit import moved  # which imports JAX

        return moved(many, fields, shape, outlines=outlines)
    return computed(many, fields, shape, outlines=outlines)
