"""Least squares in blocks against those of the whole matrix."""

from __future__ import annotations

import numpy as np
import pytest

from phnn.signals import least_squares


@pytest.mark.parametrize("dependent", [False, True])
def test_blocks_leave_what_the_whole_matrix_leaves(dependent: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    t = np.linspace(0.0, 1.0, 1013)
    columns = np.column_stack([np.ones(t.size), t, np.sin(40.0 * t), np.cos(40.0 * t)])
    if dependent:
        columns = np.column_stack([columns, columns @ [1.0, 2.0, 3.0, 4.0]])
    y = columns @ rng.standard_normal(columns.shape[1]) + 0.1 * rng.standard_normal(t.size)
    whole = least_squares.residual(y, lambda rows: columns[rows])
    assert np.allclose(columns.T @ whole, 0.0, atol=1e-10)
    monkeypatch.setattr(least_squares, "_WHOLE", 100)
    monkeypatch.setattr(least_squares, "_ROWS", 100)
    assert np.allclose(least_squares.residual(y, lambda rows: columns[rows]), whole, atol=1e-12)
