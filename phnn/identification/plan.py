"""The effort of an identification and a diagnosis, and the plan of a fit: recordings, and the steps of simulations."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextvars import copy_context
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

from phnn.configuration import check, positive, whole
from phnn.recordings.recording import Recording
from phnn.rescue import among_others, spend, stop_if_late
from phnn.setup import Setup


@dataclass(frozen=True)
class Options:
    """How hard to try; the keys of the configuration files.

        phnn.diagnose(campaign, phnn.Options(starts=2, executor="processes:2"))

    Attributes:
        seed: of every random draw.
        starts: starting points of the nonlinear stage per resonance.
        error_bound_sigma: bound on the numerical error over the plan, in standard deviations.
        max_effects: how many elements a diagnosis may add.
        evaluations: what a diagnosis may spend, in simulations of 300,000 steps; derivatives by eight variables count
            as four simulations; a step of a modulated or of a general network counts more often.
        without: effects of the catalogue that a diagnosis must not use.
        criteria: values of `phnn.criteria.Criteria` that replace the defaults, by name.
        workers: threads of a fit.
        executor: where the refits of a diagnosis are done, for choices see `phnn.parallel.executor`; anywhere
            but in ``serial`` each refit has one thread.

    Raises:
        InputRefused: a number is of the wrong kind or out of range.
    """

    seed: int = whole(0)
    starts: int = whole(4, least=1)
    error_bound_sigma: float = positive(1.0)
    max_effects: int = whole(4)
    evaluations: int = whole(4000, least=1)
    without: tuple[str, ...] = ()
    criteria: Mapping[str, float] = field(default_factory=dict)
    workers: int = whole(2, least=1)
    executor: str = "serial"

    def __post_init__(self) -> None:
        check(self)

    @classmethod
    def from_config(cls, config: Any) -> Options:
        """From a mapping such as a hydra configuration; keys it lacks keep their defaults."""
        given = {n: config[n] for n in cls.__dataclass_fields__ if n in config}
        wholes = {n: kind(given[n]) for n, kind in {"without": tuple, "criteria": dict}.items() if n in given}
        return cls(**(given | wholes))


@dataclass(frozen=True)
class Plan:
    """Which recordings are simulated how.

    Attributes:
        recordings: those that take part.
        substeps: by recording name.
        workers: threads; the compiled integration releases the interpreter lock.
        anchors: standard deviations [SI] of parameters known from elsewhere, by name; what is estimated beside a held
            anchor inherits its uncertainty.
        rough: derivatives are taken at every few samples, see `derived`; the residual never is.
    """

    recordings: tuple[Recording, ...]
    substeps: Mapping[str, int] = field(default_factory=dict)
    workers: int = 2
    anchors: Mapping[str, float] = field(default_factory=dict)
    rough: bool = False

    def steps_of(self, recording: Recording) -> int:
        """Return the sub-steps of a recording, 1 where nothing was chosen."""
        return self.substeps.get(recording.name, 1)

    @property
    def finest(self) -> int:
        """Return the most sub-steps of any recording."""
        return max((self.steps_of(r) for r in self.recordings), default=1)

    @property
    def inputs(self) -> tuple[float, float]:
        """Return the least and the largest input of the recordings, SI."""
        return min(float(r.u.min()) for r in self.recordings), max(float(r.u.max()) for r in self.recordings)

    @property
    def size(self) -> int:
        """Return the steps of one simulation of all recordings."""
        return sum(r.t.size * self.steps_of(r) for r in self.recordings)

    def each(self, function: Callable[..., Any], *sequences: Sequence[Any], simulations: float = 0.0) -> list[Any]:
        """Apply a function to every recording (and matching entries of the sequences), in threads.

        Args:
            simulations: of a recording to which the work of the function amounts; they are counted.

        Raises:
            Stopped: the time of a search is up.
        """
        stop_if_late()
        if simulations:
            spend(simulations * self.size)
        tasks = list(zip(self.recordings, *sequences, strict=True))
        if self.workers < 2 or len(tasks) < 2 or among_others():
            return [function(*task) for task in tasks]
        # The longest first: one that comes last would leave the other threads idle.
        order = sorted(range(len(tasks)), key=lambda i: -self.recordings[i].t.size * self.steps_of(self.recordings[i]))
        # What numpy warns of is a matter of the caller.
        waiting = {i: _threads(self.workers).submit(copy_context().run, function, *tasks[i]) for i in order}
        try:
            # All are awaited before the first failure is passed on: none may work on behind the caller's back.
            wait(waiting.values())
        except BaseException:
            for task in waiting.values():
                task.cancel()
            raise
        return [waiting[i].result() for i in range(len(tasks))]

    def coarse(self) -> Plan:
        """Return the same recordings with a quarter of the sub-steps and rough derivatives, for first evaluations."""
        return replace(self, substeps={r.name: max(1, self.steps_of(r) // 4) for r in self.recordings}, rough=True)

    def derived(self, setup: Setup) -> Plan:
        """Return the recordings of which derivatives are taken: where these may be rough, at as few samples as show
        their inputs, unless the setup has sources of its own, which may be faster."""
        if not self.rough or setup.sources:
            return self
        return replace(self, recordings=tuple(r.sparse for r in self.recordings))


@cache
def _threads(count: int) -> ThreadPoolExecutor:
    """Return the threads that are kept: a fit asks for them a thousand times."""
    return ThreadPoolExecutor(count)
