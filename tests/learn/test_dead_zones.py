"""Hysterons with learned resistors find dead zones of which they were told nothing."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from phnn.configuration import compose_groups
from phnn.learn import Settings, train
from phnn.learn.characteristic import inverse, thresholds
from phnn.models.store import load
from phnn.recordings import read
from phnn.simulate import simulate
from studies.generator.world import TABLE
from studies.recordings import Conditions, write_recordings


@pytest.mark.slow
def test_two_hysterons_learn_dead_zones_they_were_not_told_of(tmp_path: Path) -> None:
    # The generator shares no code with the model: four sines to train on, three more, a step and a chirp held out.
    folder, out = tmp_path / "recordings", tmp_path / "out"
    write_recordings(folder, Conditions(noise_um=0.05, seed=5))
    overrides = ("model.start=none", "stride=5", "substeps=2", "gauss_newton=100", "patience=30", "validation=[]")
    settings = compose_groups("train", [f"folder={folder}", f"out={out}", "tensorboard=false", *overrides])
    content = train(Settings.from_config(settings))
    assert json.loads((out / "metrics.json").read_text()) == content
    assert content["held_out_over_noise"] < 1.3
    assert content["passivity"] == {"states": 10_000, "violations": 0}
    setup, substeps = load(out / "model")
    trained = [r for r in read(folder).recordings if r.mask("identification").any()]
    states = np.concatenate([simulate(setup, r, substeps).states for r in trained])
    for i in (1, 2):
        law, half = setup.network.resistors[i - 1].law, 0.5 * TABLE[f"d_{i}"]
        visited = torch.from_numpy(states[:, i - 1] / setup.values()[f"C_{i}"])
        largest = 0.9 * float(law(visited).detach().abs().max())
        for found in thresholds(law, largest, 3.0 * half):
            assert abs(found) == pytest.approx(half, rel=0.01)
        flows = np.linspace(0.05, 1.0, 30) * largest
        exact = flows / TABLE[f"rho_{i}"] + half
        assert np.abs(inverse(law, flows, 4.0 * half) - exact).max() < 0.03 * half
