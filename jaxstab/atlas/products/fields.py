"""Dense fields at all nodes: spectral radius, frequency and damping ratio, poles outside.

These are plain arrays over the five axes, for pictures and for programs that know nothing of
jaxstab; ``point.fields`` computes them. A node is *near* if it is stable, or a corner of a cell in
the plane of alpha and beta that has a stable corner: so contours at the boundary can be drawn. With
``where = "near"`` in the specification the other nodes have NaN in place of radius, frequency and
damping ratio, which makes a file smaller; ``outside`` is given everywhere. The file says how many
nodes are left out, in its attribute ``fields``.
"""

from collections.abc import Iterator, Mapping
from math import inf, pi, prod
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxstab.atlas.product import NODE, SLICE, Array, Check, Inspection, Product, Variable

if TYPE_CHECKING:
    from jaxstab.atlas.plan import Plan, Tile

FIELDS = "fields"
RADIUS_FIELD, RADIUS_ERROR = "spectral_radius", "spectral_radius_error"
FREQUENCY, DAMPING_RATIO, OUTSIDE = "frequency", "damping_ratio", "outside"
NEAR_NODES = "near_nodes"
_LEFT_OUT = "NaN: left out (see the attribute fields of the file)"
_NOT_RESOLVED = "NaN also where two poles or pairs have nearly the same modulus"


def _field(name: str, long_name: str, words: str, low: float, high: float, **said: str) -> Variable:
    shown = tuple(said.items())
    return Variable(name, "float32", NODE, long_name, words, low, high, True, attributes=shown)


_VARIABLES = (
    _field(
        RADIUS_FIELD,
        "spectral radius, the largest modulus of a closed-loop pole",
        f"rounded up: no pole is outside of this radius; {_LEFT_OUT}",
        *(0.0, inf),
        standard_name=RADIUS_FIELD,
        ancillary_variables=RADIUS_ERROR,
    ),
    _field(
        RADIUS_ERROR,
        "proved bound of the error of the spectral radius",
        "the true radius lies between spectral_radius less this and spectral_radius; infinite: "
        f"none is proved; {_LEFT_OUT}",
        *(0.0, inf),
        standard_name=f"{RADIUS_FIELD} standard_error",
    ),
    _field(
        FREQUENCY,
        "frequency of the dominant pole z = exp(s)",
        "|Im s| in rad per sample, within 1e-6: 0 for a positive real pole, pi for a negative one; "
        f"{_LEFT_OUT}. {_NOT_RESOLVED}",
        *(0.0, float(np.float32(pi))),
        units="rad",
    ),
    _field(
        DAMPING_RATIO,
        "damping ratio of the dominant pole z = exp(s)",
        "-Re s / |s|, within 1e-6: 1 and -1 for positive real poles inside and outside of the unit "
        f"circle; {_LEFT_OUT}. {_NOT_RESOLVED}",
        *(-1.0, 1.0),
    ),
    Variable(
        OUTSIDE,
        "int16",
        NODE,
        "number of poles outside of the unit circle",
        "proved; 0 is stable, -1: a pole is too close to the circle to tell",
        -1,
    ),
    Variable(
        NEAR_NODES,
        "int32",
        SLICE,
        "number of nodes with a spectral radius",
        "the other nodes of the slice were left out",
        0,
    ),
)


