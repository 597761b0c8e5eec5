"""One object answers for each product of an atlas: a new one is a class and a line of a table."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from jaxstab.atlas.plan import Plan, compute_tile, extents_of, plan_atlas
from jaxstab.atlas.products.limits import upper_errors
from jaxstab.atlas.products.table import PRODUCTS
from jaxstab.atlas.schema import VARIABLES
from jaxstab.atlas.spec import AtlasSpec

# A product that jaxstab does not have: the largest stable beta of each slice.
NEW_PRODUCT = """
import sys
import numpy as np
from jaxstab.atlas import product
from jaxstab.atlas.product import SLICE, Variable
from jaxstab.atlas.products import table


class EndOfBeta(product.Product):
    name = "end_of_beta"
    variables = (Variable(name, "float64", SLICE, "largest stable beta", "closed form", 0.0),)

    def compute(self, plan, tile):
        from jaxstab import stable_region

        delay = plan.grid.walls(tile.delay)[2]
        values = [
            stable_region(gamma=gamma, delta=delta, delay=delay).max_beta[1]
            for gamma, delta in plan.hands(tile).tolist()
        ]
        return {self.name: np.array(values, float).reshape(plan.shape(self.name, tile))}

    def checks(self, stored):
        values = stored.datasets[self.name][()]
        yield product.Check(self.name, bool(np.all(values > 0.0)), "positive")


table.PRODUCTS[EndOfBeta.name] = EndOfBeta()
import jaxstab
from jaxstab.atlas.write.resolution import estimate_build
from jaxstab.atlas.write.build import verify_atlas

spec = jaxstab.AtlasSpec(gamma=[0.0], delta=[0.0, 0.01], delay=[0.0], products=[EndOfBeta.name])
plan = jaxstab.plan_atlas(spec)
assert "2 slices" in str(plan)
assert estimate_build(plan).size > 0.0
atlas = jaxstab.build_atlas(spec, sys.argv[1])
assert atlas.products == (EndOfBeta.name,)
checks = list(verify_atlas(sys.argv[1]))
assert all(check.passed for check in checks)
assert EndOfBeta.name in [check.name for check in checks]
print(float(atlas.arrays[EndOfBeta.name][0, 0, 0]))
"""


def test_a_new_product_is_a_class_and_a_line_of_the_table(tmp_path: Path) -> None:
    """Specified, planned, built, read and verified; without a hand and a delay, beta ends at 2."""
    words = [sys.executable, "-c", NEW_PRODUCT, str(tmp_path / "a.h5")]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) == pytest.approx(2.0, rel=1e-9)


@pytest.mark.parametrize("name", list(PRODUCTS))
def test_a_part_of_a_product_is_what_its_variables_say(name: str) -> None:
    product = PRODUCTS[name]
    spec = AtlasSpec(gamma=[0.0, 1e-3], delta=[0.0, 0.015], delay=[1.0, 2.0], products=[name])
    plan = plan_atlas(spec)
    grid = product.small_grid(plan.grid, np.array([0.5, 0.5, 0.5, 0.5]))
    part = Plan(spec, grid)
    arrays = compute_tile(part, part.tiles[0])
    axes = {variable.name for variable in product.variables if variable.is_axis}
    assert set(arrays) == set(product.names) - set(product.fixed) - axes
    for key, values in arrays.items():
        variable = VARIABLES[key]
        assert values.dtype == variable.dtype
        assert product.are_values(key, values)
        known = values[~np.isnan(values)] if variable.has_nan else values
        assert np.all((known >= variable.lowest) & (known <= variable.highest))
    if name == "alpha_limits":
        errors = upper_errors(grid, arrays[name], extents_of(spec), np.random.default_rng(1))
        assert 0.0 <= np.median(errors) < 0.2  # one wide box of hands
        assert np.all(errors >= 0.0)
