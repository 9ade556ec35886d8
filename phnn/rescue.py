"""Work in parts, of which one that fails, or comes too late, is left out and told; what was finished stays.

| call | of what | left out where |
|---|---|---|
| `attempt` | one model: a start, a refit, a model without an element | it cannot be simulated, or its fit raises |
| `move` | a move of the search | it fails, which ends the search; time is up; the user interrupts |
| `extra` | what an answer can do without: a formula, the next recording | it fails; time is up; the user interrupts |
| `needed` | what every answer has: scores, tables, figures; time is no matter | it fails; the user interrupts |

Each returns what stands in place of the result. Without `accounted` around them they only call the function, and
`attempt` passes over models that cannot be simulated. What cannot be written (`phnn.errors.OutputRefused`,
`phnn.errors.OutputFailed`) is never passed over. With ``PHNN_DEBUG`` set nothing is passed over but models that cannot
be simulated.
"""

from __future__ import annotations

import os
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from phnn.errors import InputRefused, OutputFailed, OutputRefused, PhnnError

if TYPE_CHECKING:
    from phnn.parallel import Executor

T = TypeVar("T")

_STRICT = "PHNN_DEBUG"
# Items of work that are begun at a time, at least: on one core as on two, for the same answer; from which share of the
# budget on.
_SIDE, _NEARLY = 2, 0.6
_PACKAGE = Path(__file__).resolve().parent
NOTHING_LEFT, EVALUATIONS, SECONDS = "nothing left", "evaluations", "seconds"
INTERRUPTED, FAILURE = "interrupted", "failure"


class Stopped(BaseException):
    """The time is up. It passes all handlers of errors, so that a whole move is given up."""


@dataclass(frozen=True)
class Failure:
    """A part that failed.

    Attributes:
        part: what was to be done; candidate: name of the effect that was refitted, if one was.
        error: type of the exception; message: its text; where: file, line and function of the package.
    """

    part: str
    candidate: str
    error: str
    message: str
    where: str


@dataclass(frozen=True)
class Ended:
    """How a search ended, and what is missing in its answer.

    Attributes:
        why: ``nothing left``, ``evaluations``, ``seconds``, ``interrupted`` or ``failure``.
        not_tried: moves that were given up or not begun.
        failed: models that could not be simulated or fitted; they were no candidates.
        warnings: parts that failed otherwise, or that the answer lacks.
        budget: seconds that there were; None without a bound.
        evaluations: what was spent, see `allow`.
        interruption: what interrupted it, to be raised again when the answer is written.
    """

    why: str = NOTHING_LEFT
    not_tried: tuple[str, ...] = ()
    failed: tuple[Failure, ...] = ()
    warnings: tuple[Failure, ...] = ()
    budget: float | None = None
    evaluations: float = 0.0
    interruption: KeyboardInterrupt | None = field(default=None, compare=False)

    @property
    def early(self) -> bool:
        """Return whether something was left to try."""
        return self.why != NOTHING_LEFT


class Account:
    """What has failed and what was not tried so far.

    Attributes:
        until: time of day [s since the epoch] at which moves are given up.
        answers: an interruption ends the search with an answer; otherwise it ends everything.
        spent: steps of all simulations so far; unit: steps of one evaluation; most: evaluations that may be spent.
        stopped: why no further move is begun; empty while they are.
        among: this is one of several items of work side by side; above: the account of all of them, in threads.
    """

    def __init__(self, until: float = float("inf"), checked: bool = False, answers: bool = False) -> None:
        self.until = until
        self.answers = answers
        self.unit = self.most = float("inf")
        self.spent, self.stopped = 0.0, ""
        self.interruption: KeyboardInterrupt | None = None
        self.failed: list[Failure] = []
        self.warnings: list[Failure] = []
        self.not_tried: list[str] = []
        self.among = self._lost = False
        self.above: Account | None = None
        self.checked = checked

    def ended(self, budget: float | None = None) -> Ended:
        """Return all of it."""
        why = self.stopped or (FAILURE if self._lost else NOTHING_LEFT)
        untried, bad, warnings = tuple(dict.fromkeys(self.not_tried)), tuple(self.failed), tuple(self.warnings)
        return Ended(why, untried, bad, warnings, budget, self.evaluations, self.interruption)

    @property
    def evaluations(self) -> float:
        """Return what was spent so far, see `allow`; 0 where nothing is bounded."""
        return self.spent / self.unit

    @property
    def used_up(self) -> bool:
        """Return whether the allowed evaluations are spent."""
        return self.evaluations >= self.most

    def run(self, part: str, work: Callable[[], T], otherwise: T, checked: bool, ends: bool) -> T:
        """Return the result of a part; ``otherwise`` where it failed or was stopped.

        Args:
            checked: it may be stopped when the time is up.
            ends: its failure ends the search.
        """
        before, self.checked = self.checked, checked
        try:
            return work()
        except Stopped:
            self.stopped = self.stopped or SECONDS
            self.not_tried.append(part)
        except KeyboardInterrupt as interruption:
            self.interrupt(interruption, part)
        except (OutputRefused, OutputFailed):
            raise
        except Exception as error:
            if os.environ.get(_STRICT):
                raise
            self.warnings.append(_failure(part, error))
            self._lost |= ends
        finally:
            self.checked = before
        return otherwise

    def interrupt(self, interruption: KeyboardInterrupt, part: str) -> None:
        """Let an interruption end the search with an answer; a second one, or one without an answer, is raised."""
        if self.interruption is not None or not self.answers:
            raise interruption
        self.interruption = interruption.with_traceback(None)
        self.stopped = self.stopped or INTERRUPTED
        self.not_tried.append(part)


