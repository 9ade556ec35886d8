"""The next recording: the one of a menu on which the members of a class differ most, whatever their parameters.

Members ``a`` and ``b`` are refitted models that the recordings at hand cannot tell apart. On a new recording, if ``a``
is right, ``b`` fails to explain

    min over δ of  ‖Δ − S δ‖² + ‖J δ‖²,    Δ = (y_a − y_b)/σ without the zero of the recording

to first order: ``S`` are the sensitivities of ``b`` on the new recording and ``J`` those on the recordings at hand, so
that its parameters, base and effect, move only within what these allow. This is the expected difference of the sums of
squares of a joint refit; its root is the separation in noise units. The smaller of both directions counts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from phnn.derivatives import output_derivatives
from phnn.diagnose.criteria import SELECTION
from phnn.diagnose.ground import Ground
from phnn.diagnose.menu import Experiment, menu
from phnn.diagnose.trial import Trial, tie
from phnn.errors import PhnnError
from phnn.identify.fit import Fit, variables_from
from phnn.identify.nuisances import without_nuisances
from phnn.identify.problem import Problem, Variables
from phnn.identify.staged import stated_only
from phnn.recall import recalled
from phnn.setup import Own
from phnn.simulate import simulate

Array = NDArray[np.float64]

_SUBSTEPS = 2
# Coordinates do not move further than this, a factor of twenty: beyond, a sensitivity at one place says nothing.
_FAR = 3.0
_NOTHING = 1e-3


@dataclass(frozen=True)
class NextExperiment:
    """A recording to make.

    Attributes:
        recording: all that is needed to make it, in words; experiment: the same for a program.
        separates: members of the class that it tells from another one; all where it tells none apart.
        why: a sentence with the figures.
        separation: the smallest between members that it tells apart, in noise units over the whole recording.
        needed: the separation from which two models are told apart.
        menu: the smallest separation between any two members, by recording of the menu.
    """

    recording: str
    separates: tuple[str, ...]
    why: str
    separation: float
    needed: float
    experiment: Experiment
    menu: Mapping[str, float]


@recalled
def propose(members: Sequence[Trial], ground: Ground, variances: float = SELECTION.tie) -> NextExperiment | None:
    """The experiment of the menu that tells most pairs of members apart; of several, the one that does so most clearly.

    None where there is no class, or nothing on the menu moves its members apart.

    Args:
        variances: difference of χ² in residual variances below which two fits are equally good.
    """
    fitted = [(t.candidate.effect.name, t.fit) for t in members if t.fit is not None]
    if len(fitted) < 2:
        return None
    rivals = [_rival(f) for _, f in fitted]
    needed = math.sqrt(tie(fitted[0][1], variances))
    found = [(e, s) for e in menu(ground) if (s := separations(rivals, e, ground.scales.noise)) is not None]
    if not found:
        return None
    experiment, apart = max(found, key=lambda item: _merit(item[1], needed))
    if apart.max() < _NOTHING:
        return None
    pairs = list(combinations([name for name, _ in fitted], 2))
    told = [pair for pair, s in zip(pairs, apart, strict=True) if s >= needed]
    names = tuple(n for n, _ in fitted if not told or any(n in pair for pair in told))
    separation = _merit(apart, needed)[1]
    return NextExperiment(
        recording=experiment.words,
        separates=names,
        why=_why(pairs, apart, needed),
        separation=separation,
        needed=needed,
        experiment=experiment,
        menu={e.kind: float(s.min()) for e, s in found},
    )


def _merit(apart: Array, needed: float) -> tuple[int, float]:
    """How many pairs are told apart, and the smallest separation of those; of all where there are none."""
    told = apart[apart >= needed]
    return told.size, float(told.min() if told.size else apart.min())


def _why(pairs: Sequence[tuple[str, str]], apart: Array, needed: float) -> str:
    told = [(pair, s) for pair, s in zip(pairs, apart, strict=True) if s >= needed]
    start = "With their parameters refitted as far as the recordings at hand allow, the models of "
    end = f"× noise over the whole recording; {_two(needed)} are needed to tell two models apart"
    if not told:
        pair, s = min(zip(pairs, apart, strict=True), key=lambda item: item[1])
        times = math.ceil((needed / s) ** 2) if s > 0.0 else 0
        often = f": make it {times} times" if 0 < times < 100 else ""
        return f"{start}{_both(pair)} differ there by {_two(s)} {end}{often}."
    pair, s = min(told, key=lambda item: item[1])
    rest = [_both(pair) for pair, value in zip(pairs, apart, strict=True) if value < needed]
    but = f" It does not tell apart {'; '.join(rest)}." if rest else ""
    least = " least: by" if len(told) > 1 else " by"
    return f"{start}{_both(pair)} differ there{least} {_two(s)} {end}.{but}"


def _both(pair: tuple[str, str]) -> str:
    return " and ".join(name.replace("_", " ") for name in pair)


def _two(value: float) -> str:
    """Two digits, and no exponent."""
    return f"{float(f'{value:.2g}'):.10g}"


@dataclass(frozen=True, eq=False)
class Rival:
    """A refitted model with what the recordings at hand know of its parameters.

    Attributes:
        variables: everything that they leave open, also what they do not identify.
        known: (M, K) rows ``J`` with ``‖J δ‖²`` the rise of their sum of squares.
    """

    fit: Fit
    variables: Variables
    known: Array


def _rival(fitted: Fit) -> Rival:
    held = [n for n in fitted.held if n not in stated_only(fitted.held)]
    variables = variables_from(fitted.setup, fitted.plan, (*fitted.variables.names, *held), fitted)
    j = fitted.jacobian
    if held:
        problem = Problem(fitted.setup, fitted.plan.coarse(), variables)
        j = problem.jacobian(variables.start(fitted.setup))
    return Rival(fitted, variables, np.concatenate([np.linalg.qr(j, mode="r"), np.eye(j.shape[1]) / _FAR]))


def separations(rivals: Sequence[Rival], experiment: Experiment, noise: float) -> Array | None:
    """(P,) separations of all pairs on an experiment; None where one of the models cannot be simulated there.

    Args:
        noise: standard deviation of the output's noise [m].
    """
    recording = experiment.recording(noise)
    everything = recording.mask("identification")
    owns = [r.fit.setup.own for r in rivals]
    own = Own(tuple(dict.fromkeys(f for o in owns for f in o.lines)), max(o.courses for o in owns))

    def weighted(values: Array) -> Array:
        return without_nuisances(values, everything, recording, own) / noise

    outputs, moved = [], []
    for r in rivals:
        try:
            trajectory = simulate(r.fit.setup, recording, _SUBSTEPS)
        except PhnnError:
            return None
        raw = output_derivatives(trajectory, r.variables.names)
        outputs.append(weighted(trajectory.y))
        moved.append(weighted(r.variables.columns(r.fit.setup, recording, raw)))
    pairs = combinations(range(len(rivals)), 2)
    return np.array(
        [
            min(left(outputs[a] - outputs[b], moved[i], rivals[i].known) for i in (a, b))
            for a, b in pairs
        ]
    )  # fmt: skip


def left(difference: Array, moved: Array, known: Array) -> float:
    """``√min ‖Δ − S δ‖² + ‖J δ‖²`` over ``δ``.

    Args:
        difference: (N,) ``Δ``; moved: (N, K) ``S``; known: (M, K) ``J``.
    """
    design = np.concatenate([moved, known])
    wanted = np.concatenate([difference, np.zeros(known.shape[0])])
    basis = np.linalg.qr(design)[0]
    return float(np.linalg.norm(wanted - basis @ (basis.T @ wanted)))
