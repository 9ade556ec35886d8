"""Systems of latent states of which everything is learned: one that is port-Hamiltonian, and one without structure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from phnn.errors import InputRefused
from phnn.network.bounded import LARGEST_WEIGHT, check_weights
from phnn.network.elements import MultiPort, Network, Port, SharedEnergy, Storage
from phnn.network.system import PortHamiltonianSystem
from phnn.nn.multi_ports import LearnedCoupling, LearnedDissipation, LearnedEnergy, Perceptron
from phnn.parameters import Parameter, as_table, positive

# Relative size of the damping that is added where a linear start has none.
_LEAST_DAMPING = 1e-6
# Share of a random start that a system near another one keeps in its coupling and in the scale of its learned energy.
# With ten times as much the loss at the start is 16 times as large near the identified actuator of docs/train.md.
_KEPT = (0.005, 0.1)
# At so many states a dissipation is fitted.
_POINTS = 4000


@dataclass(frozen=True)
class Scales:
    """What one dimensionless unit is.

    Attributes:
        time: [s]; input: [SI]; output: [SI].

    Raises:
        InputRefused: one of them is not positive.
    """

    time: float = 1.0
    input: float = 1.0
    output: float = 1.0

    def __post_init__(self) -> None:
        for name, value in (("time", self.time), ("input", self.input), ("output", self.output)):
            if not 0.0 < value < float("inf"):
                raise InputRefused(f"the scale of the {name} is {value:g}: give a positive typical magnitude in SI")


class LearnedSystem(PortHamiltonianSystem):
    """A port-Hamiltonian system of latent states, everything learned, passive whatever the weights.

        system = phnn.nn.LearnedSystem(states=4, ports=2)
        x, y = phnn.simulate(system, u, dt=1e-4)

        ẋ = [J(x) − D(∇H)] ∇H(x) + g u,     y = gᵀ∇H(x),     H(x) = ½ Σ_i k_i x_i² + H_s(x)

    It is a network of springs ``k_i``, one `LearnedCoupling` that reads all states, one `LearnedDissipation` on all
    efforts, one `LearnedEnergy` of all states and learned columns ``g``; so it does all that other networks do. The
    first state is measured.

    Attributes:
        from_given: (n, n) matrix from the states of the system that it was made near to, to its own.

    Args:
        states: their number, or their names.
        ports: their number, or their names.
        width: of the hidden layers, and number of units of the energy.
        scales: of time, inputs and the first state; the other states have none, and energies are dimensionless.
        seed: of the initial weights.

    Raises:
        InputRefused: fewer than two states, no port, or no unit.
    """

    from_given: Tensor

    def __init__(
        self,
        states: int | Sequence[str] = 4,
        ports: int | Sequence[str] = 1,
        width: int = 32,
        scales: Scales | None = None,
        seed: int = 0,
    ) -> None:
        names = tuple(f"x_{k + 1}" for k in range(states)) if isinstance(states, int) else tuple(states)
        inlets = [f"u_{k + 1}" for k in range(ports)] if isinstance(ports, int) else list(ports)
        n = len(names)
        if n < 2 or not inlets or width < 1:
            raise InputRefused(
                f"{n} states, {len(inlets)} ports, width = {width}: give two states, one port and one unit at least"
            )
        self.scales = scales = scales or Scales()
        size = [scales.output, *[1.0] * (n - 1)]
        efforts, flows = [1.0 / s for s in size], [s / scales.time for s in size]
        random = torch.Generator().manual_seed(seed)
        drawn = torch.randn(n, len(inlets), generator=random, dtype=torch.float64).tolist()
        table = [replace(positive(f"k_{x}", 1.0 / s**2, "1"), fixed=True) for x, s in zip(names, size, strict=True)]
        table += [
            Parameter(f"g_{x}_{p}", drawn[i][j] * flows[i] / scales.input, typical=flows[i] / scales.input)
            for i, x in enumerate(names)
            for j, p in enumerate(inlets)
        ]
        coupling = MultiPort("coupling", LearnedCoupling(n, n, efforts, flows, size, width, seed), names, names)
        dissipation = MultiPort("dissipation", LearnedDissipation(n, 0, efforts, flows, (), width, seed + 1), names)
        network = Network(
            storages=tuple(Storage(x, "spring", (f"k_{x}",)) for x in names),
            resistors=(),
            couplings=(),
            ports=tuple(Port(p, {x: f"g_{x}_{p}" for x in names}, unit="1") for p in inlets),
            parameters=as_table(table),
            output=names[0],
            multi_ports=(coupling, dissipation),
            shared_energies=(SharedEnergy("energy", LearnedEnergy(n, size, 1.0, width, seed + 2), names),),
        )
        super().__init__(network)

    @classmethod
    @torch.no_grad()
    def near(
        cls,
        system: PortHamiltonianSystem,
        scales: Scales,
        width: int = 32,
        seed: int = 0,
        typical: Tensor | None = None,
    ) -> LearnedSystem:
        """Return a learned system that begins near another one, linearised at rest but for its dissipation.

        Args:
            system: without modulator states, every energy with a curvature at rest; its states are taken in units in
                which its energy is ``½ |x|²``, the measured one first.
            scales: of time and inputs; the unit of the output is that of ``scales`` too.
            typical: (n,) largest states, up to which the dissipation is that of the other system as a function of the
                efforts; None takes its value at rest.

        Raises:
            InputRefused: an energy has no curvature at rest, or the network has modulator states.
        """
        network = system.network
        output = network.storage_names.index(network.output)
        order = [output, *(k for k in range(len(network.storages)) if k != output)]
        rest = torch.zeros(len(order), dtype=torch.float64)
        with torch.enable_grad():
            at = rest.clone().requires_grad_()
            efforts = torch.stack([system.mean_effort(k, x, x) for k, x in enumerate(at)])
            curvature = torch.autograd.grad(efforts.sum(), at)[0]
        if network.memories or not bool((curvature > 0.0).all()):
            raise InputRefused("a linear start needs energies with a curvature at rest and no modulator states")
        learned = cls([network.storage_names[k] for k in order], [p.name for p in network.ports], width, scales, seed)
        # In joules the unit of energy is that of the output at its scale.
        unit = curvature[output] * scales.output**2
        root = (curvature / unit).sqrt()[order]
        half = scales.time * unit * root[:, None] * system.structure(rest)[order][:, order] * root
        coupling, dissipation = (m.law for m in learned.network.multi_ports)
        n = len(order)
        coupling.entries.begin(half[*torch.tril_indices(n, n, -1)], _KEPT[0])
        learned.network.shared_energies[0].law.typical.mul_(_KEPT[1])
        reach, rows = (0.0 * rest if typical is None else typical), torch.tril_indices(n, n)
        points = (2.0 * torch.rand(_POINTS, n, generator=torch.Generator().manual_seed(seed)).double() - 1.0) * reach
        lost = scales.time * unit * root[:, None] * system.dissipation(points)[:, order][:, :, order] * root
        lost = lost + _LEAST_DAMPING * (1.0 + lost.diagonal(dim1=1, dim2=2).mean()) * torch.eye(n, dtype=torch.float64)
        factors = torch.linalg.cholesky(lost)[:, *rows]
        diagonal = lost.diagonal(dim1=1, dim2=2)
        bent = torch.nonzero(diagonal.std(0) > _LEAST_DAMPING * diagonal.mean()).flatten()
        if len(bent):
            # Units along the axes of the efforts that bend the dissipation: a threshold lies across one of them.
            dissipation.entries.spread((root * reach[order]), bent)
            dissipation.entries.fit(points[:, order] * root, factors)
        else:
            dissipation.entries.begin(factors[0])
        size = torch.tensor([scales.output, *[1.0] * (n - 1)], dtype=torch.float64)
        learned.from_given = (size * root)[:, None] * torch.eye(n, dtype=torch.float64)[order]
        columns = learned.from_given @ system.incidences(rest)[1]
        learned.set_values(
            {
                f"g_{name}_{p.name}": columns[i, j].item()
                for i, name in enumerate(learned.state_names)
                for j, p in enumerate(network.ports)
            }
        )
        return learned


class NeuralODE(nn.Module):
    """``T ẋ = f(x, u/U) − f(0, 0)``, ``y = Y c x`` with a perceptron ``f`` and a learned row ``c``.

    Nothing keeps it passive, nor even stable; only zero input holds the zero state, so that a recording from rest
    starts there. `torchdiffeq` solves it: it has no energy that a discrete gradient could be taken of.

    Args:
        scales: ``T``, ``U`` and ``Y``; the states have none.
        states: number of latent states.
        width: of two hidden layers.
        seed: of the initial weights.

    Raises:
        InputRefused: no state, or no unit.
        SolverFailed: at an evaluation, where training has carried a weight beyond use; names it.

    References: Chen, Rubanova, Bettencourt & Duvenaud 2018.
    """

    def __init__(self, scales: Scales, states: int = 4, width: int = 32, seed: int = 0) -> None:
        super().__init__()
        if states < 1 or width < 1:
            raise InputRefused(f"states = {states}, width = {width}: give one state and one unit at least")
        random = torch.Generator().manual_seed(seed)
        self.scales = scales
        self.states = states
        self.field = Perceptron((states + 1, width, width, states), random, last=0.5)
        drawn = torch.randn(states, generator=random, dtype=torch.float64)
        self.readout = nn.Parameter(drawn * states**-0.5)

    def vector_field(
        self,
        x: Tensor,  # (..., n)
        u: Tensor,  # (..., 1) [V]
    ) -> Tensor:
        """Return (..., n) ``ẋ`` [1/s]."""
        check_weights(self, largest=LARGEST_WEIGHT)
        both = torch.cat([x, (u / self.scales.input).expand(*x.shape[:-1], 1)], dim=-1)
        return (self.field(both) - self.field(both.new_zeros(both.shape[-1]))) / self.scales.time

    def measured(self, x: Tensor) -> Tensor:  # x: (..., n)
        """Return (...) ``y`` [m]."""
        return self.scales.output * (x @ self.readout)
