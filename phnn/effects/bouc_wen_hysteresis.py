"""A hysteresis of Bouc–Wen's form beside the spring: an elastic spring that slips along the path."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

from phnn.effects import (
    Effect,
    Parts,
    Placed,
    Scales,
    at_amplifier,
    between,
    bounded,
    has_inertia,
    has_transducer,
    inertia,
    kinds,
    positive,
)
from phnn.network.elements import Coupling, Resistor, Storage
from phnn.setup import Setup

# Displacements after which the spring slips, over the largest one; a stiffness with a proportional response.
_TRAVELS, _SMALL = (0.05, 0.2, 0.6, 2.0), 1e-3


@dataclass(frozen=True)
class _Slipping:
    """``F += −E(z)``, ``ż = v − φ``: a storage whose slip reads the momentum."""

    form: str
    spring: Storage
    shape: tuple[str, ...]
    passive = True

    def __call__(self, setup: Setup, parameters: Placed) -> Setup:
        slip = Resistor("slip_B", self.form, {"z_B": 1.0}, (*self.shape, inertia(setup)), "p")
        return Parts((self.spring,), (slip,), (Coupling("z_B", "p"),))(setup, parameters)


def _grid(scales: Scales, backs: tuple[float, ...]) -> list[dict[str, float]]:
    stiffness = _SMALL * scales.stiffness
    return [
        {"k_B": stiffness, "F_B": stiffness * share * scales.displacement, "n_B": 1.3, "c_B": back}
        for share, back in product(_TRAVELS, backs)
    ]


def grid(scales: Scales) -> list[dict[str, float]]:
    """Slip after shares of the displacement and beyond it; half as much on the way back."""
    return [point | {"a_B": 0.0} for point in _grid(scales, (0.5,))]


def grid_before(scales: Scales) -> list[dict[str, float]]:
    """Slip after shares of the voltage and beyond it."""
    return [
        {"w_B": _SMALL * share * scales.voltage, "V_B": share * scales.voltage, "n_B": 1.3, "c_B": 0.5, "a_B": 0.0}
        for share in _TRAVELS
    ]


def grid_duhem(scales: Scales) -> list[dict[str, float]]:
    """The same with a way back that is softer, and much stiffer, the larger the force."""
    return _grid(scales, (-0.3, 2.0))


def rescale(values: Mapping[str, float], factor: float) -> dict[str, float]:
    """Scale stiffness and force; the displacement to slip does not change."""
    weight = max(factor, 1e-3)
    return {**values, "k_B": weight * values["k_B"], "F_B": weight * values["F_B"]}


_SPRING = (
    positive("k_B", "N/m", "stiffness of the spring that slips", 1e8, strength=True),
    positive("F_B", "N", "force at which it slips", 1e8),
)
_N, _C = "exponent of the slip", "change of its stiffness by that force"
# What stiffens shall slip too: with e = |E|/F_B, slip over stiffening is e^(n-1)/c. A spring that stiffens and hardly
# slips, of a larger n and c, is a nonlinear spring and no hysteresis.
_STIFFENS = (between("n_B", "1", _N, 1.0, 1.5), bounded("c_B", "1", _C, -0.95, 3.0, 0.1))
_SLIPS = (
    between("n_B", "1", _N, 1.0, 3.0),
    bounded("c_B", "1", "slip on the way back over that on the way forth", 0.0, 5.0, 0.1),
    bounded("a_B", "1", "share by which it slips later on the way up, and earlier on the way down", -0.9, 0.9, 0.1),
)
_DUHEM = Effect(
    name="bouc_wen_hysteresis",
    kind=kinds.SHAPE,
    equation=r"\dot{E} = k_B v\,(1 + c\,|E|/F_B - |E/F_B|^n [vE > 0])",
    statement="A hysteresis acts beside the spring: a spring of {k_B} slips the more the nearer its force comes to "
    "{F_B}, with an exponent of {n_B}; by that force its stiffness has changed by a share of {c_B}.",
    fingerprint="Loops with rounded corners whose width depends on the amplitude and not on the frequency.",
    separation="Slow triangles of several amplitudes at two rates: this hysteresis depends on the path alone.",
    references=(
        "Wen 1976, J. Eng. Mech. Div. 102",
        "Ikhouane & Rodellar 2005, J. Sound Vib. 282 (passivity)",
        "Visintin 1994, Differential Models of Hysteresis (Duhem)",
    ),
    declares=(*_SPRING, *_STIFFENS),
    adds=_Slipping("duhem", Storage("z_B", "exponential_spring", ("k_B", "F_B", "c_B"), "m"), ("F_B", "n_B", "c_B")),
    grid=grid_duhem,
    applies=has_inertia,
    neighbours=("extra_hysteron", "coulomb_friction", "creep"),
    related_kinds=(kinds.THRESHOLD_BY_DISPLACEMENT, kinds.THRESHOLD_BY_RATE),
    rescale=rescale,
)
EFFECT = _DUHEM.or_as(
    equation=r"\dot{E} = k_B\,(v - \beta\,|v|\,e\,\mathrm{sgn}\,E - \gamma\,v\,e), \quad e = |E/F_\pm|^n,"
    r" \quad F_\pm = F_B\,(1 \pm a), \quad \beta, \gamma = (1 \pm c)/2",
    statement="A hysteresis acts beside the spring: a spring of {k_B} slips the more the nearer its force comes to "
    "{F_B}, with an exponent of {n_B}, and on the way back {c_B} times as much. Forwards that force is the share "
    "{a_B} larger, backwards smaller.",
    declares=(*_SPRING, *_SLIPS),
    adds=_Slipping("bouc_wen", Storage("z_B", "spring", ("k_B",), "m"), ("F_B", "n_B", "c_B", "a_B")),
    grid=grid,
).or_as(
    equation=r"V = u - w s, \quad \dot{s} = (\dot{u} - \beta\,|\dot{u}|\,e\,\mathrm{sgn}\,s - \gamma\,\dot{u}\,e)/V_B,"
    r" \quad e = |s/(1 \pm a)|^n, \quad \beta, \gamma = (1 \pm c)/2",
    statement="The hysteresis lies before the moving part: up to {w_B} of the voltage are lost to a state that follows "
    "it over {V_B} and then slips, with an exponent of {n_B}, and on the way back {c_B} times as much. On the way "
    "up that range is the share {a_B} larger, on the way down smaller.",
    references=(
        "Wen 1976, J. Eng. Mech. Div. 102",
        "Low & Guo 1995, J. Microelectromech. Syst. 4 (of a piezoelectric bender)",
    ),
    declares=(
        positive("w_B", "V", "voltage that the hysteresis takes at most", 1e8, strength=True),
        positive("V_B", "V", "voltage over which it slips", 1e4),
        *_SLIPS,
    ),
    adds=at_amplifier("slipping"),
    applies=has_transducer,
    grid=grid_before,
    rescale=None,
)
