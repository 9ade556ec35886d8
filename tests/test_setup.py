"""A setup as a value: its network, its blocks and their parameters."""

from __future__ import annotations

import numpy as np
import pytest
from junctions import recording

from phnn.effects import Effect, Scales, effect, in_all_forms
from phnn.effects.learned import learned_elements
from phnn.errors import InputRefused, StructureViolated
from phnn.models.actuator import from_paper
from phnn.network.elements import Port
from phnn.parameters import Parameter, positive
from phnn.passage import sensing
from phnn.recordings.sensor import Sensor
from phnn.setup import AMPLIFIERS, SENSORS, SOURCES, Block, Setup, Source


def chain() -> Setup:
    tau = positive("tau_a", 1e-3, "s")
    return (
        Setup(from_paper())
        .with_block("amplifier", Block("lowpass", ("tau_a",)), (tau,))
        .with_block("sensor", Block("drift", ("rate",)), (Parameter("rate", 1e-7, fixed=True),))
    )


def test_values_reach_network_and_blocks() -> None:
    setup = chain()
    assert [b.kind for b in (*setup.amplifier, *setup.sensor)] == ["lowpass", "drift"]
    moved = setup.with_values({"tau_a": 2e-3, "k": 2e4})
    assert moved.values()["tau_a"] == 2e-3
    assert moved.network.parameters["k"].value == 2e4
    assert setup.values()["k"] == 24579.0
    assert "rate" not in setup.free
    assert {"tau_a", "k"} <= set(setup.free)
    assert list(setup.parameters)[:4] == ["m", "k", "b", "alpha"]
    assert moved.with_values(setup.values()) == setup


def test_names_that_are_not_there_or_twice_are_refused() -> None:
    with pytest.raises(StructureViolated, match="no parameter called tau in model"):
        chain().with_values({"tau": 1.0})
    with pytest.raises(InputRefused, match="two parameters are called m"):
        Setup(from_paper()).with_block("amplifier", Block("lowpass", ("m",)), (positive("m", 1.0, "s"),)).values()


def test_a_source_has_a_port_of_its_own() -> None:
    force = (Parameter("F_c", 1.0, "N"), Parameter("F_s", 0.0, "N"), positive("f", 50.0, "Hz"))
    names = tuple(p.name for p in force)
    setup = Setup(from_paper()).with_source(Source("tone", "force", names), force)
    assert set(names) <= set(setup.free)
    assert setup.with_values({"f": 60.0}).values()["f"] == 60.0
    for port in ("voltage", "base"):
        with pytest.raises(StructureViolated, match=f"'{port}': name one beside the recorded input, force"):
            Setup(from_paper()).with_source(Source("tone", port, names), force)
    one = from_paper()
    alone = Setup(one.__class__(one.storages, one.resistors, one.couplings, (Port("voltage", {"p": "alpha"}),),
                                one.parameters))  # fmt: skip
    with pytest.raises(StructureViolated, match="of which there is none"):
        alone.with_source(Source("tone", "force", names), force)


def test_every_kind_has_an_effect_or_a_model() -> None:
    setups = [built(form) for name in CHAIN for form in in_all_forms([effect(name)])]
    setups += [e.add_to(Setup(from_paper()), e.grid(SIZES)[0]) for e in learned_elements().values()]
    assert {b.kind for s in setups for b in s.amplifier} | {"bouc_wen", "gain", "rate", "slipping"} == set(AMPLIFIERS)
    said = sensing(Setup(from_paper()), recording(np.arange(9.0), np.zeros(9), sensor=Sensor(derivative=True))).sensor
    assert {b.kind for s in setups for b in s.sensor} | {b.kind for b in said} | {"zero"} == set(SENSORS)
    assert {b.kind for s in setups for b in s.sources} == set(SOURCES)


SIZES = Scales(
    voltage=75.0, displacement=1e-4, velocity=1e-2, stiffness=2.5e4, transducer=0.046, slowest=1.0, fastest=100.0,
    duration=3.0, noise=5e-8,
)  # fmt: skip
CHAIN = {
    "amplifier_lowpass": {"tau_a": 1e-3},
    "amplifier_saturation": {"V_max": 20.0},
    "delay": {"tau_d": 1e-4},
    "slew_limit": {"S": 1e4},
    "amplifier_offset": {"V_0": 1.0},
    "sensor_drift": {"drift_rate": 1e-6},
    "sensor_lag": {"tau_y": 1e-4},
    "sensor_nonlinearity": {"a_2": 1.0, "a_3": 1.0},
    "sensor_rectification": {},
    "output_backlash": {"delta_b": 1e-7},
    "base_motion": {"A_c": 1.0, "A_s": 0.0, "f_b": 50.0},
}


def built(form: Effect) -> Setup:
    return form.add_to(Setup(from_paper()), {"n_V": 4.0, "zeta_a": 0.7, **CHAIN[form.name]})
