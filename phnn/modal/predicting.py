"""Predict periodic recordings with a modal model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from phnn.errors import InputRefused
from phnn.intake.limits import LIMITS
from phnn.modal.experiment import experiment_of, experiments_of
from phnn.modal.store import Channels, StoredModes
from phnn.prediction import Predicted
from phnn.recordings.recording import Campaign, Recording

Array = NDArray[np.float64]


def predicted_modes(stored: StoredModes, campaign: Campaign) -> tuple[Predicted, ...]:
    """Predict every recording of a folder in the periodic steady state, in the order of the campaign.

    A modal model says nothing about the mean of an output: where one was recorded, the prediction takes it over, and
    all samples are scored. Nothing else of the recorded output is used.

    Raises:
        InputRefused: a recording is not periodic, or its inputs, outputs or units are not those of the model.
        SolverFailed: a step of the model has no solution.
    """
    found: dict[str, Predicted] = {}
    for views in experiments_of(campaign).values():
        _check(stored.channels, views)
        found |= {p.recording.name: p for p in _predicted(stored, views, campaign)}
    return tuple(found[r.name] for r in campaign.recordings)


def _predicted(stored: StoredModes, views: Sequence[Recording], campaign: Campaign) -> list[Predicted]:
    first = views[0]
    fit = replace(stored.fit, dt=first.dt)
    if fit.model.substeps(fit.dt) > LIMITS.substeps:
        raise InputRefused(
            f"{first.source}: {1.0 / first.dt:.4g} Hz is too slow for modes up to "
            f"{fit.model.omega.max() / (2.0 * np.pi):.4g} Hz: use recordings at {1.0 / stored.fit.dt:.4g} Hz or so"
        )
    period = fit.predict(experiment_of(first.name, views))
    return [_one(r, period, stored.channels, r.name in campaign.held_out) for r in views]


def _one(recording: Recording, period: Array, channels: Channels, held_out: bool) -> Predicted:
    """One recorded output, or all outputs of the model side by side where none was recorded."""
    repeated = np.resize(period, (recording.t.size, period.shape[1]))
    if not np.isfinite(recording.y).all():
        unit = channels.units["output"].replace(" ", "")
        table = pd.DataFrame(
            {"time_s": recording.t} | {f"{n}_{unit}": y for n, y in zip(channels.outputs, repeated.T, strict=True)}
        )
        return Predicted(recording, repeated[:, 0], table, held_out, whole=True)
    y = repeated[:, channels.outputs.index(_output(recording))] + recording.y.mean()
    unit = recording.units.output
    column = "displacement_m" if unit == "m" else f"output_{unit.replace(' ', '')}"
    return Predicted(recording, y, pd.DataFrame({"time_s": recording.t, column: y}), held_out, whole=True)


def _output(recording: Recording) -> str:
    return recording.measures or "output"


def _check(channels: Channels, views: Sequence[Recording]) -> None:
    """Refuse recordings with other channels than the model has."""
    first = views[0]
    recorded = [r for r in views if np.isfinite(r.y).all()]
    inputs, outputs = ("input", *first.further), [_output(r) for r in recorded]
    if inputs != channels.inputs:
        raise InputRefused(
            f"{first.source}: inputs {', '.join(inputs)}, where the model has {', '.join(channels.inputs)}: name the "
            f"ports in recordings.yaml as they were named when the model was fitted"
        )
    if unknown := [o for o in outputs if o not in channels.outputs]:
        raise InputRefused(
            f"{first.source}: outputs {', '.join(unknown)}, where the model has {', '.join(channels.outputs)}: name "
            f"the outputs in recordings.yaml as they were named when the model was fitted"
        )
    units = {"input": first.units.input, "output": first.units.output}
    if recorded and units != channels.units:
        raise InputRefused(
            f"{first.source}: {first.units.output} by {first.units.input}, where the model gives "
            f"{channels.units['output']} by {channels.units['input']}: correct the units in recordings.yaml"
        )
