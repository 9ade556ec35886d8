"""The objective of training: residual over noise, and the jumps between windows.

    L = mean_n ((y_n − ŷ_n − zero)/σ)² + c mean_k |(x_k(end) − x_{k+1}(start))/(ν s)|²,     ν = σ/rms(y)

Recording by recording the displacement zero is projected out. Jumps are measured in typical states ``s`` times the
relative noise ``ν``, so that with ``c = 1`` a jump weighs as much as the residual it would make. With whole recordings
as windows only the first term is there (single shooting); the loss is 1 at the noise floor.

A trained plant is scored on every part of every recording, each run from its own start to its end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor, nn

from phnn.errors import SolverFailed
from phnn.identification.evaluate import Evaluation, scored, with_zero
from phnn.integrate.rest import equilibrium
from phnn.integrate.scheme import can_compile
from phnn.learn.solvers import NetworkPlant, Plant, Solver, grouped, near, starts_at_zero, windows_of
from phnn.nn.learned_system import LearnedSystem
from phnn.recordings.recording import Part, Recording

_HEAD_SHARE, _HEAD_LEAST = 0.02, 50
_SETTLING = 20


class Objective(nn.Module):
    """The loss of a plant on recordings, and the initial states that are estimated with it.

    Args:
        plant: what is trained.
        solver: of the windows.
        recordings: thinned as they are to be used.
        length: samples of a window, 0 for whole recordings.
        substeps: a sample interval.
        continuity: weight ``c``.

    Attributes:
        windows: of all recordings, in order.
        origin: (W, n) initial states to which the scaled ``offsets`` (K, n) of the ``unknown`` windows are added.
        solved: how often the windows were simulated.
    """

    solved = 0

    def __init__(
        self,
        plant: Plant,
        solver: Solver,
        recordings: Sequence[Recording],
        length: int = 0,
        substeps: int = 1,
        continuity: float = 1.0,
    ) -> None:
        super().__init__()
        self.plant, self.solver, self.recordings, self.continuity = plant, solver, tuple(recordings), continuity
        self.windows = windows_of(recordings, length, substeps)
        self.unknown = [k for k, w in enumerate(self.windows) if not w.known]
        self.masks = [torch.from_numpy(r.mask("identification")) for r in recordings]
        self.measured = [torch.from_numpy(np.ascontiguousarray(r.y)) for r in recordings]
        self.origin = self._first_guess(substeps)
        self.offsets = nn.Parameter(torch.zeros(len(self.unknown), plant.scale.numel(), dtype=torch.float64))

    @torch.no_grad()
    def _first_guess(self, substeps: int) -> Tensor:
        """Return (W, n) initial states: where recordings begin, and on the untrained model's way where windows do."""
        starts = torch.stack([begin(self.plant, r) for r in self.recordings])
        if not any(w.continues for w in self.windows):
            return starts
        try:
            paths = self.solver(self.plant, windows_of(self.recordings, 0, substeps), starts)
        except SolverFailed:
            # Windows are for models that cannot run over a whole recording yet.
            paths = [starts[k].expand(r.t.size, -1) for k, r in enumerate(self.recordings)]
        return torch.stack([paths[w.recording][w.first] for w in self.windows])

    def trained(self) -> list[nn.Parameter]:
        """Return what an optimiser moves: coordinates and weights of the plant, then initial states."""
        return [*self.plant.trained(), self.offsets] if self.unknown else self.plant.trained()

    def present(self) -> list[Tensor]:
        """Return copies of what an optimiser moves."""
        return [p.detach().clone() for p in self.trained()]

    @torch.no_grad()
    def move_to(self, values: Sequence[Tensor]) -> None:
        """Set what an optimiser moves."""
        for parameter, value in zip(self.trained(), values, strict=True):
            parameter.copy_(value)

    def initial(self) -> Tensor:
        """Return (W, n) initial states of the windows."""
        if not self.unknown:
            return self.origin
        return self.origin.index_add(0, torch.tensor(self.unknown), self.offsets * self.plant.scale)

    def outputs(self) -> list[Tensor]:
        """Return (N,) displacement of every recording, without its zero."""
        return self._joined(self.solver(self.plant, self.windows, self.initial()))

    def _joined(self, states: Sequence[Tensor]) -> list[Tensor]:
        pieces: list[list[Tensor]] = [[] for _ in self.recordings]
        for w, x in zip(self.windows, states, strict=True):
            y = self.plant.measured(x)
            # A shared sample is the end of the earlier window.
            pieces[w.recording].append(y[1:] if w.continues else y)
        return [torch.cat(p) for p in pieces]

    def residuals(self, outputs: Sequence[Tensor]) -> Tensor:
        """Return (N,) scored residuals over noise, each recording's mean taken out."""
        residuals = []
        for r, mask, y, model in zip(self.recordings, self.masks, self.measured, outputs, strict=True):
            error = (y - model)[mask]
            residuals.append((error - error.mean()) / r.noise)
        return torch.cat(residuals)

    def forward(self) -> Tensor:
        """Return () the loss.

        Raises:
            SolverFailed: a window could not be solved.
        """
        self.solved += 1
        x0 = self.initial()
        states = self.solver(self.plant, self.windows, x0)
        loss = self.residuals(self._joined(states)).square().mean()
        jumps = [
            (states[k - 1][-1] - x0[k]) / (self.plant.scale * float(r.noise / np.std(r.y)))
            for k, (w, r) in enumerate((w, self.recordings[w.recording]) for w in self.windows)
            if w.continues
        ]
        return loss + self.continuity * torch.stack(jumps).square().mean() if jumps else loss


