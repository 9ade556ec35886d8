"""
Your own network and your own effect
====================================

Build a network from a bond graph, register an effect that the catalogue lacks, and let a diagnosis find it.

The system is a carriage on a spring, driven by a force. Its guide brakes more the farther the carriage is from the
middle, which no effect of the catalogue says.
"""

# %%
# The network
# -----------
# Elements at one junction share the velocity; causality and equations follow.

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp

import phnn
from phnn.effects import Effect, Parts, Scales, constant, has_motion, kinds, positive, registered
from phnn.network.bondgraph import BondGraph, C, I, R, Se
from phnn.network.elements import Resistor
from phnn.parameters import as_table
from phnn.parameters import positive as parameter

graph = BondGraph(
    {"carriage": 1},
    (
        C("q", "carriage", "spring", ("k",), "m"),
        I("p", "carriage", "capacitor", ("m",), "kg m/s"),
        R("damper", "carriage", "linear", ("b",), "resistance"),
        Se("force", "carriage", "N"),
    ),
    parameters=as_table([parameter("k", 900.0, "N/m"), parameter("m", 1.0, "kg"), parameter("b", 4.0, "N s/m")]),
    output="q",
)
network = graph.network()
print(network.state_names, [port.name for port in network.ports])

# %%
# Recordings
# ----------
# The same network stands in a file beside the recordings. scipy solves the true carriage, whose guide brakes with
# :math:`F_w (q/q_w)^2 v`. Three sines identify, one is held out.


def recorded(amplitude: float, frequency: float, rng: np.random.Generator) -> np.ndarray:
    """Time, force and displacement of ten periods from rest."""
    t = np.arange(0.0, 10.0 / frequency, 0.002)

    def rate(time: float, x: np.ndarray) -> list[float]:
        force = amplitude * np.sin(2.0 * np.pi * frequency * time)
        braking = 4.0 * x[1] + 6.0 * (x[0] / 0.05) ** 2 * x[1]
        return [x[1], force - 900.0 * x[0] - braking]

    q = solve_ivp(rate, (0.0, t[-1]), (0.0, 0.0), "LSODA", t, rtol=1e-9, atol=1e-12).y[0]
    u = amplitude * np.sin(2.0 * np.pi * frequency * t)
    return np.column_stack([t, u, q + 2e-5 * rng.standard_normal(t.size)])


folder = Path(tempfile.mkdtemp()) / "recordings"
folder.mkdir()
rng = np.random.default_rng(1)
drives = {"slow": (20.0, 2.0), "resonant": (8.0, 4.7), "strong": (14.0, 4.7), "held": (11.0, 4.2)}
entries = []
for name, (amplitude, frequency) in drives.items():
    table = recorded(amplitude, frequency, rng)
    np.savetxt(folder / f"{name}.csv", table, delimiter=",", header="time_s,force_N,displacement_m", comments="")
    use = "confirmation" if name == "held" else "identification"
    entries.append(f"  - {{file: {name}.csv, use: {use}, start: {{state: rest, input_before: 0.0}}}}\n")
carriage = """
junctions: {carriage: 1}
elements:
  q: {type: C, junction: carriage, law: spring, parameters: [k], unit: m}
  p: {type: I, junction: carriage, law: capacitor, parameters: [m], unit: kg m/s}
  damper: {type: R, junction: carriage, law: linear, parameters: [b], direction: resistance}
  force: {type: Se, junction: carriage, unit: N}
parameters:
  k: {value: 900.0, unit: N/m, positive: true}
  m: {value: 1.0, unit: kg, positive: true}
  b: {value: 4.0, unit: N s/m, positive: true}
output: q
"""
(folder / "carriage.yaml").write_text(carriage, encoding="utf-8")
(folder / "recordings.yaml").write_text(
    "setup: {network: carriage.yaml}\ninput: cubic\n"
    "columns: {input: {column: 1, unit: N}, output: {column: 2, unit: m}}\nrecordings:\n" + "".join(entries),
    encoding="utf-8",
)
campaign = phnn.read(folder)

# %%
# Without the effect
# ------------------
# The linear carriage leaves more than the noise wherever it moves far at the resonance.

fit = phnn.identify(None, campaign, phnn.Options(starts=1))
for found in phnn.predict(fit.model, campaign):
    print(f"{found.recording.name:9s} {found.document('')['residual_over_noise']:6.2f} × noise")

# %%
# The effect
# ----------
# One resistor on the momentum that reads the displacement. :doc:`/write-your-own-effect` explains every line.


def grid(scales: Scales) -> list[dict[str, float]]:
    """The law is linear in its strength: one point."""
    force = 1e-4 * scales.stiffness * scales.displacement
    return [{"F_w": force, "n_w": 1.0, "v_w": scales.velocity, "q_w": scales.displacement}]


guide = Effect(
    name="guide_damping",
    kind=kinds.DAMPING_BY_DISPLACEMENT,
    equation=r"F = F_w\,(q/q_w)^2\,v/v_w",
    statement="The guide brakes more the farther it bends: {F_w} at {q_w} and {v_w}.",
    fingerprint="Losses grow with the amplitude at every frequency.",
    separation="Small sines at the resonance about two offsets of the force: the peak is broader at the larger one.",
    references=("Smith 2000, Flexures: Elements of Elastic Mechanisms",),
    declares=(
        positive("F_w", "N", "braking force at the reference displacement and speed", strength=True),
        constant("n_w", "1", "exponent of the speed"),
        constant("v_w", "m/s", "reference speed"),
        constant("q_w", "m", "reference displacement"),
    ),
    adds=Parts(
        resistors=(Resistor("guide", "square_damper", {"p": 1.0}, ("F_w", "n_w", "v_w", "q_w"), modulated_by="q"),)
    ),
    grid=grid,
    applies=has_motion,
    neighbours=("quadratic_drag",),
)

# %%
# With the effect
# ---------------
# Registration checks it: the network stays passive, derivatives agree with finite differences. Then a diagnosis looks
# for it.

with registered(guide):
    after = phnn.diagnose(fit)
print(after.verdict, [claim.effect.name for claim in after.claims])
values = after.model.parameters
braking = values["F_w"] / values["v_w"] * (0.05 / values["q_w"]) ** 2
print(f"braking at 5 cm: {braking:.2f} N s/m, true 6")

# %%
# Each recording, before and after
# --------------------------------

figure, axis = plt.subplots(figsize=(8, 3), layout="constrained")
names = [r.name for r in campaign.recordings]
for shift, (label, model) in zip((-0.2, 0.2), (("base", fit.model), ("with the guide", after.model)), strict=True):
    scores = [p.document("")["residual_over_noise"] for p in phnn.predict(model, campaign)]
    axis.bar(np.arange(len(names)) + shift, scores, 0.4, label=label)
axis.axhline(1.0, color="0.4", linewidth=1.0)
axis.set(xticks=range(len(names)), xticklabels=names, ylabel="residual over noise", yscale="log")
_ = axis.legend()
