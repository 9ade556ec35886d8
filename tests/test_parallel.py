"""One choice of where work is done: serial, threads, processes or a dask cluster give the same results."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import pytest

from phnn import parallel
from phnn.errors import InputRefused, PhnnError, SolverFailed
from phnn.parallel import executor

needs_dask = pytest.mark.skipif(find_spec("distributed") is None, reason="the extra [cluster] is not installed")
LOCAL = ["serial", "threads:2", "processes:1", "processes:2"]


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """The address of a scheduler with two worker processes of one thread each."""
    distributed = pytest.importorskip("distributed", reason="the extra [cluster] is not installed")
    with distributed.LocalCluster(2, threads_per_worker=1, processes=True, dashboard_address=None) as running:
        yield running.scheduler_address


@pytest.fixture(params=[*LOCAL, pytest.param("cluster", marks=pytest.mark.slow)])
def choice(request: pytest.FixtureRequest) -> str:
    """Every kind of executor."""
    return str(request.getfixturevalue("cluster") if request.param == "cluster" else request.param)


def unhurried_square(number: int) -> int:
    # The first items take longest, so that results come in another order than they were asked for.
    time.sleep(0.05 / (1 + number))
    return number * number


def odd_refused(number: int) -> int:
    if number % 2:
        raise InputRefused(f"{number} is odd: give an even number")
    return number


def killed(folder: Path, times: int, number: int) -> int:
    """Kill the process of item 2 for so many times."""
    marks = len(list(folder.iterdir()))
    if number == 2 and marks < times:
        (folder / str(marks)).touch()
        time.sleep(0.5)  # dask does not replace a worker that dies while it is still starting
        os.kill(os.getpid(), signal.SIGKILL)
    return 10 * number


def surroundings(_: int) -> tuple[int, bool, int, int]:
    import numba
    import torch

    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    one = all(os.environ.get(name) == "1" for name in names)
    return os.getpid(), one, numba.get_num_threads(), torch.get_num_threads()


def test_results_are_those_of_a_loop_and_come_as_they_finish(choice: str) -> None:
    chosen = executor(choice)
    assert chosen.run(unhurried_square, range(9)) == [n * n for n in range(9)]
    assert chosen.run(unhurried_square, []) == []
    pairs = chosen.each(unhurried_square, range(9))
    first = next(pairs)
    assert sorted([first, *pairs]) == [(n, n * n) for n in range(9)]


def test_an_exception_passes_as_it_is_and_the_executor_serves_on(choice: str) -> None:
    chosen = executor(choice)
    with pytest.raises(InputRefused, match=r"^[135] is odd: give an even number$"):
        chosen.run(odd_refused, range(6))
    assert chosen.run(odd_refused, [2, 4]) == [2, 4]


def test_threads_of_one_number_work_at_once() -> None:
    # Each waits for the other; one after the other they would wait for ever.
    meeting = threading.Barrier(2, timeout=20.0)
    assert sorted(executor("threads:2").run(lambda _: meeting.wait(), range(2))) == [0, 1]


def test_processes_are_others_with_one_thread_each() -> None:
    for pid, *threads in executor("processes:2").run(surroundings, range(4)):
        assert pid != os.getpid()
        assert threads == [True, 1, 1]


def test_closing_gives_up_the_rest() -> None:
    pairs = executor("processes:2").each(time.sleep, [0.0, 60.0, 60.0, 60.0])
    assert next(pairs) == (0, None)
    before = time.monotonic()
    pairs.close()  # type: ignore[attr-defined]
    assert time.monotonic() - before < 20.0


def test_a_killed_process_ends_with_a_message_and_the_next_call_is_served(tmp_path: Path) -> None:
    chosen = executor("processes:2")
    with pytest.raises(SolverFailed, match=r"a worker process was killed; .* run out of memory: use fewer workers"):
        chosen.run(partial(killed, tmp_path, 1), range(6))
    assert chosen.run(partial(killed, tmp_path, 1), range(6)) == [10 * n for n in range(6)]


@pytest.mark.slow
def test_a_cluster_does_again_what_a_dead_worker_had_and_gives_up_what_kills_them_all(
    cluster: str, tmp_path: Path
) -> None:
    assert executor(cluster).run(partial(killed, tmp_path, 1), range(6)) == [10 * n for n in range(6)]
    with pytest.raises(SolverFailed, match="several workers were killed at the same piece of work"):
        executor(cluster).run(partial(killed, tmp_path, 99), range(6))


@pytest.mark.slow
def test_a_scheduler_lost_on_the_way_is_said_and_what_finished_is_kept() -> None:
    distributed = pytest.importorskip("distributed", reason="the extra [cluster] is not installed")
    import dask

    with (
        dask.config.set({"distributed.comm.timeouts.connect": "1s"}),
        distributed.LocalCluster(1, threads_per_worker=1, processes=True, dashboard_address=":0") as running,
    ):
        pairs = executor(running.scheduler_address).each(time.sleep, [0.0, 300.0])
        assert next(pairs) == (0, None)
        running.close()
        with pytest.raises(PhnnError, match="the scheduler was lost"):
            next(pairs)


@needs_dask
@pytest.mark.parametrize(
    "said", ["", "{", "[]", "{}", "tcp://", "tcp://node", "tcp://node:port", "tls://:8786", "tls://127.0.0.1:8786"]
)
def test_what_is_no_file_and_no_address_of_a_scheduler_is_refused(tmp_path: Path, said: str) -> None:
    file = tmp_path / "scheduler.json"
    if said:
        file.write_text(said)
    given = said if "://" in said else str(file)
    with pytest.raises(InputRefused, match=f"executor={given}: no dask scheduler answers .*dask scheduler --sch"):
        executor(given)


@needs_dask
@pytest.mark.parametrize("listens", [False, True])
def test_an_address_without_a_scheduler_is_refused_in_time(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, listens: bool
) -> None:
    monkeypatch.setattr(parallel, "_CONNECT", 0.3)
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        if listens:
            other.listen()
        file = tmp_path / "scheduler.json"
        file.write_text(json.dumps({"address": f"tcp://127.0.0.1:{other.getsockname()[1]}"}))
        with pytest.raises(InputRefused, match="no dask scheduler answers"):
            executor(str(file))


def test_without_the_package_the_remedy_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputRefused, match=r"needs the package distributed: pip install 'phnn\[cluster\]'"):
        executor("tcp://127.0.0.1:8786")


@pytest.mark.parametrize("unknown", ["", "fork", "serial:2", "threads:", "threads:0", "processes:two", "processes:-1"])
def test_an_unknown_choice_is_refused_with_those_there_are(unknown: str) -> None:
    with pytest.raises(InputRefused, match=r"executor=.*serial, threads, threads:N, processes.*tcp://host:port"):
        executor(unknown)


# Without a main guard, as in a notebook: workers must not run it again.
SCRIPT = """
import os, signal, time
from phnn.parallel import executor

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it

