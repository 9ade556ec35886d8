"""Derivatives by equivalent linearisation against differences."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from phnn.modal.model import ModalModel
from phnn.modal.slopes import output_slopes
from phnn.modal.study import Result

Array = NDArray[np.float64]


def moved(model: ModalModel, k: int, by: float, dt: float) -> ModalModel:
    m, ports, outputs = model.omega.size, model.b.shape[1], model.delay.size
    sizes = np.cumsum([m, m, m * ports, outputs])
    if k < sizes[0]:
        return replace(model, omega=model.omega * np.exp(by * (np.arange(m) == k)))
    if k < sizes[1]:
        return replace(model, zeta=model.zeta * np.exp(by * (np.arange(m) == k - sizes[0])))
    if k < sizes[2]:
        return replace(model, b=model.b + by * (np.arange(m * ports) == k - sizes[1]).reshape(m, ports))
    if k < sizes[3]:
        return replace(model, delay=model.delay + by * dt * (np.arange(outputs) == k - sizes[2]))
    return replace(model, k=model.k * np.exp(by * (np.arange(model.k.size) == k - sizes[3]).reshape(model.k.shape)))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "bound"), [("linear", 0.999999), ("extra_hysteron", 0.75)])
def test_slopes_point_where_differences_do(studied: Callable[[str, int], Result], name: str, bound: float) -> None:
    result = studied("extra_hysteron", 7)
    study = result.study
    fit = next(c.fit for c in result.candidates if c.element.name == name)
    experiment, lines = study.identification(0)[0], study.lines

    def outputs(model: ModalModel) -> Array:
        seen = model.seen(experiment, study.dt).at(lines, 1.0)
        return (seen.columns @ fit.shapes.T) * np.exp(-seen.s[:, None] * model.delay)

    slopes = output_slopes(fit.model, fit.model.seen(experiment, study.dt).at(lines, 1.0), fit.shapes, study.dt)
    sizes = np.linalg.norm(slopes.reshape(-1, slopes.shape[2]), axis=0)
    for k in np.flatnonzero(sizes > 1e-3 * sizes.max()):
        ahead, behind = (outputs(moved(fit.model, int(k), by, study.dt)) for by in (1e-5, -1e-5))
        difference = (ahead - behind) / 2e-5
        norms = np.linalg.norm(slopes[:, :, k]), np.linalg.norm(difference)
        assert np.vdot(slopes[:, :, k], difference).real >= bound * norms[0] * norms[1], k
        if name == "linear":
            assert norms[0] == pytest.approx(norms[1], rel=1e-6)
