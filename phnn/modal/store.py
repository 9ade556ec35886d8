"""A modal model as plain data and back, and the document of a study."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.errors import InputRefused
from phnn.modal.elements import PortElement
from phnn.modal.fit import ModalFit
from phnn.modal.model import ModalModel
from phnn.modal.study import Candidate, Result

Array = NDArray[np.float64]

MODEL_SCHEMA, STUDY_SCHEMA = "phnn.modal-model/1", "phnn.modes/1"


def model_document(fit: ModalFit) -> dict[str, Any]:
    """All that is needed to simulate the model again, SI."""
    m = fit.model
    return {
        "schema": MODEL_SCHEMA,
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


def model_from(document: Mapping[str, Any]) -> ModalFit:
    """The model of a document.

    Raises:
        InputRefused: it is not such a document, or something in it is missing.
    """
    if document.get("schema") != MODEL_SCHEMA:
        raise InputRefused(f"schema {document.get('schema')!r} is not {MODEL_SCHEMA!r}: give a file of phnn modes")
    try:
        ports = np.array(document["ports"], dtype=float)
        shape = ports.shape[1], -1
        k, thresholds = (
            np.array(document[n], dtype=float).reshape(shape) if np.size(document[n]) else np.zeros((shape[0], 0))
            for n in ("parameters", "thresholds")
        )
        kinds, reach = np.array(document["kinds"], dtype=np.int64), np.array(document["reach"], dtype=float)
        element = PortElement(tuple(document["element"]), kinds, reach)
        model = ModalModel(
            2.0 * np.pi * np.array(document["frequency_Hz"], dtype=float),
            np.array(document["damping_ratio"], dtype=float), ports, np.array(document["delay_s"], dtype=float),
            element, k, thresholds,
        )  # fmt: skip
        shapes = np.array(document["shapes"], dtype=float)
        return ModalFit(model, shapes, float(document["dt_s"]), float(document["left_of_fitted"]) ** 2)
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise InputRefused(f"the model is incomplete ({error!r}): run phnn modes again") from error


def study_document(result: Result) -> dict[str, Any]:
    """The study as plain data, SI."""
    study = result.study
    return {
        "schema": STUDY_SCHEMA,
        "verdict": result.verdict,
        "elements": list(result.final.element.names),
        "class": [list(m.element.names) for m in result.members],
        "inputs": list(study.inputs),
        "outputs": list(study.outputs),
        "units": {"input": study.units[0], "output": study.units[1]},
        "sampling_interval_s": study.dt,
        "left_out": dict(study.left_out),
        "could_not_be_marched": list(result.failed),
        "chosen_by_what_was_fitted": result.fitted_choose,
        "levels": [
            {
                "amplitude": level[0].amplitude,
                "experiments": [e.name for e in level],
                "held_out": [e.name for e in level if e.held_out],
                "linear_alone": {
                    "frequency_Hz": sorted((result.alone[i].model.omega / (2.0 * np.pi)).tolist()),
                    "choosing_error": float(result.alone_by[i]),
                    "held_out_rmse": result.held_out[result.alone[i]][i],
                },
            }
            for i, level in enumerate(study.levels)
        ],
        "models": {c.element.name: _candidate(c, result) for c in result.candidates},
    }


def _candidate(candidate: Candidate, result: Result) -> dict[str, Any]:
    return {
        "choosing_error": candidate.by_level.tolist(),
        "held_out_rmse": list(result.held_out[candidate.fit]),
    }
