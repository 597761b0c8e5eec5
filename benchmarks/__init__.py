"""Run time beside error: `python -m benchmarks [name] [--small]`.

Every benchmark is a module with a generator ``rows(small)``. Rivals run in one process, warm and in
turns, on data that are passed as arguments; a row of a record holds a time and an error together.
The errors are measured by ``exact``, which shares no code with jaxstab.
"""

import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # jax threads its batches of eigenvalues itself
sys.path.append(str(Path(__file__).parents[1] / "tests"))  # what judges the tests judges here, too

import jax

jax.config.update("jax_enable_x64", True)
