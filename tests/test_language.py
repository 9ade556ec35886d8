"""Docstrings, comments, messages and documents use the terms of the field; `docs/glossary.md` defines them."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DOCUMENTS = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
MODULES = sorted((ROOT / "phnn").rglob("*.py"))

# A pattern of words that a reader has to guess; what to say in their place.
REPLACE: dict[str, str] = {
    r"\b(on|the|a|another|base) ground\b(?! loop)": "linearised fit",
    r"\bown parts?\b": "nuisances",
    r"\b(slow|learned|a|the|such a|gain's) courses?\b": "drift",
    r"(?<!laws\.)\bleaf\b": "reducible storage",
    r"\b(stiff|linear|lossless|these|the|all|of) leaves\b(?! (no|nothing|less|more|at|it|the|a|in)\b)": (
        "reducible storage"
    ),
    r"\bwide (laws?|resistors?|storages?)\b": "additive-unit law",
    r"\bsound(ed|ings?)\b": "sample of the source input",
    r"\b(further|next|several|few|first|second) looks?\b": "evaluation, test",
    r"\blookups?\b": "table access",
    r"(?<!\.)\bmarch(es|ed|ing)?\b(?!:)": "integrate, integration",
    r"\bsettled\b(?!:)": "converged, in equilibrium, periodic, final",
    r"(?<!\.)\bmemories\b(?!:|\[)|\bmemory (state|law)s?\b": "modulator states",
    r"\b(where|what) (it|they|that) (lies|lie)\b": "location, path, name the thing",
    r"\bakin\b(?!:)": "related",
    r"\bfak(e|es|ed|ing)\b|\bimitat": "confound",
    r"\bin vain\b|\bnibbl|\bastray\b": "rejected; what is compared with what",
    r"\b(loud|loudest|boldly|bold (start|step)s?)\b": "large, with the number that it exceeds",
    r"\bripples?\b": "a cost that is not smooth on a small scale",
    r"\bwhat (\w+ ){0,4}of (it|them|that)\b": "the quantity by its name",
    r"\bof those (that|which)\b|\bthat of which\b": "name the things",
    r"\b(it|they|that|which) (is|are) none\b|\b(is|are) none of\b": "is not one",
    r"\b(lead|leads|led) nowhere\b": "the outcome",
    r"\bnext to nothing\b": "little, with the number",
}


def _texts(path: Path) -> Iterator[tuple[int, str]]:
    """First line and text of all that people read: documents; comments and strings with a blank of modules."""
    text = path.read_text("utf-8")
    if path.suffix == ".md":
        yield 1, text
        return
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT or (token.type == tokenize.STRING and " " in token.string):
            yield token.start[0], token.string


@cache
def texts() -> list[tuple[str, int, str]]:
    """Path, first line and text of everything; read by the process that needs them, not by all that look for tests."""
    return [
        (path.relative_to(ROOT).as_posix(), line, text)
        for path in (*DOCUMENTS, *MODULES)
        for line, text in _texts(path)
    ]


def private(pattern: str) -> list[str]:
    """Places where a pattern stands, also across the end of a line."""
    search = re.compile(pattern.replace(" ", r"\s+"), re.IGNORECASE)
    return [
        f"{path}:{first + text.count(chr(10), 0, hit.start())}: {hit[0]!r}"
        for path, first, text in texts()
        for hit in search.finditer(text)
    ]


@pytest.mark.parametrize("pattern", REPLACE)
def test_no_private_words(pattern: str) -> None:
    hits = private(pattern)
    assert not hits, f"say: {REPLACE[pattern]}\n" + "\n".join(hits)


def test_no_module_begins_with_a_question() -> None:
    begins = re.compile(r'"""(What|How|Where|Which|Whether|Why|When)\b')
    assert not [path.name for path in MODULES if begins.match(path.read_text("utf-8"))]


def test_the_glossary_is_in_order() -> None:
    rows = [line.split("|")[1] for line in (ROOT / "docs/glossary.md").read_text("utf-8").splitlines() if "|" in line]
    terms = [t.strip(" `").lower() for t in rows[2 : rows.index(" location ", 3)]]
    assert terms == sorted(set(terms))


# Names that say nothing of what they hold, and answers whose docstring begins with no verb: every change may lower
# these counts, none may raise them.
VAGUE = {"found", "here", "said", "left", "own", "beside", "told"}
NO_VERB = re.compile(r"(The|An?|Whether|What|How|Why|Where|Which|All|Every|Each|Names?|Values|Numbers?)\b|[^A-Z]")
MOST_VAGUE, MOST_WITHOUT_VERB = 3, 52


def test_names_and_docstrings_say_what_they_hold() -> None:
    kept = (ast.Name, ast.arg, ast.FunctionDef)
    vague, without_verb = [], []
    for path in MODULES:
        for n in (node for node in ast.walk(ast.parse(path.read_text("utf-8"))) if isinstance(node, kept)):
            name = n.id if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store) else getattr(n, "arg", "")
            vague += [f"{path}:{n.lineno} {name}"] if name in VAGUE else []
            answers = isinstance(n, ast.FunctionDef) and n.returns and ast.unparse(n.returns) != "None"
            if answers and NO_VERB.match(ast.get_docstring(n) or "Return"):
                without_verb.append(f"{path}:{n.lineno} {n.name}")
    assert len(vague) <= MOST_VAGUE and len(without_verb) <= MOST_WITHOUT_VERB, "\n".join([*vague, *without_verb])
