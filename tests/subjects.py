"""Every law, learned law and model of the package as something that can be trained; found by looking, not by a list."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import typing
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from networks import remembering
from torch import Tensor, nn

import phnn.models
import phnn.nn
from phnn.laws import FACTOR_LAWS, MEMORY_LAWS, PORT_LAWS, RESISTOR_LAWS, STORAGE_LAWS
from phnn.models.network_file import load_network, ready
from phnn.models.store import _KINDS
from phnn.network import (
    Coupling,
    Modulation,
    ModulatorState,
    MultiPort,
    Network,
    Port,
    PortHamiltonianSystem,
    Resistor,
    SharedEnergy,
    Storage,
)
from phnn.parameters import Parameter, as_table, positive
from phnn.recordings.manifest import READY
from phnn.setup import Setup

CONFIGS = Path(phnn.models.__file__).parents[1] / "configs" / "network"
# Energy at which states of a network count as typical [J].
_ENERGY = 1e-3


class Subject(Protocol):
    """A trainable system with states at random."""

    module: nn.Module

    def states(self, count: int, seed: int, reach: float) -> tuple[Tensor, Tensor]:
        """(count, n) states up to ``reach`` times typical ones, and (count, P) inputs."""

    def supplied(self, efforts: Tensor, x: Tensor, u: Tensor) -> Tensor:
        """(count,) power of the ports."""

    def balanced_rate(self, efforts: Tensor, x: Tensor, u: Tensor) -> Tensor:
        """(count, n) rate of the states with energy."""

    def lost(self, efforts: Tensor, x: Tensor) -> Tensor:
        """(count,) dissipated power at efforts of a step."""


def _spread(shape: tuple[int, int], seed: int, reach: float) -> Tensor:
    """Signs and sizes over nine decades up to ``reach``, one entry in ten zero."""
    random = torch.Generator().manual_seed(seed)
    size = reach * 10.0 ** (-9.0 * torch.rand(shape, generator=random, dtype=torch.float64).square())
    values = size * torch.randn(shape, generator=random, dtype=torch.float64)
    return values * (torch.rand(shape, generator=random) > 0.1)


class NetworkSubject:
    """A network of one-ports."""

    def __init__(self, network: Network) -> None:
        self.module = self.system = PortHamiltonianSystem(network)
        probe = torch.full((1, len(network.state_names)), 1e-6, dtype=torch.float64)
        stiffness = (self.system.efforts(probe) / 1e-6).abs().detach().clamp_min(1e-3)
        self.typical = torch.ones_like(probe)
        self.typical[:, : stiffness.shape[-1]] = (2.0 * _ENERGY / stiffness).sqrt()

    def _like(self, values: Tensor) -> Tensor:
        return values.to(next(self.module.parameters()).dtype)

    def states(self, count: int, seed: int, reach: float) -> tuple[Tensor, Tensor]:
        x = self.typical * _spread((count, self.typical.shape[-1]), seed, reach)
        u = _spread((count, len(self.system.network.ports)), seed + 1, 100.0)
        return self._like(x), self._like(u)

    def supplied(self, efforts: Tensor, x: Tensor, u: Tensor) -> Tensor:
        return self.system.power(efforts, x, u, efforts[..., 0]).supplied.sum(-1)

    def lost(self, efforts: Tensor, x: Tensor) -> Tensor:
        still = efforts.new_zeros(*x.shape[:-1], len(self.system.network.ports))
        return self.system.power(efforts, x, still, efforts[..., 0]).dissipated.sum(-1)

    def balanced_rate(self, efforts: Tensor, x: Tensor, u: Tensor) -> Tensor:
        return self.system.rate(efforts, x, u)


def body(
    storage: Any = "spring", resistor: Any = "linear", port: str = "linear", reads: str | None = None, **more: Any
) -> Network:
    """A driven mass on a spring with a damper, each law of which can be exchanged; parameters as plain as can be."""
    table: list[Parameter] = [positive("m", 2.0, "kg")]

    def named(kind: str, law: Any, laws: dict[str, Any]) -> tuple[str, ...]:
        if not isinstance(law, str):
            return ()
        names = tuple(f"{kind}_{k}" for k in range(len(laws[law].example)))
        table.extend(Parameter(n, v) for n, v in zip(names, laws[law].example, strict=True))
        return names

    network = Network(
        (Storage("q", storage, named("s", storage, STORAGE_LAWS)), Storage("p", "capacitor", ("m",))),
        (Resistor("damper", resistor, {"p": 1.0}, named("r", resistor, RESISTOR_LAWS), reads),),
        (Coupling("q", "p", "ratio"),),
        (Port("force", {"p": "ratio"}, port, named("u", port, PORT_LAWS)),),
        as_table([*table, Parameter("ratio", 1.2)]),
    )
    return replace(network, **more)


def modulated(law: str) -> Network:
    """The body with a ratio that follows its displacement."""
    names = tuple(f"f_{k}" for k in range(len(FACTOR_LAWS[law].example)))
    base = body()
    more = [Parameter(n, v) for n, v in zip(names, FACTOR_LAWS[law].example, strict=True)]
    table = as_table([*base.parameters.values(), *more])
    return replace(base, modulations=(Modulation("ratio", "q", law, names),), parameters=table)


def slow(law: str) -> Network:
    """The body with a memory that its damper follows."""
    names = tuple(f"z_{k}" for k in range(len(MEMORY_LAWS[law].example)))
    base = body(resistor="thermal_dead_zone")
    more = [Parameter(n, v) for n, v in zip(names, MEMORY_LAWS[law].example, strict=True)]
    table = as_table([*base.parameters.values(), *more])
    damper = replace(base.resistors[0], modulated_by="z")
    return replace(base, resistors=(damper,), memories=(ModulatorState("z", law, names),), parameters=table)


def laws() -> Iterator[tuple[str, Callable[[], NetworkSubject]]]:
    """Every registered law in a body of its own; a weight is a source and promises nothing of its energy."""
    for name in (n for n, law in STORAGE_LAWS.items() if law.bounded):
        yield f"storage {name}", lambda name=name: NetworkSubject(body(storage=name))
    for name in RESISTOR_LAWS:
        yield f"resistor {name}", lambda name=name: NetworkSubject(body(resistor=name))
        yield f"resistor {name} reading q", lambda name=name: NetworkSubject(body(resistor=name, reads="q"))
    for name in PORT_LAWS:
        yield f"port {name}", lambda name=name: NetworkSubject(body(port=name))
    for name in FACTOR_LAWS:
        yield f"factor {name}", lambda name=name: NetworkSubject(modulated(name))
    for name in MEMORY_LAWS:
        yield f"memory {name}", lambda name=name: NetworkSubject(slow(name))


# How a learned law that is no one-port joins the body, by the class of `phnn.nn`.
JOINED: dict[type, Callable[[Any], dict[str, Any]]] = {
    phnn.nn.LearnedDissipation: lambda law: {
        "multi_ports": (MultiPort("both", law(2, 1, width=5), ("q", "p"), ("q",)),)
    },
    phnn.nn.LearnedCoupling: lambda law: {"multi_ports": (MultiPort("both", law(2, 1, width=5), ("q", "p"), ("q",)),)},
    phnn.nn.LearnedEnergy: lambda law: {"shared_energies": (SharedEnergy("both", law(2, width=5), ("q", "p")),)},
    phnn.nn.LearnedRatio: lambda law: {"modulations": (Modulation("ratio", "q", law(width=5)),)},
}


def learned() -> Iterator[tuple[str, Callable[[], NetworkSubject]]]:
    """Every learned one-port in a body."""
    for kind, make in _KINDS.items():
        where = "storage" if hasattr(make(2), "energy") else "resistor"
        yield f"learned {kind}", lambda make=make, where=where: NetworkSubject(body(**{where: make(5)}))


def learned_together() -> Iterator[tuple[str, Callable[[], NetworkSubject]]]:
    """Every other learned law of `phnn.nn` in a body, and every system that is learned; kernels solve none of them."""
    modules = [thing for name in phnn.nn.__all__ if isinstance(thing := getattr(phnn.nn, name), type)]
    one_ports = {type(make(2)) for make in _KINDS.values()}
    for law in (m for m in modules if issubclass(m, nn.Module) and m not in one_ports):
        if issubclass(law, PortHamiltonianSystem):
            yield law.__name__, lambda law=law: NetworkSubject(law(3, 2, 6).network)
        else:
            yield law.__name__, lambda law=law: NetworkSubject(body(**JOINED[law](law)))


def _modules_of_models() -> Iterator[Any]:
    for found in pkgutil.iter_modules(phnn.models.__path__):
        yield importlib.import_module(f"phnn.models.{found.name}")


def _things_of_models() -> Iterator[tuple[str, Any]]:
    """Every public function and class that a module of `phnn.models` defines."""
    for module in _modules_of_models():
        for name, thing in vars(module).items():
            if not name.startswith("_") and getattr(thing, "__module__", "") == module.__name__:
                yield name, thing


def network_models() -> Iterator[tuple[str, Callable[[], NetworkSubject]]]:
    """Every function of `phnn.models` that makes a network, and every shipped network."""
    for name, thing in _things_of_models():
        makes = inspect.isfunction(thing) and typing.get_type_hints(thing).get("return")
        # Others make one network out of something else.
        alone = makes and all(p.default is not p.empty for p in inspect.signature(thing).parameters.values())
        if alone and makes in (Network, Setup):
            yield name, lambda thing=thing: NetworkSubject(getattr(made := thing(), "network", made))
    for name in READY:
        yield name, lambda name=name: NetworkSubject(ready(name))
    for file in sorted(CONFIGS.glob("*.yaml")):
        yield f"file {file.stem}", lambda file=file: NetworkSubject(load_network(file))


def everything() -> Network:
    """One network with every law of resistors and storages, learned ones among them, memories and a modulated ratio."""
    names = [n for n, law in STORAGE_LAWS.items() if law.bounded]
    storages, resistors, table = [], [], [positive("m", 2.0, "kg"), Parameter("alpha", 1.2)]
    for name in names:
        theta = tuple(f"{name}_{k}" for k in range(len(STORAGE_LAWS[name].example)))
        table += [Parameter(n, v) for n, v in zip(theta, STORAGE_LAWS[name].example, strict=True)]
        storages.append(Storage(f"x_{name}", name, theta))
    storages += [Storage("x_learned", _KINDS["convex"](3)), Storage("p", "capacitor", ("m",))]
    for k, name in enumerate(RESISTOR_LAWS):
        theta = tuple(f"r_{name}_{i}" for i in range(len(RESISTOR_LAWS[name].example)))
        table += [Parameter(n, v) for n, v in zip(theta, RESISTOR_LAWS[name].example, strict=True)]
        on = storages[k % len(storages)].name
        resistors.append(Resistor(f"r_{name}", name, {on: 1.0, "p": "alpha"}, theta, "x_spring" if k % 2 else None))
    kinds = ("damping", "symmetric_damping", "monotone")
    resistors += [Resistor(f"r_{kind}", _KINDS[kind](3), {"p": 1.0, "x_spring": -0.5}) for kind in kinds]
    couplings = tuple(Coupling(s.name, "p", "alpha") for s in storages[:-1])
    port = Port("force", {"p": "alpha"})
    plain = Network(tuple(storages), tuple(resistors), couplings, (port,), as_table(table), "x_spring")
    return remembering(plain, 3)


def modal_network() -> Network:
    """Two modes and two ports, with a stop, two springs and a drag at both ports."""
    b = np.array([[0.9, 0.5], [0.6, -0.8]])
    modes = phnn.models.modal(np.array([2.0, 7.0]), np.array([0.02, 0.05]), b)
    values = {"k_stop": 0.2, "r_stop": 0.7, "slip": 1e-3, "k_soft": 0.3, "r_soft": 0.8, "k_hard": 0.1, "k_drag": 0.05}
    storages, resistors, couplings = list(modes.storages), list(modes.resistors), list(modes.couplings)
    for port in modes.ports:
        stop, soft, hard = (f"{kind}_{port.name}" for kind in ("stop", "soft", "hard"))
        storages += [
            Storage(stop, "spring", ("k_stop",)),
            Storage(soft, "softening_spring", ("k_soft", "r_soft")),
            Storage(hard, "hardening_spring", ("k_hard",)),
        ]
        resistors += [
            Resistor(f"slip_{port.name}", "yielding", {stop: 1.0}, ("k_stop", "r_stop", "slip")),
            Resistor(f"drag_{port.name}", "quadratic_drag", port.on, ("k_drag",)),
        ]
        couplings += [Coupling(x, p, ratio) for x in (stop, soft, hard) for p, ratio in port.on.items()]
    table = as_table([*modes.parameters.values(), *(positive(n, v, "1", n) for n, v in values.items())])
    return replace(
        modes, storages=tuple(storages), resistors=tuple(resistors), couplings=tuple(couplings), parameters=table
    )


CORE = (
    ("everything", lambda: NetworkSubject(everything())),
    ("modal_network", lambda: NetworkSubject(modal_network())),
)
# Those of networks; made only where they are needed, which takes seconds for some.
NETWORKS: dict[str, Callable[[], NetworkSubject]] = dict((*CORE, *laws(), *learned(), *network_models()))
EVERY: dict[str, Callable[[], Subject]] = {**NETWORKS, **dict(learned_together())}
