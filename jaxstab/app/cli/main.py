"""The command line. JAX, matplotlib and rich are imported inside the commands that need them.

Exit codes: 0, answered, and everything is stable; 1, answered, and something is not proved stable;
2, not answered.
"""

import io
import os
import sys
import traceback
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any, NoReturn

import click

# Before NumPy is imported: matrices are small, and where processors are busy threads that share
# them wait for each other ten times as long as one thread takes. Who sets it has it.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import jaxstab
from jaxstab.app.cli import plane, scene
from jaxstab.shown import printable


class OneSentence(click.Group):
    """Commands whose every failure is one sentence on stderr and exit code 2."""

    def main(self, *args: Any, standalone_mode: bool = True, **extra: Any) -> Any:
        """Run a command; see click.Command.main."""
        run: Callable[[], object] = partial(super().main, *args, standalone_mode=False, **extra)
        if not standalone_mode:
            return run()
        _open_what_is_closed()
        try:
            stdout: Any = sys.stdout
            if stdout is None:
                raise OSError("stdout is closed; redirect it to a file, or to /dev/null.")
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", "delay is ")  # scenes say so themselves
                warnings.showwarning = lambda words, *_, **__: scene.warn(_with_remedy(str(words)))
                code = run()
            stdout.flush()
        except click.ClickException as error:
            words = error.format_message() + self._missing(error)
            _fail(words if words.startswith("Usage:") else f"jaxstab: {words}")
        except click.Abort:  # Ctrl-C, where Python hears of it
            sys.exit(130)
        except (_NoReader, BrokenPipeError):  # the reader of our output has enough
            _drop(sys.stdout)
            _drop(sys.stderr)
            sys.exit(2)
        except OSError as error:
            _fail(f"jaxstab: {scene.sentence_of(error)}")
        except (ValueError, TypeError, RuntimeError, MemoryError) as error:
            _fail(f"jaxstab: {str(error) or 'there is not enough memory.'}")
        except Exception:  # noqa: BLE001  a fault of ours, which says nothing of a wall
            _fail(traceback.format_exc())
        sys.exit(code if isinstance(code, int) else 0)

    def invoke(self, context: click.Context) -> Any:
        """Run a command; see click.Group.invoke."""
        try:
            return super().invoke(context)
        except BrokenPipeError as error:  # which click would end with 1
            raise _NoReader from error

    def _missing(self, error: click.ClickException) -> str:
        """The values of an option that has bad ones, or who has one that this command lacks."""
        parameter = getattr(error, "param", None)
        name = parameter.opts[0] if parameter else getattr(error, "option_name", "")
        users = {
            command: option
            for command, own in self.commands.items()
            for option in own.get_params(click.Context(own))
            if name in option.opts
        }
        if isinstance(error, click.NoSuchOption):
            return f" It is an option of {', '.join(users)}." if users else ""
        several = (option.metavar for option in users.values() if option.nargs > 1)
        return "".join(f" Its values are {metavar}." for metavar in [*several][:1])


def _with_remedy(words: str) -> str:
    """A warning; JAX keeps a program that was written in part, and has no remedy."""
    is_damaged = words.startswith("Error reading persistent compilation cache")
    remedy = f"; delete {os.environ.get('JAX_COMPILATION_CACHE_DIR')}" if is_damaged else ""
    return f"{words.rstrip('.')}{remedy}"


class _NoReader(Exception):
    """Nobody reads what is printed any more."""


def _open_what_is_closed() -> None:
    """Put the null device in place of streams that are closed: no file of ours takes a number."""
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(descriptor)
    sys.stderr = sys.stderr or io.StringIO()


def _fail(words: str) -> NoReturn:
    """End with a sentence on stderr, in which nothing commands the terminal; flush stdout."""
    try:
        click.echo(printable(words, "\n"), err=True)
    except OSError:
        _drop(sys.stderr)
    try:
        sys.stdout.flush()
    except AttributeError:  # it is closed
        pass
    except OSError:
        _drop(sys.stdout)
    sys.exit(2)


def _drop(stream: Any) -> None:
    """Give up what a stream could not write: trying again at the end would change the exit code."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


_COMMANDS = (
    *(scene.limits, scene.check, scene.contact, scene.tune, scene.design, scene.study),
    *(scene.joints, scene.scene, scene.identify, scene.explore, scene.guard, scene.files),
    *(plane.region, plane.figure),
)
_OF_ATLASES = plane.spec, plane.build, plane.info, plane.verify, plane.query, plane.plot


@click.group(cls=OneSentence, commands=_COMMANDS)
@click.version_option(jaxstab.__version__, prog_name="jaxstab")
def main() -> None:
    """Stability of haptic rendering loops."""


@main.group(commands=_OF_ATLASES)
def atlas() -> None:
    """Build, inspect, verify, query and plot atlases: limits and fields at nodes, in one file."""
