"""APHYNITY as a tool: the base model and a learned field that is as small as it can be.

After Yin, Le Guen, Dona, de Bézenac, Ayed, Thome & Gallinari (2021, ICLR; J. Stat. Mech. 2021, 124012): of all pairs
``F = F_p(θ) + F_a`` that fit the trajectories, the one with the least ``‖F_a‖`` is sought by

    min ‖F_a‖² + λ (L − 1)     with     λ ← λ + τ₂ (L − 1)

in turn, ``L`` the mean square of the error over the noise; without noise the authors have ``L`` alone. The field is a
network of all states and the input (`augmented`), the base parameters are trained beside it. The authors observe all
states; here only the displacement is: windows begin at states of a simulation of the whole recordings, which is
renewed in rounds, and their first samples, in which the mass forgets its start, do not count.

The method names nothing. What it says is that something is missing, where the field predicts windows that were not
trained; that counts as not listed. Its place is read from the rate that most of the field's power enters, by `PLACES`,
and a force that follows the voltage more closely than the motion is put at the coupling.

Settings were chosen on cases of a benchmark of seed 903 that was written for that purpose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from phnn.errors import SolverFailed
from phnn.identification.identified import Identified
from phnn.recordings import read
from phnn.recordings.recording import Recording
from phnn.setup import Setup
from phnn.simulate import simulate
from phnn.studies.benchmark.answer import Answer
from phnn.studies.benchmark.tools.augmented import Augmented
from phnn.studies.benchmark.tools.common import base_of, predictions
from phnn.studies.benchmark.tools.regimes import whole

Array = NDArray[np.float64]

# Samples of a window and of its start that do not count; one window in this many is held out.
WINDOW, FORGOTTEN, HELD = 120, 20, 4
# Windows of a batch; rounds, in each of which states are renewed; iterations of a round.
_BATCH, _ROUNDS, _ITERATIONS = 64, 6, 25
# Rates of learning of the field, of the base parameters, and of λ (τ₂), and its first value.
_FIELD, _BASE, _MULTIPLIER, _FIRST = 5e-3, 5e-4, 1.0, 1.0
# Size of the field's force where its output is one, in that of the base model, and of its other rates beside it: they
# add up over windows, so that they are learned cautiously.
_UNIT, _FREE = 0.05, 0.03
# Weight of the mean error of a window.
_SHIFT = 0.1
# Share of the error of the base model that the field has to predict on held-out windows.
_WORTH = 0.1
_NONE, _FOUND = 0.85, 0.8
# Places of the rates of q, v and charges.
PLACES = ("sensor", "mechanical", "hysteron")


@dataclass(frozen=True)
class Data:
    """Recordings of one length, padded.

    Attributes:
        u: (R, N) input; h: (R,) sampling interval; target: (R, N) displacement without zero and error of integration;
            weight: (R, N) one over the noise, zero where padded; start: (R, 2 + H) first states.
        offset: (R, N) what phnn's simulation of the base model has beside that of `Augmented`.
        lengths: of the recordings.
    """

    u: Tensor
    h: Tensor
    target: Tensor
    weight: Tensor
    start: Tensor
    offset: Tensor
    lengths: tuple[int, ...]


@dataclass(frozen=True)
class Learned:
    """A trained model; ``base``, ``left``: mean squares on held-out windows before and after; ``norm``: ``‖F_a‖``."""

    model: Augmented
    base: float
    left: float
    norm: float
    places: tuple[str, ...]

    @property
    def useful(self) -> bool:
        """Whether the field predicts what it was not trained on."""
        return self.left < (1.0 - _WORTH) * self.base


def answer(folder: Path, seed: int) -> Answer:
    """Train the field, and say whether it is needed."""
    base = base_of(folder, seed)
    learned = learn(base, seed)
    predicted = dict(predictions(base.model, folder))
    if not learned.useful:
        return Answer({}, none=_NONE, places=learned.places, predictions=predicted)
    exam = read(folder / "exam", need_output=False).recordings
    found = _simulated(learned.model, _data(base.fit.setup, exam, base.fit.plan.finest, learned.model))
    for recording, q in zip(exam, found, strict=True):
        if np.isfinite(q).all():
            predicted[recording.name] = q
    return Answer({}, 1.0 - _FOUND, _FOUND, learned.places, predicted)


def learn(base: Identified, seed: int, rounds: int = _ROUNDS, iterations: int = _ITERATIONS) -> Learned:
    """Train base model and field on the recordings of a base model.

    Raises:
        SolverFailed: the base model is no actuator with a voltage in and a displacement out, or no window fits in.
    """
    setup, recordings = base.fit.setup, whole(base.fit.plan).recordings
    model = _begun(setup, recordings, base.fit.plan.finest, seed)
    data = _data(setup, recordings, base.fit.plan.finest, model)
    windows = [(r, s) for r, n in enumerate(data.lengths) for s in range(0, n - WINDOW, WINDOW)]
    held = np.array([i % HELD == HELD - 1 for i in range(len(windows))])
    if not held.any():
        raise SolverFailed(f"aphynity: recordings of at least {HELD * WINDOW + 1} samples are needed in all")
    places = torch.tensor(windows)
    first, best = _on(model, data, places[held]), None
    rng, multiplier = np.random.default_rng(seed), _FIRST
    groups = [
        {"params": list(model.field.parameters()), "lr": _FIELD},
        {"params": [model.base, model.hysteretic], "lr": _BASE},
    ]
    optimiser = torch.optim.Adam(groups)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, rounds * iterations, eta_min=1e-5)
    for _ in range(rounds):
        states = _states(model, data)
        if not torch.isfinite(states).all():
            break
        for _ in range(iterations):
            chosen = places[~held][rng.permutation(int((~held).sum()))[:_BATCH]]
            multiplier += _MULTIPLIER * _iterate(model, data, states, chosen, multiplier, optimiser)
            schedule.step()
        left = _on(model, data, places[held])
        if np.isfinite(left) and (best is None or left < best[0]):
            best = left, {name: value.clone() for name, value in model.state_dict().items()}
    if best is not None:
        model.load_state_dict(best[1])
    powers, order = _read(model, data)
    return Learned(model, first, best[0] if best else np.inf, float(np.sqrt(powers)), order)


def _iterate(
    model: Augmented, data: Data, states: Tensor, chosen: Tensor, multiplier: float, optimiser: torch.optim.Optimizer
) -> float:  # fmt: skip
    """One step of Adam; returns by how much the mean square exceeds that of the noise."""
    rows = chosen[:, 1:] + torch.arange(WINDOW + 1)
    which = chosen[:, :1]
    found, field = model.run(states[chosen[:, 0], chosen[:, 1]], data.u[which, rows], data.h[chosen[:, 0]])
    error = (found[:, :, 0] - data.target[which, rows]) * data.weight[which, rows]
    # The hysterons of a window begin where those of an imperfect model are: what that shifts counts little.
    kept = error[:, FORGOTTEN:]
    mean = kept.mean(1, keepdim=True)
    excess = ((kept - mean) ** 2).mean() + _SHIFT * (mean**2).mean() - 1.0
    loss = multiplier * excess.clamp(min=0.0) + (field**2).sum(-1).mean()
    optimiser.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    torch.nn.utils.clip_grad_norm_(model.parameters(), multiplier)
    optimiser.step()
    return max(float(excess.detach()), 0.0)


def _begun(setup: Setup, recordings: Sequence[Recording], substeps: int, seed: int) -> Augmented:
    """The base model with a field that is zero, in units of what the recordings show."""
    found = [_trajectory(setup, r, substeps)[0] for r in recordings]
    sizes = np.max([np.abs(x).max(axis=0) for x in found], axis=0)
    values = setup.values()
    volts = max(float(np.abs(r.u).max()) for r in recordings)
    force = values.get("k", 1.0) * sizes[0] / values.get("m", 1.0)
    current = values.get("alpha", 1.0) * sizes[1]
    rates = np.array([_FREE * sizes[1], force, *[_FREE * current] * (sizes.size - 2)])
    return Augmented(values, torch.tensor([*sizes, volts]), torch.tensor(_UNIT * rates), seed)


def _trajectory(setup: Setup, recording: Recording, substeps: int) -> tuple[Array, Array]:
    """(N, 2 + H) displacement, velocity and charges at the samples, and (N,) the output.

    Raises:
        SolverFailed: the model has other states.
    """
    found = simulate(setup, recording, substeps)
    names, states = found.setup.network.state_names, found.states[found.nodes[found.lead :]]
    charges = [n for n in names if n.startswith("Q_")]
    if {"q", "p", *charges} != set(names) or setup.amplifier or setup.sensor:
        raise SolverFailed(
            f"aphynity: an actuator with the states q, p and Q_i is needed, this one has {', '.join(names)}"
        )
    of = {n: states[:, i] for i, n in enumerate(names)}
    return np.column_stack([of["q"], of["p"] / setup.values()["m"], *(of[c] for c in charges)]), found.y


def _data(setup: Setup, recordings: Sequence[Recording], substeps: int, model: Augmented) -> Data:
    lengths = tuple(r.t.size for r in recordings)
    pairs = [_trajectory(setup, r, substeps) for r in recordings]

    def padded(rows: Sequence[Array], mode: str) -> Tensor:
        width = max(lengths)
        if mode == "edge":
            return torch.tensor(np.array([np.pad(x, (0, width - x.size), mode="edge") for x in rows]))
        return torch.tensor(np.array([np.pad(x, (0, width - x.size)) for x in rows]))

    u, h = padded([r.u for r in recordings], "edge"), torch.tensor([r.dt for r in recordings])
    start = torch.tensor(np.array([x[0] for x, _ in pairs]))
    with torch.no_grad():
        q, _ = model.run(start, u, h, with_field=False)
    offset = padded([y for _, y in pairs], "edge") - q[:, :, 0]
    error = [np.nan_to_num(r.y - y) for r, (_, y) in zip(recordings, pairs, strict=True)]
    seen = padded([y + e - e.mean() for e, (_, y) in zip(error, pairs, strict=True)], "edge")
    noise = [np.full(r.t.size, 1.0 / r.noise if r.noise > 0.0 else 0.0) for r in recordings]
    return Data(u, h, seen - offset, padded(noise, "zero"), start, offset, lengths)


def _states(model: Augmented, data: Data) -> Tensor:
    with torch.no_grad():
        found, _ = model.run(data.start, data.u, data.h)
    return found


def _simulated(model: Augmented, data: Data) -> list[Array]:
    """(N,) predicted displacement of every recording."""
    q = (_states(model, data)[:, :, 0] + data.offset).numpy()
    return [np.asarray(row[:n]) for row, n in zip(q, data.lengths, strict=True)]


def _on(model: Augmented, data: Data, windows: Tensor) -> float:
    """Mean square in some windows of a simulation of the whole recordings, each without its mean."""
    error = (_states(model, data)[:, :, 0] - data.target) * data.weight
    used = data.weight > 0.0
    zero = (error * used).sum(1, keepdim=True) / used.sum(1, keepdim=True).clamp(min=1)
    rows = windows[:, 1:] + torch.arange(WINDOW)
    return float(((error - zero)[windows[:, :1], rows] ** 2).mean())


def _read(model: Augmented, data: Data) -> tuple[float, tuple[str, ...]]:
    """Mean square of the field along the recordings, and places by what its rates and their arguments are."""
    with torch.no_grad():
        states, field = model.run(data.start, data.u, data.h)
    used = (data.weight[:, :-1] > 0.0).numpy()
    f, q, u = field.numpy()[used], states[:, :-1, 0].numpy()[used], data.u[:, :-1].numpy()[used]
    v = states[:, :-1, 1].numpy()[used]
    powers = np.array([float(np.var(f[:, 0])), float(np.var(f[:, 1])), float(np.var(f[:, 2:], axis=0).sum())])
    order = [PLACES[i] for i in np.argsort(-powers)]
    force = f[:, 1]
    if _explains(force, [u, u**2]) > _explains(force, [q, v, q**2, q**3]):
        order = ["coupling" if place == "mechanical" else place for place in order]
    return float((f**2).sum(axis=1).mean()), tuple(order)


def _explains(y: Array, columns: Sequence[Array]) -> float:
    """Share of the variance of a signal that columns explain."""
    design = np.column_stack([np.ones_like(y), *(c / max(float(np.abs(c).max()), 1e-300) for c in columns)])
    left = y - design @ np.linalg.lstsq(design, y)[0]
    return 1.0 - float(np.var(left)) / max(float(np.var(y)), 1e-300)
