"""A page on this computer that leads from a folder of recordings to a verdict: ``phnn open FOLDER``.

The page shows the columns of every file, takes their roles and units, writes the manifest, and runs ``phnn check`` and
``phnn diagnose`` as processes of their own, whose words and progress it asks for once a second.

Nobody else may ask: the server listens on 127.0.0.1 only, the address that is printed holds a token for one call, and
the cookie that it is exchanged for no script reads and no other site sends. docs/security.md has the whole list.
"""

from __future__ import annotations

import json
import secrets
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
from numpy.typing import NDArray

from phnn.errors import InputRefused, OutputRefused, PhnnError
from phnn.intake import plain_values
from phnn.recordings import read
from phnn.report.page import content
from phnn.results import PROGRESS, printable, write_atomic
from phnn.template import INPUT, MANIFEST, OUTPUT, TIME, Found, Look

Array = NDArray[np.float64]

# Bytes of a body; letters of a command's words that are kept; stretches of a column that are drawn.
_LARGEST, _KEPT, _DRAWN = 1_000_000, 200_000, 500
# The page has its script in itself, and may ask for nothing but what this server has.
_POLICY = "default-src 'none'; script-src 'nonce-{}'; style-src 'unsafe-inline'; connect-src 'self'; base-uri 'none'"


@dataclass
class Work:
    """What one page works on.

    Attributes:
        look: what the files of the folder look like; outside: they may lead out of it.
        manifest: where it is written; out: where the diagnosis goes.
        command, process, words: what was started last, and what it has said; running: not all has been said yet.
    """

    look: Look
    manifest: Path
    out: Path
    outside: bool = False
    command: str = ""
    process: subprocess.Popen[str] | None = None
    words: str = ""
    running: bool = False
    lock: threading.Lock = field(default_factory=threading.Lock)

    def files(self) -> dict[str, Any]:
        """Return every file with its columns, and the manifest that is there or was guessed."""
        files = [{"file": f.file, "reason": f.reason, "columns": _columns(f)} for f in self.look.files]
        there = self.manifest.is_file()
        text = self.manifest.read_text("utf-8", "replace") if there else self.look.text()
        roles = [TIME, INPUT, OUTPUT]
        return {"files": files, "roles": roles, "manifest": text, "there": there, "path": str(self.manifest)}

    def curves(self, file: str) -> dict[str, Any]:
        """Return the columns of a file for a plot: the ends of every column in each of some stretches."""
        recording = next((f for f in self.look.files if f.file == file and not f.reason), None)
        if recording is None:
            raise InputRefused(f"there is no recording {file!r} in {self.look.folder}: choose one of the list")
        return {name: _ends(column.values) for name, column in recording.named.items()}

    def drafted(self, roles: Mapping[str, Any]) -> dict[str, Any]:
        """Return the manifest with the roles and units that a person has picked."""
        picked = {role: (str(given["column"]), str(given["unit"])) for role, given in roles.items()}
        return {"manifest": self.look.picked(picked).text()}

    def save(self, text: str, replace: bool) -> dict[str, Any]:
        """Write a manifest that can be read; one that is there is replaced only where that was said."""
        read(self.look.folder, plain_values(text, MANIFEST), allow_outside=self.outside)
        if self.manifest.exists() and not replace and self.manifest.read_bytes() != text.encode():
            raise OutputRefused(f"{self.manifest}: is there already: tick the box to replace it")
        write_atomic(self.manifest, text.encode())
        return {"saved": str(self.manifest)}

    def start(self, command: str) -> dict[str, Any]:
        """Start ``check`` or ``diagnose`` with the manifest that was saved."""
        if command not in ("check", "diagnose"):
            raise InputRefused(f"{command!r} is nothing that this page starts: take check or diagnose")
        with self.lock:
            if self.running:
                raise InputRefused(f"phnn {self.command} is still running: stop it first")
            given = [command, str(self.look.folder), "--manifest", str(self.manifest)]
            given += ["--out", str(self.out), "--overwrite"] if command == "diagnose" else []
            given += ["--allow-outside"] if self.outside else []
            self.command, self.words = command, ""
            self.process = subprocess.Popen(
                [sys.executable, "-m", "phnn.cli", *given], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT, text=True, encoding="utf-8", errors="replace",
            )  # fmt: skip
            self.running = True
        threading.Thread(target=self._listen, args=(self.process,), daemon=True).start()
        return self.state()

    def _listen(self, process: subprocess.Popen[str]) -> None:
        for line in process.stdout or ():
            self.words = (self.words + line)[-_KEPT:]
        process.wait()
        self.running = False

    def state(self) -> dict[str, Any]:
        """Return what the command that was started last has said, its last step, and how it ended."""
        running, diagnosis, step = self.running, self.command == "diagnose", ""
        if running and diagnosis:
            with suppress(FileNotFoundError):  # it goes when the command ends
                step = str(json.loads((self.out / PROGRESS).read_text("utf-8"))["steps"][-1]["text"])
        status = None if running or self.process is None else self.process.returncode
        report = diagnosis and not running and (self.out / "report.html").is_file()
        words = printable(self.words, lines=True)
        return {"command": self.command, "words": words, "step": step, "status": status, "report": report}

    def stop(self) -> dict[str, Any]:
        """End the command as Ctrl-C does: a diagnosis writes the best so far."""
        if self.process is not None and self.running:
            self.process.send_signal(signal.SIGINT)
        return self.state()

    def report(self) -> bytes:
        """Return the page of the diagnosis."""
        path = self.out / "report.html"
        if not path.is_file():
            raise InputRefused(f"{path}: there is no report yet: start the diagnosis")
        return path.read_bytes()


