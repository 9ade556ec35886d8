"""
Neural hysterons with torchdiffeq
=================================

A small network takes the place of the dead zone of a hysteron and learns it from the displacement.

The network is sign-constrained: :math:`e\\,\\varphi(e) \\geq 0` for all weights, so that the model is passive before,
during and after training. ``torchdiffeq.odeint_adjoint`` solves it with the power-preserving step, which is its own
exact adjoint.
"""

# %%
# Data
# ----
# One hysteron with the dead zone of Table 1, a sine of 50 Hz from rest, 400 samples, 60 nm of noise.

import matplotlib.pyplot as plt
import numpy as np
import torch
import torchdiffeq

import phnn
from phnn.models import hrc
from phnn.models.neural import LearnedLaws, neural_hrc, thresholds

torch.manual_seed(0)
true = hrc(1)
t = np.linspace(0.0, 0.04, 401)
voltage = 75.0 * np.sin(2.0 * np.pi * 50.0 * t)
noise = 60e-9 * np.random.default_rng(0).standard_normal(t.size)
measured = torch.from_numpy(phnn.Model(phnn.Setup(true)).simulate(t, voltage) + noise)

# %%
# The model
# ---------
# The resistor starts as a dead zone that is 30 % too narrow. All other parameters stay at their values here.

values = {name: parameter.value for name, parameter in true.parameters.items()}
names = [name for name in values if not name.startswith(("rho", "d_"))]
narrow = values | {"d_1": 0.7 * values["d_1"]}
network = neural_hrc(1, LearnedLaws(width=8), start="parametric", values=narrow, hold=names)
system = phnn.PortHamiltonianSystem(network)
print(sum(weight.numel() for weight in system.parameters()), "weights")

# %%
# Training
# --------
# The input is a function of time. The steps are compiled, and the adjoint is the transpose of the same steps.

driven = system.with_input(lambda t: torch.stack([75.0 * torch.sin(2.0 * np.pi * 50.0 * t), 0.0 * t], dim=-1))
times = torch.from_numpy(t)
x0 = torch.zeros(len(system.state_names), dtype=torch.float64)
q = system.state_names.index(network.output)


def loss() -> torch.Tensor:
    """Mean square of the residual over noise."""
    states = torchdiffeq.odeint_adjoint(driven, x0, times, method="phnn")
    return (((states[:, q] - measured) / 60e-9) ** 2).mean()


optimizer = torch.optim.LBFGS(system.parameters(), max_iter=60, history_size=30, line_search_fn="strong_wolfe")
history = []


def closure() -> torch.Tensor:
    """One evaluation with its gradient."""
    optimizer.zero_grad()
    value = loss()
    value.backward()
    history.append(value.item())
    return value


_ = optimizer.step(closure)
print(f"{len(history)} gradients, loss {history[0]:.4g} → {min(history):.4g}")

# %%
# What it has learned
# -------------------
# The curve is compared where recordings visited it. The line through its inverse meets zero flow at the threshold;
# that of Table 1 is half the dead zone.

law = next(iter(system.laws.values()))
reach, largest = 2.0 * values["d_1"], values["alpha"] * 0.03
low, high = thresholds(law, largest, reach)
print(f"thresholds {low:.3f} V and {high:.3f} V, true ±{0.5 * values['d_1']:.3f} V")

effort = torch.linspace(-1.3, 1.3, 400, dtype=torch.float64) * 0.5 * values["d_1"]
with torch.no_grad():
    learned = law(effort)
dead_zone = values["rho_1"] * (effort - effort.clamp(-0.5 * values["d_1"], 0.5 * values["d_1"]))
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.4), layout="constrained")
left.semilogy(history)
left.set(xlabel="gradient", ylabel="loss", title="training")
right.plot(effort, 1e3 * dead_zone, color="0.7", linewidth=3, label="eq. (2), Table 1")
right.plot(effort, 1e3 * learned, label="learned")
right.set(xlabel="effort [V]", ylabel="flow [mA]", ylim=(-3.0, 3.0), title="resistor of the hysteron")
_ = right.legend()

# %%
# Hysteron 1 relaxes in a microsecond, so the slope outside its dead zone is hardly visible in these samples; the
# thresholds are. The start matters: with ``start="none"``, thresholds that follow from the drive alone, this short
# training ends after a few gradients at a loss of 4,496. :doc:`/learning` says which starts and trainers succeed.

print("passive:", bool((effort * learned >= 0.0).all()))
