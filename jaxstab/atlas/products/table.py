"""The products that an atlas may hold, in the order of the file."""

from jaxstab.atlas.product import Product
from jaxstab.atlas.products.fields import Fields
from jaxstab.atlas.products.limits import Limits
from jaxstab.atlas.products.slices import Outlines, Summaries
from jaxstab.atlas.products.verdicts import Verdicts

PRODUCTS: dict[str, Product] = {
    product.name: product for product in (Verdicts(), Limits(), Fields(), Outlines(), Summaries())
}
