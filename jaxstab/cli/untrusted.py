"""Files from strangers: a published digest is compared first, and a child process reads them.

``python -m jaxstab.cli.untrusted ARGUMENTS`` runs a command with limits on memory and time.
"""

import hashlib
import subprocess
import sys
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any

import click

from jaxstab.durable import named_errors

_OPTION = "--untrusted"
_MEMORY = 4 * 2**30  # bytes of addresses
_SECONDS = 300


def careful(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of a command that reads a file of a stranger, its argument ``file``."""

    @click.option(_OPTION, is_flag=True, help="Read the file in a process with limits.")
    @click.option("--expect-sha256", help="Refuse a file with another SHA-256.")
    @wraps(command)
    def careful_command(
        untrusted: bool, expect_sha256: str | None, file: Path, **options: Any
    ) -> Any:
        if untrusted:
            sys.exit(_in_a_child(file))
        if expect_sha256 is not None:
            _check_digest(file, expect_sha256)
        return command(file=file, **options)

    return careful_command


def _check_digest(file: Path, expected: str) -> None:
    with named_errors("read", file), file.open("rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
    if digest != expected.strip().lower():
        raise ValueError(f"{file} has the SHA-256 {digest}, not the expected one; do not use it.")


def _in_a_child(file: Path) -> int:
    """Run this command in another process, and return its exit code."""
    arguments = [argument for argument in sys.argv[1:] if argument != _OPTION]
    words = [sys.executable, "-P", "-m", __name__, *arguments]  # -P: nothing from this folder
    try:
        code = subprocess.run(words, timeout=2 * _SECONDS).returncode
    except subprocess.TimeoutExpired as error:
        raise ValueError(f"{file} takes longer than {2 * _SECONDS} s; do not use it.") from error
    if code < 0:
        raise ValueError(f"{file} ended the process that read it (signal {-code}); do not use it.")
    return code


def main() -> None:
    """Run a command with limits on memory and time."""
    from jaxstab.cli.main import main as run

    if sys.platform == "win32":
        raise click.UsageError(f"{_OPTION} needs the limits of POSIX systems.")
    import resource

    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (_SECONDS, _SECONDS))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    run(prog_name="jaxstab")


if __name__ == "__main__":
    main()
