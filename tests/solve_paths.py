"""A short integration of any network by every path that solves it, with gradients, and how far the results differ."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from typing import Any

import numpy as np
import torch
import torchdiffeq
from effect_homes import EFFECTS, FORMULAS, LEARNED, home, point
from junctions import random_junction
from networks import random_network, remembering
from subjects import _KINDS, NETWORKS, NetworkSubject, body

from phnn.integrate import kernel, sweep
from phnn.integrate.differentiable import Steps, simulated
from phnn.integrate.program import compile_network
from phnn.integrate.quick import serves
from phnn.integrate.scheme import Scheme, can_compile
from phnn.laws import RESISTOR_LAWS, STORAGE_LAWS
from phnn.network import Coupling, Network, PortHamiltonianSystem, Resistor, Storage
from phnn.parameters import Parameter, as_table

STEPS = 8
_REACH = 0.3
# Share of the fastest oscillation, or of the slowest decay where nothing oscillates, that a step takes.
_SHARE = 0.2
_ROUNDS = 3
_NOTHING = 1e-300


@dataclass(frozen=True, eq=False)
class Case:
    """A network with ``n`` steps to integrate: two sizes of step, inputs that jump, every state away from zero.

    Attributes:
        x0: (N,) initial state; u: (n, P) mean inputs; h: (n,) steps [s].
        scale: (N,) largest absolute value of every state.
        weights: (n+1, N) of the loss ``L = Σ w x / scale``, which looks at two instants.
    """

    network: Network
    x0: np.ndarray
    u: np.ndarray
    h: np.ndarray
    scale: np.ndarray
    weights: np.ndarray

    @property
    def instants(self) -> tuple[int, int]:
        """The steps after which the loss looks."""
        return _instants(self.h.size)

    @property
    def tensors(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Inputs, steps and initial state."""
        return torch.from_numpy(self.u), torch.from_numpy(self.h), torch.from_numpy(self.x0)

    @property
    def scaled_weights(self) -> np.ndarray:
        """(n+1, N) weights in units of the states."""
        return self.weights / np.where(self.scale > 0.0, self.scale, 1.0)

    def value(self, name: str) -> np.ndarray:
        """A parameter's value, or the largest of some weights."""
        known = self.network.parameters
        weights = dict(self.system.named_parameters())
        return np.array(known[name].value) if name in known else weights[name].detach().abs().max().numpy()

    @cached_property
    def system(self) -> PortHamiltonianSystem:
        return PortHamiltonianSystem(self.network)


@dataclass(frozen=True, eq=False)
class Solution:
    """What one path found.

    Attributes:
        states: (n+1, N).
        gradients: derivatives of the loss by parameters and weights, by name.
        sizes: sums of the absolute values of the terms of these derivatives, where they are known.
    """

    states: np.ndarray
    gradients: dict[str, Any]
    sizes: dict[str, Any] = field(default_factory=dict)


def _instants(steps: int) -> tuple[int, int]:
    return steps // 2, steps


