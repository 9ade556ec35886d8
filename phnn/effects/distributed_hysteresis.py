"""A distributed hysteresis: springs beside that of the displacement, which yield beyond travels of their own."""

from __future__ import annotations

from collections.abc import Mapping

from phnn.effects import Effect, Parts, Scales, has_motion, kinds, positive, signed
from phnn.network.elements import Coupling, Resistor, Storage

CELLS = tuple(f"D{i}" for i in (1, 2, 3, 4))
# Travels over the largest displacement, those of one grid point being spread by these factors.
_TRAVELS, _SPREAD = (0.1, 0.4), (0.4, 0.8, 1.4, 2.0)
# Stiffness of all cells over that of the base model, where the response is still proportional to it, and how far the
# travels lean at the largest displacement.
_SMALL, _LEANING = 1e-3, (-0.05, 0.05)


def grid(scales: Scales) -> list[dict[str, float]]:
    """Cells of one stiffness that yield early, and late, farther backwards than forwards, and less far."""
    stiffness = _SMALL * scales.stiffness / len(CELLS)
    return [
        {f"k_{i}": stiffness for i in CELLS}
        | {f"x_{i}": share * by * scales.displacement for i, by in zip(CELLS, _SPREAD, strict=True)}
        | {"g_D": 0.2 * abs(lean) / scales.displacement, "a_D": lean / scales.displacement}
        for share in _TRAVELS
        for lean in _LEANING
    ]


def rescale(values: Mapping[str, float], factor: float) -> dict[str, float]:
    """Scale all stiffnesses."""
    return {n: max(factor, 1e-3) * v if n.startswith("k_") else v for n, v in values.items()}


EFFECT = Effect(
    name="distributed_hysteresis",
    kind=kinds.SHAPE,
    equation=r"F_h = \sum_i k_i s_i, \quad \dot{s}_i = v \text{ while } -x_i - (g - a) q^2 < s_i < x_i + (g + a) q^2",
    statement="The hysteresis has another form: springs of {k_D1}, {k_D2}, {k_D3} and {k_D4} yield after {x_D1}, "
    "{x_D2}, {x_D3} and {x_D4}, and these travels grow with the square of the displacement, by {g_D} in both "
    "directions and by {a_D} more forwards than backwards.",
    fingerprint="Loops whose width grows with the amplitude in another way than the hysterons of the model allow, the "
    "same at every frequency.",
    separation="Slow triangles of many amplitudes, each with a hold at its end.",
    references=(
        "Iwan 1966, J. Appl. Mech. 33 (distributed elements)",
        "Al Janaideh, Rakheja & Su 2011, IEEE/ASME Trans. Mechatron. 16 (envelopes)",
    ),
    declares=(
        *(positive(f"k_{i}", "N/m", "stiffness of a spring that yields", 1e8, strength=True) for i in CELLS),
        *(positive(f"x_{i}", "m", "displacement after which it yields", 1e3) for i in CELLS),
        signed("g_D", "1/m", "growth of the travels with the square of the displacement", 1e9, 100.0, own_size=True),
        signed("a_D", "1/m", "growth of the travels forwards less that backwards, halved", 1e9, 100.0, own_size=True),
    ),
    adds=Parts(
        tuple(Storage(f"s_{i}", "spring", (f"k_{i}",), "m") for i in CELLS),
        tuple(
            Resistor(f"yield_{i}", "plastic", {f"s_{i}": 1.0}, (f"k_{i}", f"x_{i}", "g_D", "a_D"), "q") for i in CELLS
        ),
        tuple(Coupling(f"s_{i}", "p") for i in CELLS),
    ),
    grid=grid,
    applies=has_motion,
    neighbours=("extra_hysteron", "coulomb_friction", "bouc_wen_hysteresis"),
    related_kinds=(kinds.THRESHOLD_BY_DISPLACEMENT, kinds.THRESHOLD_BY_RATE),
    rescale=rescale,
)
