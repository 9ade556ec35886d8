"""Anchors are known to their stated errors only, and so is what is estimated beside them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import campaigns
import numpy as np
import pytest

from phnn.effects import effect
from phnn.errors import InputRefused
from phnn.identification.fit import Fit, fit
from phnn.identification.plan import Plan
from phnn.identification.prepare import identification_plan
from phnn.identification.staged import check_known, held_at
from phnn.models.actuator import hrc
from phnn.recordings.recording import Anchor
from phnn.setup import Setup
from phnn.trajectory import simulate

NOISE = 4e-8
# The truth is what these sub-steps give: fine enough that standard errors hold next to nothing of their error.
STEPS = 16
CREEP = {"k_s": 6e3, "tau_s": 3e-3}
FREE = ("k", "b", "alpha", "k_s", "tau_s")


@cache
def setup() -> Setup:
    """A mass–spring–damper with creep: linear, with stiffnesses that the common factor scales."""
    return effect("creep").add_to(Setup(hrc(0), name="linear"), CREEP)


@cache
def plan() -> Plan:
    """One recording of a chirp that passes the resonance."""
    t = np.arange(600) * 5e-5
    u = 60.0 * np.sin(2.0 * np.pi * (20.0 * t + 0.5 * 6e4 * t**2)) * np.minimum(1.0, t / 2e-3)
    recording = campaigns.recorded(setup(), "chirp", t, u, 0.0)
    true = simulate(setup(), recording, STEPS).y
    return Plan((replace(recording, y=true, noise=NOISE),), {"chirp": STEPS}, 1)


def drawn(rng: np.random.Generator) -> Plan:
    """The plan with fresh noise."""
    (recording,) = plan().recordings
    noisy = recording.y + NOISE * rng.standard_normal(recording.t.size)
    return replace(plan(), recordings=(replace(recording, y=noisy),))


def fitted(here: Plan, anchors: dict[str, Anchor], free: tuple[str, ...] = FREE) -> Fit:
    begun = setup().with_values({n: a.value for n, a in anchors.items()})
    with_errors = replace(here, anchors={n: a.std for n, a in anchors.items()})
    return fit(begun, with_errors, [n for n in free if n not in anchors], held_at(anchors), tolerance=1e-12)


def relative(found: Fit, powers: dict[str, int]) -> float:
    """Relative standard error of a product of powers of parameters."""
    names, covariance = found.joint_covariance()
    values = found.setup.values()
    slopes = np.array([powers.get(n, 0) / values[n] for n in names])
    return float(np.sqrt(slopes @ covariance @ slopes))


@pytest.mark.parametrize("names", [("m",), ("k",), ("alpha",), ("m", "k"), ("k_s", "m", "alpha")])
def test_estimates_follow_an_anchor_as_refits_do(names: tuple[str, ...]) -> None:
    here, values = drawn(np.random.default_rng(2)), setup().values()
    free = ("m", *FREE)
    known = {n: Anchor(values[n], 1e-3 * values[n]) for n in names}
    found = fitted(here, known, free)
    assert found.by_anchors.shape == (len(free) - len(names), len(names))
    for j, name in enumerate(names):
        above, below = (
            fitted(here, known | {name: replace(known[name], value=known[name].value + side * known[name].std)}, free).z
            for side in (1.0, -1.0)
        )
        change = 0.5 * (above - below)
        tolerance = 0.02 * max(np.abs(change).max(), 1e-4)
        np.testing.assert_allclose(found.by_anchors[:, j] * known[name].std, change, atol=tolerance)


def test_a_single_anchor_scales_what_the_common_factor_scales_and_leaves_ratios_alone() -> None:
    here, mass = drawn(np.random.default_rng(3)), setup().values()["m"]
    exact, vague = (fitted(here, {"m": Anchor(mass, share * mass)}) for share in (0.0, 0.05))
    assert "m" not in exact.std()
    assert vague.std()["m"] == pytest.approx(0.05 * mass)
    for name, power in {"k": 1, "b": 1, "alpha": 1, "k_s": 1, "tau_s": 0}.items():
        before, after = relative(exact, {name: 1}), relative(vague, {name: 1})
        assert after == pytest.approx(np.hypot(before, 0.05 * power), rel=1e-3), name
        assert vague.std()[name] == pytest.approx(after * vague.setup.values()[name])
        assert relative(vague, {name: 1, "m": -power}) == pytest.approx(before, rel=1e-3), name
    assert relative(vague, {"k": 1}) > 5.0 * relative(exact, {"k": 1})
    assert relative(vague, {"k_s": 1, "k": -1}) == pytest.approx(relative(exact, {"k_s": 1, "k": -1}), rel=1e-3)


def test_an_anchor_that_is_estimated_or_unknown_to_the_model_adds_nothing() -> None:
    here = drawn(np.random.default_rng(4))
    found = fit(setup(), replace(here, anchors={"k": 1e3, "C_7": 1.0}), FREE)
    assert found.anchors == {}
    np.testing.assert_array_equal(found.covariance, fit(setup(), here, FREE).covariance)
    nothing = fit(setup(), replace(here, anchors={"k": 1e3}), ())
    assert nothing.std() == {"k": 1e3}


@pytest.mark.parametrize("count", [100, pytest.param(500, marks=pytest.mark.slow)])
def test_intervals_cover_the_truth_when_the_anchor_is_drawn_with_its_error(count: int) -> None:
    rng = np.random.default_rng(5)
    true, share = setup().values(), 0.03
    misses = np.empty((count, len(FREE) + 1))
    for i in range(count):
        mass = true["m"] * (1.0 + share * rng.standard_normal())
        found = fitted(drawn(rng), {"m": Anchor(mass, share * mass)})
        values, std = found.setup.values(), found.std()
        misses[i] = [(values[n] - true[n]) / std[n] for n in (*FREE, "m")]
    for size, level in ((1.0, 0.683), (1.96, 0.95)):
        covered = np.mean(np.abs(misses) < size, axis=0)
        # Three standard deviations of a binomial share.
        assert (np.abs(covered - level) < 3.0 * np.sqrt(level * (1.0 - level) / count)).all(), (size, covered)


def test_what_a_manifest_states_reaches_the_fit() -> None:
    campaign = campaigns.campaign()
    stated = campaign.known["m"]
    assert stated.std > 0.0
    assert identification_plan(campaign, 1).anchors == {"m": stated.std}
    assert held_at(campaign.known) == {"m": f"held at the stated {stated.value:g} ± {stated.std:g}"}
    assert held_at({"m": Anchor(2.0)}) == {"m": "held at the stated 2"}


def test_an_anchor_in_a_unit_of_something_else_is_refused() -> None:
    check_known({"rho_1": Anchor(1e-6, unit="1/Ω"), "m": Anchor(1.0)}, hrc(1).parameters)
    with pytest.raises(InputRefused, match="m is in kg, its stated unit is one of the kind of m"):
        check_known({"m": Anchor(1e-3, unit="m")}, hrc(1).parameters)
