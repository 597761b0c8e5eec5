"""The command line. JAX, matplotlib and rich are imported inside the commands that need them."""

import sys
from functools import partial
from typing import Any

import click

import jaxstab
from jaxstab.cli.atlas import build, info, plan, verify
from jaxstab.cli.query import plot, query
from jaxstab.cli.region import figure, region
from jaxstab.cli.scene import check, design, limits, scene, tune


class OneSentence(click.Group):
    """Commands whose every failure is one sentence on stderr and a non-zero exit code."""

    def main(self, *args: Any, standalone_mode: bool = True, **extra: Any) -> Any:
        """Run a command; see click.Command.main."""
        run = partial(super().main, *args, standalone_mode=False, **extra)
        if not standalone_mode:
            return run()
        try:
            code: object = run()
        except click.ClickException as error:
            words = error.format_message()
            click.echo(words if words.startswith("Usage:") else f"jaxstab: {words}", err=True)
            sys.exit(error.exit_code)
        except click.Abort:
            click.echo("jaxstab: interrupted; nothing was written.", err=True)
            sys.exit(130)
        except BrokenPipeError:  # the reader of our output has enough
            sys.stderr.close()
            sys.exit(1)
        except OSError as error:
            named = f"{error.filename}: {error.strerror}." if error.filename else error.strerror
            click.echo(f"jaxstab: {named or error}", err=True)
            sys.exit(1)
        except (ValueError, TypeError, RuntimeError, MemoryError) as error:
            click.echo(f"jaxstab: {str(error) or 'there is not enough memory.'}", err=True)
            sys.exit(1)
        sys.exit(code if isinstance(code, int) else 0)


@click.group(cls=OneSentence)
@click.version_option(jaxstab.__version__, prog_name="jaxstab")
def main() -> None:
    """Stability of haptic rendering loops."""


for _command in (limits, check, tune, design, scene, region, figure):
    main.add_command(_command)


@main.group()
def atlas() -> None:
    """Plan, build, inspect, verify, ask and plot atlases: stability over a grid, in one file."""


for _command in (build, plan, info, verify, query, plot):
    atlas.add_command(_command)
