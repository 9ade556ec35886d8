"""A real cluster of worker processes on this machine, found by its address."""

from __future__ import annotations

import json
import os
import signal
import socket
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from junctions import recording

from phnn.ensemble import cluster, executor
from phnn.ensemble.many import simulate_many
from phnn.errors import InputRefused, PhnnError, SolverFailed
from phnn.models.actuator import from_paper
from phnn.setup import Setup

pytest.importorskip("distributed", reason="the extra [cluster] is not installed")


@pytest.fixture(scope="module")
def local() -> Iterator[Any]:
    """Two worker processes with one thread each."""
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as running:
        yield running


def unhurried_square(number: int) -> int:
    time.sleep(0.05 / (1 + number))
    return number * number


def one_refused(number: int) -> int:
    if number == 3:
        raise InputRefused("3 is refused: give another number")
    return number


def noted(folder: Path, number: int) -> int:
    with (folder / "log").open("a") as log:
        log.write(f"{os.getpid()}\n")
    return 10 * number


def killed_once(folder: Path, number: int) -> int:
    """Kills its process on the first attempt at 3, which leaves a mark."""
    if number == 3 and not (folder / "mark").exists():
        (folder / "mark").write_text(str(os.getpid()))
        os.kill(os.getpid(), signal.SIGKILL)
    return noted(folder, number)


def killed_always(folder: Path, number: int) -> int:
    if number == 2:
        # dask does not replace a worker that dies while it is still starting.
        time.sleep(0.5)
        os.kill(os.getpid(), signal.SIGKILL)
    return noted(folder, number)


@pytest.mark.slow
def test_results_are_those_of_this_process(local: Any, tmp_path: Path) -> None:
    chosen = executor(local.scheduler_address)
    assert chosen.run(unhurried_square, range(9)) == [n * n for n in range(9)]
    assert chosen.run(unhurried_square, []) == []
    chosen.run(partial(noted, tmp_path), range(4))
    assert str(os.getpid()) not in (tmp_path / "log").read_text().split()
    file = tmp_path / "scheduler.json"
    file.write_text(json.dumps({"type": "Scheduler", "address": local.scheduler_address}))
    assert executor(str(file)).run(unhurried_square, [5]) == [25]


@pytest.mark.slow
def test_an_ensemble_on_a_cluster_has_the_same_bits(local: Any) -> None:
    t = np.arange(101) * 1e-4
    recordings = [recording(t, 90.0 * np.sin(2 * np.pi * f * t)) for f in (50.0, 200.0)]
    values = [{"k": 2.4e4 + 10.0 * i} for i in range(5)]
    model = Setup(from_paper())
    there = simulate_many(model, values, recordings, 2, local.scheduler_address)
    here = simulate_many(model, values, recordings, 2, "serial")
    for row, expected in zip(there, here, strict=True):
        for member, other in zip(row, expected, strict=True):
            assert member.output is not None
            np.testing.assert_array_equal(member.output, other.output)


@pytest.mark.slow
def test_an_exception_passes_as_it_is_and_is_not_tried_again(local: Any) -> None:
    chosen = executor(local.scheduler_address)
    with pytest.raises(InputRefused, match=r"^3 is refused: give another number$"):
        chosen.run(one_refused, range(6))
    assert chosen.run(one_refused, [2, 4]) == [2, 4]


@pytest.mark.slow
def test_a_killed_worker_loses_nothing(local: Any, tmp_path: Path) -> None:
    found = executor(local.scheduler_address).run(partial(killed_once, tmp_path), range(20))
    assert found == [10 * n for n in range(20)]
    killed = (tmp_path / "mark").read_text()
    survivors = set((tmp_path / "log").read_text().split()) - {killed}
    assert survivors


@pytest.mark.slow
def test_an_item_that_kills_every_worker_is_named_and_the_others_are_kept(local: Any, tmp_path: Path) -> None:
    kept: dict[int, int] = {}
    with pytest.raises(SolverFailed, match=r"^item 2 \(2\): killed every worker, even alone"):
        kept.update(executor(local.scheduler_address).each(partial(killed_always, tmp_path), range(5)))
    assert kept == {n: 10 * n for n in (0, 1, 3, 4)}


@pytest.mark.slow
def test_a_scheduler_lost_on_the_way_is_said_and_what_finished_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    import dask
    from distributed import LocalCluster

    kept = []
    with (
        dask.config.set({"distributed.comm.timeouts.connect": "1s"}),
        LocalCluster(n_workers=1, threads_per_worker=1, processes=True, dashboard_address=":0") as running,
    ):
        pairs = executor(running.scheduler_address).each(time.sleep, [0.0, 300.0])
        kept.append(next(pairs))
        running.close()
        with pytest.raises(PhnnError, match="the scheduler was lost before item 1 was done"):
            next(pairs)
    assert kept == [(0, None)]


def test_a_scheduler_that_does_not_answer_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(cluster, "_CONNECT", 0.3)
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{unused.getsockname()[1]}"
        with pytest.raises(InputRefused, match=rf"{address}: no dask scheduler answers.*`dask scheduler`"):
            executor(address)
        file = tmp_path / "scheduler.json"
        file.write_text(json.dumps({"address": address}))
        with pytest.raises(InputRefused, match=rf"no dask scheduler answers at {address}"):
            executor(str(file))


@pytest.mark.parametrize("address", ["tcp://", "tcp://node", "tcp://node:port", "tls://:8786"])
def test_an_address_without_host_or_port_is_refused(address: str) -> None:
    with pytest.raises(InputRefused, match=f"{address} is no address: give host and port"):
        executor(address)


def test_tls_without_certificates_is_refused() -> None:
    with pytest.raises(InputRefused, match=r"no certificates: name them under distributed\.comm\.tls"):
        executor("tls://127.0.0.1:8786")


@pytest.mark.parametrize("content", [None, "{", "[]", "{}"])
def test_what_is_no_scheduler_file_is_refused(tmp_path: Path, content: str | None) -> None:
    file = tmp_path / "scheduler.json"
    if content is not None:
        file.write_text(content)
    with pytest.raises(InputRefused, match=r"is no scheduler file .*dask scheduler --scheduler-file"):
        executor(str(file))


def test_without_the_package_the_remedy_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputRefused, match=r"needs the package distributed: pip install 'phnn\[cluster\]'"):
        executor("tcp://127.0.0.1:8786")
