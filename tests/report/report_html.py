"""A page as a parser of HTML sees it."""

from __future__ import annotations

import re
from html.parser import HTMLParser

_VOID = {"meta", "img", "br", "path", "link", "hr", "input"}


class Page(HTMLParser):
    """Collects what a browser would fetch, the visible text, scripts and their policy, and tags left open."""

    def __init__(self, content: str) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.tags: list[str] = []
        self.open: list[str] = []
        self.scripts: list[str] = []
        self.data: list[str] = []
        self.policy = ""
        self.text = ""
        self.feed(content)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.fetched += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "data")]
        if tag == "script":
            (self.data if dict(attrs).get("type") == "application/json" else self.scripts).append("")
        if dict(attrs).get("http-equiv") == "Content-Security-Policy":
            self.policy = dict(attrs)["content"] or ""
        assert not any(name.startswith("on") for name, _ in attrs)
        if tag not in _VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in _VOID:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "script" in self.open:
            found = self.data if "application/json" in (self.get_starttag_text() or "") else self.scripts
            found[-1] += data
        elif "style" not in self.open:
            self.text += data

    def leads_away(self) -> list[str]:
        """Links that are neither data, nor a place in the page, nor a picture beside it."""
        return [t for t in self.fetched if not t.startswith(("data:image/", "data:text/csv;", "#", "figures/"))]

    def allowed(self) -> set[str]:
        """Hashes of the scripts that the policy allows."""
        return set(re.findall(r"'sha256-([^']+)'", self.policy))
