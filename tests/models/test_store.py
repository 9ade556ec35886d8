"""Models on disk, and neural actuators: they start where they are told to, keep their structure, survive the disk."""

from __future__ import annotations

import json
from pathlib import Path

import campaigns
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from phnn.effects import catalogue
from phnn.effects.learned import learned_elements
from phnn.errors import InputRefused, PhnnError, SolverFailed
from phnn.models.actuator import TABLE_1, hrc
from phnn.models.neural import LearnedLaws, neural_hrc, thresholds
from phnn.models.store import FILE, load, save
from phnn.network.elements import Resistor
from phnn.nn import LearnedEnergy, LearnedSystem, Scales
from phnn.nn.learned_system import NeuralODE
from phnn.setup import Setup
from phnn.trajectory import simulate

MEMBERS = {**catalogue(), **learned_elements()}


def with_effect(name: str) -> Setup:
    base = Setup(hrc(2), name="phs")
    if name == "none":
        return base
    entry = MEMBERS[name]
    return entry.add_to(base, entry.grid(campaigns.linearised().scales)[-1])


@pytest.mark.parametrize("name", ["none", *(n for n, e in MEMBERS.items() if e.can_be_added_to(Setup(hrc(2))))])
def test_round_trip(tmp_path: Path, name: str) -> None:
    setup = with_effect(name)
    save(setup, tmp_path / "model", 3)
    again, steps = load(tmp_path / "model")
    assert steps == 3
    assert again.network == setup.network
    assert again.parameters == setup.parameters
    assert (again.amplifier, again.sensor, again.name) == (setup.amplifier, setup.sensor, setup.name)
    recording = campaigns.campaign().recordings[0]
    np.testing.assert_array_equal(simulate(again, recording).y, simulate(setup, recording).y)
    assert {p.name for p in (tmp_path / "model").iterdir()} == {".phnn", FILE}


def written(folder: Path) -> dict[str, object]:
    save(Setup(hrc(1)), folder)
    return json.loads((folder / FILE).read_text())


@pytest.mark.parametrize("key", ["drift_terms", "courses"])
def test_drift_terms_are_read_under_the_name_of_earlier_versions_too(tmp_path: Path, key: str) -> None:
    content = {k: v for k, v in written(tmp_path).items() if k != "drift_terms"}
    (tmp_path / FILE).write_text(json.dumps({**content, key: 8}))
    assert load(tmp_path)[0].own.drift_terms == 8


def test_absent_files_and_other_ones_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputRefused, match=r"absent.*cannot be read.*model/ or base/"):
        load(tmp_path / "absent")
    for content in ("[]", "3", '{"schema": "phnn.model/99"}'):
        (tmp_path / FILE).write_text(content)
        with pytest.raises(InputRefused, match=r"model\.json: .*model/ or base/ of a result of this version"):
            load(tmp_path)


@pytest.mark.parametrize("key", ["storages", "resistors", "couplings", "ports", "parameters", "substeps", "output"])
def test_a_part_that_is_missing_or_of_the_wrong_kind_is_refused(tmp_path: Path, key: str) -> None:
    content = written(tmp_path)
    for damaged in ({k: v for k, v in content.items() if k != key}, {**content, key: None}):
        (tmp_path / FILE).write_text(json.dumps(damaged))
        with pytest.raises(InputRefused, match="damaged"):
            load(tmp_path)


SCALES = Scales(1e-3, 75.0, 1e-4)
fuzzy = settings(max_examples=40, deadline=None)


@pytest.mark.parametrize("law", ["damping", "monotone"])
def test_a_parametric_start_is_the_dead_zone(law: str) -> None:
    network = neural_hrc(2, LearnedLaws(16, law))
    for i, r in enumerate(network.resistors[:2], start=1):
        half = 0.5 * TABLE_1[f"d_{i}"]
        # Where the recordings go: hysteron 1 hardly beyond its threshold, hysteron 2 to about twice its own.
        largest = min(TABLE_1[f"rho_{i}"] * half, 0.05 * 0.12)
        low, high = thresholds(r.law, largest, 3.0 * half)
        assert (low, high) == pytest.approx((-half, half), rel=0.02)
    assert set(network.parameters) == {"m", "k", "b", "alpha", "C_1", "C_2"}


@pytest.mark.slow
@pytest.mark.parametrize("law", ["damping", "monotone"])
def test_without_a_start_thresholds_are_those_of_the_drive(law: str) -> None:
    told = {"rho_1": 1.0, "rho_2": 2.0, "d_1": 3.0, "d_2": 4.0}
    networks = [neural_hrc(2, LearnedLaws(16, law), "none", values) for values in ({}, told)]
    for i in (1, 2):
        scale = 0.5 * TABLE_1["alpha"] * 1.2e-4 / TABLE_1[f"C_{i}"]
        for network in networks:
            resistor = network.resistors[i - 1].law
            largest = 0.9 * float(resistor(torch.tensor(2.0 * scale, dtype=torch.float64)).detach())
            low, high = thresholds(resistor, largest, 2.5 * scale)
            assert (low, high) == pytest.approx((-scale / 1.5 / i, scale / 1.5 / i), rel=0.03)


def test_a_learned_spring_starts_as_the_linear_one() -> None:
    spring = next(s for s in neural_hrc(1, LearnedLaws(8, spring_width=8)).storages if s.name == "q").law
    q = torch.linspace(-1.2e-4, 1.2e-4, 25, dtype=torch.float64)
    np.testing.assert_allclose(spring(q).detach(), TABLE_1["k"] * q, atol=0.01 * TABLE_1["k"] * 1.2e-4)


