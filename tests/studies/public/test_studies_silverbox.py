"""The protocol of the benchmark: initial state from 50 samples, zero from the training samples, mean included."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.io import savemat

from phnn.configuration import config_folder
from phnn.models.network_file import load_network
from phnn.recordings import Campaign, Recording, read
from phnn.setup import Setup
from phnn.simulate import simulate
from studies.public.silverbox import UNSCORED, initial_state, official_errors

STEPS, ZERO = 4, 0.02
MANIFEST = """
setup: {{network: {network}}}
voltage: terminals
variables: {{input: V1, output: V2}}
columns: {{input: {{unit: V}}, output: {{unit: V}}}}
sample_rate_hz: 610.3515625
start: unknown
input: band_limited
recordings:
  - {{file: made.mat, name: training, slice: [0, 900], use: identification}}
  - {{file: made.mat, name: test, slice: [900, 1400], use: confirmation}}
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Setup, Campaign]:
    """An oscillator, and what it answers to a smooth noise; the test begins in motion."""
    folder = tmp_path_factory.mktemp("silverbox")
    network = config_folder() / "recordings" / "silverbox" / "oscillator.yaml"
    setup = Setup(load_network(network), name="oscillator")
    u = np.convolve(np.random.default_rng(1).standard_normal(1400), np.hanning(12), mode="same") * 0.02
    savemat(folder / "made.mat", {"V1": u[None], "V2": np.random.default_rng(2).standard_normal((1, 1400))})
    (folder / "recordings.yaml").write_text(MANIFEST.format(network=network), encoding="utf-8")
    campaign = read(folder, allow_outside=True)

    def answered(recording: Recording) -> Recording:
        begun = simulate(setup, recording, STEPS).states[0].copy()
        begun[setup.network.state_names.index("q")] += 0.05 if recording.name == "test" else 0.0
        return replace(recording, y=simulate(setup, recording, STEPS, initial=begun).y + ZERO)

    return setup, replace(campaign, recordings=tuple(answered(r) for r in campaign.recordings))


def test_the_true_model_has_no_error(made: tuple[Setup, Campaign]) -> None:
    setup, campaign = made
    assert official_errors(setup, STEPS, campaign)["test"] < 1e-6


def test_the_initial_state_is_that_of_the_unscored_samples(made: tuple[Setup, Campaign]) -> None:
    setup, campaign = made
    test = campaign.recordings[1]
    later = replace(test, y=np.where(np.arange(test.y.size) < UNSCORED, test.y, 9.0))
    begun = initial_state(setup, STEPS, later, ZERO)
    place = setup.network.state_names.index("q")
    assert begun[place] - simulate(setup, test, STEPS).states[0][place] == pytest.approx(0.05, rel=1e-3)


def test_a_mean_that_the_training_samples_do_not_have_is_an_error(made: tuple[Setup, Campaign]) -> None:
    setup, campaign = made
    training, test = campaign.recordings
    scored = np.arange(test.y.size) >= UNSCORED
    moved = replace(campaign, recordings=(training, replace(test, y=test.y + 0.01 * scored)))
    assert official_errors(setup, STEPS, moved)["test"] == pytest.approx(0.01, rel=1e-3)
