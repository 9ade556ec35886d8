"""A fitted modal model as plain data and back, and its predictions of recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from phnn.errors import InputRefused
from phnn.modal.experiment import experiment_of, experiments_of
from phnn.modal.fit import ModalFit
from phnn.modal.model import ModalModel
from phnn.models.typed import a_list, a_name, a_number, an_object, brief
from phnn.prediction import Predicted
from phnn.recordings.recording import Campaign, Recording, Units
from phnn.results import printable

Array = NDArray[np.float64]

SCHEMA = "phnn.modal-model/3"


def model_document(fit: ModalFit) -> dict[str, Any]:
    """All that is needed to simulate the model again, SI."""
    m = fit.model
    return {
        "schema": SCHEMA,
        "inputs": list(fit.inputs),
        "outputs": list(fit.outputs),
        "units": fit.units._asdict(),
        "dt_s": fit.dt,
        "frequency_Hz": (m.omega / (2.0 * np.pi)).tolist(),
        "damping_ratio": m.zeta.tolist(),
        "ports": m.b.tolist(),
        "delay_s": m.delay.tolist(),
        "springs": m.springs.tolist(),
        "reach": m.reach.tolist(),
        "shapes": fit.shapes.tolist(),
        "left_of_fitted": float(np.sqrt(fit.cost)),
    }


def model_from(document: Mapping[str, Any]) -> ModalFit:
    """The model of a document; what is returned is passive at its ports, whatever the document says.

    Raises:
        InputRefused: it is not such a document, something in it is missing, or a value lies outside its domain.
    """
    if document.get("schema") != SCHEMA:
        raise InputRefused(f"schema {brief(document.get('schema'))} is not {SCHEMA!r}: give a file of phnn modes")
    try:
        return _model(document)
    except KeyError as error:
        raise InputRefused(f"the model is incomplete (no {error}): run phnn modes again") from error
    except (ValueError, TypeError, OverflowError) as error:
        raise InputRefused(f"the model is damaged ({printable(str(error))}): run phnn modes again") from error


def _model(document: Mapping[str, Any]) -> ModalFit:
    inputs, outputs = (tuple(a_name(n, x) for n in a_list(document[x], x)) for x in ("inputs", "outputs"))
    units = Units(**{end: a_name(unit, end) for end, unit in an_object(document["units"], "units").items()})
    modes, ports = len(a_list(document["frequency_Hz"], "frequency_Hz")), len(inputs)
    if not modes or not ports or not outputs:
        raise ValueError("a model has one mode, one input and one output at least")
    frequency, zeta = _numbers(document, "frequency_Hz", modes), _numbers(document, "damping_ratio", modes)
    springs = _numbers(document, "springs", ports if document["springs"] else 0)
    reach, dt = _numbers(document, "reach", ports), a_number(document["dt_s"], "dt_s")
    if frequency.min() <= 0.0 or not 0.0 < zeta.min() <= zeta.max() < 1.0:
        raise ValueError("frequencies are positive and damping ratios lie between 0 and 1")
    if (springs < 0.0).any() or reach.min() <= 0.0 or dt <= 0.0:
        raise ValueError("springs are 0 or more, reach and dt_s are positive")
    delay = _numbers(document, "delay_s", len(outputs))
    model = ModalModel(2.0 * np.pi * frequency, zeta, _numbers(document, "ports", modes, ports), delay, springs, reach)
    shapes = _numbers(document, "shapes", len(outputs), 2 * modes + ports)
    cost = a_number(document["left_of_fitted"], "left_of_fitted") ** 2
    return ModalFit(model, shapes, dt, cost, inputs, outputs, units)


def _numbers(document: Mapping[str, Any], name: str, *shape: int) -> Array:
    """Read finite numbers of a given shape. Raises ValueError otherwise."""

    def nested(value: Any, sizes: tuple[int, ...]) -> Any:
        if not sizes:
            return a_number(value, name)
        entries = a_list(value, name)
        if len(entries) != sizes[0]:
            raise ValueError(f"{name} has {len(entries)} entries where {sizes[0]} belong")
        return [nested(v, sizes[1:]) for v in entries]

    return np.array(nested(document[name], shape), dtype=float).reshape(shape)


def predicted_modes(fit: ModalFit, campaign: Campaign) -> tuple[Predicted, ...]:
    """Predict every recording of a folder in the periodic steady state, in the order of the campaign.

    A modal model says nothing about the mean of an output: where one was recorded, the prediction takes it over, and
    all samples are scored. Nothing else of the recorded output is used.

    Raises:
        InputRefused: a recording is not periodic, or its inputs, outputs or units are not those of the model.
        SolverFailed: the model has no steady state.
    """
    known: dict[str, Predicted] = {}
    for views in experiments_of(campaign).values():
        _check(fit, views)
        first = views[0]
        period = replace(fit, dt=first.dt).predict(experiment_of(first.name, views))
        known |= {r.name: _one(r, period, fit, r.name in campaign.held_out) for r in views}
    return tuple(known[r.name] for r in campaign.recordings)


def _one(recording: Recording, period: Array, fit: ModalFit, held_out: bool) -> Predicted:
    """One recorded output, or all outputs of the model side by side where none was recorded."""
    repeated = np.resize(period, (recording.t.size, period.shape[1]))
    if not np.isfinite(recording.y).all():
        unit = fit.units.output.replace(" ", "")
        table = pd.DataFrame(
            {"time_s": recording.t} | {f"{n}_{unit}": y for n, y in zip(fit.outputs, repeated.T, strict=True)}
        )
        return Predicted(recording, repeated[:, 0], table, held_out, whole=True)
    y = repeated[:, fit.outputs.index(recording.measures or "output")] + recording.y.mean()
    unit = recording.units.output
    column = "displacement_m" if unit == "m" else f"output_{unit.replace(' ', '')}"
    return Predicted(recording, y, pd.DataFrame({"time_s": recording.t, column: y}), held_out, whole=True)


def _check(fit: ModalFit, views: Sequence[Recording]) -> None:
    """Refuse recordings with other inputs, outputs or units than the model has."""
    first = views[0]
    recorded = [r for r in views if np.isfinite(r.y).all()]
    inputs, outputs = ("input", *first.further), [r.measures or "output" for r in recorded]
    if inputs != fit.inputs:
        raise InputRefused(
            f"{first.source}: inputs {', '.join(inputs)}, where the model has {', '.join(fit.inputs)}: name the "
            f"ports in recordings.yaml as they were named when the model was fitted"
        )
    if unknown := [o for o in outputs if o not in fit.outputs]:
        raise InputRefused(
            f"{first.source}: outputs {', '.join(unknown)}, where the model has {', '.join(fit.outputs)}: name "
            f"the outputs in recordings.yaml as they were named when the model was fitted"
        )
    if recorded and first.units != fit.units:
        raise InputRefused(
            f"{first.source}: {first.units.output} by {first.units.input}, where the model gives "
            f"{fit.units.output} by {fit.units.input}: correct the units in recordings.yaml"
        )
