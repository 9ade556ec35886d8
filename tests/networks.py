"""Random port-Hamiltonian networks for property tests: every registered law, shared ratios, any topology."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from hypothesis import strategies as st
from torch import Tensor, nn

from phnn.integrate.differentiable import Steps, port_inputs
from phnn.integrate.equations import step_balance
from phnn.integrate.scheme import Scheme
from phnn.laws import FACTOR_LAWS, PORT_LAWS, RESISTOR_LAWS, STORAGE_LAWS
from phnn.network import (
    Coupling,
    Modulation,
    ModulatorState,
    Network,
    Port,
    PortHamiltonianSystem,
    Ratio,
    Resistor,
    Storage,
)
from phnn.network.checks import PowerBalance
from phnn.nn import ConvexEnergyMLP, MonotoneMLP
from phnn.parameters import Parameter, as_table, positive


class _Draw:
    """Draws elements and collects the parameters they refer to."""

    def __init__(self, seed: int) -> None:
        self.random = np.random.default_rng(seed)
        self.parameters = [
            Parameter("alpha", float(self.random.uniform(0.2, 2.0))),
            Parameter("beta", float(self.random.normal()), fixed=True),
        ]

    def ratio(self) -> Ratio:
        kind = self.random.integers(4)
        return ("alpha", "beta", 1.0, float(self.random.normal()))[kind]

    def on(self, names: list[str]) -> dict[str, Ratio]:
        count = int(self.random.integers(1, min(3, len(names)) + 1))
        return {str(name): self.ratio() for name in self.random.choice(names, count, replace=False)}

    def on_linear(self, names: list[str], stores: list[Storage]) -> dict[str, Ratio]:
        """One storage, or several linear ones: the end state of a nonlinear one that is joined with others is itself an
        unknown, whose rounding a resistor of 1e9 1/s makes larger than 1e-10 of everything else."""
        linear = [s.name for s in stores if s.law in ("capacitor", "spring")]
        if len(linear) < 2 or self.random.random() < 0.5:
            return {str(self.random.choice(names)): self.ratio()}
        return self.on(linear)

    def values(self, element: str, example: tuple[float, ...]) -> tuple[str, ...]:
        names = tuple(f"{element}_{k}" for k in range(len(example)))
        for name, value in zip(names, example, strict=True):
            fixed = bool(self.random.random() < 0.3)
            self.parameters.append(Parameter(name, float(value * np.exp(0.5 * self.random.normal())), fixed=fixed))
        return names

    def make_stiff(self, element: str, law: str) -> None:
        """A rate between 1e-3 and 1e9 1/s beside storages of about one; of a Maxwell cell it is the time constant."""
        rate = float(10.0 ** self.random.uniform(-3.0, 9.0))
        name, value = (f"{element}_1", 1.0 / rate) if law == "maxwell" else (f"{element}_0", rate)
        self.parameters = [Parameter(name, value) if p.name == name else p for p in self.parameters]


def random_network(
    seed: int,
    storages: int = 4,
    resistors: int = 3,
    ports: int = 2,
    monotone: bool = False,
    stiff: float = 1.0,
    rich: bool = False,
) -> Network:
    """A network that depends on the seed alone.

    Args:
        monotone: only convex energies and monotone resistors, and no law that follows a state: every step then has
            exactly one solution.
        stiff: factor on one resistor's first parameter.
        rich: neural laws and a modulated ratio among the elements, and every resistor's rate from 1e-3 to 1e9 1/s.
    """
    draw = _Draw(seed)
    names = [f"x{k}" for k in range(storages)]
    storage_laws = [law for law in STORAGE_LAWS.values() if law.bounded and (law.convex or not monotone)]
    # Of laws that follow the path alone no rate can be drawn: networks that are rich in rates leave them out.
    apart = [n for n, law in RESISTOR_LAWS.items() if n == "plastic" or (rich and law.path)]
    resistor_laws = [law for n, law in RESISTOR_LAWS.items() if (law.monotone or not monotone) and n not in apart]
    port_laws = list(PORT_LAWS.values())
    pick = draw.random.choice
    stores, hindrances, entries, couplings = [], [], [], []
    for name in names:
        law = pick(storage_laws)  # type: ignore[arg-type]
        if rich and draw.random.random() < 0.15:
            stores.append(Storage(name, ConvexEnergyMLP(1.0, float(draw.random.uniform(0.5, 2.0)), 4)))
        else:
            stores.append(Storage(name, law.name, draw.values(name, law.example)))
    for r in range(resistors):
        law = pick(resistor_laws)  # type: ignore[arg-type]
        modulator = str(pick(names)) if draw.random.random() < 0.5 and not monotone else None
        if rich and draw.random.random() < 0.15:
            learned = MonotoneMLP(1.0, float(10.0 ** draw.random.uniform(-3.0, 9.0)), 4)
            hindrances.append(Resistor(f"r{r}", learned, draw.on_linear(names, stores) if monotone else draw.on(names)))
            continue
        on = draw.on_linear(names, stores) if rich and monotone else draw.on(names)
        hindrances.append(Resistor(f"r{r}", law.name, on, draw.values(f"r{r}", law.example), modulator))
        if rich:
            draw.make_stiff(f"r{r}", law.name)
    for p in range(ports):
        law = pick(port_laws)  # type: ignore[arg-type]
        entries.append(Port(f"u{p}", draw.on(names), law.name, draw.values(f"u{p}", law.example)))
    for _ in range(2 * storages):
        to, of = pick(names, 2, replace=False) if storages > 1 else (names[0], names[0])
        couplings.append(Coupling(str(to), str(of), draw.ratio()))
    modulations: list[Modulation] = []
    if rich and not monotone and draw.random.random() < 0.5:
        law = FACTOR_LAWS["affine"]
        modulations = [Modulation("alpha", str(pick(names)), law.name, draw.values("factor", law.example))]
    network = Network(
        tuple(stores), tuple(hindrances), tuple(couplings), tuple(entries), as_table(draw.parameters), names[0],
        tuple(modulations),
    )  # fmt: skip
    if stiff != 1.0 and hindrances:
        name = hindrances[0].parameters[0]
        network = network.with_values({name: stiff * network.parameters[name].value})
    return network


def remembering(network: Network, seed: int) -> Network:
    """The network with a temperature that all resistors raise, a memory of an effort and one of the inputs.

    Resistors follow any of them. A ratio follows the inputs alone: one that grows with what it drives may run away.
    Time constants are about one second, so that there is something to follow.
    """
    random = np.random.default_rng(seed)
    ports = tuple(p.name for p in network.ports)
    memories = (
        ModulatorState("theta", "thermal", ("C_T", "R_T", "T_a", "T_ref"), unit="K"),
        ModulatorState("zeta", "exceeding", ("tau", "s0"), (str(random.choice(network.storage_names)),)),
        *([ModulatorState("xi", "relaxing", ("tau",), ports)] if ports else []),
    )
    values = {"C_T": 1.0, "R_T": 1.0, "tau": 1.0, "s0": 0.5, "kappa": 0.2, "scale": 1.0}
    parameters = [Parameter(n, float(v * np.exp(0.5 * random.normal()))) for n, v in values.items()]
    parameters += [Parameter("T_a", 296.0), Parameter("T_ref", 293.0)]
    names = [m.name for m in memories]

    def follows(r: Resistor) -> Resistor:
        free = isinstance(r.law, str) and (r.modulated_by is None or random.random() < 0.5)
        return replace(r, modulated_by=str(random.choice(names))) if free else r

    modulations = network.modulations
    if ports:
        modulations = (*modulations, Modulation("alpha", "xi", "affine", ("kappa", "scale")))
    return replace(
        network,
        resistors=tuple(map(follows, network.resistors)),
        modulations=modulations,
        memories=memories,
        parameters=as_table((*network.parameters.values(), *parameters)),
    )


@st.composite
def networks(draw: st.DrawFn, monotone: bool = False) -> Network:
    """Networks of one to six storages; drawn by seed and sizes, so that a failure is reproduced by five numbers."""
    return random_network(
        draw(st.integers(0, 2**31 - 1)),
        draw(st.integers(1, 6)),
        draw(st.integers(0, 5)),
        draw(st.integers(0, 3)),
        monotone,
    )


def random_states(network: Network, seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """(count, n) states, some entries exactly zero, and (count, P) inputs."""
    random = np.random.default_rng(seed)
    x = random.normal(size=(count, len(network.storages))) * 10.0 ** random.uniform(-3, 0.5, (count, 1))
    x[random.random(x.shape) < 0.1] = 0.0
    return x, random.normal(size=(count, len(network.ports)))


def solve_dense(
    system: PortHamiltonianSystem, x0: Tensor, u_mean: Tensor, h: float, scheme: Scheme = Scheme.DISCRETE_GRADIENT
) -> Tensor:
    """(N+1, ..., n) states by the step in torch, whatever kernels there are."""
    return Steps(system, scheme).solve(x0, port_inputs(system, u_mean, x0.ndim - 1), x0.new_full(u_mean.shape[:1], h))


def ledger(
    system: PortHamiltonianSystem,
    states: Tensor,  # (N+1, ..., n) of a solve
    u_mean: Tensor,  # (N, ..., P) or (N,)
    h: float,
    scheme: Scheme = Scheme.DISCRETE_GRADIENT,
) -> PowerBalance:
    """Mean powers of every step (N, ...) at the mean efforts of the step, which balance the energy exactly; nodal
    efforts do not."""
    return step_balance(system, states[:-1], states[1:], port_inputs(system, u_mean, states.ndim - 2), h, scheme)


def shaken(law: nn.Module, seed: int, size: float) -> nn.Module:
    """The law with weights moved far from their initial values."""
    random = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for weight in law.parameters():
            weight.add_(size * torch.randn(weight.shape, generator=random, dtype=torch.float64))
    return law


class Falling(nn.Module):
    """A sector law that falls so steeply that long steps have no connected solution."""

    def forward(self, effort: Tensor) -> Tensor:
        return 50.0 * effort * torch.exp(-((effort / 0.1) ** 2))


class Quartic(nn.Module):
    """``H = x²/2 + a x⁴/4`` as a user would write it, with nothing but an energy."""

    def __init__(self) -> None:
        super().__init__()
        self.a = nn.Parameter(torch.tensor(0.7, dtype=torch.float64))

    def energy(self, x: Tensor) -> Tensor:
        return 0.5 * x**2 + 0.25 * self.a * x**4


def oscillator(storage: object = "spring", resistor: object = "linear") -> Network:
    """A driven mass on a spring with a damper, whose laws can be exchanged."""
    return Network(
        (Storage("q", storage, ("k",) if isinstance(storage, str) else ()), Storage("p", "capacitor", ("m",))),
        (Resistor("damper", resistor, {"p": 1.0}, ("b",) if isinstance(resistor, str) else ()),),
        (Coupling("q", "p"),),
        (Port("force", {"p": 1.0}),),
        as_table([positive("m", 2.0, "kg"), positive("k", 8.0, "N/m"), positive("b", 0.5, "N s/m")]),
    )
