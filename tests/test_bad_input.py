"""What cannot be used is refused on the command line: status 2, one message, no traceback, nothing half-written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from phnn.cli import main
from phnn.effects import effect
from phnn.errors import InputRefused
from phnn.models.actuator import hrc
from phnn.models.store import save
from phnn.setup import Setup

HEADER = "time_s,voltage_V,displacement_m"


def table() -> np.ndarray:
    """(600, 3) a clean loop with some curvature."""
    t = np.arange(600) * 1e-4
    u = 50.0 * np.sin(2.0 * np.pi * 50.0 * t)
    y = 1e-6 * (u + 0.1 * u**2 / 50.0) + 20e-9 * np.random.default_rng(0).standard_normal(t.size)
    return np.column_stack([t, u, y])


def write(folder: Path, rows: np.ndarray, header: str = HEADER, name: str = "a.csv") -> Path:
    folder.mkdir(exist_ok=True)
    text = "\n".join(",".join(repr(float(v)) for v in row) for row in rows)
    (folder / name).write_text(f"{header}\n{text}\n")
    return folder / name


def changed(change: Callable[[np.ndarray], np.ndarray | None], header: str = HEADER) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        rows = table()
        result = change(rows)
        write(folder, rows if result is None else result, header)

    return make


def rewritten(change: Callable[[str], str]) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        path = write(folder, table())
        path.write_text(change(path.read_text()))

    return make


def manifest(text: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        write(folder, table())
        (folder / "recordings.yaml").write_text(text)

    return make


def at(row: int, column: int, value: float) -> Callable[[np.ndarray], None]:
    def change(rows: np.ndarray) -> None:
        rows[row, column] = value

    return change


def _clip(rows: np.ndarray) -> None:
    rows[:, 2] = np.minimum(rows[:, 2], 0.8 * rows[:, 2].max())


def _two_rates(rows: np.ndarray) -> None:
    rows[300:, 0] = rows[300, 0] + np.arange(300) * 3e-4


def _twice(rows: np.ndarray) -> None:
    rows[300, 0] = rows[299, 0]


def _still(rows: np.ndarray) -> None:
    rows[:, 2] = 1e-6


def _decimal_commas(text: str) -> str:
    head, body = text.split("\n", 1)
    return head + "\n" + body.replace(".", ",")


CASES: dict[str, tuple[Callable[[Path], object], tuple[str, ...]]] = {
    "missing folder": (lambda folder: None, ("bad", "no such folder", "check the path")),
    "empty folder": (lambda folder: folder.mkdir(), ("bad", "no recordings", "voltage_V")),
    "no voltage column": (
        changed(lambda r: None, "time_s,tension_V,displacement_m"), ("a.csv", "no voltage column", "recordings.yaml"),
    ),
    "no unit": (changed(lambda r: None, "time_s,voltage_V,displacement"), ("a.csv", "no unit", "displacement_m")),
    "wrong unit": (changed(lambda r: None, "time_s,voltage_V,displacement_V"), ("a.csv", "cannot be in V")),
    "NaN": (changed(at(41, 2, np.nan)), ("a.csv", "displacement_m", "row 42", "NaN", "repair")),
    "gap": (changed(lambda r: np.delete(r, np.s_[200:220], axis=0)), ("a.csv", "row 201", "gap", "split")),
    "time going back": (changed(at(300, 0, 0.0298)), ("a.csv", "row 301", "time goes back", "sort")),
    "two rows with one time": (changed(_twice), ("a.csv", "row 301", "two rows with one time", "delete")),
    "constant output": (changed(_still), ("a.csv", "displacement_m", "constant", "check the sensor")),
    "clipped sensor": (changed(_clip), ("a.csv", "displacement_m", "row ", "clipped", "range")),
    "one sample": (changed(lambda r: r[:1]), ("a.csv", "1 sample", "at least 50", "record longer")),
    "mixed rates": (changed(_two_rates), ("a.csv", "rate changes", "row 30", "split")),
    "decimal commas": (rewritten(_decimal_commas), ("a.csv", "line 2", "comma as decimal sign")),
    "absent file": (
        manifest("recordings: [{file: b.csv}]"), ("recordings.yaml", "recordings[0]", "b.csv", "correct its name"),
    ),
    "unknown model": (manifest("setup: {model: perpetuum_mobile}"), ("recordings.yaml", "perpetuum_mobile")),
    "unknown use": (manifest("recordings: [{file: a.csv, use: pleasure}]"), ("recordings.yaml", "pleasure")),
    "unknown parameter": (manifest("known: {zeal: {value: 1.0}}"), ("zeal",)),
    "hysterons": (manifest("setup: {model: piezo_actuator, hysterons: -1}"), ("hysterons", "-1")),
    "only held out": (
        manifest("recordings: [{file: a.csv, use: confirmation}]"), ("use: identification",),
    ),
}  # fmt: skip


def refused(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    """The one message of a refused command."""
    assert main([str(a) for a in arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    message = captured.err
    assert message.startswith("phnn: ")
    assert message.count("\n") == 1
    assert "Traceback" not in message
    assert "internal error" not in message
    return message


# A misspelt anchor is passed over in silence, so that the mass keeps its default.


@pytest.mark.parametrize("case", CASES)
def test_identify_refuses(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make, words = CASES[case]
    make(tmp_path / "bad")
    message = refused(capsys, "identify", tmp_path / "bad", "--out", tmp_path / "out")
    assert [w for w in words if w not in message] == [], message
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", ["check", "diagnose", "compare", "predict", "modes"])
@pytest.mark.parametrize("case", ["missing folder", "NaN", "decimal commas", "absent file"])
def test_every_command_refuses_in_the_same_words(
    command: str, case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make, words = CASES[case]
    make(tmp_path / "bad")
    save(Setup(hrc(2)), tmp_path / "model")
    model = [tmp_path / "model"] if command == "predict" else []
    out = ["--out", tmp_path / "out"] if command != "check" else []
    message = refused(capsys, command, *model, tmp_path / "bad", *out)
    assert [w for w in words if w not in message] == [], message
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", ["identify", "diagnose", "compare"])
@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("beginnings=3", ("beginnings", "starts")),
        ("starts=0", ("starts", "1 or more")),
        ("seed=later", ("seed", "whole number")),
        ("error_bound_sigma=0", ("error_bound_sigma", "positive")),
    ],
)
def test_unknown_and_impossible_settings(
    command: str, setting: str, words: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "data", table())
    message = refused(capsys, command, tmp_path / "data", "--out", tmp_path / "out", setting)
    assert [w for w in words if w not in message] == [], message
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("content", [None, "{", '{"schema": "another"}', '{"schema": "phnn.model/1"}'])
def test_predict_refuses_what_is_no_model(
    content: str | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "data", table())
    (tmp_path / "model").mkdir()
    if content is not None:
        (tmp_path / "model" / "model.json").write_text(content)
    message = refused(capsys, "predict", tmp_path / "model", tmp_path / "data", "--out", tmp_path / "out")
    assert "model.json" in message
    assert "model/ or base/" in message or "write the model again" in message
    assert not (tmp_path / "out").exists()


def test_check_lets_a_good_folder_pass(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(tmp_path / "good", table())
    assert main(["check", str(tmp_path / "good")]) == 0
    assert capsys.readouterr().err == ""


def test_an_unknown_effect_is_refused_with_those_that_exist() -> None:
    with pytest.raises(InputRefused, match=r"no effect called 'telepathy'.*creep.*sensor_drift"):
        effect("telepathy")
    assert effect("creep").name == "creep"


def test_an_out_that_is_a_file_is_an_error_without_a_traceback(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "out").write_text("mine")
    save(Setup(hrc(2)), tmp_path / "model")
    write(tmp_path / "data", table())
    assert main(["predict", str(tmp_path / "model"), str(tmp_path / "data"), "--out", str(tmp_path / "out")]) != 0
    error = capsys.readouterr().err
    assert "out" in error
    assert "Traceback" not in error
    assert "internal error" not in error
    assert (tmp_path / "out").read_text() == "mine"