_ACCOUNT: ContextVar[Account | None] = ContextVar("account", default=None)


@contextmanager
def accounted(until: float = float("inf"), checked: bool = False, answers: bool = False) -> Iterator[Account]:
    """Keep an `Account` of all parts until the end of the block; ``checked``: the block itself is part of a move."""
    account = Account(until, checked, answers)
    token = _ACCOUNT.set(account)
    try:
        # Models on the way may lie beyond all bounds.
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            yield account
    finally:
        _ACCOUNT.reset(token)


def deadline(budget: float | None) -> float:
    """Return the time of day [s since the epoch] at which a budget of seconds is used up.

    Raises:
        InputRefused: it is no positive number.
    """
    if budget is not None and not budget > 0.0:
        raise InputRefused(f"budget: {budget:g} s: give a positive number of seconds")
    return float("inf") if budget is None else time.time() + budget


def stop_if_late() -> None:
    """Give up the present move where its time is up; called before all recordings are simulated.

    Raises:
        Stopped: it is.
    """
    account = _ACCOUNT.get()
    if account is None or not account.checked or account.stopped:
        return
    if time.time() > account.until or (account.above is not None and account.above.stopped):
        raise Stopped


def spend(steps: float) -> None:
    """Count the steps of simulations."""
    account = _ACCOUNT.get()
    if account is not None:
        account.spent += steps


def allow(evaluations: float, unit: float) -> None:
    """Bound what may be spent.

    Args:
        evaluations: simulations that may be done, those before among them; unit: steps of one.
    """
    account = _ACCOUNT.get()
    if account is not None:
        account.most, account.unit = evaluations, unit


def spent() -> float:
    """Return the share of the allowed evaluations that was spent so far."""
    account = _ACCOUNT.get()
    return 0.0 if account is None else account.evaluations / account.most


def used_up() -> bool:
    """Return whether a move has spent what it may: a fit then ends where it is."""
    account = _ACCOUNT.get()
    return account is not None and account.checked and account.used_up


def untried() -> int:
    """Return how many parts were left out so far because the search had ended."""
    account = _ACCOUNT.get()
    return 0 if account is None else len(account.not_tried)


def late(part: str) -> bool:
    """Return whether the search is stopped or its budget used up, so that no part or move after it is begun."""
    account = _ACCOUNT.get()
    if account is None:
        return False
    if not account.stopped:
        if time.time() <= account.until and not account.used_up:
            return False
        account.stopped = EVALUATIONS if time.time() <= account.until else SECONDS
    account.not_tried.append(part)
    return True


def attempt(part: str, work: Callable[[], T], otherwise: T) -> T:
    """Return what one model gives; ``otherwise`` where it cannot be simulated, or its fit raises."""
    account = _ACCOUNT.get()
    try:
        return work()
    except PhnnError as error:
        if account is not None:
            account.failed.append(_failure(part, error))
    except Exception as error:
        if account is None or os.environ.get(_STRICT):
            raise
        account.warnings.append(_failure(part, error))
    return otherwise


def move(part: str, work: Callable[[], T], otherwise: T) -> T:
    """Return what a move of the search gives; ``otherwise`` where it fails, or time is up."""
    return extra(part, work, otherwise, ends=True)


def extra(part: str, work: Callable[[], T], otherwise: T, ends: bool = False) -> T:
    """Return what a part gives that an answer can do without; ``otherwise`` where it fails, or time is up.

    ``ends``: its failure ends the search.
    """
    account = _ACCOUNT.get()
    if account is None:
        return work()
    if account.stopped:
        account.not_tried.append(part)
        return otherwise
    return account.run(part, work, otherwise, checked=True, ends=ends)


