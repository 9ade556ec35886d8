"""The training loop and its methods: one after the other, each until it stops to help on recordings it does not see.

A method takes one epoch a call and holds its own state. The best parameters by validation are what a run ends with, and
what each method begins with. A step that fails or leads to what is not finite is taken back and the rate of learning
halved. The state of a run is on disk whole or not at all, so that it goes on as if it had never been stopped.
"""

from __future__ import annotations

import io
import math
import os
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray
from torch import Tensor

from phnn.errors import InputRefused, SolverFailed
from phnn.intake import LIMITS, named_file
from phnn.integrate.differentiable import Steps, first_order, march, sensitivities
from phnn.integrate.scheme import can_compile
from phnn.learn.objective import Objective
from phnn.learn.settings import Settings, check_same, instantiate
from phnn.learn.solvers import NetworkPlant, Window, discrete_gradient, grouped, near, remember, together
from phnn.network.bounded import is_finite
from phnn.report.formatting import short
from phnn.results import Place

Array = NDArray[np.float64]

_DAMPING, _EASED, _RAISED, _MOST = 1e-2, 0.3, 4.0, 1e8
# Weights that the recordings do not see at all must not move at all.
_FLOOR = 1e-3


class GaussNewton:
    """One damped step an epoch; what is kept between them is the damping alone.

        (JᵀJ + λ diag JᵀJ) δ = −Jᵀ r,     r = (y − ŷ − zero)/σ

    A Jacobian of a hundred columns costs a few gradients, and some tens of steps replace thousands of a first-order
    method. Compiled code has the derivatives of networks without learned laws; those of others are taken in torch, many
    steps at once. Where a law has no kernel torch takes the steps too, and begins a trial where the derivatives lead.

    Raises:
        InputRefused: the plant is no network, its solver has no sensitivities, or recordings are cut into windows.

    References: Levenberg 1944, Marquardt 1963.
    """

    def __init__(self, objective: Objective) -> None:
        plant = objective.plant
        whole = objective.solver is discrete_gradient and not any(w.continues for w in objective.windows)
        if not isinstance(plant, NetworkPlant) or not whole:
            raise InputRefused(
                "gauss_newton is for networks on whole recordings with solver=discrete_gradient: set gauss_newton=0 "
                "and lbfgs=100, or window=0"
            )
        self.objective, self.plant, self.damping = objective, plant, _DAMPING
        self.steps = Steps(plant.system, compiles=can_compile(plant.system.network))
        # Members, windows, inputs and steps of windows of equal lengths: no step is wasted.
        self.groups: list[tuple[list[int], list[Window], Tensor, Tensor]] = []
        for members in grouped([len(w.h) for w in objective.windows]):
            windows = [objective.windows[k] for k in members]
            u, h = together(plant, windows)
            self.groups.append((members, windows, u, h.unsqueeze(-1)))
        self.states: list[Tensor] = []

    def state_dict(self) -> dict[str, Any]:
        """Return what the next step depends on beside the parameters."""
        return {"damping": self.damping}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a state."""
        self.damping = float(state["damping"])

    def __call__(self, epoch: int) -> float:
        """Take one step; return the loss before it.

        Raises:
            SolverFailed: the present model cannot be simulated.
        """
        residual, jacobian = self.linearised()
        n = residual.size
        cost = float(residual @ residual) / n
        normal, slope = jacobian.T @ jacobian, jacobian.T @ residual
        scale = np.maximum(np.diag(normal), _FLOOR * np.diag(normal).max())
        before = self.objective.present()
        while self.damping < _MOST:
            vector = torch.from_numpy(-np.linalg.solve(normal + self.damping * np.diag(scale), slope))
            pieces = vector.split([p.numel() for p in before])
            step = [v.reshape(p.shape) for v, p in zip(pieces, before, strict=True)]
            if self._cost(before, step) < cost:
                self.damping = max(self.damping * _EASED, 1e-10)
                return cost
            self.damping *= _RAISED
        self.objective.move_to(before)
        self.damping = _DAMPING
        return cost

    @torch.no_grad()
    def _cost(self, before: Sequence[Tensor], step: Sequence[Tensor]) -> float:
        """Return the loss after a step, which is taken; infinite where the model cannot be simulated there."""
        after = [p + s for p, s in zip(before, step, strict=True)]
        try:
            if self.steps.compiles:
                self.objective.move_to(after)
                return float(self.objective())
            x0 = self.objective.initial()
            names = {id(p): name for name, p in self.steps.named_parameters()}
            # Initial states come last in a step.
            moved = {names[id(p)]: s for p, s in zip(self.plant.trained(), step, strict=False)}
            self.objective.move_to(after)
            start = self.objective.initial() - x0
            self.objective.move_to(before)
            given = zip(self.groups, self.states, strict=True)
            guesses = [x + first_order(self.steps, x, u, h, moved, start[m]) for (m, _, u, h), x in given]
            self.objective.move_to(after)
            states = self._solved(guesses, alone=True)
            return float(self.objective.residuals(self._outputs(states)).square().mean())
        except SolverFailed:
            return float("inf")

    @torch.no_grad()
    def _solved(self, guesses: Sequence[Tensor | None], alone: bool = False) -> list[Tensor]:
        """Return (N+1, B, n) states of the windows of every group; those that torch has found are remembered."""
        x0, states = self.objective.initial(), []
        for (members, windows, u, h), guess in zip(self.groups, guesses, strict=True):
            if self.steps.compiles:
                states.append(self.steps.states(x0[members], u, h, 0.0))
            else:
                states.append(march(self.plant.system, x0[members], u, h, near=guess, alone=alone))
                remember(self.plant, windows, states[-1])
        return states

    def _outputs(self, states: Sequence[Tensor]) -> list[Tensor]:
        """Return (S,) output of every window."""
        outputs: list[Tensor] = [states[0]] * len(self.objective.windows)
        for (members, windows, *_), x in zip(self.groups, states, strict=True):
            for b, (k, w) in enumerate(zip(members, windows, strict=True)):
                outputs[k] = self.plant.measured(x[w.nodes, b])
        return outputs

    def linearised(self) -> tuple[Array, Array]:
        """Return (N,) residual over noise and (N, K) its derivatives by all that is trained."""
        o, scale = self.objective, self.plant.scale.numpy()
        o.solved += 1
        self.states = self._solved([None if self.steps.compiles else near(self.plant, w) for _, w, *_ in self.groups])
        trained, row = self.steps.trained.values(), self.plant.system.state_names.index(self.plant.network.output)
        places = dict(zip(map(id, trained), np.cumsum([0, *(p.numel() for p in trained)]), strict=False))
        order = np.concatenate([places[id(p)] + np.arange(p.numel()) for p in self.plant.trained()])
        rows = [np.zeros(0)] * len(o.windows)
        for (members, windows, u, h), x in zip(self.groups, self.states, strict=True):
            try:
                derivatives = sensitivities(self.steps, x, u, h, [w.nodes for w in windows], row)
            except RuntimeError as error:
                raise InputRefused(f"gauss_newton cannot follow a law ({error}): take lbfgs") from error
            for k, w, by in zip(members, windows, map(Tensor.numpy, derivatives), strict=True):
                of_start = np.zeros((len(by), o.offsets.numel()))
                if not w.known:
                    first = o.unknown.index(k) * scale.size
                    of_start[:, first : first + scale.size] = by[:, -scale.size :] * scale
                inside = np.concatenate([by[:, order], of_start], axis=1)[o.masks[w.recording].numpy()]
                rows[k] = -(inside - inside.mean(0)) / o.recordings[w.recording].noise
        return o.residuals(self._outputs(self.states)).detach().numpy(), np.concatenate(rows)


METHODS = ("adam", "lbfgs", "gauss_newton")

_LEAST_RATE = 0.01
_HISTORY = 30
# A trial of a line search that cannot be simulated counts as this many times the loss at its start.
_BAD = 1e3


def method_of(name: str, objective: Objective, settings: Settings, factor: float) -> Method:
    """Return a method by its name; ``factor`` lowers the rate of learning after failures.

    ``adam`` is Adam along a cosine from the full rate to a hundredth of it (Kingma & Ba 2015; Loshchilov & Hutter
    2017), or an optimiser of the user's choice, with a scheduler if there is one; ``lbfgs`` some iterations of L-BFGS
    with a strong Wolfe line search (Liu & Nocedal 1989).
    """
    trained, rate = objective.trained(), settings.rate * factor
    if name == "gauss_newton":
        return GaussNewton(objective)
    if name == "lbfgs":
        most = settings.lbfgs_iterations
        return Stepwise(
            objective, torch.optim.LBFGS(trained, max_iter=most, history_size=_HISTORY, line_search_fn="strong_wolfe")
        )
    if settings.optimiser is None:

        def rate_at(epoch: int) -> float:
            share = 0.5 * (1.0 + math.cos(math.pi * epoch / settings.adam))
            return rate * (_LEAST_RATE + (1.0 - _LEAST_RATE) * share)

        return Stepwise(objective, torch.optim.Adam(trained, lr=rate), rate_at=rate_at)
    optimiser = _made(settings.optimiser, "params", trained)
    for group in optimiser.param_groups:
        group["lr"] = factor * group["lr"]
    scheduler = None if settings.scheduler is None else _made(settings.scheduler, "optimizer", optimiser)
    return Stepwise(objective, optimiser, scheduler)


def with_gradients(objective: Objective) -> Tensor:
    """Return () the loss, gradients left in ``.grad`` of all that is trained.

    Raises:
        SolverFailed: the model could not be simulated, or loss or gradient are not finite.
    """
    objective.zero_grad()
    loss = objective()
    try:
        loss.backward()
    except AssertionError as error:
        raise SolverFailed(f"the way back failed ({error}): the model is stiff, set solver.adjoint=false") from error
    gradients = [p.grad for p in objective.trained() if p.grad is not None]
    if not bool(torch.isfinite(loss)) or not all(bool(torch.isfinite(g).all()) for g in gradients):
        value = float(loss.detach())
        raise SolverFailed(f"the loss is {value:g} or its gradient not finite: lower the rate of learning")
    return loss.detach()


class Stepwise:
    """A torch optimiser, a step an epoch; ``rate_at`` gives its rate of learning by the epoch."""

    def __init__(
        self, objective: Objective, optimiser: Any, scheduler: Any = None, rate_at: Callable[[int], float] | None = None
    ) -> None:
        self.objective, self.optimiser, self.scheduler, self.rate_at = objective, optimiser, scheduler, rate_at

    def __call__(self, epoch: int) -> float:
        """Take one step; return the loss before it."""
        if self.rate_at is not None:
            for group in self.optimiser.param_groups:
                group["lr"] = self.rate_at(epoch)
        first: list[float] = []

        def closure() -> Tensor:
            try:
                loss = with_gradients(self.objective)
            except SolverFailed:
                if not first:
                    raise
                for p in self.objective.trained():
                    p.grad = torch.zeros_like(p)
                return torch.tensor(_BAD * first[0], dtype=torch.float64)
            first.append(float(loss))
            return loss

        self.optimiser.step(closure)
        if self.scheduler is not None:
            self.scheduler.step()
        return first[0]

    def state_dict(self) -> dict[str, Any]:
        """Return the state of optimiser and scheduler."""
        later = None if self.scheduler is None else self.scheduler.state_dict()
        return {"optimiser": self.optimiser.state_dict(), "scheduler": later}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a state."""
        # Earlier versions kept of L-BFGS the state of the optimiser alone.
        self.optimiser.load_state_dict(dict(state.get("optimiser", state)))
        if self.scheduler is not None:
            self.scheduler.load_state_dict(dict(state["scheduler"]))


