"""The one entry: `python -m benchmarks [name] [--small]`."""

import argparse
import os
import subprocess
import sys
from collections.abc import Iterable
from functools import partial
from importlib import import_module
from inspect import signature
from pathlib import Path

from benchmarks import record, table
from benchmarks.record import Row

BENCHMARKS = (
    "latency", "boundary", "regions", "answers", "resolution", "throughput", "accelerator",
    "scaling", "ranges", "loops", "many", "mapper", "exact", "polynomials", "rivals", "stress",
    "measured",
)  # fmt: skip
OF_THE_EXTRA = {"control", "mpmath", "mujoco"}  # truths and rivals, in the extra `test`


def main() -> int:
    os.environ.setdefault("JAX_ENABLE_X64", "1")  # of this process and of all that it starts
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # batches of eigenvalues have threads of jax
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument(
        "name",
        nargs="?",
        choices=[*BENCHMARKS, "jitter", "plot", "table"],
        help="what to measure, or plot: draw records and put their tables into the pages, "
        "or table: print that table, "
        "or jitter: attack proofs for delays that move; "
        "without a name all benchmarks",
    )
    parser.add_argument("--small", action="store_true", help="the smallest sizes, in seconds")
    parser.add_argument("--billion", action="store_true", help="scaling goes on to 1e9 points")
    parser.add_argument("--points", type=int, help="how many loops stress judges, or others")
    parser.add_argument(
        "--out", type=Path, default=record.RESULTS, help="folder of the records and plots"
    )
    choice = parser.parse_args()
    folder = choice.out / "small" if choice.small else choice.out
    if choice.name == "jitter":
        return import_module("benchmarks.jitter").main(choice.small, choice.points, choice.out)
    if choice.name == "table":
        print(table.markdown(record.read_all(folder)))
        return 0
    if choice.name == "plot":
        import_module("benchmarks.plots").draw_all(folder)
        if folder == record.RESULTS:
            table.put_into_pages(record.read_all(folder))
        return 0
    if choice.name is None and not choice.small:
        return _each_in_its_process(sys.argv[1:])
    for name in [choice.name] if choice.name else BENCHMARKS:
        try:
            _measure(name, choice)
        except ModuleNotFoundError as error:
            if error.name not in OF_THE_EXTRA:
                raise
            sys.exit(
                f"`python -m benchmarks {name}` needs {error.name}, which is not installed; "
                "run `python -m pip install '.[test]'` first."
            )
    return 0


def _measure(name: str, choice: argparse.Namespace) -> None:
    keep = partial(_keep, name, choice.small, choice.out)
    rows_of = import_module(f"benchmarks.{name}").rows
    given = {"billion": choice.billion, "points": choice.points, "keep": keep}
    options = {k: v for k, v in given.items() if v and k in signature(rows_of).parameters}
    own = {"benchmark": name, "small": choice.small, "machine": record.machine()}
    path = record.path_of(own, choice.out)
    before = record.read(path) if path.exists() else None
    kept = keep(record.shown(rows_of(choice.small, **options)))
    print(*record.comparison(record.read(kept), before), kept, sep="\n")


def _keep(name: str, small: bool, folder: Path, rows: Iterable[Row]) -> Path:
    return record.write(record.new_record(name, small, rows), folder)


def _each_in_its_process(options: list[str]) -> int:
    """Run the benchmarks one after the other: none inherits the memory of those before."""
    commands = [[sys.executable, "-m", "benchmarks", name, *options] for name in BENCHMARKS]
    return max(subprocess.run(command, check=False).returncode for command in commands)


if __name__ == "__main__":
    sys.exit(main())
