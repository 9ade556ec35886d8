"""A modal model as plain data and back, and the document of a study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from phnn.errors import InputRefused
from phnn.intake.limits import LIMITS
from phnn.modal.elements import SLOW, SOFTENING, STATEMENTS, STOP, PortElement
from phnn.modal.experiment import Experiment, Study, experiment_of, experiments_of
from phnn.modal.fit import ModalFit
from phnn.modal.model import ModalModel
from phnn.modal.study import DESCRIBED, PROVISIONAL, UNKNOWN, Candidate, Result, Score
from phnn.models.typed import a_count, a_list, a_name, a_number, an_object, brief
from phnn.network.elements import Network
from phnn.prediction import Predicted
from phnn.recordings.recording import Campaign, Recording
from phnn.results import printable

Array = NDArray[np.float64]

MODEL_SCHEMA, STUDY_SCHEMA = "phnn.modal-model/2", "phnn.modes/2"


@dataclass(frozen=True)
class Channels:
    """What a model is driven at and what it observes: names of inputs and outputs in their order, and their units."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    units: Mapping[str, str]


class StoredModes(NamedTuple):
    """A fitted model and the channels that it was fitted to."""

    fit: ModalFit
    channels: Channels

    def to_network(self) -> Network:
        """Build the network of the model, its ports named as the inputs; see `phnn.modal.model.ModalModel.to_network`.

        Raises:
            StructureViolated: the model has a slow part, which no network expresses.
        """
        return self.fit.model.to_network(self.channels.inputs, self.channels.units["input"])


def _plain(channels: Channels) -> dict[str, Any]:
    return {"inputs": list(channels.inputs), "outputs": list(channels.outputs), "units": dict(channels.units)}


def channels_of(study: Study) -> Channels:
    """The channels of a study."""
    return Channels(study.inputs, study.outputs, dict(zip(("input", "output"), study.units, strict=True)))


def model_document(fit: ModalFit, channels: Channels) -> dict[str, Any]:
    """All that is needed to simulate the model again, SI."""
    m = fit.model
    return {
        "schema": MODEL_SCHEMA,
        **_plain(channels),
        "dt_s": fit.dt,
        "frequency_Hz": (m.omega / (2.0 * np.pi)).tolist(),
        "damping_ratio": m.zeta.tolist(),
        "ports": m.b.tolist(),
        "delay_s": m.delay.tolist(),
        "element": list(m.element.names),
        "kinds": m.element.kinds.tolist(),
        "reach": m.element.reach.tolist(),
        "parameters": m.k.tolist(),
        "thresholds": m.thresholds.tolist(),
        "shapes": fit.shapes.tolist(),
        "left_of_fitted": float(np.sqrt(fit.cost)),
    }


def model_from(document: Mapping[str, Any]) -> StoredModes:
    """The model of a document; what is returned is passive at its ports, whatever the document says.

    Raises:
        InputRefused: it is not such a document, something in it is missing, or a value lies outside its domain.
    """
    if document.get("schema") != MODEL_SCHEMA:
        raise InputRefused(f"schema {brief(document.get('schema'))} is not {MODEL_SCHEMA!r}: give a file of phnn modes")
    try:
        return _model(document)
    except KeyError as error:
        raise InputRefused(f"the model is incomplete (no {error}): run phnn modes again") from error
    except (ValueError, TypeError, OverflowError) as error:
        raise InputRefused(f"the model is damaged ({printable(str(error))}): run phnn modes again") from error


def _model(document: Mapping[str, Any]) -> StoredModes:
    inputs, outputs = (tuple(a_name(n, x) for n in a_list(document[x], x)) for x in ("inputs", "outputs"))
    names = tuple(a_name(n, "element") for n in a_list(document["element"], "element"))
    for name in names:
        if name not in STATEMENTS:
            raise ValueError(f"unknown element {brief(name)}; there are {', '.join(STATEMENTS)}")
    modes, ports = len(a_list(document["frequency_Hz"], "frequency_Hz")), len(inputs)
    parts = len(a_list(document["kinds"], "kinds"))
    if not modes or not ports or not outputs:
        raise ValueError("a model has one mode, one input and one output at least")
    kinds = np.array([a_count(k, "kinds", STOP, SLOW) for k in document["kinds"]], dtype=np.int64)
    element = PortElement(names, kinds, _numbers(document, "reach", parts))
    frequency = _numbers(document, "frequency_Hz", modes)
    zeta, k = _numbers(document, "damping_ratio", modes), _numbers(document, "parameters", ports, parts)
    thresholds = _numbers(document, "thresholds", ports, parts)
    if frequency.min() <= 0.0 or not 0.0 < zeta.min() <= zeta.max() < 1.0:
        raise ValueError("frequencies are positive and damping ratios lie between 0 and 1")
    if k.size and k.min() < 0.0:
        raise ValueError("weights of parts are 0 or more")
    if not (thresholds[:, np.isin(kinds, (STOP, SOFTENING, SLOW))] > 0.0).all():
        raise ValueError("thresholds of parts are positive")
    delay = _numbers(document, "delay_s", len(outputs))
    model = ModalModel(
        2.0 * np.pi * frequency, zeta, _numbers(document, "ports", modes, ports), delay, element, k, thresholds
    )
    dt = a_number(document["dt_s"], "dt_s")
    if dt <= 0.0 or model.substeps(dt) > LIMITS.substeps:
        raise ValueError(
            f"dt_s = {dt:g} asks for {model.substeps(max(dt, 0.0))} steps a sample, at most {LIMITS.substeps}"
        )
    shapes = _numbers(document, "shapes", len(outputs), 2 * modes + ports)
    cost = a_number(document["left_of_fitted"], "left_of_fitted") ** 2
    units = {n: a_name(u, n) for n, u in an_object(document["units"], "units").items()}
    channels = Channels(inputs, outputs, {n: units[n] for n in ("input", "output")})
    return StoredModes(ModalFit(model, shapes, dt, cost), channels)


