"""Golden answers: what the package computed before its files were merged, moved and deleted.

They say that a refactoring changes no number that a user gets. They do not say that a number is right: other tests do.

| layer | file | what is held | tolerance |
|---|---|---|---|
| read | `read.json` | what `phnn.read` makes of shared folders and small files, or the text of its refusal | 1e-12 |
| simulate | `simulate.json` | output and sensitivities of every law, block, effect and model, 200 steps | 1e-10 |
| scores | `scores.json` | scores of candidates and locations on five fits, whose values are in `fits.json` | 1e-4 |
| diagnoses (slow) | `diagnoses.json` | verdict, names, exit status and residual of whole diagnoses | 1e-4 |

A number agrees if it differs by less than the tolerance times its size. For an array, the size is its largest
absolute value, because a value near zero has no relative digits. Estimated noise is compared to 1e-3, because its
estimation is iterative; of that and of scores, processors differ by up to 4e-5. A p-value is a count among 100,000
draws and may differ by a few of them.

To renew the answers of a layer, or of single cases, say why in a sentence:

    pytest tests/golden -k read --renew "Times are read as written, no longer rounded to a nanosecond."

The sentence goes to `answers/CHANGES.md` together with the digest of the file. A test compares the digests, so that
no answer changes without a sentence. Answers of a case that no longer exists are removed when its layer is renewed.

The last layer is made of a few small diagnoses that are run as a user runs them, 6 to 60 s each on a free core. They
take the place of a tape of all calls of a search, from a store of results by the content of their arguments. Measured
on campaigns of three recordings with 400 samples each, the tape of one search has 25 to 556 calls and 4 to 69 MB, and
its keys contain names of modules and classes, which a refactoring changes. Exit status 1 of a shared folder is held
as it is: the command fails there today, and whoever mends that renews the answer.

Everything that may move is imported in one place: the top of `golden_subjects.py`.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

ANSWERS = Path(__file__).parent / "answers"
CHANGES = ANSWERS / "CHANGES.md"
# Samples of an array that are kept beside its summary, and significant digits of every number.
_SAMPLES, _DIGITS = 8, 15
# Keys of a fingerprint.
_COUNT, _SIZE, _SUMMARY, _VALUES = "count", "size", "summary", "samples"


def fingerprint(values: ArrayLike, samples: int = _SAMPLES) -> dict[str, Any]:
    """Return the number of values, the largest absolute value, a summary and some evenly spaced samples.

    The summary is least, largest, mean and root mean square. Values that are not finite are counted, and left out of
    size and summary.
    """
    x = np.asarray(values, dtype=np.float64).ravel()
    finite = x[np.isfinite(x)]
    kept = finite if finite.size else np.zeros(1)
    chosen = np.unique(np.linspace(0, x.size - 1, samples).round().astype(int)) if x.size else np.zeros(0, int)
    return {
        _COUNT: [int(x.size), int(finite.size)],
        _SIZE: rounded(float(np.abs(kept).max())),
        _SUMMARY: [rounded(float(v)) for v in (kept.min(), kept.max(), kept.mean(), np.sqrt(np.mean(kept**2)))],
        _VALUES: [rounded(float(v)) for v in x[chosen]],
    }


def rounded(value: float) -> float:
    """Return a number with the digits that are stored."""
    return float(f"{value:.{_DIGITS}g}")


def differences(expected: Any, actual: Any, tolerance: float, where: str = "", size: float = 0.0) -> list[str]:
    """Return a line for every difference between a stored and a computed answer.

    Args:
        tolerance: of numbers, relative to their size, or to ``size`` where that is larger.
        where: path of the answer in its case, for the lines.
    """
    if isinstance(expected, Mapping) and isinstance(actual, Mapping):
        lines = [f"{where}: {key!r} is missing" for key in expected if key not in actual]
        lines += [f"{where}: {key!r} is new" for key in actual if key not in expected]
        own = float(expected.get(_SIZE, 0.0)) if _VALUES in expected else size
        for key in expected:
            if key in actual:
                lines += differences(expected[key], actual[key], tolerance, f"{where}/{key}", own)
        return lines
    if isinstance(expected, list) and isinstance(actual, list):
        if len(expected) != len(actual):
            return [f"{where}: {len(expected)} entries became {len(actual)}: {expected} -> {actual}"]
        pairs = enumerate(zip(expected, actual, strict=True))
        return [line for i, (a, b) in pairs for line in differences(a, b, tolerance, f"{where}[{i}]", size)]
    if isinstance(expected, float) and isinstance(actual, float):
        return [] if _agree(expected, actual, tolerance, size) else [f"{where}: {expected!r} became {actual!r}"]
    same = type(expected) is type(actual) and expected == actual
    return [] if same else [f"{where}: {expected!r} became {actual!r}"]


def _agree(expected: float, actual: float, tolerance: float, size: float) -> bool:
    if not (math.isfinite(expected) and math.isfinite(actual)):
        return repr(expected) == repr(actual)
    # Rounding to the stored digits is no difference.
    return abs(expected - actual) <= (tolerance + 10.0 ** (1 - _DIGITS)) * max(abs(expected), size)


class Answers:
    """The stored answers of all layers.

    Attributes:
        why: the sentence with which answers are renewed; empty where they are held.
    """

    def __init__(self, why: str = "") -> None:
        self.why = why.strip()
        self._layers: dict[str, dict[str, Any]] = {}
        self._renewed: set[str] = set()

    def layer(self, name: str) -> dict[str, Any]:
        """Return the answers of a layer by case."""
        if name not in self._layers:
            path = ANSWERS / f"{name}.json"
            self._layers[name] = json.loads(path.read_text("utf-8")) if path.is_file() else {}
        return self._layers[name]

    def hold(self, layer: str, case: str, actual: Any, tolerance: float) -> None:
        """Fail where an answer differs from the stored one; store it where answers are renewed.

        Args:
            actual: plain values: texts, numbers, lists and mappings from texts.
        """
        plain = json.loads(json.dumps(actual))
        if self.why:
            # An answer that agrees keeps its digits: only what changed is renewed.
            if case not in self.layer(layer) or differences(self.layer(layer)[case], plain, tolerance):
                self.layer(layer)[case] = plain
                self._renewed.add(layer)
            return
        if case not in self.layer(layer):
            pytest.fail(f"no golden answer of {case} in {layer}.json: renew it with --renew 'WHY' (golden_answers.py)")
        found = differences(self.layer(layer)[case], plain, tolerance)
        if found:
            more = f"\n… and {len(found) - 12} more" if len(found) > 12 else ""
            pytest.fail(f"{layer}: {case} changed:\n" + "\n".join(found[:12]) + more)

    def keep_only(self, layer: str, cases: set[str]) -> None:
        """Fail where answers of other cases are stored; remove them where answers are renewed."""
        others = sorted(set(self.layer(layer)) - cases)
        if self.why and others:
            for case in others:
                del self.layer(layer)[case]
            self._renewed.add(layer)
        elif others:
            pytest.fail(f"{layer}.json has answers of {', '.join(others)}, which no test asks for: renew the layer")

    def write(self) -> None:
        """Write the layers that were renewed, and the sentence with the new digests."""
        for name in sorted(self._renewed):
            ordered = dict(sorted(self._layers[name].items()))
            # One line a case: small files, and changes that can be read.
            lines = (f"{json.dumps(case)}: {json.dumps(said, sort_keys=True)}" for case, said in ordered.items())
            (ANSWERS / f"{name}.json").write_text("{\n" + ",\n".join(lines) + "\n}\n", "utf-8")
            with CHANGES.open("a", encoding="utf-8") as changes:
                changes.write(f"| {name} | {digest(name)} | {self.why} |\n")


def digest(layer: str) -> str:
    """Return the first digits of the SHA-256 of a layer's file."""
    return hashlib.sha256((ANSWERS / f"{layer}.json").read_bytes()).hexdigest()[:12]


def stated_digests() -> dict[str, str]:
    """Return the last digest of every layer that `CHANGES.md` states."""
    rows = [line.split("|") for line in CHANGES.read_text("utf-8").splitlines() if line.count("|") >= 4]
    cells = [[cell.strip() for cell in row[1:4]] for row in rows]
    return {layer: stated for layer, stated, _ in cells if len(stated) == 12 and set(stated) <= set("0123456789abcdef")}
