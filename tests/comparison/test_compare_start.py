"""Black boxes that begin linear: what they begin with, and that a thinned recording keeps its weight."""

from __future__ import annotations

from dataclasses import replace

import compare_example as example
import numpy as np
import pytest
import torch

from phnn.comparison.training import _stride, _thinned, begin_linear
from phnn.learn.plant import LatentPlant
from phnn.learn.starts import scales_of, unfitted
from phnn.models.actuator import hrc
from phnn.models.fully_neural import FullyNeural
from phnn.models.neural_ode import NeuralODE
from phnn.network.system import PortHamiltonianSystem
from phnn.recordings import Campaign, read


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    return read(example.written(tmp_path_factory.mktemp("start") / "recordings"))


def test_a_fully_neural_model_begins_with_the_modes_of_linear_hysterons(campaign: Campaign) -> None:
    core = FullyNeural(scales_of(campaign.recordings), 4, 8)
    begin_linear(core, campaign, 0)
    at, rest = torch.zeros(4, dtype=torch.float64), torch.zeros(1, dtype=torch.float64)
    found = torch.linalg.eigvals(torch.func.jacfwd(lambda x: core.vector_field(x, rest))(at))
    values = {n: 0.0 if n.startswith("d_") else v for n, v in unfitted(campaign, 2).items()}
    system = PortHamiltonianSystem(hrc(2, values | {"d_1": 1e-9, "d_2": 1e-9}))
    # Beyond the closed dead zones the network is linear.
    x = system.efforts(at).new_tensor([1e-3, 1e-3, 1e-3, 1e-3])
    both = torch.zeros(len(system.network.ports), dtype=torch.float64)
    wanted = torch.linalg.eigvals(torch.func.jacfwd(lambda s: system.vector_field(s, both))(x))
    sizes = [np.sort(np.abs(v.detach().numpy())) for v in (found, wanted)]
    ratio = sizes[0] / sizes[1]
    assert np.all(np.abs(np.log(ratio)) < 0.3)


def test_a_thinned_recording_keeps_its_weight(campaign: Campaign) -> None:
    recipe = replace(example.settings().recipes["neural_ode"], longest_step=0.2)
    plant = LatentPlant(NeuralODE(scales_of(campaign.recordings), 2, 3))
    chosen = [r for r in campaign.recordings if r.mask("identification").any()]
    found = _thinned(chosen, recipe, plant)
    assert len({f.t.size for f in found}) == 2
    for f, r in zip(found, chosen, strict=True):
        share = f.t.size / f.noise**2 / sum(x.t.size for x in found)
        assert share == pytest.approx(r.t.size / r.noise**2 / sum(x.t.size for x in chosen), rel=1e-12)
    assert _stride(chosen[0], 1.0, 20) * 20 <= chosen[0].period / chosen[0].dt
    assert _stride(chosen[0], 0.5 * chosen[0].dt, 20) == 1
