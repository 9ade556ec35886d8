"""Many pieces of work at once: in threads or processes (joblib), or on a cluster (dask), with the same results.

joblib's own dask backend waits for ever where work kills its workers, so a cluster is asked directly.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from joblib import Parallel, cpu_count, delayed, parallel_config

from phnn.errors import InputRefused, PhnnError, SolverFailed
from phnn.laws.identity import register_again, registered_outside

if TYPE_CHECKING:
    from distributed import Client

_CHOICES = (
    "serial, threads, threads:N, processes, processes:N, tcp://host:port or tls://host:port (a dask scheduler), "
    "or the path of its scheduler file (.json)"
)
_CONNECT = 10.0  # s until a scheduler has to answer
_IDLE = 60.0  # s after which idle processes end; until then the next call finds them with everything imported
_WATCH = 1.0  # s between two looks whether the parent process lives


@dataclass(frozen=True)
class Executor:
    """The choice of where work is done, which makes no difference to its results.

    Attributes:
        kind: ``serial``, ``threads``, ``processes`` (with one torch, BLAS and numba thread each) or ``cluster``.
        workers: number of threads or processes; scheduler: address or scheduler file of a cluster.
    """

    kind: str = "serial"
    workers: int = 1
    scheduler: str = ""

    def each(self, function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """Yield pairs of an item's index and ``function(item)`` as they finish; closing the iterator gives up the rest.

        Function, items and results must pickle where they leave this process.

        Raises:
            Exception: whatever ``function`` raises, as it is; the rest is given up.
            SolverFailed: a worker process was killed; PhnnError: the scheduler was lost.
        """
        if self.kind == "serial":
            return ((i, function(item)) for i, item in enumerate(items))
        return _on_cluster(self.scheduler, function, items) if self.kind == "cluster" else self._local(function, items)

    def run(self, function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
        """Return ``[function(item) for item in items]``; raises what `each` raises."""
        results = dict(self.each(function, items))
        return [results[i] for i in range(len(items))]

    def _local(self, function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        options: dict[str, Any] = {"backend": "threading"}
        if self.kind == "processes":
            begin = {"initializer": _begin, "initargs": (os.getpid(), *registered_outside())}
            options = {"backend": "loky", "inner_max_num_threads": 1, "idle_worker_timeout": _IDLE, **begin}
        # With one worker joblib would work in this process: of two, one gets all. Arrays that joblib maps to files
        # (max_nbytes) are read-only, for which kernels would be compiled once more.
        with parallel_config(**options, n_jobs=max(2, self.workers), max_nbytes=None):
            pool = Parallel(return_as="generator_unordered", pre_dispatch=self.workers, batch_size=1)
            results = pool(delayed(_numbered)(function, *numbered) for numbered in enumerate(items))
        try:
            # Closed below, where it cannot warn.
            for pair in results:  # noqa: UP028
                yield pair
        except BrokenProcessPool as error:
            raise SolverFailed(
                "a worker process was killed; the machine has probably run out of memory: use fewer workers "
                "(executor=processes:N) or executor=serial"
            ) from error
        finally:
            with warnings.catch_warnings(action="ignore"):
                results.close()


SERIAL = Executor()


def executor(choice: str) -> Executor:
    """Return the executor of a choice; without a number, threads and processes take all cores this process may use.

    Args:
        choice: ``serial``, ``threads``, ``threads:N``, ``processes``, ``processes:N``; ``tcp://host:port``,
            ``tls://host:port`` or the path of a scheduler file (``.json``) for a cluster of dask.distributed.

    Raises:
        InputRefused: the choice is not understood, a package is missing, or no scheduler answers.
    """
    kind, colon, count = choice.partition(":")
    if choice == "serial":
        return SERIAL
    if kind in ("threads", "processes"):
        if colon and not (count.isdecimal() and int(count)):
            raise InputRefused(f"executor={choice}: {count!r} is no number of workers, 1 or more; give {_CHOICES}")
        return Executor(kind, int(count) if colon else cpu_count())
    if choice.startswith(("tcp://", "tls://")) or choice.endswith(".json"):
        # An address that does not answer is noticed now, not after hours of other work.
        _connect(choice).close()
        return Executor("cluster", scheduler=choice)
    raise InputRefused(f"executor={choice} is not known: give {_CHOICES}")


def _connect(scheduler: str) -> Client:
    """Return a client of a running scheduler, given by its address or its file; a silent one is refused in time."""
    try:
        from distributed import Client
        from distributed.core import rpc
    except ModuleNotFoundError as error:
        raise InputRefused(
            f"executor={scheduler} needs the package {error.name}: pip install 'phnn[cluster]'"
        ) from error

    async def identity(address: str) -> None:
        async with rpc(address, timeout=_CONNECT) as remote:
            await asyncio.wait_for(remote.identity(), _CONNECT)

    try:
        address = scheduler if "://" in scheduler else json.loads(Path(scheduler).read_text("utf-8"))["address"]
        # In a thread, for a notebook has an event loop of its own.
        with ThreadPoolExecutor(1) as thread:
            thread.submit(asyncio.run, identity(address)).result()
        return Client(address, timeout=_CONNECT, set_as_default=False)
    except (OSError, ValueError, TypeError, KeyError, AssertionError) as error:
        raise InputRefused(
            f"executor={scheduler}: no dask scheduler answers ({str(error) or 'no answer'}): give host and port or its "
            "scheduler file; `dask scheduler --scheduler-file FILE` starts one, `dask worker ADDRESS` a worker"
        ) from error


def _on_cluster(scheduler: str, function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
    """Yield results as they finish; the scheduler does again what a dead worker had at work, up to its own limit."""
    from distributed import KilledWorker, as_completed

    with _connect(scheduler) as client:
        # A bound item is opaque: dask would search lists and mappings for futures.
        futures = {client.submit(partial(function, item), pure=False): i for i, item in enumerate(items)}
        try:
            for future in as_completed(list(futures), loop=client.loop):
                yield futures[future], future.result()
        except KilledWorker as error:
            raise SolverFailed(
                f"{scheduler}: several workers were killed at the same piece of work; their logs say why, most "
                "often they need more memory"
            ) from error
        except CancelledError as error:
            raise PhnnError(f"{scheduler}: the scheduler was lost before all work was done: start it again") from error
        finally:
            client.cancel(list(futures))


def _numbered(function: Callable[[Any], Any], index: int, item: Any) -> tuple[int, Any]:
    return index, function(item)


def _begin(parent: int, *laws: Any) -> None:
    """Prepare a worker process: leave Ctrl-C to the parent, end with it, register laws before the solver is loaded."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with(parent)
    for law in laws:
        register_again(law)


@cache
def end_with(parent: int) -> None:
    """End this process when its parent ends, however that happens: a killed parent closes nothing."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_WATCH)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
