"""What is known of the state in which a slice of an operation begins."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import campaigns
import numpy as np
import pytest
import yaml
from campaigns import recorded

from phnn.diagnose.diagnosis import score_on_all
from phnn.errors import PhnnError
from phnn.identification import staged
from phnn.identification.base import identify_base
from phnn.identification.evaluate import evaluate
from phnn.identification.options import Options
from phnn.identification.plan import Plan
from phnn.identification.problem import Problem, expected_start, variables_of
from phnn.models.actuator import hrc
from phnn.recordings import read
from phnn.recordings.recording import Part, Recording, Start
from phnn.setup import Setup
from phnn.trajectory import simulate

NOISE = 3e-8
SETUP = Setup(hrc(2))
T = np.arange(3000) * 1e-4


@pytest.fixture(scope="module")
def whole() -> Recording:
    """Three swings of a sine from rest."""
    return recorded(SETUP, "whole", T, 75.0 * np.sin(2 * np.pi * 10.0 * T), NOISE)


def sliced(whole: Recording, first: int, head: int = 0) -> Recording:
    """What comes after a number of samples; a head that is not scored, or all for identification."""
    size = whole.t.size - first
    parts = (Part("head", 0, head, "nuisance"), Part("rest", head, size, "confirmation"))
    return replace(
        whole, name="slice", t=whole.t[:size], u=whole.u[first:], y=whole.y[first:], start=Start("unknown"),
        parts=parts if head else (Part("all", 0, size, "identification"),),
    )  # fmt: skip


def true_state(whole: Recording, first: int) -> np.ndarray:
    run = simulate(SETUP, whole, 4)
    return np.asarray(run.states[run.nodes[run.lead :]][first])


@pytest.mark.parametrize("first", [1100, 1300, 1600, 1850])
def test_the_expected_state_is_near_the_true_one_where_the_input_went_on_as_before(
    whole: Recording, first: int
) -> None:
    later = sliced(whole, first)
    run = simulate(SETUP, later, 4)
    ranges = np.ptp(run.states, axis=0)
    found, true = expected_start(run, ranges), true_state(whole, first)
    assert (np.abs(found.mean - true) < 2.0 * found.spread).all()
    # Nearer than the state of rest, in the states that remember.
    rest = simulate(SETUP, later, 4).states[0]
    assert np.linalg.norm((found.mean - true) / ranges) < np.linalg.norm((rest - true) / ranges)
    assert (found.spread > 0.0).all()


def test_a_short_recording_expects_rest(whole: Recording) -> None:
    run = simulate(SETUP, replace(sliced(whole, 0), start=Start("rest", 0.0)).only(slice(0, 60)), 2)
    found = expected_start(run, np.ones(run.states.shape[1]))
    assert np.array_equal(found.mean, run.states[0])


def test_derivatives_of_the_prior_are_those_of_finite_differences(whole: Recording) -> None:
    plan = Plan((sliced(whole, 1300),), {"slice": 2}, 1)
    variables = variables_of(SETUP, plan, ("k", "b"))
    rng = np.random.default_rng(3)
    z = variables.start(SETUP) + 0.1 * rng.standard_normal(variables.start(SETUP).size)
    rows = variables.prior(z)
    assert rows.shape == (4, z.size + 1)
    for i in range(z.size):
        step = np.zeros(z.size)
        step[i] = 1e-6
        slope = (variables.prior(z + step)[:, -1] - variables.prior(z - step)[:, -1]) / 2e-6
        np.testing.assert_allclose(rows[:, i], slope, atol=1e-8)


def test_an_optimiser_sees_the_prior(whole: Recording) -> None:
    plan = Plan((sliced(whole, 1300),), {"slice": 2}, 1)
    problem = Problem(SETUP, plan, variables_of(SETUP, plan, ("k",)))
    z = problem.variables.start(SETUP) + 0.05
    prior, slopes, residual = problem.variables.prior(z), problem.jacobian(z), problem.residual(z)
    gradient = slopes.T @ residual + prior[:, :-1].T @ prior[:, -1]
    np.testing.assert_allclose(
        problem.slopes(z).T @ problem.size(z), gradient, rtol=1e-8, atol=1e-6 * np.abs(gradient).max()
    )
    assert problem.size(z)[-1] ** 2 == pytest.approx(residual @ residual + prior[:, -1] @ prior[:, -1])


@pytest.mark.parametrize("first", [200, 700, 1000])
def test_a_slice_is_predicted_as_well_as_the_whole(whole: Recording, first: int) -> None:
    later = sliced(whole, first, head=1000)
    found = evaluate(SETUP, Plan((later,), {"slice": 4}, 1), {})
    assert found.over_noise("confirmation") == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_recordings_cut_at_random_predict_as_well_as_the_whole(tmp_path: Path, seed: int) -> None:
    whole, cut = campaigns.concealed()[0], tmp_path / "cut"
    cut.mkdir()
    manifest, rng = yaml.safe_load((whole / "recordings.yaml").read_text()), np.random.default_rng(seed)
    print(f"seed {seed}")
    entries = []
    for entry in manifest["recordings"]:
        head, *rows = (whole / entry["file"]).read_text().splitlines()
        inner = [(0.2, 0.8)] if rng.random() < 0.5 else [(0.2, 0.4), (0.6, 0.8)]
        cuts = [0, *(int(rng.uniform(*share) * len(rows)) for share in inner), len(rows)]
        for i, (a, b) in enumerate(itertools.pairwise(cuts)):
            name = f"{entry['name']}_{i}"
            (cut / f"{name}.csv").write_text("\n".join([head, *rows[a:b]]) + "\n")
            start = {"start": "unknown"} if a else {}
            entries.append(entry | {"file": f"{name}.csv", "name": name} | start)
    (cut / "recordings.yaml").write_text(yaml.safe_dump(manifest | {"recordings": entries}))

    def held_out(folder: Path) -> float:
        campaign = read(folder)
        fitted, _ = identify_base(campaign, Options(starts=2, workers=1))
        return score_on_all(fitted, campaign).over_noise("confirmation")

    assert held_out(cut) == pytest.approx(held_out(whole), rel=0.1)


@pytest.mark.parametrize("fails", ["identify_actuator", "with_starts"])
def test_known_starts_that_identify_nothing_by_themselves_stop_no_identification(
    whole: Recording, monkeypatch: pytest.MonkeyPatch, fails: str
) -> None:
    def refuse(*_: object) -> None:
        raise PhnnError("not from these")

    short = replace(
        whole, t=whole.t[:800], u=whole.u[:800], y=whole.y[:800], parts=(Part("all", 0, 800, "identification"),)
    )
    plan = Plan((short, sliced(whole, 1500)), {}, 1)
    monkeypatch.setattr(staged, fails, refuse)
    assert staged._from_known_starts(plan, {}, 1, 1, 0) is None
    monkeypatch.undo()
    assert staged._from_known_starts(Plan((short,), {}, 1), {}, 1, 1, 0) is None
