"""One choice of where work is done: the same results everywhere, and nothing lost."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from phnn.ensemble import SERIAL, executor
from phnn.ensemble.local import Threads
from phnn.ensemble.processes import Processes
from phnn.errors import InputRefused, SolverFailed

LOCAL = ["serial", "threads:2", "processes:2"]


def unhurried_square(number: int) -> int:
    # The first items take longest, so that results come in another order than they were asked for.
    time.sleep(0.05 / (1 + number))
    return number * number


def odd_refused(number: int) -> int:
    if number % 2:
        raise InputRefused(f"{number} is odd: give an even number")
    return number


def killed_once(folder: Path, number: int) -> int:
    """Kills its process on the first attempt at 3, which leaves a mark."""
    if number == 3 and not (folder / "mark").exists():
        (folder / "mark").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    with (folder / "log").open("a") as log:
        log.write(f"{number}\n")
    return 10 * number


def killed_always(folder: Path, number: int) -> int:
    if number == 2:
        with (folder / "log").open("a") as log:
            log.write("2\n")
        os.kill(os.getpid(), signal.SIGKILL)
    return 10 * number


def surroundings(_: int) -> tuple[int, dict[str, str | None], int]:
    import numba

    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    return os.getpid(), {n: os.environ.get(n) for n in names}, numba.get_num_threads()


def torch_threads(_: int) -> int:
    import torch

    return torch.get_num_threads()


@pytest.mark.parametrize("choice", LOCAL)
def test_results_come_in_the_order_of_the_items(choice: str) -> None:
    assert executor(choice).run(unhurried_square, range(9)) == [n * n for n in range(9)]
    assert executor(choice).run(unhurried_square, []) == []


@pytest.mark.parametrize("choice", LOCAL)
def test_results_are_handed_out_as_they_finish(choice: str) -> None:
    pairs = executor(choice).each(unhurried_square, range(9))
    first = next(pairs)
    assert first[1] == first[0] ** 2
    assert sorted([first, *pairs]) == [(n, n * n) for n in range(9)]


@pytest.mark.parametrize("choice", LOCAL)
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
    for pid, environment, threads in executor("processes:2").run(surroundings, range(4)):
        assert pid != os.getpid()
        assert set(environment.values()) == {"1"}
        assert threads == 1


def test_closing_gives_up_the_rest() -> None:
    pairs = executor("processes:2").each(time.sleep, [0.0, 60.0, 60.0, 60.0])
    assert next(pairs) == (0, None)
    before = time.monotonic()
    pairs.close()  # type: ignore[attr-defined]
    assert time.monotonic() - before < 20.0


def test_a_killed_worker_loses_nothing(tmp_path: Path) -> None:
    found = executor("processes:2").run(partial(killed_once, tmp_path), range(8))
    assert found == [10 * n for n in range(8)]
    done = [int(line) for line in (tmp_path / "log").read_text().split()]
    assert set(done) == set(range(8))
    # At most the item that was at work beside the killed one is done twice: what had finished is kept.
    assert len(done) <= 9


def test_an_item_that_kills_every_worker_is_named_and_the_others_are_kept(tmp_path: Path) -> None:
    kept = {}
    with pytest.raises(
        SolverFailed, match=r"^item 2 \(2\): killed the worker 3 times; the machine has probably run out of memory"
    ):
        kept.update(executor("processes:2").each(partial(killed_always, tmp_path), range(6)))
    assert kept == {n: 10 * n for n in (0, 1, 3, 4, 5)}
    assert (tmp_path / "log").read_text() == "2\n" * 3


def test_choices() -> None:
    assert executor("serial") is SERIAL
    assert executor("threads:3") == Threads(3)
    assert executor("processes:3") == Processes(3)
    assert executor("threads").workers >= 1  # type: ignore[attr-defined]
    assert executor("processes").workers == executor("threads").workers  # type: ignore[attr-defined]


@pytest.mark.parametrize("choice", ["", "fork", "serial:2", "threads:", "threads:0", "processes:two", "processes:-1"])
def test_an_unknown_choice_is_refused_with_those_there_are(choice: str) -> None:
    with pytest.raises(InputRefused, match=r"executor=.*serial, threads, threads:N, processes.*tcp://host:port"):
        executor(choice)


@pytest.mark.slow
def test_torch_has_one_thread_in_a_process() -> None:
    assert executor("processes:2").run(torch_threads, range(2)) == [1, 1]


SCRIPT = """
import os, signal, time
from phnn.ensemble import executor

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
    # The script has no main guard, as in a notebook: workers must not run it again.
    surrounding = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    script = subprocess.Popen([sys.executable, "-c", SCRIPT], cwd=tmp_path, env=surrounding, stderr=subprocess.DEVNULL)
    wait_for(lambda: (tmp_path / "kept").exists() and len((tmp_path / "kept").read_text().split()) == 3)
    wait_for(lambda: len((tmp_path / "pids").read_text().split()) == 5)
    script.send_signal(number)
    assert script.wait(timeout=60.0) != 0
    wait_for(lambda: not any(alive(int(pid)) for pid in (tmp_path / "pids").read_text().split()))
    assert sorted((tmp_path / "kept").read_text().split()) == ["0", "1", "2"]


def wait_for(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    last = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < last, "waited in vain"
        time.sleep(0.05)


def alive(pid: int) -> bool:
    """Whether a process runs; one that is dead but not yet collected by its parent does not."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    status = Path(f"/proc/{pid}/stat")
    return not (status.exists() and status.read_text().rpartition(")")[2].split()[0] == "Z")