def _columns(file: Found) -> list[dict[str, Any]]:
    """Return name, unit and role of every column of a file."""
    taken = {role.column.place: {"unit": role.unit, "role": name} for name, role in file.roles.items()}
    free = ((name, c.place, {"unit": c.unit or "", "role": ""}) for name, c in file.named.items())
    return [{"name": name, **taken.get(place, unassigned)} for name, place, unassigned in free]


def _ends(values: Array) -> list[float]:
    """Return the least and the largest value of some stretches, in the order in which they come: no peak is lost."""
    if values.size <= 2 * _DRAWN:
        return [float(v) for v in values]
    edges = np.linspace(0, values.size, _DRAWN + 1).astype(int)
    ends = np.column_stack([np.minimum.reduceat(values, edges[:-1]), np.maximum.reduceat(values, edges[:-1])])
    falls = values[edges[:-1]] > values[edges[1:] - 1]
    ends[falls] = ends[falls, ::-1]
    return [float(v) for v in ends.ravel()]


class Server(ThreadingHTTPServer):
    """The server of one page.

    Attributes:
        work: what the page works on; address: where a browser begins, good for one call.
    """

    daemon_threads = True

    def __init__(self, work: Work, port: int = 0) -> None:
        super().__init__(("127.0.0.1", port), _Handler)
        self.work, self.token = work, secrets.token_urlsafe(32)
        # A browser keeps cookies by the host, whatever the port: each server has a name of its own.
        self.cookie = f"phnn_{self.server_port}={secrets.token_urlsafe(32)}"
        self.hosts = {f"{name}:{self.server_port}" for name in ("127.0.0.1", "localhost")}
        self.address = f"http://127.0.0.1:{self.server_port}/?token={self.token}"


class _Refused(Exception):
    """A request that is not answered, with its status."""


