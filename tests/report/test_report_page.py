"""The report as a whole: complete, self-contained, in order, and unmoved by what is absent or odd."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pytest
from report_example import NOISE, make_document, make_evidence, make_trace
from report_html import Page

from phnn.diagnose.words import Picture
from phnn.errors import InputRefused, OutputFailed
from phnn.report.evidence import CandidateRow, Evidence, LedgerRow, ModelRow, ParameterRow, Trace
from phnn.report.write import write_report
from phnn.results import Place, claim, file_name

VERDICTS = ("named", "equivalent", "unknown", "none")
EMPTY = Evidence((), (), (), (), (), (), "")


def _write(document: dict[str, Any], evidence: Evidence, folder: Path) -> Page:
    write_report(document, evidence, Place(folder))
    return Page((folder / "report.html").read_text("utf-8"))


@pytest.fixture(scope="module", params=VERDICTS)
def report(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path, Page]:
    verdict = request.param
    evidence = make_evidence(
        ("sine_1Hz_75V", "step_50V"), creeps=verdict != "none", sentence=f"The {verdict} headline."
    )
    folder = tmp_path_factory.mktemp(verdict)
    return verdict, folder, _write(make_document(verdict, evidence), evidence, folder)


def test_page_opens_offline_and_runs_only_its_own_scripts(report: tuple[str, Path, Page]) -> None:
    _, _, page = report
    assert not {"link", "iframe", "object", "base"} & set(page.tags)
    assert page.fetched
    assert page.leads_away() == []
    assert "url(" not in (report[1] / "report.html").read_text("utf-8")
    assert page.open == []
    assert page.policy.startswith("default-src 'none';")
    assert {base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in page.scripts} == page.allowed()
    assert "The MIT License" in page.scripts[0] and "unsafe-inline" not in page.policy.partition("style-src")[0]


def test_figures_are_written_as_png_and_inlined(report: tuple[str, Path, Page]) -> None:
    verdict, folder, page = report
    names = sorted(path.name for path in (folder / "figures").iterdir())
    assert len([t for t in page.fetched if t.startswith("data:image/png")]) == len(names)
    assert sorted(unquote(t[8:]) for t in page.fetched if t.startswith("figures/")) == names
    stems = {re.sub(r"^\d\d-|\.png$", "", name) for name in names}
    expected = {"overview", "held-out-step_50V", "identification-sine_1Hz_75V", "ledger"}
    assert stems == (expected if verdict == "none" else expected | {"locations", "picture"})
    for name in names:
        assert (folder / "figures" / name).read_bytes().startswith(b"\x89PNG")


def test_page_reads_top_down(report: tuple[str, Path, Page]) -> None:
    verdict, _, page = report
    landmarks = [
        f"The {verdict} headline.",
        "Where it acts\n",
        "Before and after\n",
        "Held out: step_50V",
        "Identification recordings",
        "Parameters\n",
        "Energy\n",
        "What was tried\n",
        "What remains, and what to record next",
        "What was understood of the recordings",
        "readme.txt is no recording",
        "Use and reproduce\n",
    ]
    places = [page.text.rindex(landmark) for landmark in landmarks]
    assert places == sorted(places)


def test_verdict_decides_what_is_said(report: tuple[str, Path, Page]) -> None:
    verdict, _, page = report
    said = {
        "named": "The model with it stays passive.",
        "equivalent": "These recordings cannot tell creep from charge leakage.",
        "unknown": "A learned element",
        "none": "so there is nothing to locate",
    }
    assert said[verdict] in page.text
    assert ("p = 0.44" if verdict == "none" else "p < 2 × 10⁻⁵") in page.text
    assert ("final model" in page.text) == (verdict != "none")
    assert ("Record next" in page.text) == (verdict in ("equivalent", "unknown"))


@pytest.mark.parametrize("verdict", VERDICTS)
@pytest.mark.parametrize("filler", ["absent", "null", "hollow"])
def test_absent_and_null_entries_are_shown_as_absent(verdict: str, filler: str, tmp_path: Path) -> None:
    document: dict[str, Any] = {"verdict": verdict}
    if filler != "absent":
        document |= {key: None for key in make_document(verdict, EMPTY) if key != "verdict"}
    if filler == "hollow":
        document |= {"test": {}, "missing": [{}, None], "remainder": {}, "location": {}, "next_experiment": {}}
        document["fit"] = {"before": {"a": None, "b": {}}, "after": None, "held_out": None}
        document["noise_floor"] = {"a": None}
    page = _write(document, EMPTY, tmp_path)
    assert not re.search(r"\b(None|nan|null|Undefined)\b", page.text)
    assert "The remainder was not judged." in page.text


def test_probabilities_are_bars_with_a_text_for_each(tmp_path: Path) -> None:
    likely = {f"effect_{i}": 0.5 - 0.05 * i for i in range(10)} | {"delay": 0.004, "none": 0.001}
    _write({"verdict": "unknown", "probability": likely}, EMPTY, tmp_path)
    page = (tmp_path / "report.html").read_text("utf-8")
    bars = re.findall(r'role="img" aria-label="([^"]+)"><i style="width:([0-9.]+)%">', page)
    assert bars[0] == ("effect 0: 50 %", "50.0")
    assert len(bars) == 9 and bars[-1] == ("nothing is missing: &lt; 1 %", "0.1")
    assert "delay" not in page


def test_a_single_recording_without_curves_or_held_out_part(tmp_path: Path) -> None:
    evidence = replace(make_evidence(("sine_1Hz_75V",)), curves=())
    page = _write(make_document("named", evidence), evidence, tmp_path)
    assert "No recording was held out" in page.text
    assert "No curve was learned" in page.text
    assert not any("overview" in path.name or "picture" in path.name for path in (tmp_path / "figures").iterdir())


def test_names_from_outside_are_escaped(tmp_path: Path) -> None:
    name = '<script>alert("1")</script> $\\frac$ [bold]'
    trace = replace(make_trace("step_50V", 400), name=name)
    evidence = Evidence(
        traces=(trace,),
        curves=(Picture(np.arange(3.0), np.arange(3.0), None, "$x", r"$\nonsense$", r"$\frac{$"),),
        parameters=(ParameterRow("<b>", "<i>", "<u>", 1.0, 2.0, None, "<img src=x>"),),
        candidates=(CandidateRow("<b>", "", 1.0, 0.1, "<img src=x>"),),
        models=(ModelRow("<img src=x>", 1.0, 1.0, 1, 0.5, True, True),),
        ledger=(LedgerRow(name, 1.0, 0.0, {"<b>$": 1.0}, 0.0),),
        notes=("<script>",),
        verdict_sentence="<script>",
    )
    document = make_document("unknown", evidence)
    document["missing"][0] |= {"statement": "<script>", "equation": r"\undefined{<script>}"}
    page = _write(document, evidence, tmp_path)
    assert len(page.scripts) == 2 == len(page.allowed())
    assert page.leads_away() == []
    assert name in page.text
    assert json.loads(page.data[0])["name"] == name and "<" not in page.data[0]
    for path in (tmp_path / "figures").iterdir():
        assert path.name == file_name(path.name) and not set(path.name) & set("<>\"'&$`\\/:*?|")


def test_a_model_that_failed_and_a_recording_without_noise_are_drawn(tmp_path: Path) -> None:
    good = make_trace("step_50V", 400)
    broken = replace(good, name="broken", after=np.full(400, np.nan))
    silent = replace(good, name="silent", noise=0.0, u=np.zeros(400), measured=np.zeros(400), before=np.zeros(400))
    unscored = replace(good, name="unscored", scored=np.zeros(400, dtype=bool))
    short = Trace("short", *(np.arange(5.0) for _ in range(5)), NOISE, True, np.ones(5, dtype=bool))
    evidence = replace(EMPTY, traces=(broken, silent, unscored, short))
    _write({"verdict": "unknown"}, evidence, tmp_path)
    assert len(list((tmp_path / "figures").iterdir())) == 4


def test_only_the_worst_recordings_get_a_figure_when_there_are_many(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("phnn.report.gallery._MOST_DRAWN", 1)
    first = make_trace("step_50V", 400)
    evidence = replace(EMPTY, traces=(first, replace(first, name="worse")))
    fit = {"step_50V": {"residual_over_noise": 2.0}, "worse": {"residual_over_noise": 5.0}}
    page = _write({"verdict": "named", "fit": {"before": fit}}, evidence, tmp_path)
    assert [path.name for path in (tmp_path / "figures").glob("*held-out*")] == ["02-held-out-worse.png"]
    assert "1 further recording has no figure here" in page.text


@pytest.mark.slow
def test_same_input_gives_the_same_bytes(tmp_path: Path) -> None:
    evidence = replace(make_evidence(("step_50V",)), traces=(make_trace("step_50V", 400),), ledger=())
    document = make_document("named", evidence)
    for folder in ("a", "b"):
        write_report(document, evidence, Place(tmp_path / folder))
    assert (tmp_path / "a/report.html").read_bytes() == (tmp_path / "b/report.html").read_bytes()


def test_figures_of_an_earlier_report_go_and_other_files_stay(tmp_path: Path) -> None:
    evidence = replace(make_evidence(("step_50V",)), traces=(make_trace("step_50V", 400),), ledger=())
    for document, shown in ((make_document("named", evidence), evidence), ({"verdict": "none"}, EMPTY)):
        with claim(tmp_path, "diagnose", (), ("report.html", "figures")) as place:
            write_report(document, shown, place)
        if shown is evidence:
            assert any((tmp_path / "figures").iterdir())
            (tmp_path / "figures" / "07-mine.png").write_bytes(b"")
    assert [path.name for path in (tmp_path / "figures").iterdir()] == ["07-mine.png"]


def test_an_interrupted_write_leaves_the_earlier_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _write({"verdict": "none"}, EMPTY, tmp_path)
    before = (tmp_path / "report.html").read_bytes()

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", fail)
    with pytest.raises(OutputFailed, match=r"report\.html: the disk is full \(No space left on device\)"):
        write_report({"verdict": "named"}, EMPTY, Place(tmp_path))
    assert (tmp_path / "report.html").read_bytes() == before
    assert {path.name for path in tmp_path.iterdir()} == {".phnn", "report.html"}


def test_a_folder_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    with (
        pytest.raises(InputRefused, match="is a file: name a folder for --out"),
        claim(tmp_path / "out", "diagnose") as place,
    ):
        write_report({"verdict": "none"}, EMPTY, place)


@pytest.mark.parametrize("verdict", [None, "maybe"])
def test_a_verdict_that_does_not_exist_is_refused(verdict: str | None, tmp_path: Path) -> None:
    with pytest.raises(InputRefused, match="must be one of named, equivalent, unknown, none"):
        write_report({"verdict": verdict}, EMPTY, Place(tmp_path))


def test_lengths_that_differ_are_named() -> None:
    trace = make_trace("step_50V", 400)
    with pytest.raises(ValueError, match=r"trace step_50V: before has shape \(3,\), t has \(400,\)"):
        replace(trace, before=np.zeros(3))


def test_importing_the_report_loads_no_drawing_and_no_torch() -> None:
    code = "import sys, phnn.report; print([m for m in ('matplotlib', 'torch', 'jinja2', 'scipy') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_anchors_lead_somewhere(report: tuple[str, Path, Page]) -> None:
    content = (report[1] / "report.html").read_text("utf-8")
    for target in report[2].fetched:
        if target.startswith("#"):
            assert f'id="{target[1:]}"' in content
