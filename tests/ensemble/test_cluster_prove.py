"""A proof on a real cluster of two workers, one of which is killed while it works: nothing is lost."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).resolve().parent.parent / "output"))
from small_runs import differing, results

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "prove.py"
CASES = ("fast_none=3", "fast_weak=3", "only=[fast_none,fast_weak]", "fast_plan=few")


def _prove(out: Path, executor: str) -> dict[str, object]:
    command = [sys.executable, str(SCRIPT), f"out={out}", *CASES, f"executor='{executor}'"]
    subprocess.run(command, check=True)
    return results(out)


@pytest.mark.slow
def test_a_proof_is_the_same_with_a_worker_killed(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="the extra [cluster] is not installed")
    killed: list[int] = []

    with distributed.LocalCluster(2, threads_per_worker=1, processes=True, dashboard_address=None) as local:
        with distributed.Client(local) as client:
            workers = list(client.run(os.getpid).values())
        # On the same workers: they have one thread each, with which sums of the linear algebra round in one way.
        expected = _prove(tmp_path / "undisturbed", local.scheduler_address)

        def kill() -> None:
            # With the first answer written, both workers are at work on further ones.
            answers = tmp_path / "there" / "answers"
            while not list(answers.glob("*.json")):
                time.sleep(0.01)
            os.kill(workers[0], signal.SIGKILL)
            killed.append(workers[0])

        watching = threading.Thread(target=kill, daemon=True)
        watching.start()
        found = _prove(tmp_path / "there", local.scheduler_address)
        with distributed.Client(local) as client:
            left = set(client.run(os.getpid).values())
    assert killed and not set(killed) & left
    assert differing(found, expected) == []
