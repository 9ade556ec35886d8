"""Nothing finished is ever lost: failures, a budget and an interruption at any place leave a written answer."""

from __future__ import annotations

import json
import random
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple
from unittest import mock

import campaigns
import numpy as np
import pytest

import phnn
from phnn.cli import main
from phnn.diagnose import diagnosis as path
from phnn.diagnose import linearised, proposal, refit, screen, search
from phnn.diagnose.diagnosis import Diagnosis
from phnn.effects import catalogue
from phnn.effects.learned import learned_elements
from phnn.errors import OutputFailed, SolverFailed
from phnn.identification import evaluate as evaluation
from phnn.identification import problem
from phnn.identification.base import NumericalError, numerical_error
from phnn.identification.plan import Options
from phnn.parallel import executor
from phnn.report import result, sections, statements
from phnn.report.result import write
from phnn.rescue import accounted, allow, attempt, extra, move, needed, results, spend, stop_if_late, used_up

# Functions of numbers and pictures that a diagnosis calls after its base fit, in the modules that call them. For an
# optimiser and for scores, a simulation that does not solve a step is an answer like others: it is no failure there.
SIMULATIONS = [(problem, "simulate"), (linearised, "simulate"), (evaluation, "simulate")]
PLACES: list[tuple[ModuleType, str]] = [
    *SIMULATIONS, (refit, "fit"), (refit, "fit_identified"), (search, "short"), (search, "further"),
    (search, "converged"), (search, "rebuilt"), (search, "numerical_error"), (search, "evaluate"),
    (screen, "direction"), (path, "prepare"), (path, "locate"), (path, "evaluate"), (path, "gain"), (path, "distil"),
    (path, "check"), (path, "propose"), (proposal, "menu"), (sections, "picture"),
    (result, "missing_entries"), (statements, "first_screen"), (statements, "consequence"),
    (sections, "draw_recording"), (sections, "draw_error"), (sections, "parameter_rows"),
]  # fmt: skip
ERRORS: list[Callable[[str], Exception]] = [SolverFailed, FloatingPointError, ValueError, np.linalg.LinAlgError]
TOLD = "raised on purpose"


class Case(NamedTuple):
    """Recordings with an effect, and what there is to explain them with."""

    effect: str
    names: tuple[str, ...]
    learned: tuple[str, ...]


QUICK = Case("creep", ("creep", "extra_hysteron"), ())
# Nothing of the catalogue explains drag: the model is composed of what has no name, and a formula describes that.
COMPOSED = Case("quadratic_drag", ("sensor_drift",), ("learned_damper",))


_SVG = b"<svg ></svg>"


@pytest.fixture(autouse=True)
def _small_pictures() -> Iterator[None]:
    """A figure is drawn, and not rendered: that takes most of the time of a report."""
    with mock.patch.object(sections, "png", return_value=b""), mock.patch.object(sections, "svg", return_value=_SVG):
        yield


@cache
def base(effect: str) -> tuple[Any, NumericalError]:
    fitted = campaigns.base(effect)
    return fitted, numerical_error(fitted)


def diagnosed(case: Case, out: Path | None = None, budget: float | None = None) -> Diagnosis:
    """A diagnosis from a base model that is fitted once, written where a folder is given."""
    effects, campaign = [catalogue()[n] for n in case.names], campaigns.campaign(case.effect)
    setup = base(case.effect)[0].setup
    learned = path._possible(campaign, setup, [e for n, e in learned_elements().items() if n in case.learned])
    with mock.patch.object(path, "identify_base", return_value=base(case.effect)):
        found = path.diagnose(
            campaign, Options(workers=1), effects=effects, learned=learned, budget=budget, answers=True
        )
    if out is not None:
        write(found, out)
    return found


