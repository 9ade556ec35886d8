"""From a network to the integer-coded program that the compiled kernel marches.

The kernel covers networks with one 1-junction: a single inertia whose velocity ``v = p/m`` is the flow
shared by every other element. Leaves hang on it through ratios,

    ẋ_l = a_l v − φ_l(E_l(x_l)),     ṗ = −Σ_l a_l E_l(x_l) − Σ_r φ_r(v) + Σ_j g_j ψ_j(u_j),

which is the actuator of eqs. (3)–(6) with everything the catalogue adds to it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phnn.errors import StructureViolated
from phnn.laws import PORT_LAWS, RESISTOR_LAWS, STORAGE_LAWS
from phnn.network.elements import Network, Ratio, Resistor, Storage

LOSSLESS, DISSIPATIVE = 0, 1
_MAX_PARAMETERS = 4
_NONE = -1
_LINEAR_STORAGES = ("capacitor", "spring")


@dataclass(frozen=True)
class Program:
    """Integer tables that index a vector ``theta`` of parameter values.

    Attributes:
        names: parameter names in the order of ``theta``; entries after them are constants.
        constants: values of those constants.
        leaf_names: the leaves in the order of the kernel's state.
        leaves: (L, 12) kind, storage law, resistor law, ratio, 4 storage and 4 resistor parameters.
        modulators: (L,) leaf whose energy variable the resistor reads, or -1.
        resistors: (R, 6) law, modulating leaf, 4 parameters, on the junction's flow.
        ports: (P, 6) law, ratio, 4 parameters, in the order of the network's ports.
        inertia: index of the mass in ``theta``.
        output: index of the measured leaf.
    """

    names: tuple[str, ...]
    constants: tuple[float, ...]
    leaf_names: tuple[str, ...]
    leaves: NDArray[np.int64]
    modulators: NDArray[np.int64]
    resistors: NDArray[np.int64]
    ports: NDArray[np.int64]
    inertia: int
    output: int

    def theta(self, network: Network) -> NDArray[np.float64]:
        """(M,) parameter values of a network with this structure, constants appended."""
        return np.array([network.parameters[n].value for n in self.names] + list(self.constants))


class _Indexer:
    """Gives every name and constant its place in ``theta``."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self.names = names
        # The first constant stands where a law has fewer parameters than the kernel passes.
        self.constants: list[float] = [0.0]

    def ratio(self, ratio: Ratio) -> int:
        if isinstance(ratio, str):
            return self.names.index(ratio)
        if ratio not in self.constants:
            self.constants.append(float(ratio))
        return len(self.names) + self.constants.index(ratio)

    def parameters(self, names: tuple[str, ...]) -> list[int]:
        if len(names) > _MAX_PARAMETERS:
            raise StructureViolated(f"a law has {len(names)} parameters; the kernel passes {_MAX_PARAMETERS}")
        return [self.names.index(n) for n in names] + [len(self.names)] * (_MAX_PARAMETERS - len(names))


def _position(table: object, law: object, kind: str) -> int:
    names = list(table)  # type: ignore[call-overload]
    if not isinstance(law, str):
        raise StructureViolated(f"a {kind} law that is a torch module has no kernel: solve with integrate.dense")
    if law not in names:
        raise StructureViolated(f"no {kind} law called {law!r}: known are {', '.join(names)}")
    return names.index(law)


