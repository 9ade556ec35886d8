"""The pages of the server in a real browser: a report runs confined, and everything else without scripts."""

from __future__ import annotations

from pathlib import Path

import pytest
from chromium import PROGRAM, chromium
from served import diagnosed, running

from phnn.output import Place
from phnn.report import CandidateRow, Evidence, Trace, write_report

pytestmark = pytest.mark.skipif(PROGRAM is None, reason="no Chromium is installed: the pages are not opened")


def _report(folder: Path) -> None:
    import numpy as np

    t = np.linspace(0.0, 1.0, 500)
    y = np.sin(10.0 * t)
    trace = Trace("sine", t, 10.0 * y, y, 0.9 * y, y + 1e-3, 1e-3, True, np.ones(500, dtype=bool))
    evidence = Evidence((trace,), (), (), (CandidateRow("creep", "mechanical", 1.0, 0.5, None, "kept"),), (), (), "")
    write_report({"verdict": "none", "fit": {"before": {"sine": {}}}}, evidence, Place(folder))


def test_a_served_report_zooms_and_reads_nothing_from_the_server(tmp_path: Path) -> None:
    diagnosed(tmp_path / "runs" / "a")
    (tmp_path / "runs" / "a" / "report.html").unlink()
    _report(tmp_path / "runs" / "a")
    stranger = "<!doctype html><script>document.title = 'ran'</script><img src='/file/a/figures/x.png'>"
    (tmp_path / "runs" / "a" / "stranger.html").write_text(stranger)
    with chromium(tmp_path / "profile") as page, running(tmp_path / "runs") as found:
        for path in ("", "run/a", "compare?a=a&b=a"):
            page.open(found.url + path)
            assert page.complaints() == []
            # The style is applied: its hash is the one of the policy.
            assert page.value("getComputedStyle(document.querySelector('main')).maxWidth") == "1020px"
        page.open(found.url + "file/a/report.html")
        assert page.complaints() == []
        page.value("phnnReport.groups[0].zoom(0.2, 0.4)")
        assert page.value("phnnReport.groups[0].plots.map(p => p.scales.x.min).join()") == "0.2,0.2,0.2"
        assert page.value("origin") == "null"
        assert page.value(f"fetch('{found.url}').then(() => 'read', () => 'refused')") == "refused"
        page.open(found.url + "file/a/stranger.html")
        assert page.value("document.title") == ""
        assert len(page.complaints()) == 2
