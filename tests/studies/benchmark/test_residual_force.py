"""The residual force: the table of terms, and SINDy on it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lsim
from scipy.stats import multivariate_normal

from phnn.effects import catalogue
from phnn.errors import InputRefused, SolverFailed
from phnn.models.actuator import hrc
from phnn.recordings.recording import unrecorded
from phnn.setup import Setup
from phnn.simulate import simulate
from studies import rivals
from studies.benchmark.residual_force import signals
from studies.benchmark.residual_force.evidence import whitening_filter
from studies.benchmark.residual_force.latent import Features, best_of
from studies.benchmark.residual_force.matching import named, shares
from studies.benchmark.residual_force.plant import Plant, plant_of
from studies.benchmark.residual_force.prediction import Forced, predicted, with_force
from studies.benchmark.residual_force.states import responses, states_of
from studies.benchmark.residual_force.terms import Sizes, effects_of, table_of
from studies.benchmark.tools import tool
from studies.generator import generate
from studies.generator.effects import LISTED

DT = 1e-4
T = DT * np.arange(4000)
PLANT = Plant(1e-3, 3.0, 3e4)
SIZES = Sizes(2e-5, 0.01, 75.0, 5e4, 1.0, 100.0, 1.0, DT, 5e-8)
SETUP = Setup(hrc(2))
SINE = unrecorded("sine", T, 60.0 * np.sin(2.0 * np.pi * 20.0 * T))


def _force() -> np.ndarray:
    return 0.05 * np.sin(2.0 * np.pi * 30.0 * T) + 0.02 * np.sin(2.0 * np.pi * 170.0 * T) * np.sin(
        2.0 * np.pi * 3.0 * T
    )


def _moved(force: np.ndarray) -> np.ndarray:
    """Of a linear oscillator, by scipy."""
    system = ([1.0], [PLANT.mass, PLANT.damping, PLANT.stiffness])
    return np.asarray(lsim(system, force, T)[1])


def test_the_plant_of_a_model_without_hysterons_is_the_model() -> None:
    network = hrc(0)
    values = {n: p.value for n, p in network.parameters.items()}
    found = plant_of(simulate(Setup(network), SINE, 2))
    assert found.stiffness == pytest.approx(values["k"], rel=0.01)
    assert found.damping == pytest.approx(values["b"], rel=0.03)


def test_responses_are_those_of_a_simulation_with_a_small_force() -> None:
    trajectory = simulate(SETUP, SINE, 2)
    force = 1e-4 * np.sin(2.0 * np.pi * 35.0 * T)
    exact = simulate(SETUP, with_force(SINE, force), 2).y - trajectory.y
    assert np.std(responses(trajectory, force[:, None])[:, 0] - exact) < 0.03 * np.std(exact)


def test_the_table_has_terms_for_what_cases_conceal_and_no_other_names() -> None:
    table = table_of(SIZES)
    assert set(effects_of(table)) <= set(catalogue())
    # Lines have columns of their own.
    assert set(LISTED) - set(effects_of(table)) == {"mains_pickup", "base_motion"}
    assert len({t.name for t in table}) == len(table)
    states = states_of(simulate(SETUP, SINE, 1))
    for term in table:
        action = term.action(states)
        parts = [x for x in (action.force, action.current, action.output) if x is not None]
        assert parts, term.name
        assert all(x.shape[0] == T.size and np.isfinite(x).all() for x in parts), term.name


def test_models_without_a_mass_are_refused() -> None:
    trajectory = simulate(SETUP, SINE, 1)
    renamed = replace(trajectory.program, states=("a", "b", "c", "d"))
    with pytest.raises(InputRefused, match="needs a mass, spring and damper"):
        states_of(replace(trajectory, program=renamed))


def test_operators_on_samples() -> None:
    step = np.append(np.zeros(1000), np.ones(3000))
    late = signals.relaxed(step, DT, 0.05)
    assert late[1500] == pytest.approx(1.0 - np.exp(-0.05 / 0.05), abs=0.01)
    slow = signals.resonant(np.sin(2.0 * np.pi * 5.0 * T), DT, 500.0, 0.1)
    assert np.abs(slow - np.sin(2.0 * np.pi * 5.0 * T)).max() < 0.02
    assert np.ptp(signals.played(np.sin(2.0 * np.pi * 5.0 * T), 0.25)) == pytest.approx(1.5, abs=1e-3)
    assert np.abs(np.diff(signals.slewed(step, 0.01))).max() <= 0.01 + 1e-12
    held = signals.held_charge(np.ones(100), np.zeros(100), DT, 1e-6, 1.0)
    assert held[-1] == pytest.approx(-100 * DT / 1e-6)


def test_whitening_makes_first_order_noise_white() -> None:
    lags = 0.8 ** np.arange(5)
    assert whitening_filter(lags) == pytest.approx(np.array([1.0, -0.8, 0.0, 0.0, 0.0]) / 0.6)


def test_a_force_that_grows_with_the_motion_is_no_prediction() -> None:
    model = Forced(SETUP, SETUP, lambda s: (3e5 * s.q, np.zeros(s.q.size)), 3, 2)
    with pytest.raises(SolverFailed, match=r"grow by one another|no solution"):
        predicted(model, SINE, 2)


def test_a_missing_package_is_told() -> None:
    with pytest.raises(InputRefused, match=r"pip install 'phnn\[rivals\]'"):
        rivals.needed("no_such_package_at_all")


def case(folder: Path, effect: str, seed: int = 3) -> Path:
    """A concealed effect in four recordings, one of which is the examination's input too."""
    generate(seed, folder, effect, "short")
    exam = folder / "exam"
    exam.mkdir()
    (exam / "sine_100Hz_75V.csv").write_text((folder / "sine_100Hz_75V.csv").read_text())
    (exam / "recordings.yaml").write_text("setup: {model: piezo_actuator, hysterons: 2}\n")
    return folder


