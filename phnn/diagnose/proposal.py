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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from string import ascii_uppercase
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.derivatives import output_derivatives
from phnn.diagnose.linearised import LinearisedFit, tie
from phnn.diagnose.menu import Experiment, menu
from phnn.errors import PhnnError
from phnn.identification.fit import Fit, variables_from
from phnn.identification.nuisances import without_nuisances
from phnn.identification.problem import Problem
from phnn.identification.staged import stated_only
from phnn.identification.variables import Variables
from phnn.recordings.recording import Recording
from phnn.setup import Own
from phnn.simulate import Trajectory, simulate

Array = NDArray[np.float64]


_SUBSTEPS = 2
# Coordinates do not move further than this, a factor of twenty: beyond, a sensitivity at one place says nothing.
FAR = 3.0
# Separations below this are nothing.
_NOTHING = 1e-3
# By this factor a repetition of all recordings at hand shrinks standard errors.
REPEATED = math.sqrt(2.0)
# A recording is not asked for more often.
_OFTEN = 100


class Predicted(NamedTuple):
    """What a model predicts: outputs (N,) [m] and their derivatives (N, K) by its coordinates."""

    y: Array
    moved: Array


class Bench:
    """A recording that does not exist yet, with the simulations of the models that were asked; each fit is simulated
    once.

    Args:
        recording: its input; the output is not read.
    """

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self._known: dict[int, tuple[Fit, Trajectory, Array]] = {}

    def simulated(self, fit: Fit, variables: Variables) -> tuple[Trajectory, Array]:
        """Return the simulation of a fit, and the derivatives (N, K) of the output [m] by all its variables.

        Raises:
            SolverFailed: the model cannot be simulated there.
        """
        if id(fit) not in self._known:
            trajectory = simulate(fit.setup, self.recording, _SUBSTEPS)
            raw = output_derivatives(trajectory, variables.names)
            self._known[id(fit)] = fit, trajectory, variables.columns(fit.setup, self.recording, raw)
        return self._known[id(fit)][1:]


@dataclass(frozen=True, eq=False)
class Rival:
    """A model with what the recordings at hand know of its parameters.

    Attributes:
        name: canonical name of what it has beyond the others, or a formula in words.
        fit: around which it is linear.
        variables: everything that the recordings leave open, also what they do not identify.
        known: (M, K) rows ``J`` with ``‖J δ‖²`` the rise of their sum of squares when its coordinates move by ``δ``.
        own: which of the K coordinates belong to the element in question.
    """

    name: str
    fit: Fit
    variables: Variables
    known: Array
    own: tuple[int, ...]

    @property
    def is_formula(self) -> bool:
        """Whether its name is a formula in words."""
        return " " in self.name

    @property
    def words(self) -> str:
        """Its name in a sentence; a formula in quotation marks."""
        return f"“{self.name}”" if self.is_formula else self.name.replace("_", " ")

    def predicted(self, bench: Bench) -> Predicted:
        """Return output and sensitivities on a recording.

        Raises:
            SolverFailed: it cannot be simulated there.
        """
        trajectory, moved = bench.simulated(self.fit, self.variables)
        return Predicted(trajectory.y, moved)


@dataclass(frozen=True)
class Question:
    """Models of which a recording shall tell the right one.

    Attributes:
        models: the first is the present model; a question with one model asks how large its element's numbers are.
        element: canonical name of the element without a name; empty for a class of effects, or for places.
    """

    models: tuple[Rival, ...]
    element: str = ""


def refitted_rival(name: str, fitted: Fit, parameters: tuple[str, ...] = ()) -> Rival:
    """Return a fit as a rival.

    Args:
        name: of the element; parameters: of it.
        fitted: the fit with the element in its place.
    """
    variables, slopes = everything(fitted)
    own = tuple(i for i, n in enumerate(variables.names) if n in parameters)
    return Rival(name, fitted, variables, bounded(slopes), own)


def everything(fitted: Fit) -> tuple[Variables, Array]:
    """Return all variables that no statement holds, and the derivatives (N, K) of the weighted residual by them."""
    held = [n for n in fitted.held if n not in stated_only(fitted.held)]
    variables = variables_from(fitted.setup, fitted.plan, (*fitted.variables.names, *held), fitted)
    if not held:
        return variables, fitted.jacobian
    problem = Problem(fitted.setup, fitted.plan.coarse(), variables)
    return variables, problem.jacobian(variables.start(fitted.setup))


def bounded(slopes: Array) -> Array:
    """Return the square root (K + K, K) of the rise of the sum of squares, no coordinate beyond `FAR`.

    Args:
        slopes: (N, K) derivatives of the weighted residual.
    """
    return np.concatenate([np.linalg.qr(slopes, mode="r"), np.eye(slopes.shape[1]) / FAR])


@dataclass(frozen=True)
class NextExperiment:
    """A recording to make.

    Attributes:
        recording: all that is needed to make it, in words; experiment: the same for a program.
        separates: models that it tells from another one, by the name of what each has beyond the others; all where it
            tells none apart, and none where it measures.
        why: a sentence with the figures.
        separation: the smallest between models that it tells apart, in noise units over the whole recording; where it
            measures, the factor by which the standard errors of an element's numbers shrink.
        needed: the separation from which two models are told apart; where it measures, the factor that a repetition of
            all recordings at hand would give.
        menu: the smallest separation between any two, or that factor, by recording of the menu.
        aim: ``separate`` or ``measure``.
        groups: ``separates`` by question: a class of effects or places, or one element and what may stand in its place.
    """

    recording: str
    separates: tuple[str, ...]
    why: str
    separation: float
    needed: float
    experiment: Experiment
    menu: Mapping[str, float]
    aim: str = "separate"
    groups: tuple[tuple[str, ...], ...] = ()


