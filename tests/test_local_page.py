"""The page of ``phnn open``: who may ask, what it says, and the whole way from a folder to a verdict in Chromium."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator, Mapping
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chromium import PROGRAM, chromium

from phnn.local_page import Server, Work
from phnn.template import look

Reply = tuple[int, Mapping[str, str], bytes]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with two recordings of a capacitor behind a resistor, 0.2 s."""
    there = tmp_path_factory.mktemp("lab")
    rng = np.random.default_rng(1)
    for name, frequency in (("slow", 0.5), ("fast", 2.0)):
        t = 0.01 * np.arange(300)
        u = 3.0 * np.sin(2.0 * np.pi * frequency * t)
        y = np.zeros(t.size)
        for n in range(1, t.size):
            y[n] = y[n - 1] + 0.05 * (0.5 * (u[n] + u[n - 1]) - y[n - 1])
        columns = np.column_stack([t, u, y + 0.01 * rng.standard_normal(t.size)])
        np.savetxt(there / f"{name}.csv", columns, delimiter=",", header="time_s,U_in,U_out", comments="", fmt="%.6g")
    return there


@pytest.fixture
def server(folder: Path, tmp_path: Path) -> Iterator[Server]:
    """A server that runs; its manifest and results are this test's own."""
    with Server(Work(look(folder), tmp_path / "recordings.yaml", tmp_path / "out")) as found:
        threading.Thread(target=found.serve_forever, args=(0.02,), daemon=True).start()
        yield found
        found.work.stop()
        found.shutdown()


def asked(server: Server, method: str, path: str, body: Any = None, known: bool = True, **headers: str) -> Reply:
    """Send one request as a browser that knows the cookie would, or not."""
    given = {"Cookie": server.cookie} if known else {}
    connection = HTTPConnection("127.0.0.1", server.server_port, timeout=30)
    content = None if body is None else body if isinstance(body, bytes) else json.dumps(body).encode()
    connection.request(method, path, content, {**given, **{n.replace("_", "-"): v for n, v in headers.items()}})
    reply = connection.getresponse()
    return reply.status, dict(reply.headers), reply.read()


def test_the_token_serves_once_and_gives_a_cookie_of_this_page(server: Server) -> None:
    path = server.address.partition(str(server.server_port))[2]
    status, headers, _ = asked(server, "GET", path, known=False)
    assert (status, headers["Location"]) == (303, "/")
    assert {"HttpOnly", "SameSite=Strict"} <= set(headers["Set-Cookie"].split("; "))
    assert asked(server, "GET", path, known=False)[0] == 403
    status, headers, page = asked(server, "GET", "/", Cookie=headers["Set-Cookie"].partition(";")[0])
    nonce = headers["Content-Security-Policy"].partition("nonce-")[2].partition("'")[0]
    assert status == 200 and f'nonce="{nonce}"'.encode() in page


@pytest.mark.parametrize(
    ("status", "request_"),
    [
        (403, {"path": "/", "known": False}),
        (403, {"path": "/?token=guessed", "known": False}),
        (403, {"path": "/files", "Host": "evil.example"}),
        (403, {"path": "/files", "Origin": "http://evil.example"}),
        (403, {"path": "/stop", "method": "POST", "Origin": "null"}),
        (404, {"path": "/../recordings.yaml"}),
        (404, {"path": "/%2e%2e/%2e%2e/etc/passwd"}),
        (404, {"path": "/start", "method": "GET"}),
        (413, {"path": "/save", "method": "POST", "Content_Length": "2000000"}),
        (413, {"path": "/save", "method": "POST", "Content_Length": "-1"}),
        (400, {"path": "/save", "method": "POST", "body": b"{"}),
        (400, {"path": "/save", "method": "POST", "body": [1]}),
        (422, {"path": "/start", "method": "POST", "body": {"command": "demo"}}),
        (422, {"path": "/curves?file=../slow.csv"}),
        (422, {"path": "/report.html"}),
        (501, {"path": "/files", "method": "PUT"}),
    ],
)
def test_nobody_else_is_let_in_and_nothing_else_is_sent(server: Server, status: int, request_: dict[str, Any]) -> None:
    request_ = {"method": "GET", **request_}
    assert asked(server, request_.pop("method"), request_.pop("path"), **request_)[0] == status


def test_picked_roles_make_a_manifest_that_is_saved_once(server: Server) -> None:
    files = json.loads(asked(server, "GET", "/files")[2])
    assert [f["file"] for f in files["files"]] == ["fast.csv", "slow.csv"] and not files["there"]
    roles = {"time": ("time_s", "s"), "input": ("U_in", "V"), "output": ("U_out", "furlough")}
    given = {role: {"column": column, "unit": unit} for role, (column, unit) in roles.items()}
    status, _, said = asked(server, "POST", "/draft", {"roles": given})
    assert status == 422 and "furlough" in json.loads(said)["refused"]
    given["output"]["unit"] = "mV"
    text = json.loads(asked(server, "POST", "/draft", {"roles": given})[2])["manifest"]
    assert "unit: mV" in text
    status, _, said = asked(server, "POST", "/save", {"text": "recordings: 3"})
    assert status == 422 and not server.work.manifest.exists()
    assert asked(server, "POST", "/save", {"text": text})[0] == 200
    assert server.work.manifest.read_text("utf-8") == text
    assert asked(server, "POST", "/save", {"text": text + "\n"})[0] == 422
    assert asked(server, "POST", "/save", {"text": text + "\n", "replace": True})[0] == 200


def test_curves_keep_every_peak(tmp_path: Path) -> None:
    t = np.arange(5000.0)
    spike = np.where(t == 3217.0, 9.0, -t / 5000.0)
    np.savetxt(tmp_path / "long.csv", np.column_stack([t, np.sin(t), spike]), delimiter=",", header="t,u,y")
    curves = Work(look(tmp_path), tmp_path / "recordings.yaml", tmp_path / "out").curves("long.csv")
    assert len(curves["y"]) == 1000 and max(curves["y"]) == 9.0 and curves["t"] == sorted(curves["t"])


@pytest.mark.skipif(PROGRAM is None, reason="there is no Chromium here")
def test_from_nothing_to_a_verdict(server: Server, tmp_path: Path) -> None:
    with chromium(tmp_path / "profile") as page:

        def until(expression: str) -> None:
            end = time.monotonic() + 120.0
            while not page.value(expression):
                assert time.monotonic() < end, f"{expression}: {page.value('document.body.innerText')}"
                time.sleep(0.1)

        page.open(server.address)
        until("document.querySelectorAll('polyline').length === 2")
        page.value("document.getElementById('output-unit').value = 'mV'")
        page.value("document.getElementById('output-unit').dispatchEvent(new Event('change'))")
        until("document.getElementById('manifest').value.includes('unit: mV')")
        page.value("document.getElementById('check').click()")
        until("document.getElementById('step').textContent === 'phnn check has ended.'")
        assert "mV" in page.value("document.getElementById('words').textContent")
        page.value("document.getElementById('diagnose').click()")
        until("!document.getElementById('report').hidden")
        assert "verdict: none" in page.value("document.getElementById('words').textContent")
        assert page.complaints() == []
        page.open(f"http://127.0.0.1:{server.server_port}/report.html")
        assert page.value("document.querySelector('h1').textContent") == "Nothing is missing"
        assert page.complaints() == []
