"""Noise of each recording, from the residual of the final model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from phnn.diagnose.diagnosis import Diagnosis
from phnn.effects.places import values_by_role
from phnn.identification.residual_noise import difference
from phnn.network.roles import capacitances
from phnn.recordings.recording import Recording
from phnn.report.tried import remains
from phnn.setup import Setup
from phnn.signals.noise_statement import NoiseStatement, Sample, noise_statement
from phnn.signals.quantisation import quantisation_step

Array = NDArray[np.float64]


def noise_statements(diagnosis: Diagnosis) -> dict[str, NoiseStatement]:
    """Return the noise by recording, held-out ones included: it decides nothing. Recordings that could not be simulated
    have none."""
    outputs, setup = diagnosis.after.outputs, diagnosis.final.setup
    shown = [r for r in diagnosis.campaign.recordings if r.name in outputs]
    return statements(shown, outputs, setup, not remains(diagnosis))


def statements(
    recordings: Sequence[Recording], outputs: Mapping[str, Array], setup: Setup, complete: bool
) -> dict[str, NoiseStatement]:
    """The same from the outputs of a model.

    Args:
        complete: the model leaves nothing that matters.
    """
    plant, found = plant_gain(setup), {}
    for r in recordings:
        chosen = [r.mask(use) for use in ("identification", "confirmation")]
        mask = max(chosen, key=np.count_nonzero)
        residual = ((r.y - outputs[r.name]) / r.noise)[mask]
        speed = (np.gradient(outputs[r.name], r.dt) / r.noise)[mask]
        found[r.name] = noise_statement(
            r.noise, r.noise_source, r.units.output, _sample(r, residual, speed, complete, plant)
        )
    return found


def _sample(
    r: Recording, residual: Array, speed: Array, complete: bool, plant: Callable[[Array], Array] | None
) -> Sample | None:
    """Return the residual if it is not significant, else the part that does not repeat, or None."""
    step = quantisation_step(r.y) / r.noise
    if complete:
        return Sample(residual, r.dt, speed, step, plant, r.noise)
    changed = difference(residual, r)
    if changed is None:
        return None
    return Sample(changed, r.dt, speed[-changed.size :], step, plant, r.noise)


def plant_gain(setup: Setup) -> Callable[[Array], Array] | None:
    """Power gain from a force on the moving mass to the displacement, hysterons at rest.

        |G|² = 1/|k + α² Σ 1/C_i − m ω² + i ω b|²

    None where the model has no such parameters.
    """
    network, values = setup.network, values_by_role(setup.network)
    if not {"m", "k", "b"} <= set(values):
        return None
    alpha = values.get("alpha", 0.0)
    stiffness = values["k"] + alpha**2 * sum(1.0 / network.parameters[n].value for n in capacitances(network))

    def gain(f: Array) -> Array:
        omega = 2.0 * np.pi * f
        return np.asarray(1.0 / ((stiffness - values["m"] * omega**2) ** 2 + (omega * values["b"]) ** 2))

    return gain