def test_held_parameters_are_fixed_and_strangers_refused() -> None:
    assert neural_hrc(1, LearnedLaws(4), "none", hold=("m",)).parameters["m"].fixed
    for wrong, words in (
        ({"hold": ("rho_1",)}, "hold: no parameter rho_1"),
        ({"start": "warm"}, "choose parametric or none"),
        ({"hysterons": 0}, "at least one"),
    ):
        with pytest.raises(InputRefused, match=words):
            neural_hrc(**{"laws": LearnedLaws(4), "start": "none", **wrong})  # type: ignore[arg-type]
    with pytest.raises(InputRefused, match="choose damping or monotone"):
        LearnedLaws(law="spline")


@fuzzy
@given(st.integers(2, 6), st.integers(1, 20), st.integers(0, 10**6))
def test_a_learned_energy_is_convex_and_least_at_rest_for_any_weights(states: int, width: int, seed: int) -> None:
    energy, random = LearnedEnergy(states, width=width), torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for weight in energy.parameters():
            weight.add_(torch.randn(weight.shape, generator=random, dtype=torch.float64))
    a, b = 4.0 * torch.randn(2, 7, states, generator=random, dtype=torch.float64)
    gained = energy.energy(b) - energy.energy(a)
    torch.testing.assert_close((energy.mean_efforts(a, b) * (b - a)).sum(-1), gained, rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(energy.mean_efforts(a, b), energy.mean_efforts(b, a))
    assert bool((energy.energy(0.5 * (a + b)) <= 0.5 * (energy.energy(a) + energy.energy(b)) + 1e-12).all())
    x = a.clone().requires_grad_(True)
    (slope,) = torch.autograd.grad(energy.energy(x).sum(), x)
    torch.testing.assert_close(energy(x), slope, rtol=1e-8, atol=1e-8)
    zero = torch.zeros(states, dtype=torch.float64)
    assert torch.equal(energy(zero), zero)
    assert energy.energy(zero) == 0.0
    # Near and far, no state stores less than nothing.
    for size in (1e-9, 1e-3, 1.0, 1e3, 1e6):
        assert bool((energy.energy(size * a) >= 0.0).all())


@pytest.mark.parametrize("kind", ["learned", "neural_ode"])
@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 1e7])
def test_weights_beyond_use_are_named_where_a_black_box_is_evaluated(kind: str, bad: float) -> None:
    core = NeuralODE(SCALES, 3, 5) if kind == "neural_ode" else LearnedSystem(3, 1, 5, SCALES)
    x, u = torch.ones(3, dtype=torch.float64), torch.ones(1, dtype=torch.float64)
    core.vector_field(x, u)
    network = core.field if kind == "neural_ode" else core.laws["multi_port_coupling"].entries
    with torch.no_grad():
        network.weights[0][1, 2] = bad
    with pytest.raises(
        SolverFailed, match=r"parameter (multi_port_coupling.entries|entries|field)\.weights\.0 is not finite"
    ):
        core.vector_field(x, u)


def test_black_box_rests_at_zero_and_reads_a_row() -> None:
    core = NeuralODE(SCALES, 3, 8, seed=2)
    x = torch.zeros(4, 3, dtype=torch.float64)
    still = core.vector_field(x, torch.zeros(4, 1, dtype=torch.float64)).detach()
    torch.testing.assert_close(still, x, rtol=0.0, atol=1e-12 / SCALES.time)
    assert float(core.vector_field(x, torch.ones(4, 1, dtype=torch.float64)).detach().abs().max()) > 0.0
    x = torch.randn(4, 3, dtype=torch.float64)
    torch.testing.assert_close(core.measured(x), SCALES.output * (x @ core.readout))


def test_black_boxes_repeat_from_their_seed_and_refuse_nothing() -> None:
    for made in (lambda n, seed: NeuralODE(SCALES, n, 5, seed), lambda n, seed: LearnedSystem(n, 1, 5, SCALES, seed)):
        first, again, other = made(3, 7), made(3, 7), made(3, 8)
        assert all(torch.equal(a, b) for a, b in zip(first.parameters(), again.parameters(), strict=True))
        assert any(not torch.equal(a, b) for a, b in zip(first.parameters(), other.parameters(), strict=True))
        with pytest.raises(InputRefused, match=r"0 states|states = 0"):
            made(0, 7)
    with pytest.raises(InputRefused, match="scale of the input is 0"):
        Scales(1.0, 0.0, 1.0)


@pytest.mark.parametrize("law", ["damping", "monotone"])
@pytest.mark.parametrize("symmetric", [True, False])
def test_learned_laws_survive_the_disk(tmp_path: Path, law: str, symmetric: bool) -> None:
    network = neural_hrc(2, LearnedLaws(3, law, symmetric, 2), "none", {"d_1": 4.0})
    save(Setup(network, name="neural"), tmp_path, 2)
    again, steps = load(tmp_path)
    assert steps == 2
    recording = campaigns.recorded(
        Setup(hrc(1)), "any", np.linspace(0.0, 0.02, 40), 50.0 * np.sin(np.arange(40.0)), 1e-8
    )
    assert np.array_equal(simulate(again, recording).y, simulate(Setup(network), recording).y)


def test_a_law_without_a_form_on_disk_is_refused(tmp_path: Path) -> None:
    foreign = Resistor("r", torch.nn.Tanh(), {"p": 1.0})
    with pytest.raises(PhnnError, match=r"Tanh as a law has no form on disk.*torch\.save"):
        save(Setup(hrc(0).extend(resistors=(foreign,))), tmp_path)