def _made(given: Any, name: str, argument: Any) -> Any:
    """Return what a function makes of its argument, or a mapping with ``_target_`` of an argument of this name."""
    try:
        return given(argument) if callable(given) else instantiate({**given, "_partial_": True})(**{name: argument})
    except (TypeError, ValueError, KeyError) as error:
        raise InputRefused(f"the {'optimiser' if name == 'params' else 'scheduler'} cannot be made: {error}") from error


# One epoch a call, which returns the loss before it; what the next one depends on beside the parameters is its state.
Method = GaussNewton | Stepwise


# ---- The loop

FILE, LOG = "checkpoint.pt", "log.csv"
COLUMNS = ("epoch", "method", "loss", "validation", "rate", "seconds")
Row = dict[str, Any]

_SCHEMA = "phnn.checkpoint/1"
_MOST_FAILURES = 8
# A validation that is lower by a smaller share does not make a method go on.
_NOTICEABLE = 1e-3


def as_bytes(content: Mapping[str, Any]) -> bytes:
    """Return what ``torch.load(..., weights_only=True)`` reads back."""
    buffer = io.BytesIO()
    torch.save(content, buffer)
    return buffer.getvalue()


def _refused(path: Path, cause: str) -> InputRefused:
    """Return the refusal of a checkpoint."""
    return InputRefused(f"{path}: {cause}: delete it to begin anew")


