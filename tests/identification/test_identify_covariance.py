"""Intervals contain the truth as often as they say, whatever the noise is, and anchors err as they are stated to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise

import campaigns
import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binom
from scipy.stats import t as student

from phnn.effects import effect
from phnn.errors import InputRefused
from phnn.identification.covariance import bread, scatter
from phnn.identification.fit import Fit, fit
from phnn.identification.plan import Plan
from phnn.identification.prepare import identification_plan
from phnn.identification.staged import check_known, fit_identified, held_at
from phnn.models.actuator import hrc
from phnn.recordings.recording import Anchor, Recording
from phnn.setup import Setup
from phnn.trajectory import simulate

DRAWS = 200
Noise = Callable[[np.random.Generator, int], np.ndarray]


def white(rng: np.random.Generator, size: int) -> np.ndarray:
    return rng.standard_normal(size)


def first_order(rng: np.random.Generator, size: int) -> np.ndarray:
    return np.asarray(lfilter([0.6], [1.0, -0.8], rng.standard_normal(size + 200)))[200:]


def through_a_resonance(rng: np.random.Generator, size: int) -> np.ndarray:
    """A fifth of the power in a resonance at 0.05 cycles a sample."""
    found = np.asarray(lfilter([1.0], [1.0, -1.9 * np.cos(0.1 * np.pi), 0.9025], rng.standard_normal(size + 500)))[500:]
    return np.sqrt(0.8) * rng.standard_normal(size) + np.sqrt(0.2) * found / 7.0


def heavy(rng: np.random.Generator, size: int) -> np.ndarray:
    return rng.standard_t(3.0, size) / np.sqrt(3.0)


def recordings() -> tuple[tuple[Recording, ...], list[slice]]:
    found = campaigns.base().plan.recordings
    ends = np.cumsum([0, *(int(r.mask("identification").sum()) for r in found)])
    return found, [slice(int(a), int(b)) for a, b in pairwise(ends)]


@cache
def errors(noise: Noise, periodic: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """(DRAWS, K) errors of the linearised fit over their standard errors, and their degrees of freedom."""
    jacobian = campaigns.base().jacobian
    inverse, rng = np.linalg.pinv(jacobian), np.random.default_rng(7)
    among, slices = recordings()
    among = among if periodic else tuple(replace(r, period=None) for r in among)
    found, freedom = [], []
    for _ in range(DRAWS):
        parts = [noise(rng, s.stop - s.start) for s in slices]
        drawn = np.concatenate([p - p.mean() for p in parts])
        error = inverse @ drawn
        known = scatter(drawn - jacobian @ error, jacobian, among, slices)
        found.append(error / np.sqrt(np.diag(known.covariance)))
        freedom.append(known.freedom)
    return np.array(found), np.array(freedom)


@pytest.mark.parametrize(
    "noise", [first_order, *(pytest.param(n, marks=pytest.mark.slow) for n in (white, heavy, through_a_resonance))]
)
@pytest.mark.parametrize(
    ("share", "periodic"), [(0.68, True), (0.95, True), pytest.param(0.95, False, marks=pytest.mark.slow)]
)
def test_intervals_contain_the_truth_as_often_as_they_say(noise: Noise, share: float, periodic: bool) -> None:
    found, freedom = errors(noise, periodic)
    inside = np.abs(found) <= student.ppf(0.5 + 0.5 * share, freedom)
    # All parameters of one draw count as one: their errors go together.
    low, high = binom.interval(0.99, DRAWS, share)
    assert low <= DRAWS * inside.mean() <= high


def test_uneven_noise_widens_where_it_lies() -> None:
    jacobian = campaigns.base().jacobian
    among, slices = recordings()
    rng = np.random.default_rng(3)
    # As large as the first parameter listens, as jitter is where the output is fast.
    inverse = np.linalg.pinv(jacobian)
    size = np.abs(inverse[0]) / np.sqrt(np.mean(inverse[0] ** 2))
    true = np.sqrt(np.einsum("kn,n->k", inverse**2, size**2))
    least = np.sqrt(np.diag(bread(jacobian)))
    assert true[0] > 1.3 * least[0]
    stated = []
    for _ in range(50):
        drawn = size * rng.standard_normal(size.size)
        stated.append(np.diag(scatter(drawn - jacobian @ (inverse @ drawn), jacobian, among, slices).covariance))
    assert np.sqrt(np.mean(stated, axis=0)[0]) == pytest.approx(true[0], rel=0.2)


@pytest.mark.slow
def test_intervals_know_of_lines_that_the_model_misses() -> None:
    jacobian = campaigns.base().jacobian
    inverse, rng = np.linalg.pinv(jacobian), np.random.default_rng(11)
    among, slices = recordings()
    inside, naive = [], []
    for _ in range(DRAWS):
        missed = []
        for rows in slices:
            n = rows.stop - rows.start
            # Harmonics of three periods a recording, with amplitudes that fall and phases that nobody knows.
            orders = np.arange(1, 25)
            phase = 2.0 * np.pi * (np.outer(np.arange(n) / n, 3 * orders) + rng.random(orders.size))
            missed.append(np.cos(phase) @ (3.0 / orders) + rng.standard_normal(n))
        drawn = np.concatenate(missed)
        error = inverse @ drawn
        known = scatter(drawn - jacobian @ error, jacobian, among, slices)
        inside.append(np.abs(error) <= student.ppf(0.975, known.freedom) * np.sqrt(np.diag(known.covariance)))
        naive.append(np.abs(error) <= 1.96 * np.sqrt(np.diag(bread(jacobian))))
    assert np.mean(naive) < 0.6
    assert np.mean(inside) > 0.9


def test_never_below_the_stated_noise() -> None:
    jacobian = campaigns.base().jacobian
    among, slices = recordings()
    found = scatter(1e-3 * np.random.default_rng(0).standard_normal(len(jacobian)), jacobian, among, slices)
    least = bread(jacobian)
    np.testing.assert_allclose(np.diag(found.covariance), np.diag(least), rtol=1e-6)
    nothing = scatter(np.ones(len(jacobian)), jacobian[:, :0], among, slices)
    assert nothing.covariance.shape == (0, 0)
    assert nothing.freedom.shape == (0,)


def test_a_large_unit_does_not_hide_the_other_columns() -> None:
    jacobian = np.random.default_rng(3).standard_normal((40, 3))
    units = np.array([1.0, 1e18, 1e-12])
    np.testing.assert_allclose(bread(jacobian * units) * np.outer(units, units), bread(jacobian), rtol=1e-9)


def test_an_interval_is_that_of_the_estimation_coordinate() -> None:
    fitted = campaigns.base()
    for name in fitted.variables.names:
        p = fitted.setup.parameters[name]
        ends, narrow, alone = fitted.interval(name), fitted.interval(name, 0.68), fitted.interval(name, anchored=False)
        assert ends is not None
        assert narrow is not None
        assert alone is not None
        assert 0.0 < ends[0] < narrow[0] < p.value < narrow[1] < ends[1]
        # Up to what the search left on its last step.
        middle = 0.5 * (p.to_coordinate(ends[0]) + p.to_coordinate(ends[1]))
        assert p.from_coordinate(middle) == pytest.approx(p.value, rel=1e-9)
        assert ends[0] <= alone[0] <= alone[1] <= ends[1]
    assert fitted.interval("q_0") is None


def refitted(true: Fit, rng: np.random.Generator) -> Fit:
    """A fit to new white noise on the output of a fitted model, begun at that model."""
    fresh = []
    for r in true.plan.recordings:
        y = simulate(true.setup, r, true.plan.steps_of(r)).y
        fresh.append(replace(r, y=y + r.noise * rng.standard_normal(y.size)))
    return fit_identified(true.setup, replace(true.plan, recordings=tuple(fresh)), true.held, origin=true)


@pytest.mark.slow
def test_refits_find_the_truth_in_their_intervals() -> None:
    true, rng, inside = campaigns.base(), np.random.default_rng(5), {0.68: [], 0.95: []}
    draws = 40
    for _ in range(draws):
        found = refitted(true, rng)
        for share, hits in inside.items():
            for name in found.variables.names:
                ends = found.interval(name, share, anchored=False)
                if ends is not None:
                    hits.append(ends[0] <= true.setup.values()[name] <= ends[1])
    for share, hits in inside.items():
        low, high = binom.interval(0.99, draws, share)
        assert low <= draws * np.mean(hits) <= high


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


@pytest.mark.slow
def test_intervals_cover_the_truth_when_the_anchor_is_drawn_with_its_error() -> None:
    rng, count = np.random.default_rng(5), 500
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
