"""A dask.distributed cluster, found by the address of its scheduler or by its scheduler file."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from phnn.ensemble.local import Executor, named
from phnn.errors import InputRefused, PhnnError, SolverFailed

if TYPE_CHECKING:
    from distributed import Client, Future

_CONNECT = 10.0
_START = "start one with `dask scheduler`, and workers with `dask worker ADDRESS --nthreads 1`"


@dataclass(frozen=True)
class Cluster(Executor):
    """The workers of a cluster. They need this package in the same version; dask's nanny gives them one thread each.

    Workers may come and go. Where none is left the work waits for the next one to join, as long as the scheduler's
    setting ``no-workers-timeout`` allows (without that, for ever).

    Attributes:
        scheduler: ``tcp://host:port``, ``tls://host:port`` or the path of a scheduler file.
    """

    scheduler: str

    def each(self, function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """Results as they finish; closing the iterator cancels the rest.

        The scheduler does again what a dead worker had at work, up to its setting ``allowed-failures``. Beyond that it
        gives up everything the worker had been assigned, so such items get one more chance alone.

        Raises:
            InputRefused: the scheduler cannot be reached.
            SolverFailed: items that kill their workers even alone; raised when all others are done.
            PhnnError: the scheduler was lost on the way.
        """
        from distributed import KilledWorker, as_completed

        with connect(self.scheduler) as client:
            if not client.scheduler_info()["workers"]:
                logging.getLogger(__name__).warning("%s has no workers yet: waiting for the first", self.scheduler)
            suspected: list[int] = []
            guilty: list[int] = []
            # A bound item is opaque: dask would search lists and mappings for futures.
            futures = {client.submit(partial(function, item), pure=False): i for i, item in enumerate(items)}
            try:
                for future in as_completed(list(futures), loop=client.loop):
                    index = futures.pop(future)
                    try:
                        result = self._result(future, index)
                    except KilledWorker:
                        suspected.append(index)
                        continue
                    yield index, result
            finally:
                client.cancel(list(futures))
            for index in suspected:
                alone = client.submit(partial(function, items[index]), pure=False)
                try:
                    result = self._result(alone, index)
                except KilledWorker:
                    guilty.append(index)
                    continue
                yield index, result
        if guilty:
            raise SolverFailed(
                f"{named(items, guilty)}: killed every worker, even alone; the workers' logs say why, most often they "
                "need more memory"
            )

    def _result(self, future: Future, index: int) -> Any:
        try:
            return future.result()
        except CancelledError as error:
            raise PhnnError(
                f"{self.scheduler}: the scheduler was lost before item {index} was done: start it again; what finished "
                "before is not affected"
            ) from error


def connect(scheduler: str) -> Client:
    """A client of a running scheduler.

    Args:
        scheduler: ``tcp://host:port``, ``tls://host:port`` or the path of a scheduler file.

    Raises:
        InputRefused: the package is missing, the file or the address cannot be read, or no scheduler answers.
    """
    try:
        from distributed import Client, Security
    except ModuleNotFoundError as error:
        raise InputRefused(
            f"executor={scheduler} needs the package {error.name}: pip install 'phnn[cluster]'"
        ) from error

    address = scheduler if "://" in scheduler else _address(Path(scheduler))
    if not _complete(address):
        raise InputRefused(f"executor={scheduler}: {address} is no address: give host and port, as in tcp://node1:8786")
    if address.startswith("tls://") and Security().get_connection_args("client").get("ssl_context") is None:
        raise InputRefused(
            f"executor={scheduler}: no certificates: name them under distributed.comm.tls, see dask's docs"
        )
    try:
        # A client waits for ever where something accepts the connection and says nothing.
        asyncio.run(asyncio.wait_for(_answers(address), _CONNECT))
        return Client(address, timeout=_CONNECT, set_as_default=False)
    except (OSError, TimeoutError) as error:
        raise InputRefused(f"executor={scheduler}: no dask scheduler answers at {address}; {_START}") from error


async def _answers(address: str) -> None:
    """Ask a scheduler who it is."""
    from distributed.core import rpc

    async with rpc(address, timeout=_CONNECT) as scheduler:
        await scheduler.identity()


def _complete(address: str) -> bool:
    """Whether an address has a host and a port."""
    try:
        parts = urlsplit(address)
        return bool(parts.hostname) and parts.port is not None
    except ValueError:
        return False


def _address(file: Path) -> str:
    """The address in a scheduler file."""
    try:
        return str(json.loads(file.read_text(encoding="utf-8"))["address"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputRefused(
            f"executor={file} is no scheduler file ({error}): `dask scheduler --scheduler-file {file}` writes one"
        ) from error
