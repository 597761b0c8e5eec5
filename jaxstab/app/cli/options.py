"""Shared by commands: values of options, checked before anything is computed; cache and workers."""

import csv
import io
import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial, reduce
from multiprocessing import active_children, get_context, parent_process
from pathlib import Path
from typing import Any, TypeVar

import click

import jaxstab
from jaxstab.durable import OUTPUTS, publish, target_of
from jaxstab.shown import shortened
from jaxstab.tables import text_of

Command = TypeVar("Command", bound=Callable[..., Any])


def split(separator: str, kind: Callable[[str], Any], counts: Sequence[int], words: str) -> Any:
    """Return the reader of numbers in one text; one alone is itself if there may be one."""

    def read(_: click.Context, option: click.Parameter, text: str | None) -> Any:
        if text is None:
            return None
        try:
            numbers = [kind(word) for word in text.split(separator)]
        except ValueError:
            numbers = []
        if len(numbers) not in counts:
            raise click.BadParameter(f"{shortened(text)} {words}", param=option)
        return numbers if len(numbers) > 1 else numbers[0]

    return read


def key_values(_: click.Context, option: click.Parameter, texts: tuple[str, ...]) -> dict[str, str]:
    """Return the texts of KEY=VALUE by their keys."""
    given, example = dict[str, str](), "0.1:0.5:20" if option.name == "over" else "0.25"
    for text in texts:
        key, __, value = text.partition("=")
        if not (key and value):
            raise click.BadParameter(
                f"{shortened(text)} is not {option.metavar}, such as device.mass={example}.",
                param=option,
            )
        if key in given:
            raise click.BadParameter(f"{key} is given twice; give each key once.", param=option)
        given[key] = value
    return given


def refuse(given: Mapping[str, Any], words: str) -> None:
    """Refuse the first of some options that is given, in words that follow its name."""
    for name, value in given.items():
        if value is not None and value is not False and value not in ((), {}):
            raise click.UsageError(f"--{name.replace('_', '-')} {words}")


PICTURES = ".png", ".svg"


def _output_file(
    endings: tuple[str, ...],
    may_be_stdout: bool,
    context: click.Context,
    option: click.Parameter,
    path: Path | None,
) -> Path | None:
    """Return the name of a file that may be written, in a folder that exists.

    "-" is stdout, of options that allow it. Until the command ends, the file may not be read.
    """
    if path is None:
        return path
    if endings and path.suffix not in endings:
        words = f"ends in neither {' nor '.join(endings)}"
        words = words if len(endings) > 1 else f"does not end in {endings[0]}"
        raise click.BadParameter(f"{path} {words}.", param=option)
    if str(path) == "-":
        if may_be_stdout:
            return path
        raise click.BadParameter(
            "it is -, but is not written to stdout; name a file.", param=option
        )
    try:
        folder = target_of(path)[0].parent
    except OSError as error:
        raise click.BadParameter(f"cannot write {path}: {error.strerror}.", param=option) from error
    if not folder.is_dir():
        raise click.BadParameter(f"the folder {folder} does not exist.", param=option)
    if not os.access(folder, os.W_OK):
        raise click.BadParameter(f"the folder {folder} cannot be written.", param=option)
    name, names = option.opts[-1], context.meta.setdefault(__name__, {})  # of this command
    other = names.setdefault(os.path.realpath(path), name)
    if other != name:
        words = f"{path} is the file of {other}, too; give another name."
        raise click.BadParameter(words, param=option)
    OUTPUTS[path] = name
    context.call_on_close(partial(OUTPUTS.pop, path, None))
    return path


def file_option(
    *names: str, endings: tuple[str, ...] = (), may_be_stdout: bool = False, **more: Any
) -> Callable[[Command], Command]:
    """Return the option of a file to write, whose name is checked before anything is computed."""
    check = partial(_output_file, endings, may_be_stdout)
    return click.option(*names, type=Path, callback=check, **more)


