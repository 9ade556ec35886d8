"""The Bouc–Wen actuator of eq. (19): a hysteresis block in front of a mass–spring–damper."""

from __future__ import annotations

from dataclasses import replace

from phnn.models.actuator import hrc
from phnn.parameters import Parameter, constant
from phnn.setup import Block, Setup

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
    """Eq. (19) as an amplifier block ``V − w h(V)`` before a linear mass–spring–damper with ``α = K_v``.

        ḣ = A V̇ − β|V̇|h − γ|h|V̇,   ṗ = −k δ − b p/M + K_v (V − w h),   w = K_h/K_v

    ``A`` and ``w`` enter only as their product, so ``A`` stays at Table 2's value.

    Args:
        values: parameter values in SI; those left out are Table 2's.
    """
    network = hrc(0, {"m": TABLE_2["m"], "k": TABLE_2["k"], "b": TABLE_2["b"], "alpha": TABLE_2["K_v"]})
    setup = Setup(replace(network), name="bouc_wen").with_block(
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
