"""A refit on recordings made from Table 1 finds Table 1."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from phnn.diagnosis.tested import score_on_all
from phnn.identification.base import identify_base
from phnn.identification.fit import Fit
from phnn.identification.options import Options
from phnn.recordings import read
from studies.generator.world import TABLE
from studies.recordings import Conditions, write_recordings

NOISE = 0.05e-6
# Values that voltage and displacement identify, whatever the common factor.
GROUPS = [("m", "alpha"), ("k", "alpha"), ("b", "alpha"), ("alpha", "C_1"), ("alpha", "C_2"), ("rho_2", "C_2")]


def cramer_rao(fitted: Fit, name: str, noise: float) -> float:
    """Smallest standard error of the logarithm of a parameter that an unbiased estimate can have.

    The Jacobian is weighted by the noise of each recording as it was estimated.
    """
    rows = np.concatenate([np.full(int(r.mask("identification").sum()), r.noise) for r in fitted.plan.recordings])
    information = (fitted.jacobian * rows[:, None] / noise).T @ (fitted.jacobian * rows[:, None] / noise)
    place = fitted.variables.names.index(name)
    return float(np.sqrt(np.linalg.inv(information)[place, place]))


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)])
def test_table_1_is_recovered(seed: int, tmp_path: Path) -> None:
    write_recordings(tmp_path / "r", Conditions(noise_um=NOISE * 1e6, seed=seed))
    campaign = read(tmp_path / "r")
    fitted, error = identify_base(campaign, Options(starts=1, seed=seed))
    values = fitted.setup.values()
    assert values["m"] == pytest.approx(TABLE["m"], rel=1e-12)
    for a, b in GROUPS:
        assert values[a] / values[b] == pytest.approx(TABLE[a] / TABLE[b], rel=5e-3), f"{a}/{b}"
    for name in ("k", "b", "alpha", "C_1", "C_2", "rho_2", "d_1", "d_2"):
        assert values[name] == pytest.approx(TABLE[name], rel=5e-3), name
    bound = cramer_rao(fitted, "rho_1", NOISE)
    assert abs(np.log(values["rho_1"] / TABLE["rho_1"])) < 3.0 * bound
    # Any wrong value would pass if the bound were wide: it is known within a factor, no better than to a fifth.
    assert 0.2 < bound < 1.0
    assert error.sigma <= 1.0
    scores = score_on_all(fitted, campaign)
    held_out = [p for p in scores.parts if p.use == "confirmation"]
    assert len(held_out) == 5
    assert scores.over_noise("confirmation") <= 1.05
    # The floor of a single recording is an estimate, good to some percent; what was added is known.
    for part in held_out:
        assert part.rmse <= 1.05 * NOISE, part.name
