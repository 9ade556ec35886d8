"""Models that compete for one mismatch: what each predicts on a new recording, and what is known of its parameters."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.derivatives import output_derivatives
from phnn.identification.fit import Fit, variables_from
from phnn.identification.problem import Problem
from phnn.identification.staged import stated_only
from phnn.identification.variables import Variables
from phnn.recordings.recording import Recording
from phnn.simulate import Trajectory, simulate

Array = NDArray[np.float64]

_SUBSTEPS = 2
# Coordinates do not move further than this, a factor of twenty: beyond, a sensitivity at one place says nothing.
FAR = 3.0


class Simulated(NamedTuple):
    """A fit on a new recording.

    Attributes:
        trajectory: its simulation.
        moved: (N, K) derivatives of the output [m] by all variables of the fit.
    """

    trajectory: Trajectory
    moved: Array


class Bench:
    """A recording that does not exist yet, with the simulations of the models that were asked; each fit is simulated
    once.

    Args:
        recording: its input; the output is not read.
    """

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self._known: dict[int, tuple[Fit, Simulated]] = {}

    def simulated(self, fit: Fit, variables: Variables) -> Simulated:
        """A fit with its sensitivities.

        Raises:
            SolverFailed: the model cannot be simulated there.
        """
        if id(fit) not in self._known:
            trajectory = simulate(fit.setup, self.recording, _SUBSTEPS)
            raw = output_derivatives(trajectory, variables.names)
            self._known[id(fit)] = fit, Simulated(trajectory, variables.columns(fit.setup, self.recording, raw))
        return self._known[id(fit)][1]


class Predicted(NamedTuple):
    """What a model predicts: outputs (N,) [m] and their derivatives (N, K) by its coordinates."""

    y: Array
    moved: Array


@dataclass(frozen=True, eq=False)
class Rival(ABC):
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

    @abstractmethod
    def predicted(self, bench: Bench) -> Predicted:
        """Output and sensitivities on a recording.

        Raises:
            SolverFailed: it cannot be simulated there.
        """


class RefittedRival(Rival):
    """A model that was fitted with the element in its place."""

    def predicted(self, bench: Bench) -> Predicted:
        """See `Rival.predicted`."""
        found = bench.simulated(self.fit, self.variables)
        return Predicted(found.trajectory.y, found.moved)


def refitted_rival(name: str, fitted: Fit, parameters: tuple[str, ...] = ()) -> RefittedRival:
    """A fit as a rival.

    Args:
        name: of the element.
        fitted: the fit with it.
        parameters: of the element.
    """
    variables, slopes = everything(fitted)
    own = tuple(i for i, n in enumerate(variables.names) if n in parameters)
    return RefittedRival(name, fitted, variables, bounded(slopes), own)


def everything(fitted: Fit) -> tuple[Variables, Array]:
    """All variables that no statement holds, and the derivatives (N, K) of the weighted residual by them."""
    held = [n for n in fitted.held if n not in stated_only(fitted.held)]
    variables = variables_from(fitted.setup, fitted.plan, (*fitted.variables.names, *held), fitted)
    if not held:
        return variables, fitted.jacobian
    problem = Problem(fitted.setup, fitted.plan.coarse(), variables)
    return variables, problem.jacobian(variables.start(fitted.setup))


def bounded(slopes: Array) -> Array:
    """(K + K, K) square root of the rise of the sum of squares, no coordinate beyond `FAR`.

    Args:
        slopes: (N, K) derivatives of the weighted residual.
    """
    return np.concatenate([np.linalg.qr(slopes, mode="r"), np.eye(slopes.shape[1]) / FAR])
