"""Records: what was measured, on which machine, with which versions, as JSON."""

import json
import os
import platform
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

import jaxstab

Row = dict[str, Any]
Record = dict[str, Any]

RESULTS = Path(__file__).parent / "results"
PACKAGES = (
    *("jax", "jaxlib", "numpy", "scipy", "optimistix", "contourpy", "control", "h5py"),
    *("python-flint", "mpmath"),
)
_OF_ALL = 9  # columns that every row has; those of a benchmark's own come after


def row(
    section: str,
    method: str,
    seconds: Sequence[float],
    error: float,
    error_measure: str,
    *,
    delay: float = 0.0,
    points: int = 1,
    **own: Any,
) -> Row:
    """Return a row; rows of one section are rivals.

    Args:
        section: a group of rows.
        method: who answers.
        seconds: of each repeat of one call.
        error: as ``error_measure`` says in words.
        error_measure: these words.
        delay: of the loop, in samples.
        points: how many points one call answers or finds.
        own: columns of the benchmark's own, which are numbers, texts or null.
    """
    low, middle, high = np.quantile(seconds, (0.25, 0.5, 0.75)).tolist()
    return {
        "section": section,
        "method": method,
        "delay": delay,
        "points": points,
        "seconds": middle,
        "seconds_quartiles": [low, high],
        "repeats": len(seconds),
        "error": error,
        "error_measure": error_measure,
        **own,
    }


def shown(rows: Iterable[Row]) -> Iterator[Row]:
    """Show each row on a line as it comes."""
    for row in rows:
        print(line(row), flush=True)
        yield row


def new_record(benchmark: str, small: bool, rows: Iterable[Row]) -> Record:
    """Return a record of rows, of this machine and this day."""
    return {
        "benchmark": benchmark,
        "small": small,
        "date": datetime.now(UTC).date().isoformat(),
        "machine": machine(),
        "versions": versions(),
        "rows": list(rows),
    }


def path_of(record: Record, folder: Path) -> Path:
    """Return the file of a record; those of small runs lie apart."""
    folder = folder / "small" if record["small"] else folder
    return folder / f"{record['benchmark']}-{record['machine']['name']}.json"


def write(record: Record, folder: Path) -> Path:
    path = path_of(record, folder)
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(record, indent=1, allow_nan=False) + "\n"
    part = path.with_suffix(".part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)  # a record that is written again is whole at any time
    return path


def read(path: Path) -> Record:
    record: Record = json.loads(path.read_text(encoding="utf-8"))
    return record


def read_all(folder: Path) -> list[Record]:
    """Return the records of a folder by the names of their files."""
    records = [read(path) for path in sorted(folder.glob("*.json"))]
    if not records:
        raise SystemExit(f"{folder} holds no records; run `python -m benchmarks` first.")
    return records


def comparison(record: Record, before: Record | None) -> Iterator[str]:
    """Say how long rows take beside those of an earlier record of the same machine."""
    name, versions = record["machine"]["name"], record["versions"]
    if before is None:
        yield f"no record of this machine ({name}): these times are compared with nothing."
        return
    yield (
        f"times over those of {before['date']} on this machine ({name}), with jax "
        f"{versions['jax']} now and {before['versions']['jax']} then:"
    )
    seconds = {_key(row): row["seconds"] for row in before["rows"]}
    for row in record["rows"]:
        if _key(row) in seconds:
            ratio = row["seconds"] / seconds[_key(row)]
            yield f"{row['section']:10} {row['method']:26} delay {row['delay']:<4g} {ratio:8.2f}"


def _key(row: Row) -> tuple[Any, ...]:
    return row["section"], row["method"], row["delay"], row["points"]


def line(row: Row) -> str:
    """Return a row in words: time and error side by side."""
    own = (f"{k}={_short(v)}" for k, v in list(row.items())[_OF_ALL:])
    return (
        f"{row['section']:10} {row['method']:26} delay {row['delay']:<4g} "
        f"{row['points']:>10} points  {row['seconds'] * 1e3:12.4g} ms  "
        f"error {row['error']:9.2e}  {' '.join(own)}"
    )


def machine() -> dict[str, Any]:
    """All that a run time depends on; no name of a host."""
    import jax  # last of all: the flags of a benchmark are set when it starts

    cpu = _cpu_model()
    device = jax.devices()[0]
    accelerator = None if device.platform == "cpu" else device.device_kind
    name = accelerator or f"{cpu} {os.cpu_count()} cores"
    return {
        "name": re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-"),
        "cpu": cpu,
        "cores": os.cpu_count(),
        "memory_gib": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1),
        "system": f"{platform.system()} {platform.machine()}",
        "accelerator": accelerator,
    }


def versions() -> dict[str, str]:
    """Those of what a run may use and is installed."""
    found = {"python": platform.python_version(), "jaxstab": jaxstab.__version__}
    for name in PACKAGES:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


def _cpu_model() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        models = re.findall(r"model name\s*: (.+)", info.read_text(encoding="utf-8"))
        if models:
            return re.sub(r"\s*(\((R|TM)\)|CPU|@.*)", "", models[0]).strip()
    return platform.processor() or platform.machine()


def _short(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
