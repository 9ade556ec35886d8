"""Tables of studies in pages of markdown."""

from __future__ import annotations

from pathlib import Path

import pytest

from phnn.errors import InputRefused
from studies.results import fill


def test_a_table_takes_the_place_of_the_one_before(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# A\n\n<!-- begin one -->\nold\n<!-- end one -->\nb\n<!-- begin two -->\nkept\n<!-- end two -->\n")
    fill(page, "one", "| new |\n")
    after = page.read_text()
    assert after.startswith("# A\n\n<!-- begin one -->\n\n| new |\n\n<!-- end one -->\nb\n")
    assert "old" not in after
    assert "kept" in after
    fill(page, "one", "| new |\n")
    assert page.read_text() == after


@pytest.mark.parametrize("content", [None, "# nothing\n", "<!-- begin one -->\n"])
def test_a_page_without_its_lines_is_refused(content: str | None, tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    if content is not None:
        page.write_text(content)
    with pytest.raises(InputRefused, match=r"page\.md"):
        fill(page, "one", "text")
