"""Further effects that can be concealed in the amplifier, in the sensor, and in what it picks up."""

from __future__ import annotations

import math

import numpy as np

from studies.generator.concealed import Concealed, Values, either_sign
from studies.generator.excitation import Excitation
from studies.generator.inner import Base, Plan, Rng
from studies.generator.parameters import Array

_TYPICAL = 100e-6  # m, displacement at which the two terms of a curved sensor count alike


def delay(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``V(t) = u(t − τ)``."""
    return Concealed("delay", 1e-5, 1e-2, lambda z: {"tau_d": z})


def slew_limit(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``|V̇| ≤ S``; strength one is the steepest slope of all voltages between their jumps."""
    steepest = max(p.steepest for e in plan for p in e.pieces)
    return Concealed("slew_limit", 0.5, 20.0, lambda z: {"S": steepest / z})


def sensor_lag(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``τ ẏ = q − y``."""
    return Concealed("sensor_lag", 1e-5, 1e-2, lambda z: {"tau_y": z})


def sensor_nonlinearity(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``y = q + a₂ q² + a₃ q³``; the ratio of the two terms is the shape."""
    angle = float(rng.uniform(0.0, 2.0 * math.pi))

    def law(z: float) -> Values:
        return {"a_2": z * math.cos(angle) / _TYPICAL, "a_3": z * math.sin(angle) / _TYPICAL**2}

    return Concealed("sensor_nonlinearity", 5e-3, 0.2, law)


def output_backlash(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """A play of half-width δ."""
    return Concealed("output_backlash", 1e-7, 2e-5, lambda z: {"delta_b": z})


def mains_pickup(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Lines at 50 or 60 Hz and up to two harmonics, of one amplitude; every recording begins at a phase of its own."""
    mains, harmonics = float(rng.choice([50.0, 60.0])), int(rng.integers(1, 4))
    shares = {h: 1.0 if h == 1 else float(rng.uniform(0.1, 0.6)) for h in range(1, harmonics + 1)}
    phases = {e.name: rng.uniform(0.0, 2.0 * math.pi, harmonics) for e in plan}

    def added(z: float, excitation: Excitation) -> Array:
        t, own = excitation.t, phases[excitation.name]
        return z * np.sum(
            [shares[h] * np.sin(2.0 * math.pi * h * mains * t + own[h - 1]) for h in shares], axis=0
        )  # fmt: skip

    def stated(z: float) -> Values:
        return {"f_m": mains, **{f"A_{h}": z * share for h, share in shares.items()}}

    return Concealed("mains_pickup", 1e-7, 1e-4, lambda z: {}, added=added, stated=stated)


def sensor_drift(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """A ramp, of the same rate in every recording."""
    rate = either_sign(rng)
    return Concealed(
        "sensor_drift",
        1e-7,
        1e-3,
        lambda z: {},
        added=lambda z, excitation: z * rate * excitation.t,
        stated=lambda z: {"rate": z * rate},
    )


CHAIN = {
    "delay": delay,
    "slew_limit": slew_limit,
    "sensor_lag": sensor_lag,
    "sensor_nonlinearity": sensor_nonlinearity,
    "output_backlash": output_backlash,
    "mains_pickup": mains_pickup,
    "sensor_drift": sensor_drift,
}
