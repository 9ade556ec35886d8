"""The pages of the server: all runs, one run, two runs compared. No script; every name is escaped."""

from __future__ import annotations

from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from urllib.parse import quote

from phnn.intake.names import printable
from phnn.report.formatting import change, number, ratio
from phnn.report.plain import plain_page
from phnn.report.scripts import content, hash_source
from phnn.serve.comparing import Comparison
from phnn.serve.inside import KINDS
from phnn.serve.runs import Run

# Runs that were not written to for longer are taken for dead: their pages are no longer loaded again and again [s].
_ALIVE = 3600.0
_MINUTE, _HOUR, _DAY = 60.0, 3600.0, 86400.0


@cache
def policy() -> str:
    """Content-Security-Policy of these pages: their own style, forms to this server, and nothing else."""
    return (
        f"default-src 'none'; style-src {hash_source(content('plain.css'))}; form-action 'self'; base-uri 'none'; "
        "frame-ancestors 'none'"
    )


def runs_page(root: Path, runs: list[Run]) -> bytes:
    """All runs below a folder."""
    goes_on = any(_alive(run) for run in runs)
    comparable = [run for run in runs if run.before or run.parameters]
    return _page("runs.html", root=printable(str(root)), runs=runs, refresh=goes_on, comparable=comparable)


def run_page(run: Run, files: list[str]) -> bytes:
    """One run: its files, and its steps while it goes on."""
    return _page("run.html", run=run, files=files, refresh=_alive(run))


def compared_page(comparison: Comparison) -> bytes:
    """Two runs side by side."""
    return _page("compared.html", c=comparison, runs=(comparison.first, comparison.second))


def refused_page(text: str) -> bytes:
    """Why there is nothing at an address."""
    return _page("refused.html", text=text)


def files_of(folder: Path) -> list[str]:
    """Names of the files directly in a folder that the server gives out."""
    files = (p for p in folder.iterdir() if p.is_file() and not p.name.startswith("."))
    return sorted(p.name for p in files if p.suffix.lower() in KINDS)


def address(kind: str, *parts: str) -> str:
    """Link to a file or to a run of this server."""
    path = "/".join(part for part in parts if part not in ("", "."))
    return f"/{kind}/{quoted(path)}"


def quoted(name: str) -> str:
    """A name of a folder, as an address spells it: bytes that are no UTF-8 stay what they are."""
    return quote(name, errors="surrogateescape")


def _page(template: str, **values: object) -> bytes:
    helpers = {f.__name__: f for f in (address, ago, change, number, printable, quoted)}
    return plain_page("phnn.serve", template, **helpers, show=ratio, **values)


def _alive(run: Run) -> bool:
    return not run.complete and _seconds_since(run.changed) < _ALIVE


def _seconds_since(when: datetime) -> float:
    return (datetime.now(UTC) - when).total_seconds()


def ago(when: datetime) -> str:
    """How long ago something was, in one unit: ``3 min ago``."""
    seconds = max(_seconds_since(when), 0.0)
    for unit, size, least in (("d", _DAY, 2 * _DAY), ("h", _HOUR, 2 * _HOUR), ("min", _MINUTE, 2 * _MINUTE)):
        if seconds >= least:
            return f"{seconds / size:.0f} {unit} ago"
    return f"{seconds:.0f} s ago"
