"""Ctrl-C ends every command within a second or two, whatever it is doing.

Python answers a signal between two instructions of its main thread. A program of XLA that is
compiled or runs there holds it up, for minutes if need be, and so do threads and processes for
which a command waits when it ends. So SIGINT is blocked in all threads and, as they inherit that,
in all worker processes. One thread waits for it, and interrupts the main thread by another signal:
files that are half-written are removed, and workers are ended. If the process is still there a
second later, the thread ends it.
"""

import os
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import active_children, get_context, parent_process, resource_tracker
from typing import Any


@contextmanager
def prompt_interrupts() -> Iterator[None]:
    """End this process soon after Ctrl-C; elsewhere than on POSIX, Python's own way remains."""
    if os.name != "posix" or threading.current_thread() is not threading.main_thread():
        yield
        return
    done = threading.Event()
    former = signal.signal(signal.SIGUSR1, signal.default_int_handler)
    with _mask_kept():
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        watch = threading.Thread(target=_watch, args=(done,), daemon=True)
        watch.start()
        try:
            yield
        finally:
            done.set()
            assert watch.ident is not None  # it was started
            signal.pthread_kill(watch.ident, signal.SIGINT)
    signal.signal(signal.SIGUSR1, former)


def _watch(done: threading.Event) -> None:
    patience = 1.0  # s
    signal.sigwait({signal.SIGINT})
    if done.is_set():
        return
    main = threading.main_thread().ident
    assert main is not None  # it runs
    signal.pthread_kill(main, signal.SIGUSR1)
    time.sleep(patience)
    end_workers()
    os._exit(130)


def end_workers() -> None:
    """End the worker processes of this one at once, whatever they compute."""
    for child in active_children():
        child.kill()


@contextmanager
def processes(count: int) -> Iterator[ProcessPoolExecutor]:
    """Open worker processes, spawned: a process that has used JAX must not be forked.

    They end at once where an error leaves the ``with`` statement, and with this process.
    """
    with _mask_kept(), _silent():  # the tracker of resources changes the mask when it starts
        resource_tracker.ensure_running()
    with _Workers(count, get_context("spawn"), _end_with_parent) as pool:
        try:
            yield pool
        except BaseException:
            end_workers()
            raise


class _Workers(ProcessPoolExecutor):
    """Processes that ``submit`` starts whole: an interruption waits until one has begun."""

    def submit(self, *given: Any, **options: Any) -> Future[Any]:
        with _mask_kept():
            if os.name == "posix":
                signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGUSR1})
            return super().submit(*given, **options)


@contextmanager
def _mask_kept() -> Iterator[None]:
    """Keep the signals that this thread blocks, whatever is blocked meanwhile."""
    if os.name != "posix":
        yield
        return
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, [])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


@contextmanager
def _silent() -> Iterator[None]:
    """Let the tracker that starts meanwhile not report what it clears up after a sudden end."""
    name, silence = "PYTHONWARNINGS", "ignore:resource_tracker:UserWarning"
    before = os.environ.get(name)
    os.environ[name] = f"{before},{silence}" if before else silence
    try:
        yield
    finally:
        os.environ.pop(name)
        if before is not None:
            os.environ[name] = before


def _end_with_parent() -> None:
    """End this worker when its parent ends, in whatever way."""

    def wait() -> None:
        parent = parent_process()
        assert parent is not None  # this is a worker
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()
