"""Every command, stopped at random moments, where the disk fills up, and where the usual surroundings are missing."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import chdir, suppress
from pathlib import Path

import numpy as np
import pytest
from small_runs import MARK, ROOT, RUNS, Runner, differing, given, results

from phnn.cli import main

SIGNALS = (signal.SIGKILL, signal.SIGINT, signal.SIGTERM)
# Stops of each command by each signal.
STOPS = 5


@pytest.mark.slow
@pytest.mark.parametrize("verb", RUNS)
def test_a_command_that_is_stopped_leaves_a_mark_and_ends_with_the_same_results(runner: Runner, verb: str) -> None:
    now, before = RUNS[verb]
    place = runner.home / "runs" / verb

    # Twice, for the first run may wait for compiled code.
    for _ in range(2):
        began = time.monotonic()
        assert runner.run(given(now, place / "clean")) == 0, runner.told.read_text()
        if verb in ("train", "compare"):
            break
    seconds = time.monotonic() - began
    clean = results(place / "clean")
    old = None
    if before is not None:
        assert runner.run(given(before, place / "old")) == 0, runner.told.read_text()
        old = results(place / "old")
    seed, out, stopped = list(RUNS).index(verb), place / "out", 0
    for number, moment in enumerate(np.random.default_rng(seed).uniform(0.0, seconds, STOPS * len(SIGNALS))):
        sent = SIGNALS[number % len(SIGNALS)]
        case = f"{verb}, seed {seed}, stop {number}: {sent.name} after {moment:.3f} s"
        shutil.rmtree(out, ignore_errors=True)
        # Every other run meets the results of an earlier one.
        first = old is not None and before is not None and number % 2 == 1
        if first:
            assert runner.run(given(before or [], out)) == 0, case
        status = runner.run(given(now, out), (float(moment), sent))
        stopped += status != 0
        assert status in (0, -sent, 128 + sent), (case, runner.told.read_text())
        assert "Traceback" not in runner.told.read_text(), case
        left = results(out) if out.is_dir() else {}
        whole = not left or left == clean or (first and left == old)
        # A diagnosis that is interrupted ends with an answer that says so.
        said = left.get("diagnosis.json", {}).get("ended", {}).get("why") == "interrupted"  # type: ignore[attr-defined]
        assert whole or said or MARK in left, (case, differing(left, clean))
        assert runner.run(given(now, out)) == 0, (case, runner.told.read_text())
        assert results(out) == clean, (case, differing(results(out), clean))
        assert not list(out.rglob("*.part")), case
    print(f"{verb}: {stopped} of {STOPS * len(SIGNALS)} runs were stopped, seed {seed}, {seconds:.1f} s a run")


def test_an_interruption_within_a_callback_of_compiled_code_is_not_lost() -> None:
    code = (
        "import ctypes, os, signal, time, phnn.cli as c; c._prepare()\n"
        "ctypes.CFUNCTYPE(None)(lambda: os.kill(os.getpid(), signal.SIGTERM))()\ntime.sleep(60)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, env=os.environ | {"PYTHONPATH": str(ROOT)})
    assert b"_Terminated" in done.stderr and b"callback" not in done.stderr


DISK = 64 << 20
# Bytes that are left when the disk fills up.
ROOM = (0, 1 << 13, 1 << 15)
SURROUNDINGS = {
    "no home": {"HOME": None, "USER": None, "LOGNAME": None},
    "no folder for temporary files": {"TMPDIR": "/nowhere", "TMP": "/nowhere", "TEMP": "/nowhere"},
    "ASCII": {"LANG": "C", "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONIOENCODING": None},
}
# In a hurry all of this is missing at once.
SURROUNDINGS = {"all": {n: v for changed in SURROUNDINGS.values() for n, v in changed.items()}, **SURROUNDINGS}


def quick(names: object, first: str) -> list[object]:
    """Parameters of which only one runs in the fast suite."""
    return [n if n == first else pytest.param(n, marks=pytest.mark.slow) for n in names]


def clean(runner: Runner, verb: str) -> dict[str, object]:
    """What a command leaves that nothing has disturbed."""
    out = runner.home / "undisturbed" / verb
    if not out.exists() and verb == "predict":
        # So quick that a process would take longer to start.
        with chdir(runner.home):
            assert main(given(RUNS[verb][0], out)) == 0
    elif not out.exists():
        assert runner.run(given(RUNS[verb][0], out)) == 0, runner.told.read_text()
    return results(out)


def fill(disk: Path, out: Path, room: int, ended: threading.Event) -> None:
    """Leave only so much room as soon as a command has begun to write."""
    while not (out / MARK).exists() and not ended.is_set():
        time.sleep(1e-3)
    # The command takes of the same room meanwhile.
    with suppress(OSError):
        (disk / "filler").write_bytes(bytes(max(shutil.disk_usage(disk).free - room, 0)))


@pytest.mark.slow
@pytest.mark.parametrize("verb", quick(RUNS, "predict"))
def test_a_disk_that_fills_up_under_a_command_loses_nothing(
    runner: Runner, disk: Callable[[str], Path], verb: str
) -> None:
    wanted, full, small = clean(runner, verb), 0, disk(f"size={DISK}")
    for room in ROOM:
        out, ended = small / f"out_{room}", threading.Event()
        filling = threading.Thread(target=fill, args=(small, out, room, ended))
        filling.start()
        status = runner.run(given(RUNS[verb][0], out))
        ended.set()
        filling.join()
        text, case = runner.told.read_text(), f"{verb}, {room} bytes"
        left = results(out)
        assert "Traceback" not in text and "internal error" not in text, (case, text)
        if status:
            full += 1
            assert status == 1 and "the disk is full" in text, (case, status, text)
            assert MARK in left, case
        else:
            assert left == wanted, (case, differing(left, wanted))
        assert not list(out.rglob("*.part")), case
        (small / "filler").unlink()
        assert runner.run(given(RUNS[verb][0], out)) == 0, (case, runner.told.read_text())
        assert results(out) == wanted, (case, differing(results(out), wanted))
    assert full, verb


@pytest.mark.parametrize("options", ["size=1m", "size=4m", "size=64m ro", "rights"])
def test_a_place_that_does_not_take_the_results_is_met_before_the_work(
    options: str, runner: Runner, tmp_path: Path, disk: Callable[[str], Path]
) -> None:
    if options == "rights":
        tmp_path.chmod(0o500)
        if os.access(tmp_path, os.W_OK):
            pytest.skip("rights do not bind this user")
    folder = tmp_path if options == "rights" else [disk(option) for option in options.split()][-1]
    words = "MiB of disk are free" if options in ("size=1m", "size=4m") else "choose another folder"
    assert runner.run(given(RUNS["predict"][0], folder / "new")) == 2
    assert words in runner.told.read_text() and not (folder / "new").exists()


def command(verb: str, out: Path, changed: dict[str, str | None], runner: Runner, stdout: str = "") -> tuple[int, str]:
    """Exit status and messages of a command in a process of its own, with these variables changed or removed."""
    # Compiled code is kept where it is now, whatever HOME is: what a missing one changes is tested beside the cache.
    kept = os.environ.get("PHNN_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PHNN_CACHE_DIR": kept} | changed
    done = subprocess.run(
        ["sh", "-c", f'exec "$@" {stdout}', "sh", sys.executable, "-m", "phnn.cli", *given(RUNS[verb][0], out)],
        env={n: v for n, v in environment.items() if v is not None},
        cwd=runner.home,
        capture_output=True,
    )
    return done.returncode, done.stderr.decode()


@pytest.mark.parametrize("verb", quick(RUNS, "predict"))
@pytest.mark.parametrize("missing", quick(SURROUNDINGS, "all"))
def test_a_command_needs_no_surroundings(runner: Runner, verb: str, missing: str) -> None:
    out = runner.home / "surroundings" / missing.replace(" ", "_") / verb
    status, text = command(verb, out, SURROUNDINGS[missing], runner)
    assert status == 0 and "Traceback" not in text, text
    wanted = clean(runner, verb)
    assert results(out) == wanted, differing(results(out), wanted)


@pytest.mark.slow
@pytest.mark.parametrize("verb", quick(RUNS, "predict"))
def test_a_command_whose_output_nobody_reads_ends_its_work(runner: Runner, verb: str) -> None:
    out = runner.home / "closed" / verb
    status, text = command(verb, out, {}, runner, ">&-")
    assert status == 0 and not text, text
    wanted = clean(runner, verb)
    assert results(out) == wanted, differing(results(out), wanted)
