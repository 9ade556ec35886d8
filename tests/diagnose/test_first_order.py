"""A body that cools: a network of one storage, which no other one drives."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import phnn
from phnn.derivatives import output_derivatives
from phnn.diagnose.locations import locate
from phnn.errors import StructureViolated
from phnn.recordings import Campaign, read
from phnn.simulate import simulate

BODY = """
junctions: {supply: 1, body: 0}
elements:
  warmth: {type: C, junction: body, law: capacitor, parameters: [one], unit: K}
  loss: {type: R, junction: body, law: linear, parameters: [g], direction: conductance}
  heater: {type: Sf, junction: supply, unit: W}
bonds:
  - {type: TF, from: supply, to: body, ratio: c}
parameters:
  c: {value: 0.02, unit: K/J, positive: true}
  one: {value: 1.0, unit: "1", fixed: true}
  g: {value: 0.1, unit: 1/s, positive: true}
output: warmth
"""
MANIFEST = """setup: {network: body.yaml}
columns: {time: {column: 0, unit: s}, input: {column: 1, unit: W}, output: {column: 2, unit: K}}
"""
CAPACITY, RATE, NOISE = 0.05, 0.03, 0.05


@pytest.fixture(scope="module")
def heated(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """Recordings of steps of the heater, by the exact solution of ``Ṫ = c P − g T``."""
    folder = tmp_path_factory.mktemp("heated")
    (folder / "body.yaml").write_text(BODY, encoding="utf-8")
    (folder / "recordings.yaml").write_text(MANIFEST, encoding="utf-8")
    rng = np.random.default_rng(3)
    for name, levels in {"up": (0.0, 10.0, 4.0), "down": (0.0, 15.0, 0.0), "short": (0.0, 6.0, 12.0)}.items():
        power, kept = np.repeat(levels, 200), np.exp(-0.5 * RATE)
        warmth = np.zeros(power.size)
        for n in range(power.size - 1):
            warmth[n + 1] = kept * warmth[n] + (1.0 - kept) * CAPACITY / RATE * power[n]
        table = {"t": 0.5 * np.arange(power.size), "P": power, "T": warmth + NOISE * rng.standard_normal(power.size)}
        pd.DataFrame(table).to_csv(folder / f"{name}.csv", index=False)
    return read(folder)


def test_nothing_is_missing_and_the_parameters_are_right(heated: Campaign) -> None:
    found = phnn.diagnose(heated)
    assert (found.verdict, found.ended.warnings) == ("none", ())
    values = found.final.setup.values()
    assert [values["c"], values["g"]] == pytest.approx([CAPACITY, RATE], rel=0.01)
    assert np.isfinite(list(locate(found.linearised[0]).scores.values())).all()


def test_the_rate_of_the_output_is_its_change_and_no_force_acts(heated: Campaign) -> None:
    setup, recording = phnn.identify(None, heated).fit.setup, heated.recordings[0]
    trajectory = simulate(setup, recording, 1)
    assert trajectory.velocity == pytest.approx(np.diff(trajectory.states[:, 0]) / trajectory.h)
    with pytest.raises(StructureViolated, match="no force acts"):
        output_derivatives(trajectory, (), (), np.ones((trajectory.h.size, 1)))
