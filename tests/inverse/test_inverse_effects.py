"""Every effect of the catalogue: the model with it follows its inverse, or the inverse is refused by name."""

from __future__ import annotations

import numpy as np
import pytest
from effect_homes import EFFECTS, FORMULAS, LEARNED, home, point

from phnn.chain import AMPLIFIERS, MEMORYLESS, SENSORS
from phnn.effects import Effect, in_all_forms
from phnn.errors import InputRefused
from phnn.inverse import blocks
from phnn.inverse.invert import InverseOptions, invert
from phnn.model import Model

RATE, FREQUENCY = 20_000.0, 100.0
T = np.arange(401) / RATE
REFERENCE = 2e-5 * (1.0 - np.cos(2.0 * np.pi * FREQUENCY * T)) * (1.0 - np.exp(-((T / 0.004) ** 3)))
# Largest error over the range of the reference. Only what a voltage between samples cannot follow, or what takes time
# to cross, is allowed more than the tolerance of the inverse; each with the reason.
TOLERANCE = 2e-5
ALLOWED = {
    "output_backlash": 2e-2,  # the mass cannot cross the play at once when the direction changes
    "coulomb_friction": 5e-4,  # the friction turns round within one sample
    "sensor_drift": 5e-4,  # the drifting reference begins in motion, the mass at rest
    "sensor_rectification": 1e-4,  # where the reference touches zero, errors of both signs are reported as one
    "sensor_clock": 5e-5,  # a fast clock asks for what comes after the last sample
}
# Effects of systems whose motion does not tell the input.
REFUSED = {"overflow", "spill_over", "turbulent_orifice"}
FORMS = in_all_forms([*EFFECTS, *LEARNED, *FORMULAS])


@pytest.mark.parametrize("effect_", FORMS, ids=["-".join((e.name, *e.parameters)) for e in FORMS])
def test_the_inverse_of_every_effect(effect_: Effect) -> None:
    setup = effect_.add_to(home(effect_).setup, point(effect_))
    if effect_.name in REFUSED:
        with pytest.raises(InputRefused, match="does not push the mass"):
            invert(setup, 1, T, REFERENCE, InverseOptions())
        return
    found = invert(setup, 1, T, REFERENCE, InverseOptions())
    reached = Model(setup).simulate(T, found.voltage, input_before=found.voltage_before)
    share = np.abs(reached - REFERENCE).max() / np.ptp(REFERENCE)
    assert share <= ALLOWED.get(effect_.name, TOLERANCE)


def test_a_strong_effect_changes_the_voltage() -> None:
    # That the inverse follows the model is worth something only where the model without the effect would not.
    for name in ("creep", "electrostriction", "amplifier_lowpass", "sensor_lag", "second_mode"):
        effect_ = next(e for e in EFFECTS if e.name == name)
        setup = effect_.add_to(home(effect_).setup, point(effect_))
        base = invert(home(effect_).setup, 1, T, REFERENCE, InverseOptions())
        missed = Model(setup).simulate(T, base.voltage, input_before=0.0) - REFERENCE
        assert np.abs(missed).max() > 50.0 * TOLERANCE * np.ptp(REFERENCE), name


def test_every_block_of_the_chain_has_an_inverse_or_is_refused() -> None:
    assert set(AMPLIFIERS) - set(MEMORYLESS) - set(blocks._AMPLIFIER_INVERSES) == {"rate"}
    assert set(SENSORS) - set(blocks.STATIC_SENSORS) - set(blocks._SENSOR_INVERSES) == {"rate"}
