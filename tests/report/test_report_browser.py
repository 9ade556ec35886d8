"""The report in a real browser: plots that zoom together, downloads, print, no error on the console."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from chromium import PROGRAM, Page, chromium
from report_example import make_document, make_evidence, make_trace

from phnn.report.write import write_report
from phnn.results import Place

pytestmark = pytest.mark.skipif(PROGRAM is None, reason="no Chromium is installed: the page is not opened")

_NAMES = ("step_50V", "sine_10Hz_75V", "sine_1Hz_75V", "triangle_2Hz_40V")


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of four recordings, two held out; the last one stands in a closed part of the page."""
    folder = tmp_path_factory.mktemp("report")
    evidence = make_evidence(_NAMES, sentence="The model leaves out creep.")
    write_report(make_document("named", evidence), evidence, Place(folder))
    return folder / "report.html"


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with chromium(tmp_path_factory.mktemp("profile")) as page:
        yield page


@pytest.fixture
def page(browser: Page, report: Path) -> Iterator[Page]:
    browser.size(1280)
    browser.open(report.as_uri())
    yield browser
    assert browser.complaints() == []
    assert browser.fetched() == [report.as_uri()]


def _stretches(page: Page, group: int) -> list[list[float]]:
    """What each plot of a recording shows, in seconds."""
    axes = f"phnnReport.groups[{group}].plots.map(p => [p.scales.x.min, p.scales.x.max])"
    return json.loads(page.value(f"JSON.stringify({axes})"))


def _inside(page: Page, plot: str) -> tuple[float, float, float, float]:
    """Left, top, width and height of a plot's inside within the window, scrolled into view."""
    page.value(f"{plot}.over.scrollIntoView({{block: 'center'}})")
    found = json.loads(
        page.value(f"(b => JSON.stringify([b.left, b.top, b.width, b.height]))({plot}.over.getBoundingClientRect())")
    )
    return tuple(found)  # type: ignore[return-value]


def test_a_drag_zooms_all_plots_of_a_recording_and_no_other(page: Page) -> None:
    assert page.value("phnnReport.groups.length") == 3
    before = [_stretches(page, group) for group in range(3)]
    left, top, width, height = _inside(page, "phnnReport.groups[0].plots[1]")
    middle = top + 0.5 * height
    page.mouse("mouseMoved", left + 0.25 * width, middle)
    page.mouse("mousePressed", left + 0.25 * width, middle, button="left", clickCount=1)
    for share in (0.3, 0.4, 0.5):
        page.mouse("mouseMoved", left + share * width, middle, button="left")
    page.mouse("mouseReleased", left + 0.5 * width, middle, button="left", clickCount=1)
    after = [_stretches(page, group) for group in range(3)]
    whole = before[0][0][1] - before[0][0][0]
    assert len(after[0]) == 3 and after[0][0] == after[0][1] == after[0][2]
    assert after[0][0] == pytest.approx(
        [before[0][0][0] + 0.25 * whole, before[0][0][0] + 0.5 * whole], abs=0.01 * whole
    )
    assert after[1:] == before[1:]

    for count in (1, 2):
        page.mouse("mousePressed", left + 0.5 * width, middle, button="left", clickCount=count)
        page.mouse("mouseReleased", left + 0.5 * width, middle, button="left", clickCount=count)
    assert _stretches(page, 0) == before[0]


def test_the_cursor_stands_at_one_time_in_all_plots_of_a_recording(page: Page) -> None:
    left, top, width, height = _inside(page, "phnnReport.groups[0].plots[0]")
    page.mouse("mouseMoved", left + 0.4 * width, top + 0.5 * height)
    page.mouse("mouseMoved", left + 0.5 * width, top + 0.5 * height)
    shown = json.loads(page.value("JSON.stringify(phnnReport.groups.map(g => g.plots.map(p => p.cursor.idx ?? null)))"))
    assert shown[0][0] is not None and shown[0][0] == shown[0][1] == shown[0][2]
    assert shown[1] == [None] * 3


def test_buttons_zoom_as_the_mouse_does(page: Page) -> None:
    press = "[...document.querySelectorAll('.tools button')].find(b => b.textContent === '{}').click()"
    ((low, high), *_) = _stretches(page, 0)
    width = high - low
    for name, expected in (("+", (0.25, 0.75)), ("→", (0.5, 1.0)), ("→", (0.5, 1.0)), ("all", (0.0, 1.0))):
        page.value(press.format(name))
        for stretch in _stretches(page, 0):
            assert stretch == pytest.approx([low + share * width for share in expected], abs=1e-9)


def test_plots_show_the_values_of_the_recording(page: Page) -> None:
    trace = make_trace("sine_10Hz_75V")
    names = json.loads(page.value("JSON.stringify(phnnReport.groups.map(g => g.name))"))
    group = names.index(trace.name)
    values = json.loads(page.value(f"JSON.stringify(phnnReport.groups[{group}].plots[0].data.map(x => [...x]))"))
    assert values[0] == pytest.approx(trace.t, abs=1e-9)
    assert values[1] == pytest.approx(1e6 * trace.measured, abs=1e-3)


