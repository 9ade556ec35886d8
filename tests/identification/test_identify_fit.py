"""The machinery of a fit: residual, derivatives, covariance, identifiability, and where a slice begins."""

from __future__ import annotations

import itertools
import pickle
from dataclasses import replace
from pathlib import Path

import campaigns
import numpy as np
import pytest
import yaml
from campaigns import recorded

from phnn.diagnose.diagnosis import score_on_all
from phnn.identification.base import identify_base, released, resumed
from phnn.identification.evaluate import evaluate
from phnn.identification.fit import fit, unidentified
from phnn.identification.plan import Options, Plan
from phnn.identification.problem import Problem, expected_start, variables_of, without_nuisances
from phnn.identification.staged import fit_identified
from phnn.identification.starting_points import scaled_points
from phnn.models.actuator import hrc
from phnn.recordings import read
from phnn.recordings.recording import Part, Recording, Start
from phnn.rescue import accounted
from phnn.setup import Setup
from phnn.trajectory import simulate


def test_a_fit_that_rests_too_early_goes_on() -> None:
    best = campaigns.base()
    moved = best.setup.with_values({n: 1.01 * best.setup.values()[n] for n in ("k", "alpha")})
    early = fit(moved, best.plan, best.variables.names, best.held, max_evaluations=1)
    assert early.cost > 1.5 * best.cost
    assert resumed(early).cost < 1.001 * best.cost


def test_a_fit_at_its_optimum_is_left_alone() -> None:
    best = campaigns.base()
    again = fit_identified(best.setup, best.plan, {"m": "held at the stated value"})
    assert again.held == {"m": "held at the stated value"}
    assert resumed(again) is again and released(again) is again


def test_stated_bounds_hold_in_units_that_suit_the_recordings() -> None:
    fitted = campaigns.base()
    k = fitted.setup.parameters["k"]
    stated = replace(k, value=0.02 * k.value, lower=0.01 * k.value, upper=3.0 * k.value)
    network = replace(fitted.setup.network, parameters=fitted.setup.network.parameters | {"k": stated})
    points = scaled_points(replace(fitted.setup, network=network), fitted.plan, {})
    assert {(p.parameters["k"].lower, p.parameters["k"].upper) for p in points} == {(stated.lower, stated.upper)}


def test_a_parameter_on_a_plateau_comes_back() -> None:
    fitted = campaigns.base()
    # With the first hysteron held, the two cannot change places.
    stated = dict.fromkeys(("m", "rho_1", "C_1", "d_1"), "held at the stated value")
    # Hysteron 2 without a limit to its current: a plateau, far above the best fit.
    away = fitted.setup.with_values({"rho_2": 1e6})
    stuck = fit_identified(away, fitted.plan, stated)
    assert "rho_2" in stuck.held
    assert stuck.cost > 1.5 * fitted.cost
    free = released(stuck)
    assert "rho_2" not in free.held
    assert free.cost < 1.02 * fitted.cost


def test_rough_derivatives_are_nearly_the_exact_ones_and_cost_less() -> None:
    best, found, spent = campaigns.base(), [], []
    for rough in (False, True):
        variables = variables_of(best.setup, best.plan, best.variables.names)
        with accounted() as account:
            problem = Problem(best.setup, replace(best.plan, rough=rough), variables)
            found.append(problem.jacobian(variables.start(best.setup)))
        spent.append(account.spent)
    exact, rough_ones = found
    assert not np.array_equal(exact, rough_ones)
    assert (np.linalg.norm(rough_ones - exact, axis=0) < 0.1 * np.linalg.norm(exact, axis=0)).all()
    assert spent[1] < 0.7 * spent[0]


def test_displacement_zero_is_projected_out_exactly() -> None:
    fitted = campaigns.base()
    shifted = tuple(replace(r, y=r.y + 1e-4 * (i + 1)) for i, r in enumerate(fitted.plan.recordings))
    here = Problem(fitted.setup, fitted.plan, fitted.variables)
    moved = Problem(fitted.setup, replace(fitted.plan, recordings=shifted), fitted.variables)
    # A zero of a tenth of a millimetre, a thousand times the noise, leaves rounding.
    np.testing.assert_allclose(moved.residual(fitted.z), here.residual(fitted.z), atol=1e-8)
    for rows in fitted.slices:
        assert np.abs(fitted.jacobian[rows].mean(axis=0)).max() < 1e-9 * np.abs(fitted.jacobian[rows]).max()
        assert abs(fitted.residual[rows].mean()) < 1e-8


def test_unidentified() -> None:
    rng = np.random.default_rng(1)
    a, b, c = np.linalg.qr(rng.standard_normal((50, 3)))[0].T
    assert unidentified(np.column_stack([100 * a, 10 * b, 5 * c]), ["a", "b", "c"]) == []
    # A coordinate uncertain by 2, more than a factor e^1.5, goes; one uncertain by a half stays.
    assert unidentified(np.column_stack([100 * a, 0.5 * b, 2.0 * c]), ["a", "b", "c"]) == ["b"]
    assert unidentified(np.column_stack([100 * a, 0 * b, 5 * c]), ["a", "b", "c"]) == ["b"]
    twins = unidentified(np.column_stack([100 * a, 100 * b, 100 * b]), ["a", "b", "twin"])
    assert twins in (["b"], ["twin"])
    assert set(unidentified(np.zeros((50, 2)), ["a", "b"])) == {"a", "b"}
    # Two that are only known by their product: one is dropped, and the other one is known then.
    product = np.column_stack([100 * a + 1e-3 * b, 100 * a - 1e-3 * b])
    assert len(unidentified(product, ["a", "b"])) == 1