def load(path: Path) -> dict[str, Any] | None:
    """Return the state that a trainer wrote, with torch's random generator set back to it; None where there is none.

    Raises:
        InputRefused: the file is damaged, too large or no checkpoint.
    """
    if not os.path.lexists(path):
        return None
    source = named_file(path, (path.parent,))
    source.check_size(LIMITS.checkpoint_bytes, "a checkpoint")
    source.check_memory(source.size)
    try:
        with source.open() as file, warnings.catch_warnings():
            # What torch finds odd in a file is refused below.
            warnings.simplefilter("ignore", UserWarning)
            state = torch.load(file, weights_only=True, map_location="cpu")
    except InputRefused:
        raise
    except Exception as error:
        raise _refused(path, f"cannot be read ({type(error).__name__})") from error
    if not isinstance(state, dict) or state.get("schema") != _SCHEMA:
        raise _refused(path, f"is no {_SCHEMA} file")
    if missing := [key for key in ("random", "settings", "progress", "present", "method") if key not in state]:
        raise _refused(path, f"holds no {missing[0]!r}")
    if not isinstance(state["settings"], Mapping):
        raise _refused(path, "holds no settings")
    try:
        torch.set_rng_state(state["random"])
    except (TypeError, RuntimeError) as error:
        raise _refused(path, "its state of the random generator is none") from error
    return state


