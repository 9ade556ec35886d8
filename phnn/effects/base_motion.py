"""A shaking base: a force on the mass that is independent of the voltage."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from phnn.effects import Effect, Placed, Scales, has_motion, kinds, positive, signed, with_network
from phnn.network.elements import Port
from phnn.setup import Setup, Source

# Typical amplitude [N] if both start at zero.
_FORCE = 1e-3


def shake(setup: Setup, parameters: Placed) -> Setup:
    """A port ``F_b`` on ``p`` with ``F_b(t) = A_c cos 2πft + A_s sin 2πft``, ``t`` the time of the recording.

    In the frame of a base that moves by ``s_b``, it is the inertia force ``−m s̈_b``.
    """
    size = max(abs(parameters[n].value) for n in ("A_c", "A_s")) or _FORCE
    sized = {n: p if p.positive else replace(p, typical=size) for n, p in parameters.items()}
    port = Port("base", {"p": 1.0}, unit="N")
    network = replace(setup.network, ports=(*setup.network.ports, port))
    return with_network(setup, network).with_source(Source("tone", "base", tuple(sized)), tuple(sized.values()))


def grid(scales: Scales) -> list[dict[str, float]]:
    """One point for each of the two phases; the frequency is searched."""
    force = 1e-4 * scales.stiffness * scales.displacement
    return [{"A_c": a * force, "A_s": (1.0 - a) * force, "f_b": scales.fastest} for a in (1.0, 0.0)]


def rescale(values: Mapping[str, float], factor: float) -> dict[str, float]:
    """Scale both amplitudes; together they are the strength."""
    return {"A_c": factor * values["A_c"], "A_s": factor * values["A_s"], "f_b": values["f_b"]}


EFFECT = Effect(
    name="base_motion",
    kind=kinds.LINES,
    equation=r"F_b(t) = A_c \cos 2\pi f_b t + A_s \sin 2\pi f_b t",
    statement="The base shakes at {f_b}, the same way in every recording: a force of {A_c} (cosine) and {A_s} (sine) "
    "acts on the moving part, independently of the voltage.",
    fingerprint="An error at one frequency that no drive excites, with the same phase in every recording.",
    separation="A recording at zero voltage that begins at another time: the shaking continues, amplified by the "
    "resonance of the actuator; a line that the sensor picks up is not.",
    references=("Harris & Piersol 2002, Harris' Shock and Vibration Handbook, ch. 2",),
    declares=(
        signed("A_c", "N", "cosine part of the base force", 1e6, _FORCE, strength=True),
        signed("A_s", "N", "sine part of the base force", 1e6, _FORCE),
        positive("f_b", "Hz", "frequency of the base motion", 1e3).plausibly(
            0.5, 200.0, "vibration of buildings (1 to 80 Hz, ISO 2631-2) and of machines on the mains"
        ),
    ),
    adds=shake,
    grid=grid,
    applies=has_motion,
    neighbours=("mains_pickup",),
    rescale=rescale,
    searched="f_b",
)