def needed(part: str, work: Callable[[], T], otherwise: T, ends: bool = False) -> T:
    """Return what a part of every answer gives; ``otherwise`` where it fails.

    Args:
        ends: its failure ends the search.
    """
    account = _ACCOUNT.get()
    return work() if account is None else account.run(part, work, otherwise, checked=False, ends=ends)


class _Result(NamedTuple):
    """What became of an item, wherever it was at work; ended: why before its time, empty where it was not."""

    result: Any
    ended: str
    spent: float
    failed: Sequence[Failure]
    warnings: Sequence[Failure]


def results(executor: Executor, work: Callable[[Any], Any], items: Sequence[Any], names: Sequence[str]) -> list[Any]:
    """Return ``work(item)`` of every item, done by an executor; None where an item failed, or the search was ended.

    An item spends at most what is left of the budget, side by side with others half of it. Near its end no more items
    are begun at a time than two, or than there are workers, so that it ends between them.

    Args:
        executor: where it is done; work: on one item.
        items: candidates; names: of their effects.
    """
    account = _ACCOUNT.get()
    if account is None:
        return executor.run(work, items)
    finished: list[Any] = [None] * len(items)
    if not items or (account.checked and account.stopped):
        return finished
    # Threads share those of the recordings, so that the last item has all of them.
    threads, until = executor.kind == "threads", account.until if account.checked else float("inf")
    among = not threads and executor.kind != "serial" and len(items) > 1
    above = account if account.checked and threads else None
    side = max(_SIDE, executor.workers) if account.evaluations > _NEARLY * account.most else len(items)

    def answers() -> Iterator[tuple[int, _Result]]:
        for first in range(0, len(items), side):
            if first and account.checked and late(", ".join(names[first:])):
                return
            budget = account.most * account.unit - account.spent if account.checked else float("inf")
            one = partial(_one, work, until, budget / min(len(items), _SIDE), among, above)
            for place, answer in executor.each(one, items[first : first + side]):
                yield first + place, answer

    try:
        for index, answer in answers():
            named = {"candidate": names[index]}
            account.failed += [Failure(**(vars(f) | named)) for f in answer.failed]
            account.warnings += [Failure(**(vars(f) | named)) for f in answer.warnings]
            account.spent += answer.spent
            finished[index] = answer.result
            if answer.ended:
                account.not_tried.append(names[index])
            if answer.ended == SECONDS:
                account.stopped = account.stopped or SECONDS
    except KeyboardInterrupt as interruption:
        account.interrupt(interruption, "refits of " + ", ".join(names))
    except PhnnError as error:
        # Workers that were killed; all other items are done.
        account.failed.append(_failure("refit", error))
    return finished


def _one(
    work: Callable[[Any], Any], until: float, steps: float, among: bool, above: Account | None, item: Any
) -> _Result:
    """Return one item, accounted for by itself: it may be at work in another process."""
    with accounted(until, checked=True) as account:
        account.among, account.above = among, above
        allow(steps, 1.0)
        try:
            result = attempt("refit", partial(work, item), None)
            ended = EVALUATIONS if account.used_up else ""
        except Stopped:
            result, ended = None, SECONDS
    return _Result(result, ended, account.spent, account.failed, account.warnings)


def among_others() -> bool:
    """Return whether this work is one of several items side by side, whose own threads would get in their way."""
    account = _ACCOUNT.get()
    return account is not None and account.among


def warnings() -> tuple[Failure, ...]:
    """Return the parts that have failed so far."""
    account = _ACCOUNT.get()
    return () if account is None else tuple(account.warnings)


def documents(failures: Sequence[Failure]) -> list[Mapping[str, Any]]:
    """Return the failures for a json file, equal ones once with their number."""
    return [vars(failure) | {"times": times} for failure, times in Counter(failures).items()]


def _failure(part: str, error: Exception) -> Failure:
    """Return what is told of an exception; its frames, which hold all recordings, are let go."""
    passed = [f for f in traceback.extract_tb(error.__traceback__) if Path(f.filename) != Path(__file__)]
    last = [*passed, *(f for f in passed if Path(f.filename).resolve().is_relative_to(_PACKAGE))][-1]
    place = Path(last.filename)
    place = place.resolve().relative_to(_PACKAGE.parent) if place.resolve().is_relative_to(_PACKAGE) else place
    return Failure(part, "", type(error).__name__, str(error), f"{place.as_posix()}:{last.lineno} {last.name}")
