"""The HRC actuator that warms up by what it dissipates (paper, Sec. 2.4.4)."""

from __future__ import annotations

from dataclasses import replace

from phnn.models.actuator import hrc
from phnn.network.elements import Modulation, ModulatorState, Network, Resistor
from phnn.parameters import Parameter, as_table, constant, positive

# The heat capacity is that of the 1.11 g that the paper's bender weighs, at 350 J/(kg K), a usual figure for PZT
# ceramics. Ambient conductance is some 10 W/(m² K), natural convection and radiation, over its two faces of 32 mm by
# 8 mm. The temperature coefficients are placeholders: of soft PZT, coupling and losses grow and coercivity falls by the
# order of a permille to a percent per kelvin. None of these has been identified.
ORDERS = {
    "C_T": 0.39,
    "R_T": 200.0,
    "T_a": 293.15,
    "T_ref": 293.15,
    "kappa_alpha": 1e-3,
    "kappa_rho": 1e-2,
    "kappa_d": -2e-3,
}


def thermal_hrc(hysterons: int = 2, values: dict[str, float] | None = None) -> Network:
    """`phnn.models.actuator.hrc` with the temperature ``T`` of one body, heated by hysterons and damper alike.

        Q̇_i = α(T) p/m − h_i⁻¹(Q_i/C_i, T),   q̇ = p/m,   ṗ = −α(T) Σ Q_i/C_i − k q − b p/m + α(T) V − F
        C_T Ṫ = Σ (Q_i/C_i) h_i⁻¹ + b (p/m)² − (T − T_a)/R_T
        α(T) = α (1 + κ_α ϑ),   ϱ_i⁻¹(T) = ϱ_i⁻¹ max(0, 1 + κ_ϱ ϑ),   d_i(T) = d_i max(0, 1 + κ_d ϑ),   ϑ = T − T_ref

    The last state is ``ϑ``, at rest ``T_a − T_ref``. ``k`` is purely mechanical: with the capacitor ``C`` of Fig. 5 in
    it, it would follow ``α²``. An actuator of constant energies: neither thermal expansion nor pyroelectricity.

    Args:
        hysterons: ``n ≥ 0``.
        values: parameter values in SI; those left out are Table 1's and `ORDERS`.

    Raises:
        InputRefused: a negative count, or a value for a parameter that does not exist.
    """
    base = hrc(hysterons)
    parameters = [*base.parameters.values(), *_thermal_parameters()]
    return replace(
        base,
        resistors=tuple(_tempered(r) if r.law == "dead_zone" else r for r in base.resistors),
        modulations=(Modulation("alpha", "theta", "affine", ("kappa_alpha", "T_s")),),
        memories=(ModulatorState("theta", "thermal", ("C_T", "R_T", "T_a", "T_ref"), unit="K"),),
        parameters=as_table(parameters),
    ).with_values(values or {})


def _tempered(hysteron: Resistor) -> Resistor:
    names = (*hysteron.parameters, "kappa_rho", "kappa_d")
    return replace(hysteron, law="thermal_dead_zone", parameters=names, modulated_by="theta")


def _thermal_parameters() -> tuple[Parameter, ...]:
    about = {
        "kappa_alpha": "temperature coefficient of the transducer ratio",
        "kappa_rho": "temperature coefficient of the hysterons' conductance",
        "kappa_d": "temperature coefficient of the hysterons' dead zones",
    }
    return (
        positive("C_T", ORDERS["C_T"], "J/K", "heat capacity"),
        positive("R_T", ORDERS["R_T"], "K/W", "thermal resistance to the ambient"),
        constant("T_a", ORDERS["T_a"], "K", "temperature of the ambient"),
        constant("T_ref", ORDERS["T_ref"], "K", "temperature at which the other parameters hold"),
        constant("T_s", 1.0, "K", "unit of temperature coefficients"),
        *(Parameter(n, ORDERS[n], "1/K", typical=1e-3, description=text) for n, text in about.items()),
    )
