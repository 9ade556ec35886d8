"""Many samples at once against single samples."""

from __future__ import annotations

import math

import numpy as np
import pytest
from rival_example import DT, linear_recordings, sweep

from phnn.model import Model
from phnn.models.actuator import hrc
from phnn.setup import Setup
from studies.rival_models import compiled_stepper as module
from studies.rival_models.compiled_stepper import CompiledStepper, compiled_stepper
from studies.rival_models.loops import ExportedStepper
from studies.rival_models.names import NAMES, rival
from studies.rival_models.rival import Stepper

FEW = 3  # evaluations or updates of each candidate


def one_by_one(stepper: Stepper, before: float, u: np.ndarray) -> np.ndarray:
    return Stepper.run(stepper, stepper.rest(before), u)[1]


@pytest.mark.parametrize("name", NAMES)
def test_many_samples_of_a_rival_are_single_ones(name: str) -> None:
    fitted = rival(name).fit(linear_recordings(), math.inf, 0, most=FEW)
    stepper, u = fitted.stepper(fitted.dt or DT), sweep(1.5, 3.0, 9.0, 300)
    wanted = one_by_one(stepper, 0.7, u)
    begun = stepper.rest(0.7)
    # In pieces, one of them a single sample; the state in front of them stays as it is.
    for _ in range(2):
        state, found = begun, []
        for piece in np.split(u, [1, 150]):
            state, y = stepper.run(state, piece)
            found.append(y)
        assert np.concatenate(found) == pytest.approx(wanted, rel=1e-9, abs=1e-9 * np.abs(wanted).max())


def test_long_inputs_are_taken_in_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    fitted = rival("preisach").fit(linear_recordings(), math.inf, 0, most=FEW)
    stepper, u = fitted.stepper(DT), sweep(1.5, 3.0, 9.0, 300)
    whole = stepper.run(stepper.rest(0.0), u)[1]
    monkeypatch.setattr("studies.rival_models.separable._BLOCK", 70)
    assert stepper.run(stepper.rest(0.0), u)[1] == pytest.approx(whole, rel=1e-9, abs=1e-15)


def test_a_compiled_model_is_the_exported_one(monkeypatch: pytest.MonkeyPatch) -> None:
    model, u = Model(Setup(hrc())), 60.0 * np.sin(2.0 * np.pi * 50.0 * np.arange(400) * 1e-4)
    stepper = compiled_stepper(model, 1e-4)
    if not isinstance(stepper, CompiledStepper):
        pytest.skip("no C compiler is installed, or the machine is another one than Linux on 64 bits")
    wanted = one_by_one(ExportedStepper(model, 1e-4), -20.0, u)
    scale = 1e-9 * np.abs(wanted).max()
    assert one_by_one(stepper, -20.0, u) == pytest.approx(wanted, rel=1e-9, abs=scale)
    state = stepper.rest(-20.0)
    for _ in range(2):
        assert stepper.run(state, u)[1] == pytest.approx(wanted, rel=1e-9, abs=scale)
    with pytest.raises(ArithmeticError, match="sample 1 of 2"):
        stepper.run(state, np.array([0.0, np.nan]))
    monkeypatch.setattr(module, "compiled", lambda *_: None)
    assert isinstance(compiled_stepper(model, 1e-4), ExportedStepper)
