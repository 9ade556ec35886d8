"""A modal model as a port-Hamiltonian network.

    q̇_i = ω_i² p_i,     ṗ_i = −q_i − 2ζ_i ω_i p_i + Σ_j b_ij (u_j − e_j),     ẋ_j = Σ_i b_ij q̇_i = y_j

Each mode is a spring of stiffness one, an inertia ``1/ω_i²`` and a damper ``2ζ_i/ω_i``. The ratios ``b_ij`` are
transformers: they join the ports and the storages of the elements to the momenta, so that ``J`` is skew. The parts of
an element are laws of `phnn.laws`:

    stop         `spring` on the deflection s with the resistor `yielding`, ṡ = ẋ − max(|s| − r, 0) sign(s)/τ
    softening    `softening_spring` on the extension x;  hardening: `hardening_spring`
    drag         resistor `quadratic_drag` on ẋ

The stop of `phnn.modal.elements` is the limit ``τ → 0``. The slow part has no network: it follows the mean square of
the period before, and what it stores changes without a port that supplies it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from phnn.errors import InputRefused, StructureViolated
from phnn.modal.elements import HARDENING, SLOW, SOFTENING, STOP
from phnn.network.elements import Coupling, Network, Port, Resistor, Storage
from phnn.parameters import Parameter, as_table, constant, positive, signed

if TYPE_CHECKING:
    from phnn.modal.model import ModalModel

# Time in which a stop slides back to its threshold, times the highest natural frequency. At a velocity v the stop
# exceeds its threshold by τ|v|: at the fastest mode by this share of the amplitude of x.
_SLIP = 1e-6
# Names of the constants.
_STIFFNESS, _SLIP_TIME = "stiffness", "slip_time"


class _Part(NamedTuple):
    """What one part of an element adds to a network: its storage, its resistor, or both."""

    storage: Storage | None
    resistor: Resistor | None
    parameters: tuple[Parameter, ...]


def network_of(model: ModalModel, ports: Sequence[str] = (), unit: str = "V") -> Network:
    """Build the network of a modal model.

    The energy is ``H = ½ Σ (q_i² + q̇_i²/ω_i²)`` and what the parts of the elements store. Parts of weight zero are
    left out. Output shapes and delays of a fit observe only; they are no part of the network.

    Args:
        model: modes, ratios and elements.
        ports: (P,) names of the inputs; ``port_1``, ``port_2``, … if left out.
        unit: of the inputs u_j; the extension x_j has the unit J/unit, because ``u_j ẋ_j`` is a power.

    Returns:
        A network with storages ``q_i`` and ``p_i = q̇_i/ω_i²``, one more for each stop (its deflection ``s_j_a``) and
        each softening or hardening spring (the extension ``x_j_a``), and the output ``q_1``. Modes i, ports j and
        parts a count from 1.

    Raises:
        StructureViolated: the model has a slow part.
        InputRefused: another number of names than there are ports, or two alike.
    """
    modes, count = model.b.shape
    names = tuple(ports) or tuple(f"port_{j}" for j in range(1, count + 1))
    if len(names) != count or len(set(names)) != count:
        raise InputRefused(f"ports {', '.join(names)}: give {count} different names, one for each port of the model")
    numbers = range(1, modes + 1)
    ratios = [{f"p_{i}": f"b_{i}_{j}" for i in numbers} for j in range(1, count + 1)]
    parts = _parts(model, ratios, unit)
    storages = [Storage(f"q_{i}", "spring", (_STIFFNESS,), "J1/2") for i in numbers]
    storages += [part.storage for _, part in parts if part.storage]
    storages += [Storage(f"p_{i}", "capacitor", (f"m_{i}",), "J1/2 s") for i in numbers]
    dampers = [Resistor(f"damper_{i}", "linear", {f"p_{i}": 1.0}, (f"c_{i}",)) for i in numbers]
    couplings = [Coupling(f"q_{i}", f"p_{i}") for i in numbers]
    couplings += [Coupling(p.storage.name, of, b) for j, p in parts if p.storage for of, b in ratios[j].items()]
    return Network(
        storages=tuple(storages),
        resistors=(*dampers, *(part.resistor for _, part in parts if part.resistor)),
        couplings=tuple(couplings),
        ports=tuple(Port(name, on, unit=unit) for name, on in zip(names, ratios, strict=True)),
        parameters=as_table([*_modal_parameters(model, unit), *(p for _, part in parts for p in part.parameters)]),
        output="q_1",
    )


def _modal_parameters(model: ModalModel, unit: str) -> list[Parameter]:
    """The parameters of the modes, the ratios, and the constants."""
    table = [constant(_STIFFNESS, 1.0, "1", "modal stiffness in coordinates in which it is one")]
    if (model.k[:, model.element.kinds == STOP] > 0.0).any():
        slip = _SLIP / float(model.omega.max())
        table.append(constant(_SLIP_TIME, slip, "s", "time in which a stop slides to its threshold"))
    for i, (w, z) in enumerate(zip(model.omega.tolist(), model.zeta.tolist(), strict=True), start=1):
        table.append(positive(f"m_{i}", w**-2, "s2", f"inertia of mode {i}, 1/ω²"))
        table.append(positive(f"c_{i}", 2.0 * z / w, "s", f"damping of mode {i}, 2ζ/ω"))
    typical = float(np.abs(model.b).max()) or 1.0
    for (i, j), b in np.ndenumerate(model.b):
        name, told = f"b_{i + 1}_{j + 1}", f"ratio between mode {i + 1} and port {j + 1}"
        table.append(signed(name, float(b), f"J1/2/{unit}", 0.0 if b else typical, typical, told))
    return table


def _parts(model: ModalModel, ratios: Sequence[dict[str, str]], unit: str) -> list[tuple[int, _Part]]:
    """The parts of the elements at all ports, each with the index of its port."""
    kinds = model.element.kinds.tolist()
    if any(kind == SLOW and (model.k[:, a] > 0.0).any() for a, kind in enumerate(kinds)):
        raise StructureViolated(
            "self_heating at the ports follows the mean square of the previous period, and a network knows no period: "
            "take a model without self_heating, or simulate this one with phnn.predict"
        )
    return [
        (j, _part(kinds[a], f"{j + 1}_{a + 1}", ratios[j], (float(k), float(model.thresholds[j, a])), unit))
        for (j, a), k in np.ndenumerate(model.k)
        if k > 0.0
    ]


def _part(kind: int, number: str, on: dict[str, str], values: tuple[float, float], unit: str) -> _Part:
    """One part on the extension of a port.

    Args:
        number: of the port and the part, ``j_a``; on: momentum to ratio of the port.
        values: weight k > 0 and threshold r of the part; unit: of the inputs.
    """
    weight, extension = f"k_{number}", f"J/{unit}"
    if kind == HARDENING:
        own = positive(weight, values[0], f"{unit}4/J3", "coefficient of a hardening spring")
        return _Part(Storage(f"x_{number}", "hardening_spring", (weight,), extension), None, (own,))
    if kind not in (STOP, SOFTENING):
        own = positive(weight, values[0], f"{unit}3 s2/J2", "coefficient of a drag")
        return _Part(None, Resistor(f"drag_{number}", "quadratic_drag", dict(on), (weight,)), (own,))
    reach = f"r_{number}"
    table = (
        positive(weight, values[0], f"{unit}2/J", "stiffness of a stop or a softening spring"),
        positive(reach, values[1], extension, "extension at which it slides or softens"),
    )
    if kind == SOFTENING:
        return _Part(Storage(f"x_{number}", "softening_spring", (weight, reach), extension), None, table)
    deflection = f"s_{number}"
    slip = Resistor(f"stop_{number}", "yielding", {deflection: 1.0}, (weight, reach, _SLIP_TIME))
    return _Part(Storage(deflection, "spring", (weight,), extension), slip, table)
