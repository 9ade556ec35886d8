"""The one choice of where work is done, as a string."""

from __future__ import annotations

from loky import cpu_count

from phnn.ensemble.cluster import Cluster, connect
from phnn.ensemble.local import SERIAL, Executor, Threads
from phnn.ensemble.processes import Processes
from phnn.errors import InputRefused

_KNOWN = (
    "serial, threads, threads:N, processes, processes:N, tcp://host:port or tls://host:port (a dask scheduler), "
    "or the path of its scheduler file (.json)"
)


def executor(choice: str) -> Executor:
    """The executor that a string asks for; results do not depend on it.

    Args:
        choice: ``serial``; ``threads`` or ``processes``, on all cores this process may use, or with ``:N`` on N of
            them; ``tcp://host:port``, ``tls://host:port`` or the path of a scheduler file (``.json``) for a cluster of
            dask.distributed.

    Raises:
        InputRefused: the choice is not understood, a package is missing, or no scheduler answers.
    """
    if choice == "serial":
        return SERIAL
    kind, colon, count = choice.partition(":")
    if kind in ("threads", "processes"):
        workers = _workers(choice, count) if colon else cpu_count()
        return Threads(workers) if kind == "threads" else Processes(workers)
    if choice.startswith(("tcp://", "tls://")) or choice.endswith(".json"):
        # An address that does not answer is noticed now, not after hours of other work.
        connect(choice).close()
        return Cluster(choice)
    raise InputRefused(f"executor={choice} is not known: give {_KNOWN}")


def _workers(choice: str, count: str) -> int:
    if not count.isdecimal() or int(count) < 1:
        raise InputRefused(f"executor={choice}: {count!r} is no number of workers, 1 or more; give {_KNOWN}")
    return int(count)