def csv_option(words: str) -> Callable[[Command], Command]:
    """Return the option of a CSV file to write, or to print."""
    words = f"CSV file ('-': stdout) {words}"
    return file_option("--csv", "csv_file", may_be_stdout=True, help=words)


def plot_option(words: str) -> Callable[[Command], Command]:
    """Return the option of a file to draw a picture into."""
    return file_option("--plot", endings=PICTURES, help=words)


def write_beside(data: bytes, path: Path, *, may_replace: bool = True) -> None:
    """Write a file beside an answer on stdout, as ``publish`` does, and name it on stderr."""
    publish(data, path, may_replace=may_replace)
    click.echo(f"jaxstab: wrote {path}", err=True)


def require_one_stdout(as_json: bool, file: Path | None) -> None:
    """Refuse JSON beside CSV on stdout, before anything is computed."""
    if as_json and str(file) == "-":
        raise click.UsageError(
            "--csv is - beside --json, both for stdout; give the CSV file a name, or one of them."
        )


def print_with_csv(
    words: Any, rows: Iterable[Iterable[Any]], file: Path | None, *, may_replace: bool = True
) -> None:
    """Print an answer, and write its rows into a CSV file; for "-" print only the rows."""
    if file:
        stream = io.StringIO()
        csv.writer(stream, lineterminator="\n").writerows(map(_no_formula, row) for row in rows)
        # The bytes of a scene's file name, which need not be UTF-8, whatever the locale is.
        data = stream.getvalue().encode(errors="surrogateescape")
        if str(file) == "-":
            words = data.rstrip(b"\n")
        else:
            write_beside(data, file, may_replace=may_replace)
    click.echo(words)


def _no_formula(value: Any) -> Any:
    """Return a cell with a quote before what a spreadsheet would compute."""
    return f"'{value}" if isinstance(value, str) and value[:1] in tuple("=+-@\t\r") else value


def draw(figure: Any, path: Path) -> None:
    """Write a figure of matplotlib beside an answer, in the format that its name ends in."""
    from jaxstab.drawing import picture

    write_beside(picture(figure, path.suffix[1:]), path)


def keep_programs() -> None:
    """Keep compiled programs for the next process of this user."""
    with suppress(OSError):  # without a cache it only takes longer
        jaxstab.use_compilation_cache()


@contextmanager
def at_work(words: str) -> Iterator[Callable[[float, float], None]]:
    """Show on a terminal what is computed, and for how long, until it is done.

    The function that is yielded takes how much is done, and of how much: it draws a bar.
    """
    if not sys.stderr.isatty():
        yield lambda done, total: None
        return
    from rich import progress as bars
    from rich.console import Console

    times = bars.TimeElapsedColumn(), bars.TimeRemainingColumn()
    columns = bars.TextColumn("{task.description}"), bars.BarColumn(), *times
    with bars.Progress(*columns, console=Console(stderr=True), transient=True) as shown:
        shown.console.show_cursor()  # which Ctrl-C would leave hidden
        task = shown.add_task(words, total=None)
        yield lambda done, total: shown.update(task, completed=done, total=total)


