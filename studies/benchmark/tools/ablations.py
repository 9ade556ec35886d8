"""`phnn diagnose` without one of its parts, to see what the part is worth.

Another base model without ports is no part that could be taken away: effects and learned elements are attached at
ports. Tools that add a force without any port to the same base model are rivals of their own.
"""

from __future__ import annotations

from pathlib import Path

from phnn.diagnosis.diagnosis import available, input_measured
from phnn.diagnosis.scored import scored
from phnn.effects import Effect
from phnn.errors import PhnnError
from phnn.identification.fit import Fit
from phnn.identification.identified import Identified
from phnn.identification.options import Options
from phnn.model import Model
from studies.benchmark.answer import Answer
from studies.benchmark.tools.common import base_of, fitted_with, predictions
from studies.benchmark.tools.diagnosis import diagnosed

# Held-out recordings take out nothing but what makes their error clearly larger.
_NO_VETO = {
    **dict.fromkeys(("material", "material_share", "named_gain", "untested_fall"), 1e-9),
    "held_out_level": 0.999,
}
# Every candidate of the catalogue is refitted until it converges.
_NO_RACE = {
    **dict.fromkeys(("enter_large", "enter_second", "enter_last"), 1000),
    **dict.fromkeys(("least_saving", "least_score", "explained_left"), 1e-9),
    **dict.fromkeys(("near_moving", "near_at_rest", "incomparable_left"), 1e9),
}
# Probability of the name with the highest score, and that nothing is missing where no score is significant.
_NAME, _NONE = 0.6, 0.95


def without_veto(folder: Path, seed: int) -> Answer:
    """Names and models stand whatever held-out recordings say, unless they become clearly worse."""
    return diagnosed(folder, Options(seed=seed, workers=1, criteria=_NO_VETO))


def without_racing(folder: Path, seed: int) -> Answer:
    """No candidate is dropped before its refit has converged."""
    return diagnosed(folder, Options(seed=seed, workers=1, criteria=_NO_RACE))


def without_learned(folder: Path, seed: int) -> Answer:
    """What no name explains is added by no learned element."""
    return diagnosed(folder, Options(seed=seed, workers=1), learned=())


def scores_only(folder: Path, seed: int) -> Answer:
    """The name with the highest score of the catalogue on the base model, refitted once; no local functions."""
    base = base_of(folder, seed)
    effects = available(base.campaign, base.fit.setup)
    found = scored(base.fit, effects, seed, terminals=input_measured(base.campaign, base.fit.setup))
    if not found.significant or not found.naming.candidates:
        return Answer({}, none=_NONE, predictions=predictions(base.model, folder))
    best = found.naming.candidates[0]
    refitted = _refitted(base, best.effect, best.values)
    model = Model(refitted.setup, refitted.plan.finest)
    return Answer(
        {best.effect.canonical: _NAME}, places=(best.effect.location,), predictions=predictions(model, folder)
    )


def _refitted(base: Identified, effect: Effect, values: dict[str, float]) -> Fit:
    """The base model with an effect, refitted; the base model where that cannot be simulated."""
    try:
        return fitted_with(base.fit, effect, values)
    except PhnnError:
        return base.fit
