"""Plain offline pages of tables and figures."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from phnn.report.formatting import ratio
from phnn.report.page import image


def plain_page(package: str, template: str, **content: Any) -> bytes:
    """A template of a package filled in; every name and sentence from outside is escaped."""
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters.update(image=image, ratio=ratio)
    style = Markup(files("phnn.report").joinpath("plain.css").read_text("utf-8"))
    page = environment.from_string(files(package).joinpath(template).read_text("utf-8"))
    return page.render(style=style, **content).encode()
