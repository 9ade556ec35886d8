"""Black-box models that begin as linear ones, as is usual in nonlinear identification.

From weights at random some thousand steps go by before a latent model has found that displacement follows voltage. So
it starts as linear relaxations with the static gain of the recordings, none of whose values are fitted yet:

    neural ODE            T ẋ_i = λ_i (c_i u/U − x_i),  y = Y Σ x_i       one fast lag, slow ones over the recorded band
    fully neural PHS      mass, spring, damper and linear hysterons, scaled so that H = ½|x|² and y = Y x_1

References: Paduart et al. 2010; Schoukens & Ljung 2019 (best linear approximation as a start).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from phnn.learn.starts import unfitted
from phnn.models.fully_neural import FullyNeural
from phnn.models.neural_ode import NeuralODE
from phnn.recordings.recording import Campaign, Recording, dominant_frequency

# Of a neural ODE: rate of the fast lag over that of the highest frequency, and what each slow lag adds to the gain.
_FAST, _SLOW = 1.5, 0.1
# Points at which its perceptron is fitted, in typical sizes, and the ridge that keeps its weights small.
_POINTS, _REACH, _RIDGE = 4000, 1.5, 1e-6
# Layers that are less curved than usual carry a linear field within some percent.
_GENTLE = 0.5
# Size of what is left of random last layers: none at all would give the layers before them no gradient.
_LEFT = 0.05


@torch.no_grad()
def begin_linear(core: FullyNeural | NeuralODE, campaign: Campaign, seed: int) -> None:
    """Set the weights of a latent model such that it begins as linear relaxations.

    Args:
        core: changed in place.
        campaign: gives gain and band, from the recordings for identification.
        seed: of the points at which a perceptron is fitted.
    """
    if isinstance(core, NeuralODE):
        recordings = [r for r in campaign.recordings if r.mask("identification").any()]
        _lags(core, recordings, torch.Generator().manual_seed(seed))
    else:
        _hysterons(core, campaign)


def _lags(core: NeuralODE, recordings: Sequence[Recording], random: torch.Generator) -> None:
    """The field ``−λ_i x_i + λ_i c_i u`` by least squares in the last layer."""
    n = core.states
    slow = [2.0 * np.pi * dominant_frequency(r) * core.scales.time for r in recordings]
    rates = torch.cat([torch.tensor([_FAST]).double(), _spread(min(slow), max(slow), n - 1)])
    gains = torch.full((n,), _SLOW, dtype=torch.float64)
    gains[0] = 1.0 - _SLOW * (n - 1)
    points = _REACH * (2.0 * torch.rand(_POINTS, n + 1, generator=random, dtype=torch.float64) - 1.0)
    wanted = rates * (gains * points[:, -1:] - points[:, :-1])
    hidden = points
    for weight, bias in zip(core.field.weights[:-1], core.field.biases[:-1], strict=True):
        weight.mul_(_GENTLE)
        hidden = torch.tanh(hidden @ weight.mT + bias)
    columns = torch.cat([hidden, torch.ones(_POINTS, 1, dtype=torch.float64)], dim=1)
    normal = columns.mT @ columns + _RIDGE * _POINTS * torch.eye(columns.shape[1], dtype=torch.float64)
    found = torch.linalg.solve(normal, columns.mT @ wanted)
    core.field.weights[-1].copy_(found[:-1].mT)
    core.field.biases[-1].copy_(found[-1])
    core.readout.fill_(1.0)


def _spread(low: float, high: float, count: int) -> Tensor:
    """Rates evenly over a band, logarithmically."""
    return torch.logspace(np.log10(low), np.log10(high), count, dtype=torch.float64)


def _hysterons(core: FullyNeural, campaign: Campaign) -> None:
    """Displacement, momentum and the charges of linear hysterons, in units of the root of their energy."""
    count = core.states - 2
    values = unfitted(campaign, count)
    m, k, b, alpha = (values[name] for name in ("m", "k", "b", "alpha"))
    capacities = [values[f"C_{i + 1}"] for i in range(count)]
    unit = k * core.scales.output**2
    roots = torch.tensor([k, 1.0 / m, *(1.0 / c for c in capacities)], dtype=torch.float64).div(unit).sqrt()
    structure = torch.zeros(core.states, core.states, dtype=torch.float64)
    structure[1, 0], structure[2:, 1] = -1.0, alpha
    loss = torch.tensor([0.0, b, *(values[f"rho_{i + 1}"] for i in range(count))], dtype=torch.float64)
    factor = core.scales.time * unit
    _constant(
        core.skew, (factor * roots[:, None] * structure * roots)[*torch.tril_indices(core.states, core.states, -1)]
    )
    lower = torch.diag((factor * roots**2 * loss).sqrt())
    _constant(core.lower, lower[*torch.tril_indices(core.states, core.states)])
    core.inlet.zero_()
    core.inlet[1] = core.scales.time * core.scales.input * roots[1] * alpha


def _constant(perceptron: torch.nn.Module, values: Tensor) -> None:
    """A perceptron that gives nearly the same everywhere."""
    perceptron.weights[-1].mul_(_LEFT)  # type: ignore[index]
    perceptron.biases[-1].copy_(values)  # type: ignore[index]
