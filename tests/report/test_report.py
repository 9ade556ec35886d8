"""The report as a whole: a short first screen, one file that opens offline, escaped and accessible."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import fields, replace
from functools import cache
from html.parser import HTMLParser
from pathlib import Path

import campaigns
import numpy as np
import pytest
from chromium import PROGRAM, chromium
from chromium import Page as Window

import phnn
from phnn.diagnose.diagnosis import Diagnosis
from phnn.effects import catalogue
from phnn.report.figures.style import Drawing
from phnn.report.page import Bar, Bars, Block, Code, Formula, Link, Section, Table, literal_text, page
from phnn.report.result import document, write
from phnn.report.sections import curve_of, notebook, sections
from phnn.report.statements import LONGEST, causes, consequence, headline, quality, summary
from phnn.results import file_name

_VOID = {"meta", "img", "br", "path", "use", "link", "hr", "input"}


class Page(HTMLParser):
    """Collects what a browser would fetch, the visible text, the policy, and tags left open."""

    def __init__(self, content: str) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.tags: list[str] = []
        self.open: list[str] = []
        self.policy = ""
        self.text = ""
        self.feed(content)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.fetched += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "data")]
        if dict(attrs).get("http-equiv") == "Content-Security-Policy":
            self.policy = dict(attrs)["content"] or ""
        assert not any(name.startswith("on") for name, _ in attrs)
        if tag not in _VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in _VOID:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.text += data


_LARGEST = 3_000_000  # bytes of a page
# Effects that are concealed, and what there is to explain them with; a class is made from a named effect.
CASES = {"none": ("none",), "named": ("quadratic_drag",), "unknown": ("quadratic_drag", "sensor_drift")}


@cache
def made(verdict: str) -> Diagnosis:
    if verdict != "equivalent":
        effect, *names = CASES[verdict]
        return campaigns.diagnosis(effect, *names)
    found = made("named")
    claim = replace(found.claims[0], status="equivalent", alike=(catalogue()["coulomb_friction"],))
    return replace(found, outcome=replace(found.outcome, word="equivalent", claims=(claim,)), proposal=None)


VERDICTS = ("named", "equivalent", "unknown", "none")


@pytest.fixture(scope="module", params=VERDICTS)
def report(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Diagnosis, Path, Page]:
    folder = tmp_path_factory.mktemp(request.param)
    write(made(request.param), folder)
    return made(request.param), folder, Page((folder / "report.html").read_text("utf-8"))


def first_screen(content: str) -> Page:
    """What does not fold."""
    return Page(content.partition("<details")[0] + "</main></body></html>")


def test_the_first_screen_is_a_line_a_sentence_a_picture_and_bars(report: tuple[Diagnosis, Path, Page]) -> None:
    found, folder, _ = report
    content = (folder / "report.html").read_text("utf-8")
    top = first_screen(content)
    assert headline(found) in top.text and consequence(found) in top.text
    assert content.count("<figure") >= 1 and top.tags.count("figure") == 1
    letters = re.sub(r"\s+", " ", re.sub(r"<svg.*?</svg>", "", content.partition("<details")[0], flags=re.DOTALL))
    letters = re.sub(r"<style>.*?</style>|<[^>]+>", "", letters)
    assert len(letters) < 1500
    for name, _ in causes(found):
        assert name in top.text
    assert "table" not in top.tags


@pytest.mark.parametrize("verdict", VERDICTS)
def test_the_headline_is_short_and_the_number_is_the_same_everywhere(verdict: str) -> None:
    found = made(verdict)
    line = headline(found)
    assert len(line) <= LONGEST == 90 and "\n" not in line
    expected = {
        "named": "Quadratic drag is missing: more than 99 % sure",
        "equivalent": "Quadratic drag or Coulomb friction is missing; these recordings cannot tell which",
        "unknown": "A mechanical effect is missing; no name is proven",
        "none": "Nothing is missing",
    }
    assert line == expected[verdict]
    q = quality(found)
    assert q.held_out and q.after == found.after.over_noise("confirmation")
    assert q.say(q.after) in consequence(found)
    lines = summary(found).splitlines()
    assert lines[:2] == [line, consequence(found)] and f"verdict: {verdict}" in lines


def test_many_names_are_told_as_far_as_the_line_holds_them() -> None:
    found = made("named")
    others = tuple(catalogue()[n] for n in ("coulomb_friction", "hysteresis_asymmetry", "amplifier_saturation"))
    claim = replace(found.claims[0], status="equivalent", alike=others)
    many = replace(found, outcome=replace(found.outcome, word="equivalent", claims=(claim,)))
    assert headline(many) == "Quadratic drag, Coulomb friction, hysteresis asymmetry or amplifier saturation is missing"
    more = replace(claim, alike=(*others, catalogue()["displacement_coupling"]))
    many = replace(found, outcome=replace(found.outcome, word="equivalent", claims=(more,)))
    assert headline(many) == "One of 5 effects is missing; these recordings cannot tell which"


def test_without_a_noise_floor_the_error_is_a_share_of_the_signal() -> None:
    found = made("named")
    first, *others = found.campaign.recordings
    bare = replace(found, campaign=replace(found.campaign, recordings=(replace(first, noise_found=False), *others)))
    assert "× noise" in consequence(found)
    assert "× noise" not in consequence(bare) and "% of the signal" in consequence(bare)


def test_an_unknown_helps() -> None:
    told = summary(made("unknown"))
    assert "Use the model all the same: it predicts held-out recordings to" in told
    assert "It acts most like" in told or "The model describes it by" in told
    assert "No name is proven, because a learned element is part of the model." in told


@pytest.mark.parametrize("verdict", VERDICTS)
def test_probabilities_are_at_most_one_and_nothing_missing_is_last(verdict: str) -> None:
    rows = causes(made(verdict))
    assert rows[-1][0] == "nothing is missing" and len(rows) <= 5
    assert all(0.0 <= p <= 1.0 + 1e-12 for _, p in rows)


def test_a_base_model_that_nothing_improves_is_no_answer() -> None:
    found = made("unknown")
    bare = replace(found, outcome=replace(found.outcome, word="unknown", claims=()))
    rows = dict(causes(bare))
    assert "nothing is missing" not in rows and "something else" not in rows
    assert rows["nothing that was tried"] >= found.probability["none"]


def test_page_opens_offline_without_scripts(report: tuple[Diagnosis, Path, Page]) -> None:
    _, folder, shown = report
    assert not {"link", "iframe", "object", "base", "script"} & set(shown.tags)
    assert [t for t in shown.fetched if not t.startswith(("data:image/", "#"))] in ([], ["next_experiment.csv"])
    assert shown.open == []
    assert shown.policy.startswith("default-src 'none';")
    assert (folder / "report.html").stat().st_size < _LARGEST
    assert not re.search(r"\b(None|nan|null|Undefined)\b", shown.text)


def test_pictures_have_alternative_texts_and_tables_have_heads(report: tuple[Diagnosis, Path, Page]) -> None:
    content = (report[1] / "report.html").read_text("utf-8")
    pictures = re.findall(r"<figure>(<\w+ [^>]*>)", content)
    assert pictures and all(re.search(r'(aria-label|alt)="[^"]{10,}"', p) for p in pictures)
    assert content.count("<table>") == content.count("<thead>")
    assert "<html lang=" in content and content.count("<h1>") == 1
    files = list((report[1] / "figures").iterdir())
    assert len(files) == len(pictures) and all(f.read_bytes().startswith(b"\x89PNG") for f in files)


def test_a_curve_belongs_to_the_element() -> None:
    found = made("named")
    (claim,) = found.claims
    curve = curve_of(found, claim)
    assert curve is not None and curve.title.startswith("mechanical")
    elsewhere = replace(claim, effect=catalogue()["amplifier_lowpass"])
    assert curve_of(found, elsewhere) is None
    (learned,) = made("unknown").claims
    law = curve_of(made("unknown"), learned)
    assert law is not None and law.title.startswith("learned one-port")
    # Drag takes energy from the motion, forwards and backwards, and grows faster than the speed.
    assert np.all(law.x * law.y <= 0.0)
    assert abs(law.y[-1]) > 3.0 * abs(float(np.interp(0.5 * law.x[-1], law.x, law.y)))


def test_an_element_is_told_with_its_evidence() -> None:
    folded = {s.title: s.blocks for s in sections(made("named"), document(made("named")), None)}
    text = " ".join(b for b in folded["What is missing"] if isinstance(b, str))
    effect = catalogue()["quadratic_drag"]
    for part in (effect.fingerprint, effect.references[0], "stays passive"):
        assert part in text
    assert any(isinstance(b, Formula) for b in folded["What is missing"])
    (table,) = (b for b in folded["Parameters"] if isinstance(b, Table))
    assert {row[0].partition(" (")[0] for row in table.rows} >= {"m", "k", "alpha", "C_1", "d_2", "c_2"}


HOSTILE = '<script>alert("1")</script> $\\frac$ [bold]'


def test_names_from_outside_are_escaped() -> None:
    every: list[Block] = [
        HOSTILE, Table([HOSTILE], [[HOSTILE]]), Bars(HOSTILE, [Bar(HOSTILE, 2.0, HOSTILE, HOSTILE)]), Formula(HOSTILE),
        Code(HOSTILE), Link(HOSTILE, HOSTILE), Drawing(HOSTILE, HOSTILE, HOSTILE, b"\x00" * 32),
    ]  # fmt: skip
    text = page(HOSTILE, HOSTILE, [Section(None, every), Section(HOSTILE, every)], HOSTILE).decode()
    shown = Page(text)
    assert "script" not in shown.tags and "<script" not in text
    assert shown.open == [] and shown.text.count(HOSTILE) > 10
    assert "width:100%" in text


def test_files_of_recordings_with_odd_names_stay_in_their_folder(tmp_path: Path) -> None:
    found = made("named")
    part = f"../{HOSTILE}"
    names = {r.name: f"{part}{i}" for i, r in enumerate(found.campaign.recordings)}
    recordings = tuple(
        replace(
            r, name=names[r.name], parts=tuple(replace(p, name=p.name.replace(r.name, names[r.name])) for p in r.parts)
        )
        for r in found.campaign.recordings
    )
    scores = [
        replace(
            e, outputs={names[n]: y for n, y in e.outputs.items()},
            parts=tuple(replace(p, name=names.get(p.name, p.name)) for p in e.parts),
        )
        for e in (found.before, found.after)
    ]  # fmt: skip
    odd = replace(found, campaign=replace(found.campaign, recordings=recordings), before=scores[0], after=scores[1])
    write(odd, tmp_path / "out")
    assert "<script" not in (tmp_path / "out" / "report.html").read_text("utf-8")
    for path in (tmp_path / "out" / "figures").iterdir():
        assert path.name == file_name(path.name) and not set(path.name) & set("<>\"'&$`\\/:*?|")


@pytest.mark.parametrize("name", ['=cmd|"/C calc"!A1', "+1", "-2", "@SUM(A1)", "\t=1"])
def test_a_name_is_no_formula(name: str) -> None:
    assert literal_text(name) == f"'{name}" and literal_text("a") == "a"


def test_same_diagnosis_gives_the_same_bytes(report: tuple[Diagnosis, Path, Page], tmp_path: Path) -> None:
    found, folder, _ = report
    write(found, tmp_path)
    assert (tmp_path / "report.html").read_bytes() == (folder / "report.html").read_bytes()


def facade(verdict: str) -> phnn.Diagnosis:
    """The diagnosis as `phnn.diagnose` returns it."""
    return phnn.Diagnosis(**{f.name: getattr(made(verdict), f.name) for f in fields(Diagnosis)})


def test_a_diagnosis_in_python() -> None:
    found = facade("named")
    assert str(found) == summary(found) and len(repr(found)) < 200
    assert found.missing == ("quadratic_drag",) and found.probability["quadratic_drag"] > 0.95
    (axes,) = found.plot().axes
    assert axes.get_ylabel() == "error (nm)"
    assert facade("none").missing == ()
    assert facade("unknown").missing == ("unknown",)


def test_values_show_themselves_in_notebooks() -> None:
    found = made("named")
    shown = Page(notebook(found))
    assert headline(found) in shown.text and shown.open == [] and "img" in shown.tags
    recordings = Page(found.campaign._repr_html_())
    assert all(r.name in recordings.text for r in found.campaign.recordings) and recordings.open == []
    model = Page(found.model._repr_html_())
    assert "dq/dt = e(p)" in model.text and "c_2" in model.text and model.open == []


# ---- In a browser

_browser = pytest.mark.skipif(PROGRAM is None, reason="no Chromium is installed: the page is not opened")


@pytest.fixture(scope="module")
def window(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Window]:
    with chromium(tmp_path_factory.mktemp("profile")) as one:
        yield one


# Contrast of each text with its ground, as the accessibility guidelines (WCAG 2) define it.
_CONTRAST = """
(() => {
  const light = c => { const [r, g, b] = c.match(/[0-9.]+/g).map(Number).map(v => v / 255)
    .map(v => v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4); return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
  const ground = e => { const c = getComputedStyle(e).backgroundColor;
    return c === 'rgba(0, 0, 0, 0)' && e.parentElement ? ground(e.parentElement) : c; };
  const found = [...document.querySelectorAll('p, h1, h2, h3, li, th, td, a, small, figcaption, pre code')].map(e => {
    const pair = [light(getComputedStyle(e).color), light(ground(e))].sort((a, b) => b - a);
    return (pair[0] + 0.05) / (pair[1] + 0.05); });
  return Math.min(...found);
})()
"""


@_browser
@pytest.mark.parametrize("width", [1280, 420])
@pytest.mark.parametrize("dark", [False, True])
def test_the_page_fits_the_window_and_can_be_read(
    window: Window, report: tuple[Diagnosis, Path, Page], width: int, dark: bool
) -> None:
    address = (report[1] / "report.html").as_uri()
    window.size(width, dark=dark)
    window.open(address)
    window.value("document.querySelectorAll('details').forEach(d => d.open = true)")
    assert window.value("document.documentElement.scrollWidth") <= width
    light = window.value("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert light != dark
    assert float(window.value(_CONTRAST)) >= 4.5
    assert window.complaints() == [] and window.fetched() == [address]


@_browser
def test_keys_open_a_section_and_print_has_all_of_them(window: Window, report: tuple[Diagnosis, Path, Page]) -> None:
    window.size(1280)
    window.open((report[1] / "report.html").as_uri())
    window.value("document.querySelector('summary').focus()")
    for kind in ("keyDown", "keyUp"):
        window.call("Input.dispatchKeyEvent", type=kind, key="Enter", code="Enter", windowsVirtualKeyCode=13, text="\r")
    assert window.value("document.querySelector('details').open") is True
    window.call("Emulation.setEmulatedMedia", media="print")
    try:
        inside = "Math.min(...[...document.querySelectorAll('details > p')].map(e => e.getBoundingClientRect().height))"
        assert float(window.value(inside)) > 0.0
        assert window.printed().startswith(b"%PDF")
    finally:
        window.call("Emulation.setEmulatedMedia", media="")
