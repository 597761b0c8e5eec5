"""What the campaigns counted: a line of JSON for each in the file that JAXSTAB_COUNTS names.

``python tests/counts.py FILE`` prints the latest of each kind as rows for the README's table.
"""

import json
import os
import sys
from pathlib import Path


def note(kind: str, **counts: int) -> None:
    """Write down what a campaign counted, where that is wanted."""
    if "JAXSTAB_COUNTS" in os.environ:
        with Path(os.environ["JAXSTAB_COUNTS"]).open("a", encoding="utf-8") as file:
            file.write(json.dumps({"kind": kind, **counts}) + "\n")


def rows(lines: list[str]) -> list[str]:
    """The latest counts of each kind, as rows of Markdown."""
    latest = {noted.pop("kind"): noted for noted in map(json.loads, lines)}
    return [
        f"| {kind} | {', '.join(f'{count:,} {what}' for what, count in counts.items())} |"
        for kind, counts in latest.items()
    ]


if __name__ == "__main__":
    noted = Path(sys.argv[1]).read_text(encoding="utf-8").splitlines()
    sys.stdout.write("\n".join(rows(noted)) + "\n")
