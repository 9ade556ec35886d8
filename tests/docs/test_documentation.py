"""The code of the documentation runs and prints what the pages say; pages of effects say what the effects declare."""

from __future__ import annotations

import re
from dataclasses import asdict
from pathlib import Path

import blocks
import numpy as np
import pytest
from docstrings import examples, marked
from effect_scenes import SHOWN, scene_of, shown
from effect_text import index, page, title
from links import broken, main

from phnn.effects import catalogue, effect
from phnn.intake import LIMITS, available_memory

PAGE = """\
# A page

```python
x = 2
print(x, "mm")
```

```text
2 mm
```

<!-- not run: needs a cluster -->

```python
connect()
```

```python
print(x + 1)
```
"""


def written(folder: Path, monkeypatch: pytest.MonkeyPatch, text: str) -> blocks.Outcome:
    """The outcome of a page with a text."""
    (folder / "page.md").write_text(text, encoding="utf-8")
    monkeypatch.setattr(blocks, "DOCS", folder)
    return blocks.run_page("page")


def test_blocks_share_names_and_skipped_ones_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    outcome = written(tmp_path, monkeypatch, PAGE)
    assert (outcome.run, outcome.skipped, outcome.failure) == (2, 1, "")
    assert outcome.reasons == ("needs a cluster",)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("2 mm\n```", "3 mm\n```", "the page states"),
        ("2 mm\n```", "2 µm\n```", "the page states"),
        ("print(x + 1)", "print(y)", "NameError"),
        ("print(x + 1)", "print(x +", "SyntaxError"),
    ],
)
def test_what_is_wrong_with_a_block_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, old: str, new: str, says: str
) -> None:
    assert says in written(tmp_path, monkeypatch, PAGE.replace(old, new)).failure


def test_numbers_may_differ_a_little() -> None:
    assert not blocks.differs("1.00 µm, −3", "1.01 µm, −3")
    assert blocks.differs("1.00 µm", "1.03 µm")
    assert blocks.differs("1.00", "−1.00")
    assert blocks.differs("named", "named 1")


def test_every_page_of_markdown_has_no_fenced_block_that_is_overlooked() -> None:
    for path in sorted(blocks.DOCS.glob("*.md")):
        text = path.read_text(encoding="utf-8")
        assert len(blocks.blocks_of(text)) == text.count("```python\n"), path.name


def test_every_page_stands_in_a_table_of_contents() -> None:
    listed = {"index"}
    for path in blocks.DOCS.glob("*.md"):
        for block in re.findall(r"^```\{toctree\}\n(.*?)^```$", path.read_text("utf-8"), re.DOTALL | re.MULTILINE):
            listed |= {line for line in block.split("\n") if line and not line.startswith(":")}
    assert {path.stem for path in blocks.DOCS.glob("*.md")} <= listed


def test_indented_examples_of_docstrings_are_code_and_equations_are_not() -> None:
    docstring = "Do it.\n\n    y = f(x)\n\n    ẋ = −k x\n\nArgs:\n    x: a number.\n\n    more of it.\n"
    assert examples(docstring) == ["y = f(x)"]
    text = "\n".join(marked(docstring.splitlines()))
    assert ".. code-block:: python\n\n    y = f(x)" in text
    assert ".. code-block:: text\n\n    ẋ = −k x" in text
    assert text.count("code-block") == 2


def test_a_broken_link_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other, page = tmp_path / "other.html", tmp_path / "index.html"
    other.write_text('<h1 id="here">title</h1>', encoding="utf-8")
    page.write_text('<a href="other.html#here">a</a><a href="https://example.org">b</a>', encoding="utf-8")
    assert main(tmp_path) == 0
    assert broken(page, "link", "other.html#there") == "other.html#there has no such anchor"
    assert broken(page, "link", "none.html") == "none.html does not exist"
    assert broken(page, "loaded", "https://example.org/a.js") == "loads https://example.org/a.js"
    (tmp_path / "third.html").write_text('<a href="none.html">a</a>', encoding="utf-8")
    assert main(tmp_path) == 1
    assert "none.html does not exist" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("page", blocks.pages_with_code())
def test_the_code_of_a_page_runs(page: str) -> None:
    (outcome,) = blocks.in_processes([page])
    assert outcome.failure == ""
    assert outcome.run + outcome.skipped > 0


@pytest.mark.parametrize("name", ["creep", "amplifier_saturation", "mains_pickup", "overflow"])
def test_a_page_has_symptom_law_parameters_relations_and_separation(name: str) -> None:
    declared, found = effect(name), shown(effect(name))
    text = page(found)
    assert all(part in text for part in (declared.fingerprint, declared.separation, declared.equation))
    assert all(f"| `{p.name}` | " in text for p in declared.declares)
    assert all(f"]({n}.md)" in text for n in declared.neighbours)
    assert f"pictures/{name}.png" in text and "{" not in text.split("## In Python")[0].split("$$")[2]


def test_a_picture_shows_a_strength_that_is_visible_and_what_the_base_model_cannot_explain() -> None:
    found = shown(effect("creep"))
    reach = np.abs(scene_of(found.effect).base.y).max()
    assert np.abs(found.change).max() == pytest.approx(SHOWN * reach, rel=0.15)
    assert 0.05 < np.linalg.norm(found.left) / np.linalg.norm(found.change) < 0.9
    # A constant load shifts the zero of the output and nothing else.
    load = shown(effect("constant_load"))
    assert np.linalg.norm(load.left) < 0.05 * np.linalg.norm(load.change)


def test_the_index_lists_every_effect_once() -> None:
    effects = list(catalogue().values())
    text = index(effects)
    assert all(text.count(f"| [{title(e)}]({e.name}.md) | {e.fingerprint} |") == 1 for e in effects)


def test_limits_are_documented_and_a_file_may_take_less_than_the_memory_that_is_available() -> None:
    text = (blocks.DOCS / "limits.md").read_text(encoding="utf-8")
    for name, value in asdict(LIMITS).items():
        assert f"| `{name}` | {value:,} |" in text
    assert 0.0 < LIMITS.memory_share < 1.0 and available_memory() > 0


def test_tests_that_pages_name_exist() -> None:
    root = Path(__file__).resolve().parents[2]
    files = list(root.glob("tests/**/test_*.py"))
    known = {name for f in files for name in (f.stem, *re.findall(r"def (test_\w+)", f.read_text(encoding="utf-8")))}
    pages = {page.name: page.read_text(encoding="utf-8") for page in (*root.glob("docs/*.md"), root / "README.md")}
    named = [(page, n) for page, text in pages.items() for n in re.findall(r"\btest_\w+", text) if n not in known]
    # A name that is cut off stands for several tests.
    assert [one for one in named if not (one[1].endswith("_") and any(k.startswith(one[1]) for k in known))] == []
