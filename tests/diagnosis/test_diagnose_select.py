"""What a selection compares, and where it begins when it takes an effect away."""

from __future__ import annotations

from dataclasses import replace
from unittest import mock

import campaigns
import numpy as np
import pytest

from phnn.criteria import CRITERIA
from phnn.diagnosis import retest, select
from phnn.diagnosis.finding import Finding
from phnn.diagnosis.judge import judge
from phnn.diagnosis.name import Candidate
from phnn.diagnosis.scored import scored
from phnn.diagnosis.search import Search
from phnn.diagnosis.trial import Trial
from phnn.effects import effect
from phnn.identification.fit import Fit, fit
from phnn.units import FORCE_UNITS

VALUES = {"amplifier_lowpass": {"tau_a": 1e-5}, "sensor_lag": {"tau_y": 1e-5}, "creep": {"k_s": 4e3, "tau_s": 5e-3}}


def trial(name: str, above: float) -> Trial:
    """A refit of an effect that leaves so much more than the noise, as a sum of squares."""
    base = campaigns.base()
    left = base.residual * np.sqrt((base.residual.size + above) / base.cost)
    setup = effect(name).add_to(base.setup, VALUES[name])
    return Trial(Candidate(effect(name), VALUES[name], (), 10.0, 1e-3), replace(base, setup=setup, residual=left))


def test_refits_that_end_close_together_are_compared_without_numerical_error() -> None:
    best, near, far = trial("amplifier_lowpass", 0.0), trial("sensor_lag", 50.0), trial("creep", 500.0)
    asked = []

    def exact(fitted: Fit, keep: list[str], _: object) -> Fit:
        asked.append(keep)
        gain = 50.0 if "tau_y" in keep else 0.0
        return replace(fitted, residual=fitted.residual * np.sqrt((fitted.cost - gain) / fitted.cost))

    with mock.patch.object(select, "_exact", exact):
        compared = select._compared([best, near, far], ["k_s"], CRITERIA.selection)
        assert [keep[0] for keep in asked] == ["k_s", "k_s"]
        assert compared[2] is far
        assert next(t.cost for t in compared if t.candidate is near.candidate) == pytest.approx(best.cost)
        assert select._compared([best, far], [], CRITERIA.selection) == [best, far]
    assert len(asked) == 2


def test_where_nothing_was_tried_there_is_nothing_to_compare() -> None:
    assert select._compared([], ["k_s"], CRITERIA.selection) == []
    failed = replace(trial("creep", 0.0), fit=None)
    assert select._compared([failed], [], CRITERIA.selection) == [failed]


def test_a_mismatch_without_a_catalogue_is_unknown() -> None:
    found = scored(campaigns.linearised("creep").fit, (), 0)
    assert found.significant
    judgement = judge(found, Search((), max_effects=2, new_in_held_out=True))
    assert judgement.verdict == "unknown"
    assert judgement.findings == () and judgement.tried == ()


def test_what_is_dropped_leaves_the_model_at_its_own_values_too() -> None:
    base = campaigns.base()
    grown = effect("creep").add_to(base.setup, VALUES["creep"])
    # The model has followed the creep: far from where it fits without.
    followed = replace(base, setup=grown.with_values({"k": 2.0 * base.setup.values()["k"]}))
    dropped = Finding(trial("creep", 0.0), (), (), mock.sentinel.naming)
    begun = []

    def fitted(_: Fit, others: tuple[Finding, ...], values: dict[str, float]) -> Fit:
        begun.append(values["k"])
        return replace(base, residual=(9.0 if len(begun) == 1 else 1.0) * base.residual)

    with mock.patch.object(retest, "fit_with", fitted):
        alone = retest.without(base, (), dropped, followed)
    assert begun == [2.0 * base.setup.values()["k"], base.setup.values()["k"]]
    assert alone is not None and alone.cost == base.cost


