"""Limits of alpha in a tile, cell of delays by cell of delays, in float32 that claims no more."""

import numpy as np
from jaxtyping import Float32

from jaxstab.atlas.compute.plan import Plan, Tile
from jaxstab.atlas.format.schema import ALPHA_LIMITS
from jaxstab.atlas.format.single import in_float32
from jaxstab.proofs.columns import stable_columns
from jaxstab.proofs.enclosures import Domain
from jaxstab.proofs.plant import HandBoxes


def alpha_limits(plan: Plan, tile: Tile, hands: HandBoxes) -> Float32[np.ndarray, "*shape"]:
    """Return the limits of alpha in a tile, of the shape ``plan.shape``.

    Args:
        plan: of the atlas.
        tile: of the plan.
        hands: the boxes of hands that begin in the tile.
    """
    shape = plan.shape(ALPHA_LIMITS, tile)
    limits = np.zeros((shape[0], hands.gamma.size, *shape[3:]), np.float32)
    for number, cell in enumerate(plan.numbers("delay_cell", tile) if limits.size else ()):
        early, late, *walls = plan.grid.limit_range[cell].tolist()
        domain = Domain((walls[0], walls[1]), (walls[2], walls[3]))
        edges = np.linspace(*domain.beta, plan.grid.limit_cells + 1)
        middle = 0.5 * (early + late)
        half = np.nextafter(max(middle - early, late - middle), np.inf) if late > early else 0.0
        columns = stable_columns(edges, hands, middle, domain, plan.spec.filters, float(half))
        beta = max(map(abs, domain.beta))
        hand = plan.grid.gamma[-1], plan.grid.delta[-1]
        limits[:, :, number] = np.concatenate(
            [in_float32(terms, (beta, *hand, late)) for terms in columns], axis=-1
        ).swapaxes(0, 1)
    return limits.reshape(shape)
