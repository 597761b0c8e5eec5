"""The command line, as ``python -m jaxstab``."""

from jaxstab.cli.main import main

if __name__ == "__main__":
    main(prog_name="python -m jaxstab")
