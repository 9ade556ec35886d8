"""The study of a campaign: modes at every amplitude, one model for all, and the elements that explain what moves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from phnn.errors import SolverFailed
from phnn.modal.elements import LINEAR, PortElement, elements
from phnn.modal.experiment import Experiment, Study
from phnn.modal.fit import ModalFit, fit_modes
from phnn.modal.model import ModalModel
from phnn.modal.response import first_modes, response
from phnn.modal.settings import Settings

Array = NDArray[np.float64]

NONE, NAMED, CLASS, UNKNOWN, ONE_LEVEL = "none", "named", "class", "unknown", "one_level"
# One linear model is as good as one for each amplitude up to this factor; elements are named that take away this
# share of what it costs to be linear; a further one must take away this share, and leave less of every experiment.
_AS_GOOD, _EXPLAINS, _FURTHER = 1.1, 0.5, 0.01
# Weights of a further element at the start, over those that it would begin with alone.
_GENTLY = 0.1


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


@dataclass(frozen=True, eq=False)
class Result:
    """A finished study.

    Attributes:
        study: what was studied; alone: a linear model for each amplitude; alone_by: (L,) their errors.
        candidates: one model for all amplitudes each, the linear one first.
        verdict: ``none``, ``named``, ``class``, ``unknown`` or ``one_level``.
        members: models that the verdict cannot tell from each other, the best first.
    """

    study: Study
    alone: tuple[ModalFit, ...]
    alone_by: Array
    candidates: tuple[Candidate, ...]
    verdict: str
    members: tuple[Candidate, ...]

    @property
    def final(self) -> Candidate:
        """The model that stands at the end: the best that is named, otherwise the linear one."""
        return self.members[0] if self.members else self.candidates[0]


def study_modes(
    study: Study, settings: Settings, progress: Callable[[str], None], keep: Callable[[str, ModalFit], None]
) -> Result:
    """Find the modes, fit one model to all amplitudes with each element in turn, add further ones, and judge.

    Args:
        keep: called with every fit as soon as it is finished.
    """
    alone = []
    for number, level in enumerate(study.levels, start=1):
        progress(f"modes at {level[0].amplitude:.3g} {study.units[0]}")
        alone.append(_alone(study, number - 1, settings))
        keep(f"linear_at_level_{number}", alone[-1])
    alone_by = np.array([np.sqrt((_left(f, study, i, settings) ** 2).mean()) for i, f in enumerate(alone)])
    candidates: list[Candidate] = []

    def tried(model: ModalModel) -> Candidate:
        progress(f"one model for all amplitudes: {model.element.name}")
        candidates.append(_candidate(study, model, settings))
        keep(model.element.name, candidates[-1].fit)
        return candidates[-1]

    first = tried(_normalised(alone[0].model))
    if len(alone) > 1 and not _serves(first, alone_by):
        available = elements(settings.stops)
        start = _normalised(alone[0].model)
        best = min((tried(_with(start, e, study)) for e in available), key=lambda c: c.error)
        while rest := [e for e in available if e.names[0] not in best.element.names]:
            further = min((tried(_with(best.fit.model, e, study)) for e in rest), key=lambda c: c.error)
            if not _worth(further, best, first):
                break
            best = further
    verdict, members = judged(candidates, alone_by)
    return Result(study, tuple(alone), alone_by, tuple(candidates), verdict, members)


def judged(candidates: Sequence[Candidate], alone_by: Array) -> tuple[str, tuple[Candidate, ...]]:
    """The verdict, and the models that it names, the best first.

    A further element counts where it is worth its room; models of one size belong to one class unless the best one
    leaves less of every single experiment.

    Args:
        candidates: the linear one first; alone_by: (L,) errors of a linear model for each amplitude.
    """
    if alone_by.size == 1:
        return ONE_LEVEL, ()
    linear = candidates[0]
    if _serves(linear, alone_by):
        return NONE, ()
    best = min((c for c in candidates if len(c.element.names) == 1), key=lambda c: c.error)
    for size in range(2, 1 + max(len(c.element.names) for c in candidates)):
        further = min((c for c in candidates if len(c.element.names) == size), key=lambda c: c.error)
        if not _worth(further, best, linear):
            break
        best = further
    apart = float((alone_by**2).mean())
    if linear.error**2 - best.error**2 < _EXPLAINS * (linear.error**2 - apart):
        return UNKNOWN, ()
    kin = [c for c in candidates if len(c.element.names) == len(best.element.names)]
    lowest = np.concatenate(best.left)
    members = [c for c in kin if c is best or (np.concatenate(c.left) <= lowest).any()]
    members.sort(key=lambda c: c.error)
    return (NAMED if len(members) == 1 else CLASS), tuple(members)


def _worth(further: Candidate, best: Candidate, linear: Candidate) -> bool:
    """Whether a model with one more element is better for more than its freedom."""
    everywhere = bool((np.concatenate(further.left) < np.concatenate(best.left)).all())
    return everywhere and best.error**2 - further.error**2 >= _FURTHER * linear.error**2


def _serves(linear: Candidate, alone_by: Array) -> bool:
    return linear.error <= _AS_GOOD * float(np.sqrt((alone_by**2).mean()))


def _alone(study: Study, level: int, settings: Settings) -> ModalFit:
    fitted = study.identification(level)
    found = first_modes(study, response(fitted))
    none = np.zeros((len(study.inputs), 0))
    delay = np.full(len(study.outputs), found.delay * study.dt)
    model = ModalModel(found.omega, found.zeta, found.b, delay, LINEAR, none, none)
    few = fitted[: max(settings.experiments, len(study.inputs))]
    return fit_modes(model, few, study, settings.iterations, settings.workers)


def _normalised(model: ModalModel) -> ModalModel:
    """With ratios of size one for every mode: a linear fit does not see how strongly ports are joined to it."""
    return replace(model, b=model.b / np.linalg.norm(model.b, axis=1)[:, None])


def _with(model: ModalModel, element: PortElement, study: Study) -> ModalModel:
    """A model with an element more at every port, too weak yet to matter much at any amplitude."""
    (low, _), (x, v) = (_extension(model, study.identification(i)[0], study.dt) for i in (0, -1))
    k, thresholds = element.start(1.0 / (model.b**2).sum(axis=0), x, v), element.thresholds(low)
    if not model.element.names:
        return replace(model, element=element, k=k, thresholds=thresholds)
    return replace(
        model,
        element=model.element + element,
        k=np.hstack([model.k, _GENTLY * k]),
        thresholds=np.hstack([model.thresholds, thresholds]),
    )


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
    """Experiments of identification that no model for all amplitudes was fitted to; the fitted ones where none are."""
    found = study.identification(level)
    return found[settings.experiments :] or found


def _left(fit: ModalFit, study: Study, level: int, settings: Settings) -> Array:
    """What a model leaves of each experiment that chooses, over what was measured; all where it cannot be marched."""

    def share(e: Experiment) -> float:
        try:
            return float(np.sqrt((fit.errors(e) ** 2).sum() / (e.y**2).mean(axis=0).sum()))
        except SolverFailed:
            return np.inf

    return np.array([share(e) for e in _choosing(study, level, settings)])
