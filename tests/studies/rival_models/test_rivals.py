"""Every rival: the contract that all keep, and the truth that each can find."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import torch
from junctions import recording as plain
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete, dlsim

from phnn.errors import InputRefused
from phnn.recordings.recording import Part, Recording, Start
from studies.rival_models.bouc_wen import BoucWen, Loop
from studies.rival_models.continuous import ContinuousFitted, Field
from studies.rival_models.grid import data_on
from studies.rival_models.hysteresis import Duhem, Operator, Plane, Plays
from studies.rival_models.names import NAMES, rival
from studies.rival_models.networks import linear_model
from studies.rival_models.rival import Budget, scales_of

Array = NDArray[np.float64]
DT, NOISE = 1e-3, 1e-3


def recording(name: str, u: Array, y: Array, use: str = "identification", dt: float = DT) -> Recording:
    """A recording from rest at zero, whose output has a zero of its own and a little noise."""
    rng = np.random.default_rng(len(name) + u.size)
    noisy = y + 0.3 + NOISE * rng.standard_normal(u.size)
    return plain(np.arange(u.size) * dt, u, use=use, name=name, y=noisy, interpolation="linear", noise=NOISE)


def sweep(amplitude: float, low: float, high: float, samples: int = 600) -> Array:
    """A sine whose frequency rises, from zero."""
    t = np.arange(samples) * DT
    return np.asarray(amplitude * np.sin(2.0 * np.pi * (low * t + 0.5 * (high - low) / t[-1] * t * t)))


def second_order(f: Array, omega: float = 150.0, zeta: float = 0.3) -> Array:
    """``ÿ + 2ζω ẏ + ω² y = ω² f`` from rest, ``f`` linear between samples."""
    a, b, c, d, _ = cont2discrete(
        (
            np.array([[0.0, 1.0], [-(omega**2), -2.0 * zeta * omega]]), np.array([[0.0], [omega**2]]),
            np.array([[1.0, 0.0]]), np.zeros((1, 1)),
        ),
        DT, method="foh",
    )  # fmt: skip
    return np.asarray(dlsim((a, b, c, d, DT), f)[1][:, 0])


DRIVES = {"slow": (2.0, 2.0, 6.0), "fast": (2.0, 8.0, 20.0), "weak": (0.9, 4.0, 12.0)}


def linear_recordings(samples: int = 600) -> list[Recording]:
    """Return three recordings of a linear system."""
    return [recording(name, u := sweep(*drive, samples), second_order(u)) for name, drive in DRIVES.items()]


@cache
def fitted_briefly(name: str) -> Any:
    """Return a rival after a few updates on short recordings, which is enough for what holds at any time."""
    return rival(name).fit(linear_recordings(300), math.inf, 1, most=FEW)


def slow(*names: str) -> list[Any]:
    """Parameters of which each takes long: they are for the slow suite."""
    return [pytest.param(name, marks=pytest.mark.slow) for name in names]


FEW = 3  # evaluations or updates of each candidate


def run(operator: Operator, u: np.ndarray, shape: np.ndarray | None = None, rates: np.ndarray | None = None) -> Any:
    """Columns of an operator from zero."""
    shape = operator.shape[0] if shape is None else shape
    return operator.run(shape, operator.rest(shape, 0.0)[1], u, np.zeros(u.size) if rates is None else rates)[0]


def error(found: list[np.ndarray], recordings: list[Recording]) -> float:
    """Residual over noise."""
    return float(
        np.sqrt(np.mean([np.mean(((r.y - y) / r.noise) ** 2) for r, y in zip(recordings, found, strict=True)]))
    )


@pytest.mark.parametrize("name", NAMES)
def test_contract(name: str) -> None:
    recordings, fitted = linear_recordings(300), fitted_briefly(name)
    outputs = fitted.outputs(recordings)
    assert [y.shape for y in outputs] == [r.y.shape for r in recordings]
    assert all(np.isfinite(y).all() for y in outputs)
    assert fitted.parameters > 0
    again = rival(name).fit(recordings, math.inf, 1, most=FEW).outputs(recordings)
    # Rounding in linear algebra depends on where arrays lie in storage.
    assert all(np.allclose(a, b, rtol=0.0, atol=1e-9) for a, b in zip(outputs, again, strict=True))
    # Nothing but the input and the start may shape the response: another output moves it by a constant only.
    other = replace(recordings[0], y=np.cos(np.arange(recordings[0].y.size)))
    assert np.ptp(fitted.outputs([other])[0] - outputs[0]) < 1e-9


@pytest.mark.parametrize("name", NAMES)
def test_a_sample_at_a_time_is_the_whole_recording(name: str) -> None:
    fitted = fitted_briefly(name)
    dt = fitted.dt or DT
    u = sweep(1.5, 3.0, 9.0, 200)
    blind = replace(recording("blind", u, np.zeros(u.size), dt=dt), y=np.full(u.size, np.nan))
    whole = fitted.outputs([blind])[0]
    stepper = fitted.stepper(dt)
    state, single = stepper.rest(0.0), []
    for x in u:
        state, y = stepper.step(state, float(x))
        single.append(y)
    assert np.allclose(single, whole, atol=1e-8)
    assert np.allclose(stepper.run(stepper.rest(0.0), u)[1], whole, atol=1e-8)
    if fitted.dt is not None:
        with pytest.raises(InputRefused, match="close the loop"):
            fitted.stepper(2.0 * fitted.dt)


@pytest.mark.parametrize("name", NAMES)
def test_refusals(name: str) -> None:
    first = linear_recordings()[0]
    with pytest.raises(InputRefused, match="one input"):
        rival(name).fit([replace(first, further={"second": first.u})], 1.0, 0)
    with pytest.raises(InputRefused, match="identification"):
        rival(name).fit([replace(first, parts=())], 1.0, 0)
    with pytest.raises(InputRefused, match="budget"):
        rival(name).fit([first], 0.0, 0)


@pytest.mark.parametrize("name", ["narx", *slow("prandtl_ishlinskii", "preisach", "gru", "subnet")])
def test_the_budget_is_kept(name: str) -> None:
    recordings, chosen = linear_recordings(), rival(name)
    chosen.warm()
    began = time.process_time()
    fitted = chosen.fit(recordings, 1.5, 0)
    assert time.process_time() - began < 3.0
    assert fitted.facts["processor_seconds"] < 3.0


def test_hammerstein_recovers_its_own_truth() -> None:
    made = [recording(r.name, r.u, second_order(r.u + 0.2 * r.u**2 - 0.1 * r.u**3)) for r in linear_recordings()]
    held = recording("held", u := sweep(1.7, 3.0, 15.0), second_order(u + 0.2 * u**2 - 0.1 * u**3), "confirmation")
    fitted = rival("hammerstein").fit(made, 3.0, 0)
    assert error(fitted.outputs([*made, held]), [*made, held]) < 1.1


BOUC_WEN = np.array([np.arcsinh(3.0), np.arcsinh(1.0), np.log(1.6)])
HYSTERETIC: dict[str, tuple[Any, Any, Array, float]] = {  # operator, shape, weights, seconds of the fit
    "prandtl_ishlinskii": (Plays(6), None, np.array([0.3, 0.2, 0.0, 0.3, 0.0, 0.0, 0.2, 0.1]), 10.0),
    "preisach": (Plane(4, 6), None, np.linspace(0.5, 0.1, 16), 10.0),
    "dahl": (Duhem(1, 1), None, np.array([1.0, -0.4]), 3.0),
    "bouc_wen_before_1": (BoucWen(1), BOUC_WEN, np.array([1.0, -0.5]), 10.0),
    "bouc_wen_loop_1": (BoucWen(1), np.array([np.log(1.2), np.log(0.3), 0.5, *BOUC_WEN]), np.ones(1), 10.0),
}


@pytest.mark.parametrize("name", ["dahl", *slow(*(n for n in HYSTERETIC if n != "dahl"))])
def test_hysteresis_recovers_its_own_truth(name: str) -> None:
    operator, shape, weights, seconds = HYSTERETIC[name]

    def made(key: str, u: Array, use: str = "identification") -> Recording:
        if "loop" in name:
            law = Loop(operator, 0, scales_of(linear_recordings()))
            return recording(key, u, law.columns(shape, recording(key, u, u))[:, 0], use)
        columns = run(operator, u / 2.0, shape)
        force = columns @ weights[: columns.shape[1]]
        return recording(key, u, second_order(force - force[0]), use)

    known = [made(r.name, r.u) for r in linear_recordings()]
    # The largest input is the scale: the first sweep reaches 2 within a per mille.
    held = made("held", sweep(1.7, 3.0, 15.0), "confirmation")
    fitted = rival(name).fit(known, seconds, 0)
    assert error(fitted.outputs([*known, held]), [*known, held]) < (1.3 if "wen" in name else 1.5)
    linear = rival("hammerstein").fit(known, 2.0, 0)
    assert error(linear.outputs(known), known) > (5.0 if "wen" in name else 10.0)


def difference_equation(u: np.ndarray) -> np.ndarray:
    """``y_k = y_{k−1} + 0.1 (u_k − y_{k−1}) + 0.05 u_k y_{k−1} − 0.2 |Δu_k| y_{k−1}``."""
    y, now, last = np.zeros(u.size), 0.0, 0.0
    for k, x in enumerate(u):
        now = now + 0.1 * (x - now) + 0.05 * x * now - 0.2 * abs(x - last) * now
        y[k], last = now, x
    return y


def test_narx_recovers_a_difference_equation() -> None:
    rng = np.random.default_rng(3)
    inputs = [np.concatenate([[0.0], rng.uniform(-1.0, 1.0, 500)]) for _ in range(4)]
    made = [recording(f"r{k}", u, difference_equation(u)) for k, u in enumerate(inputs[:3])]
    held = recording("held", inputs[3], difference_equation(inputs[3]), "confirmation")
    fitted = rival("narx").fit(made, 5.0, 0)
    assert fitted.dt == pytest.approx(DT)
    assert error(fitted.outputs([*made, held]), [*made, held]) < 1.2


@pytest.mark.parametrize("name", ["gru", *slow("subnet")])
def test_networks_learn_a_linear_system(name: str) -> None:
    recordings = linear_recordings()
    untrained = rival(name).fit(recordings, math.inf, 0, most=1)
    trained = rival(name).fit(recordings, math.inf, 0, most=25)
    before, after = (error(f.outputs(recordings), recordings) for f in (untrained, trained))
    assert after < 0.5 * before
    other = rival(name).fit(recordings, math.inf, 7, most=1)
    assert not np.allclose(other.outputs(recordings)[0], untrained.outputs(recordings)[0])


@pytest.mark.parametrize("name", ["narx", *slow("hammerstein", "gru", "subnet")])
def test_an_unknown_start_is_estimated(name: str) -> None:
    """The recording begins in motion: what came before is cut off."""
    made = []
    for key, drive in DRIVES.items():
        u = sweep(*drive)
        whole = recording(key, u, second_order(u))
        cut = replace(whole.only(slice(100, 600)), t=whole.t[:500], start=Start("unknown"))
        made.append(replace(cut, parts=(replace(whole.parts[0], last=500),)))
    budget = {"gru": 12.0, "subnet": 12.0}.get(name, 3.0)
    outputs = rival(name).fit(made, budget, 0).outputs(made)
    least = {"hammerstein": 1.1, "narx": 3.0, "gru": 40.0, "subnet": 40.0}[name]
    for r, y in zip(made, outputs, strict=True):
        assert np.sqrt(np.mean(((r.y - y)[30:] / r.noise) ** 2)) < least


@pytest.mark.parametrize("name", ["narx", "gru", "subnet"])
def test_held_out_samples_do_not_begin_a_simulation(name: str) -> None:
    """A recording that begins unknown, held out after its first 20 samples: what is measured later changes nothing."""
    u = sweep(2.0, 2.0, 20.0)
    made = [recording("r", u, second_order(u))]
    fitted = rival(name).fit(made, 2.0, 0, most=3)
    parts = (Part("head", 0, 20, "nuisance"), Part("held", 20, 600, "confirmation"))
    held = replace(made[0], start=Start("unknown"), parts=parts)
    other = replace(held, y=np.where(np.arange(600) < 20, held.y, 0.0))
    first, second = fitted.outputs([held, other])
    # Output splines near the last known sample may move the first grid value a little.
    assert np.abs(first - second).max() < 0.05


CONTINUOUS = {"trained_ode": 0, "oe_phnn": 1, "sphnn": 2}


def untrained(name: str) -> tuple[ContinuousFitted, Any]:
    """A network of three states in continuous time before its training, weights moved at random, and its data."""
    recordings = linear_recordings()
    data = data_on(recordings, 16.0)
    torch.manual_seed(2)
    net = Field(CONTINUOUS[name], 4, 3, linear_model(recordings, data, Budget(math.inf, 40)))
    return ContinuousFitted(0, {}, data.dt, data.scales, data.zero, net), data


@pytest.mark.parametrize("name", ["oe_phnn", "sphnn"])
def test_learned_port_hamiltonian_networks_have_their_structure(name: str) -> None:
    net = untrained(name)[0].net
    with torch.no_grad():
        for p in net.parameters():
            p.add_(torch.randn_like(p))
        x = 3.0 * torch.randn(500, net.states, dtype=torch.float64)
        e, rest = net.gradient(x), torch.zeros(1, net.states, dtype=torch.float64)
        lost = (e * net.field(x, torch.zeros(500, 1, dtype=torch.float64))).sum(-1)
        assert float(lost.max()) <= 1e-9 * float(lost.abs().max())
        if name == "sphnn":
            assert float(net.gradient(rest).abs().max()) < 1e-12
            other = x[torch.randperm(500)]
            assert float(((net.gradient(other) - e) * (other - x)).sum(-1).min()) >= 0.0  # convex


@pytest.mark.slow
@pytest.mark.parametrize("name", CONTINUOUS)
def test_networks_in_continuous_time_learn_a_nonlinear_oscillator(name: str) -> None:
    """``q̈ + 2ζω q̇ + ω² (q + q³/8) = ω² u``, a port-Hamiltonian system."""

    def made(key: str, u: Array, use: str = "identification") -> Recording:
        t = np.arange(u.size) * DT

        def rate(at: float, x: Array) -> list[float]:
            return [x[1], 150.0**2 * (np.interp(at, t, u) - x[0] - x[0] ** 3 / 8.0) - 90.0 * x[1]]

        path = solve_ivp(rate, (0.0, t[-1]), [0.0, 0.0], t_eval=t, max_step=DT, rtol=1e-8)
        return recording(key, u, path.y[0], use)

    known = [made(key, sweep(*drive)) for key, drive in DRIVES.items()]
    held = made("held", sweep(1.5, 3.0, 15.0), "confirmation")
    linear = error(rival("hammerstein").fit(known, 3.0, 0, most=20).outputs([held]), [held])
    assert error(rival(name).fit(known, 20.0, 0).outputs([held]), [held]) < min(5.0, 0.2 * linear)
