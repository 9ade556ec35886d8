"""Effects of the surroundings: a shaking base, a constant load and the mains."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from phnn.effects import kinds
from phnn.effects.additions import OfEveryRecording, Parts, Placed, with_network
from phnn.effects.declaration import bounded, constant, has_motion, positive, signed
from phnn.effects.effect import Effect, Points
from phnn.network.elements import Coupling, Port, Storage
from phnn.parameters import as_table
from phnn.setup import Setup, Source

# Typical amplitude [N] if both start at zero.
_FORCE = 1e-3


def shake(setup: Setup, parameters: Placed) -> Setup:
    """Return a port ``F_b`` on ``p`` with ``F_b(t) = A_c cos 2πft + A_s sin 2πft``, ``t`` the time of the recording.

    In the frame of a base that moves by ``s_b``, it is the inertia force ``−m s̈_b``.
    """
    size = max(abs(parameters[n].value) for n in ("A_c", "A_s")) or _FORCE
    sized = {n: p if p.positive else replace(p, typical=size) for n, p in parameters.items()}
    port = Port("base", {"p": 1.0}, unit="N")
    network = replace(setup.network, ports=(*setup.network.ports, port))
    return with_network(setup, network).with_source(Source("tone", "base", tuple(sized)), tuple(sized.values()))


def rescale_shaking(values: Mapping[str, float], factor: float) -> dict[str, float]:
    """Scale both amplitudes; together they are the strength."""
    return {"A_c": factor * values["A_c"], "A_s": factor * values["A_s"], "f_b": values["f_b"]}


BASE_MOTION = Effect(
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
    # One point for each of the two phases; the frequency is searched.
    grid=Points(
        *(
            {"A_c": (a, "stiffness", "displacement"), "A_s": (1e-4 - a, "stiffness", "displacement"), "f_b": "fastest"}
            for a in (1e-4, 0.0)
        )
    ),
    applies=has_motion,
    neighbours=("mains_pickup",),
    rescale=rescale_shaking,
    searched="f_b",
)


# A storage ``H = −F₀ x_w`` with ``J[x_w, p] = 1``: an energy source that is not bounded below. If a spring acts, it has
# deflected before the recording starts. Without a spring there is no rest state, and recordings start unknown.
_WEIGHT = Parts((Storage("x_w", "weight", ("F_0",), "m"),), couplings=(Coupling("x_w", "p", 1.0),))


CONSTANT_LOAD = Effect(
    name="constant_load",
    kind=kinds.CONSTANT_FORCE,
    equation=r"F = F_0",
    statement="A constant force of {F_0} acts on the moving part, as gravity or a preload does.",
    fingerprint="Without a spring the motion is larger in one direction; with a linear spring only the mean changes.",
    separation="The same recording with the actuator turned upside down: a weight changes its sign, an offset of the "
    "amplifier and a zero of the sensor do not.",
    references=("Gautier, Janot & Vandanjon 2013, IEEE Transactions on Control Systems Technology 21 (EMPS)",),
    declares=(bounded("F_0", "N", "constant force", typical=0.1, strength=True),),
    adds=_WEIGHT,
    grid=Points({"F_0": (1e-3, "stiffness", "displacement")}),
    applies=has_motion,
    neighbours=("amplifier_offset",),
)


_HARMONICS = (1, 2, 3)


def mains_lines(setup: Setup, parameters: Placed) -> Setup:
    """Lines at ``f_m`` and its second and third harmonic, with an amplitude and phase for each recording."""
    table = as_table((*(setup.block_parameters or {}).values(), *parameters.values()))
    added = tuple(n * parameters["f_m"].value for n in _HARMONICS)
    return replace(setup, own=setup.own._replace(lines=(*setup.own.lines, *added)), block_parameters=table)


MAINS_PICKUP = Effect(
    name="mains_pickup",
    kind=kinds.LINES,
    equation=r"y = q + \sum_{n=1}^{3} (a_n \cos 2\pi n f_m t + b_n \sin 2\pi n f_m t)",
    statement="The measurement picks up the mains: lines at {f_m} and its harmonics stand in the output, with an "
    "amplitude and phase of their own in every recording.",
    fingerprint="Narrow lines at the mains and its harmonics whose phase is another one in every recording.",
    separation="A recording at zero voltage with the actuator held fast: pickup does not change, a shaking base has "
    "no effect any more.",
    references=("Ott 2009, Electromagnetic Compatibility Engineering, ch. 2",),
    declares=(
        constant("f_m", "Hz", "frequency of the mains").plausibly(
            49.5, 60.6, "grids hold 50 or 60 Hz within 1 % (EN 50160)"
        ),
    ),
    adds=OfEveryRecording(mains_lines),
    grid=Points({"f_m": 50.0}, {"f_m": 60.0}),
    neighbours=("base_motion",),
)
