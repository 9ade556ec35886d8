"""Refits of a diagnosis in threads and processes: what is sent survives, and what comes back is the same."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from unittest import mock

import campaigns
import numpy as np
import pytest

from phnn.configuration import compose
from phnn.criteria import Criteria
from phnn.diagnose import diagnosis as path
from phnn.diagnose.diagnosis import Diagnosis, diagnose
from phnn.diagnose.number import Visited
from phnn.diagnose.search import _heat, begin, explore
from phnn.effects import Scales, catalogue
from phnn.identification.fit import Fit
from phnn.identification.options import Options
from phnn.identification.plan import Plan
from phnn.identification.refinement import numerical_error
from phnn.identification.staged import fit_identified
from phnn.models.actuator import hrc
from phnn.parallel import executor
from phnn.recordings import Campaign
from phnn.recordings.recording import Start
from phnn.setup import Setup

SCALES = Scales(90.0, 1e-4, 0.1, 2.5e4, 0.046, 50.0, 150.0, 0.06, 1e-8)
HELD = {"m": "held at the stated value"}


@cache
def base() -> Fit:
    """A fit that misses creep, on a recording from rest and one with an unknown start."""
    t = np.arange(301) * 2e-4
    true = catalogue()["creep"].add_to(Setup(hrc(1)), {"k_s": 2e3, "tau_s": 5e-3})
    made = [campaigns.recorded(true, f"sine {f}", t, 80.0 * np.sin(2 * np.pi * f * t), 2e-8, seed=f) for f in (50, 150)]
    plan = Plan((made[0], replace(made[1], start=Start("unknown"))), {"sine 50": 2, "sine 150": 2}, workers=2)
    return fit_identified(Setup(hrc(1)), plan, HELD, max_evaluations=10)


def visited(choice: str) -> list[Visited]:
    """Short refits of three effects, and all models of a search, whose refits are done somewhere."""
    campaign = Campaign(base().plan.recordings, {}, {}, "command", (), True, "made up")
    effects = [catalogue()[n] for n in ("creep", "quadratic_drag", "cubic_stiffness")]
    search = begin(campaign, base(), effects, [], Criteria(), most=1, executor=executor(choice))
    heat = _heat(search, search.base, search.screen(search.screen.base))
    explore(search)
    return [*heat, *search.weighed.models]


def assert_same(found: Sequence[Visited], expected: Sequence[Visited]) -> None:
    """The same models to the last bit, on the same recordings."""
    assert [m.elements for m in found] == [m.elements for m in expected]
    for one, other in zip(found, expected, strict=True):
        assert one.fit.setup.values() == other.fit.setup.values()
        assert one.fit.held == other.fit.held
        assert one.fit.plan == other.fit.plan
        for name in ("z", "covariance", "residual", "jacobian"):
            np.testing.assert_array_equal(getattr(one.fit, name), getattr(other.fit, name))
        assert (one.fitted, one.held_out, one.converged) == (other.fitted, other.held_out, other.converged)


def test_a_fit_survives_pickling() -> None:
    fitted = base()
    again = pickle.loads(pickle.dumps(fitted))
    assert fitted.variables.unknown == ("sine 150",)
    np.testing.assert_array_equal(again.initial("sine 150"), fitted.initial("sine 150"))
    for name in ("z", "covariance", "residual", "jacobian"):
        np.testing.assert_array_equal(getattr(again, name), getattr(fitted, name))
    assert again.setup == fitted.setup
    assert again.std() == fitted.std()
    for one, other in zip(again.plan.recordings, fitted.plan.recordings, strict=True):
        np.testing.assert_array_equal(one.y, other.y)
        assert (one.name, one.start, one.parts) == (other.name, other.start, other.parts)
    # And is as good as the original to go on with.
    onwards = [fit_identified(f.setup, f.plan, HELD, 3, origin=f) for f in (again, fitted)]
    np.testing.assert_array_equal(onwards[0].z, onwards[1].z)


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_every_effect_survives_pickling(name: str) -> None:
    effect = catalogue()[name]
    again = pickle.loads(pickle.dumps(effect))
    assert again == effect
    for values in effect.grid(SCALES)[:2] if effect.can_be_added_to(base().setup) else ():
        changed = effect.add_to(base().setup, values)
        assert again.add_to(base().setup, values) == changed
        assert pickle.loads(pickle.dumps(changed)) == changed
        assert again.scaled(values, 2.0) == effect.scaled(values, 2.0)


@pytest.mark.parametrize("choice", ["threads:2", pytest.param("processes:2", marks=pytest.mark.slow)])
def test_refits_are_the_same_wherever_they_are_done(choice: str) -> None:
    expected = visited("serial")
    assert expected[0].words == "creep"
    assert len(expected) >= 5
    assert_same(visited(choice), expected)


def test_the_choice_is_a_setting() -> None:
    assert compose("diagnose")["executor"] == Options().executor == "serial"
    for choice in ("processes:2", "tcp://node1:8786", "runs/scheduler.json"):
        config = compose("diagnose", [f"executor={choice}"])
        assert Options.from_config(config).executor == choice


@pytest.mark.slow
def test_a_diagnosis_in_processes_is_that_of_one_thread() -> None:
    effects = [catalogue()[n] for n in ("creep", "extra_hysteron", "amplifier_lowpass")]
    fitted = campaigns.base("creep")
    error = numerical_error(fitted)

    def found(choice: str) -> Diagnosis:
        with mock.patch.object(path, "identify_base", return_value=(fitted, error)):
            return diagnose(campaigns.campaign("creep"), Options(workers=2, executor=choice), effects=effects)

    serial, processes = found("serial"), found("processes:2")
    assert len(serial.visited.models) > 2
    assert_same(processes.visited.models, serial.visited.models)
    assert processes.verdict == serial.verdict
    assert processes.probability == serial.probability
    assert processes.final.setup.values() == serial.final.setup.values()
    assert processes.significance() == serial.significance()
    assert processes.after.table() == serial.after.table()
    assert processes.kernel_residual == serial.kernel_residual
    assert processes.proposal == serial.proposal
