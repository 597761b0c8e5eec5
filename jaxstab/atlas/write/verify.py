"""Check an atlas file: that it is whole, as the schema says, and right at a sample of points.

One slice is in memory at a time, however large the atlas is. Each product compares a sample of what
its contents with a new computation (``Product.checks``); half of the sample of verdicts is next to
where the verdict changes, where a wrong one would be. At the end the atlas is opened and queried at
random points, as its users do.
"""

from collections.abc import Iterator
from os import PathLike
from pathlib import Path

import numpy as np

from jaxstab.atlas.atlas import Atlas, open_atlas
from jaxstab.atlas.file import TooLargeError, table_of
from jaxstab.atlas.products.product import Check, Stored
from jaxstab.atlas.products.table import PRODUCTS
from jaxstab.atlas.products.verdicts import wrong_codes
from jaxstab.atlas.schema import content_digest, digest_of
from jaxstab.atlas.spec import filters_of
from jaxstab.atlas.variables import SPEC
from jaxstab.atlas.write.variables import checked_datasets, opened, text_of
from jaxstab.conventions import AXES, Verdict
from jaxstab.model import by_name
from jaxstab.model.filters import as_keywords


def verify_atlas(path: str | PathLike[str], sample: int = 1000, seed: int = 0) -> Iterator[Check]:
    """Yield one check after the other; the first that fails may be the last.

    About ``sample`` nodes, and as many points in cells, are computed again, by ``jaxstab.verdict``
    with resolve="exact" and ``jaxstab.spectral_radius``; of outlines and summaries those of at most
    16 slices. OSError: the file is missing or unreadable.
    """
    chance = np.random.default_rng(seed)
    path = Path(path)
    try:
        table = table_of(path)
        yield Check("file", True, "whole by its SHA-256, of this version of the schema")
        with opened(path) as file:
            datasets = checked_datasets(file, table)
            yield Check("schema", True, f"{len(datasets)} variables as it says")
            digest = content_digest(digest_of(*pair) for pair in datasets.items())
            said = text_of(file, "content_sha256")
            is_right = said == table.content_digest == digest
            yield Check("content", is_right, f"its digest is {digest}")
            filters = as_keywords(filters_of(b"\n".join(datasets[SPEC][()]).decode()))
            axes = {name: datasets[name][()] for name in AXES}
            stored = Stored({**datasets, **axes}, filters, sample, chance)
            for product in PRODUCTS.values():
                if product.names[0] in datasets:
                    yield from product.checks(stored)
        atlas = open_atlas(path)
        for name in atlas.products:
            yield from PRODUCTS[name].checks_of_answers(atlas, sample, chance)
        yield _answers(atlas, sample, chance)
    except TooLargeError:
        return
    except ValueError as error:
        yield Check("file", False, str(error))


def _answers(atlas: Atlas, sample: int, chance: np.random.Generator) -> Check:
    """Ask the atlas about random points of each delay, as its users do."""
    each, wrong = -(-sample // atlas.delays.size), 0
    filters = as_keywords(atlas.filters)
    for number, delay in enumerate(atlas.delays):
        ends = [(nodes[0], nodes[-1]) for nodes in atlas.nodes(number).values()]
        point = (*(chance.uniform(*side, each) for side in ends), delay)
        answer = atlas.query(**by_name(*point))
        codes = np.where(
            answer.verdict == Verdict.NOT_COMPUTED, np.int8(Verdict.UNDECIDED), answer.verdict
        )
        wrong += wrong_codes(codes, point, filters)
    points = each * atlas.delays.size
    return Check("answers", wrong == 0, f"{wrong} of {points} points are wrong")
