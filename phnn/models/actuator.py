"""The HRC actuator (paper, Sec. 2), the Bouc–Wen actuator of eq. (19), and structures of modes, as networks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from phnn.errors import InputRefused
from phnn.network.elements import Coupling, Network, Port, Resistor, Storage
from phnn.parameters import Parameter, as_table, constant, positive, signed
from phnn.setup import Block, Setup

# Table 1 of the paper; slopes are the conductances ϱ⁻¹ of eq. (2).
TABLE_1 = {
    "m": 1.0148e-3,
    "k": 24579.0,
    "b": 3.7356,
    "alpha": 0.046311,
    "C_1": 5.6425e-7,
    "C_2": 5.2125e-7,
    "rho_1": 0.6002,
    "rho_2": 1.1528e-4,
    "d_1": 14.7571,
    "d_2": 8.6838,
}


def hysteron(i: int | str) -> tuple[Storage, Resistor, Coupling]:
    """Return the i-th parallel-RC hysteron, eq. (1), driven by the current ``α v``."""
    return (
        Storage(f"Q_{i}", "capacitor", (f"C_{i}",), "C"),
        Resistor(f"hysteron_{i}", "dead_zone", {f"Q_{i}": 1.0}, (f"rho_{i}", f"d_{i}")),
        Coupling(f"Q_{i}", "p", "alpha"),
    )


def hrc(hysterons: int = 2, values: dict[str, float] | None = None) -> Network:
    """Return the actuator of eqs. (3)–(6) and Proposition 1 with any number of hysterons.

        Q̇_i = α p/m − h_i⁻¹(Q_i/C_i),   q̇ = p/m,   ṗ = −α Σ Q_i/C_i − k q − b p/m + α V − F

    Args:
        hysterons: ``n ≥ 0``.
        values: parameter values in SI; those left out are Table 1's, further hysterons cycle through its two
            with growing dead zones.

    Raises:
        InputRefused: a negative count, or a value for a parameter that does not exist.
    """
    if hysterons < 0:
        raise InputRefused(f"hysterons = {hysterons}: give a count of zero or more")
    parameters = [
        positive("m", TABLE_1["m"], "kg", "moving mass"),
        positive("k", TABLE_1["k"], "N/m", "stiffness"),
        positive("b", TABLE_1["b"], "N s/m", "viscous damping"),
        positive("alpha", TABLE_1["alpha"], "N/V", "transducer ratio"),
    ]
    elements = [hysteron(i + 1) for i in range(hysterons)]
    for i in range(hysterons):
        number, template, round_ = i + 1, i % 2 + 1, i // 2
        c, rho, d = (TABLE_1[f"{n}_{template}"] for n in ("C", "rho", "d"))
        parameters += [
            positive(f"C_{number}", c, "F", f"capacitance of hysteron {number}"),
            positive(f"rho_{number}", rho, "S", f"conductance of hysteron {number} outside its dead zone"),
            positive(f"d_{number}", d * 1.5**round_, "V", f"width of the dead zone of hysteron {number}"),
        ]
    network = Network(
        storages=(
            *(e[0] for e in elements),
            Storage("q", "spring", ("k",), "m"),
            Storage("p", "capacitor", ("m",), "kg m/s"),
        ),
        resistors=(*(e[1] for e in elements), Resistor("damper", "linear", {"p": 1.0}, ("b",))),
        couplings=(*(e[2] for e in elements), Coupling("q", "p", 1.0)),
        ports=(Port("voltage", {"p": "alpha"}, unit="V"), Port("force", {"p": -1.0}, unit="N")),
        parameters=as_table(parameters),
    )
    return network.with_values(values or {})


def from_paper() -> Network:
    """Return two hysterons with the identified values of Table 1."""
    return hrc(2)


# Table 2 of the paper. K_h enters as the weight w = K_h/K_v of the block's state.
TABLE_2 = {
    "m": 9.4023e-4,
    "k": 24579.0,
    "b": 5.2,
    "A": 0.008743,
    "beta": 0.00637,
    "gamma": 0.0144905,
    "K_v": 0.048676,
    "K_h": 1.9767,
}


def bouc_wen(values: dict[str, float] | None = None) -> Setup:
    """Return eq. (19): an amplifier block ``V − w h(V)`` before a linear mass–spring–damper with ``α = K_v``.

        ḣ = A V̇ − β|V̇|h − γ|h|V̇,   ṗ = −k δ − b p/M + K_v (V − w h),   w = K_h/K_v

    ``A`` and ``w`` enter only as their product, so ``A`` stays at Table 2's value.

    Args:
        values: parameter values in SI; those left out are Table 2's.
    """
    network = hrc(0, {"m": TABLE_2["m"], "k": TABLE_2["k"], "b": TABLE_2["b"], "alpha": TABLE_2["K_v"]})
    setup = Setup(network, name="bouc_wen").with_block(
        "amplifier",
        Block("bouc_wen", ("A", "beta", "gamma", "w")),
        (
            constant("A", TABLE_2["A"], "1/V", "slope of the Bouc–Wen state"),
            Parameter("beta", TABLE_2["beta"], "1/V", 1e-6, 10.0, positive=True, description="Bouc–Wen β"),
            Parameter("gamma", TABLE_2["gamma"], "1/V", -10.0, 10.0, typical=0.01, description="Bouc–Wen γ"),
            Parameter(
                "w", TABLE_2["K_h"] / TABLE_2["K_v"], "V", -1e4, 1e4, typical=10.0, description="Bouc–Wen weight"
            ),
        ),
    )
    return setup.with_values(values or {})


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
    """Build the network of a structure of modes in parallel, joined to ports and outputs.

        q̇_i = ω_i² p_i,     ṗ_i = −q_i − 2ζ_i ω_i p_i + Σ_j b_ij u_j,     y_k = Σ_i c_ki q_i

    Each mode is a spring of stiffness one, an inertia ``1/ω_i²`` and a damper ``2ζ_i/ω_i``. The ratios ``b_ij`` are
    transformers, so that ``J`` is skew. An output is a storage without energy that moves by ``Σ_i c_ki q̇_i``: it
    observes, and returns no force.

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

    Reference: Preumont 2018, Vibration Control of Active Structures, ch. 3 and 4 (modes, collocated pairs).
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
    """Return the ratios (K, M) between modes and ports or outputs as parameters, ``name_mode_end``."""
    typical = float(np.abs(ratios).max()) or 1.0
    return [
        signed(
            f"{name}_{i}_{k}", float(r), unit, 0.0 if r else typical, typical, f"ratio between mode {i} and {end} {k}"
        )
        for k, row in enumerate(ratios, start=1)
        for i, r in enumerate(row.tolist(), start=1)
    ]
