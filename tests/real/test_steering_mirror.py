"""The steering mirror: arrays of three inputs and outputs, two of whose realisations are known to be contaminated."""

from __future__ import annotations

import numpy as np
import pytest
from real_recordings import folder

from phnn.check import check
from phnn.configuration import compose, config_folder
from phnn.modal.experiment import study_of
from phnn.modal.settings import Settings
from phnn.modal.study import CLASS, NAMED, study_modes
from phnn.recordings import read


def test_the_contaminated_realisations_are_found_and_no_others() -> None:
    where = folder("steering-mirror", "u_100mV_train.npy")
    campaign = read(where, config_folder() / "recordings" / "steering-mirror" / "recordings.yaml")
    assert len(campaign.recordings) == 54
    findings = check(campaign).findings
    noticed = {n for n, found in findings.items() if found}
    # The second and the third of the first train.
    assert noticed == {f"100mV_{r}.y_{y}" for r in (2, 3) for y in (1, 2, 3)}
    assert {f.kind for found in findings.values() for f in found} == {"contaminated"}


@pytest.mark.slow
def test_one_passive_model_serves_at_both_amplitudes() -> None:
    where = folder("steering-mirror", "u_100mV_train.npy")
    campaign = read(where, config_folder() / "recordings" / "steering-mirror" / "recordings.yaml")
    study = study_of(campaign)
    assert set(study.left_out) == {"100mV_2", "100mV_3"}
    settings = Settings.from_config(compose("modes"))
    result = study_modes(study, settings, lambda _: None, lambda *_: None)
    assert result.verdict in (NAMED, CLASS)
    # Linear models of one amplitude each, as published: 0.114 and 0.228 µm.
    for level, published in enumerate((0.114e-6, 0.228e-6)):
        found = result.held_out[result.final.fit][level]
        assert found is not None and np.mean(found) < published