def test_shares_are_found_forward_and_grids_count_once() -> None:
    rng = np.random.default_rng(0)
    columns = np.linalg.qr(rng.normal(size=(200, 4)))[0]
    wanted = 3.0 * columns[:, 0] + 2.0 * columns[:, 1] + 1.0 * columns[:, 2]
    found = shares(columns, wanted, ("creep", "creep", "delay", ""), 14.0)
    assert found == pytest.approx({"creep": 13.0 / 14.0})
    assert named(found) == (frozenset({"creep"}), pytest.approx(13.0 / 14.0 / 0.75))
    assert named({}) == (frozenset(), 0.0)


def test_a_process_recovers_a_force_and_prefers_none_in_noise() -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(size=(500, 20))
    truth = 0.1 * rng.normal(size=20)
    features = Features("motion", np.zeros(2), np.ones(2), np.zeros((20, 2)), np.eye(20), 1.0)
    y = x @ truth + rng.normal(size=500)
    found = best_of(features, x, x, y, 1.0)
    exact = np.linalg.solve(x.T @ x + np.eye(20) / found.variance, x.T @ y)
    assert found.mean == pytest.approx(exact)
    # The definition of the marginal likelihood: y ~ N(0, I + s² x xᵀ).
    ratio = [multivariate_normal(np.zeros(500), np.eye(500) + v * x @ x.T).logpdf(y) for v in (found.variance, 0.0)]
    assert found.evidence == pytest.approx(ratio[0] - ratio[1], rel=1e-6)
    assert found.evidence > 8.0
    assert np.corrcoef(found.mean, truth)[0, 1] > 0.85
    assert best_of(features, x, x, rng.normal(size=500), 1.0).evidence < 8.0


@pytest.mark.slow
def test_sindy_finds_a_concealed_cubic_spring_and_leaves_a_null_alone(tmp_path: Path) -> None:
    pytest.importorskip("pysindy")
    found = tool("sindy")(case(tmp_path / "cubic", "cubic_stiffness"), 0)
    assert "cubic_stiffness" in found.claims
    assert "mechanical" in found.places
    assert found.predictions["sine_100Hz_75V"].size == 2500
    nothing = tool("sindy")(case(tmp_path / "none", "none"), 0)
    assert nothing.claims == {"none"}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "package"), [("gp_force", "sklearn"), ("symbolic", "gplearn")])
def test_other_tools_tell_a_spring_from_nothing(name: str, package: str, tmp_path: Path) -> None:
    pytest.importorskip(package)
    found = tool(name)(case(tmp_path / "cubic", "cubic_stiffness"), 0)
    assert "none" not in found.claims
    assert "cubic_stiffness" in found.names
    nothing = tool(name)(case(tmp_path / "none", "none"), 0)
    assert nothing.claims == {"none"}
