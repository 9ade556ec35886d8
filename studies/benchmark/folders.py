"""The folders of a benchmark: recordings and examinations for a tool, seals for the scorer.

    bench.json                          version, names of the cases, hash of cases and seals
    cases/NAME/*.csv, recordings.yaml   what is known: inputs and outputs
    cases/NAME/exam/*.csv, …            inputs whose outputs are to be predicted
    sealed/NAME/seal.json, *.csv        what was concealed, and the outputs of the examination
    sealed/settings.json                seed and numbers of cases, from which everything follows

A tool sees what is not sealed.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
from omegaconf import OmegaConf

import phnn
from phnn.errors import InputRefused
from phnn.intake.files import named_file
from phnn.intake.json_file import load_json
from phnn.intake.limits import LIMITS
from phnn.parallel import executor
from phnn.results import Place, write_atomic
from studies.benchmark.cases import Entry, entries
from studies.benchmark.settings import Settings
from studies.generator import Sealed, make_case, open_seal, write_seal
from studies.generator.folder import MANIFEST
from studies.generator.plans import EXAM

Say = Callable[[str], None]
SCHEMA = "phnn.bench/1"
RESULTS = ("bench.json", "cases", "sealed")
OUTPUT = "displacement_um"
_CARD, _CASES, _SEALED, _SEAL, _ENTRY = "bench.json", "cases", "sealed", "seal.json", "entry.json"
_SETTINGS = "settings.json"


def write_benchmark(settings: Settings, place: Place, where: str, say: Say) -> str:
    """Make and seal all cases; returns the hash of all files.

    A case whose seal lies there is not made again.

    Args:
        place: claimed for it; where: see `phnn.parallel.executor`; say: called with a line of progress.
    """
    found = entries(settings)
    for name in (_CASES, _SEALED):
        (place / name).own_folder()
    todo = [e for e in found if not (place / _SEALED / e.name / _SEAL).path.exists()]
    for number, _ in enumerate(executor(where).each(partial(_make, place), todo), start=1):
        say(f"made {number} of {len(todo)}")
    if not (place / _SEALED / _SETTINGS).path.exists():
        (place / _SEALED / _SETTINGS).write_json(asdict(settings))
    digest = digest_of(place.path, [e.name for e in found])
    content = {"schema": SCHEMA, "generator": phnn.__version__, "cases": [e.name for e in found], "sha256": digest}
    (place / _CARD).write_json(content)
    return digest


def _make(place: Place, entry: Entry) -> None:
    """Make a case; its seal comes last, so that it stands for the whole."""
    known, sealed = (place / _CASES / entry.name).path, (place / _SEALED / entry.name).path
    for folder in (known, sealed):
        shutil.rmtree(folder, ignore_errors=True)
    answer = make_case(entry.case(), known, write_atomic)
    exam = known / "exam"
    exam.mkdir()
    sealed.mkdir()
    for path in sorted(known.glob(f"{EXAM}*.csv")):
        table = pd.read_csv(path)
        write_atomic(sealed / path.name, table.to_csv(index=False).encode())
        write_atomic(exam / path.name, table.drop(columns=OUTPUT).to_csv(index=False).encode())
        path.unlink()
    manifest: Any = OmegaConf.to_container(OmegaConf.load(known / MANIFEST))
    for folder, is_exam in ((known, False), (exam, True)):
        recordings = [r for r in manifest["recordings"] if r["file"].startswith(EXAM) is is_exam]
        write_atomic(folder / MANIFEST, OmegaConf.to_yaml({**manifest, "recordings": recordings}).encode())
    write_atomic(sealed / _ENTRY, (json.dumps(asdict(entry), indent=1) + "\n").encode())
    write_seal(answer, sealed / _SEAL, write_atomic)


def digest_of(folder: Path, names: Sequence[str]) -> str:
    """One hash over all files of some cases and their seals, in their order.

    Raises:
        InputRefused: the files of a case are absent.
    """
    each = []
    for home in (folder / kind / name for name in names for kind in (_CASES, _SEALED)):
        if not home.is_dir():
            raise InputRefused(f"{home}: there is no such folder: a case cannot be scored without all that was written")
        files = sorted(path for path in home.rglob("*") if path.is_file())
        each += [f"{path.relative_to(folder)} {hashlib.sha256(path.read_bytes()).hexdigest()}" for path in files]
    return hashlib.sha256("\n".join(each).encode()).hexdigest()


def card_of(folder: Path) -> dict[str, Any]:
    """The content of ``bench.json``.

    Raises:
        InputRefused: the folder is no benchmark.
    """
    return document_of(folder / _CARD, SCHEMA, "a benchmark", "give the folder that phnn bench write has written")


def document_of(path: Path, schema: str, what: str, remedy: str) -> dict[str, Any]:
    """The content of a json file of a schema.

    Raises:
        InputRefused: it is absent, damaged or of another schema.
    """
    content = load_json(named_file(path, (path.parent,), "", remedy), LIMITS.json_bytes, what, remedy)
    if not isinstance(content, dict) or content.get("schema") != schema:
        raise InputRefused(f"{path}: is no {schema} file: {remedy}")
    return content


def case_folder(folder: Path, name: str) -> Path:
    """What a tool sees of a case."""
    return folder / _CASES / name


def opened(folder: Path, name: str) -> tuple[Entry, Sealed, dict[str, pd.DataFrame]]:
    """A case with its seal, and the tables of its examination by recording.

    Raises:
        InputRefused: the seal is absent or damaged.
    """
    home = folder / _SEALED / name
    sealed = open_seal(home / _SEAL)
    entry = Entry(**json.loads((home / _ENTRY).read_text(encoding="utf-8")))
    return entry, sealed, {path.stem: pd.read_csv(path) for path in sorted(home.glob("*.csv"))}
