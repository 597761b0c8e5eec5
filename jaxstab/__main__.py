"""The command line, as ``jaxstab`` and as ``python -m jaxstab``.

Ctrl-C ends the process at once, as its default does: Python's own way waits until a program of XLA
is compiled or has run, and for threads and processes.
"""

import signal
from typing import Any


def main(**options: Any) -> None:
    """Run a command."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not ignored, as by nohup
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from jaxstab.app.cli.main import main as run

    run(**options)


if __name__ == "__main__":
    main(prog_name="python -m jaxstab")
