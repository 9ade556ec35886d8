"""The settings of a training run; the keys of ``configs/train.yaml``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from phnn.configuration import check, positive, whole
from phnn.errors import InputRefused
from phnn.intake.files import named_file
from phnn.intake.yaml_file import load_yaml
from phnn.results import same

# Keys that say where a run lies or how long it may go on, not what it computes: they may differ when it resumes.
FREE_TO_CHANGE = ("out", "folder", "manifest", "allow_outside", "resume", "checkpoint_every", "tensorboard", "base")


@dataclass(frozen=True)
class Settings:
    """One training run.

    Attributes:
        folder, out, manifest: recordings, results, and a ``recordings.yaml`` that lies elsewhere.
        allow_outside: read files outside ``folder`` that it names, links or refers to.
        model: ``kind`` and the arguments of that kind, see `phnn.learn.starts`.
        solver: ``name`` (``discrete_gradient`` or ``torchdiffeq``) and its options, see `phnn.learn.solvers`.
        base: folder of a model that `phnn identify` wrote, to start from; it is identified where it is left out.
        seed: of initial weights.
        stride: every how many samples are used for training.
        substeps: steps a (used) sample interval; 0: as many as keep the numerical error well below the noise.
        window: samples of a window; 0 for whole recordings.
        continuity: weight of the jumps between windows.
        validation: names of the recordings that stop the training; None chooses among those for identification, an
            empty list trains on all of these.
        adam, lbfgs, gauss_newton: most epochs of each method, in this order; a method of 0 epochs is left out.
        rate: of Adam, falls to a hundredth along a cosine.
        lbfgs_iterations: within one epoch.
        patience: epochs without a better validation after which a method ends.
        validate_every, checkpoint_every: epochs.
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
    stride: int = whole(1, least=1)
    substeps: int = whole(0)
    window: int = whole(0)
    continuity: float = positive(1.0)
    validation: tuple[str, ...] | None = None
    adam: int = whole(0)
    lbfgs: int = whole(0)
    gauss_newton: int = whole(60)
    rate: float = positive(0.01)
    lbfgs_iterations: int = whole(10, least=1)
    patience: int = whole(15, least=1)
    validate_every: int = whole(1, least=1)
    checkpoint_every: int = whole(1, least=1)
    tensorboard: bool = True
    resume: bool = True

    def __post_init__(self) -> None:
        check(self)
        if not isinstance(self.allow_outside, bool):
            raise InputRefused(f"setting allow_outside={self.allow_outside} must be true or false")
        if self.window == 1:
            raise InputRefused("setting window=1: a window has two samples at least; 0 takes whole recordings")
        for name, key in (("model", "kind"), ("solver", "name")):
            if not isinstance(getattr(self, name), Mapping) or key not in getattr(self, name):
                raise InputRefused(f"setting {name} must hold {key}: choose one of the files in configs/{name}")

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> Settings:
        """From a composed configuration.

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
        if given.get("validation") is not None:
            given["validation"] = tuple(given["validation"])
        return cls(**given)

    def plain(self) -> dict[str, Any]:
        """As nested dictionaries and lists."""
        content = asdict(self)
        aside = None if self.validation is None else list(self.validation)
        return content | {"validation": aside, "model": dict(self.model), "solver": dict(self.solver)}

    @property
    def home(self) -> Path:
        """Where the results go."""
        return Path(self.out)


def settings_in(path: Path) -> dict[str, Any]:
    """What a run's ``config.yaml`` holds, read as plain values.

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