def case_of(network: Network, steps: int = STEPS, seed: int = 0) -> Case:
    """A case that depends on the network, the number of steps and the seed alone."""
    random = np.random.default_rng(seed)
    subject = NetworkSubject(network)
    states = len(network.state_names)
    x0 = subject.typical.numpy()[0] * random.uniform(0.3, 1.0, states) * random.choice([-1.0, 1.0], states) * _REACH
    shape = random.choice([0.0, 1.0, -0.6], (steps, len(network.ports))) * random.uniform(0.5, 1.0, (steps, 1))
    h = _step(subject.system, x0) * np.where(np.arange(steps) < steps // 2, 1.0, 0.4)
    weights, size = np.zeros((steps + 1, states)), 1.0
    weights[list(_instants(steps))] = random.normal(size=(2, states))
    unforced = _states(subject.system, x0, 0.0 * shape, h)
    for _ in range(_ROUNDS):
        moved = np.abs(_states(subject.system, x0, size * shape, h) - unforced).max(0)
        reached = float((moved / (_REACH * subject.typical.numpy()[0])).max())
        size *= min(max(1.0 / reached, 1e-3), 1e3) if reached > 0.0 else 1.0
    path = _states(subject.system, x0, size * shape, h)
    return Case(network, x0, size * shape, h, np.abs(path).max(0), weights)


def _step(system: PortHamiltonianSystem, x0: np.ndarray) -> float:
    x, u = torch.from_numpy(x0), torch.zeros(len(system.network.ports), dtype=torch.float64)
    slope = torch.autograd.functional.jacobian(lambda z: system.vector_field(z, u), x)
    rates = torch.linalg.eigvals(slope)
    turning, falling = rates.imag.abs().max(), rates.real.abs()
    falling = falling[falling > 1e-9 * falling.max()]
    fastest = turning if turning > 0.0 else falling.min() if falling.numel() else torch.tensor(1.0)
    return float(_SHARE / fastest)


def _states(system: PortHamiltonianSystem, x0: np.ndarray, u: np.ndarray, h: np.ndarray) -> np.ndarray:
    with torch.no_grad():
        return simulated(system, *map(torch.from_numpy, (x0, u, h))).numpy()


def _physical(case: Case, states: torch.Tensor) -> dict[str, np.ndarray]:
    """Derivatives of the loss by the values of the free parameters and by the weights of learned laws."""
    system = case.system
    named = {name: p for name, p in system.named_parameters() if p.requires_grad}
    loss = (torch.from_numpy(case.scaled_weights) * states).sum()
    if not named or not loss.requires_grad:
        return {}
    found = torch.autograd.grad(loss, list(named.values()), allow_unused=True, materialize_grads=True)
    out = {}
    for (name, parameter), value in zip(named.items(), found, strict=True):
        key = name.removeprefix("free.z.")
        slope = torch.autograd.grad(system.value(key), parameter)[0] if key != name else 1.0
        out[key] = (value / slope).numpy()
    return out


def compiled(case: Case, scheme: Scheme, general: bool = False) -> Solution:
    """By the compiled march, gradients by forward sensitivities; laws of learned weights have none of these."""
    program = compile_network(case.network, scheme)
    theta, n = program.theta(case.network), case.h.size
    states, efforts = np.empty((n + 1, case.x0.size)), np.empty((n, case.x0.size))
    done = kernel.march(program, theta, case.x0, case.u, case.h, states, efforts, general)
    assert done == n, f"step {done} of {n} was not solved"
    free = [name for name in program.names if name in case.system.free]
    places = np.array([program.names.index(name) for name in free], dtype=np.int64)
    total, size = np.zeros(places.size), np.zeros(places.size)
    for k in case.instants:
        end, none = np.zeros((case.x0.size, places.size)), np.zeros(0, np.int64)
        march = sweep.Integrated(program, theta, states, efforts, case.u, case.h).first(k)
        sweep.sensitivities(march, sweep.by_parameters(places, k), np.zeros_like(end), none, np.arange(k + 1), end)
        total += case.scaled_weights[k] @ end
        size += np.abs(case.scaled_weights[k]) @ np.abs(end)
    return Solution(states, dict(zip(free, total, strict=True)), dict(zip(free, size, strict=True)))


def adjoint(case: Case, scheme: Scheme) -> Solution:
    """By the compiled march, gradients by its compiled adjoint sweep and the residual of the torch module."""
    u, h, x0 = case.tensors
    states = simulated(case.system, x0, u, h, scheme)
    return Solution(states.detach().numpy(), _physical(case, states))


def torch_step(case: Case, scheme: Scheme) -> Solution:
    """By the step that is solved in torch, gradients by the implicit function theorem."""
    u, h, x0 = case.tensors
    states = Steps(case.system, scheme).solve(x0, u, h)
    return Solution(states.detach().numpy(), _physical(case, states))


def torch_batch(case: Case, scheme: Scheme) -> Solution:
    """The same for a batch of which the case is the first member."""
    u, h, x0 = case.tensors
    starts, inputs = torch.stack([x0, 0.5 * x0]), torch.stack([u, 0.7 * u], dim=1)
    states = Steps(case.system, scheme).solve(starts, inputs, h)[:, 0]
    return Solution(states.detach().numpy(), _physical(case, states))


def torchdiffeq_step(case: Case, scheme: Scheme) -> Solution:
    """By torchdiffeq with the torch step and the adjoint of its steps, under an input that is a function of time."""
    u, h, x0 = case.tensors
    t = torch.cat([h.new_zeros(1), h.cumsum(0)])

    def held(time: torch.Tensor) -> torch.Tensor:
        return u[min(int(torch.searchsorted(t, time.detach(), right=True)) - 1, len(u) - 1)]

    solve = torchdiffeq.odeint_adjoint if case.x0.size < 12 else torchdiffeq.odeint
    states = solve(case.system.with_input(held), x0, t, method="phnn", options={"scheme": scheme})
    return Solution(states.detach().numpy(), _physical(case, states))


def paths(case: Case, scheme: Scheme, every: bool = True) -> dict[str, Solution]:
    """What every path finds that solves the case; the first one is that to compare with.

    Args:
        every: also by the paths that wrap others of them.
    """
    found = {}
    if can_compile(case.network):
        found = {"compiled": compiled(case, scheme)}
        if serves(compile_network(case.network, scheme)):
            found["compiled, general"] = compiled(case, scheme, general=True)
        found["compiled, adjoint"] = adjoint(case, scheme)
    found["torch"] = torch_step(case, scheme)
    if every:
        found["torch, batch"] = torch_batch(case, scheme)
        found["under torchdiffeq"] = torchdiffeq_step(case, scheme)
    return found


def apart(case: Case, one: Solution, other: Solution, weakest: float) -> tuple[float, float]:
    """Largest difference of states and of gradients.

    States are relative to the largest value of each, gradients to the sum of the absolute values of the terms of each.

    Args:
        weakest: a parameter whose relative change moves the loss by a smaller share than this of what the strongest
            one does counts as if it moved it by this share.
    """
    reach = np.where(case.scale > 0.0, case.scale, 1.0)
    states = float((np.abs(one.states - other.states).max(0) / reach).max())
    shared = one.gradients.keys() & other.gradients.keys()
    weight = {name: np.abs(case.value(name)) for name in shared}
    size = {n: weight[n] * max(one.sizes.get(n, 0.0), np.abs(one.gradients[n]).max(initial=0.0)) for n in shared}
    strongest = max((float(np.max(s)) for s in size.values()), default=0.0)
    gradients = 0.0
    for name in shared:
        change = weight[name] * np.abs(one.gradients[name] - other.gradients[name])
        gradients = max(gradients, float(np.max(change / np.maximum(size[name], weakest * strongest + _NOTHING))))
    return states, gradients


def effect_networks() -> Iterator[tuple[str, Network]]:
    """The network of every effect of the catalogue, of every learned element and every formula, at its home; those of
    imposed motions are the kernel's alone."""
    for effect in (e for e in (*EFFECTS, *LEARNED, *FORMULAS) if not home(e).setup.network.senses):
        yield f"effect {effect.name}", effect.add_to(home(effect).setup, point(effect)).network


def reducible_networks() -> Iterator[tuple[str, Network]]:
    """Every law of resistors on a storage of its own beside the body: alone, with a leak, reading, and with a ratio."""
    for name, law in RESISTOR_LAWS.items():
        names = tuple(f"leaf_{k}" for k in range(len(law.example)))
        table = [Parameter(n, v) for n, v in zip(names, law.example, strict=True)]
        table += [Parameter("C", 0.8), Parameter("g", 0.3), Parameter("beta", 0.6)]
        bending = tuple(f"bent_{k}" for k in range(len(STORAGE_LAWS["cubic_spring"].example)))
        table += [Parameter(n, v) for n, v in zip(bending, STORAGE_LAWS["cubic_spring"].example, strict=True)]
        base = body()
        parameters = as_table([*base.parameters.values(), *table])
        common = {"couplings": (*base.couplings, Coupling("x", "p", "beta")), "parameters": parameters}
        storages = (*base.storages, Storage("x", "capacitor", ("C",)))
        leaf, leak = Resistor("leaf", name, {"x": 1.0}, names), Resistor("leak", "linear", {"x": 1.0}, ("g",))
        lossy = (*base.resistors, leaf)
        yield f"leaf {name}", replace(base, storages=storages, resistors=lossy, **common)
        yield f"leaf {name} and a leak", replace(base, storages=storages, resistors=(*lossy, leak), **common)
        reading = (*base.resistors, replace(leaf, modulated_by="q"), leak)
        yield f"leaf {name} reading q", replace(base, storages=storages, resistors=reading, **common)
        scaled = (*base.resistors, replace(leaf, on={"x": "beta"}))
        yield f"leaf {name} by a ratio", replace(base, storages=storages, resistors=scaled, **common)
        bent = (*base.storages, Storage("x", "cubic_spring", bending))
        yield f"nonlinear leaf {name}", replace(base, storages=bent, resistors=lossy, **common)
    for kind, make in _KINDS.items():
        if not hasattr(make(2), "energy"):
            learned = Resistor("leaf", make(4), {"x": 1.0})
            yield f"leaf {kind}", replace(base, storages=storages, resistors=(*base.resistors, learned), **common)
    unknown = Resistor("leaf", _Cubic(), {"x": 1.0})
    yield "leaf of another module", replace(base, storages=storages, resistors=(*base.resistors, unknown), **common)


class _Cubic(torch.nn.Module):
    """A law that the kernel does not have."""

    monotone = True

    def __init__(self) -> None:
        super().__init__()
        self.rate = torch.nn.Parameter(torch.tensor(0.7, dtype=torch.float64))

    def forward(self, effort: torch.Tensor) -> torch.Tensor:
        return self.rate * (effort + effort**3)


def in_a_hurry() -> list[str]:
    """Names of networks that show every law and every topology, but not every law in every topology: each law of
    reducible storages alone and in one of the other surroundings, and half of the random networks."""
    others = ("leaf {} and a leak", "leaf {} reading q", "leaf {} by a ratio", "nonlinear leaf {}")
    left_out = {
        form.format(law)
        for place, law in enumerate(RESISTOR_LAWS)
        for k, form in enumerate(others)
        if k != place % len(others)
    }
    # The compiled march cannot take the last one, so that there are no paths to compare.
    left_out.add("leaf of another module")
    return [n for n in networks() if n not in left_out and not n.endswith((" 3", " 4", " 5"))]


@cache
def networks() -> dict[str, Callable[[], Network]]:
    """What makes every law, learned law, model and effect; random networks with one and with several junctions, and
    memories."""
    found = {name: lambda make=make: make().system.network for name, make in NETWORKS.items()}
    found |= {name: lambda net=net: net for name, net in (*effect_networks(), *reducible_networks())}
    for seed in range(6):
        found[f"junction {seed}"] = partial(random_junction, seed, stiff=False)
        found[f"stiff junction {seed}"] = partial(random_junction, seed)
        found[f"network {seed}"] = partial(random_network, seed)
        found[f"rich network {seed}"] = partial(random_network, seed, rich=True, monotone=True)
        found[f"junction with memories {seed}"] = lambda seed=seed: remembering(
            random_junction(seed, stiff=False), seed
        )
    return found
