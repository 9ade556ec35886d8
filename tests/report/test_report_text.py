"""Numbers as text, the summary on a terminal, tables as csv with all digits, and what a page says to do a run again."""

from __future__ import annotations

import base64
import csv
import hashlib
import io
import math
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import campaigns
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from report_example import make_document, make_evidence, make_trace
from rich.console import Console

from phnn.recordings import read
from phnn.report import formatting as f
from phnn.report import verdicts
from phnn.report.document import read_document
from phnn.report.evidence import Evidence, ledger_shares
from phnn.report.methods import bibtex, command_line, methods, provenance
from phnn.report.page import csv_text, table_links, usage
from phnn.report.result import evidence as evidence_of
from phnn.report.write import console_summary

EMPTY = Evidence((), (), (), (), (), (), "")


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"),
        (math.nan, "–"),
        (0.0, "0"),
        (1.03, "1.03"),
        (0.0012345, "0.00123"),
        (1.11e-5, "1.11 × 10⁻⁵"),
        (-3.02e5, "−3.02 × 10⁵"),
        (9.999, "10.0"),
        (99999.0, "1.00 × 10⁵"),
    ],
)
def test_number(value: float | None, text: str) -> None:
    assert f.number(value) == text


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (0.31, 0.02, "0.310 ± 0.020"),
        (3.11e5, 2.1e3, "(3.110 ± 0.021) × 10⁵"),
        (9210.0, 330.0, "9210 ± 330"),
        (1.11e-3, None, "0.00111"),
        (0.5, 4.0, "0.5 ± 4.0"),
        (None, 1.0, "–"),
        (1e-7, 9.96e-9, "(1.00 ± 0.10) × 10⁻⁷"),
    ],
)
def test_with_error(value: float | None, std: float | None, text: str) -> None:
    assert f.with_error(value, std) == text


