"""Effects on the moving part: springs, dampers, friction, creep, a stop and a second mode."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from phnn.effects import kinds
from phnn.effects.additions import Parts, Placed, Slipping, at_amplifier, bent_spring
from phnn.effects.declaration import between, bounded, constant, has_inertia, has_motion, has_spring, limit, positive
from phnn.effects.effect import Effect, Points, Scales
from phnn.network.elements import Coupling, Network, Resistor, Storage
from phnn.setup import Setup

# Of a round stop, over the displacement.
_ROUND_GAPS = (0.4, 0.6, 0.8, -0.4, -0.6, -0.8)
_GAP = limit("g_c", "m", "gap to the stop", 1e2, signed=True)
CONTACT_STOP = Effect(
    name="contact_stop",
    kind=kinds.ELASTIC,
    equation=r"F_c = k_c \max(q - g_c, 0)",
    statement="The moving part meets an elastic stop: beyond a displacement of {g_c} a further stiffness of {k_c} acts "
    "on that side.",
    fingerprint="Nothing below one displacement, and beyond it a force that grows with the depth, on one side only.",
    separation="Sines of rising amplitude about two offsets of the voltage: a stop acts at one displacement and on one "
    "side only, a limit of the amplifier at one voltage.",
    references=("Johnson 1985, Contact Mechanics, ch. 4 (linearised)",),
    declares=(
        positive("k_c", "N/m", "stiffness of the stop", 1e8, strength=True),
        # The gap keeps its sign: a fit cannot move a stop to the other side.
        _GAP,
    ),
    adds=Parts((Storage("x_c", "stop", ("k_c", "g_c"), "m"),), couplings=(Coupling("x_c", "p", 1.0),)),
    # A weak stop at shares of the displacement on either side.
    grid=Points(
        *(
            {"k_c": (1e-3, "stiffness"), "g_c": (side * share, "displacement")}
            for side in (1.0, -1.0)
            for share in (0.3, 0.5, 0.65, 0.8, 0.9, 0.97)
        )
    ),
    applies=has_motion,
    neighbours=("amplifier_saturation", "quadratic_stiffness", "cubic_stiffness"),
).or_as(
    equation=r"F_c = k_c\,d\,\sqrt{d/d_c}, \quad d = \max(q - g_c, 0)",
    statement="The moving part meets a round stop: beyond a displacement of {g_c} a force acts on that side that grows "
    "with the power 3/2 of the depth, like a stiffness of {k_c} at a depth of {d_c}.",
    references=("Johnson 1985, Contact Mechanics, ch. 4 (Hertz)",),
    declares=(
        positive("k_c", "N/m", "stiffness of the stop at its reference depth", 1e8, strength=True),
        _GAP,
        constant("d_c", "m", "reference depth of the stop"),
    ),
    adds=Parts((Storage("x_c", "round_stop", ("k_c", "g_c", "d_c"), "m"),), couplings=(Coupling("x_c", "p", 1.0),)),
    grid=Points(
        *({"k_c": (1e-3, "stiffness"), "g_c": (x, "displacement"), "d_c": (0.1, "displacement")} for x in _ROUND_GAPS)
    ),
)


_NAME = "coulomb_friction"
# Resistance at the largest velocity, as a share of the friction.
_HARDLY = 0.01
_FORCE = positive("F_c", "N", "Coulomb friction force", 1e8, strength=True)
_STIFFNESS = positive("k_f", "N/m", "stiffness of the bristles before they slip", 1e8)
_SLIP = constant("slip_f", "m/(N s)", "speed of slipping over the force beyond friction")
_STRIBECK = (
    positive("r_f", "1", "excess of friction at low speed, over that at high speed", 1e3),
    positive("v_d", "m/s", "speed over which friction falls", 1e4),
)
_BRISTLES, _BENT = Storage("z", "spring", ("k_f",), "m"), Coupling("z", "p", 1.0)
_SLIPPING = Resistor(_NAME, "bristles", {"z": 1.0}, ("slip_f", "F_c"))
_CREEPING = Resistor(f"{_NAME}_creep", "linear", {"z": 1.0}, ("rho_f",))
# Rates at which bristles creep, as shares of the fastest line.
_RATES = (0.03, 0.3, 3.0)


def slides(setup: Setup) -> bool:
    """Return whether the output is a displacement ``q`` that a momentum ``p`` moves, without a coulomb_friction yet."""
    return has_motion(setup) and all(r.name != _NAME for r in setup.network.resistors)


def slides_by_inertia(setup: Setup) -> bool:
    """The same, with a mass of constant inertia."""
    return slides(setup) and has_inertia(setup)


def friction_grid(scales: Scales) -> list[dict[str, float]]:
    """Smoothing velocities well below the largest velocity of the slowest and of the fastest recording."""
    force = 1e-4 * scales.stiffness * scales.displacement
    slow = 6.0 * scales.slowest * scales.displacement
    speeds = {0.01 * slow, 0.1 * slow, 0.6 * slow, 0.1 * scales.velocity}
    return [{"F_c": force, "v_s": v} for v in sorted(speeds)]


def falling_friction_grid(scales: Scales) -> list[dict[str, float]]:
    """Return the same speeds; friction falls over a few and over many of them."""
    return [{**v, "r_f": 0.5, "v_d": times * v["v_s"]} for v in friction_grid(scales) for times in (5.0, 50.0)]


def _bristles(scales: Scales) -> list[dict[str, float]]:
    """Bristles of a friction that is hardly noticeable, which slip after shares of the displacement."""
    force = 1e-4 * scales.stiffness * scales.displacement
    return [{"k_f": force / (share * scales.displacement), "F_c": force} for share in (3e-4, 3e-3, 3e-2)]


def bent_bristles_grid(scales: Scales) -> list[dict[str, float]]:
    """Friction falls over a share of the speeds, or hardly."""
    return [{**v, "r_f": r, "v_d": 0.1 * scales.velocity} for v in _bristles(scales) for r in (0.05, 0.5)]


def creeping_bristles_grid(scales: Scales) -> list[dict[str, float]]:
    """Bristles that slip with a resistance that is hardly noticeable, and creep slower and faster than the fastest
    line."""
    rates = [2.0 * math.pi * share * scales.fastest for share in _RATES]
    return [
        {**v, "slip_f": scales.velocity / (_HARDLY * v["F_c"]), "rho_f": rate / v["k_f"]}
        for v in _bristles(scales) for rate in rates
    ]  # fmt: skip


def rescale_bristles(values: Mapping[str, float], factor: float) -> dict[str, float]:
    """Scale the force; the displacement to slip, the rate of creep and the share of the resistance do not change."""
    weight = max(factor, 1e-3)
    powers = {"k_f": 1, "F_c": 1, "slip_f": -1, "rho_f": -1}
    return {n: v * weight ** powers.get(n, 0) for n, v in values.items()}


_OVER_VELOCITY = Effect(
    name=_NAME,
    kind=kinds.DISSIPATIVE,
    equation=r"F_f = F_c \tanh(v/v_s)",
    statement="Dry friction of {F_c} acts on the moving part; its sign follows the velocity. From about {v_s} "
    "on its size does not grow with the speed.",
    fingerprint="Odd harmonics whose share of the motion falls as the amplitude grows, and the motion sticks at its "
    "turning points.",
    separation="Triangles of small amplitude at two rates: friction holds the output at every reversal by the same "
    "force, a hysteron slips after the same displacement.",
    references=("Armstrong-Hélouvry, Dupont & Canudas de Wit 1994, Automatica 30",),
    declares=(
        _FORCE,
        positive("v_s", "m/s", "velocity over which friction changes sign", 1e4).plausibly(
            1e-6, 0.1, "contacts leave the Stribeck range below 0.1 m/s (Armstrong-Hélouvry et al. 1994)"
        ),
    ),
    adds=Parts(resistors=(Resistor(_NAME, "coulomb", {"p": 1.0}, ("F_c", "v_s")),)),
    grid=friction_grid,
    applies=slides,
    neighbours=("extra_hysteron",),
)
_FALLING = _OVER_VELOCITY.or_as(
    equation=r"F_f = F_c\,(1 + r_f\,e^{-(v/v_d)^2}) \tanh(v/v_s)",
    statement="Dry friction of {F_c} acts on the moving part; at low speed it is larger by {r_f} times that, and falls "
    "over {v_d}.",
    references=("Bo & Pavelescu 1982, Wear 82 (exponential model of the Stribeck curve)",),
    declares=(*_OVER_VELOCITY.declares, *_STRIBECK),
    adds=Parts(resistors=(Resistor(_NAME, "stribeck", {"p": 1.0}, ("F_c", "v_s", "r_f", "v_d")),)),
    grid=falling_friction_grid,
)
_BENT_FIRST = _FALLING.or_as(
    equation=r"F_f = k_f\,z, \quad \dot{z} = v - |v|\,k_f z/F, \quad F = F_c\,(1 + r_f\,e^{-(v/v_d)^2})",
    statement="Dry friction acts on the moving part: bristles of {k_f} bend with it and slip the more the nearer they "
    "come to {F_c}; at low speed friction is larger by {r_f} times that, and falls over {v_d}.",
    references=("Canudas de Wit, Olsson, Åström & Lischinsky 1995, IEEE Trans. Autom. Control 40",),
    declares=(_STIFFNESS, _FORCE, *_STRIBECK),
    adds=Slipping(_NAME, "lugre", _BRISTLES, ("F_c", "r_f", "v_d")),
    grid=bent_bristles_grid,
    applies=slides_by_inertia,
    rescale=rescale_bristles,
)
COULOMB_FRICTION = _BENT_FIRST.or_as(
    equation=r"F_f = k_f\,z, \quad \dot{z} = v - \rho_f\,k_f z - \varphi(k_f z)",
    statement="Dry friction acts on the moving part: bristles of {k_f} bend with it, creep by {rho_f} under any "
    "force, and slip as soon as they pull with {F_c}.",
    references=("Kamath & Wereley 1997, Smart Mater. Struct. 6 (nonlinear viscoelastic-plastic fluids)",),
    declares=(_STIFFNESS, _FORCE, positive("rho_f", "m/(N s)", "speed of creep over the force of the bristles"), _SLIP),
    adds=Parts((_BRISTLES,), (_SLIPPING, _CREEPING), (_BENT,)),
    grid=creeping_bristles_grid,
    rescale=rescale_bristles,
)


# Cells of creep that follows the logarithm of time: their times are a decade apart. The growth of the displacement then
# differs by 5 % at most from decade to decade.
_CELLS = tuple(range(1, 7))
# Shortest of these times, as shares of the fastest period.
_SHORTEST = (0.03, 0.3, 3.0)


def creep_grid(scales: Scales) -> list[dict[str, float]]:
    """Relaxation times from the fastest period to the longest recording."""
    times = np.geomspace(0.1 / scales.fastest, 2.0 * scales.duration, 10)
    return [{"k_s": 1e-3 * scales.stiffness, "tau_s": float(t)} for t in times]


def logarithmic_creep_grid(scales: Scales) -> list[dict[str, float]]:
    """Return a cell in each of six decades, which begin well below the fastest period, below it and beyond it."""
    return [
        {"k_s": 1e-3 * scales.stiffness} | {f"tau_s1{i}": 10.0 ** (i - 1) * share / scales.fastest for i in _CELLS}
        for share in _SHORTEST
    ]


def growth_per_decade(network: Network, stiffness: float, first: float, last: float) -> float:
    """Return the growth of the displacement under a constant force in every decade from one time to another [%].

    With the stiffness ``K(t) = k + Σ k_i exp(−t/τ_i)`` of the spring and all cells beside it it is
    ``100 (K(t₁)/K(t₂) − 1) / lg(t₂/t₁)``.

    Args:
        network: of a model with creep; stiffness: of its spring [N/m].
        first, last: times since the force was applied [s].
    """
    cells = [[network.parameters[n].value for n in r.parameters] for r in network.resistors if r.law == "maxwell"]
    relaxing, tau = np.array(cells).T
    early, late = (stiffness + float(relaxing @ np.exp(-t / tau)) for t in (first, last))
    return float(100.0 * (early / late - 1.0) / np.log10(last / first))


CREEP = Effect(
    name="creep",
    kind=kinds.MEMORY,
    equation=r"F_s = k_s\,s, \quad \dot{s} = v - s/\tau_s",
    statement="Part of the stiffness relaxes: a spring of {k_s} gives way with a time constant of {tau_s}, so the "
    "displacement goes on growing after a change of voltage.",
    fingerprint="The displacement goes on growing long after a step, and the gain falls slowly towards high "
    "frequencies at a nearly constant phase.",
    separation="A step to a constant voltage held ten times the creep time and back to zero: creep recovers "
    "completely, a drifting sensor goes on in one direction, a hysteron stops.",
    references=("Findley, Lai & Onaran 1976, Creep and Relaxation of Nonlinear Viscoelastic Materials",),
    declares=(
        positive("k_s", "N/m", "stiffness of the relaxing spring", 1e8, strength=True).plausibly(
            0.0, 0.25, "piezo actuators creep by up to a quarter of a step in minutes to hours", over="k"
        ),
        positive("tau_s", "s", "creep time", 1e3).plausibly(
            1e-3, 1e5, "creep goes on over many decades of time, from milliseconds to days"
        ),
    ),
    adds=Parts(
        (Storage("s", "spring", ("k_s",), "m"),),
        (Resistor("creep", "maxwell", {"s": 1.0}, ("k_s", "tau_s")),),
        (Coupling("s", "p", 1.0),),
    ),
    grid=creep_grid,
    applies=has_motion,
    neighbours=("extra_hysteron", "sensor_drift"),
    at_most=3,
).or_as(
    equation=r"F_s = k_s \sum_i s_i, \quad \dot{s}_i = v - s_i/\tau_i, \quad \tau_{i+1} = 10\,\tau_i",
    statement="Part of the stiffness relaxes with the logarithm of time, {k_s} in every decade from {tau_s11} on, so "
    "the displacement goes on growing after a change of voltage.",
    references=("Findley, Lai & Onaran 1976, Creep and Relaxation of Nonlinear Viscoelastic Materials, ch. 5",),
    declares=(
        positive("k_s", "N/m", "stiffness that relaxes in every decade of time", 1e8, strength=True).plausibly(
            0.0, 0.1, "piezo actuators creep by one or two per cent of a step in every decade of time", over="k"
        ),
        *(constant(f"tau_s1{i}", "s", "creep time of one decade") for i in _CELLS),
    ),
    adds=Parts(
        tuple(Storage(f"s_1{i}", "spring", ("k_s",), "m") for i in _CELLS),
        tuple(Resistor(f"creep_1{i}", "maxwell", {f"s_1{i}": 1.0}, ("k_s", f"tau_s1{i}")) for i in _CELLS),
        tuple(Coupling(f"s_1{i}", "p", 1.0) for i in _CELLS),
    ),
    grid=logarithmic_creep_grid,
    at_most=1,
)


def cubic(setup: Setup, parameters: Placed) -> Setup:
    """Effort of ``q`` becomes ``k q (1 + κ₃ s² + c s⁴)``, ``s = q/q₀``; ``c`` completes a softening spring."""
    return bent_spring(setup, "cubic_spring", parameters)


CUBIC_STIFFNESS = Effect(
    name="cubic_stiffness",
    kind=kinds.ELASTIC,
    equation=r"F_k = k\,q\,(1 + \kappa_3 (q/q_0)^2)",
    statement="The stiffness depends on the amplitude: at a displacement of {q_0} the spring force differs by the "
    "share {kappa_3} from a straight line.",
    fingerprint="A third harmonic that grows with the cube of the amplitude, and a resonance that moves with the "
    "amplitude.",
    separation="Sweeps through the resonance at several amplitudes: a stiffness moves it on every one, a saturated "
    "amplifier only beyond its limit.",
    references=("Kovacic & Brennan 2011, The Duffing Equation",),
    declares=(
        bounded("kappa_3", "1", "cubic stiffness", -2.0, 20.0, 0.05, strength=True),
        constant("q_0", "m", "reference displacement of the cubic stiffness"),
    ),
    adds=cubic,
    grid=Points({"kappa_3": 1e-3, "q_0": "displacement"}),
    applies=has_spring,
    neighbours=("amplifier_saturation",),
).or_as(
    equation=r"F_k = k\,q + k_5\,q\,(q/q_0)^4",
    statement="The stiffness depends on the amplitude: a force with the fifth power of the displacement acts beside "
    "the spring, like a stiffness of {k_5} at a displacement of {q_0}.",
    references=("Kovacic & Brennan 2011, The Duffing Equation (cubic-quintic)",),
    declares=(
        positive("k_5", "N/m", "quintic stiffness at its reference displacement", 1e8, strength=True),
        constant("q_0", "m", "reference displacement of the quintic stiffness"),
    ),
    adds=Parts((Storage("x_5", "quintic_spring", ("k_5", "q_0"), "m"),), couplings=(Coupling("x_5", "p", 1.0),)),
    applies=has_motion,
    grid=Points({"k_5": (1e-3, "stiffness"), "q_0": "displacement"}),
)


def moves_without_drag(setup: Setup) -> bool:
    """Return whether the output is a displacement ``q`` that a momentum ``p`` moves, without a quadratic_drag yet."""
    return has_motion(setup) and all(r.name != "quadratic_drag" for r in setup.network.resistors)


def has_imposed_motion(setup: Setup) -> bool:
    """Return whether a motion is imposed and the force that it takes is measured; no play carries it yet."""
    return bool(setup.network.senses) and all(b.kind != "play" for b in setup.amplifier)


INPUT_BACKLASH = Effect(
    name="input_backlash",
    kind=kinds.PLAY,
    equation=r"|x - x_e| \leq \delta_i, \quad \dot{x}_e \neq 0 \ \mathrm{only\ where}\ |x - x_e| = \delta_i",
    statement="There is play between the imposed motion and what it moves: after each reversal the force rests until "
    "the drive has moved by twice {delta_i}.",
    fingerprint="A plateau of the force after every reversal, as wide at every amplitude and frequency.",
    separation="Small triangles whose amplitude grows from nothing: below the width of the play no force changes.",
    references=("Brokate & Sprekels 1996, Hysteresis and Phase Transitions, ch. 2 (play operator)",),
    declares=(positive("delta_i", "m", "half-width of the play at the drive", 1e4, strength=True),),
    adds=at_amplifier("play"),
    grid=Points(*({"delta_i": (share, "displacement")} for share in (1e-3, 0.01, 0.05))),
    applies=has_imposed_motion,
    neighbours=("coulomb_friction", "bouc_wen_hysteresis"),
)


QUADRATIC_DRAG = Effect(
    name="quadratic_drag",
    kind=kinds.DISSIPATIVE,
    equation=r"F_d = c_2 |v| v",
    statement="A resistance of {c_2} grows with the square of the velocity, so that fast motion is damped more than "
    "slow motion.",
    fingerprint="The resonance peak grows broader with the amplitude, while slow motion does not change.",
    separation="Sines at the resonance of rising amplitude, the terminal voltage recorded as well: drag limits the "
    "motion, a slew limit the voltage.",
    references=("Batchelor 1967, An Introduction to Fluid Dynamics, sec. 5.11",),
    declares=(
        positive("c_2", "N s²/m²", "quadratic drag", 1e8, strength=True).plausibly(
            0.0,
            0.012,
            "drag in air, ½ ρ C A with 1.2 kg/m³, C up to 2 and an area up to 100 cm²",
            outside="it is not air: a liquid, a narrow gap, or another loss that grows as fast",
        ),
    ),
    adds=Parts(resistors=(Resistor("quadratic_drag", "quadratic_drag", {"p": 1.0}, ("c_2",)),)),
    grid=Points({"c_2": (1e-4, "stiffness", "displacement", "1/velocity", "1/velocity")}),
    applies=moves_without_drag,
    neighbours=("slew_limit",),
).or_as(
    equation=r"F_d = F_2\,|v/v_2|^{n_2}\,\mathrm{sgn}\,v",
    statement="A resistance of {F_2} at {v_2} grows with the power {n_2} of the velocity, so that fast motion is "
    "damped more than slow motion.",
    references=("Schlichting & Gersten 2017, Boundary-Layer Theory (1.5 laminar, 1.75 to 2 turbulent)",),
    declares=(
        positive("F_2", "N", "drag at its reference velocity", 1e8, strength=True),
        between("n_2", "1", "exponent of the drag", 1.2, 3.0),
        constant("v_2", "m/s", "reference velocity of the drag"),
    ),
    adds=Parts(resistors=(Resistor("quadratic_drag", "power_damper", {"p": 1.0}, ("F_2", "F_2", "n_2", "v_2"), "q"),)),
    # Powers below and above two.
    grid=Points(*({"F_2": (1e-4, "stiffness", "displacement"), "n_2": n, "v_2": "velocity"} for n in (1.5, 2.6))),
)


def quadratic(setup: Setup, parameters: Placed) -> Setup:
    """Effort of ``q`` becomes ``k q (1 + κ₂ s + κ₂² s²/3)``, ``s = q/q₂``, hence ``H″ = k (1 + κ₂ s)² ≥ 0``."""
    return bent_spring(setup, "quadratic_spring", parameters)


QUADRATIC_STIFFNESS = Effect(
    name="quadratic_stiffness",
    kind=kinds.ELASTIC,
    equation=r"F_k = k\,q\,(1 + \kappa_2 s + \frac{1}{3}\kappa_2^2 s^2), \quad s = q/q_2",
    statement="The spring is stiffer on one side than on the other: at a displacement of {q_2} its force differs by "
    "the share {kappa_2} from a straight line.",
    fingerprint="A second harmonic and a mean shift with the square of the displacement, and a resonance that moves "
    "with the offset.",
    separation="Sines at the resonance about several offsets of the voltage: only a stiffness moves the resonance to "
    "one side with a positive and to the other with a negative offset.",
    references=("Kovacic & Brennan 2011, The Duffing Equation, ch. 8",),
    declares=(
        bounded("kappa_2", "1", "quadratic stiffness", -3.0, 3.0, 0.05, strength=True),
        constant("q_2", "m", "reference displacement of the quadratic stiffness"),
    ),
    adds=quadratic,
    grid=Points({"kappa_2": 1e-3, "q_2": "displacement"}),
    applies=has_spring,
    neighbours=("electrostriction", "displacement_coupling", "hysteresis_asymmetry", "contact_stop"),
)


def mode_grid(scales: Scales) -> list[dict[str, float]]:
    """Weakly and strongly damped modes around the highest excited frequency."""
    mass = 1e-3 * scales.stiffness / (2.0 * np.pi * 2.0 * scales.fastest) ** 2
    rates = [2.0 * np.pi * share * scales.fastest for share in (0.5, 1.0, 1.5, 2.5, 5.0)]
    return [
        {"m_2": mass, "k_2": mass * omega**2, "b_2": 2.0 * ratio * mass * omega}
        for omega in rates
        for ratio in (0.02, 0.2)
    ]


def rescale_mode(values: Mapping[str, float], factor: float) -> dict[str, float]:
    """Scale the mass, the strength; frequency and damping ratio do not change."""
    weight = max(factor, 1e-3)
    return {name: weight * value for name, value in values.items()}


SECOND_MODE = Effect(
    name="second_mode",
    kind=kinds.MODE,
    equation=r"m_2 \dot{v}_2 = k_2 x_2 + b_2 (v - v_2), \quad \dot{x}_2 = v - v_2",
    statement="A second mass of {m_2} moves with the first, held by a stiffness of {k_2} and a damping of {b_2}: there "
    "is one more resonance.",
    fingerprint="The error rises towards one frequency, where it turns its phase, and steps ring with it.",
    separation="A slow sweep over the second frequency: a mode turns the phase by half a turn and back within its "
    "width, a delay goes on turning it in proportion to frequency.",
    references=("Meirovitch 2001, Fundamentals of Vibrations, ch. 5",),
    declares=(
        positive("m_2", "kg", "mass of the second mode", 1e8, strength=True),
        positive("k_2", "N/m", "stiffness of the second mode", 1e8),
        positive("b_2", "N s/m", "damping of the second mode", 1e8),
    ),
    adds=Parts(
        (Storage("x_2", "spring", ("k_2",), "m"), Storage("p_2", "capacitor", ("m_2",), "kg m/s")),
        (Resistor("second_mode", "linear", {"p": 1.0, "p_2": -1.0}, ("b_2",)),),
        (Coupling("x_2", "p", 1.0), Coupling("x_2", "p_2", -1.0)),
    ),
    grid=mode_grid,
    applies=has_motion,
    neighbours=("delay", "sensor_lag"),
    rescale=rescale_mode,
)
