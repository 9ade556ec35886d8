"""Which recordings lie outside the range that was identified."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from phnn.recordings.recording import Part, Recording, Start
from studies.comparison.uses import uses
from studies.recordings import comparison_plan


def recorded(name: str, use: str, u: NDArray[np.float64], dt: float) -> Recording:
    parts = (Part(name, 0, u.size, use),)
    t = dt * np.arange(u.size)
    return Recording(name, t, u, u, Start("rest"), "cubic", parts, 1.0, "given", np.ones(1), None, {}, name)


def sine(use: str, frequency: float, amplitude: float) -> Recording:
    u = amplitude * np.sin(2 * np.pi * 3.0 * np.arange(600) / 600)
    return recorded(f"{frequency:g} Hz {amplitude:g} V", use, u, 3.0 / frequency / 600)


def test_the_plan_of_the_comparison_is_grouped() -> None:
    stated, plan = comparison_plan()
    found = uses([recorded(e.name, stated[e.name], e.voltage(e.t), e.dt) for e in plan])
    beyond = {n for n, use in found.items() if use == "outside"}
    assert beyond == {
        "sine_300Hz_75V", "sine_010Hz_37.5V", "sine_075Hz_37.5V", "sine_150Hz_37.5V", "sine_025Hz_90V",
    }  # fmt: skip
    assert {n for n, use in found.items() if use == "confirmation"} == {f"sine_{f:03}Hz_75V" for f in (10, 25, 75)}


@pytest.mark.parametrize(
    ("frequency", "amplitude", "use"),
    [
        (20.0, 60.0, "confirmation"),
        (10.2, 40.1, "confirmation"),
        (9.0, 60.0, "outside"),
        (60.0, 60.0, "outside"),
        (20.0, 30.0, "outside"),
        (20.0, 90.0, "outside"),
    ],
)
def test_frequency_and_amplitude_both_count(frequency: float, amplitude: float, use: str) -> None:
    known = [sine("identification", 10.0, 75.0), sine("identification", 50.0, 40.0)]
    other = sine("confirmation", frequency, amplitude)
    assert uses([*known, other])[other.name] == use


def test_a_step_is_judged_by_its_height() -> None:
    levels = np.concatenate([np.zeros(100), np.ones(400)])
    known = sine("identification", 10.0, 75.0)
    for height, use in ((75.0, "confirmation"), (90.0, "outside"), (20.0, "confirmation")):
        assert uses([known, recorded("step", "confirmation", height * levels, 1e-3)])["step"] == use
    # Nothing oscillated: a sine of any frequency counts by its height alone.
    only = recorded("step", "identification", 75.0 * levels, 1e-3)
    assert uses([only, sine("confirmation", 10.0, 75.0)])["10 Hz 75 V"] == "confirmation"
