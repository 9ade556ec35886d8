"""The response of the output to a force on the moving part, and the residual that a formula has to explain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phnn.derivatives import output_derivatives
from phnn.diagnose.linearised import LinearisedFit
from phnn.effects import Effect
from phnn.laws import RESISTOR_LAWS, STORAGE_LAWS
from phnn.recordings.recording import Recording
from phnn.setup import Setup
from phnn.simulate import Trajectory

Array = NDArray[np.float64]
Columns = Callable[[Array, Array], Array]  # (n,) displacements, (n,) velocities -> (n, F) forces


def element_force(setup: Setup, element: Effect, q: Array, v: Array) -> Array:
    """(n,) force [N] with which an element of a setup resists, at displacements ``q`` and velocities ``v`` (n,).

    Args:
        setup: with the element; its storages and resistors are those that take the element's strengths.
    """
    values, mine = setup.values(), set(element.strengths)
    force = np.zeros_like(q)
    for s in (s for s in setup.network.storages if mine & set(s.parameters)):
        force += np.asarray(STORAGE_LAWS[s.law].mean_effort(q, q, *(values[n] for n in s.parameters)))
    for r in (r for r in setup.network.resistors if mine & set(r.parameters)):
        read = q if r.modulated_by else 0.0 * q
        force += np.asarray(RESISTOR_LAWS[r.law].flow(v, read, *(values[n] for n in r.parameters)))
    return force


@dataclass(frozen=True)
class Target:
    """What the data say of a learned force, to first order around the fit that has it.

    A force ``f`` in its place, with base parameters shifted by ``z``, leaves ``wanted − columns(f) − base z``.

    Attributes:
        linearised: of the fit with the element.
        base: (N, K) derivatives of the output by all variables of the fit but the element's strengths.
        names: (K,) of these; a number for an initial state or an instant.
        wanted: (N,) the residual, and the response to the learned force.
        basis: (N, K) orthonormal basis of ``base``.
    """

    linearised: LinearisedFit
    base: Array
    names: tuple[str, ...]
    wanted: Array
    basis: Array

    def columns(self, forces: Columns) -> Array:
        """(N, F) weighted responses of the output to resisting forces."""
        return _responses(self.linearised, forces)

    def moved(self, columns: Array, sizes: Array, name: str) -> float:
        """Value [SI] of a base parameter beside forces of given sizes with the responses ``columns`` (N, T)."""
        return self.moved_base(columns, sizes)[name]

    def moved_base(self, columns: Array, sizes: Array) -> dict[str, float]:
        """The same of every base parameter."""
        shift = np.linalg.lstsq(self.base, self.wanted - columns @ sizes, rcond=None)[0]
        parameters = self.linearised.fit.setup.parameters
        found = ((parameters[n], float(z)) for n, z in zip(self.names, shift, strict=True) if n in parameters)
        # Forces are linear in the value, not in its logarithm.
        return {p.name: p.value + p.slope(p.value) * z for p, z in found}

    def free(self, columns: Array) -> Array:
        """Columns without what base parameters can take over."""
        return np.asarray(columns - self.basis @ (self.basis.T @ columns))


def target(linearised: LinearisedFit, element: Effect) -> Target:
    """The target of a formula for an element of a fitted model."""
    fit = linearised.fit
    named = fit.variables.names
    names = (*named, *map(str, range(len(named), fit.jacobian.shape[1])))
    kept = [n not in element.strengths and bool(np.any(c)) for n, c in zip(names, fit.jacobian.T, strict=True)]
    # The derivatives of the residual are those of the output, with the other sign.
    base = -fit.jacobian[:, kept]
    learned = _responses(linearised, lambda q, v: element_force(fit.setup, element, q, v)[:, None])[:, 0]
    left = tuple(n for n, k in zip(names, kept, strict=True) if k)
    return Target(linearised, base, left, fit.residual + learned, np.linalg.qr(base)[0])


def pushed(trajectory: Trajectory, forces: Columns) -> Array:
    """(N, F) changes of the output [m] by forces that resist the motion of a trajectory."""
    pushes = -forces(trajectory.mid_displacement, trajectory.velocity)
    return output_derivatives(trajectory, (), (), np.ascontiguousarray(pushes))


def _responses(linearised: LinearisedFit, forces: Columns) -> Array:
    def one(_: Recording, trajectory: Trajectory) -> Array:
        return pushed(trajectory, forces)

    return linearised.stack(linearised.plan.each(one, linearised.trajectories))