@contextmanager
def counted(on_call: Callable[[str, int], None]) -> Iterator[Counter[str]]:
    """Count the calls of all places by name; each is announced before it is made."""
    count: Counter[str] = Counter()

    def watched(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            count[name] += 1
            on_call(name, count[name])
            return function(*args, **kwargs)

        return call

    with ExitStack() as stack:
        for module, name in PLACES:
            place = f"{module.__name__}.{name}"
            stack.enter_context(mock.patch.object(module, name, watched(place, getattr(module, name))))
        yield count


@cache
def clean(case: Case, folder: Path) -> tuple[Diagnosis, Counter[str]]:
    """A run in which nothing fails, and how often each place was called."""
    with counted(lambda name, call: None) as count:
        found = diagnosed(case, folder / f"clean-{case.effect}")
    return found, count


def chosen(number: int, count: Counter[str]) -> tuple[str, int, Exception]:
    """A place, a call of it, and what it raises."""
    draw = random.Random(number)
    name = draw.choice(sorted(count))
    kinds = ERRORS[1:] if any(name == f"{m.__name__}.{n}" for m, n in SIMULATIONS) else ERRORS
    return name, draw.randint(1, count[name]), kinds[number % len(kinds)](TOLD)


def assert_answered(out: Path, found: Diagnosis) -> dict[str, Any]:
    """All of an answer is there, its model is no worse than the base model; returns the document."""
    content: dict[str, Any] = json.loads((out / "diagnosis.json").read_text())
    assert content["verdict"] == found.verdict
    assert "</html>" in (out / "report.html").read_text()
    assert not (out / "INCOMPLETE.txt").exists()
    t = np.arange(200) * 1e-4
    for name in ("base", "model"):
        assert np.isfinite(phnn.load(out / name).simulate(t, 50.0 * np.sin(600.0 * t))).all()  # type: ignore[union-attr]
    assert found.final.cost <= found.base.cost * (1.0 + 1e-9)
    before, after = (e.over_noise("identification") for e in (found.before, found.after))
    assert after <= before * (1.0 + 1e-6)
    return content


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("rescue")


@pytest.mark.parametrize(("case", "number"), [
    *((QUICK, number) for number in range(2)),
    *(pytest.param(QUICK, number, marks=pytest.mark.slow) for number in range(2, 16)),
    *(pytest.param(COMPOSED, number, marks=pytest.mark.slow) for number in range(14)),
])  # fmt: skip
def test_a_failure_anywhere_after_the_base_fit_leaves_an_answer_that_tells_it(
    case: Case, number: int, folder: Path
) -> None:
    _, count = clean(case, folder)
    name, when, error = chosen(number, count)

    def on_call(called: str, call: int) -> None:
        if (called, call) == (name, when):
            raise error

    out = folder / f"{case.effect}-{number}"
    with counted(on_call):
        found = diagnosed(case, out)
    content = assert_answered(out, found)
    told = [*content["warnings"], *content["ended"]["failed"]]
    assert [t for t in told if TOLD in t["message"] and t["error"] == type(error).__name__], (name, when, told)
    assert TOLD in (out / "report.html").read_text(), (name, when)


def test_a_clean_run_has_no_warnings_and_nothing_left(folder: Path) -> None:
    found, count = clean(QUICK, folder)
    content = assert_answered(folder / "clean-creep", found)
    assert content["warnings"] == []
    used = content["ended"].pop("evaluations")
    assert content["ended"] == {"why": "nothing left", "budget": None, "not_tried": [], "failed": []}
    assert 0.0 < used < Options().evaluations
    assert found.verdict == "named"
    assert {"phnn.diagnose.refit.fit", "phnn.report.sections.draw_recording"} <= set(count)


@contextmanager
def _on_the_command_line(case: Case) -> Iterator[None]:
    """What `diagnosed` sets, for a command."""
    effects = [catalogue()[n] for n in case.names]
    with (
        mock.patch.object(path, "identify_base", return_value=base(case.effect)),
        mock.patch.object(path, "available", return_value=effects),
        mock.patch.object(path, "learned_elements", return_value={}),
        mock.patch("phnn.integrate.cache.compile_ahead", return_value=False),
    ):
        yield


@pytest.mark.parametrize(("limit", "why", "told"), [
    (("--budget", "0.001"), "seconds", ("time of 0.001 s was used up", "search ended before it accepted an element.")),
    (("evaluations=1",), "evaluations", ("its number of evaluations was used up",)),
])  # fmt: skip
def test_a_limit_ends_the_search_with_the_best_so_far(
    limit: tuple[str, ...], why: str, told: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    with _on_the_command_line(QUICK):
        assert main(["diagnose", str(campaigns.concealed("creep")[0]), "--out", str(out), *limit]) == 0
    content = json.loads((out / "diagnosis.json").read_text())
    ended = content["ended"]
    assert content["verdict"] == "unknown"
    assert ended["why"] == why
    assert ended["not_tried"]
    if why == "seconds":
        assert ended["budget"] == 0.001
        assert "what to add to base model" in ended["not_tried"]
    else:
        assert ended["evaluations"] > 1.0
    assert content["warnings"] == []
    for shown in (" ".join(capsys.readouterr().out.split()), (out / "report.html").read_text()):
        assert all(words in shown for words in told)
    assert (out / "model").is_dir()


def test_an_interrupted_search_leaves_its_answer(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def on_call(name: str, call: int) -> None:
        if (name, call) == ("phnn.diagnose.search.converged", 1):
            # Short refits are done, and none is carried to its end yet.
            raise KeyboardInterrupt

    out = tmp_path / "out"
    with _on_the_command_line(QUICK), counted(on_call):
        assert main(["diagnose", str(campaigns.concealed("creep")[0]), "--out", str(out)]) == 130
    content = json.loads((out / "diagnosis.json").read_text())
    assert content["ended"]["why"] == "interrupted"
    assert not (out / "INCOMPLETE.txt").exists()
    # The best refit is the model, and the word is that of a search that did not end.
    assert content["verdict"] == "unknown"
    assert [m["effect"] for m in content["missing"]] in (["creep"], ["unknown"])
    ends = [content["fit"][when]["step_75V"]["residual_over_noise"] for when in ("before", "after")]
    assert ends[0] > 6.0
    assert ends[1] < 1.2
    assert "The search was interrupted." in (out / "report.html").read_text()
    assert "interrupted; what was finished is in" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["files", "available", "begin", "prepare"])
def test_an_interruption_before_the_search_leaves_an_answer(name: str) -> None:
    """Ctrl-C while files of the base model are written, or the candidates are put together."""
    calls: list[str] = []

    def interrupted_once(do: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            calls.append(name)
            if len(calls) == 1:
                raise KeyboardInterrupt
            return do(*args, **kwargs)

        return call

    on_base = interrupted_once(lambda fitted: None) if name == "files" else None
    campaign, place = campaigns.campaign("creep"), search if name == "prepare" else path
    watched = (
        mock.patch.object(place, name, interrupted_once(getattr(place, name))) if on_base is None else nullcontext()
    )
    with watched, mock.patch.object(path, "identify_base", return_value=base("creep")):
        found = path.diagnose(campaign, Options(workers=1), on_base=on_base, learned=[], answers=True)
    assert calls
    assert (found.verdict, found.ended.why) == ("unknown", "interrupted")
    assert found.chosen.key == frozenset()


def test_a_second_interruption_ends_at_once(tmp_path: Path) -> None:
    def on_call(name: str, call: int) -> None:
        if name in ("phnn.diagnose.search.converged", "phnn.diagnose.diagnosis.evaluate"):
            raise KeyboardInterrupt

    with counted(on_call), pytest.raises(KeyboardInterrupt):
        diagnosed(QUICK)


def test_a_failure_of_the_test_itself_is_no_verdict_on_the_base_model(tmp_path: Path) -> None:
    with mock.patch.object(screen.Screen, "__call__", side_effect=FloatingPointError(TOLD)):
        found = diagnosed(QUICK, tmp_path / "out")
    content = assert_answered(tmp_path / "out", found)
    assert content["verdict"] == "unknown"
    assert content["test"]["candidate"] is None
    assert "Whether something is missing is not known" in (tmp_path / "out" / "report.html").read_text()


def test_a_recording_that_cannot_be_simulated_does_not_take_the_others_with_it(tmp_path: Path) -> None:
    simulate = evaluation.simulate

    def failing_at_one(setup: Any, recording: Any, *args: Any, **kwargs: Any) -> Any:
        if recording.name == "sine_010Hz_50V":
            raise SolverFailed(TOLD)
        return simulate(setup, recording, *args, **kwargs)

    with mock.patch.object(evaluation, "simulate", failing_at_one):
        found = diagnosed(QUICK, tmp_path / "out", budget=1e-6)
    content = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert set(content["fit"]["before"]) == {"sine_010Hz_75V", "sine_100Hz_75V", "step_75V"}
    assert [w["part"] for w in content["warnings"]] == ["scores on sine_010Hz_50V"]
    assert found.verdict == "unknown"


def _fails() -> float:
    raise FloatingPointError(TOLD)


@pytest.mark.parametrize("call", [attempt, move, extra, needed])
def test_failures_show_themselves_on_request_and_where_nobody_accounts_for_them(
    call: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(FloatingPointError):
        call("part", _fails, None)
    monkeypatch.setenv("PHNN_DEBUG", "1")
    with accounted(), pytest.raises(FloatingPointError):
        call("part", _fails, None)


def test_what_cannot_be_written_is_no_part_that_is_left_out() -> None:
    def full() -> None:
        raise OutputFailed("no space left")

    with accounted(), pytest.raises(OutputFailed):
        needed("report", full, None)


def test_no_move_begins_after_the_time_and_what_every_answer_needs_does() -> None:
    def late() -> str:
        stop_if_late()
        return "done"

    with accounted(until=0.0) as account:
        assert needed("scores", late, "") == "done"
        assert move("element 1", late, "") == ""
        assert move("element 2", _fails, 2.0) == 2.0
        assert needed("scores", late, "") == "done"
    assert account.ended().not_tried == ("element 1", "element 2")
    assert account.ended().why == "seconds"
    assert account.ended().warnings == ()


def _late_or_failing(item: str) -> str:
    if item == "late":
        stop_if_late()
    if item == "failing":
        raise SolverFailed(TOLD)
    return item.upper()


@pytest.mark.parametrize("where", ["serial", "threads:2", pytest.param("processes:2", marks=pytest.mark.slow)])
def test_refits_elsewhere_fail_and_stop_alone(where: str) -> None:
    there, items = executor(where), ["a", "failing", "b"]
    with accounted(until=time.time() - 1.0) as account:
        assert needed("refits", lambda: results(there, _late_or_failing, items, items), []) == ["A", None, "B"]
        assert move("refits", lambda: results(there, _late_or_failing, ["a", "late"], ["x", "y"]), []) == ["A", None]
    assert [(f.candidate, f.message) for f in account.failed] == [("failing", TOLD)]
    assert (account.stopped, account.not_tried) == ("seconds", ["y"])


def _spending(item: str) -> str:
    for _ in range(20):
        if not used_up():
            spend(1.0)
    return item.upper()


@pytest.mark.parametrize("where", ["serial", "threads:2"])
@pytest.mark.parametrize(("before", "done"), [(0.0, 5), (70.0, 2)])
def test_a_budget_ends_between_refits_wherever_they_are_done(where: str, before: float, done: int) -> None:
    items = list("abcde")
    with accounted() as account:
        allow(100.0, 1.0)
        spend(before)
        found = move("refits", lambda: results(executor(where), _spending, items, items), [])
    assert found == [*"ABCDE"[:done], *([None] * (5 - done))]
    assert account.evaluations == 100.0
    assert account.ended().why == ("nothing left" if done == 5 else "evaluations")
    # Two have ended where half of what was left was used up, three were not begun.
    assert account.not_tried == ([] if done == 5 else ["a", "b", "c, d, e"])
