"""Recordings of a model with some effects, and models in which some effects are fitted together."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from unittest import mock

import campaigns

from phnn.diagnosis import retest
from phnn.diagnosis.finding import Finding
from phnn.diagnosis.name import Candidate
from phnn.diagnosis.trial import Trial
from phnn.effects import effect
from phnn.identification.fit import Fit
from phnn.identification.plan import Plan
from phnn.identification.staged import fit_identified

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


def together(base: Fit, *names: str) -> tuple[tuple[Finding, ...], Fit]:
    """Effects as a search finds them, and the base model fitted with all of them."""
    candidates = [Candidate(effect(n), VALUES[n], (), 10.0, 1e-3) for n in names]
    blank = [Finding(Trial(c, None), (), (), mock.sentinel.naming) for c in candidates]
    values = base.setup.values() | {n: v for name in names for n, v in VALUES[name].items()}
    whole = retest.fit_with(base, blank, values)
    assert whole is not None
    trials = [Trial(c, whole) for c in candidates]
    return tuple(Finding(t, (t,), (t,), mock.sentinel.naming) for t in trials), whole
