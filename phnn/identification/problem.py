"""The weighted residual of a setup on a campaign, and its derivatives.

    r = (y − ŷ(θ) − zero − nuisances) / σ     over the samples of one use, recording by recording

The displacement zero and the nuisances of the setup (lines, slow drift) enter linearly; they are projected out of
residual and derivatives (variable projection), so that no optimiser sees them. Initial states of recordings with an
unknown start are variables beside ``θ``, and so are the instants at which an input jumps between two samples. An
initial state has a prior, see `phnn.identification.begun`: what the samples do not show of it stays near to what the
model knows of its own motion. Samples at a limit of the sensor are censored (`phnn.identification.nuisances`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phnn.derivatives import output_derivatives
from phnn.errors import SolverFailed
from phnn.identification.nuisances import beyond_limit, without_nuisances
from phnn.identification.plan import Plan
from phnn.identification.variables import Variables
from phnn.recordings.recording import Recording
from phnn.setup import Setup
from phnn.trajectory import Trajectory, simulate

Array = NDArray[np.float64]

_FAILED = 1e6
# Simulations that take about as long as the derivatives of one by a variable, and by a few of them.
_DERIVATIVE, _FEW = 0.5, 4.0
# Weight of the present value of an instant, where the output of a seen jump weighs hundreds.
_WEAK = 1e-3


class Problem:
    """Residual and Jacobian for `scipy.optimize.least_squares`.

    The last trajectories and the last derivatives are kept: an optimiser ends where it has been, and what it found is
    asked for once more there.
    """

    def __init__(self, template: Setup, plan: Plan, variables: Variables, use: str = "identification") -> None:
        self.template = template
        self.plan = plan
        self.variables = variables
        self.use = use
        self.masks = [r.mask(use) for r in plan.recordings]
        timed = sum(x.size for x in variables.instants.values())
        self._weak = np.append(
            np.zeros(len(variables.names) + len(variables.unknown) * variables.scales.size), np.full(timed, _WEAK)
        )
        self._marched: tuple[bytes | None, list[Trajectory]] = (None, [])
        self._differentiated: tuple[bytes | None, list[Array]] = (None, [])

    def trajectories(self, z: Array) -> list[Trajectory]:
        """Simulations at ``z``."""
        if self._marched[0] != z.tobytes():
            setup = self.variables.setup(self.template, z)

            def run(recording: Recording) -> Trajectory:
                initial, timed = self.variables.initial(recording, z), self.variables.timed(recording, z)
                return simulate(setup, timed, self.plan.steps_of(recording), initial=initial)

            self._marched = z.tobytes(), self.plan.each(run, simulations=1.0)
        return self._marched[1]

    def residual(self, z: Array) -> Array:
        """(N,) weighted residual."""
        if self._differentiated[0] == z.tobytes():
            return np.concatenate([both[:, -1] for both in self._differentiated[1]])
        found = self.trajectories(z)
        return np.concatenate([weighted_residual(t, m) for t, m in zip(found, self.masks, strict=True)])

    def jacobian(self, z: Array) -> Array:
        """(N, K) derivatives of the residual by ``z``."""
        return np.concatenate([both[:, :-1] for both in self._with_derivatives(z)])

    def size(self, z: Array) -> Array:
        """(K+1,) the residual turned into the last of a few coordinates, where `slopes` are its derivatives.

        If an optimiser needs only products of the two, a step is evaluated without sensitivities.
        """
        turned = np.zeros(z.size + 1)
        length = self._length(z) if self.variables.can_begin(z) else np.inf
        # The optimiser needs numbers: what cannot be, or cannot be simulated, is far from any optimum.
        turned[-1] = length if np.isfinite(length) else _FAILED * np.sqrt(self.samples)
        return turned

    def _length(self, z: Array) -> float:
        """Root of the sum of squares of residual and prior; infinite where ``z`` cannot be simulated."""
        try:
            return float(np.hypot(np.linalg.norm(self.residual(z)), np.linalg.norm(self.variables.prior(z)[:, -1])))
        except SolverFailed:
            return np.inf

    def slopes(self, z: Array) -> Array:
        """(K+1, K) the Jacobian in the coordinates of `size`: the same gradient and normal matrix in a small square.

        Factored recording by recording and then together, so that no tall matrix is ever assembled.
        """
        squares = self.plan.each(lambda _, both: np.linalg.qr(both, mode="r"), self._with_derivatives(z))
        # A jump outside the samples that are fitted has no derivative; an optimiser crawls on a singular matrix.
        stacked = np.concatenate([*squares, self.variables.prior(z), np.diag(np.append(self._weak, 0.0))])
        square = np.asarray(np.linalg.qr(stacked, mode="r"))
        if not np.isfinite(square).all():
            raise SolverFailed("the derivatives of the output are not finite; narrow the bounds of the parameters")
        # A reflection takes the residual's column to the last axis; from its far side, or else digits would cancel.
        square[-1, -1] = -abs(square[-1, -1])
        normal, slopes = square[:, -1] - self.size(z), square[:, :-1]
        length = float(normal @ normal)
        return slopes - np.outer(normal, 2.0 / length * (normal @ slopes)) if length > 0.0 else slopes

    @property
    def samples(self) -> int:
        """How many samples are scored."""
        return sum(int(m.sum()) for m in self.masks)

    def _with_derivatives(self, z: Array) -> list[Array]:
        """(N_r, K+1) derivatives of the residual of every recording, and the residual."""
        if self._differentiated[0] != z.tobytes():
            found, setup = self.trajectories(z), self.variables.setup(self.template, z)

            def one(recording: Recording, trajectory: Trajectory, mask: Array) -> Array:
                initial = range(self.variables.scales.size) if recording.name in self.variables.unknown else ()
                instants = recording.name in self.variables.instants
                raw = output_derivatives(trajectory, self.variables.names, tuple(initial), instants=instants)
                columns = self.variables.columns(setup, recording, raw)
                both = np.column_stack([columns, trajectory.y - recording.y])
                hidden = beyond_limit(recording, trajectory.y, mask, setup.own)
                inside = without_nuisances(both, mask, recording, setup.own, hidden)
                inside /= -recording.noise
                return inside

            count = max(_FEW, _DERIVATIVE * z.size)
            self._differentiated = z.tobytes(), self.plan.each(one, found, self.masks, simulations=count)
        return self._differentiated[1]


def weighted_residual(trajectory: Trajectory, mask: Array) -> Array:
    """``(y − ŷ)/σ`` on the masked samples without what zero and nuisances explain."""
    recording = trajectory.recording
    error, own = recording.y - trajectory.y, trajectory.setup.own
    hidden = beyond_limit(recording, trajectory.y, mask, own)
    return without_nuisances(error, mask, recording, own, hidden) / recording.noise
