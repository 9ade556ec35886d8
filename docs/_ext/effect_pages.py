"""Sphinx extension: a page and a picture for each effect of the catalogue, made when the site is built."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from effect_pictures import draw
from effect_scenes import shown
from effect_text import index, page
from sphinx.application import Sphinx

from phnn.effects import catalogue, kinds

FOLDER = "effects"


def write_if_changed(path: Path, text: str) -> None:
    """Write a page only if it differs, so that Sphinx reads only changed pages again."""
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def generate(folder: Path) -> list[str]:
    """Write all pages and pictures into a folder; returns the names of the effects."""
    effects = sorted(catalogue().values(), key=lambda e: (kinds.LOCATIONS.index(e.location), e.name))
    (folder / "pictures").mkdir(parents=True, exist_ok=True)
    for effect in effects:
        found = shown(effect)
        draw(found, folder / "pictures" / f"{effect.name}.png")
        write_if_changed(folder / f"{effect.name}.md", page(found))
    write_if_changed(folder / "index.md", index(effects))
    wanted = {"index", *(e.name for e in effects)}
    for stale in (p for p in folder.glob("*.md") if p.stem not in wanted):
        stale.unlink()
    return [e.name for e in effects]


def _generate(app: Sphinx) -> None:
    generate(Path(app.srcdir) / FOLDER)


def setup(app: Sphinx) -> dict[str, Any]:
    """Generate the pages before Sphinx looks for sources."""
    app.connect("builder-inited", _generate)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
