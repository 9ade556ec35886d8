"""Systems that are slower or larger than any actuator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from effect_homes import EFFECTS, FORMULAS, LEARNED, SCALES, home
from junctions import recording

from phnn.configuration import config_folder
from phnn.effects import Effect, effect, in_all_forms
from phnn.identification.fit import fit
from phnn.identification.plan import Plan
from phnn.models.network_file import load_network
from phnn.recordings.recording import Part, Start
from phnn.setup import Setup
from phnn.simulate import simulate

_ALL = in_all_forms([*EFFECTS, *LEARNED, *FORMULAS])


@pytest.mark.parametrize("effect_", _ALL, ids=["-".join((e.name, *e.parameters)) for e in _ALL])
@pytest.mark.parametrize("time", [1e-7, 1e7])
def test_an_effect_can_be_placed_in_a_system_of_any_size_and_speed(effect_: Effect, time: float) -> None:
    base = home(effect_).setup
    for length in (1e-6, 1e6):
        for drive in (1e-6, 1e7):
            scales = replace(
                SCALES,
                slowest=SCALES.slowest / time,
                fastest=SCALES.fastest / time,
                duration=SCALES.duration * time,
                displacement=SCALES.displacement * length,
                velocity=SCALES.velocity * length / time,
                stiffness=SCALES.stiffness * drive / length,
                noise=SCALES.noise * length,
                voltage=SCALES.voltage * drive,
            )
            for values in effect_.grid(scales):
                effect_.add_to(base, values)
                effect_.add_to(base, effect_.scaled(values, 1e3))


@pytest.mark.parametrize(("name", "parameter"), [("amplifier_lowpass", "tau_a"), ("sensor_lag", "tau_y")])
def test_a_lag_of_a_minute_is_found_in_samples_every_four_seconds(name: str, parameter: str) -> None:
    tanks = Setup(load_network(config_folder() / "network" / "tanks.yaml"))
    rng = np.random.default_rng(3)
    t = 4.0 * np.arange(400)
    u = 1e-4 * (1.0 + np.repeat(rng.uniform(-0.5, 0.5, 40), 10))
    blank = recording(t, u, Start("rest", 1e-4), interpolation="linear")
    true = effect(name).add_to(tanks, {parameter: 54.0})
    y = simulate(true, blank).y
    noise = 1e-4 * float(np.ptp(y))
    run = replace(
        blank, y=y + noise * rng.standard_normal(t.size), noise=noise, parts=(Part("a", 0, t.size, "identification"),)
    )
    found = fit(effect(name).add_to(tanks, {parameter: 0.05}), Plan((run,)), [parameter])
    assert found.chi2 < 1.3
    assert found.setup.parameters[parameter].value == pytest.approx(54.0, rel=0.02)
