"""The package as a user meets it: the names of `phnn`, and the example of its first page."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from pathlib import Path

import campaigns
import numpy as np
import pytest

import phnn
from phnn.models import hrc
from phnn.recordings.recording import unrecorded
from phnn.setup import Setup
from phnn.trajectory import simulate

T = np.linspace(0.0, 0.05, 501)
SINE = 60.0 * np.sin(2.0 * np.pi * 40.0 * T)


def test_every_public_name_is_there_and_explains_itself() -> None:
    for name in phnn.__all__:
        found = getattr(phnn, name)
        assert inspect.getdoc(found), name
        if inspect.isfunction(found) or (inspect.isclass(found) and not issubclass(found, Exception)):
            text = inspect.getdoc(found) or ""
            assert re.search(r"phnn\.[\w.]+\(", text), f"{name}: no example"
    assert set(phnn.__all__) <= set(dir(phnn))
    with pytest.raises(AttributeError, match="has no attribute 'simulated'; it has Diagnosis"):
        _ = phnn.simulated


@pytest.mark.parametrize(("begun", "heavy"), [
    ("phnn", {"torch", "numba", "scipy", "pandas"}),
    ("phnn.network.bondgraph, phnn.models.actuator", {"sympy", "torch"}),
    ("phnn.report", {"matplotlib", "torch", "jinja2", "scipy"}), ("phnn; phnn.plot.compare", {"matplotlib.pyplot"}),
])  # fmt: skip
def test_a_part_of_the_package_loads_nothing_heavy_that_it_does_not_need(begun: str, heavy: set[str]) -> None:
    code = f"import sys, {begun}; print(sorted({heavy} & set(sys.modules)))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


@pytest.mark.slow
def test_a_verb_stays_a_verb_when_its_room_is_imported() -> None:
    code = "import phnn.identification.base, phnn.diagnose.linearised, phnn.comparison.models, phnn; " + (
        "print([callable(f) for f in (phnn.read, phnn.identify, phnn.diagnose, phnn.predict, phnn.compare, phnn.load)])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == str([True] * 6)


def test_model_simulates_as_the_engine_does(tmp_path: Path) -> None:
    model = phnn.Model(Setup(hrc(2)), substeps=2)
    expected = simulate(model.setup, unrecorded("a", T, SINE), 2).y
    np.testing.assert_array_equal(model.simulate(T, SINE), expected)
    np.testing.assert_allclose(model.simulate(T + 3.0, list(SINE)), expected, rtol=1e-11)
    model.save(tmp_path / "model")
    again = phnn.load(tmp_path / "model")
    assert again.substeps == 2
    assert again.parameters == model.parameters
    np.testing.assert_array_equal(again.simulate(T, SINE), expected)
    assert model.module.state_names == ("Q_1", "Q_2", "q", "p")


def test_further_ports_act() -> None:
    model, push = phnn.Model(Setup(hrc(1))), np.full(T.size, 10.0)
    alone = model.simulate(T, SINE)
    np.testing.assert_array_equal(model.simulate(T, SINE, further={"force": 0.0 * push}), alone)
    assert (model.simulate(T, SINE, further={"force": push}) - alone).mean() < 0.0


@pytest.mark.parametrize(
    ("t", "u", "options", "message"),
    [
        (T, SINE[1:], {}, "u has 500 samples and t has 501"),
        (T[:1], SINE[:1], {}, "t has 1 samples"),
        (T, np.where(T > 0.01, np.nan, SINE), {}, r"u\[101\] is not finite"),
        (T**2, SINE, {}, "give equal steps"),
        (T[::-1], SINE, {}, "give equal steps"),
        (T, SINE[:, None], {}, r"u has shape \(501, 1\)"),
        (T, ["a"] * T.size, {}, "u: could not convert"),
        (T, SINE, {"further": {"torque": SINE}}, "no port 'torque'; there are force"),
        (T, SINE, {"hold": "quintic"}, "hold = 'quintic': choose one of cubic"),
    ],
)
def test_what_cannot_be_simulated_is_refused(t: object, u: object, options: dict[str, object], message: str) -> None:
    with pytest.raises(phnn.InputRefused, match=message):
        phnn.Model(Setup(hrc(2))).simulate(t, u, **options)  # type: ignore[arg-type]


def test_identify_refuses_what_is_no_model() -> None:
    with pytest.raises(phnn.InputRefused, match="model: a int: give a Network"):
        phnn.identify(3, campaigns.campaign())  # type: ignore[arg-type]


def test_identified_model_goes_into_the_diagnosis_and_predicts(tmp_path: Path) -> None:
    folder, _ = campaigns.concealed()
    campaign = phnn.read(folder)
    fit = phnn.identify(phnn.models.hrc(hysterons=2), campaign, phnn.Options(starts=1, workers=1))
    value, error = fit.parameters["k"]
    assert error is not None
    table = fit.to_dataframe()
    assert tuple(table.loc["k", ["value", "std_error", "unit"]]) == (value, error, "N/m")
    assert table.loc["k", "low_95"] < value < table.loc["k", "high_95"]
    assert all(name in fit._repr_html_() and name in str(fit) for name in table.index)
    assert 0.0 < error < value
    diagnosis = phnn.diagnose(fit)
    assert diagnosis.verdict == "none"
    assert diagnosis.base is fit.fit
    content = diagnosis.write(tmp_path / "out")
    assert content["verdict"] == "none"
    stored = phnn.load(tmp_path / "out" / "model")
    assert stored.parameters == diagnosis.model.parameters
    for one, other in zip(
        phnn.predict(diagnosis, campaign), phnn.predict(tmp_path / "out" / "model", campaign), strict=True
    ):
        np.testing.assert_array_equal(one.y, other.y)
        assert one.document("")["residual_over_noise"] < 1.2


def test_a_folder_stands_for_its_recordings(tmp_path: Path) -> None:
    folder, _ = campaigns.concealed()
    campaign = phnn.read(folder)
    assert phnn.describe(folder) == phnn.describe(str(folder)) == phnn.describe(campaign)
    model = phnn.Model(phnn.Setup(phnn.models.hrc(hysterons=2)))
    as_predicted = phnn.read(folder, need_output=False)
    found, same = (phnn.predict(model, given) for given in (str(folder), as_predicted))
    assert [f.table.equals(s.table) for f, s in zip(found, same, strict=True)] == [True] * 4
    assert phnn.plot.loops(model, folder).axes
    with pytest.raises(phnn.InputRefused, match="no such folder"):
        phnn.diagnose(tmp_path / "absent")


def test_other_values_than_models_and_diagnoses_are_refused() -> None:
    network = phnn.models.hrc(hysterons=2)
    with pytest.raises(phnn.InputRefused, match="made of a Setup, not of a Network"):
        phnn.Model(network)  # type: ignore[arg-type]
    model = phnn.Model(phnn.Setup(network))
    t = np.arange(0.0, 0.1, 1e-4)
    with pytest.raises(phnn.InputRefused, match=r"reaches 40 m, a piezo actuator at most 0.01 m: give it in metres"):
        model.inverse(t, 40.0 * np.sin(50.0 * t) ** 3)