def propose(questions: Sequence[Question], linearised: LinearisedFit) -> NextExperiment | None:
    """Return the experiment of the menu that tells most pairs of rivals apart; of several, the clearest.

    None where nothing is asked, or nothing on the menu moves the rivals apart.

    Args:
        questions: pairs are made within each of them.
        linearised: of the base model, for the menu and the noise.
    """
    asked = [q for q in questions if len(q.models) > 1]
    if not asked:
        return _measure(questions[0], linearised) if questions else None
    needed = math.sqrt(max(tie(q.models[0].fit) for q in asked))
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
        why=_why_it_separates(asked, apart, needed),
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
        why=_why_it_measures(question, times, REPEATED),
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
    """Return the separations (P,) of all pairs of every question on an experiment; None where a simulation fails.

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
    """Return ``√min ‖Δ − S δ‖² + ‖J δ‖²`` over ``δ``.

    Args:
        difference: (N,) ``Δ``; moved: (N, K) ``S``; known: (M, K) ``J``.
    """
    design = np.concatenate([moved, known])
    wanted = np.concatenate([difference, np.zeros(known.shape[0])])
    basis = np.linalg.qr(design)[0]
    return float(np.linalg.norm(wanted - basis @ (basis.T @ wanted)))


def shrinks(model: Rival, experiment: Experiment, noise: float) -> float | None:
    """Return the factor by which the standard errors of an element's numbers shrink when an experiment joins the
    recordings at hand; None where the model cannot be simulated there.

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
    """Return ``(det P_ee / det P'_ee)^{1/2m}``, as the module says.

    Args:
        moved: (N, K) ``S``; known: (M, K) ``J``; own: which ``m`` of the K coordinates are ``e``.
    """
    sizes = []
    for rows in (known, np.concatenate([known, moved])):
        root = np.linalg.inv(np.linalg.qr(rows, mode="r"))[list(own)]
        sizes.append(np.linalg.slogdet(root @ root.T)[1])
    return math.exp((sizes[0] - sizes[1]) / (2.0 * len(own)))


def _why_it_separates(questions: Sequence[Question], apart: Array, needed: float) -> str:
    """Which models compete, how far the recording moves them apart, and which it does not tell apart.

    Args:
        apart: (P,) separations of all pairs of models, question by question.
        needed: from where on they are told apart.
    """
    short = _short_names([m for q in questions for m in q.models])
    competing = "".join(f"{_competing(q, short)} " for q in questions if q.element)
    pairs = [f"{short[id(a)]} and {short[id(b)]}" for q in questions for a, b in combinations(q.models, 2)]
    told = [(pair, s) for pair, s in zip(pairs, apart, strict=True) if s >= needed]
    start = f"{competing}With their parameters refitted as far as the recordings at hand allow, the models of "
    end = f"× noise over the whole recording; {_two(needed)} are needed to tell two models apart"
    if not told:
        pair, s = min(zip(pairs, apart, strict=True), key=lambda item: item[1])
        times = math.ceil((needed / s) ** 2) if s > 0.0 else 0
        often = f": make it {times} times" if 0 < times < _OFTEN else ""
        return f"{start}{pair} differ there by {_two(s)} {end}{often}."
    pair, s = min(told, key=lambda item: item[1])
    rest = [pair for pair, value in zip(pairs, apart, strict=True) if value < needed]
    but = f" It does not tell apart {'; '.join(rest)}." if rest else ""
    least = " least: by" if len(told) > 1 else " by"
    return f"{start}{pair} differ there{least} {_two(s)} {end}.{but}"


def _short_names(models: Sequence[Rival]) -> dict[int, str]:
    """What a model is called after it was introduced, by its id: a formula by a letter."""
    letters = iter(ascii_uppercase)
    return {id(m): f"formula {next(letters)}" if m.is_formula else m.words for m in models}


def _competing(question: Question, short: Mapping[int, str]) -> str:
    """What may stand in the place of an element without a name."""
    first, *others = [m.words + f" ({short[id(m)]})" * m.is_formula for m in question.models]
    own = question.element.replace("_", " ")
    element = f"The element {own}" if first == own else f"The element {own}, described as {first},"
    return f"{element} has no proven name: in its place {_listed(others)} explains these recordings nearly as well."


def _why_it_measures(question: Question, times: float, needed: float) -> str:
    """That an element has no rival, and how much the recording says of its numbers.

    Args:
        times: the factor by which their standard errors shrink; needed: what a repetition of all recordings gives.
    """
    model, own = question.models[0], question.element.replace("_", " ")
    element = own if model.words == own else f"{own}, described as {model.words}"
    small = " only" if times < needed else ""
    return (
        f"Nothing else that was tried explains these recordings nearly as well as the element {element}. No two models "
        f"are left to be told apart, so this recording measures the element itself: beside the recordings at hand it "
        f"makes the standard errors of its numbers smaller by a factor of{small} {_two(times)} (geometric mean). To "
        f"repeat all recordings at hand would give {_two(needed)}."
    )


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} or {names[-1]}"


def _two(value: float) -> str:
    """Two digits, and no exponent."""
    return f"{float(f'{value:.2g}'):.10g}"
