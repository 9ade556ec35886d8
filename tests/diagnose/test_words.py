"""Curves of known kind are described as what they are, and are learned only where something was recorded."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import campaigns
import numpy as np
import pytest

from phnn.diagnose.locations import locate
from phnn.diagnose.refit import converged, short
from phnn.diagnose.words import curve_in_words, fitted_in_words, memory_in_words, shape_of
from phnn.effects.learned import learned_elements

X = np.linspace(-90.0, 90.0, 241)


@pytest.mark.parametrize(
    ("curve", "words"),
    [
        (X**3, "is odd in the displacement, is there from the start and grows with the cube"),
        (X**2, "is even in the displacement, is there from the start and grows with the square"),
        (np.maximum(X - 60.0, 0.0), "acts for positive displacement only, sets in at"),
        (np.maximum(-X - 30.0, 0.0), "acts for negative displacement only, sets in at"),
        (np.sign(X) * np.maximum(np.abs(X) - 45.0, 0.0), "is odd in the displacement, sets in at"),
        (np.tanh(X / 4.0), "is odd in the displacement, levels off beyond"),
        (np.abs(X) * X, "is odd in the displacement, is there from the start and grows with the square"),
        (X**3 + 35.0 * X**2, "is neither odd nor even in the displacement"),
    ],
)
def test_words_of_curves(curve: np.ndarray, words: str) -> None:
    noisy = curve + 0.01 * np.abs(curve).max() * np.random.default_rng(0).standard_normal(X.size)
    for y in (curve, -curve, noisy):
        assert f"It {words}" in curve_in_words(X, y, "displacement [µm]", "missing force [N]")


def test_words_of_a_stop_with_its_sizes() -> None:
    stop = 0.8 / 29.25 * np.maximum(X - 60.75, 0.0)
    assert curve_in_words(X, stop, "displacement [µm]", "missing displacement [nm]") == (
        "It acts for positive displacement only, sets in at 60.7 µm and grows from there; "
        "at 90 µm it has reached 800 pm."
    )
    assert curve_in_words(X, 0.0 * X, "displacement [µm]", "missing force [N]") == "Its strengths are all zero."


@pytest.mark.parametrize(
    ("curve", "kind", "at"),
    [
        (lambda s: s, "power", 1.0),
        (lambda s: s**3, "power", 3.0),
        (lambda s: np.maximum(s - 2.0 / 3.0, 0.0), "onset", 2.0 / 3.0),
        (lambda s: np.tanh(22.5 * s), "level", 4.0 / 90.0),
    ],
)
def test_shape_of_half_a_curve(curve: Callable[[np.ndarray], np.ndarray], kind: str, at: float) -> None:
    s = np.linspace(0.0, 1.0, 121)
    assert shape_of(s, 5.0 * curve(s)) == (kind, pytest.approx(at, rel=0.1))


def test_forgetting_of_one_time_constant_and_of_many() -> None:
    t = np.geomspace(1e-4, 10.0, 241)
    # A tenth, a half and nine tenths are gone after 10.5, 69.3 and 230 ms, on a grid of 5 %.
    one = memory_in_words(t, 3.0 * np.exp(-t / 0.1))
    assert "as with one time constant" in one
    gone = [float(x) for x in re.findall(r"([0-9.]+) ms", one)]
    assert gone == pytest.approx([10.5, 69.3, 230.0], rel=0.06)
    many = sum((np.exp(-t / tau) for tau in np.geomspace(1e-3, 1.0, 7)), np.zeros_like(t))
    assert "over decades of time" in memory_in_words(t, many)
    assert "does not simply decay" in memory_in_words(t, np.sin(t))


@pytest.mark.parametrize(
    ("effect", "words"),
    [
        ("cubic_stiffness", ("missing force", "the displacement", "odd")),
        pytest.param("coulomb_friction", ("missing",), marks=pytest.mark.slow),
        ("contact_stop", ("missing force", "positive displacement only", "sets in at")),
    ],
)
def test_what_was_fitted_at_the_location_in_words(effect: str, words: tuple[str, ...]) -> None:
    linearised = campaigns.linearised(effect)
    found = fitted_in_words(linearised, locate(linearised))
    assert all(w in found for w in words), found


def test_springs_beyond_the_recorded_motion_stay_as_weak_as_they_begin() -> None:
    linearised = campaigns.linearised("creep")
    wide = replace(linearised, scales=replace(linearised.scales, displacement=2.0 * linearised.scales.displacement))
    element, base = learned_elements()["learned_spring"], linearised.fit
    values = element.grid(wide.scales)[0]
    began = short(base, base.plan.coarse(), element, [values], 12)
    assert began is not None and began.cost < base.cost
    ended = converged(began, base.plan, base.held, element.parameters)
    assert ended is not None
    reached = max(float(np.abs(t.states[:, t.program.output]).max()) for t in linearised.trajectories)
    for found in (began, ended):
        fitted, stops = found.setup.values(), [f"{side}{i}" for i in range(1, 5) for side in "RL"]
        beyond = [i for i in stops if fitted[f"g_L{i[1]}"] > 1.01 * reached]
        assert len(beyond) >= 4
        assert not {f"k_{i}" for i in beyond} & set(found.variables.names)
        assert [fitted[f"k_{i}"] for i in beyond] == pytest.approx([values[f"k_{i}"] for i in beyond])
        assert any(f"k_{i}" in found.variables.names for i in stops)
