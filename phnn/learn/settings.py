"""The settings of a training run; the keys of ``configs/train.yaml``."""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from phnn.configuration import check, number, positive, whole
from phnn.errors import InputRefused
from phnn.intake import load_yaml, named_file
from phnn.results import same

# The key of what is made by a class or function of the user's own, as hydra has it.
TARGET = "_target_"
_MADE = ("optimiser", "scheduler")
# Keys that say where a run lies or how long it may go on, not what it computes: they may differ when it resumes. The
# last two are those of runs of earlier versions.
FREE_TO_CHANGE = (
    "out", "folder", "manifest", "allow_outside", "resume", "tensorboard", "base", "checkpoint_every", "validate_every",
)  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """One training run.

    Attributes:
        folder, out, manifest: recordings, results, and a ``recordings.yaml`` that lies elsewhere.
        allow_outside: read files outside ``folder`` that it names, links or refers to.
        model: ``kind`` and the arguments of that kind, see `phnn.learn.starts`.
        solver: ``name`` (``discrete_gradient`` or ``torchdiffeq``) and its options, see `phnn.learn.solvers`.
        base: folder of a model that `phnn identify` wrote, to start from; it is identified where it is left out.
        seed: of initial weights; seeds: train once with each of several.
        stride: every how many samples are used for training.
        substeps: steps a (used) sample interval; 0: as many as keep the numerical error well below the noise.
        window: samples of a window; 0 for whole recordings.
        continuity: weight of the jumps between windows.
        validation: names of the recordings that stop the training; None chooses among those for identification, an
            empty list trains on all of these.
        adam, lbfgs, gauss_newton: most epochs of each method, in this order; a method of 0 epochs is left out.
        rate: of Adam, falls to a hundredth along a cosine.
        optimiser: what the epochs of ``adam`` take instead: a function of the parameters to a torch optimiser, or a
            mapping with ``_target_``; scheduler: a function of this optimiser, or such a mapping.
        lbfgs_iterations: within one epoch.
        seconds: of the processor, counted anew after a stop, None for no limit; an epoch that has begun is finished.
        patience: epochs without a validation that is better by a thousandth, after which a method ends.
        tensorboard: write a log for it as well.
        resume: go on where an earlier run in ``out`` was stopped.
    """

    folder: str
    out: str
    manifest: str | None = None
    allow_outside: bool = False
    model: Mapping[str, Any] = field(default_factory=lambda: {"kind": "neural_hrc"})
    solver: Mapping[str, Any] = field(default_factory=lambda: {"name": "discrete_gradient"})
    base: str | None = None
    seed: int = whole(0)
    seeds: tuple[int, ...] | None = None
    stride: int = whole(1, least=1)
    substeps: int = whole(0)
    window: int = whole(0)
    continuity: float = positive(1.0)
    validation: tuple[str, ...] | None = None
    adam: int = whole(0)
    lbfgs: int = whole(0)
    gauss_newton: int = whole(60)
    rate: float = positive(0.01)
    optimiser: Any = None
    scheduler: Any = None
    lbfgs_iterations: int = whole(10, least=1)
    seconds: float | None = None
    patience: int = whole(8, least=1)
    tensorboard: bool = True
    resume: bool = True

    def __post_init__(self) -> None:
        check(self)
        for name in ("allow_outside", "tensorboard", "resume"):
            if not isinstance(getattr(self, name), bool):
                raise InputRefused(f"setting {name}={getattr(self, name)} must be true or false")
        if self.seconds is not None:
            number("seconds", self.seconds, 0.0)
        if self.window == 1:
            raise InputRefused("setting window=1: a window has two samples at least; 0 takes whole recordings")
        for name, keys in (("model", ("kind", TARGET)), ("solver", ("name",))):
            if not isinstance(getattr(self, name), Mapping) or not any(k in getattr(self, name) for k in keys):
                raise InputRefused(f"setting {name} must hold {keys[0]}: choose one of the files in configs/{name}")
        for seed in self.seeds or ():
            number("seeds", seed, 0)
        for name in _MADE:
            made = getattr(self, name)
            if not (made is None or callable(made) or (isinstance(made, Mapping) and TARGET in made)):
                raise InputRefused(f"setting {name}={made}: give a function, or {{_target_: module.Class, ...}}")

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> Settings:
        """Read the settings from a composed configuration.

        Raises:
            InputRefused: a key that is unknown or missing, or a value out of range.
        """
        known = {f.name: f for f in fields(cls)}
        for key in config:
            if key not in known:
                raise InputRefused(f"unknown setting {key}: training accepts {', '.join(known)}")
        for name, f in known.items():
            if f.default is MISSING and f.default_factory is MISSING and config.get(name) is None:
                raise InputRefused(f"setting {name} is missing: write {name}=...")
        given = dict(config)
        for name in ("validation", "seeds"):
            if given.get(name) is not None:
                if isinstance(given[name], str) or not isinstance(given[name], Iterable):
                    raise InputRefused(f"setting {name}={given[name]} must be a list: write {name}=[...]")
                given[name] = tuple(given[name])
        return cls(**given)

    def plain(self) -> dict[str, Any]:
        """Return the settings as nested dictionaries and lists."""
        content = asdict(self)
        lists = {n: None if (v := getattr(self, n)) is None else list(v) for n in ("validation", "seeds")}
        made = {n: dict(v) if isinstance(v, Mapping) else _called(v) for n in _MADE for v in (getattr(self, n),)}
        return content | lists | made | {"model": dict(self.model), "solver": dict(self.solver)}

    @property
    def named(self) -> str:
        """Return what is trained, for people."""
        return str(self.model.get("kind") or self.model.get(TARGET, "")).rpartition(".")[2]

    @property
    def home(self) -> Path:
        """Return where the results go."""
        return Path(self.out)


def _called(function: Any) -> str | None:
    """Return the name of a function, the same in every process."""
    return None if function is None else str(getattr(function, "__qualname__", type(function).__qualname__))


def settings_in(path: Path) -> dict[str, Any]:
    """Return what a run's ``config.yaml`` holds, read as plain values.

    Raises:
        InputRefused: the file is damaged.
    """
    content = load_yaml(named_file(path, (path.parent,)))
    if not isinstance(content, dict):
        raise InputRefused(f"{path}: holds no settings: delete the folder, or name another")
    return {str(key): value for key, value in content.items()}


def check_same(before: Mapping[str, Any], now: Mapping[str, Any], where: Path) -> None:
    """Refuse to resume a run with settings that would have made it another one."""
    same(where, before, now, "take the former, another out, or resume=false to begin anew", FREE_TO_CHANGE)


def accepted(target: str) -> set[str]:
    """Return the names of the arguments that a class or function takes.

    Raises:
        InputRefused: there is no such class or function.
    """
    from hydra.utils import get_object

    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    try:
        return set(inspect.signature(get_object(target)).parameters)
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise InputRefused(f"{target}: there is no such class or function ({error}): give module.Class") from error


def instantiate(given: Any) -> Any:
    """Return what a mapping with ``_target_`` makes or returns; modules of the present folder are found.

    Raises:
        InputRefused: there is no such class, or it does not take these arguments.
    """
    from hydra.errors import HydraException
    from hydra.utils import instantiate as made

    accepted(given[TARGET])
    try:
        return made(dict(given))
    except HydraException as error:
        cause = str(error.__cause__ or error).strip().splitlines()[0]
        raise InputRefused(f"{given[TARGET]}: {cause}: give the arguments that it takes") from error
