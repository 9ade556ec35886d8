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
from phnn.diagnosis import diagnosis as path
from phnn.diagnosis.diagnosis import Diagnosis, diagnose
from phnn.diagnosis.name import Candidate
from phnn.diagnosis.refit import refit
from phnn.diagnosis.trial import Trial
from phnn.effects import Scales, catalogue
from phnn.errors import InputRefused
from phnn.identification.fit import Fit
from phnn.identification.options import Options
from phnn.identification.plan import Plan
from phnn.identification.refinement import numerical_error
from phnn.identification.staged import fit_identified
from phnn.models.actuator import hrc
from phnn.parallel import executor
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


def candidates() -> list[Candidate]:
    chosen = [catalogue()[n] for n in ("creep", "quadratic_drag", "cubic_stiffness")]
    grids = [e.grid(SCALES) for e in chosen]
    return [
        Candidate(e, g[len(g) // 2], tuple(g[:1]), 10.0 - i, 1e-5)
        for i, (e, g) in enumerate(zip(chosen, grids, strict=True))
    ]


def assert_same(found: Sequence[Trial], expected: Sequence[Trial]) -> None:
    """The same trials to the last bit, on the same recordings."""
    assert [t.candidate for t in found] == [t.candidate for t in expected]
    for one, other in zip(found, expected, strict=True):
        assert (one.fit is None) == (other.fit is None)
        if one.fit is not None and other.fit is not None:
            assert one.fit.setup.values() == other.fit.setup.values()
            assert one.fit.held == other.fit.held
            assert one.fit.plan == other.fit.plan
            for name in ("z", "covariance", "residual", "jacobian"):
                np.testing.assert_array_equal(getattr(one.fit, name), getattr(other.fit, name))
            assert [s.values() for s in one.fit.alternatives] == [s.values() for s in other.fit.alternatives]


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
    assert_same(refit(base(), candidates(), executor(choice)), refit(base(), candidates()))


def test_the_choice_is_a_setting() -> None:
    assert compose("diagnose")["executor"] == Options().executor == "serial"
    for choice in ("processes:2", "tcp://node1:8786", "runs/scheduler.json"):
        config = compose("diagnose", [f"executor={choice}"])
        assert Options.from_config(config).executor == choice


def test_an_unknown_choice_is_refused_before_anything_is_fitted() -> None:
    with (
        mock.patch.object(path, "identify_base", side_effect=AssertionError("fitted")),
        pytest.raises(InputRefused, match="executor=fork is not known"),
    ):
        diagnose(mock.sentinel.campaign, Options(executor="fork"))


@pytest.mark.slow
def test_a_diagnosis_in_processes_is_that_of_one_thread() -> None:
    effects = [catalogue()[n] for n in ("creep", "extra_hysteron", "amplifier_lowpass")]
    fitted = campaigns.base("creep")
    error = numerical_error(fitted)

    def found(choice: str) -> Diagnosis:
        with mock.patch.object(path, "identify_base", return_value=(fitted, error)):
            return diagnose(campaigns.campaign("creep"), Options(workers=2, executor=choice), effects=effects)

    serial, processes = found("serial"), found("processes:2")
    assert len(serial.judgement.tried) == len(effects)
    assert processes.judgement.verdict == serial.judgement.verdict
    assert_same(processes.judgement.tried, serial.judgement.tried)
    for one, other in zip(processes.judgement.findings, serial.judgement.findings, strict=True):
        assert_same(one.trials, other.trials)
        assert_same(one.members, other.members)
    assert processes.judgement.final.setup.values() == serial.judgement.final.setup.values()
    assert processes.judgement.naming.p_value == serial.judgement.naming.p_value
    assert processes.after.table() == serial.after.table()
    assert processes.kernel_residual == serial.kernel_residual
    assert processes.proposal == serial.proposal
