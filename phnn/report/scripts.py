"""The scripts and styles inside a page, and the policy under which a browser runs them and nothing else."""

from __future__ import annotations

import base64
import hashlib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from markupsafe import Markup


def content(name: str) -> str:
    """A file of the package `phnn.report`."""
    return files("phnn.report").joinpath(name).read_text("utf-8")


@dataclass(frozen=True)
class Scripts:
    """Attributes:
    texts: the content of every ``script`` element that a browser may run.
    style: the content of the ``style`` element.
    policy: Content-Security-Policy that allows these scripts by their hashes, pictures within the page, and nothing
        from anywhere.
    """

    texts: tuple[Markup, ...]
    style: Markup
    policy: str


@cache
def scripts() -> Scripts:
    """Scripts, style and policy of a report; the plotting library stands unchanged below its licence."""
    library = f"/*\n{content('vendor/uplot/LICENSE')}*/\n{content('vendor/uplot/uPlot.iife.min.js')}"
    texts = (library, content("live.js"))
    style = content("vendor/uplot/uPlot.min.css") + "\n" + content("report.css")
    return Scripts(tuple(map(Markup, texts)), Markup(style), _policy(texts))


def hash_source(text: str) -> str:
    """A script or style as a policy names it: by the SHA-256 of its text."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode('ascii')}'"


def _policy(texts: tuple[str, ...]) -> str:
    """Styles stand in attributes, too (lengths of bars, colours of plots), which no hash can allow: any style may."""
    return (
        f"default-src 'none'; script-src {' '.join(map(hash_source, texts))}; style-src 'unsafe-inline'; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    )
