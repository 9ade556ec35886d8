"""The interface of executors, and the executors that work inside this process."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from typing import Any

_SHOWN = 120


class Executor(ABC):
    """Applies a function to items somewhere; where must make no difference to the results."""

    @abstractmethod
    def each(self, function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """Pairs of an item's index and ``function(item)`` as they finish.

        What has been handed out is the caller's: keep it, and an interruption costs only what was at work.
        Closing the iterator gives up the rest.

        Args:
            function: of one item; function, items and results must pickle where they leave this process.
            items: what to apply it to.

        Raises:
            Exception: whatever ``function`` raises, as it is; the rest is given up.
        """

    def run(self, function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
        """``[function(item) for item in items]``.

        Raises:
            Exception: whatever ``function`` raises, as it is.
        """
        found = dict(self.each(function, items))
        return [found[i] for i in range(len(items))]


def named(items: Sequence[Any], indices: Iterable[int]) -> str:
    """Items in the words of a message: index and the beginning of what they are."""
    return ", ".join(f"item {i} ({repr(items[i])[:_SHOWN]})" for i in indices)


@dataclass(frozen=True)
class Serial(Executor):
    """One item after the other, here."""

    def each(self, function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """Results in the order of the items; each is computed when it is asked for."""
        for index, item in enumerate(items):
            yield index, function(item)


SERIAL = Serial()


@dataclass(frozen=True)
class Threads(Executor):
    """Threads of this process; worth it where compiled code releases the interpreter lock, as the integration does."""

    workers: int

    def each(self, function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """Results as they finish. A thread cannot be stopped: items at work are finished before a failure passes."""
        pool = ThreadPoolExecutor(self.workers)
        try:
            waiting = {pool.submit(function, item): index for index, item in enumerate(items)}
            for future in as_completed(waiting):
                yield waiting[future], future.result()
        finally:
            pool.shutdown(cancel_futures=True)