class Fields(Product):
    """Spectral radius, dominant pole and number of poles outside, at nodes."""

    name = FIELDS
    variables = _VARIABLES
    gridded = (RADIUS_FIELD,)
    unit = NODE

    def compute(self, plan: "Plan", tile: "Tile") -> dict[str, Array]:
        from jaxstab.point.fields import fields_of_grid

        alpha, beta, delay = plan.grid.walls(tile.delay)
        gamma, delta = plan.hands(tile).T
        spec, longest = plan.spec, float(plan.grid.delay[-1])
        fields = fields_of_grid(
            alpha, beta, gamma, delta, delay, spec.filters, longest=longest, method=spec.method
        )
        near = np.full(fields.outside.shape, spec.where == "all")
        if spec.where == "near":
            # Where a pole is on the circle, or too close to it to tell, the radius decides.
            least = fields.radius - fields.error
            near = _near((fields.outside == 0) | ((fields.outside < 0) & (least <= 1.0)))
        for values in fields[:-1]:
            np.copyto(values, np.nan, where=~near)
        count = np.sum(near, axis=(0, 1), dtype=np.int32)
        arrays = zip(self.names, (*fields, count), strict=True)
        return {name: value.reshape(plan.shape(name, tile)) for name, value in arrays}

    def attributes(self, datasets: Mapping[str, Any]) -> dict[str, Any]:
        """Return the share of nodes with fields, and what draws them in viewers of NeXus files."""
        near, nodes = int(datasets[NEAR_NODES][()].sum()), prod(datasets[OUTSIDE].shape)
        return {
            "fields": f"spectral radii at {near} of {nodes} nodes; {nodes - near} are left out, "
            "more than one cell outside of the stable set",
            "NX_class": "NXdata",
            "signal": RADIUS_FIELD,
            "axes": np.array(NODE, "S"),
            "auxiliary_signals": np.array([FREQUENCY, DAMPING_RATIO, OUTSIDE], "S"),
        }

    def checks(self, stored: Inspection) -> Iterator[Check]:
        """Compare nodes with eigenvalues of the companion matrix."""
        places = stored.places(stored.datasets[OUTSIDE].shape[2:])
        each, wrong = -(-stored.sample // len(places)), 0
        for place in places:
            here = (slice(None), slice(None), *place)
            fields = {name: stored.datasets[name][here] for name in self.names[:-1]}
            wrong += _wrong_nodes(stored, place, fields, each)
            near = np.sum(~np.isnan(fields[RADIUS_ERROR]))
            wrong += int(near != stored.datasets[NEAR_NODES][tuple(place)])
        yield Check(FIELDS, wrong == 0, f"{wrong} of {each * len(places)} points are wrong")


def _near(stable: Array) -> Array:
    """Return which nodes are corners of cells along the first two axes with a stable corner."""
    near = stable.copy()
    for axis in (0, 1):
        along = near.swapaxes(0, axis)
        before = along.copy("K")
        along[1:] |= before[:-1]
        along[:-1] |= before[1:]
    return near


_NEAR_CIRCLE, _SAME, _APART = 1e-6, 2e-6, 1e-5  # of poles from the circle, of modes, of two moduli


def _wrong_nodes(stored: Inspection, place: Any, fields: Mapping[str, Array], count: int) -> int:
    """Count nodes of a slice, of ``count`` at random, that differ from a new computation."""
    from jaxstab.model import by_name
    from jaxstab.motion import dominant_mode
    from jaxstab.point import closed_loop_poles, spectral_radius

    i, j = (stored.chance.integers(0, n, count) for n in fields[OUTSIDE].shape)
    alpha, beta = (stored.datasets[name][:, place[-1]] for name in ("alpha", "beta"))
    point = by_name(alpha[i], beta[j], *stored.loop(place))
    radius = spectral_radius(**point, method="companion", **stored.filters)
    poles = np.asarray(closed_loop_poles(**point, **stored.filters))
    given = {name: values[i, j].astype(np.float64) for name, values in fields.items()}
    upper, error = given[RADIUS_FIELD], given[RADIUS_ERROR]
    is_within = radius.value - radius.error <= upper
    is_within &= np.isinf(error) | (radius.value + radius.error >= upper - error)
    off = ~(np.isnan(upper) | is_within)  # NaN in the new computation is wrong, too
    moduli = np.abs(poles)
    off |= (given[OUTSIDE] == 0) & np.isnan(error) | np.isnan(upper) & np.isfinite(error)
    counted = (np.min(np.abs(moduli - 1.0), axis=-1) > _NEAR_CIRCLE) & (given[OUTSIDE] >= 0)
    off |= counted & (np.sum(moduli > 1.0, axis=-1) != given[OUTSIDE])
    # Eigenvalues tell the dominant pole, and its frequency, where it is simple.
    others = np.min(np.abs(poles[:, :1] - poles[:, 1:]), axis=-1)
    rival = np.where(poles[:, 0].imag == 0.0, moduli[:, 1], moduli[:, 2])
    simple = (moduli[:, 0] - rival > _APART) & (others > _APART**0.5)
    mode = dominant_mode(**point, **stored.filters)
    for name, value in ((FREQUENCY, mode.frequency), (DAMPING_RATIO, mode.damping_ratio)):
        off |= simple & (np.abs(value - given[name]) > _SAME)
    return int(np.sum(off))