def compile_network(network: Network) -> Program:
    """The kernel's program of a network.

    Raises:
        StructureViolated: the network has no kernel (several junctions, neural laws, resistors between
            storages); `phnn.integrate.dense` solves it in torch.
    """
    flows = {c.of for c in network.couplings}
    if len(flows) != 1:
        raise StructureViolated(f"the kernel needs one shared flow; the couplings use {sorted(flows)}")
    junction = flows.pop()
    inertia = next(s for s in network.storages if s.name == junction)
    if inertia.law != "capacitor":
        raise StructureViolated(f"the kernel needs a constant mass on {junction}, not the law {inertia.law}")
    index = _Indexer(tuple(network.parameters))
    leaves = [s for s in network.storages if s.name != junction]
    names = tuple(s.name for s in leaves)
    ratios = {c.to: c.ratio for c in network.couplings}
    if set(ratios) != set(names) or len(network.couplings) != len(names):
        raise StructureViolated("the kernel needs every storage coupled once to the shared flow")
    by_leaf, on_flow = _resistors_by_place(network, junction)
    rows = [_leaf_row(s, by_leaf.get(s.name), ratios[s.name], index) for s in leaves]
    lossless = tuple(name if name not in by_leaf else "" for name in names)
    modulators = [_modulator(by_leaf.get(s.name), lossless) for s in leaves]
    resistors = [
        [_position(RESISTOR_LAWS, r.law, "resistor"), _modulator(r, lossless), *index.parameters(r.parameters)]
        for r in on_flow
    ]
    if network.output not in names:
        raise StructureViolated(f"the kernel needs an output beside {junction}, not {network.output}")
    ports = []
    for port in network.ports:
        if set(port.on) != {junction}:
            raise StructureViolated(f"the kernel needs port {port.name} on {junction}")
        row = [_position(PORT_LAWS, port.law, "port"), index.ratio(port.on[junction])]
        ports.append(row + index.parameters(port.parameters))
    return Program(
        names=index.names,
        constants=tuple(index.constants),
        leaf_names=names,
        leaves=np.array(rows, dtype=np.int64).reshape(-1, 12),
        modulators=np.array(modulators, dtype=np.int64),
        resistors=np.array(resistors, dtype=np.int64).reshape(-1, 6),
        ports=np.array(ports, dtype=np.int64).reshape(-1, 6),
        inertia=index.names.index(inertia.parameters[0]),
        output=names.index(network.output),
    )


def _resistors_by_place(network: Network, junction: str) -> tuple[dict[str, Resistor], list[Resistor]]:
    by_leaf: dict[str, Resistor] = {}
    on_flow: list[Resistor] = []
    for r in network.resistors:
        if len(r.on) != 1 or next(iter(r.on.values())) != 1.0:
            raise StructureViolated(f"the kernel needs resistor {r.name} on one effort with ratio 1")
        place = next(iter(r.on))
        if place == junction:
            on_flow.append(r)
        elif place in by_leaf:
            raise StructureViolated(f"the kernel takes one resistor a leaf; {place} has two")
        else:
            by_leaf[place] = r
    return by_leaf, on_flow


def _leaf_row(storage: Storage, resistor: Resistor | None, ratio: Ratio, index: _Indexer) -> list[int]:
    law = _position(STORAGE_LAWS, storage.law, "storage")
    parameters = index.parameters(storage.parameters)
    if resistor is None:
        return [LOSSLESS, law, 0, index.ratio(ratio), *parameters, *index.parameters(())]
    position = _position(RESISTOR_LAWS, resistor.law, "resistor")
    if RESISTOR_LAWS[resistor.law].thresholds is None or storage.law not in _LINEAR_STORAGES:
        raise StructureViolated(
            f"the kernel advances leaf {storage.name} only with a linear storage and a piecewise linear resistor"
        )
    return [DISSIPATIVE, law, position, index.ratio(ratio), *parameters, *index.parameters(resistor.parameters)]


def _modulator(resistor: Resistor | None, names: tuple[str, ...]) -> int:
    """Place of the leaf that a resistor reads; only a lossless one is known at mid-step from the velocity alone."""
    if resistor is None or resistor.modulated_by is None:
        return _NONE
    if resistor.modulated_by not in names:
        raise StructureViolated(
            f"the kernel needs resistor {resistor.name} modulated by a lossless leaf, not by {resistor.modulated_by}"
        )
    return names.index(resistor.modulated_by)
