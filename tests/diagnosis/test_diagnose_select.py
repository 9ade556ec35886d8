"""What a selection compares, and where it begins when it takes an effect away."""

from __future__ import annotations

from dataclasses import replace

import campaigns
import pytest
from effects_together import VALUES, lacking, together

from phnn.criteria import CRITERIA
from phnn.diagnose.linearised import tie
from phnn.diagnosis import retest
from phnn.diagnosis.finding import Finding
from phnn.diagnosis.judge import judge
from phnn.diagnosis.scored import scored
from phnn.diagnosis.search import Search
from phnn.diagnosis.select import select
from phnn.effects import effect
from phnn.identification.fit import Fit, fit
from phnn.identification.options import Options
from phnn.identification.refinement import numerical_error
from phnn.parallel import SERIAL
from phnn.units import FORCE_UNITS


def retested(base: Fit, findings: tuple[Finding, ...], whole: Fit) -> tuple[dict[str, Finding], Fit]:
    """The findings that are kept, by name, and the fit with them."""
    location = scored(base, (), 0).remaining
    assert location is not None
    kept, fitted = retest.retested(base, location, findings, whole, SERIAL)
    return {f.effect.name: f for f in kept}, fitted


def test_refits_that_end_close_together_are_compared_without_numerical_error() -> None:
    base = lacking("sensor_lag", recordings=("sine_100Hz_75V", "step_75V"), substeps=1)
    bound = Options.error_bound_sigma
    assert numerical_error(base).sigma > 2.0 * bound
    search = Search([effect("amplifier_lowpass"), effect("sensor_lag")], max_effects=1)
    _, tried = select(search.scored(base), search)
    fits = [t.fit for t in tried if t.fit is not None]
    assert len(fits) == 2
    assert abs(fits[0].cost - fits[1].cost) < CRITERIA.selection.compared_within * tie(fits[0])
    assert max(numerical_error(f).sigma for f in fits) <= bound


def test_an_effect_that_the_others_do_not_need_is_dropped() -> None:
    base = lacking("quadratic_drag")
    findings, whole = together(base, "creep", "quadratic_drag")
    kept, fitted = retested(base, findings, whole)
    assert list(kept) == ["quadratic_drag"]
    assert "k_s" not in fitted.setup.parameters
    assert fitted.cost < whole.cost + tie(whole)


def test_effects_that_are_needed_are_kept_each_with_the_model_without_it() -> None:
    base = lacking("quadratic_drag", "creep")
    findings, whole = together(base, "quadratic_drag", "creep")
    kept, fitted = retested(base, findings, whole)
    assert list(kept) == ["quadratic_drag", "creep"]
    assert fitted.chi2 == pytest.approx(1.0, abs=0.05)
    for name, other in (("quadratic_drag", "k_s"), ("creep", "c_2")):
        alone = kept[name].others_alone
        assert alone is not None and alone.cost > 2.0 * fitted.cost
        assert other in alone.setup.parameters
        assert not set(VALUES[name]) & set(alone.setup.parameters)


def test_a_mismatch_without_a_catalogue_is_unknown() -> None:
    found = scored(campaigns.linearised("creep").fit, (), 0)
    assert found.significant
    judgement = judge(found, Search((), max_effects=2, new_in_held_out=True))
    assert judgement.verdict == "unknown"
    assert judgement.findings == () and judgement.tried == ()


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
