"""Recordings of a model with some effects, and models in which some effects are fitted together."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import campaigns

from phnn.diagnose.criteria import Criteria
from phnn.diagnose.number import Visited
from phnn.diagnose.refit import converged, rebuilt
from phnn.diagnose.search import Search, begin
from phnn.effects import effect
from phnn.identification.fit import Fit
from phnn.identification.plan import Plan
from phnn.identification.staged import fit_identified
from phnn.recordings import Campaign

VALUES = {
    "amplifier_lowpass": {"tau_a": 1.5e-5},
    "sensor_lag": {"tau_y": 1.5e-5},
    "creep": {"k_s": 4e3, "tau_s": 5e-3},
    "quadratic_drag": {"c_2": 10.0},
    "extra_hysteron": {"C_x": 3e-7, "rho_x": 0.3, "d_x": 5.0},
}
ALL = tuple(campaigns.STEPS)


@cache
def lacking(*names: str, recordings: Sequence[str] = ALL, substeps: int | None = None) -> Fit:
    """The base model fitted to recordings of one that has these effects too."""
    base = campaigns.base()
    true = base.setup
    for name in names:
        true = effect(name).add_to(true, VALUES[name])
    some = [r for r in base.plan.recordings if r.name in recordings]
    made = tuple(campaigns.recorded(true, r.name, r.t, r.u, r.noise, k) for k, r in enumerate(some))
    steps = {n: substeps or campaigns.STEPS[n] for n in recordings}
    return fit_identified(base.setup, Plan(made, steps, 1), {"m": "held at the stated value"})


def together(base: Fit, *names: str, others: Sequence[str] = ()) -> tuple[Search, Visited]:
    """A search that knows a base model and a model with some effects, carried to its end.

    Args:
        others: names of further effects that it knows of.
    """
    campaign = Campaign(base.plan.recordings, {}, {}, "command", (), True, "made up")
    elements = [effect(n) for n in names]
    search = begin(campaign, base, [*elements, *(effect(n) for n in others)], [], Criteria())
    values = base.setup.values() | {n: v for name in names for n, v in VALUES[name].items()}
    begun = rebuilt(base, elements, values, base.plan, 12)
    assert begun is not None
    own = [n for e in elements for n in e.parameters]
    whole = converged(begun, base.plan, base.held, own)
    assert whole is not None
    return search, search.visit(search.model(elements, whole, done=True))
