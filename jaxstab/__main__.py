"""The command line, as ``jaxstab`` and as ``python -m jaxstab``."""

import os
import signal
from typing import Any


def main(**options: Any) -> None:
    """Run a command. While modules are imported, Ctrl-C ends the process at once."""
    is_ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if is_ours:
        signal.signal(signal.SIGINT, lambda *_: os._exit(130))
    from jaxstab.cli.main import main as run

    if is_ours:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    run(**options)


if __name__ == "__main__":
    main(prog_name="python -m jaxstab")
