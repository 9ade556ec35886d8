"""Worker processes on this machine, with nothing lost when one of them is killed.

The pool is loky's. A dead worker breaks it, and with it everything that was at work; no pool says which item was to
blame. So no more items are handed out than there are workers, and what was at work is done again in a fresh pool:
after a second time alone, where the blame is certain.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from functools import cache
from typing import Any

from loky import get_reusable_executor
from loky.process_executor import TerminatedWorkerError

from phnn.ensemble.local import Executor, named
from phnn.errors import SolverFailed
from phnn.laws.identity import register_again, registered_outside
from phnn.threads import ONE_THREAD

_ALONE_AFTER, _KILLS = 2, 3
# Idle workers leave after so many seconds; until then the next call finds them with everything imported.
_IDLE = 60.0
_WATCH = 1.0


@dataclass(frozen=True)
class Processes(Executor):
    """Processes of this machine with one torch, BLAS and numba thread each."""

    workers: int

    def each(self, function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """Results as they finish; closing the iterator kills what is at work.

        Raises:
            SolverFailed: items that killed their worker three times, the last time with nothing else at work; raised
                when all others are done.
        """
        # Unfinished items, and how many workers have died while they were at work.
        deaths = dict.fromkeys(range(len(items)), 0)
        while pending := [i for i, count in deaths.items() if count < _KILLS]:
            together = [i for i in pending if deaths[i] < _ALONE_AFTER]
            for index, result in self._until_killed(function, items, together or pending[:1], deaths):
                del deaths[index]
                yield index, result
        if deaths:
            raise SolverFailed(
                f"{named(items, deaths)}: killed the worker {_KILLS} times; the machine has probably run out of "
                "memory: use fewer workers (executor=processes:N) or executor=serial"
            )

    def _until_killed(
        self, function: Callable[[Any], Any], items: Sequence[Any], chosen: Sequence[int], deaths: dict[int, int]
    ) -> Iterator[tuple[int, Any]]:
        """Results of the chosen items until a worker dies; that counts against every item at work."""
        pool = get_reusable_executor(
            self.workers,
            timeout=_IDLE,
            initializer=_begin,
            initargs=(os.getpid(), *registered_outside()),
            env=ONE_THREAD,
        )
        waiting = deque(chosen)
        running: dict[Future[Any], int] = {}
        try:
            while waiting or running:
                while waiting and len(running) < self.workers:
                    index = waiting.popleft()
                    running[pool.submit(function, items[index])] = index
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    result = future.result()
                    yield running.pop(future), result
        except TerminatedWorkerError:
            for future in list(running):
                if isinstance(future.exception(), TerminatedWorkerError):
                    deaths[running.pop(future)] += 1
            for future in list(running):
                result = future.result()
                yield running.pop(future), result
        finally:
            if running:
                pool.shutdown(kill_workers=True)


def _begin(parent: int, *laws: Any) -> None:
    """What a worker does first: leave Ctrl-C to the parent, end with it, register laws before the solver is loaded."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with(parent)
    for law in laws:
        register_again(law)


@cache
def end_with(parent: int) -> None:
    """End this process when its parent ends, however that happens."""
    threading.Thread(target=_watch, args=(parent,), daemon=True).start()


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_WATCH)
    # A killed parent closes nothing: its workers would go on with work that nobody waits for.
    os._exit(1)