def test_initial_state_is_estimated_where_the_start_is_unknown() -> None:
    fitted = campaigns.base()
    whole = fitted.plan.recordings[0]
    later = sliced(whole, 700)
    found = fit(fitted.setup, Plan((later,), fitted.plan.substeps, workers=1), ())
    initial = found.initial(later.name)
    assert initial is not None
    assert found.variables.unknown == (later.name,)
    assert 0.85 < found.chi2 < 1.15
    error = later.y - simulate(fitted.setup, later, 2).y
    uninformed = without_nuisances(error, later.mask("identification"), later) / later.noise
    assert np.mean(uninformed**2) > 20.0
    # The displacement relative to the zero is known to the noise of the fit; charges only as far as they matter.
    path = simulate(fitted.setup, whole, 2)
    there = path.states[path.nodes[700]]
    y = simulate(fitted.setup, later, 2, initial=initial).y
    assert np.std(y - path.y[700:]) < 0.3 * whole.noise
    assert initial[-1] == pytest.approx(there[-1], abs=0.1 * np.abs(path.states[:, -1]).max())


def test_impossible_parameters_cost_much_and_do_not_raise() -> None:
    fitted = campaigns.base()
    size = Problem(fitted.setup, fitted.plan, fitted.variables).size(np.full_like(fitted.z, 200.0))
    assert size.shape == (fitted.z.size + 1,)
    assert np.isfinite(size).all()
    assert np.linalg.norm(size) > 10.0 * np.linalg.norm(fitted.residual)


NOISE = 3e-8
SETUP = Setup(hrc(2))
T = np.arange(3000) * 1e-4


@pytest.fixture(scope="module")
def whole() -> Recording:
    """Three swings of a sine from rest."""
    return recorded(SETUP, "whole", T, 75.0 * np.sin(2 * np.pi * 10.0 * T), NOISE)


def sliced(whole: Recording, first: int, head: int = 0) -> Recording:
    """What follows a sample, with an unknown start; a head that is not scored, or all for identification."""
    size = whole.t.size - first
    parts = (Part("head", 0, head, "nuisance"), Part("rest", head, size, "confirmation"))
    return replace(
        whole, t=whole.t[:size], u=whole.u[first:], y=whole.y[first:], start=Start("unknown"),
        parts=parts if head else (Part("all", 0, size, "identification"),),
    )  # fmt: skip


def true_state(whole: Recording, first: int) -> np.ndarray:
    run = simulate(SETUP, whole, 4)
    return np.asarray(run.states[run.nodes[run.lead :]][first])


@pytest.mark.parametrize("first", [1100, 1300, 1600, 1850])
def test_the_expected_state_is_near_the_true_one_where_the_input_went_on_as_before(
    whole: Recording, first: int
) -> None:
    run = simulate(SETUP, sliced(whole, first), 4)
    ranges = np.ptp(run.states, axis=0)
    found, true = expected_start(run, ranges), true_state(whole, first)
    assert (np.abs(found.mean - true) < 2.0 * found.spread).all()
    # Nearer than the state of rest, in the states that remember.
    assert np.linalg.norm((found.mean - true) / ranges) < np.linalg.norm((run.states[0] - true) / ranges)
    assert (found.spread > 0.0).all()


def test_a_short_recording_expects_rest(whole: Recording) -> None:
    run = simulate(SETUP, replace(sliced(whole, 0), start=Start("rest", 0.0)).only(slice(0, 60)), 2)
    found = expected_start(run, np.ones(run.states.shape[1]))
    assert np.array_equal(found.mean, run.states[0])


def test_derivatives_of_the_prior_are_those_of_finite_differences(whole: Recording) -> None:
    plan = Plan((sliced(whole, 1300),), {"whole": 2}, 1)
    variables = variables_of(SETUP, plan, ("k", "b"))
    rng = np.random.default_rng(3)
    z = variables.start(SETUP) + 0.1 * rng.standard_normal(variables.start(SETUP).size)
    rows = variables.prior(z)
    assert rows.shape == (4, z.size + 1)
    for i, step in enumerate(1e-6 * np.eye(z.size)):
        slope = (variables.prior(z + step)[:, -1] - variables.prior(z - step)[:, -1]) / 2e-6
        np.testing.assert_allclose(rows[:, i], slope, atol=1e-8)


@pytest.mark.parametrize("first", [200, 1000])
def test_a_slice_is_predicted_as_well_as_the_whole(whole: Recording, first: int) -> None:
    found = evaluate(SETUP, Plan((sliced(whole, first, head=1000),), {"whole": 4}, 1), {})
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


def test_derivatives_that_were_let_go_of_come_back_in_any_process() -> None:
    fitted = campaigns.base()
    before, copied = fitted.jacobian, pickle.loads(pickle.dumps(fitted))
    fitted.slopes.forget()
    assert fitted.jacobian is not before and np.array_equal(fitted.jacobian, before)
    again = copied.on(fitted.plan.recordings)
    again.slopes.forget()
    assert np.array_equal(again.jacobian, before)
