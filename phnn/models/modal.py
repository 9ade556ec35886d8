"""A structure of modes as an ordinary network: masses, springs and dampers in parallel, joined to ports and outputs.

    q̇_i = ω_i² p_i,     ṗ_i = −q_i − 2ζ_i ω_i p_i + Σ_j b_ij u_j,     y_k = Σ_i c_ki q_i

Each mode is a spring of stiffness one, an inertia ``1/ω_i²`` and a damper ``2ζ_i/ω_i``. The ratios ``b_ij`` are
transformers, so that ``J`` is skew. An output is a storage without energy that moves by ``Σ_i c_ki q̇_i``: it observes,
and returns no force.

Reference: Preumont 2018, Vibration Control of Active Structures, ch. 3 and 4 (modes, collocated pairs).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from phnn.errors import InputRefused
from phnn.network.elements import Coupling, Network, Port, Resistor, Storage
from phnn.parameters import Parameter, as_table, constant, positive, signed

Array = NDArray[np.float64]

# Names of the constants.
_STIFFNESS, _NOTHING = "stiffness", "no_stiffness"


def modal(
    omega: Array,
    zeta: Array,
    b: Array,
    ports: Sequence[str] = (),
    unit: str = "V",
    outputs: Mapping[str, Array] | None = None,
    output_unit: str = "m",
) -> Network:
    """Build the network of a structure with some modes.

        network = phnn.models.modal(2 * np.pi * np.array([640.0, 1000.0]), [0.01, 0.02], [[1.0], [0.5]])
        phnn.PortHamiltonianSystem(network).structure(x)     # (n, n) J = −Jᵀ

    Args:
        omega, zeta: (M,) natural frequencies [rad/s] and damping ratios.
        b: (M, P) ratios between modes and ports.
        ports: (P,) names of the inputs; ``port_1``, ``port_2``, … if left out.
        unit: of the inputs u_j; the extension ``x_j = Σ_i b_ij q_i`` has the unit J/unit, as ``u_j ẋ_j`` is a power.
        outputs: (M,) shape of each output, by its name; the output is ``q_1`` if there are none.
        output_unit: of these outputs.

    Returns:
        A network with storages ``q_i`` and ``p_i = q̇_i/ω_i²``, and one for each output. Modes and ports count from 1.

    Raises:
        InputRefused: sizes that differ, frequencies that are not positive, or another number of names than there are
            ports, or two alike.
    """
    omega, zeta, b = (np.asarray(x, dtype=float) for x in (omega, zeta, b))
    if not omega.size or b.ndim != 2 or not omega.size == zeta.size == len(b) or min(omega.min(), zeta.min()) <= 0.0:
        raise InputRefused("modes: give each a positive frequency and damping ratio, and a row of ratios to the ports")
    names = tuple(ports) or tuple(f"port_{j}" for j in range(1, b.shape[1] + 1))
    if len(names) != b.shape[1] or len(set(names)) != len(names):
        raise InputRefused(f"ports {', '.join(names)}: give {b.shape[1]} different names, one for each port")
    numbers = range(1, omega.size + 1)
    observed = {name: np.asarray(c, dtype=float) for name, c in (outputs or {}).items()}
    table = [constant(_STIFFNESS, 1.0, "1", "modal stiffness in coordinates in which it is one")]
    for i, (w, z) in enumerate(zip(omega.tolist(), zeta.tolist(), strict=True), start=1):
        table.append(positive(f"m_{i}", w**-2, "s2", f"inertia of mode {i}, 1/ω²"))
        table.append(positive(f"c_{i}", 2.0 * z / w, "s", f"damping of mode {i}, 2ζ/ω"))
    table += _ratios("b", b.T, f"J1/2/{unit}", "port")
    if observed:
        table.append(constant(_NOTHING, 0.0, f"J/{output_unit}2", "an output returns no force"))
        table += _ratios("shape", np.array(list(observed.values())), f"{output_unit}/J1/2", "output")
    return Network(
        storages=(
            *(Storage(f"q_{i}", "spring", (_STIFFNESS,), "J1/2") for i in numbers),
            *(Storage(name, "spring", (_NOTHING,), output_unit) for name in observed),
            *(Storage(f"p_{i}", "capacitor", (f"m_{i}",), "J1/2 s") for i in numbers),
        ),
        resistors=tuple(Resistor(f"damper_{i}", "linear", {f"p_{i}": 1.0}, (f"c_{i}",)) for i in numbers),
        couplings=(
            *(Coupling(f"q_{i}", f"p_{i}") for i in numbers),
            *(Coupling(y, f"p_{i}", f"shape_{i}_{k}") for k, y in enumerate(observed, start=1) for i in numbers),
        ),
        ports=tuple(
            Port(name, {f"p_{i}": f"b_{i}_{j}" for i in numbers}, unit=unit) for j, name in enumerate(names, start=1)
        ),
        parameters=as_table(table),
        output=next(iter(observed), "q_1"),
    )


def _ratios(name: str, ratios: Array, unit: str, end: str) -> list[Parameter]:
    """The ratios (K, M) between modes and ports or outputs as parameters, ``name_mode_end``."""
    typical = float(np.abs(ratios).max()) or 1.0
    return [
        signed(
            f"{name}_{i}_{k}", float(r), unit, 0.0 if r else typical, typical, f"ratio between mode {i} and {end} {k}"
        )
        for k, row in enumerate(ratios, start=1)
        for i, r in enumerate(row.tolist(), start=1)
    ]
