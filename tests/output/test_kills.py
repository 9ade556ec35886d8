"""Every command, stopped at random moments: never a mixed folder without its mark, and the same results afterwards."""

from __future__ import annotations

import shutil
import signal
import time

import numpy as np
import pytest
from small_runs import MARK, RUNS, Runner, differing, given, results

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
        if verb in ("train", "compare", "prove"):
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
        assert whole or MARK in left, (case, differing(left, clean))
        assert runner.run(given(now, out)) == 0, (case, runner.told.read_text())
        assert results(out) == clean, (case, differing(results(out), clean))
        assert not list(out.rglob("*.part")), case
    print(f"{verb}: {stopped} of {STOPS * len(SIGNALS)} runs were stopped, seed {seed}, {seconds:.1f} s a run")
