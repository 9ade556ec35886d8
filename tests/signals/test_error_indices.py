"""Error indices agree with the package whose names they have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from junctions import recording

from phnn.prediction import Predicted, error_indices
from phnn.recordings.recording import Part

NAMES = ("RMSE", "NRMSE", "R_squared", "MAE", "fit_index")
T = np.arange(400) * 1e-3


def outputs(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    y = np.sin(20.0 * T) + 0.3
    return y, y + 0.05 * rng.normal(size=y.size) + 0.02 * T


@pytest.mark.parametrize("window", [None, 0, 50])
def test_they_are_those_of_nonlinear_benchmarks(window: int | None) -> None:
    package = pytest.importorskip("nonlinear_benchmarks")
    y, model = outputs()
    true = package.Input_output_data(y, y, 1e-3, state_initialization_window_length=window)
    theirs = [float(getattr(package.error_metrics, name)(true, model)) for name in NAMES]
    np.testing.assert_allclose(error_indices(y, model, window or 0), theirs, rtol=1e-13)


def test_a_prediction_has_them_over_what_is_scored_or_behind_a_window() -> None:
    y, model = outputs(1)
    parts = (Part("a[start]", 0, 60, "nuisance"), Part("a", 60, y.size, "confirmation"))
    found = Predicted(replace(recording(T, 0.0 * T), y=y, parts=parts), model, pd.DataFrame(), True)
    assert found.indices() == error_indices(y, model, 60)
    assert found.indices(50) == error_indices(y, model, 50) != found.indices()
    document = found.document("a.csv")
    assert found.indices().rmse == pytest.approx(document["rmse"], rel=1e-12)
    assert found.indices().fit_index == pytest.approx(document["fit_percent"], rel=1e-12)


def test_what_is_undefined_is_no_number() -> None:
    flat = error_indices(np.ones(9), np.zeros(9))
    assert (flat.rmse, flat.mae) == (1.0, 1.0)
    assert np.isnan([flat.nrmse, flat.r_squared, flat.fit_index]).all()
    unrecorded = Predicted(replace(recording(T, 0.0 * T), y=np.full(T.size, np.nan)), T, pd.DataFrame(), False)
    assert np.isnan(unrecorded.indices()).all()
    assert np.isnan(unrecorded.indices(5)).all()
