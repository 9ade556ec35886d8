"""The files of `phnn check`: ``check.json`` and a page of plots."""

from __future__ import annotations

from dataclasses import dataclass

from matplotlib import rc_context

from phnn.check import Checked
from phnn.recordings.describe import facts
from phnn.recordings.recording import Recording
from phnn.report.figures.recorded import draw_recorded
from phnn.report.figures.style import RC, Drawing, png
from phnn.report.page import plain_page
from phnn.results import Place


@dataclass(frozen=True)
class _Entry:
    """A recording on the page."""

    name: str
    facts: list[tuple[str, str]]
    drawing: Drawing


def write_check(checked: Checked, place: Place) -> None:
    """Write ``check.json`` and ``check.html`` into a folder."""
    (place / "check.json").write_json(checked.document())
    recordings = checked.campaign.recordings
    page = plain_page(
        "phnn.report",
        "checked.html",
        checked=checked,
        noticed=[(name, f) for name, found in checked.findings.items() for f in found],
        place={r.name: i for i, r in enumerate(recordings, start=1)},
        entries=[_entry(r) for r in recordings],
    )
    (place / "check.html").write(page)


def _entry(recording: Recording) -> _Entry:
    with rc_context(RC):
        picture = png(draw_recorded(recording))
    title = f"{recording.name}: input and output in time, loop, spectra"
    return _Entry(f"{recording.name} ({recording.source})", facts(recording), Drawing("", title, title, picture))
