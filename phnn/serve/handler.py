"""Answers to requests: only GET, only to this machine's own name, only pages and files below one folder."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import cast
from urllib.parse import parse_qs, urlsplit

from phnn.errors import InputRefused
from phnn.report.scripts import scripts
from phnn.serve.comparing import compare
from phnn.serve.inside import KINDS, served_file, served_folder
from phnn.serve.pages import compared_page, files_of, policy, refused_page, run_page, runs_page
from phnn.serve.runs import find_runs, read_run

# A browser that sends nothing for so long is left [s].
_PATIENCE = 30.0
_COMMON = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}
_HTML = "text/html; charset=utf-8"


class Rooted(HTTPServer):
    """A server that knows the folder below which everything is served.

    Attributes:
        root: the folder, links resolved.
    """

    root: Path


class Handler(BaseHTTPRequestHandler):
    """One request; the server that it belongs to knows the folder and its own names, see `phnn.serve.server`."""

    timeout = _PATIENCE
    server_version, sys_version = "phnn", ""

    @property
    def _root(self) -> Path:
        return cast(Rooted, self.server).root

    def do_GET(self) -> None:
        """Answer with a page or a file, or say that there is none."""
        if self.headers.get_all("Host") not in self._names():
            # A name of somebody else's that leads here: that is how a page of theirs would read what is served.
            self._page(refused_page("This server answers to 127.0.0.1 alone."), HTTPStatus.MISDIRECTED_REQUEST)
            return
        try:
            self._answer()
        except (InputRefused, OSError, ValueError):
            # A folder without rights, one that went meanwhile, or no proper address, is not there either.
            self._page(refused_page("There is no such run or file below the folder."), HTTPStatus.NOT_FOUND)

    def _refuse(self) -> None:
        self.send_response(HTTPStatus.METHOD_NOT_ALLOWED)
        self.send_header("Allow", "GET")
        self.send_header("Content-Length", "0")
        self.end_headers()

    do_HEAD = do_POST = do_PUT = do_PATCH = do_DELETE = do_OPTIONS = do_TRACE = do_CONNECT = _refuse

    def _names(self) -> list[list[str]]:
        port = cast(Rooted, self.server).server_port
        return [[f"{name}:{port}"] for name in ("127.0.0.1", "localhost")]

    def _answer(self) -> None:
        address = urlsplit(self.path)
        kind, _, rest = address.path.lstrip("/").partition("/")
        if not kind:
            self._page(runs_page(self._root, find_runs(self._root)))
        elif kind == "run":
            folder = served_folder(self._root, rest)
            self._page(run_page(read_run(self._root, folder), files_of(folder)))
        elif kind == "compare":
            self._page(self._compared(address.query))
        elif kind == "file":
            self._file(rest)
        else:
            raise InputRefused(kind)

    def _compared(self, query: str) -> bytes:
        """Two runs, which ``a`` and ``b`` name, quoted once more than the query is."""
        try:
            given = parse_qs(query, max_num_fields=2)
        except ValueError as error:
            raise InputRefused(query) from error
        folders = [served_folder(self._root, given.get(name, [""])[0]) for name in ("a", "b")]
        first, second = (read_run(self._root, folder) for folder in folders)
        return compared_page(compare(first, second))

    def _file(self, address: str) -> None:
        source = served_file(self._root, address)
        with source.open() as file:
            # Whatever a page is that lies there: it runs scripts of phnn's reports only, and reads nothing from here.
            confined = f"sandbox allow-scripts allow-downloads; frame-ancestors 'none'; {scripts().policy}"
            self._head(HTTPStatus.OK, KINDS[source.suffix], source.size, {"Content-Security-Policy": confined})
            with suppress(ConnectionError):
                shutil.copyfileobj(file, self.wfile)

    def _page(self, content: bytes, status: HTTPStatus = HTTPStatus.OK) -> None:
        self._head(status, _HTML, len(content), {"Content-Security-Policy": policy()})
        self.wfile.write(content)

    def _head(self, status: HTTPStatus, kind: str, size: int, more: Mapping[str, str]) -> None:
        self.send_response(status)
        for name, value in {"Content-Type": kind, "Content-Length": str(size), **_COMMON, **more}.items():
            self.send_header(name, value)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        """Say nothing: the terminal shows where to look, and no text of strangers."""
