"""Questions about many points, answered part by part. NumPy alone."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

_PART = 2**16  # points: enough for what a call of NumPy costs, and few for the memory


def in_parts(
    answers: Callable[..., Sequence[Array]], points: Sequence[Array], *dtypes: type
) -> list[Array]:
    """Return what a function answers for points of any broadcast shape.

    Args:
        answers: takes as many arrays of one length as there are in ``points``, as float64, and
            returns an array for each of ``dtypes``.
        points: real numbers; what is not float64 is converted, and what is broadcast is repeated,
            part by part as well.
        dtypes: of the answers.
    """
    asked = len(points)
    operands: Any = [*points, *(None for _ in dtypes)]
    uses: Any = [["readonly"] for _ in points] + [["writeonly", "allocate"] for _ in dtypes]
    with np.nditer(
        operands,
        flags=["external_loop", "buffered", "zerosize_ok"],
        op_flags=uses,
        op_dtypes=[*(np.float64 for _ in points), *dtypes],
        order="C",
        casting="same_kind",
        buffersize=_PART,
    ) as parts:
        for part in parts:
            for place, values in zip(part[asked:], answers(*part[:asked]), strict=True):
                place[...] = values
        return list(parts.operands[asked:])
