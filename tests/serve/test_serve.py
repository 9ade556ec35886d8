"""The pages of the server: all runs, one that goes on, two compared; it ends when it is told to."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from served import ask, diagnosed, running

from phnn.errors import InputRefused
from phnn.output import claim, watched
from phnn.report.formatting import number, ratio
from phnn.serve import server
from phnn.serve.runs import find_runs


def cells(page: str) -> list[list[str]]:
    """The text of every row of the tables of a page."""
    rows = re.findall(r"<tr>(.*?)</tr>", page, re.DOTALL)
    return [
        [re.sub(r"<[^>]*>", "", c).strip() for c in re.findall(r"<t[dh][^>]*>(.*?)</t[dh]>", r, re.DOTALL)]
        for r in rows
    ]


def test_all_runs_are_listed_with_their_reports(tmp_path: Path) -> None:
    diagnosed(tmp_path / "first")
    diagnosed(tmp_path / "deep" / "second", verdict="unknown", effect="unknown")
    for name, file in (
        ("fit", "identify.json"),
        ("shown", "predict.json"),
        ("kinds", "compare.json"),
        ("proof", "rates.csv"),
    ):
        (tmp_path / name).mkdir()
        (tmp_path / name / file).write_text("{}")
    (tmp_path / "recordings").mkdir()
    (tmp_path / "recordings" / "a.csv").write_text("t,u\n")
    with running(tmp_path) as found:
        page = ask(found, "/").text
        rows = {row[0]: row[1:] for row in cells(page)[1:]}
        assert {n: r[0] for n, r in rows.items()} == {
            "first": "diagnose", "deep/second": "diagnose", "fit": "identify", "shown": "predict", "kinds": "compare",
            "proof": "prove",
        }  # fmt: skip
        assert rows["first"][1:4] == ["report", "named (creep)", "3.25 → 0.99"]
        assert rows["deep/second"][2] == "unknown (unknown)"
        (link,) = re.findall(r'href="(/file/deep/second/[^"]*)"', page)
        assert "the report" in ask(found, link).text
        assert ask(found, "/run/first").text.count("/file/first/") == 2
        assert 'http-equiv="refresh"' not in page


def test_a_folder_without_runs_says_so(tmp_path: Path) -> None:
    with running(tmp_path) as found:
        assert "No results of phnn lie here" in ask(found, "/").text


def test_a_run_that_goes_on_shows_its_steps_and_is_loaded_again(tmp_path: Path) -> None:
    said: list[str] = []
    with running(tmp_path) as found:
        with claim(tmp_path / "now", "diagnose") as place, watched(place, "diagnose", said.append) as progress:
            progress("identify <phs> with 2 hysterons")
            progress("verdict named; confirm")
            page = ask(found, "/run/now").text
            assert "not finished" in page and "identify &lt;phs&gt; with 2 hysterons" in page
            assert page.index("verdict named; confirm") < page.index("identify &lt;phs")
            assert 'http-equiv="refresh"' in page and 'http-equiv="refresh"' in ask(found, "/").text
            assert cells(ask(found, "/").text)[1][1:3] == ["diagnose", "not finished: verdict named; confirm"]
            (place / "diagnosis.json").write_json({"verdict": "none"})
        page = ask(found, "/run/now").text
        assert "complete" in page and "refresh" not in page and "Progress" not in page
    assert said == ["identify <phs> with 2 hysterons", "verdict named; confirm"]


def test_a_run_within_another_that_goes_on_is_not_finished(tmp_path: Path) -> None:
    diagnosed(tmp_path / "demo" / "diagnosis")
    with (
        claim(tmp_path / "demo", "demo") as place,
        watched(place / "diagnosis", "diagnose", lambda text: None) as progress,
    ):
        progress("identify")
        states = {run.name: run.complete for run in find_runs(tmp_path)}
    assert states == {"demo": False, "demo/diagnosis": False}


def test_compared_numbers_are_those_of_the_json(tmp_path: Path) -> None:
    first = diagnosed(tmp_path / "a")
    second = diagnosed(tmp_path / "b", effect="electrostriction", scale=1.7)
    del second["fit"]["after"]["sine"]
    (tmp_path / "b" / "diagnosis.json").write_text(json.dumps(second))
    with running(tmp_path) as found:
        rows = cells(ask(found, "/compare?a=a&b=b").text)
    assert ["verdict", "named", "named"] in rows and ["missing", "creep", "electrostriction"] in rows

    def over_noise(content: dict[str, dict[str, dict[str, dict[str, float]]]], which: str, name: str) -> str:
        return ratio(content["fit"][which].get(name, {}).get("residual_over_noise"))

    for name, held in (("sine", ""), ("step", "A and B")):
        values = [over_noise(c, which, name) for c in (first, second) for which in ("before", "after")]
        assert [name, *values, held] in rows
    models = [json.loads((tmp_path / n / "model/model.json").read_text())["parameters"] for n in ("a", "b")]
    assert ["k", *(number(m["k"]["value"], 5) for m in models), "N/m", "+70.0 %"] in rows
    assert ["creep", number(0.25, 5), "–", "s", "–"] in rows
    assert ["electrostriction", "–", number(0.425, 5), "s", "–"] in rows


def test_worst_is_asked_of_held_out_recordings_first(tmp_path: Path) -> None:
    content = diagnosed(tmp_path / "a")
    (run,) = find_runs(tmp_path)
    assert (run.worst("before"), run.worst("after")) == (3.25, 0.99)
    content["fit"]["held_out"] = []
    (tmp_path / "a" / "diagnosis.json").write_text(json.dumps(content))
    (run,) = find_runs(tmp_path)
    assert run.worst("before") == 6.5


def test_a_run_that_goes_while_it_is_looked_at_is_left_out(tmp_path: Path) -> None:
    diagnosed(tmp_path / "a")
    with running(tmp_path) as found:
        assert ask(found, "/run/a").status == 200
        shutil.rmtree(tmp_path / "a")
        assert ask(found, "/run/a").status == 404
        assert "No results" in ask(found, "/").text


def test_a_taken_port_and_an_absent_folder_are_refused(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(InputRefused, match="leave it out for a free one"):
            server(tmp_path, taken.getsockname()[1])
    for port in (-1, 70_000):
        with pytest.raises(InputRefused, match="must be 1 to 65535"):
            server(tmp_path, port)
    with pytest.raises(InputRefused, match="is no folder"):
        server(tmp_path / "absent")


def test_only_this_machine_can_connect(tmp_path: Path) -> None:
    with server(tmp_path) as found:
        assert found.server_address[0] == "127.0.0.1"


def test_the_command_ends_tidily_when_it_is_interrupted(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "phnn.cli", "serve", str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    line = process.stdout.readline()
    (port,) = re.findall(r"http://127\.0\.0\.1:(\d+)/", line)
    with socket.create_connection(("127.0.0.1", int(port))):  # one that says nothing must not keep it from ending
        process.send_signal(signal.SIGINT)
        _, error = process.communicate(timeout=20)
    assert process.returncode == 130
    assert error == "phnn: interrupted\n"


def test_a_file_of_the_future_hides_no_run(tmp_path: Path) -> None:
    diagnosed(tmp_path / "a")
    (tmp_path / "a" / "late.txt").touch()
    os.utime(tmp_path / "a" / "late.txt", (4e9, 4e9))
    with running(tmp_path) as found:
        assert [row[0] for row in cells(ask(found, "/").text)[1:]] == ["a"]


def test_the_served_folder_itself_is_compared(tmp_path: Path) -> None:
    diagnosed(tmp_path)
    diagnosed(tmp_path / "b")
    with running(tmp_path) as found:
        values = re.findall(r'<option value="([^"]*)"', ask(found, "/").text)
        assert sorted(set(values)) == ["", "b"]
        assert ["verdict", "named", "named"] in cells(ask(found, "/compare?a=&b=b").text)
