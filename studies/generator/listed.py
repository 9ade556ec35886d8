"""The effects that a catalogue lists and that cases conceal: where each acts, how it is drawn, what resembles it."""

from __future__ import annotations

from studies.generator.chain import CHAIN
from studies.generator.concealed import Concealed, draw
from studies.generator.inner import INNER, Base, Plan, Rng

# Canonical locations. Left out are what no recording of displacement can show and what needs no search.
LOCATIONS = {
    "creep": "mechanical",
    "extra_hysteron": "hysteron",
    "cubic_stiffness": "mechanical",
    "coulomb_friction": "mechanical",
    "quadratic_drag": "mechanical",
    "hysteresis_asymmetry": "hysteron",
    "electrostriction": "coupling",
    "amplifier_lowpass": "amplifier",
    "amplifier_saturation": "amplifier",
    "sensor_drift": "sensor",
    "contact_stop": "mechanical",
    "quadratic_stiffness": "mechanical",
    "charge_leakage": "electrical",
    "rate_dependent_threshold": "hysteron",
    "displacement_coupling": "coupling",
    "depolarisation": "coupling",
    "second_mode": "mechanical",
    "self_heating": "thermal",
    "delay": "amplifier",
    "slew_limit": "amplifier",
    "sensor_lag": "sensor",
    "sensor_nonlinearity": "sensor",
    "output_backlash": "sensor",
    "mains_pickup": "environment",
    "base_motion": "environment",
}
LISTED = tuple(LOCATIONS)

# Effects of one set leave much the same trace in ordinary recordings.
ALIKE = (
    {
        "electrostriction",
        "displacement_coupling",
        "quadratic_stiffness",
        "sensor_nonlinearity",
        "hysteresis_asymmetry",
    },
    {"delay", "amplifier_lowpass", "sensor_lag"},
    {"cubic_stiffness", "contact_stop", "amplifier_saturation"},
    {"creep", "charge_leakage", "extra_hysteron"},
    {"self_heating", "depolarisation", "sensor_drift"},
)
# Two blocks of one of these act one after the other, in an order that an effect's name does not tell.
_ORDERED = ("amplifier", "sensor")


def drawn(name: str, rng: Rng, base: Base, plan: Plan) -> Concealed:
    """A listed effect in its catalogue form with its shape drawn."""
    own = {**INNER, **CHAIN}.get(name)
    return draw(name, rng, base, plan) if own is None else own(rng, base, plan)


def may_be_paired(first: str, second: str) -> bool:
    """Whether two effects can be told apart in principle and act together in one way only."""
    if first == second or any({first, second} <= alike for alike in ALIKE):
        return False
    return not (LOCATIONS[first] == LOCATIONS[second] and LOCATIONS[first] in _ORDERED)
