"""A folder of runs as the commands leave it, a server of it, and requests to it."""

from __future__ import annotations

import http.client
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from phnn.serve import server
from phnn.serve.server import Server


class Reply(NamedTuple):
    """Status, head and text of an answer."""

    status: int
    head: dict[str, str]
    text: str


def diagnosed(folder: Path, verdict: str = "named", effect: str = "creep", scale: float = 1.0) -> dict[str, Any]:
    """Write the json of a diagnosis and of its model; returns the former."""
    rows = {"sine": (6.5 * scale, 1.01 * scale), "step": (3.25 * scale, 0.99 * scale)}
    content = {
        "schema": "phnn.diagnosis/1",
        "verdict": verdict,
        "missing": [{"effect": effect}],
        "fit": {
            "before": {n: {"residual_over_noise": a} for n, (a, _) in rows.items()},
            "after": {n: {"residual_over_noise": b} for n, (_, b) in rows.items()},
            "held_out": ["step"],
        },
    }
    parameters = {"k": {"value": 3.1e5 * scale, "unit": "N/m"}, effect: {"value": 0.25 * scale, "unit": "s"}}
    (folder / "model").mkdir(parents=True)
    (folder / "diagnosis.json").write_text(json.dumps(content))
    (folder / "model" / "model.json").write_text(json.dumps({"parameters": parameters}))
    (folder / "report.html").write_text("<!doctype html><title>r</title><p>the report</p>")
    return content


@contextmanager
def running(folder: Path) -> Iterator[Server]:
    """A server of a folder, in a thread."""
    with server(folder) as found:
        thread = threading.Thread(target=found.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield found
        finally:
            found.shutdown()
            thread.join()


def ask(found: Server, path: str, method: str = "GET", host: str | None = None) -> Reply:
    """One request; ``path`` is sent as it is, however odd. Without a host the right one is named."""
    connection = http.client.HTTPConnection("127.0.0.1", found.server_port, timeout=30)
    try:
        connection.putrequest(method, path, skip_host=True)
        if host != "":
            connection.putheader("Host", host or f"127.0.0.1:{found.server_port}")
        connection.endheaders()
        reply = connection.getresponse()
        return Reply(reply.status, dict(reply.getheaders()), reply.read().decode("utf-8", "replace"))
    finally:
        connection.close()
