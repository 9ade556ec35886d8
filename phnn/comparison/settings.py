"""The settings of a comparison; the keys of ``configs/compare.yaml``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from phnn.configuration import check, positive, whole
from phnn.errors import InputRefused
from phnn.identification.options import Options
from studies.rival_models.names import NAMES as RIVALS

# Networks whose time step the identified model tells.
NETWORKS = ("phs_neural", "phs_adjoint", "phs_neural_adjoint")
TRAINED = (*NETWORKS, "neural_phs", "neural_ode")
# These begin without an identified model.
BLACK_BOXES = ("neural_phs", "neural_ode")
# In the order in which they are fitted and shown: phs_neural begins from phs.
MODELS = ("phs", *NETWORKS, "neural_phs", "bouc_wen", "linear", "neural_ode", *RIVALS)


@dataclass(frozen=True)
class Recipe:
    """How a neural model is trained.

    Attributes:
        model: its kind and arguments, see `phnn.learn.starts`.
        solver: its name and options, see `phnn.learn.solvers`.
        longest_step: recordings are thinned to steps of at most this many time units ``1/(2π f)`` of the highest
            frequency, where they are sampled finer; null for no thinning.
        least_per_period: samples that a period keeps at least.
        stages: settings of `phnn.learn.Settings` by name, one training after the other.
    """

    model: Mapping[str, Any]
    solver: Mapping[str, Any]
    longest_step: float | None
    least_per_period: int
    stages: Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class Settings:
    """One comparison.

    Attributes:
        options: of the identification of parametric models.
        models: which to fit, in the order of `MODELS`.
        inputs: random voltages under which the supplied energy is accounted for, see `phnn.comparison.supply`.
        resume: read finished models of an earlier run back, and go on where a training was stopped.
        recipes: of the neural models, by name.
        budget: processor seconds of each rival of `studies.rival_models`.
    """

    options: Options
    models: tuple[str, ...]
    resume: bool
    recipes: Mapping[str, Recipe]
    inputs: int = whole(1000, least=1)
    budget: float = positive(60.0)

    def __post_init__(self) -> None:
        check(self)

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> Settings:
        """From a composed configuration.

        Raises:
            InputRefused: an unknown model, or none.
        """
        asked = config["models"]
        names = [asked] if isinstance(asked, str) else list(asked)
        for name in names:
            if name not in (*MODELS, "all"):
                raise InputRefused(f"models: nothing is called {name!r}: choose from {', '.join(MODELS)}, or all")
        chosen = MODELS if "all" in names else tuple(m for m in MODELS if m in names)
        if not chosen:
            raise InputRefused(f"models: none is named: choose from {', '.join(MODELS)}, or all")
        recipes = {name: Recipe(**config[name]) for name in TRAINED}
        return cls(
            Options.from_config(config), chosen, bool(config["resume"]), recipes, config["inputs"], config["budget"]
        )

    def of(self, model: str) -> dict[str, Any]:
        """All that the result of one model depends on besides the recordings, as plain numbers and texts."""
        # Threads share the work and leave the result as it is.
        own: dict[str, Any] = {"seed": self.options.seed, "inputs": self.inputs}
        if model in TRAINED:
            own |= {"recipe": vars(self.recipes[model])}
        if model in RIVALS:
            return own | {"budget": self.budget}
        if model in BLACK_BOXES:
            return own
        return own | {n: getattr(self.options, n) for n in ("starts", "error_bound_sigma")}
