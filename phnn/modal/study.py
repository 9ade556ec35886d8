"""The study of a campaign: modes at every amplitude, one model for all, and the elements that explain what moves.

The verdict says what moves with amplitude, in the words of `phnn.diagnose`. ``none``: one linear model serves, or there
is one amplitude alone. ``named``: one combination of elements explains what moves. ``equivalent``: several do, and the
recordings cannot tell which. ``unknown``: no element explains half of it; the best model that helps is kept and its
elements are described.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.configuration import check, whole
from phnn.errors import SolverFailed
from phnn.modal.elements import LINEAR, PortElement, elements
from phnn.modal.experiment import Experiment, Study, first_modes
from phnn.modal.fit import ModalFit, fit_modes
from phnn.modal.model import ModalModel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Settings:
    """The keys of ``configs/modes.yaml``.

    Attributes:
        experiments: of each amplitude that are fitted; the others of identification choose between elements.
        iterations: derivatives of a fit; stops: of a hysteron element; workers: threads.
    """

    experiments: int = whole(2, least=1)
    iterations: int = whole(40, least=1)
    stops: int = whole(8, least=1)
    workers: int = whole(2, least=1)

    def __post_init__(self) -> None:
        check(self)

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> Settings:
        """From the composed configuration."""
        return cls(**{n: config[n] for n in cls.__dataclass_fields__})


NONE, NAMED, EQUIVALENT, UNKNOWN = "none", "named", "equivalent", "unknown"
# Of an element that stays in the model without a name; of one that is not even there.
DESCRIBED, PROVISIONAL = "described", "provisional"
# One linear model is as good as one for each amplitude up to this factor; elements are named that take away this
# share of what it costs to be linear; a further one must take away this share, and leave less of every experiment.
_AS_GOOD, _EXPLAINS, _FURTHER = 1.1, 0.5, 0.01
# What there is to explain is at least this share of what the linear model leaves.
_LEAST = 1e-3


@dataclass(frozen=True, eq=False)
class Candidate:
    """One model for all amplitudes.

    Attributes:
        fit: the fitted model.
        left: by amplitude, what it leaves of each experiment that chooses, over what was measured.
    """

    fit: ModalFit
    left: tuple[Array, ...]

    @property
    def element(self) -> PortElement:
        """What its ports have."""
        return self.fit.model.element

    @property
    def by_level(self) -> Array:
        """(L,) mean over the experiments of an amplitude."""
        return np.array([np.sqrt((x**2).mean()) for x in self.left])

    @property
    def error(self) -> float:
        """All amplitudes together."""
        return float(np.sqrt((self.by_level**2).mean()))


def judged(candidates: Sequence[Candidate], alone_by: Array) -> tuple[str, tuple[Candidate, ...], float | None]:
    """The verdict, the models that it is about, and the share that is explained; see `Result`.

    A further element counts where it is worth its room; models of one size belong to one class unless the best one
    leaves less of every single experiment.

    Args:
        candidates: the linear one first; alone_by: (L,) errors of a linear model for each amplitude.
    """
    linear = candidates[0]
    if alone_by.size == 1 or serves(linear, alone_by):
        return NONE, (), None
    best = linear
    for size in range(1, 1 + max(len(c.element.names) for c in candidates)):
        further = min((c for c in candidates if len(c.element.names) == size), key=lambda c: c.error, default=best)
        if worth(further, best, linear):
            best = further
    # One linear model may leave less over all amplitudes and more at one of them.
    wanted = max(linear.error**2 - float((alone_by**2).mean()), _LEAST * linear.error**2)
    share = (linear.error**2 - best.error**2) / wanted
    if best is linear or share < _EXPLAINS:
        return UNKNOWN, () if best is linear else (best,), share
    kin = [c for c in candidates if len(c.element.names) == len(best.element.names)]
    lowest = np.concatenate(best.left)
    members = [c for c in kin if c is best or (np.concatenate(c.left) <= lowest).any()]
    members.sort(key=lambda c: c.error)
    return NAMED if len(members) == 1 else EQUIVALENT, tuple(members), share


def worth(further: Candidate, best: Candidate, linear: Candidate) -> bool:
    """Whether a model with one more element is better for more than its freedom."""
    everywhere = bool((np.concatenate(further.left) < np.concatenate(best.left)).all())
    return everywhere and best.error**2 - further.error**2 >= _FURTHER * linear.error**2


def serves(linear: Candidate, alone_by: Array) -> bool:
    """Whether one linear model is as good as one for each amplitude."""
    return bool((linear.by_level <= _AS_GOOD * alone_by).all())


@dataclass(frozen=True)
class Score:
    """Errors of a model on some experiments.

    Attributes:
        rmse: (O,) root mean square error of each output over all recorded periods, in the outputs' unit.
        share: of all outputs together, over the effective value of what was measured.
    """

    rmse: list[float]
    share: float


@dataclass(frozen=True)
class HeldOut:
    """Scores of one model; None where nothing is held out, or where a step of the model has no solution.

    Attributes:
        levels: on the held-out realisations of each fitted amplitude.
        apart: at each amplitude that is held out as a whole.
    """

    levels: tuple[Score | None, ...]
    apart: tuple[Score | None, ...]

    @property
    def all(self) -> tuple[Score | None, ...]:
        """Of the fitted amplitudes, then of the others."""
        return self.levels + self.apart


def held_out_scores(fit: ModalFit, study: Study) -> HeldOut:
    """Score a model on everything that is held out."""
    levels = tuple(_score(fit, study.held_out(i)) for i in range(len(study.levels)))
    return HeldOut(levels, tuple(_score(fit, level) for level in study.apart))


def _score(fit: ModalFit, held: Sequence[Experiment]) -> Score | None:
    if not held:
        return None
    try:
        errors = np.mean([fit.errors(e) ** 2 for e in held], axis=0)
    except SolverFailed:
        return None
    measured = np.mean([(e.y**2).mean(axis=0) + e.spread**2 for e in held], axis=0)
    return Score(np.sqrt(errors).tolist(), float(np.sqrt(errors.sum() / max(measured.sum(), 1e-300))))


# Weights of a further element at the start, over those that it would begin with alone.
_GENTLY = 0.1


@dataclass(frozen=True, eq=False)
class Result:
    """A finished study.

    Attributes:
        study: what was studied; alone: a linear model for each amplitude; alone_by: (L,) their errors.
        candidates: one model for all amplitudes each, the linear one first.
        verdict: ``none``, ``named``, ``equivalent`` or ``unknown``.
        members: models that the verdict cannot tell from each other, the best first; where it is ``unknown``, the best
            model if one helps. Empty where the linear model stands.
        share_explained: of the squared error that one linear model leaves beyond one for each amplitude; None where
            there is nothing to explain. Above 1 where the model is better than those.
        failed: models that could not be integrated.
        held_out: by fit, the scores on what is held out.
        fitted_choose: whether, at some amplitude, there was nothing to choose by but what was fitted.
    """

    study: Study
    alone: tuple[ModalFit, ...]
    alone_by: Array
    candidates: tuple[Candidate, ...]
    verdict: str
    members: tuple[Candidate, ...]
    share_explained: float | None
    failed: tuple[str, ...]
    held_out: Mapping[ModalFit, HeldOut]
    fitted_choose: bool

    @property
    def final(self) -> Candidate:
        """The model that stands at the end, with or without a name: the best, or the linear one."""
        return self.members[0] if self.members else self.candidates[0]


def study_modes(
    study: Study, settings: Settings, progress: Callable[[str], None], keep: Callable[[str, ModalFit], None]
) -> Result:
    """Find the modes, fit one model to all amplitudes with each element in turn, add and take away, and judge.

    Args:
        keep: called with every fit as soon as it is finished.
    """
    alone = []
    for number, level in enumerate(study.levels, start=1):
        progress(f"modes at {level[0].amplitude:.3g} {study.units[0]}")
        alone.append(_alone(study, number - 1, settings))
        keep(f"linear_at_level_{number}", alone[-1])
    alone_by = np.array([np.sqrt((_left(f, study, i, settings) ** 2).mean()) for i, f in enumerate(alone)])
    search = _Search(study, settings, progress, keep)
    # Ratios of size one for every mode: a linear fit does not see how strongly ports are joined to it.
    b = alone[0].model.b
    start = replace(alone[0].model, b=b / np.linalg.norm(b, axis=1)[:, None])
    first = search.tried(start)
    if first is None:
        raise SolverFailed("the linear model of the lowest amplitude cannot be integrated: look at its recordings")
    if len(alone) > 1 and not serves(first, alone_by):
        search.grow(start, first)
    few = any(set(_choosing(study, i, settings)) == set(study.identification(i)) for i in range(len(alone)))
    candidates = tuple(search.found.values())
    verdict = judged(candidates, alone_by)
    # Nothing is decided behind this line.
    held = {fit: held_out_scores(fit, study) for fit in (*alone, *(c.fit for c in candidates))}
    return Result(study, tuple(alone), alone_by, candidates, *verdict, tuple(search.failed), held, few)


class _Search:
    """Forward selection with backward deletion; of models with the same elements the best is kept.

    Attributes:
        found: by the elements' names; failed: models that could not be integrated.
    """

    def __init__(
        self, study: Study, settings: Settings, progress: Callable[[str], None], keep: Callable[[str, ModalFit], None]
    ) -> None:
        self.study, self.settings, self.progress, self.keep = study, settings, progress, keep
        self.found: dict[frozenset[str], Candidate] = {}
        self.failed: list[str] = []

    def tried(self, model: ModalModel) -> Candidate | None:
        """Fit from here and return the best model with these elements so far; None if none can be integrated."""
        self.progress(f"one model for all amplitudes: {model.element.name}")
        names = frozenset(model.element.names)
        try:
            new = _candidate(self.study, model, self.settings)
        except SolverFailed:
            self.failed.append(model.element.name)
            return self.found.get(names)
        if names not in self.found or new.error < self.found[names].error:
            self.found[names] = new
            self.keep(model.element.name, new.fit)
        return self.found[names]

    def grow(self, start: ModalModel, linear: Candidate) -> None:
        """Add what helps most as long as something does, and take away what no longer helps beside it."""
        available = elements(self.settings.stops)
        best = linear
        while rest := [e for e in available if e.names[0] not in best.element.names]:
            begin = best.fit.model if best.element.names else start
            tried = [t for t in (self.tried(_with(begin, e, self.study)) for e in rest) if t is not None]
            further = min(tried, key=lambda c: c.error, default=best)
            if further is best or (best.element.names and not worth(further, best, linear)):
                return
            for name in best.element.names:
                fewer = self.tried(_without(further.fit.model, name))
                if fewer is not None and not worth(further, fewer, linear):
                    further = fewer
            if further.element.names == best.element.names:
                return
            best = further


def _alone(study: Study, level: int, settings: Settings) -> ModalFit:
    fitted = study.identification(level)
    found = first_modes(study, fitted)
    none = np.zeros((len(study.inputs), 0))
    delay = np.full(len(study.outputs), found.delay * study.dt)
    model = ModalModel(found.omega, found.zeta, found.b, delay, LINEAR, none, none)
    few = fitted[: max(settings.experiments, len(study.inputs))]
    return fit_modes(model, few, study, settings.iterations, settings.workers)


def _with(model: ModalModel, element: PortElement, study: Study) -> ModalModel:
    """A model with an element more at every port, too weak yet to matter much at any amplitude."""
    (low, _), (x, v) = (_extension(model, study.identification(i)[0], study.dt) for i in (0, -1))
    k, thresholds = element.start(1.0 / (model.b**2).sum(axis=0), x, v), low[:, None] * element.reach
    if not model.element.names:
        return replace(model, element=element, k=k, thresholds=thresholds)
    return replace(
        model,
        element=model.element + element,
        k=np.hstack([model.k, _GENTLY * k]),
        thresholds=np.hstack([model.thresholds, thresholds]),
    )


def _without(model: ModalModel, name: str) -> ModalModel:
    """A model less one effect at its ports."""
    kept = ~model.element.parts_of(name)
    return replace(model, element=model.element.without(name), k=model.k[:, kept], thresholds=model.thresholds[:, kept])


def _extension(model: ModalModel, experiment: Experiment, dt: float) -> tuple[Array, Array]:
    """(P,) effective extension of the ports and its rate."""
    seen = model.seen(experiment, dt)
    x = seen.q @ model.b
    found = [np.fft.irfft(y, len(experiment.u), axis=0).std(axis=0) for y in (x, seen.s[:, None] * x)]
    return found[0], found[1]


def _candidate(study: Study, model: ModalModel, settings: Settings) -> Candidate:
    levels = range(len(study.levels))
    fitted = [e for i in levels for e in study.identification(i)[: settings.experiments]]
    fit = fit_modes(model, fitted, study, settings.iterations, settings.workers)
    return Candidate(fit, tuple(_left(fit, study, i, settings) for i in levels))


def _choosing(study: Study, level: int, settings: Settings) -> tuple[Experiment, ...]:
    """Experiments of identification that no model was fitted to; the fitted ones where there are no others."""
    found = study.identification(level)
    return found[max(settings.experiments, len(study.inputs)) :] or found


def _left(fit: ModalFit, study: Study, level: int, settings: Settings) -> Array:
    """Error over measurement for each experiment that chooses; 1 if the model cannot be integrated."""

    def share(e: Experiment) -> float:
        try:
            return float(np.sqrt((fit.errors(e) ** 2).sum() / (e.y**2).mean(axis=0).sum()))
        except SolverFailed:
            return np.inf

    return np.array([share(e) for e in _choosing(study, level, settings)])
