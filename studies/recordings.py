"""Recordings that studies make, and the use of each of their parts: identification, interpolation, or extrapolation.

    Table 1              the paper's Sec. 3, with a second effect or without, by the generator of the demonstration
    phs                  the paper's network of two hysterons, Table 1 moved by up to 20 %
    bouc_wen             a Bouc–Wen element in the place of the hysterons (`studies.generator.cases`)
    prandtl_ishlinskii   q = L [c₀ u + Σ c_i w_i(u)], plays with cubic envelopes and thresholds r_i + λ |u̇|, behind a
                         mass, spring and damper L (Al Janaideh, Krejčí 2011)

Nothing of the models that are fitted to them takes part in making them. All but the last are integrated by LSODA; the
last is computed here, sample by sample on a grid a hundredth as long as the shortest time constant.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phnn.errors import InputRefused
from phnn.identification.evaluate import Evaluation
from phnn.recordings.excitation import Excitation as Measured
from phnn.recordings.excitation import excitation_of
from phnn.recordings.recording import Recording
from phnn.report.formatting import number
from phnn.results import write_atomic
from studies.generator.cases import BOUC_WEN, HYSTERONS, draw_base, with_hysteresis
from studies.generator.effects import EFFECTS, described, draw
from studies.generator.make import concealing, find_strength, ruler
from studies.generator.noise import Noise
from studies.generator.plans import PEAK, Excitation, chirp, sine, step
from studies.generator.seal import refuse_strangers, reported, write_folder
from studies.generator.world import TABLE, simulate_all

Array = NDArray[np.float64]

IDENTIFICATION_HZ = (1.0, 50.0, 100.0, 150.0)
VALIDATION_HZ = (10.0, 25.0, 75.0)
HALF_HZ = (10.0, 75.0, 150.0)  # at half the voltage
_WEIGHING = 1e-4  # standard deviation of the weighed mass over the mass


@dataclass(frozen=True)
class Conditions:
    """How recordings differ from what Table 1 predicts.

    Attributes:
        effect: a second effect that neither model of the paper has, one of `studies.generator.EFFECTS`; or "none".
        residual_um: root mean square over the campaign that the effect leaves beyond a refit of Table 1, µm.
        noise_um: standard deviation of the sensor's white noise, µm.
        step_nm: least step of the displacement, a whole number of nm.
        seed: of noise, displacement zeros and the shape of the effect.

    Raises:
        InputRefused: an unknown effect, or a number out of range.
    """

    effect: str = "none"
    residual_um: float = 2.0
    noise_um: float = 0.05
    step_nm: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        if self.effect not in (*EFFECTS, "none"):
            raise InputRefused(f"effect: nothing is called {self.effect!r}: take none or one of {', '.join(EFFECTS)}")
        for name in ("residual_um", "noise_um"):
            value = getattr(self, name)
            if not isinstance(value, float | int) or not 0.0 < value < math.inf:
                raise InputRefused(f"{name} = {value}: give a positive number of micrometres")
        for name, least in (("step_nm", 1), ("seed", 0)):
            value = getattr(self, name)
            if not isinstance(value, int) or value < least:
                raise InputRefused(f"{name} = {value}: give a whole number, {least} or more")


@dataclass(frozen=True)
class Made:
    """Attributes:
    conditions: what was asked for.
    parameters: of the second effect, SI; empty where there is none.
    residual: root mean square that the effect leaves beyond a refit of Table 1, m.
    """

    conditions: Conditions
    parameters: Mapping[str, float] = field(default_factory=dict)
    residual: float = 0.0

    def words(self, signals: str) -> str:
        """Say what the recordings are, for a page; ``signals`` says what drives them."""
        c = self.conditions
        text = (
            f"Recordings simulated from Table 1 of the paper by an independent generator: {signals}, white noise of "
            f"{c.noise_um:g} µm, least step {c.step_nm} nm, displacement zeros, seed {c.seed}."
        )
        if c.effect == "none":
            return f"{text} Nothing else is in them: port-Hamiltonian models with dead zones can be exact."
        values = ", ".join(f"{n} = {number(v)}" for n, v in self.parameters.items())
        return (
            f"{text} A second effect, {c.effect} ({values}; SI), leaves {number(self.residual * 1e6, 2)} µm r.m.s. "
            "beyond a refit of Table 1: no model is exact."
        )


def _used(plan: tuple[Excitation, ...]) -> tuple[dict[str, str], tuple[Excitation, ...]]:
    """Return the use by recording name, and the recordings; the paper names four sines for identification."""
    chosen = {sine(f).name for f in IDENTIFICATION_HZ}
    return {e.name: "identification" if e.name in chosen else "confirmation" for e in plan}, plan


def paper_plan() -> tuple[dict[str, str], tuple[Excitation, ...]]:
    """Return use by recording name, and the recordings: seven sines, a step and a chirp of 1–100 Hz, all of 75 V.

    The paper names four sines for identification and three for validation. Its step and chirp appear in the results
    alone; they are held out.
    """
    return _used((*map(sine, sorted((*IDENTIFICATION_HZ, *VALIDATION_HZ))), step(), chirp(75.0)))


def comparison_plan() -> tuple[dict[str, str], tuple[Excitation, ...]]:
    """Return use by recording name, and the recordings: the paper's seven sines of 75 V, and five beyond them.

    Beyond are twice the highest frequency, half the voltage, and 1.2 times the voltage; all of them are held out.
    """
    beyond = (sine(300.0), *(sine(f, 0.5 * PEAK) for f in HALF_HZ), sine(25.0, 1.2 * PEAK))
    return _used((*map(sine, sorted((*IDENTIFICATION_HZ, *VALIDATION_HZ))), *beyond))


def write_recordings(
    folder: Path, conditions: Conditions, recordings: tuple[dict[str, str], tuple[Excitation, ...]] | None = None
) -> Made:
    """Simulate the campaign, add what a sensor adds, and write one csv for each recording and ``recordings.yaml``.

    The mass of Table 1 is given as weighed; nothing in the folder tells the second effect.

    Args:
        folder: gets the files.
        conditions: how the recordings differ from what Table 1 predicts.
        recordings: use by name, and what drives them; those of the paper if left out.

    Raises:
        InputRefused: the folder holds files of others.
        SolverFailed: the effect cannot be made as strong as asked.
    """
    uses, plan = recordings or paper_plan()
    refuse_strangers(folder, plan)
    shape, sensor = (np.random.default_rng(s) for s in np.random.SeedSequence(conditions.seed).spawn(2))
    parts, made = [], Made(conditions)
    if conditions.effect != "none":
        concealed, measure = draw(conditions.effect, shape, TABLE, plan), ruler(TABLE, plan)
        strength, left = find_strength(
            lambda z: measure.residual(concealed, z), concealed.guess, concealed.most, conditions.residual_um * 1e-6
        )
        parts, made = [(concealed, strength)], Made(conditions, described(concealed, strength), left)
    noise = Noise(conditions.noise_um * 1e-6, conditions.step_nm * 1e-9)
    reports = [reported(q, noise, sensor) for q in concealing(TABLE, plan, parts)]
    write_folder(folder, TABLE["m"], plan, reports, uses, _WEIGHING, write=write_atomic)
    return made


PHS, PLAYS = "phs", "prandtl_ishlinskii"
TRUTHS = (PHS, PLAYS, BOUC_WEN)
_STEP_NM, _FINE, _COUNT = 1, 100.0, 5  # least step, nm; grid steps in the shortest time constant; plays
_RATED = (2e-5, 6e-5)  # λ times the largest rate of 75 V at 150 Hz is 0.02 to 0.06 of the largest voltage


def write_truth(
    folder: Path, truth: str, seed: int, plan: tuple[Mapping[str, str], Sequence[Excitation]], noise_um: float
) -> None:
    """Draw an actuator, simulate a plan from rest, add what a sensor adds, and write the folder.

    Args:
        truth: one of ``TRUTHS``; seed: of the actuator, the noise and the zeros.
        plan: use by recording name, and what drives the recordings.
        noise_um: standard deviation of the white noise, µm.

    Raises:
        InputRefused: an unknown truth.
        SolverFailed: the simulation failed.
    """
    if truth not in TRUTHS:
        raise InputRefused(f"truths: nothing is called {truth!r}: choose from {', '.join(TRUTHS)}")
    uses, excitations = plan
    choices, sensor = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
    base = draw_base(choices)
    if truth == PLAYS:
        law = _drawn(choices)
        outputs = tuple(_plays(law, base, e) for e in excitations)
    else:
        family = BOUC_WEN if truth == BOUC_WEN else HYSTERONS
        outputs = simulate_all(with_hysteresis(base, family, choices), excitations)
    noise = Noise(noise_um * 1e-6, _STEP_NM * 1e-9)
    reports = [reported(q, noise, sensor) for q in outputs]
    write_folder(folder, base["m"], excitations, reports, uses, _WEIGHING, write=write_atomic)


def base_of(seed: int) -> dict[str, float]:
    """Return the parameters of Table 1 as `write_truth` moves them for a seed, SI."""
    return draw_base(np.random.default_rng(np.random.SeedSequence(seed).spawn(2)[0]))


def _drawn(rng: np.random.Generator) -> dict[str, Array]:
    """Draw weights, thresholds over the largest voltage, envelope ``(a, b, c)``, and λ [s]."""
    reach = np.sort(rng.uniform(0.08, 0.7, _COUNT))
    shares = 0.45 * rng.dirichlet(np.full(_COUNT, 4.0))
    envelope = np.array([rng.uniform(-0.1, 0.1), rng.uniform(-0.08, 0.02), rng.uniform(0.0, 0.03)])
    return {
        "weights": np.array([1.0 - shares.sum(), *shares]), "reach": reach, "envelope": envelope,
        "rated": np.array([rng.uniform(*_RATED)]),
    }  # fmt: skip


def _plays(law: Mapping[str, Array], base: Mapping[str, float], excitation: Excitation) -> Array:
    """Return the (samples,) displacement [m] from rest."""
    omega = math.sqrt(base["k"] / base["m"])
    damping = base["b"] / (2.0 * math.sqrt(base["k"] * base["m"]))
    parts = max(1, math.ceil(excitation.dt * omega * _FINE / (2.0 * math.pi)))
    dt = excitation.dt / parts
    t = np.arange((excitation.samples - 1) * parts + 1, dtype=np.float64) * dt
    u = excitation.voltage(t) / PEAK
    gain = base["alpha"] * PEAK / base["k"]
    path = _path(u, dt, law["reach"], law["weights"], law["envelope"], float(law["rated"][0]), omega, damping)
    return np.asarray(gain * path[::parts])


@njit(cache=True)
def _path(
    u: Array, dt: float, reach: Array, weights: Array, envelope: Array, rated: float, omega: float, damping: float
) -> Array:
    """Return the output of the plays through ``q̈ + 2ζω q̇ + ω² q = ω² f`` by the trapezoidal rule."""
    w, out = np.zeros(reach.size), np.zeros(u.size)
    q, v, last = 0.0, 0.0, 0.0
    for n in range(u.size):
        x = u[n]
        rate = abs(x - (u[n - 1] if n > 0 else 0.0)) / dt
        middle = x + envelope[0] * x * x + envelope[1] * x**3
        up, down = middle + envelope[2] * x * x, middle - envelope[2] * x * x
        force = weights[0] * x
        for i in range(w.size):
            r = reach[i] + rated * rate
            w[i] = max(up - r, min(down + r, w[i]))
            force += weights[i + 1] * w[i]
        if n > 0:
            # Trapezoidal rule, solved for the new velocity.
            pull = omega**2 * (0.5 * (force + last) - q - 0.25 * dt * v) - damping * omega * v
            new = (v + dt * pull) / (1.0 + dt * damping * omega + (0.5 * dt * omega) ** 2)
            q, v = q + 0.5 * dt * (v + new), new
        out[n], last = q, force
    return out


IDENTIFICATION, CONFIRMATION, OUTSIDE = "identification", "confirmation", "outside"
USES = {IDENTIFICATION: "identified", CONFIRMATION: "held out, inside", OUTSIDE: "held out, outside"}
# What lies nearer than this to the edge of the range is still within it.
_SAME = 0.05


@dataclass(frozen=True)
class Range:
    """What the identification recordings reach.

    Attributes:
        low_Hz, high_Hz: of all that oscillate; NaN where none does.
        smallest: least amplitude (half the range of the input) of those; peak: largest absolute input of all.
    """

    low_Hz: float
    high_Hz: float
    smallest: float
    peak: float

    def holds(self, excitation: Measured, peak: float) -> bool:
        """Whether an input stays within; steps have no frequency and no least amplitude."""
        if peak > (1.0 + _SAME) * self.peak:
            return False
        if excitation.high_Hz <= 0.0 or np.isnan(self.high_Hz):
            return True
        return (
            excitation.low_Hz >= (1.0 - _SAME) * self.low_Hz
            and excitation.high_Hz <= (1.0 + _SAME) * self.high_Hz
            and excitation.amplitude >= (1.0 - _SAME) * self.smallest
        )


def identified_range(recordings: Sequence[Recording]) -> Range:
    """The range of the recordings that serve identification, at least in part."""
    chosen = [r for r in recordings if r.mask("identification").any()]
    moving = [e for e in (excitation_of(r.u, r.dt) for r in chosen) if e.high_Hz > 0.0]
    return Range(
        low_Hz=min((e.low_Hz for e in moving), default=float("nan")),
        high_Hz=max((e.high_Hz for e in moving), default=float("nan")),
        smallest=min((e.amplitude for e in moving), default=float("nan")),
        peak=max((_peak(r) for r in chosen), default=0.0),
    )


def uses(recordings: Sequence[Recording]) -> dict[str, str]:
    """Use by name of the part: ``identification``, ``confirmation``, or ``outside`` for a recording held out that lies
    outside the identified range of frequency or amplitude.
    """
    reached = identified_range(recordings)
    found = {}
    for r in recordings:
        inside = reached.holds(excitation_of(r.u, r.dt), _peak(r))
        for part in r.parts:
            if part.use != "nuisance":
                found[part.name] = part.use if part.use == IDENTIFICATION or inside else OUTSIDE
    return found


def over_noise(evaluation: Evaluation, kinds: Mapping[str, str], use: str) -> float:
    """Root mean square of the residual over noise over the parts of one use, as `uses` gives it; NaN for none."""
    found = [p.residual_over_noise for p in evaluation.parts if kinds[p.name] == use]
    return float(np.sqrt(np.mean(np.square(found)))) if found else float("nan")


def _peak(recording: Recording) -> float:
    return float(np.abs(recording.u).max())
