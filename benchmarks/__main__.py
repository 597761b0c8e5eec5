"""The one entry: `python -m benchmarks [name] [--small]`."""

import argparse
import subprocess
import sys
from importlib import import_module
from pathlib import Path

from benchmarks import record

BENCHMARKS = ("boundary", "queries", "throughput", "scaling")


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument(
        "name",
        nargs="?",
        choices=[*BENCHMARKS, "plot"],
        help="what to measure, or plot: draw all records and print the README's table; "
        "all benchmarks, each in a process of its own, without a name",
    )
    parser.add_argument("--small", action="store_true", help="the smallest sizes, in seconds")
    parser.add_argument("--billion", action="store_true", help="scaling goes on to 1e9 points")
    parser.add_argument(
        "--out", type=Path, default=record.RESULTS, help="folder of the records and plots"
    )
    choice = parser.parse_args()
    if choice.name is None:
        return _run_each(sys.argv[1:])
    if choice.name == "plot":
        import_module("benchmarks.plots").draw_all(
            choice.out / "small" if choice.small else choice.out
        )
        return 0
    options = {"billion": True} if choice.billion and choice.name == "scaling" else {}
    rows = import_module(f"benchmarks.{choice.name}").rows(choice.small, **options)
    made = record.new_record(choice.name, choice.small, rows)
    print(record.write(made, choice.out))
    return 0


def _run_each(options: list[str]) -> int:
    """Run every benchmark in a process of its own: memory of one is not counted for the next."""
    codes = [
        subprocess.run([sys.executable, "-m", "benchmarks", name, *options], check=False).returncode
        for name in BENCHMARKS
    ]
    return max(codes)


if __name__ == "__main__":
    sys.exit(main())