def board_of(place: Place, epochs: int) -> Any:
    """Return the writer of ``tensorboard/``, whose points after these epochs are void; None if it is not installed."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        return None
    return SummaryWriter(str((place / "tensorboard").own_folder()), purge_step=epochs)


def write_log(place: Place, rows: Sequence[Row], board: Any = None) -> None:
    """Write one row an epoch as csv, and the last one for TensorBoard."""
    (place / LOG).write(pd.DataFrame(rows, columns=COLUMNS).to_csv(index=False).encode())
    for name in ("loss", "validation", "rate") if board is not None else ():
        if rows[-1][name] is not None:
            board.add_scalar(name, rows[-1][name], rows[-1]["epoch"])


@dataclass
class Progress:
    """Where a run stands.

    Attributes:
        phase: index into `METHODS`; epoch: within it.
        factor: of the rate of learning; failures: in a row.
        best: lowest validation so far; since: epochs without a noticeably lower one; parameters: those of the best.
        rows: of the log.
        seconds: of training so far.
    """

    phase: int = 0
    epoch: int = 0
    factor: float = 1.0
    failures: int = 0
    best: float = math.inf
    since: int = 0
    parameters: list[Tensor] = field(default_factory=list)
    rows: list[Row] = field(default_factory=list)
    seconds: float = 0.0


class Trainer:
    """Train an objective.

    Args:
        objective: its parameters are moved.
        validate: the loss on recordings set aside, called without gradients; None stops on the training loss.
        settings: of the run.
        place: gets checkpoint and logs; None for no files.
        say: told one line an epoch.
        recordings: hash of what is trained on; a checkpoint of another is refused.
    """

    def __init__(
        self,
        objective: Objective,
        validate: Callable[[], float] | None,
        settings: Settings,
        place: Place | None,
        say: Callable[[str], None] = lambda line: None,
        recordings: str = "",
    ) -> None:
        self.objective, self.validate, self.settings, self.say = objective, validate, settings, say
        self.place, self.made_of = place, {**settings.plain(), "recordings": recordings}
        self.progress = Progress(parameters=objective.present())
        self.method: Method | None = None
        self.board: Any = None
        self.until = math.inf

    def run(self) -> Progress:
        """Train to the end, from the checkpoint of an earlier run where there is one.

        Raises:
            InputRefused: the checkpoint belongs to other settings.
            SolverFailed: the model cannot be simulated any more, or not from the beginning.
        """
        if self.settings.resume and self.place is not None:
            self._resume(self.place)
        p, self.until = self.progress, time.process_time() + (self.settings.seconds or math.inf)
        if not p.rows:
            # A training that only harms ends where it began.
            p.best = self._value()
        if self.place is not None:
            write_log(self.place, p.rows)
            self.board = board_of(self.place, len(p.rows)) if self.settings.tensorboard else None
        try:
            while p.phase < len(METHODS):
                self._phase()
                self.objective.move_to(p.parameters)
                p.phase, p.epoch, p.since, p.failures = p.phase + 1, 0, 0, 0
                self.method = None
                self._save()
        finally:
            if self.board is not None:
                self.board.close()
        return p

    def _phase(self) -> None:
        name = METHODS[self.progress.phase]
        epochs = int(getattr(self.settings, name))
        if epochs and self.method is None:
            self.method = method_of(name, self.objective, self.settings, self.progress.factor)
        while self.progress.epoch < epochs and self.progress.since < self.settings.patience:
            if time.process_time() > self.until:
                break
            began = time.perf_counter()
            loss = self._attempt(name)
            p, value = self.progress, self._value()
            p.since += 1
            if value < p.best:
                # What nobody would notice is kept, but is no reason to go on.
                p.since = 0 if value < (1.0 - _NOTICEABLE) * p.best else p.since
                p.best, p.parameters = value, self.objective.present()
            p.seconds += time.perf_counter() - began
            row = {
                "epoch": len(p.rows), "method": name, "loss": loss, "validation": value,
                "rate": self.settings.rate * p.factor, "seconds": round(p.seconds, 3),
            }  # fmt: skip
            p.rows.append(row)
            p.epoch += 1
            if self.place is not None:
                write_log(self.place, p.rows, self.board)
            self.say(f"{name} {p.epoch}/{epochs}: loss {loss:.5g}, validation {short(value)}, best {p.best:.5g}")
            self._save()

    def _attempt(self, name: str) -> float:
        """Return one epoch; taken back and tried again more carefully where it fails."""
        p = self.progress
        while True:
            before = self.objective.present()
            try:
                assert self.method is not None
                loss = self.method(p.epoch)
                if not all(bool(torch.isfinite(v).all()) for v in self.objective.trained()):
                    raise SolverFailed("a parameter is not finite")
                p.failures = 0
                return loss
            except SolverFailed as error:
                p.failures += 1
                if p.failures > _MOST_FAILURES:
                    raise SolverFailed(
                        f"training stopped after {p.failures} failed steps in a row, the last one: {error}; lower "
                        "rate, use shorter windows, or begin from a parametric start"
                    ) from error
                # After a failure at the very point reached, only the best one so far is known to be sound.
                self.objective.move_to(p.parameters if p.failures > 1 else before)
                p.factor *= 0.5
                self.method = method_of(name, self.objective, self.settings, p.factor)

    @torch.no_grad()
    def _value(self) -> float:
        """Return the validation at the present parameters."""
        try:
            return self.validate() if self.validate is not None else float(self.objective())
        except SolverFailed:
            return math.inf

    def _save(self) -> None:
        if self.place is None:
            return
        # Tensors, numbers, texts, lists and dictionaries.
        content: dict[str, Any] = {
            "schema": _SCHEMA, "random": torch.get_rng_state(), "settings": self.made_of,
            "progress": vars(self.progress), "present": self.objective.present(),
            "method": None if self.method is None else self.method.state_dict(),
            "near": getattr(self.objective.plant, "near", {}), "solved": self.objective.solved,
        }  # fmt: skip
        (self.place / FILE).write(as_bytes(content))

    def _resume(self, place: Place) -> None:
        path = (place / FILE).path
        state = load(path)
        if state is None:
            return
        check_same(state["settings"], self.made_of, path)
        try:
            self._restore(state)
        except (TypeError, ValueError, KeyError, IndexError, AttributeError, RuntimeError) as error:
            # What a checkpoint of these settings holds has one form; another was written by something else.
            raise _refused(path, f"does not fit the model ({type(error).__name__})") from error

    def _restore(self, state: Mapping[str, Any]) -> None:
        """Raises whatever a state of another form leads to."""
        self.progress = Progress(**state["progress"])
        self.objective.solved = int(state.get("solved", 0))
        present = self.objective.present()
        for values in (state["present"], self.progress.parameters):
            if [v.shape for v in values] != [v.shape for v in present] or not all(map(is_finite, values)):
                raise ValueError("other parameters")
        self.objective.move_to(state["present"])
        if near := state.get("near"):
            self.objective.plant.near = dict(near)  # type: ignore[assignment]
        if state["method"] is not None:
            name = METHODS[self.progress.phase]
            self.method = method_of(name, self.objective, self.settings, self.progress.factor)
            self.method.load_state_dict(state["method"])
