"""Table 3 and what is written of it."""

from __future__ import annotations

import csv
import io
from functools import cache

import campaigns
import numpy as np
import pytest

from phnn.diagnosis.tested import score_on_all
from phnn.identification.fit import Fit, fit
from phnn.models.bouc_wen import bouc_wen
from phnn.report.figures import Drawing
from phnn.results import finite
from studies.paper.document import cells, document, heads, markdown, table_csv
from studies.paper.figures import draw_all, panels, responses
from studies.paper.published import TABLE_3
from studies.paper.table import Comparison, Scored


def scored(fitted: Fit) -> Scored:
    return Scored(fitted, score_on_all(fitted, campaigns.campaign()))


@cache
def comparison() -> Comparison:
    """A fitted actuator beside the Bouc–Wen model as published: no search needed."""
    base = campaigns.base()
    rival = fit(bouc_wen(), base.plan, (), max_evaluations=1)
    return Comparison(campaigns.campaign(), {"phs": scored(base), "bouc_wen": scored(rival)}, 0.5)


@cache
def drawings() -> list[Drawing]:
    """Drawn once: it takes a while."""
    return draw_all(comparison())


def test_fit_percentage_is_that_of_matlab() -> None:
    for row in comparison().rows():
        recording = next(r for r in campaigns.campaign().recordings if r.name == row.name)
        mask = recording.mask(row.use)
        for model, score in row.scores.items():
            measured = recording.y[mask]
            simulated = comparison().models[model].evaluation.outputs[row.name][mask]
            squares = sum((a - b) ** 2 for a, b in zip(measured.tolist(), simulated.tolist(), strict=True))
            mean = sum(measured.tolist()) / len(measured)
            spread = sum((a - mean) ** 2 for a in measured.tolist())
            assert score.fit_percent == pytest.approx(100.0 * (1.0 - (squares / spread) ** 0.5), rel=1e-9)
            assert score.rmse == pytest.approx((squares / len(measured)) ** 0.5, rel=1e-9)


def test_rows_stand_beside_the_lines_that_they_repeat() -> None:
    lines = {row.name: row.line for row in comparison().rows()}
    assert lines == {
        "sine_010Hz_75V": "10 Hz", "sine_100Hz_75V": "100 Hz", "sine_010Hz_50V": "10 Hz", "step_75V": "Step"
    }  # fmt: skip
    for row in comparison().rows():
        assert row.line is not None
        assert row.printed == TABLE_3[row.line]


def test_csv_has_every_score() -> None:
    rows = comparison().rows()
    found = list(csv.DictReader(io.StringIO(table_csv(rows))))
    assert len(found) == 2 * len(rows)
    for line in found:
        row = next(r for r in rows if r.name == line["recording"])
        assert float(line["fit_percent"]) == row.scores[line["model"]].fit_percent
        assert row.printed is not None
        assert float(line["paper_rmse_m"]) == row.printed.rmse(line["model"])


def test_text_has_a_cell_for_every_column() -> None:
    rows = comparison().rows()
    head = heads(rows)
    assert head[-2:] == ["PHS, paper", "Bouc–Wen, paper"]
    for row in rows:
        line = cells(row, len(head))
        assert len(line) == len(head)
        assert f"{row.scores['phs'].fit_percent:.2f}" in line[2]
    text = markdown(comparison(), None, "mine", drawings())
    assert all(f"| {row.name} |" in text for row in rows)
    tables = [line for line in text.splitlines() if line.startswith("| ") and "---" not in line]
    assert {line.count("|") for line in tables} == {len(head) + 1, 5}
    assert "figures/fig10-responses.png" in text


def test_document_tells_parameters_beside_the_published_ones() -> None:
    content = finite(document(comparison(), None, "mine", 0, 1.0))
    k = content["parameters"]["phs"]["k"]
    assert k["published"] == 24579.0
    assert k["value"] == campaigns.base().setup.values()["k"]
    assert content["parameters"]["phs"]["m"]["held"].startswith("held at the stated")
    assert content["made"] is None


def test_figures_are_those_of_the_paper() -> None:
    found = responses(comparison())
    four = panels(found, ("Step", "1 Hz", "10 Hz", "100 Hz"), ("Chirp",))
    # There is no 1 Hz here: the second recording at 10 Hz takes the empty place.
    assert [r.recording.name for r in four] == ["step_75V", "sine_010Hz_75V", "sine_100Hz_75V", "sine_010Hz_50V"]
    for response in found:
        assert np.isfinite(response.outputs["phs"]).all()
        assert 0 <= response.shown.start < response.shown.stop <= response.recording.t.size
    names = ["fig10-responses", "fig11-errors", "fig12-hysteresis", "fig15-rate"]
    assert [d.file for d in drawings()] == [f"{n}.png" for n in names]
    assert all(d.png.startswith(b"\x89PNG") and len(d.png) > 10_000 for d in drawings())