def _numbers(document: Mapping[str, Any], name: str, *shape: int) -> Array:
    """Read finite numbers of a given shape. Raises ValueError otherwise."""

    def nested(value: Any, sizes: tuple[int, ...]) -> Any:
        if not sizes:
            return a_number(value, name)
        found = a_list(value, name)
        if len(found) != sizes[0]:
            raise ValueError(f"{name} has {len(found)} entries where {sizes[0]} belong")
        return [nested(v, sizes[1:]) for v in found]

    return np.array(nested(document[name], shape), dtype=float).reshape(shape)


def study_document(result: Result) -> dict[str, Any]:
    """The study as plain data, SI."""
    study, channels = result.study, channels_of(result.study)
    return {
        "schema": STUDY_SCHEMA,
        "verdict": result.verdict,
        "missing": _missing(result),
        "elements": list(result.final.element.names),
        "class": [list(m.element.names) for m in result.members],
        **_plain(channels),
        "sampling_interval_s": study.dt,
        "left_out": dict(study.left_out),
        "could_not_be_marched": list(result.failed),
        "chosen_by_what_was_fitted": result.fitted_choose,
        "levels": [
            _level(level)
            | {
                "linear_alone": {
                    "frequency_Hz": sorted((result.alone[i].model.omega / (2.0 * np.pi)).tolist()),
                    "choosing_error": float(result.alone_by[i]),
                    "held_out_rmse": _rmse(result.held_out[result.alone[i]].levels[i]),
                },
            }
            for i, level in enumerate(study.levels)
        ],
        "held_out_levels": [_level(level) for level in study.apart],
        "models": {c.element.name: _candidate(c, result) for c in result.candidates},
    }


def _level(level: tuple[Experiment, ...]) -> dict[str, Any]:
    return {
        "amplitude": level[0].amplitude,
        "experiments": [e.name for e in level],
        "held_out": [e.name for e in level if e.held_out],
    }


def _missing(result: Result) -> list[dict[str, Any]]:
    """One entry for each element beyond the linear model, as in ``diagnosis.json``."""
    share = result.share_explained
    if share is None:
        return []
    before, after = result.held_out[result.candidates[0].fit], result.held_out[result.final.fit]
    shared: dict[str, Any] = {
        "place": "every port",
        "location": "mechanical",
        "share_explained": share,
        "held_out": {"before": _shares(before.all), "after": _shares(after.all)},
        "passive": True,
    }
    names = result.final.element.names
    if result.verdict == UNKNOWN:
        status = DESCRIBED if names else PROVISIONAL
        return [
            shared | {"effect": UNKNOWN, "nearest": n, "status": status, "equivalent_to": [], "statement": _told(n)}
            for n in names or (None,)
        ]
    rivals = sorted({n for m in result.members for n in m.element.names} - set(names))
    return [
        shared | {"effect": n, "status": result.verdict, "equivalent_to": rivals, "statement": _told(n)} for n in names
    ]


def _told(name: str | None) -> str:
    return STATEMENTS[name] if name else "no element at the ports helps"


def _rmse(score: Score | None) -> list[float] | None:
    return score.rmse if score else None


def _shares(scores: tuple[Score | None, ...]) -> list[float | None]:
    return [s.share if s else None for s in scores]


def _candidate(candidate: Candidate, result: Result) -> dict[str, Any]:
    held = result.held_out[candidate.fit]
    return {
        "choosing_error": candidate.by_level.tolist(),
        "held_out_rmse": [_rmse(s) for s in held.levels],
        "held_out_share": _shares(held.levels),
        "held_out_levels_rmse": [_rmse(s) for s in held.apart],
        "held_out_levels_share": _shares(held.apart),
    }


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