def begin(plant: Plant, recording: Recording) -> Tensor:
    """Return (n,) state that a recording begins in or near: the rest state under the input before it."""
    zero = torch.zeros_like(plant.scale)
    if starts_at_zero(recording) or not isinstance(plant, NetworkPlant) or not can_compile(plant.system.network):
        return zero
    network = plant.network
    u = np.zeros(len(network.ports))
    u[0] = recording.input_before
    return torch.from_numpy(equilibrium(network, u))


def estimated_start(plant: Plant, solver: Solver, recording: Recording, substeps: int) -> Tensor:
    """Return (n,) initial state of a recording that begins away from zero, from its first samples, plant held.

    The samples are those of its nuisance part or, where it has none, the first 2 % and 50 at least.
    """
    used = np.flatnonzero(recording.mask("nuisance"))
    last = int(used[-1]) + 1 if used.size else max(_HEAD_LEAST, int(_HEAD_SHARE * recording.t.size))
    rows = slice(0, min(last, recording.t.size))
    head = replace(recording.only(rows), parts=(Part("head", 0, rows.stop, "identification"),))
    objective = Objective(plant, solver, (head,), 0, substeps)
    optimiser = torch.optim.LBFGS([objective.offsets], max_iter=_SETTLING, line_search_fn="strong_wolfe")

    def misfit() -> Tensor:
        optimiser.zero_grad()
        loss = objective()
        objective.offsets.grad = torch.autograd.grad(loss, objective.offsets)[0]
        return loss.detach()

    optimiser.step(misfit)
    return objective.initial()[0].detach()


def whole(
    plant: Plant, solver: Solver, recordings: Sequence[Recording], substeps: int, initial: Mapping[str, Tensor]
) -> Objective:
    """Return the objective on whole recordings, initial states given, known, or estimated from the first samples."""
    objective = Objective(plant, solver, recordings, 0, substeps)
    for k, r in enumerate(recordings):
        if not starts_at_zero(r):
            objective.origin[k] = initial[r.name] if r.name in initial else estimated_start(plant, solver, r, substeps)
    return objective


def evaluate(
    plant: Plant, solver: Solver, recordings: Sequence[Recording], substeps: int, initial: Mapping[str, Tensor]
) -> Evaluation:
    """Simulate all recordings and score their parts, as `phnn.identification.evaluate` does.

    Args:
        initial: (n,) initial states estimated in training, by recording name.
    """
    objective = whole(plant, solver, recordings, substeps, initial)
    with torch.no_grad():
        outputs = objective.outputs()
    return scored(recordings, {r.name: with_zero(r, y.numpy()) for r, y in zip(recordings, outputs, strict=True)})


# Most sub-steps, and the share of the noise below which the numerical error of an output has to be.
_MOST, _ERROR = 16, 0.1
# Samples of a piece.
_PIECE = 128


@torch.no_grad()
def substeps_needed(plant: Plant, solver: Solver, recordings: Sequence[Recording]) -> int:
    """Find how many sub-steps keep the error of every recording's output below a tenth of its noise.

    Halving a step of second order takes three quarters of its error. Where nothing but weights is in a model, its steps
    are part of what is learned: it takes one. Of laws without a kernel short pieces are integrated: the steepest of
    every recording, and its first.
    """
    if not isinstance(plant, NetworkPlant) or isinstance(plant.system, LearnedSystem):
        return 1
    length = 0 if can_compile(plant.system.network) else _PIECE
    windows, chosen = windows_of(recordings, length, 1), list[int]()
    for group in grouped([w.recording for w in windows]):
        rates = [float(((windows[k].fine[:, 2] - windows[k].fine[:, 0]) / windows[k].h).abs().amax()) for k in group]
        chosen += sorted({group[0], group[int(np.argmax(rates))]})

    def outputs(substeps: int) -> list[tuple[float, Tensor]]:
        finer = windows_of(recordings, length, substeps)
        pieces = [finer[k] for k in chosen]
        begun = [None if w.known else near(plant, [w]) for w in pieces]
        starts = [begin(plant, recordings[w.recording]) for w in pieces]
        x0 = torch.stack([x if b is None else b[0, 0] for x, b in zip(starts, begun, strict=True)])
        states = solver(plant, pieces, x0)
        return [(recordings[w.recording].noise, plant.measured(x)) for w, x in zip(pieces, states, strict=True)]

    count, before = 1, outputs(1)
    while count < _MOST:
        after = outputs(2 * count)
        pairs = [(noise, a - b) for (noise, a), (_, b) in zip(before, after, strict=True)]
        if all(4.0 / 3.0 * float((d - d.mean()).square().mean().sqrt()) <= _ERROR * noise for noise, d in pairs):
            break
        count, before = 2 * count, after
    return count
