"""Lines of the boundary whose root is known: the polynomial that is left, by products."""

import flint
import numpy as np
import pytest

from jaxstab.exact.boundary import _without
from jaxstab.model.balls import Factored

DIVISORS = [
    Factored(flint.arb_poly([1]), at_one=1),
    Factored(flint.arb_poly([1]), at_minus_one=1),
    Factored(flint.arb_poly([1.0, -1.25, 1.0])),
]


@pytest.mark.parametrize("at_one", [0, 1, 2])
@pytest.mark.parametrize("at_minus_one", [0, 1])
@pytest.mark.parametrize("windows", [(), (4,)])
@pytest.mark.parametrize("divisor", DIVISORS, ids=["z - 1", "z + 1", "pair"])
@pytest.mark.parametrize("is_known", [True, False])
def test_a_part_without_its_root_times_the_root_is_the_part(
    at_one: int, at_minus_one: int, windows: tuple[int, ...], divisor: Factored, is_known: bool
) -> None:
    """The divisor is counted among the structure, or hidden in the coefficients."""
    rest = flint.arb_poly([0.5, -2.0, 3.0, 1.0])
    quotient = Factored(rest, 1, at_one, at_minus_one, windows)
    product = quotient.times(divisor)
    if not is_known:
        product = Factored(quotient.rest * divisor.polynomial(), *quotient[1:])
    found = [float(c.mid()) for c in _without(product, divisor).polynomial().coeffs()]
    truth = [float(c.mid()) for c in quotient.polynomial().coeffs()]
    np.testing.assert_allclose(found, truth, rtol=1e-12, atol=1e-12)
