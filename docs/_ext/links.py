"""Check the links of the built site without a network: ``python docs/_ext/links.py build/site``.

Each link to a page, picture, file or anchor of the site has to lead somewhere; links to other sites are counted. Pages
must not load scripts, styles or pictures from elsewhere.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

# Attributes that lead to something, by tag; those that the browser loads by itself.
_LINKS = {"a": "href", "img": "src", "script": "src", "link": "href", "source": "src"}
_LOADED = ("img", "script", "source")


@dataclass
class Page(HTMLParser):
    """The links and anchors of a page."""

    links: list[tuple[str, str]] = field(default_factory=list)
    anchors: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        super().__init__()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Keep identifiers and targets."""
        given = dict(attrs)
        self.anchors |= {str(given[k]) for k in ("id", "name") if given.get(k)}
        target = given.get(_LINKS.get(tag, ""))
        loaded = tag in _LOADED or (tag == "link" and given.get("rel") == "stylesheet")
        if target:
            self.links.append(("loaded" if loaded else "link", target))


@cache
def parsed(path: Path) -> Page:
    """Parse an HTML file, once: many links lead to one page."""
    page = Page()
    page.feed(path.read_text(encoding="utf-8"))
    return page


def broken(path: Path, kind: str, target: str) -> str:
    """What is wrong with a link of a page; empty where nothing is."""
    parts = urlsplit(target)
    if parts.scheme in ("data", "mailto"):
        return ""
    if parts.scheme or parts.netloc:
        return f"loads {target}" if kind == "loaded" else ""
    found = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    if found.is_dir():
        found /= "index.html"
    if not found.exists():
        return f"{target} does not exist"
    anchor = unquote(parts.fragment)
    if anchor and found.suffix == ".html" and anchor not in parsed(found).anchors:
        return f"{target} has no such anchor"
    return ""


def main(site: Path) -> int:
    """Check all pages; exit status 1 if a link is broken."""
    pages = sorted(p for p in site.rglob("*.html") if "_static" not in p.parts)
    inside = outside = 0
    failures = []
    for path in pages:
        for kind, target in parsed(path).links:
            away = bool(urlsplit(target).netloc)
            inside, outside = inside + (not away), outside + away
            if wrong := broken(path, kind, target):
                failures.append(f"{path.relative_to(site)}: {wrong}")
    for failure in dict.fromkeys(failures):
        print(failure, file=sys.stderr)
    print(f"{len(pages)} pages, {inside} links within the site checked, {outside} to other sites not followed")
    return int(not pages or bool(failures))


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
