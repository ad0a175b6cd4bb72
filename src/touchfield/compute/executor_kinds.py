"""Opens the executors that the option ``--workers`` names: processes, joblib, ray, dask, and plug-ins.

An executor is any object with `submit`, as in `concurrent.futures`, or with `map`. A plug-in adds a kind by
an entry point of the group ``touchfield.executors``, an `ExecutorKind`.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import re
import socket
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import cache, partial
from threading import Thread
from typing import Any, Final, Protocol

from touchfield.compute.threads import worker_count
from touchfield.errors import InvalidArgument, SourceError, TouchfieldError, import_extra, reason
from touchfield.options import address
from touchfield.plugins import plugins

_MAX_PROCESSES: Final = 1024
_PATIENCE_S: Final = 5  # time to wait for a scheduler to answer


class TaskFuture(Protocol):
    """The result of a submitted task, as in `concurrent.futures.Future`."""

    def done(self) -> bool:
        """Return True if `result` does not have to wait."""

    def cancel(self) -> Any:
        """Drop the task if it has not started."""

    def result(self) -> Any:
        """Wait for the result; raises the error of the task."""


class SubmitExecutor(Protocol):
    """An executor that takes one task at a time, as those of `concurrent.futures` and dask's client."""

    def submit(self, work: Callable[..., Any], item: Any, /) -> Any:
        """Start ``work(item)``; return its `TaskFuture`."""


class MapExecutor(Protocol):
    """An executor that takes a list of tasks, as `multiprocessing.Pool`."""

    def map(self, work: Callable[..., Any], items: list[Any], /) -> Iterable[Any]:
        """Run ``work(item)`` for each item; return the results in the order of the items."""


TaskExecutor = SubmitExecutor | MapExecutor


def require_executor(executor: object) -> None:
    """Raise `InvalidArgument` for an object that is no executor; None passes."""
    has_method = any(callable(getattr(executor, name, None)) for name in ("submit", "map"))
    if executor is not None and not has_method:
        expected = "an object with submit or map, such as concurrent.futures.ProcessPoolExecutor"
        raise InvalidArgument("executor", f"a {type(executor).__name__}", expected)


@dataclass(frozen=True)
class ExecutorKind:
    """A kind of executors that ``--workers NAME:REST`` opens.

    forms : str; the texts of the option, for messages, such as "processes:N".
    accepts : callable; True if REST has the right form.
    open : callable; maps REST to a context manager of a `TaskExecutor`. Raises TouchfieldError, such as
        SourceError if no scheduler answers at an address.
    """

    name: str
    forms: str
    accepts: Callable[[str], bool]
    open: Callable[[str], AbstractContextManager[TaskExecutor]]


@cache
def executor_kinds() -> dict[str, ExecutorKind]:
    """Return the kinds by name: the built-in ones, and those of plug-ins."""
    added = plugins("touchfield.executors", ExecutorKind).values()
    return {kind.name: kind for kind in (*added, *_BUILT_IN)}


def _is_process_count(text: str) -> bool:
    return text.isascii() and text.isdigit() and 0 < int(text[:9]) <= _MAX_PROCESSES


def _is_scheduler_address(text: str) -> bool:
    """False if nothing is named, or the port of HOST:PORT, behind any scheme, is none."""
    place = text.rpartition("://")[2].partition("/")[0]
    if ":" not in place:
        return bool(place)
    try:
        address(place, "")
    except InvalidArgument:
        return False
    return True