@given(st.floats(1e-12, 1e12))
def test_number_keeps_three_digits(value: float) -> None:
    text = f.number(value)
    mantissa, _, power = text.partition(" × 10")
    exponent = int(power.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789"))) if power else 0
    assert float(mantissa) * 10.0**exponent == pytest.approx(value, rel=0.0051)


@pytest.mark.parametrize(
    ("p", "text"),
    [
        (0.4, "p = 0.4"),
        (0.0412, "p = 0.041"),
        (1e-5, "p < 2 × 10⁻⁵"),
        (2.0 / 100_001.0, "p < 2 × 10⁻⁵"),
        (1e-9, "p < 2 × 10⁻⁵"),
        (2.1e-5, "p = 2 × 10⁻⁵"),
        (3.2e-4, "p = 3 × 10⁻⁴"),
        (9.7e-5, "p = 10⁻⁴"),
        (0.0, "p < 2 × 10⁻⁵"),
        (None, "p not computed"),
    ],
)
def test_p_value(p: float | None, text: str) -> None:
    assert f.p_value(p) == text


def _printed(document: dict[str, object], evidence: Evidence, width: int = 100) -> str:
    stream = io.StringIO()
    Console(file=stream, width=width).print(console_summary(document, evidence))
    return stream.getvalue()


@pytest.mark.parametrize("verdict", ["named", "equivalent", "unknown", "none"])
def test_summary_holds_the_verdict_and_the_fit(verdict: str) -> None:
    evidence = make_evidence(("sine_10Hz_75V", "sine_1Hz_75V"), creeps=verdict != "none", sentence="The headline.")
    text = _printed(make_document(verdict, evidence), evidence)
    assert text.startswith("The headline.")
    assert f"verdict: {verdict}" in text
    assert "sine_10Hz_75V *" in text
    assert "1.01" in text
    assert ("→ fit %" in text) == (verdict != "none")
    assert ("missing: creep (mechanical)" in text) == (verdict in ("named", "equivalent"))
    assert ("cannot tell creep from charge leakage" in text) == (verdict == "equivalent")
    assert "\x1b" not in text


@pytest.mark.parametrize("verdict", ["named", "equivalent", "unknown", "none"])
def test_summary_of_a_bare_document(verdict: str) -> None:
    text = _printed({"verdict": verdict, "missing": None, "fit": None, "location": None}, EMPTY, width=40)
    assert f"verdict: {verdict}" in text
    assert "None" not in text


def test_what_is_significant_and_immaterial_is_told_with_its_size() -> None:
    small = {"candidate": "second_mode", "rms": 6e-10, "share_of_noise": 0.012}
    left = {"verdict": "none", "residual_over_noise": 1.001, "p_value": 0.003, "location": None}
    document = {
        "verdict": "none",
        "test": {"statistic": 6.1, "p_value": 0.003, "candidate": "second_mode", "immaterial": small},
        "remainder": left,
    }
    content = read_document(document)
    told = verdicts.test_sentence(content)
    assert "second mode" in told and "0.600 nm, 0.0120 × the noise" in told
    assert "too small to be followed up" not in told
    text = _printed(document, EMPTY)
    assert "significant, and too small to matter" in text and "Nothing significant" not in text
    inner = {"verdict": "named", "remainder": left | {"immaterial": small}}
    assert "significant, and too small to matter" in _printed(inner, EMPTY)


@pytest.mark.parametrize(
    ("entry", "title"),
    [
        ({"effect": "creep", "status": "named"}, "Creep"),
        ({"effect": "unknown", "status": "described"}, "A learned element"),
        ({"effect": "unknown", "status": "provisional", "nearest": "creep"}, "Without a name"),
        (
            {"effect": "unknown", "status": "provisional", "nearest": "creep", "equation": "F"},
            "Acts like creep, not proven",
        ),
    ],
)
def test_titles_claim_no_more_than_the_status(entry: dict[str, object], title: str) -> None:
    (missing,) = read_document({"verdict": "equivalent", "missing": [entry]}).missing
    assert verdicts.missing_title(missing) == title
    assert verdicts.held_out_sentence(missing) == ""


def test_the_gain_on_held_out_recordings_is_told() -> None:
    entry = {"effect": "creep"}
    for p_value, odds in ((1e-4, "p = "), (None, "too few independent blocks")):
        held = {"before": 6.6, "after": 2.1, "p_value": p_value}
        (missing,) = read_document({"verdict": "named", "missing": [entry | {"held_out": held}]}).missing
        told = verdicts.held_out_sentence(missing)
        assert "6.60 and 2.10 × the noise" in told and odds in told


def test_a_tail_that_nobody_knows_is_no_p_value() -> None:
    for p, told in ((1e-75, "(p < 2 × 10⁻⁵)."), (3e-3, "(p = 0.003).")):
        content = read_document({"verdict": "named", "test": {"p_value": p, "statistic": 9.0}})
        assert verdicts.test_sentence(content).endswith(told)


@pytest.mark.parametrize(
    ("changes", "tied"),
    [
        ({"missing": [{"effect": "creep", "equivalent_to": ["charge_leakage"]}]}, True),
        ({"missing": [{"effect": "unknown"}], "location": {"name": "sensor", "tied": ["coupling"]}}, True),
        ({"missing": [{"effect": "creep"}], "location": {"name": "sensor"}}, False),
    ],
)
def test_beside_a_tie_stands_a_proposal_or_why_there_is_none(changes: dict[str, object], tied: bool) -> None:
    document = {"verdict": "equivalent"} | changes
    content = read_document(document)
    assert verdicts.tied(content) is tied
    for evidence in (EMPTY, replace(EMPTY, no_proposal="Because nothing on the menu moves them apart.")):
        told = verdicts.no_proposal_sentence(content, evidence.no_proposal)
        why = evidence.no_proposal
        assert told == why if why else ("No further recording is proposed" in told) is not tied
        assert ("record next" in _printed(document, evidence)) is (tied or bool(why))


def test_names_are_not_read_as_markup() -> None:
    fit = {"before": {"[red]x[/red]": {"fit_percent": 99.0}}}
    assert "[red]x[/red]" in _printed({"verdict": "none", "fit": fit}, EMPTY)


@given(st.floats(allow_nan=True, allow_infinity=True), st.floats(allow_nan=True, allow_infinity=True))
def test_every_float_has_a_text(value: float, std: float) -> None:
    for text in (f.number(value), f.with_error(value, std), f.p_value(value), f.plain(value), f.change(value, std)):
        assert text
        assert not {"nan", "inf"} & set(text.split())


def rows_of(link: str) -> list[dict[str, str]]:
    head, _, data = link.partition(",")
    assert head == "data:text/csv;charset=utf-8;base64"
    text = base64.b64decode(data).decode("utf-8-sig")
    return list(csv.DictReader(io.StringIO(text)))


def test_tables_hold_the_numbers_of_the_document() -> None:
    evidence = replace(make_evidence(("step_50V",)), traces=(make_trace("step_50V", 400),))
    content = make_document("named", evidence)
    links = table_links(read_document(content), evidence, ledger_shares(evidence.ledger)[0])
    assert set(links) == {"fit", "parameters", "energy", "models", "tried", "noise"}
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
    models = rows_of(links["models"])
    assert [m["model"] for m in models] == ["creep", "charge leakage", "extra hysteron", "base model"]
    assert (models[0]["final model"], models[2]["converged"], models[2]["chi2/N held out"]) == ("yes", "no", "")


def test_no_table_without_rows() -> None:
    evidence = replace(make_evidence(()), parameters=(), candidates=(), models=())
    assert table_links(read_document({"verdict": "none"}), evidence, ()) == {}


@pytest.mark.parametrize("name", ['=cmd|"/C calc"!A1', "+1", "-2", "@SUM(A1)", "\t=1"])
def test_a_name_is_no_formula(name: str) -> None:
    ((found,),) = list(csv.reader(io.StringIO(csv_text(["a"], [[name]]))))[1:]
    assert found == "'" + name


def test_numbers_stay_numbers_and_undefined_ones_are_empty() -> None:
    text = csv_text(["a", "b", "c", "d"], [[-1.5e-9, None, float("nan"), 'x,"y"']])
    assert list(csv.reader(io.StringIO(text)))[1] == ["-1.5e-09", "", "", 'x,"y"']


def test_a_search_whose_evaluations_are_used_up_says_so() -> None:
    told = {"verdict": "unknown", "ended": {"why": "evaluations", "evaluations": 3000.0, "not_tried": ["delay"]}}
    content = read_document(told)
    assert content.ended.evaluations == 3000.0
    assert "its number of evaluations was used up" in _printed(told, EMPTY)
    assert "Not tried, or not to the end: delay." in verdicts.ended_sentence(content)


def test_methods_say_what_was_fitted_held_out_and_decided() -> None:
    found = campaigns.diagnosis("quadratic_drag")
    said = methods(found)
    text = " ".join(said.sentences)
    for part in (p for r in found.campaign.recordings for p in r.parts if p.use != "nuisance"):
        assert part.name in text
    assert "Held out was sine_010Hz_50V: no model was fitted to it or weighed by it." in text
    (fitted,) = re.findall(r"parameters \(([^)]*)\) were estimated", text)
    assert set(fitted.split(", ")) == set(found.base.variables.names)
    assert "The verdict is “named”: the final model adds quadratic drag [5]" in text
    assert f"numpy {np.__version__}" in text
    assert max(int(n) for n in re.findall(r"\[(?:\d+, )*(\d+)\]", text)) == len(said.references)
    assert len(re.findall(r"^@\w+\{", said.bibtex, re.MULTILINE)) == len(said.references)
    assert said.bibtex.count("{") - said.bibtex.count(r"\{") == said.bibtex.count("}") - said.bibtex.count(r"\}")


def test_what_a_run_was_made_of_changes_with_its_files(tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    shutil.copytree(campaigns.campaign().folder, folder)
    before = provenance(read(folder), command_line(["diagnose", "my recordings", "--out", "o"]))
    assert before.command == "phnn diagnose 'my recordings' --out o"
    assert {f.name for f in before.recordings} == {p.name for p in folder.glob("*.csv")}
    assert all(f.sha256 == hashlib.sha256((folder / f.name).read_bytes()).hexdigest() for f in before.recordings)
    first = folder / before.recordings[0].name
    lines = first.read_text().splitlines()
    lines[5] = lines[5].replace("1", "2")
    first.write_text("\n".join(lines))
    after = provenance(read(folder))
    changed = [a.name for a, b in zip(after.recordings, before.recordings, strict=True) if a != b]
    assert changed == [first.name] and after.understood != before.understood
    assert after.manifest == before.manifest and after.command == ""
    manifest = tmp_path / "other.yaml"
    manifest.write_text("voltage: command\n")
    said = provenance(read(folder, manifest), manifest=manifest).manifest
    assert said is not None and said.sha256 == hashlib.sha256(manifest.read_bytes()).hexdigest()


@pytest.mark.slow
def test_code_of_a_page_loads_the_model_and_simulates(tmp_path: Path) -> None:
    found = campaigns.diagnosis("quadratic_drag")
    found.model.save(tmp_path / "model")
    code = usage(evidence_of(found).traces, *found.campaign.recordings[0].units)
    (tmp_path / "use.py").write_text(code)
    done = subprocess.run([sys.executable, "use.py"], cwd=tmp_path, capture_output=True, text=True, check=True)
    low, high = map(float, done.stdout.split())
    largest = max(float(np.abs(r.y).max()) for r in found.campaign.recordings)
    assert low < 0.0 < high and 0.3 * largest < high - low < 4.0 * largest


@pytest.mark.parametrize("text", ["a {b} & c_d 100 % #1 $x$", "back\\slash 1999"])
def test_references_are_escaped(text: str) -> None:
    entry = bibtex([text]).rsplit("\n\n", 1)[1]
    assert not re.search(r"(?<!\\)[&%#_$]", entry.partition("note")[2])