def test_a_model_without_one_of_its_effects_is_fitted_once_and_kept_with_the_effect() -> None:
    base = campaigns.base()
    findings = tuple(Finding(trial(n, 0.0), (), (), mock.sentinel.naming) for n in ("creep", "sensor_lag"))
    worse = {n: replace(base, residual=3.0 * base.residual) for n in ("creep", "sensor_lag")}
    asked = []

    def without(_: Fit, __: object, dropped: Finding, *___: object) -> Fit:
        asked.append(dropped.effect.name)
        return worse[asked[-1]]

    no_better = trial("creep", 10.0 * base.cost)
    with mock.patch.multiple(retest, without=without, _refitted=lambda *_: [no_better]):
        kept, fitted = retest.retested(base, mock.MagicMock(), findings, base, mock.sentinel.executor)
        assert fitted is base and asked == ["creep", "sensor_lag"]
        assert [f.others_alone for f in kept] == [worse["creep"], worse["sensor_lag"]]
        # The first effect is refitted and ends lower; or another effect takes its place, and what was fitted without
        # the first one is no longer of use.
        for name, known in (("creep", worse["creep"]), ("amplifier_lowpass", None)):
            better = Trial(trial(name, 0.0).candidate, replace(base, residual=0.5 * base.residual))
            with mock.patch.object(retest, "_refitted", return_value=[better]):
                kept, fitted = retest.retested(base, mock.MagicMock(), findings, base, mock.sentinel.executor)
            assert fitted is better.fit
            assert [f.others_alone for f in kept] == [known, worse["sensor_lag"]]


@pytest.mark.parametrize(("left", "share", "stands"), [(1.03, 0.1, True), (9.0, 0.1, False)])
def test_what_leaves_no_more_than_the_noise_level_is_known_to_stands(left: float, share: float, stands: bool) -> None:
    remaining = mock.Mock(scores={"hysteron": 1.0})
    remaining.name = "hysteron"
    model = mock.Mock(remaining=remaining)
    model.linearised.fit.chi2 = left
    finding = Finding(trial("creep", 0.0), (), (), mock.sentinel.naming)
    last = select.Selected((finding,), model, share)
    first = select.Selected((), mock.Mock(remaining=None), 1.0)
    assert select._kept([first, last]) is stands


def test_a_base_model_at_a_local_optimum_is_told_from_one_that_lacks_physics() -> None:
    """Swapped and narrowed dead zones stop a descent far above the noise; an element that vanishes led out of it."""
    good = campaigns.base()
    wrong = good.setup.with_values({n: 0.05 * good.setup.values()[n] for n in ("d_1", "d_2")})
    stopped = fit(wrong, good.plan, good.variables.names, good.held, max_evaluations=2)
    assert stopped.chi2 > 2.0
    vanishing = replace(good, setup=effect("creep").add_to(good.setup, {"k_s": 1e-4, "tau_s": 1e-5}))
    found = retest.better_base(stopped, vanishing)
    assert found is not None and found.chi2 == pytest.approx(good.chi2, rel=1e-2)
    assert set(found.setup.parameters) == set(good.setup.parameters)

    lacking = campaigns.base("quadratic_drag")
    real = campaigns.diagnosis("quadratic_drag", "quadratic_drag").judgement.final
    assert retest.better_base(lacking, real) is None
    assert retest.better_base(good, good) is None


def test_a_heavy_mass_that_moves_with_the_first_leaves_the_forces_of_one_mass() -> None:
    """All forces and charges 2000-fold, and a second mass that takes the first along: the same motion."""
    good, factor = campaigns.base("quadratic_drag"), 2000.0
    true = effect("quadratic_drag").add_to(good.setup, {"c_2": 10.0})
    m = good.setup.values()["m"]
    large = {n: p.value * factor for n, p in true.parameters.items() if p.unit in FORCE_UNITS and n != "m"}
    mode = {"m_2": (factor - 1.0) * m, "k_2": 1e7, "b_2": 1e7}
    heavy = effect("second_mode").add_to(true.with_values(large), mode)
    (values,) = retest.at_the_mass_of(good.setup, heavy)
    found = {n: values[n] for n in true.parameters if n != "m"}
    assert found == pytest.approx({n: true.values()[n] for n in found}, rel=1e-9)
    assert retest.at_the_mass_of(good.setup, true) == ()
