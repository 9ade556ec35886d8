"""The linearised fit: the fitted base model with its residual, trajectories and Jacobian."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from phnn.diagnose.lines import Response, Spectra, spectra_of
from phnn.effects import Effect, Scales
from phnn.effects.places import values_by_role
from phnn.errors import SolverFailed
from phnn.identification.fit import Fit, carried
from phnn.identification.plan import Plan
from phnn.identification.problem import without_nuisances
from phnn.network.roles import output_gain
from phnn.recordings.recording import Recording, dominant_frequency
from phnn.trajectory import Trajectory, measured_network, simulate

Array = NDArray[np.float64]

# Difference of χ² in residual variances below which two fits are equally good: 3.5 standard deviations of a parameter.
TIE = 12.0
# Sub-steps from which on directions are fine enough.
_ENOUGH = 8


@dataclass(frozen=True)
class LinearisedFit:
    """A fit with its trajectories.

    Attributes:
        fit: residual and Jacobian are stacked over the identification samples of ``fit.plan``.
        trajectories: of the recordings in the plan, in order.
        scales: sizes from which dictionaries and effects take their grids.
    """

    fit: Fit
    trajectories: tuple[Trajectory, ...]
    scales: Scales

    @property
    def plan(self) -> Plan:
        """Return the recordings and sub-steps."""
        return self.fit.plan

    @cached_property
    def basis(self) -> Array:
        """Return (N, K) orthonormal basis of what base parameters and nuisances explain to first order."""
        jacobian = self.fit.jacobian
        # What moves nothing, such as a jump outside the samples that are fitted, spans no direction.
        return np.linalg.qr(jacobian[:, np.any(jacobian != 0.0, axis=0)])[0]

    @cached_property
    def residual(self) -> Array:
        """Return (N,) residual without what the base could still explain."""
        return self.project(self.fit.residual)

    def project(self, columns: Array) -> Array:
        """Return columns without their part in the span of the base sensitivities."""
        basis = self.basis
        share, out = basis.T @ columns, np.empty_like(columns)
        # Recording by recording: a copy of everything at once costs more than the arithmetic.
        for rows in self.slices:
            np.matmul(basis[rows], share, out=out[rows])
            np.subtract(columns[rows], out[rows], out=out[rows])
        return out

    def stack(self, outputs: Sequence[Array]) -> Array:
        """Return changes of the outputs, one array a recording, as weighted columns without nuisances."""
        nuisances = self.fit.setup.own
        rows = [
            without_nuisances(o, r.mask("identification"), r, nuisances, hidden) / r.noise
            for o, r, hidden in zip(outputs, self.plan.recordings, self.hidden, strict=True)
        ]
        return np.concatenate(rows)

    @cached_property
    def hidden(self) -> list[NDArray[np.bool_] | None]:
        """By recording the samples that sit at a limit of the sensor while the model lies beyond it: their residual is
        zero. None where the sensor has no limit."""
        by_recording: list[NDArray[np.bool_] | None] = []
        for r, rows in zip(self.plan.recordings, self.slices, strict=True):
            if not r.sensor.is_limited:
                by_recording.append(None)
                continue
            hidden, mask = r.sensor.at_limit(r.y) != 0, r.mask("identification")
            hidden[mask] &= self.fit.residual[rows] == 0.0
            by_recording.append(hidden & mask)
        return by_recording

    @cached_property
    def coarse_outputs(self) -> list[Array]:
        """Return the outputs with the coarse sub-steps, the origin of finite changes."""
        return [t.y for t in simulated(self.fit, self.plan.coarse())]

    @cached_property
    def sparse_outputs(self) -> list[Array]:
        """Return the same at as few samples as show the inputs."""
        return [t.y for t in simulated(self.fit, self.plan.coarse().derived(self.fit.setup))]

    @property
    def spectra(self) -> Spectra:
        """Of the residual; not kept, for the frequencies may be many."""
        by_force = [self.response(r) for r in self.plan.recordings]
        return spectra_of([self.residual[rows] for rows in self.slices], self.plan.recordings, by_force)

    def response(self, recording: Recording) -> Response:
        """Return the response of the recorded output to a force on the network about rest, by its stated sensor."""
        network, sensor = measured_network(self.fit.setup.network, recording), recording.sensor

        def found(f: Array) -> Array:
            rate = 2.0 * np.pi * f
            return output_gain(network, f) * rate**sensor.derivative / np.hypot(1.0, rate * sensor.lag)

        return found

    @property
    def slices(self) -> list[slice]:
        """Return the rows of every recording in the stacked arrays."""
        return self.fit.slices


def prepare(fit: Fit) -> LinearisedFit:
    """Simulate the fitted model on its plan and take the scales."""
    trajectories = simulated(fit, fit.plan)
    linearised = LinearisedFit(fit, trajectories, scales_of(fit, trajectories))
    return replace(linearised, scales=replace(linearised.scales, peaks=linearised.spectra.peaks))


def with_few_steps(linearised: LinearisedFit, plan: Plan) -> LinearisedFit:
    """Return the same with sub-steps that are fine enough for directions."""
    steps = {r.name: min(_ENOUGH, plan.steps_of(r)) for r in plan.recordings}
    return replace(linearised, fit=replace(linearised.fit, plan=replace(linearised.fit.plan, substeps=steps)))


def simulated(fit: Fit, plan: Plan) -> tuple[Trajectory, ...]:
    """Return the trajectories of a fitted model in the recordings of a plan."""

    def one(recording: Recording) -> Trajectory:
        return simulate(fit.setup, recording, plan.steps_of(recording), initial=fit.initial(recording.name))

    return tuple(plan.each(one, simulations=1.0))


def scales_of(fit: Fit, trajectories: Sequence[Trajectory]) -> Scales:
    """Return the sizes met in the recordings."""
    recordings = fit.plan.recordings
    frequencies = [f for r in recordings if (f := dominant_frequency(r)) > 0.0]
    known = values_by_role(fit.setup.network)
    return Scales(
        voltage=max(float(np.abs(r.u).max()) for r in recordings),
        displacement=max(float(np.abs(t.mid_displacement).max()) for t in trajectories),
        velocity=max(float(np.quantile(np.abs(t.velocity), 0.999)) for t in trajectories),
        # A spring that is there for the position alone has no stiffness to measure forces in.
        stiffness=known.get("k") or 1.0,
        transducer=known.get("alpha", 1.0),
        slowest=min(frequencies),
        fastest=max(frequencies),
        duration=max(float(r.t[-1]) for r in recordings),
        noise=float(np.median([r.noise for r in recordings])),
        effort=max(float(np.ptp(t.y)) for t in trajectories) if fit.setup.network.senses else 0.0,
    )


def direction(linearised: LinearisedFit, effect: Effect, values: Mapping[str, float]) -> Array:
    """Return the weighted change (N,) of the output by an effect; zero where the changed model cannot be simulated."""
    setup = effect.add_to(linearised.fit.setup, values)
    coarse = linearised.plan.coarse()
    plan = coarse.derived(setup)
    base = linearised.coarse_outputs if plan is coarse else linearised.sparse_outputs

    def one(sparse: Recording, recording: Recording, before: Array) -> Array:
        initial = linearised.fit.initial(recording.name)
        if initial is not None:
            initial = carried(initial, linearised.fit.setup, setup, np.zeros(len(setup.network.state_names)))
        return recording.from_sparse(simulate(setup, sparse, plan.steps_of(sparse), initial=initial).y - before)

    try:
        return linearised.stack(plan.each(one, coarse.recordings, base, simulations=1.0))
    except SolverFailed:
        return np.zeros(linearised.fit.residual.size)


def tie(fitted: Fit) -> float:
    """Return the difference of sums of squares below which two refits are not told apart."""
    # Coloured noise inflates such differences by the sum of its correlation.
    colour = max(max(1.0, 2.0 * float(np.sum(r.noise_correlation)) - 1.0) for r in fitted.plan.recordings)
    return TIE * colour * max(1.0, fitted.chi2)
