"""A server for one machine and one user, from the standard library."""

from __future__ import annotations

from http.server import ThreadingHTTPServer
from pathlib import Path

from phnn.errors import InputRefused
from phnn.intake.names import printable
from phnn.serve.handler import Handler, Rooted

# The address of the machine itself: nobody else's machine can reach it.
HOST = "127.0.0.1"
_LAST_PORT = 65535


class Server(ThreadingHTTPServer, Rooted):
    """A server of one folder, a thread for each request."""

    daemon_threads = True
    # A browser that keeps a connection open must not keep the server from ending.
    block_on_close = False

    def __init__(self, root: Path, port: int) -> None:
        super().__init__((HOST, port), Handler)
        self.root = root

    @property
    def url(self) -> str:
        """Where a browser finds the list of runs."""
        return f"http://{HOST}:{self.server_address[1]}/"

    def handle_error(self, request: object, client_address: object) -> None:
        """Say nothing where a browser has gone in the middle of an answer."""


def server(folder: Path, port: int = 0) -> Server:
    """A server for the runs below a folder, bound but not running yet.

    Args:
        port: 0 for a free one.

    Raises:
        InputRefused: there is no such folder, or the port is taken.
    """
    if not folder.is_dir():
        raise InputRefused(f"{printable(str(folder))}: is no folder: name one that holds results of phnn")
    if not 0 <= port <= _LAST_PORT:
        raise InputRefused(f"--port {port}: must be 1 to {_LAST_PORT}, or 0 for a free one")
    try:
        return Server(folder.resolve(), port)
    except OSError as error:
        raise InputRefused(f"--port {port}: cannot be used ({error.strerror}): leave it out for a free one") from error


def serve(folder: Path, port: int = 0) -> None:
    """Serve until the process is interrupted; prints where.

    Raises:
        InputRefused: as `server`.
    """
    with server(folder, port) as found:
        print(f"runs below {printable(str(folder))}: {found.url}   (end with Ctrl-C)", flush=True)
        found.serve_forever()
