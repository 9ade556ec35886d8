"""The next recording: the one of a menu on which rival models differ most, whatever their parameters.

Models ``a`` and ``b`` compete for one tie or one element. On a new recording, if ``a`` is right, ``b`` fails to explain

    min over δ of  ‖Δ − S δ‖² + ‖J δ‖²,    Δ = (y_a − y_b)/σ without the zero of the recording

to first order: ``S`` are the sensitivities of ``b`` on the new recording and ``J`` those on the recordings at hand, so
that its parameters, base and effect, move only within what these allow. This is the expected difference of the sums of
squares of a joint refit; its root is the separation in noise units. The smaller of both directions counts.

Where an element has no rival, a recording is asked for the element's own numbers ``e``: with the covariances
``P = (JᵀJ)⁻¹`` and ``P' = (JᵀJ + SᵀS)⁻¹`` without and with it, their standard errors shrink by

    (det P_ee / det P'_ee)^{1/2m}

in the geometric mean over the ``m`` numbers, all other coordinates free. A repetition of all recordings at hand gives
√2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from phnn.criteria import SELECTION
from phnn.diagnose.linearised import LinearisedFit
from phnn.diagnosis.following import NextExperiment, why_it_measures, why_it_separates
from phnn.diagnosis.menu import Experiment, menu
from phnn.diagnosis.questions import Question
from phnn.diagnosis.rival import Bench, Predicted, Rival
from phnn.diagnosis.trial import tie
from phnn.errors import PhnnError
from phnn.identification.nuisances import without_nuisances
from phnn.setup import Own

Array = NDArray[np.float64]

_NOTHING = 1e-3
# By this factor a repetition of all recordings at hand shrinks standard errors.
REPEATED = math.sqrt(2.0)


def propose(
    questions: Sequence[Question], linearised: LinearisedFit, variances: float = SELECTION.tie
) -> NextExperiment | None:
    """The experiment of the menu that tells most pairs of rivals apart; of several, the one that does so most clearly.

    None where nothing is asked, or nothing on the menu moves the rivals apart.

    Args:
        questions: pairs are made within each of them.
        linearised: of the base model, for the menu and the noise.
        variances: difference of χ² in residual variances below which two fits are equally good.
    """
    asked = [q for q in questions if len(q.models) > 1]
    if not asked:
        return _measure(questions[0], linearised) if questions else None
    needed = math.sqrt(max(tie(q.models[0].fit, variances) for q in asked))
    noise = linearised.scales.noise
    found = [(e, s) for e in menu(linearised) if (s := separations([q.models for q in asked], e, noise)) is not None]
    if not found:
        return None
    experiment, apart = max(found, key=lambda item: _merit(item[1], needed))
    if apart.max() < _NOTHING:
        return None
    groups = _groups(asked, apart, needed)
    return NextExperiment(
        recording=experiment.words,
        separates=tuple(dict.fromkeys(n for group in groups for n in group)),
        why=why_it_separates(asked, apart, needed),
        separation=_merit(apart, needed)[1],
        needed=needed,
        experiment=experiment,
        menu={e.kind: float(s.min()) for e, s in found},
        groups=groups,
    )


def _groups(asked: Sequence[Question], apart: Array, needed: float) -> tuple[tuple[str, ...], ...]:
    """Names of the models that are told from another one, by question; all where no two are told apart."""
    least = needed if apart.max() >= needed else 0.0
    groups, first = [], 0
    for question in asked:
        pairs = list(combinations([m.name for m in question.models], 2))
        told = {n for pair, s in zip(pairs, apart[first:], strict=False) if s >= least for n in pair}
        groups.append(tuple(dict.fromkeys(m.name for m in question.models if m.name in told)))
        first += len(pairs)
    return tuple(g for g in groups if g)


def _merit(apart: Array, needed: float) -> tuple[int, float]:
    """How many pairs are told apart, and the smallest separation of those; of all where there are none."""
    told = apart[apart >= needed]
    return told.size, float(told.min() if told.size else apart.min())


def _measure(question: Question, linearised: LinearisedFit) -> NextExperiment | None:
    """The experiment of the menu on which the standard errors of an element's numbers shrink most."""
    model, noise = question.models[0], linearised.scales.noise
    found = [(e, s) for e in menu(linearised) if (s := shrinks(model, e, noise)) is not None]
    if not found:
        return None
    experiment, times = max(found, key=lambda item: item[1])
    if times < 1.0 + _NOTHING:
        return None
    return NextExperiment(
        recording=experiment.words,
        separates=(),
        why=why_it_measures(question, times, REPEATED),
        separation=times,
        needed=REPEATED,
        experiment=experiment,
        menu={e.kind: s for e, s in found},
        aim="measure",
    )


def _weighted(values: Array, bench: Bench, own: Own, noise: float) -> Array:
    recording = bench.recording
    return without_nuisances(values, recording.mask("identification"), recording, own) / noise


def separations(questions: Sequence[Sequence[Rival]], experiment: Experiment, noise: float) -> Array | None:
    """(P,) separations of all pairs of every question on an experiment; None where a model cannot be simulated there.

    Args:
        noise: standard deviation of the output's noise [m].
    """
    bench, apart = Bench(experiment.recording(noise, questions[0][0].fit.plan.recordings[0].units)), []
    for rivals in questions:
        owns = [r.fit.setup.own for r in rivals]
        own = Own(tuple(dict.fromkeys(f for o in owns for f in o.lines)), max(o.drift_terms for o in owns))
        try:
            raw = [r.predicted(bench) for r in rivals]
        except PhnnError:
            return None
        found = [Predicted(*(_weighted(x, bench, own, noise) for x in each)) for each in raw]
        for a, b in combinations(range(len(rivals)), 2):
            difference = found[a].y - found[b].y
            apart.append(min(left(difference, found[i].moved, rivals[i].known) for i in (a, b)))
    return np.array(apart)


def left(difference: Array, moved: Array, known: Array) -> float:
    """``√min ‖Δ − S δ‖² + ‖J δ‖²`` over ``δ``.

    Args:
        difference: (N,) ``Δ``; moved: (N, K) ``S``; known: (M, K) ``J``.
    """
    design = np.concatenate([moved, known])
    wanted = np.concatenate([difference, np.zeros(known.shape[0])])
    basis = np.linalg.qr(design)[0]
    return float(np.linalg.norm(wanted - basis @ (basis.T @ wanted)))


def shrinks(model: Rival, experiment: Experiment, noise: float) -> float | None:
    """By what factor the standard errors of an element's numbers shrink when an experiment joins the recordings at
    hand; None where the model cannot be simulated there.

    Args:
        noise: standard deviation of the output's noise [m].
    """
    bench = Bench(experiment.recording(noise, model.fit.plan.recordings[0].units))
    try:
        found = model.predicted(bench)
    except PhnnError:
        return None
    return shrinkage(_weighted(found.moved, bench, model.fit.setup.own, noise), model.known, model.own)


def shrinkage(moved: Array, known: Array, own: Sequence[int]) -> float:
    """``(det P_ee / det P'_ee)^{1/2m}``, as the module says.

    Args:
        moved: (N, K) ``S``; known: (M, K) ``J``; own: which ``m`` of the K coordinates are ``e``.
    """
    sizes = []
    for rows in (known, np.concatenate([known, moved])):
        root = np.linalg.inv(np.linalg.qr(rows, mode="r"))[list(own)]
        sizes.append(np.linalg.slogdet(root @ root.T)[1])
    return math.exp((sizes[0] - sizes[1]) / (2.0 * len(own)))
