"""The steering mirror: arrays of three inputs and outputs, two of whose realisations are known to be contaminated."""

from __future__ import annotations

from real_recordings import folder

from phnn.check import check
from phnn.configuration import config_folder
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
