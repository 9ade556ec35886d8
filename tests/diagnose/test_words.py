"""Curves of known kind are described as what they are, and are learned only where something was recorded."""

from __future__ import annotations

from dataclasses import replace

import campaigns
import numpy as np
import pytest

from phnn.diagnose.locations import locate
from phnn.diagnose.refit import converged, short
from phnn.diagnose.words import character_in_words, character_of, fitted_in_words, forgetting, memory_in_words, shape_of
from phnn.effects.learned import learned_elements

X = np.linspace(-90.0, 90.0, 241)


@pytest.mark.parametrize(
    ("curve", "even", "side", "kind", "at"),
    [
        (X**3, 0.0, 0, "power", 3.0),
        (X**2, 1.0, 0, "power", 2.0),
        (np.maximum(X - 60.0, 0.0), 0.5, 1, "onset", 60.0 / 90.0),
        (np.maximum(-X - 30.0, 0.0), 0.5, -1, "onset", 30.0 / 90.0),
        (np.sign(X) * np.maximum(np.abs(X) - 45.0, 0.0), 0.0, 0, "onset", 0.5),
        (np.tanh(X / 4.0), 0.0, 0, "level", 4.0 / 90.0),
        (np.abs(X) * X, 0.0, 0, "power", 2.0),
    ],
)
def test_character_of_curves(curve: np.ndarray, even: float, side: int, kind: str, at: float) -> None:
    noisy = curve + 0.01 * np.abs(curve).max() * np.random.default_rng(0).standard_normal(X.size)
    for y in (curve, -curve, noisy):
        found = character_of(X, y)
        assert found.even == pytest.approx(even, abs=0.02)
        assert found.side == side
        assert found.shape.kind == kind
        assert found.shape.at == pytest.approx(at, rel=0.1)


def test_words_of_a_stop_and_of_an_odd_power() -> None:
    stop = character_in_words(character_of(X, np.maximum(X - 60.0, 0.0)), "displacement", "90 µm", "0.8 N", "60 µm")
    assert stop == (
        "It acts for positive displacement only, sets in at 60 µm and grows from there; at 90 µm it has reached 0.8 N."
    )
    cube = character_in_words(character_of(X, X**3), "displacement", "90 µm", "0.8 N", "")
    assert "is odd in the displacement, is there from the start and grows with the cube" in cube
    assert shape_of(np.linspace(0.0, 1.0, 50), np.linspace(0.0, 1.0, 50)).at == 1.0


def test_forgetting_of_one_time_constant_and_of_many() -> None:
    t = np.geomspace(1e-4, 10.0, 241)
    one = forgetting(t, 3.0 * np.exp(-t / 0.1))
    assert one is not None
    assert one == pytest.approx((0.0105, 0.0693, 0.230), rel=0.06)
    assert "as with one time constant" in memory_in_words(one)
    many = forgetting(t, sum((np.exp(-t / tau) for tau in np.geomspace(1e-3, 1.0, 7)), np.zeros_like(t)))
    assert many is not None
    assert "over decades of time" in memory_in_words(many)
    assert forgetting(t, np.sin(t)) is None


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
