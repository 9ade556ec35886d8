"""APHYNITY as a tool: the batched actuator, and a field that is small where nothing is missing."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
import torch

from phnn.errors import SolverFailed
from phnn.models.actuator import TABLE_1, hrc
from phnn.recordings.recording import unrecorded
from phnn.setup import Setup
from phnn.simulate import simulate
from phnn.studies.benchmark.tools.aphynity import _begun, _data, _simulated, _states, learn
from phnn.studies.benchmark.tools.augmented import Augmented
from phnn.studies.benchmark.tools.common import base_of

T = np.arange(1001) * 1e-4
SINE = unrecorded("sine_100Hz", T, 60.0 * np.sin(2.0 * np.pi * 100.0 * T))


def test_without_a_field_it_is_the_base_model() -> None:
    """Its own integration agrees with phnn's to a fraction of a per cent, and the rest is corrected exactly."""
    setup = Setup(hrc(2))
    model = _begun(setup, [SINE], 4, 0)
    data = _data(setup, [SINE], 4, model)
    y = simulate(setup, SINE, 4).y
    q = _states(model, data)[0, :, 0].numpy()
    assert np.std(q - y) < 5e-3 * np.std(y)
    assert _simulated(model, data)[0] == pytest.approx(y, abs=1e-15)


def test_the_linear_part_is_exact() -> None:
    """Under a force that is linear in time, a mass on a spring and a damper moves as scipy integrates it."""
    from scipy.integrate import solve_ivp

    values = {n: TABLE_1[n] for n in ("m", "k", "b", "alpha")}
    model = Augmented(values, torch.ones(3).double(), torch.ones(2).double(), 0)
    u = torch.tensor([[0.0, 10.0, -5.0]]).double()
    h = 5e-4
    with torch.no_grad():
        states, _ = model.run(torch.zeros(1, 2).double(), u, torch.tensor([h]).double())

    def rate(t: float, x: np.ndarray) -> list[float]:
        force = values["alpha"] * np.interp(t, [0.0, h, 2 * h], u[0].numpy())
        return [x[1], (force - values["k"] * x[0] - values["b"] * x[1]) / values["m"]]

    found = solve_ivp(rate, (0.0, 2 * h), [0.0, 0.0], rtol=1e-11, atol=1e-16, max_step=h / 20)
    assert states[0, -1].numpy() == pytest.approx(found.y[:, -1], rel=1e-6)


def test_derivatives_go_through_the_solution_of_each_step() -> None:
    model = _begun(Setup(hrc(2)), [SINE], 1, 0)
    u = torch.tensor(SINE.u[None, :40])

    def end() -> torch.Tensor:
        return model.run(torch.zeros(1, 4).double(), u, torch.tensor([1e-4]).double())[0][0, -1, 0]

    end().backward()
    slope, step = model.base.grad[0].item(), 1e-5  # type: ignore[index]
    values = []
    for sign in (1.0, -1.0):
        with torch.no_grad():
            model.base[0] += sign * step
            values.append(end().item())
            model.base[0] -= sign * step
    assert slope == pytest.approx((values[0] - values[1]) / (2.0 * step), rel=1e-5)


def test_another_model_is_refused() -> None:
    with pytest.raises(SolverFailed, match="has no parameter alpha"):
        Augmented({"m": 1.0, "k": 1.0, "b": 1.0}, torch.ones(3), torch.ones(2), 0)


@pytest.mark.slow
def test_where_nothing_is_missing_the_field_stays_small(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for frequency, amplitude in ((20.0, 75.0), (80.0, 60.0)):
        t = np.arange(1201) * 1e-4
        u = amplitude * np.sin(2.0 * np.pi * frequency * t)
        y = 1e6 * (simulate(Setup(hrc(1)), unrecorded("x", t, u), 4).y + 5e-8 * rng.normal(size=t.size))
        with (tmp_path / f"sine_{frequency:03.0f}Hz.csv").open("w", newline="") as file:
            table = csv.writer(file)
            table.writerow(["time_s", "voltage_V", "displacement_um"])
            table.writerows(zip(t, u, y, strict=True))
    manifest = "setup: {model: piezo_actuator, hysterons: 1}\nknown: {m: {value: 1.0148e-3, std: 1.0e-5}}\n"
    (tmp_path / "recordings.yaml").write_text(manifest)
    found = learn(base_of(tmp_path, 0), 0, 1, 5)
    assert not found.useful
    assert found.norm < 0.02
