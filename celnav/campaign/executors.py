"""Executors of the work: this process, several processes, or a Dask cluster. Any executor of
`concurrent.futures` will do.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from multiprocessing import active_children, get_context, parent_process, resource_tracker
from multiprocessing.process import BaseProcess
from typing import Any, NamedTuple, cast
from urllib.parse import urlsplit

from celnav.gaussian.checks import integer
from celnav.lazy import requires_extra

MOST_PROCESSES = 61 if sys.platform == "win32" else 1_000_000
"""Largest number of processes; Windows cannot wait for more at once."""
PATIENCE_S = 10.0
"""How long a scheduler may take to answer."""


class Workers(NamedTuple):
    """How to get an executor.

    open: ``() ->`` an executor. ahead: number of units that are handed out in advance. again:
        whether a new executor can be opened if the last one broke.
    """

    open: Callable[[], AbstractContextManager[Executor]]
    ahead: int
    again: bool = True


class _Serial(Executor):
    """An executor that does the work when it is submitted."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def serial() -> Workers:
    """Workers that are this process itself."""
    return Workers(_Serial, 1)


def from_executor(executor: Executor) -> Workers:
    """Workers of a given executor, such as ``mpi4py.futures.MPIPoolExecutor``; it stays open."""
    return Workers(lambda: contextlib.nullcontext(executor), 1000, again=False)


def processes(jobs: int) -> Workers:
    """Workers that are processes on this machine. They end with this process, even if it is killed.

    Raises
    ------
    ValueError: unless ``jobs`` is a positive integer.
    """
    integer("jobs", jobs)
    return Workers(lambda: _pool(jobs), 3 * jobs)


@contextmanager
def _pool(jobs: int) -> Iterator[Executor]:
    others = set(active_children())
    pool = _Pool(
        min(jobs, MOST_PROCESSES), mp_context=get_context("spawn"), initializer=_end_with_the_parent
    )
    try:
        yield pool
        pool.shutdown()
    except BaseException:
        _kill_but(others)  # a unit may take minutes, and its result is no longer needed
        pool.shutdown(cancel_futures=True)
        raise


def _kill_but(others: set[BaseProcess]) -> None:
    """Kill all child processes but these."""
    for child in set(active_children()) - others:
        child.kill()


class _Pool(ProcessPoolExecutor):
    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        with _deaf_children():
            return super().submit(fn, *args, **kwargs)


@contextmanager
def _deaf_children() -> Iterator[None]:
    """A context whose child processes ignore keyboard interrupts.

    Interrupts are for the parent alone, which receives them at the end of the context.
    """
    if sys.platform == "win32":
        yield
    else:
        resource_tracker.ensure_running()  # its start would let the signal through again
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_with_the_parent() -> None:
    """In a new process: leave interrupts to the parent, and end when the parent ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def dask(address: str | None = None, jobs: int = 1) -> Workers:
    """Workers of a running Dask scheduler (``tcp://host:port``), or of a new one with ``jobs``
    processes on this machine.

    Opening it raises ImportError without ``distributed``, OSError if no scheduler answers.

    Raises
    ------
    ValueError: if ``address`` is invalid.
    """
    if address is not None and not _is_address(address):
        raise ValueError(f"address: expected tcp://HOST:PORT, got {address!r}")
    return Workers(lambda: _cluster(address, jobs), 1000)


def _is_address(text: str) -> bool:
    try:
        parts = urlsplit(text)
        return (
            parts.scheme in ("tcp", "tls", "ws", "wss", "ucx")
            and bool(parts.hostname)
            and parts.port is not None
        )
    except ValueError:  # such as a port above 65535
        return False


@contextmanager
def _cluster(address: str | None, jobs: int) -> Iterator[Executor]:
    with requires_extra("dask", "cluster"):
        import distributed

    others, dd = set(active_children()), cast(Any, distributed)
    with contextlib.ExitStack() as stack:
        stack.callback(_kill_but, others)
        target: Any = address
        if address is None:
            local = {
                "n_workers": jobs,
                "threads_per_worker": 1,
                "host": "127.0.0.1",
                "dashboard_address": None,
            }
            with _deaf_children():
                target = stack.enter_context(
                    _closing(dd.LocalCluster(**local, silence_logs="ERROR"))
                )
        client = stack.enter_context(
            _closing(dd.Client(target, timeout=PATIENCE_S, set_as_default=False))
        )
        yield client.get_executor()


@contextmanager
def _closing(resource: Any) -> Iterator[Any]:
    """Close the resource within two seconds, even if work is still running."""
    try:
        yield resource
    finally:
        with contextlib.suppress(Exception):  # an interrupted cluster may not even have begun
            resource.close(timeout=2)
