"""The HRC actuator: a mass–spring–damper driven through parallel-RC hysterons (paper, Sec. 2)."""

from __future__ import annotations

from phnn.errors import InputRefused
from phnn.network.elements import Coupling, Network, Port, Resistor, Storage
from phnn.parameters import Parameter, as_table, positive

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


def hysteron_parameters(
    i: int | str, capacitance: float, slope: float, width: float, span: float = 1e6
) -> tuple[Parameter, ...]:
    """Parameters of the i-th hysteron: capacitance [F], slope ``ϱ_i⁻¹`` [S], dead zone [V]."""
    return (
        positive(f"C_{i}", capacitance, "F", f"capacitance of hysteron {i}", span),
        positive(f"rho_{i}", slope, "S", f"conductance of hysteron {i} outside its dead zone", span),
        positive(f"d_{i}", width, "V", f"width of the dead zone of hysteron {i}", span),
    )


def hysteron(i: int | str) -> tuple[Storage, Resistor, Coupling]:
    """The i-th parallel-RC hysteron, eq. (1), driven by the current ``α v``."""
    return (
        Storage(f"Q_{i}", "capacitor", (f"C_{i}",), "C"),
        Resistor(f"hysteron_{i}", "dead_zone", {f"Q_{i}": 1.0}, (f"rho_{i}", f"d_{i}")),
        Coupling(f"Q_{i}", "p", "alpha"),
    )


def hrc(hysterons: int = 2, values: dict[str, float] | None = None) -> Network:
    """The actuator of eqs. (3)–(6) and Proposition 1 with any number of hysterons.

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
        template, round_ = i % 2 + 1, i // 2
        c, rho, d = (TABLE_1[f"{n}_{template}"] for n in ("C", "rho", "d"))
        parameters += hysteron_parameters(i + 1, c, rho, d * 1.5**round_)
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
    """Two hysterons with the identified values of Table 1."""
    return hrc(2)
