"""Code of the documentation, run: ``python docs/_ext/blocks.py [PAGE ...]``.

The fenced python blocks of a page share one process and one namespace, in a temporary folder that `page_setups` fills.
A text block right after a code block is the output that it has to print. A block below ``<!-- not run: reason -->``
is not run; such blocks are counted and reported with their reasons.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1]
README = "README"
# A printed number may differ by this share from the page's: other processors round otherwise, and a fit ends within
# its tolerance.
TOLERANCE = 0.02

_BLOCK = re.compile(
    r"(?:^<!-- not run: (?P<reason>[^\n]*?) -->\n+)?^```python\n(?P<code>.*?)^```$(?:\n+```text\n(?P<out>.*?)^```$)?",
    re.DOTALL | re.MULTILINE,
)
_NUMBER = re.compile(r"[-−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


@dataclass(frozen=True)
class Block:
    """A block of code.

    Attributes:
        code: Python; line: of the page at which it begins.
        printed: the output that the page states; None where it states none.
        reason: why it is not run; empty where it is run.
    """

    code: str
    line: int
    printed: str | None = None
    reason: str = ""


@dataclass(frozen=True)
class Outcome:
    """What running a page gave: numbers of blocks run and not run, reasons, first failure, seconds."""

    page: str
    run: int
    skipped: int
    reasons: tuple[str, ...]
    failure: str
    seconds: float


def blocks_of(text: str) -> list[Block]:
    """The python blocks of a page in their order."""
    return [
        Block(m["code"], text.count("\n", 0, m.start("code")) + 1, m["out"], m["reason"] or "")
        for m in _BLOCK.finditer(text)
    ]


def path_of(page: str) -> Path:
    """The file of a page; README lies above the others."""
    return (DOCS.parent if page == README else DOCS) / f"{page}.md"


def pages_with_code() -> list[str]:
    """README and all pages with python blocks, by name, and the docstrings of the interface."""
    pages = sorted(p.stem for p in DOCS.glob("*.md") if blocks_of(p.read_text(encoding="utf-8")))
    return [README, *pages, "docstrings"]


def differs(printed: str, stated: str) -> bool:
    """Whether output differs from what a page states; numbers may differ by `TOLERANCE`."""
    if _NUMBER.sub("#", printed).split() != _NUMBER.sub("#", stated).split():
        return True
    pairs = zip(_NUMBER.findall(printed), _NUMBER.findall(stated), strict=True)
    values = ((float(a.replace("−", "-")), float(b.replace("−", "-"))) for a, b in pairs)
    return any(abs(a - b) > TOLERANCE * abs(b) for a, b in values)


def load(page: str) -> list[Block]:
    """The blocks of a page, or the examples of the docstrings."""
    if page == "docstrings":
        from page_setups import docstring_examples

        return [Block(code, 0) for code in docstring_examples()]
    return blocks_of(path_of(page).read_text(encoding="utf-8"))


def run_page(page: str) -> Outcome:
    """Run the blocks of a page in this process, in a temporary folder."""
    from page_setups import prepared

    begun, blocks, ran, failure = time.monotonic(), load(page), 0, ""
    back = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            names: dict[str, object] = {"__name__": "page", **prepared(page, Path(folder))}
            for block in (b for b in blocks if not b.reason):
                failure = _failure(page, block, names)
                if failure:
                    break
                ran += 1
        finally:
            os.chdir(back)
    reasons = tuple(b.reason for b in blocks if b.reason)
    return Outcome(page, ran, len(reasons), reasons, failure, round(time.monotonic() - begun, 1))


def _failure(page: str, block: Block, names: dict[str, object]) -> str:
    """Run one block; what went wrong with it, or nothing."""
    where = f"{page}, line {block.line}"
    with contextlib.redirect_stdout(io.StringIO()) as out:
        try:
            exec(compile(block.code, where, "exec"), names)
        except Exception as error:
            return f"{where}: {type(error).__name__}: {error}"
    if block.printed is not None and differs(out.getvalue(), block.printed):
        return f"{where}: the page states\n{block.printed}\nand the code prints\n{out.getvalue()}"
    return ""


def in_processes(pages: Sequence[str]) -> list[Outcome]:
    """Run each page in a process of its own, one after the other."""
    outcomes = []
    for page in pages:
        command = [sys.executable, __file__, "--here", page]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        last = (done.stdout.strip().splitlines() or [""])[-1]
        try:
            outcome = Outcome(**json.loads(last))
        except (ValueError, TypeError):
            outcome = Outcome(page, 0, 0, (), done.stderr or f"exit status {done.returncode}", 0.0)
        print(f"{page:28s} {outcome.run:3d} run, {outcome.skipped} not run, {outcome.seconds:.0f} s", flush=True)
        outcomes.append(outcome)
    return outcomes


def main(arguments: Sequence[str]) -> int:
    """Run pages and print the totals; exit status 1 if one failed."""
    if arguments[:1] == ["--here"]:
        print(json.dumps(asdict(run_page(arguments[1]))))
        return 0
    outcomes = in_processes(arguments or pages_with_code())
    for outcome in outcomes:
        for reason in outcome.reasons:
            print(f"not run in {outcome.page}: {reason}")
        if outcome.failure:
            print(f"FAILED {outcome.failure}", file=sys.stderr)
    total, skipped = sum(o.run for o in outcomes), sum(o.skipped for o in outcomes)
    print(f"{total} blocks of {len(outcomes)} pages run, {skipped} not run")
    return int(any(o.failure for o in outcomes))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