def work(number):
    with open("pids", "a") as log:
        log.write(f"{os.getpid()}\\n")
    time.sleep(0.0 if number < 3 else 300.0)
    return number

for index, result in executor("processes:2").each(work, range(8)):
    with open("kept", "a") as kept:
        kept.write(f"{result}\\n")
"""


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_an_interruption_keeps_what_was_handed_out_and_leaves_no_workers(tmp_path: Path, number: int) -> None:
    kept, pids = tmp_path / "kept", tmp_path / "pids"
    surrounding = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    script = subprocess.Popen([sys.executable, "-c", SCRIPT], cwd=tmp_path, env=surrounding, stderr=subprocess.DEVNULL)
    wait_for(lambda: kept.exists() and len(kept.read_text().split()) == 3)
    wait_for(lambda: len(pids.read_text().split()) == 5)
    script.send_signal(number)
    assert script.wait(timeout=60.0) != 0
    wait_for(lambda: not any(alive(int(pid)) for pid in pids.read_text().split()))
    assert sorted(kept.read_text().split()) == ["0", "1", "2"]


def wait_for(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    last = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < last, "waited in vain"
        time.sleep(0.05)


def alive(pid: int) -> bool:
    """Return whether a process runs; one that is dead but not yet collected by its parent does not."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    status = Path(f"/proc/{pid}/stat")
    return not (status.exists() and status.read_text().rpartition(")")[2].split()[0] == "Z")