def _threads_each(processes: int) -> int:
    """Return the number of threads of each process, so that all together use the cores once."""
    return max(1, worker_count() // processes)


# -- processes ---------------------------------------------------------------------------------------------


@contextmanager
def _open_processes(rest: str) -> Iterator[TaskExecutor]:
    count, context = int(rest), multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(count, context, _start_worker, (_threads_each(count),)) as pool:
        yield pool


def _start_worker(threads: int) -> None:
    """Set the number of threads of a worker process, and end it with the process that started it.

    A worker waits for tasks without end: the pipe of a killed process stays open, because each worker has
    both of its ends.
    """
    os.environ.setdefault("TOUCHFIELD_THREADS", str(threads))
    if multiprocessing.parent_process() is not None:
        Thread(target=_end_with_parent, name="touchfield-parent", daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None  # checked before the thread was started
    parent.join()
    os._exit(1)


# -- joblib ------------------------------------------------------------------------------------------------


class JoblibExecutor:
    """Runs tasks by a `joblib.Parallel`, on any of its backends (extra ``joblib``).

    parallel : joblib.Parallel; with ``return_as="generator"``, results arrive as soon as they are there.
    threads : int; number of threads in a worker whose environment does not set TOUCHFIELD_THREADS.
    """

    def __init__(self, parallel: Any, threads: int = 1) -> None:
        self._delayed = import_extra("joblib", "an executor of joblib", "joblib", "joblib").delayed
        self._parallel, self._threads = parallel, threads

    def map(self, work: Callable[..., Any], items: list[Any], /) -> Iterable[Any]:
        """Run ``work(item)`` for each item; yield the results in the order of the items."""
        task = self._delayed(partial(_run_with_threads, os.getpid(), self._threads, work))
        results: Iterable[Any] = self._parallel(task(item) for item in items)
        return results


def _run_with_threads(client_pid: int, threads: int, work: Callable[..., Any], item: Any) -> Any:
    """Run a task; a process other than the client's takes `threads` threads."""
    if os.getpid() != client_pid:  # one worker is no process of its own in joblib
        os.environ.setdefault("TOUCHFIELD_THREADS", str(threads))
    return work(item)


@contextmanager
def _open_joblib(rest: str) -> Iterator[TaskExecutor]:
    joblib = import_extra("joblib", "--workers joblib:N", "joblib", "joblib")
    count = int(rest)
    # tasks are small, and their arrays are not shared: no memory maps
    with joblib.Parallel(count, backend="loky", return_as="generator", max_nbytes=None) as parallel:
        yield JoblibExecutor(parallel, _threads_each(count))


# -- ray ---------------------------------------------------------------------------------------------------


class RayExecutor:
    """Runs tasks by ray, to which this process is connected (extra ``ray``); ray repeats lost tasks."""

    def __init__(self) -> None:
        self._ray = import_extra("ray", "an executor of ray", "ray", "ray")
        self._run = self._ray.remote(_outcome)

    def submit(self, work: Callable[..., Any], item: Any, /) -> TaskFuture:
        """Start ``work(item)``; return its future."""
        return _RayFuture(self._ray, self._run.remote(work, item))


class _RayFuture:
    """The result of a task of ray."""

    def __init__(self, ray: Any, reference: Any) -> None:
        self._ray, self._reference = ray, reference

    def done(self) -> bool:
        return bool(self._ray.wait([self._reference], timeout=0)[0])

    def cancel(self) -> None:
        self._ray.cancel(self._reference)

    def result(self) -> Any:
        result, error = self._ray.get(self._reference)
        if error is not None:
            raise error
        return result


def _outcome(work: Callable[..., Any], item: Any) -> tuple[Any, Exception | None]:
    """Return the result of a task, or its error: ray would raise one of its own, with a traceback as text."""
    try:
        return work(item), None
    except (TouchfieldError, MemoryError) as error:
        return None, error


@contextmanager
def _open_ray(rest: str) -> Iterator[TaskExecutor]:
    ray = import_extra("ray", "--workers ray:...", "ray", "ray")
    if rest.isdigit():
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # ray reports its use unless told not to
        threads = {"TOUCHFIELD_THREADS": os.environ.get("TOUCHFIELD_THREADS", str(_threads_each(int(rest))))}
        options = {"num_cpus": int(rest), "include_dashboard": False, "runtime_env": {"env_vars": threads}}
    else:
        options = {"address": rest}
    try:
        _require_listener(rest)
        ray.init(log_to_driver=False, logging_level="ERROR", **options)
    except (OSError, ValueError, RuntimeError) as error:
        found = f"that ray does not start or answer ({reason(error)})"
        expected = "the address of a cluster, or a number of workers of this machine"
        raise SourceError(f"--workers ray:{rest}", found, expected, "Start one: ray start --head.") from None
    try:
        yield RayExecutor()
    finally:
        ray.shutdown()


def _require_listener(address: str) -> None:
    """Raise OSError if nothing listens at HOST:PORT or ray://HOST:PORT; ray itself waits for minutes."""
    if found := re.fullmatch(r"(?:ray://)?\[?([^/\[\]]+?)\]?:(\d{1,5})", address):
        socket.create_connection((found[1], int(found[2])), _PATIENCE_S).close()


# -- dask --------------------------------------------------------------------------------------------------


class DaskExecutor:
    """Runs tasks by a `distributed.Client` (extra ``cluster``); dask repeats the tasks of a lost worker.

    The executor of `Client.get_executor` is not used: if the scheduler is lost while a result is on its way,
    it drops the error of the connection, and its future is never done (seen with distributed 2026.8).
    """

    def __init__(self, client: Any) -> None:
        self._client = client

    def submit(self, work: Callable[..., Any], item: Any, /) -> TaskFuture:
        """Start ``work(item)``; return its future."""
        future: TaskFuture = self._client.submit(work, item, pure=False)
        return future


@contextmanager
def _open_dask(rest: str) -> Iterator[TaskExecutor]:
    Client = import_extra("distributed", "--workers dask:ADDRESS", "distributed", "cluster").Client
    try:
        client = Client(rest, timeout=_PATIENCE_S, set_as_default=False)
    except (OSError, ValueError) as error:
        found = f"no scheduler that answers ({str(error) or type(error).__name__})"
        hint = "Start one: dask scheduler."
        raise SourceError(f"--workers dask:{rest}", found, "the address of one", hint) from None
    with _without_logs("distributed", "distributed.client", "tornado.application"), client:
        yield DaskExecutor(client)


@contextmanager
def _without_logs(*names: str) -> Iterator[None]:
    """Keep loggers from printing errors, with tracebacks, that are raised anyway."""
    loggers = [logging.getLogger(name) for name in names]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels):
            logger.setLevel(level)


def _is_dask_address(text: str) -> bool:
    """True for an address with a port: about one without, dask's client prints a traceback."""
    has_port = ":" in text.rpartition("://")[2] or text.startswith("inproc://")
    return has_port and _is_scheduler_address(text)


_BUILT_IN: Final = (
    ExecutorKind("processes", "processes:N", _is_process_count, _open_processes),
    ExecutorKind("joblib", "joblib:N", _is_process_count, _open_joblib),
    ExecutorKind(
        "ray",
        "ray:N or ray:ADDRESS",
        lambda rest: _is_process_count(rest) if rest.isdigit() else _is_scheduler_address(rest),
        _open_ray,
    ),
    ExecutorKind("dask", "dask:ADDRESS such as dask:tcp://host:8786", _is_dask_address, _open_dask),
)
