"""Nothing finished is ever lost: failures, a budget and an interruption at any place leave a written answer."""

from __future__ import annotations

import json
import random
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
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
from phnn.commands import diagnose as command
from phnn.diagnosis import confirm, linearised_fit, propose, retest, scored, select, steps, tested
from phnn.diagnosis import diagnosis as path
from phnn.diagnosis.diagnosis import Diagnosis
from phnn.effects import catalogue
from phnn.errors import InputRefused, SolverFailed
from phnn.identification import left_out, problem
from phnn.identification import evaluate as evaluation
from phnn.identification.numerics import NumericalError, numerical_error
from phnn.identification.options import Options
from phnn.rescue import Stopped, accounted, attempt, extra, move, needed, results, stop_if_late
from phnn.report import gallery, page, result
from phnn.report.result import write

# Functions of numbers and pictures that a diagnosis calls after its base fit, in the modules that call them. A simulation
# that does not solve a step is for an optimiser and for scores an answer like others; so it is no failure there.
SIMULATIONS = [(problem, "simulate"), (linearised_fit, "simulate"), (evaluation, "simulate"), (steps, "started")]
PLACES: list[tuple[ModuleType, str]] = [
    *SIMULATIONS, (steps, "fit"), (steps, "fit_identified"), (retest, "fit_identified"), (scored, "score"),
    (scored, "responses"), (scored, "locate"), (scored, "prepare"), (select, "class_of"), (select, "numerical_error"),
    (left_out, "evaluate"), (tested, "evaluate"), (tested, "gain"), (confirm, "tested_elements"), (path, "distil"),
    (path, "check"), (path, "questions"), (propose, "menu"), (result, "account"), (result, "picture"),
    (result, "sentence"), (result, "missing_entries"), (result, "methods"), (gallery, "draw_recording"),
    (gallery, "draw_overview"), (gallery, "plots"), (page, "table_links"),
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


@pytest.fixture(autouse=True)
def _small_pictures() -> Iterator[None]:
    """A figure is drawn, and not rendered: that takes most of the time of a report."""
    with mock.patch.object(gallery, "png", return_value=b""), mock.patch.object(gallery, "svg", return_value=b""):
        yield


@cache
def base(effect: str) -> tuple[Any, NumericalError]:
    fitted = campaigns.base(effect)
    return fitted, numerical_error(fitted)


def diagnosed(case: Case, out: Path | None = None, budget: float | None = None) -> Diagnosis:
    """A diagnosis from a base model that is fitted once, written where a folder is given."""
    from phnn.effects.learned import learned_elements

    effects, campaign = [catalogue()[n] for n in case.names], campaigns.campaign(case.effect)
    setup = base(case.effect)[0].setup
    learned = path._possible(campaign, setup, [e for n, e in learned_elements().items() if n in case.learned])
    with mock.patch.object(path, "identify_base", return_value=base(case.effect)):
        found = path.diagnose(campaign, Options(workers=1), effects=effects, learned=learned, budget=budget)
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
        found = diagnosed(case, folder / "clean")
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
    assert found.judgement.final.cost <= found.judgement.linearised.fit.cost * (1.0 + 1e-9)
    before, after = (e.over_noise("identification") for e in (found.before, found.after))
    assert after <= before * (1.0 + 1e-6)
    return content


def failing(case: Case, number: int, folder: Path) -> None:
    """One failure at a random place after the base fit: there is an answer, and it tells the failure."""
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


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("rescue")


def test_a_clean_run_has_no_warnings_and_nothing_left(folder: Path) -> None:
    found, count = clean(QUICK, folder)
    content = assert_answered(folder / "clean", found)
    assert content["warnings"] == []
    assert content["ended"] == {"why": "nothing left", "budget": None, "not_tried": [], "failed": []}
    assert found.verdict == "named"
    assert {"phnn.diagnosis.steps.fit", "phnn.report.gallery.draw_recording"} <= set(count)


@pytest.mark.parametrize("number", range(3))
def test_a_failure_leaves_an_answer(number: int, folder: Path) -> None:
    failing(QUICK, number, folder)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(3, 11))
def test_failures_anywhere_leave_an_answer(number: int, folder: Path) -> None:
    failing(QUICK, number, folder)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(9))
def test_failures_anywhere_in_a_composition_leave_an_answer(
    number: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    failing(COMPOSED, number, _composed_folder(tmp_path_factory))


@cache
def _composed_folder(factory: pytest.TempPathFactory) -> Path:
    return factory.mktemp("composed")
