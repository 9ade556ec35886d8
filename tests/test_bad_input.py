"""What cannot be used is refused by every command in the same words: status 2, one message, nothing half-written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from phnn.cli import main
from phnn.effects import effect
from phnn.errors import InputRefused
from phnn.models.actuator import hrc
from phnn.models.store import save
from phnn.setup import Setup

T = np.arange(600) * 1e-4
U = 50.0 * np.sin(2.0 * np.pi * 50.0 * T)
Y = 1e-6 * (U + 0.1 * U**2 / 50.0) + 20e-9 * np.random.default_rng(0).standard_normal(T.size)
ROWS = [",".join(map(repr, row)) for row in np.column_stack([T, U, Y]).tolist()]
GOOD = "\n".join(["time_s,voltage_V,displacement_m", *ROWS]) + "\n"
COMMANDS = ["check", "identify", "diagnose", "compare", "predict", "modes"]
# Text of the recording, of the manifest, and words of the refusal: one fault of each stage of reading.
CASES: dict[str, tuple[str | None, str, tuple[str, ...]]] = {
    "missing folder": (None, "", ("bad", "no such folder", "check the path")),
    "no number": (GOOD.replace(ROWS[41], "0,nan,0"), "", ("a.csv", "voltage_V", "row 42", "NaN", "repair")),
    "absent file": (GOOD, "recordings: [{file: b.csv}]", ("recordings.yaml", "recordings[0]", "b.csv", "correct its")),
}  # fmt: skip


def write(folder: Path, recording: str | None = GOOD, manifest: str = "") -> Path:
    if recording is not None:
        folder.mkdir()
        (folder / "a.csv").write_text(recording)
        (folder / "recordings.yaml").write_text(manifest)
    return folder


def refused(capsys: pytest.CaptureFixture[str], words: tuple[str, ...], *arguments: str | Path) -> None:
    """Fail unless a command is refused with one message of these words and writes nothing."""
    out = Path(arguments[1]).parent / "out"
    assert main([str(a) for a in (*arguments, *([] if arguments[0] == "check" else ["--out", out]))]) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.startswith("phnn: ") and printed.err.count("\n") == 1
    assert "Traceback" not in printed.err and "internal error" not in printed.err
    assert [w for w in words if w not in printed.err] == [], printed.err
    assert not out.exists()


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("case", CASES)
def test_every_command_refuses_in_the_same_words(
    command: str, case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording, manifest, words = CASES[case]
    write(tmp_path / "bad", recording, manifest)
    save(Setup(hrc(2)), tmp_path / "model")
    refused(capsys, words, command, *([tmp_path / "model"] if command == "predict" else []), tmp_path / "bad")


@pytest.mark.parametrize("command", ["identify", "diagnose", "compare"])
@pytest.mark.parametrize(("setting", "words"), [
    ("beginnings=3", ("beginnings", "starts")), ("starts=0", ("starts", "1 or more")),
    ("seed=later", ("seed", "whole number")), ("error_bound_sigma=0", ("error_bound_sigma", "positive")),
])  # fmt: skip
def test_unknown_and_impossible_settings(
    command: str, setting: str, words: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    refused(capsys, words, command, write(tmp_path / "data"), setting)


@pytest.mark.parametrize("content", [None, '{"schema": "another"}'])
def test_predict_says_where_a_model_is_written(
    content: str | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "model").mkdir()
    if content is not None:
        (tmp_path / "model" / "model.json").write_text(content)
    refused(capsys, ("model.json", "model/ or base/"), "predict", tmp_path / "model", write(tmp_path / "data"))


def test_an_unknown_effect_is_refused_with_those_that_exist() -> None:
    with pytest.raises(InputRefused, match=r"no effect called 'telepathy'.*creep.*sensor_drift"):
        effect("telepathy")