class _Handler(BaseHTTPRequestHandler):
    server: Server
    # A browser may take so many seconds for a request.
    server_version, sys_version, timeout = "phnn", "", 20

    def do_GET(self) -> None:
        work = self.server.work
        self._answer({
            "/": lambda _: self._page(),
            "/files": lambda _: work.files(),
            "/curves": lambda _: work.curves(self._asked("file")),
            "/state": lambda _: work.state(),
            "/report.html": lambda _: self._send(200, work.report(), "text/html; charset=utf-8"),
        })  # fmt: skip

    def do_POST(self) -> None:
        work = self.server.work
        self._answer({
            "/draft": lambda body: work.drafted(body["roles"]),
            "/save": lambda body: work.save(str(body["text"]), body.get("replace") is True),
            "/start": lambda body: work.start(str(body["command"])),
            "/stop": lambda _: work.stop(),
        })  # fmt: skip

    def _answer(self, known: Mapping[str, Callable[[Any], dict[str, Any] | None]]) -> None:
        """Answer one request, or say why it is refused; known paths give json, or have sent their answer."""
        try:
            self._let_in()
            path = urlsplit(self.path).path
            if path not in known:
                raise _Refused(404)
            answer = known[path](self._body() if self.command == "POST" else {})
            if answer is not None:
                self._json(answer)
        except _Refused as refused:
            self.close_connection = True
            self._send(int(refused.args[0]), b"", "text/plain")
        except (KeyError, TypeError, ValueError, AttributeError):
            self._send(400, b"", "text/plain")
        except PhnnError as error:
            self._json({"refused": str(error)}, 422)

    def _let_in(self) -> None:
        """Let in who comes from this page, or with the token of the first call."""
        hosts, origin = self.server.hosts, self.headers.get("Origin")
        if self.headers.get("Host") not in hosts or origin not in (None, *(f"http://{host}" for host in hosts)):
            raise _Refused(403)
        cookies = [c.strip() for c in self.headers.get("Cookie", "").split(";")]
        if any(secrets.compare_digest(c.encode(), self.server.cookie.encode()) for c in cookies):
            return
        token, given = self.server.token, self._asked("token")
        if self.command != "GET" or not token or not secrets.compare_digest(given.encode(), token.encode()):
            raise _Refused(403)
        self.server.token = ""

    def _asked(self, name: str) -> str:
        return parse_qs(urlsplit(self.path).query).get(name, [""])[0]

    def _body(self) -> dict[str, Any]:
        """Return the body of the request as json."""
        size = int(self.headers.get("Content-Length", "-1"))
        if not 0 <= size <= _LARGEST or self.headers.get("Transfer-Encoding"):
            raise _Refused(413)
        return dict(json.loads(self.rfile.read(size)))

    def _page(self) -> None:
        if self._asked("token"):
            self._send(303, b"", "text/plain", [
                ("Location", "/"), ("Set-Cookie", f"{self.server.cookie}; HttpOnly; SameSite=Strict; Path=/"),
            ])  # fmt: skip
            return
        nonce = secrets.token_urlsafe(16)
        text = content("open.html").replace("{{ style }}", content("report.css")).replace("{{ nonce }}", nonce)
        policy = ("Content-Security-Policy", _POLICY.format(nonce))
        self._send(200, text.encode(), "text/html; charset=utf-8", [policy])

    def _json(self, value: Any, status: int = 200) -> None:
        self._send(status, json.dumps(value).encode(), "application/json")

    def _send(self, status: int, body: bytes, kind: str, more: list[tuple[str, str]] | None = None) -> None:
        self.send_response(status)
        safe = [("X-Content-Type-Options", "nosniff"), ("X-Frame-Options", "DENY"), ("Referrer-Policy", "no-referrer")]
        headers = [("Content-Type", kind), ("Content-Length", str(len(body))), ("Cache-Control", "no-store")]
        for name, value in [*headers, *safe, *(more or [])]:
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing: the page shows what matters."""


def serve(work: Work, port: int, tell: Callable[[str], None]) -> None:
    """Serve the page until somebody interrupts; ``tell`` is called with its address.

    Raises:
        OutputRefused: the port is taken; 0 is a free one.
    """
    try:
        server = Server(work, port)
    except OSError as error:
        raise OutputRefused(f"port {port} cannot be used ({error.strerror}): leave --port out") from error
    with server:
        tell(server.address)
        try:
            server.serve_forever()
        finally:
            work.stop()
