"""What a stranger may try: paths that lead out, other names of the host, folders with hostile names, other methods."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

import pytest
from served import ask, diagnosed, running

from phnn.serve.server import Server

SECRET = "a secret outside"


@pytest.fixture
def root(tmp_path: Path) -> Path:
    root = tmp_path / "runs"
    diagnosed(root / "a")
    (tmp_path / "secret.txt").write_text(SECRET)
    (root / ".hidden").mkdir()
    (root / ".hidden" / "secret.txt").write_text(SECRET)
    (root / "a" / "notes.py").write_text(SECRET)
    (root / "link.txt").symlink_to(tmp_path / "secret.txt")
    (root / "out").symlink_to(tmp_path)
    (root / "to_hidden.txt").symlink_to(root / ".hidden" / "secret.txt")
    return root


@pytest.fixture
def found(root: Path) -> Iterator[Server]:
    with running(root) as found:
        yield found


@pytest.mark.parametrize(
    "path",
    [
        "/file/../secret.txt",
        "/file/a/../../secret.txt",
        "/file/%2e%2e/secret.txt",
        "/file/..%2fsecret.txt",
        "/file/a/%2e%2e%2f%2e%2e%2fsecret.txt",
        "/file/%252e%252e/secret.txt",
        "/file/..\\secret.txt",
        "/file//{outside}",
        "/file/{outside}",
        "/file/%00/secret.txt",
        "/file/a/report.html%00.txt",
        "/file/link.txt",
        "/file/out/secret.txt",
        "/file/.hidden/secret.txt",
        "/file/to_hidden.txt",
        "/file/a/notes.py",
        "/file/a",
        "/file/",
        "/run/../",
        "/run/out",
        "/run/%2e%2e",
        "/run/.hidden",
        "/compare?a=..&b=a",
        "/compare?a=%2e%2e%2f&b=out",
        "/compare?" + "&".join(f"a={i}" for i in range(100)),
        "/file/" + "a/" * 5000,
        "/etc/passwd",
        "//file/a/report.html/..",
        "*",
        "http://[",
    ],
)
def test_nothing_outside_the_folder_is_given_out(found: Server, tmp_path: Path, path: str) -> None:
    reply = ask(found, path.replace("{outside}", quote(str(tmp_path / "secret.txt"))))
    assert reply.status in (400, 404)
    assert SECRET not in reply.text and "root:" not in reply.text
    assert ask(found, "/").status == 200


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "", "127.0.0.1.evil.example:{port}"]
)
def test_other_names_of_this_host_are_refused(found: Server, host: str) -> None:
    for path in ("/", "/file/a/report.html"):
        reply = ask(found, path, host=host.replace("{port}", str(found.server_port)))
        assert reply.status == 421 and "the report" not in reply.text and "diagnose" not in reply.text
    assert ask(found, "/", host=f"localhost:{found.server_port}").status == 200


@pytest.mark.parametrize("method", ["HEAD", "POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "MOVE"])
def test_nothing_but_get_is_answered(found: Server, root: Path, method: str) -> None:
    before = sorted(root.rglob("*"))
    assert ask(found, "/file/a/report.html", method).status in (405, 501)
    assert sorted(root.rglob("*")) == before


@pytest.mark.parametrize(
    "name", ["<script>alert(1)</script>", 'a"onmouseover="x', "a&b=%2e%2e#c?d", "{{ 7*7 }}", "é \u202e x"]
)
def test_hostile_names_of_folders_are_text_and_lead_to_their_run(tmp_path: Path, name: str) -> None:
    name = name.replace("/", "\u2215")
    diagnosed(tmp_path / name)
    with running(tmp_path) as found:
        for path in ("/", f"/run/{quote(name)}", f"/compare?a={quote(quote(name))}&b={quote(quote(name))}"):
            page = ask(found, path)
            assert page.status == 200
            assert "<script" not in page.text and '"onmouseover' not in page.text and "49" not in page.text
            assert "\u202e" not in page.text
            assert f'href="/run/{quote(name)}"' in page.text or path.startswith("/run")
        assert "the report" in ask(found, f"/file/{quote(name)}/report.html").text


def test_a_name_that_is_no_utf_8_is_shown(tmp_path: Path) -> None:
    name = os.fsdecode(b"run\xff")
    diagnosed(tmp_path / name)
    with running(tmp_path) as found:
        assert 'href="/run/run%FF"' in ask(found, "/").text
        assert ask(found, "/run/run%FF").status == 200


def test_hostile_results_are_text(tmp_path: Path) -> None:
    diagnosed(tmp_path / "a", verdict="<img src=x>", effect="</table><script>")
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "diagnosis.json").write_text('{"fit": [], "missing": 3, "verdict": {"a": 1}}')
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "diagnosis.json").write_text("[" * 100_000)
    (tmp_path / "c" / "INCOMPLETE.txt").write_text("")
    (tmp_path / "c" / "progress.json").write_text(
        '{"steps": [{"at": "yesterday"}, 3, {"at": "2026-01-01", "text": "<b>"}]}'
    )
    with running(tmp_path) as found:
        for path in ("/", "/run/a", "/run/b", "/run/c", "/compare?a=a&b=b", "/compare?a=c&b=a"):
            page = ask(found, path)
            assert page.status == 200
            assert "<img" not in page.text and "<script" not in page.text
            assert page.text.count("</table>") == page.text.count("<table>")
        assert "<td>&lt;b&gt;</td>" in ask(found, "/run/c").text


def test_what_is_given_out_runs_confined(found: Server) -> None:
    head = ask(found, "/file/a/report.html").head
    policy = head["Content-Security-Policy"]
    assert policy.startswith("sandbox allow-scripts allow-downloads;") and "default-src 'none'" in policy
    assert "unsafe-inline" not in policy.partition("style-src")[0]
    assert head["X-Content-Type-Options"] == "nosniff" and head["Cross-Origin-Resource-Policy"] == "same-origin"
    assert "script-src" not in ask(found, "/").head["Content-Security-Policy"]