def together(*decorations: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return arguments and options of a command as one decoration, the uppermost one first."""

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        return reduce(lambda inner, decoration: decoration(inner), reversed(decorations), command)

    return decorate


# Where tiles and blocks are computed, which ``workers_in`` and ``computing`` read.
executor_options = together(
    click.option(
        "--workers", type=click.IntRange(1, 1000), help="Number of processes to use here."
    ),
    click.option(
        "--scheduler",
        help="Address of the dask scheduler to compute on; default: DASK_SCHEDULER_ADDRESS, if "
        "set.",
    ),
    click.option("--scheduler-file", type=Path, help="JSON file that the dask scheduler wrote."),
)


@contextmanager
def computing(given: Mapping[str, Any]) -> Iterator[None]:
    """Let dask compute where options say, and draw a bar on a terminal."""
    from dask import config
    from dask.callbacks import Callback

    with workers_in(given) as (pool, _), at_work("computing") as show:

        def count(_: Any, __: Any, ___: Any, state: Any, ____: Any) -> None:
            done, left = len(state["finished"]), ("waiting", "ready", "running")
            show(done, done + sum(len(state[kind]) for kind in left))

        # A task is a block, which no other one should wait for. A cluster's tasks are not counted.
        here = {"scheduler": "processes", "pool": pool, "chunksize": 1} if pool else {}
        with config.set(here), Callback(posttask=count):
            yield


@contextmanager
def workers_in(given: Mapping[str, Any]) -> Iterator[tuple[Executor | None, Any]]:
    """Processes, or the client of a dask scheduler, where options or the environment say so."""
    workers, scheduler, file = (given[name] for name in ("workers", "scheduler", "scheduler_file"))
    options = {"--workers": workers, "--scheduler": scheduler, "--scheduler-file": file}
    names = [name for name, value in options.items() if value is not None]
    if len(names) > 1:
        raise click.UsageError(f"{' and '.join(names)} are given; give one of them.")
    if scheduler == "":
        raise click.UsageError("--scheduler is empty; give an address such as tcp://10.0.0.1:8786.")
    address = _address_in(file) if file else scheduler or os.environ.get("DASK_SCHEDULER_ADDRESS")
    if workers:
        with processes(workers) as pool:
            yield pool, None
    elif address:
        with _client(address) as client:
            yield None, client
    else:
        yield None, None


def _client(address: str) -> Any:
    try:
        from distributed import Client
    except ImportError as error:
        raise RuntimeError(
            "a dask cluster needs dask: python -m pip install 'jaxstab[distributed]'."
        ) from error
    try:
        client = Client(address, timeout=10)  # s
    except OSError as error:
        raise OSError(
            f"no dask scheduler answers at {address}; start one, or correct the address."
        ) from error
    except ValueError as error:  # of an address that dask cannot read
        raise ValueError(
            f"scheduler is {address!r}; give an address such as tcp://10.0.0.1:8786."
        ) from error
    if not client.scheduler_info()["workers"]:
        words = f"the dask scheduler at {address} has no workers; the command waits for one."
        click.echo(f"jaxstab: {words}", err=True)
    return client


def _address_in(file: Path) -> str:
    try:
        return str(json.loads(text_of(file, 1_000_000))["address"])
    except (ValueError, KeyError, TypeError):
        raise click.UsageError(
            f"{file} is not a scheduler file; give what dask scheduler --scheduler-file wrote."
        ) from None


# Processes that end with the command.


@contextmanager
def processes(count: int) -> Iterator[ProcessPoolExecutor]:
    """Open worker processes, spawned: a process that has used JAX must not be forked.

    They end at once where an error leaves the ``with`` statement, and with this process.
    """
    # Of what a sudden end leaves, the tracker of resources clears up, and would report it.
    os.environ.setdefault("PYTHONWARNINGS", "ignore:resource_tracker:UserWarning")
    with _Workers(count, get_context("spawn"), _begin_worker) as pool:
        try:
            yield pool
        except BaseException:
            for child in active_children():
                child.kill()
            raise


class _Workers(ProcessPoolExecutor):
    """Processes that inherit a blocked SIGINT, or they would print what Ctrl-C stopped at first."""

    def submit(self, *given: Any, **options: Any) -> Future[Any]:
        if os.name != "posix":
            return super().submit(*given, **options)
        former = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return super().submit(*given, **options)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, former)


def _begin_worker() -> None:
    """End this worker at once with Ctrl-C, and when its parent ends, in whatever way."""

    def wait() -> None:
        parent = parent_process()
        assert parent is not None  # this is a worker
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    if os.name == "posix":
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
