"""The training loop: methods one after the other, each until it stops to help on recordings it does not see.

The best parameters by validation are what a run ends with, and what each method begins with. A step that fails or
leads to what is not finite is taken back and the rate of learning halved. The state of a run is on disk whole or not at
all, so that it goes on as if it had never been stopped.
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

import pandas as pd
import torch
from torch import Tensor

from phnn.errors import InputRefused, SolverFailed
from phnn.intake import LIMITS, named_file
from phnn.laws.diverged import is_finite
from phnn.learn.methods import METHODS, Method, method_of
from phnn.learn.objective import Objective
from phnn.learn.settings import Settings, check_same
from phnn.report.formatting import short
from phnn.results import Place

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
    """Return what writes ``tensorboard/``, of which points after these epochs are void; None where it is not
    installed."""
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