def test_a_recording_in_a_closed_part_is_drawn_when_it_is_opened(page: Page) -> None:
    page.value("document.querySelectorAll('details:has(.plots)').forEach(d => d.open = true)")
    page.value("new Promise(done => setTimeout(done, 100))")
    assert page.value("phnnReport.groups.length") == len(_NAMES)


@pytest.mark.parametrize("width", [1280, 400])
@pytest.mark.parametrize("dark", [False, True])
def test_nothing_is_wider_than_the_window(page: Page, width: int, dark: bool) -> None:
    page.size(width, dark=dark)
    # The plots take the new width when the browser has told them, which may take a while on a busy machine.
    page.value(
        "new Promise(done => { const end = Date.now() + 5000; const look = () => "
        f"document.documentElement.scrollWidth <= {width} || Date.now() > end ? done() : setTimeout(look, 50); "
        "look(); })"
    )
    assert page.value("document.documentElement.scrollWidth") <= width
    assert page.value("Math.max(...phnnReport.groups.flatMap(g => g.plots.map(p => p.width)))") <= width
    light = page.value("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert light != dark


def test_links_hold_what_they_promise(page: Page) -> None:
    links = json.loads(
        page.value("JSON.stringify([...document.querySelectorAll('a[download]')].map(a => [a.download, a.href]))")
    )
    assert all(href.startswith("data:image/png;base64,") for name, href in links if name.endswith(".png"))
    assert any(href.startswith("data:image/svg+xml;base64,") for name, href in links if name.endswith(".svg"))
    page.value(
        "URL.createObjectURL = blob => { window.offered = blob; return 'blob:here'; };"
        "document.addEventListener('click', e => e.preventDefault());"
        "document.querySelector('a[data-table]').click()"
    )
    table = list(csv.reader(io.StringIO(page.value("window.offered.text()"))))
    trace = make_trace("sine_10Hz_75V")
    assert table[0][:3] == ["time (s)", "measured: displacement (µm)", "base model: displacement (µm)"]
    assert [float(row[0]) for row in table[1:]] == pytest.approx(trace.t, abs=1e-9)
    assert [float(row[1]) for row in table[1:]] == pytest.approx(1e6 * trace.measured, abs=1e-3)


def test_code_is_selected_where_the_clipboard_is_forbidden(page: Page) -> None:
    page.value("navigator.clipboard.writeText = () => Promise.reject(new Error('forbidden'))")
    page.value("document.execCommand = () => false")
    page.value("document.querySelector('[data-copy=code-python]').click()")
    page.value("new Promise(done => setTimeout(done, 50))")
    assert page.value("document.querySelector('[data-copy=code-python]').textContent") == "selected: press Ctrl+C"
    assert page.value("getSelection().toString()").startswith("import numpy as np\nimport phnn")


def test_print_has_pictures_in_place_of_plots(page: Page) -> None:
    pdf = page.printed()
    assert pdf.startswith(b"%PDF") and len(pdf) > 100_000
    page.call("Emulation.setEmulatedMedia", media="print")
    try:
        hidden = (
            "['.plots', '.files', '.copyable button'].map(n => getComputedStyle(document.querySelector(n)).display)"
        )
        assert page.value(hidden) == ["none"] * 3
        assert page.value("document.querySelector('.panels img').getBoundingClientRect().width") > 600
    finally:
        page.call("Emulation.setEmulatedMedia", media="")


def test_without_scripts_pictures_are_shown(browser: Page, report: Path) -> None:
    browser.size(1280)
    browser.call("Emulation.setScriptExecutionDisabled", value=True)
    try:
        browser.open(report.as_uri())
        assert browser.value("document.documentElement.className") == ""
        assert browser.value("getComputedStyle(document.querySelector('.plots')).display") == "none"
        assert browser.value("document.querySelector('.panels img').getBoundingClientRect().width") > 900
    finally:
        browser.call("Emulation.setScriptExecutionDisabled", value=False)


def test_a_model_that_failed_is_drawn(browser: Page, tmp_path: Path) -> None:
    good = make_trace("step_50V", 400)
    broken = replace(good, name="</script><b>broken", after=np.full(400, np.nan))
    silent = replace(good, name="silent", noise=0.0, u=np.zeros(400), measured=np.zeros(400), before=np.zeros(400))
    evidence = replace(make_evidence(()), traces=(broken, silent))
    write_report({"verdict": "unknown"}, evidence, Place(tmp_path))
    browser.open((tmp_path / "report.html").as_uri())
    assert browser.complaints() == []
    assert browser.value("phnnReport.groups.length") == 2
