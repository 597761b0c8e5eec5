"""Files from strangers: a published digest is compared first, and a child process reads them.

``python -m jaxstab.cli.untrusted ARGUMENTS`` runs a command with limits on memory and time.
"""

import ctypes
import hashlib
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any

import click

from jaxstab.durable import named_errors, target_of

_OPTION = "--untrusted"
_MEMORY = 4 * 2**30  # bytes of addresses
_SECONDS = 300
_PR_SET_PDEATHSIG = 1


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
    wanted = expected.strip().lower()
    if not re.fullmatch("[0-9a-f]{64}", wanted):
        raise click.UsageError(
            f"--expect-sha256 is {expected!r}; give the 64 hexadecimal digits of a SHA-256."
        )
    with named_errors("read", file):
        target_of(file)  # a pipe would be waited for
        with file.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
    if digest != wanted:
        raise ValueError(
            f"{file} has the SHA-256 {digest}, and {wanted} is expected; do not use this file."
        )


def _in_a_child(file: Path) -> int:
    arguments = [argument for argument in sys.argv[1:] if argument != _OPTION]
    # -P: nothing from this folder
    words = [sys.executable, "-P", "-m", __name__, str(os.getpid()), *arguments]
    try:
        code = subprocess.run(words, timeout=2 * _SECONDS).returncode
    except subprocess.TimeoutExpired as error:
        raise ValueError(f"{file} takes longer than {2 * _SECONDS} s; do not use it.") from error
    if code < 0:
        raise ValueError(f"{file} ended the process that read it (signal {-code}); do not use it.")
    return code


def main() -> None:
    """Run a command with limits on memory and time, which ends with its parent.

    The first argument is the process of the parent.
    """
    from jaxstab.cli.main import main as run

    if sys.platform == "win32":
        raise click.UsageError(f"{_OPTION} needs the limits of POSIX systems.")
    import resource

    _end_with(int(sys.argv.pop(1)))
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (_SECONDS, _SECONDS))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    run(prog_name="jaxstab")


def _end_with(parent: int) -> None:
    """Have the system end this process when its parent ends; elsewhere than on Linux, limits do."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL))
        if os.getppid() != parent:  # it has ended already
            sys.exit(1)


if __name__ == "__main__":
    main()
