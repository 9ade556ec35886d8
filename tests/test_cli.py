"""The console command: arguments, settings, exit status, and that it starts quickly."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import pytest

from phnn import cli, commands
from phnn.configuration import compose, config_folder
from phnn.errors import InputRefused, SolverFailed

COMMANDS = ("check", "template", "identify", "diagnose", "predict", "compare", "demo")


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, dict[str, Any]]]:
    """Replaces the commands by recorders that take the same arguments."""
    seen: list[tuple[str, dict[str, Any]]] = []
    for name in COMMANDS:
        _replace(monkeypatch, name, lambda name=name, **given: seen.append((name, given)))
    return seen


def _replace(monkeypatch: pytest.MonkeyPatch, name: str, function: Callable[..., None]) -> None:
    monkeypatch.setattr(commands, name, mock.create_autospec(getattr(commands, name), side_effect=function))


def _failing(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    def check(**given: object) -> None:
        raise error

    _replace(monkeypatch, "check", check)


def test_arguments_reach_the_commands(calls: list[tuple[str, dict[str, Any]]]) -> None:
    assert cli.main(["check", "data", "--manifest", "m.yaml"]) == 0
    assert cli.main(["predict", "model", "data", "--out", "o"]) == 0
    assert cli.main(["demo", "--seed", "3"]) == 0
    assert cli.main(["template", "data"]) == 0
    options = {"outside": False, "overwrite": False}
    assert calls[0] == ("check", {"folder": Path("data"), "manifest": Path("m.yaml"), "out": None} | options)
    into = {"model": Path("model"), "folder": Path("data"), "manifest": None, "out": Path("o")}
    assert calls[1] == ("predict", into | options)
    assert calls[3] == ("template", {"folder": Path("data"), "out": None, "outside": False})
    name, given = calls[2]
    assert (name, given["seed"], given["out"], given["config"]["max_effects"]) == ("demo", 3, Path("out/demo"), 4)


@pytest.mark.parametrize(
    "argv",
    [
        ["identify", "data", "--out", "o", "starts=7", "seed=1"],
        ["identify", "data", "starts=7", "--out", "o", "seed=1"],
        ["identify", "--out", "o", "data", "starts=7", "seed=1"],
    ],
)
def test_settings_may_stand_anywhere(calls: list[tuple[str, dict[str, Any]]], argv: list[str]) -> None:
    assert cli.main(argv) == 0
    name, given = calls[0]
    assert (name, given["folder"], given["out"], given["manifest"]) == ("identify", Path("data"), Path("o"), None)
    assert given["config"] == {"seed": 1, "starts": 7, "error_bound_sigma": 1.0, "workers": 2}


@pytest.mark.parametrize("command", ["identify", "diagnose", "compare"])
def test_every_settings_file_composes(command: str) -> None:
    config = compose(command)
    assert set(config) >= {"seed", "starts", "error_bound_sigma", "workers"}
    text = (config_folder() / f"{command}.yaml").read_text()
    lines = text.splitlines()
    for key in config:
        at = next(i for i, line in enumerate(lines) if line.startswith(f"{key}:"))
        assert lines[at - 1].startswith("# "), f"{command}.yaml: {key} has no comment"


@pytest.mark.parametrize(
    ("override", "needle"),
    [
        ("beginnings=3", "beginnings"),
        ("+starts=3", "accepts seed, starts"),
        ("hydra.run.dir=x", "hydra.run.dir"),
        ("starts=many", "whole number"),
        ("starts=true", "whole number"),
        ("error_bound_sigma=nan", "positive"),
        ("starts", "key=value"),
        ("starts=[1", "key=value"),
        ("starts=1,2", "starts=1,2"),
        *((setting, "setting starts") for setting in ("starts=1001", "starts=1e9", "starts=" + "9" * 400)),
    ],
)
def test_bad_settings_are_refused(capsys: pytest.CaptureFixture[str], override: str, needle: str) -> None:
    assert cli.main(["identify", "data", "--out", "o", override]) == 2
    error = capsys.readouterr().err
    assert needle in error
    assert error.count("\n") == 1


def test_a_whole_number_is_a_number() -> None:
    value = compose("identify", ["error_bound_sigma=2"])["error_bound_sigma"]
    assert isinstance(value, float)


@pytest.mark.parametrize(
    ("error", "status", "needle"),
    [
        (InputRefused("a.csv: no voltage column"), 2, "a.csv: no voltage column"),
        (SolverFailed("no step at t = 1 s"), 1, "no step at t = 1 s"),
        (PermissionError(13, "Permission denied", "out"), 1, "cannot use out: Permission denied"),
        (KeyError("x"), 1, "PHNN_DEBUG=1"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_exit_status_and_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], error: BaseException, status: int, needle: str
) -> None:
    monkeypatch.delenv("PHNN_DEBUG", raising=False)
    _failing(monkeypatch, error)
    assert cli.main(["check", "data"]) == status
    streams = capsys.readouterr()
    assert needle in streams.err
    assert streams.err.count("\n") == 1
    assert streams.out == ""


def test_bugs_show_themselves_on_request(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PHNN_DEBUG", "1")
    _failing(monkeypatch, KeyError("x"))
    with pytest.raises(KeyError):
        cli.main(["check", "data"])


@pytest.mark.parametrize(
    ("argv", "hint"),
    [
        *((argv, "usage") for argv in ([], ["paint"], ["check"], ["identify", "data"], ["demo", "--seed", "-1"])),
        *((["check", "d", more], "usage") for more in ("a=1", "-q")),
        (["diagnos", "data", "--out", "o"], "did you mean diagnose?"),
        (["diagnose", "data", "--ouput", "o"], "did you mean --out?"),
        (["check", "data", "--manifst", "m"], "did you mean --manifest?"),
        (["plot", "cmpare", "m", "--out", "o"], "invalid choice: 'cmpare'"),
        (["diagnose", "data", "--out", "o", "--starts=2"], "settings have no dashes"),
    ],
)
def test_wrong_usage_and_misspelt_words_exit_with_2(
    argv: list[str], hint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        cli.main(argv)
    assert stop.value.code == 2
    assert hint in capsys.readouterr().err


@pytest.mark.parametrize(("override", "near"), [("stats=4", "starts"), ("criteria.materal=0.1", "material")])
def test_misspelt_settings_are_recognised(override: str, near: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["diagnose", "data", "--out", "o", override]) == 2
    assert f"did you mean {near}?" in capsys.readouterr().err


def test_options_of_an_inverse_are_refused_before_anything_is_read(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["invert", "m", "r.csv", "--out", "o", "--slew", "-1"]) == 2
    assert "slew = -1 V/s: give a positive, finite number" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        cli.main(["invert", "m", "r.csv", "--out", "o", "--hold", "linear"])


def test_help_is_quick_and_loads_nothing_heavy() -> None:
    code = (
        "import sys\nfrom phnn import cli\ntry:\n    cli.main(['--help'])\nexcept SystemExit:\n    pass\n"
        "heavy = {'torch', 'numba', 'scipy', 'numpy', 'hydra', 'matplotlib', 'pandas'} & set(sys.modules)\n"
        "sys.exit(f'loaded {heavy}' if heavy else 0)"
    )
    start = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    seconds = time.perf_counter() - start
    assert done.returncode == 0, done.stderr
    assert "diagnose" in done.stdout
    assert seconds < 1.0


def test_help_of_a_command_tells_its_settings(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        cli.main(["diagnose", "--help"])
    assert "max_effects: 4" in capsys.readouterr().out
