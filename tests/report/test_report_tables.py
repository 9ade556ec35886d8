"""Downloads of a page: tables as csv with all digits, names that no spreadsheet runs."""

from __future__ import annotations

import base64
import csv
import io
from dataclasses import replace

import pytest
from report_example import make_document, make_evidence, make_trace

from phnn.report.reading import read_document
from phnn.report.shares import ledger_shares
from phnn.report.tables import csv_text, table_links


def rows_of(link: str) -> list[dict[str, str]]:
    head, _, data = link.partition(",")
    assert head == "data:text/csv;charset=utf-8;base64"
    text = base64.b64decode(data).decode("utf-8-sig")
    return list(csv.DictReader(io.StringIO(text)))


def test_tables_hold_the_numbers_of_the_document() -> None:
    evidence = replace(make_evidence(("step_50V",)), traces=(make_trace("step_50V", 400),))
    content = make_document("named", evidence)
    links = table_links(read_document(content), evidence, ledger_shares(evidence.ledger)[0])
    assert set(links) == {"fit", "parameters", "energy", "tried", "noise"}
    (fit,) = rows_of(links["fit"])
    assert (fit["recording"], fit["held out"]) == ("step_50V", "yes")
    for which in ("before", "after"):
        score = content["fit"][which]["step_50V"]
        assert float(fit[f"{which}: RMSE (m)"]) == score["rmse"]
        assert float(fit[f"{which}: residual over noise"]) == score["residual_over_noise"]
    parameters = {row["parameter"]: row for row in rows_of(links["parameters"])}
    assert float(parameters["b"]["after"]) == 38.94
    assert parameters["tau"]["before"] == ""
    assert parameters["rho_1"]["meaning"] == "conductance of hysteron 1 beyond its threshold"
    assert float(rows_of(links["energy"])[0]["hysteron 1"]) == pytest.approx(0.6 / 2.1)


def test_no_table_without_rows() -> None:
    evidence = replace(make_evidence(()), parameters=(), candidates=())
    assert table_links(read_document({"verdict": "none"}), evidence, ()) == {}


@pytest.mark.parametrize("name", ['=cmd|"/C calc"!A1', "+1", "-2", "@SUM(A1)", "\t=1"])
def test_a_name_is_no_formula(name: str) -> None:
    ((found,),) = list(csv.reader(io.StringIO(csv_text(["a"], [[name]]))))[1:]
    assert found == "'" + name


def test_numbers_stay_numbers_and_undefined_ones_are_empty() -> None:
    text = csv_text(["a", "b", "c", "d"], [[-1.5e-9, None, float("nan"), 'x,"y"']])
    assert list(csv.reader(io.StringIO(text)))[1] == ["-1.5e-09", "", "", 'x,"y"']
