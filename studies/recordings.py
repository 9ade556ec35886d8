"""Recordings like those of the paper's Sec. 3, made from Table 1 by the generator of the demonstration.

Nothing of the models that are fitted to them takes part in making them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from phnn.errors import InputRefused
from phnn.report.formatting import number
from phnn.results import write_atomic
from studies.generator.actuator import TABLE, Array, simulate_all
from studies.generator.concealed import EFFECTS, described, draw, drifts
from studies.generator.excitation import PEAK, Excitation, chirp, sine, step
from studies.generator.folder import MANIFEST, measured, refuse_strangers, write_manifest, write_recording
from studies.generator.strength import find_strength, ruler

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
        """What the recordings are, for a page; ``signals`` says what drives them."""
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


def paper_plan() -> tuple[dict[str, str], tuple[Excitation, ...]]:
    """Use by recording name, and the recordings: seven sines, a step and a chirp of 1–100 Hz, all of 75 V.

    The paper names four sines for identification and three for validation. Its step and chirp appear in the results
    alone; they are held out.
    """
    sines = {f: sine(f) for f in sorted((*IDENTIFICATION_HZ, *VALIDATION_HZ))}
    plan = (*sines.values(), step(), chirp(75.0))
    chosen = {sines[f].name for f in IDENTIFICATION_HZ}
    return {e.name: "identification" if e.name in chosen else "confirmation" for e in plan}, plan


def comparison_plan() -> tuple[dict[str, str], tuple[Excitation, ...]]:
    """Use by recording name, and the recordings: the paper's seven sines of 75 V, and five that go beyond them.

    Beyond are twice the highest frequency, half the voltage, and 1.2 times the voltage; all of them are held out.
    """
    inside = {f: sine(f) for f in sorted((*IDENTIFICATION_HZ, *VALIDATION_HZ))}
    beyond = (sine(300.0), *(sine(f, 0.5 * PEAK) for f in HALF_HZ), sine(25.0, 1.2 * PEAK))
    chosen = {inside[f].name for f in IDENTIFICATION_HZ}
    plan = (*inside.values(), *beyond)
    return {e.name: "identification" if e.name in chosen else "confirmation" for e in plan}, plan


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
    outputs, made = _outputs(conditions, plan, shape)
    folder.mkdir(parents=True, exist_ok=True)
    for excitation, q in zip(plan, outputs, strict=True):
        y = measured(q, conditions.noise_um * 1e-6, conditions.step_nm * 1e-9, sensor)
        write_recording(folder / f"{excitation.name}.csv", excitation, y, write_atomic)
    write_manifest(folder / MANIFEST, TABLE["m"], plan, uses, _WEIGHING, write=write_atomic)
    return made


def _outputs(
    conditions: Conditions, plan: tuple[Excitation, ...], shape: np.random.Generator
) -> tuple[tuple[Array, ...], Made]:
    """Displacements (samples,) m of the recordings, and what was concealed in them."""
    if conditions.effect == "none":
        return simulate_all(TABLE, plan), Made(conditions)
    concealed = draw(conditions.effect, shape, TABLE, plan)
    measure = ruler(TABLE, plan)
    strength, left = find_strength(
        lambda z: measure.residual(concealed, z), concealed.guess, concealed.most, conditions.residual_um * 1e-6
    )
    moved = simulate_all({**TABLE, **concealed.law(strength)}, plan)
    ramps = drifts(concealed, strength, plan)
    outputs = tuple(q + d for q, d in zip(moved, ramps, strict=True))
    return outputs, Made(conditions, described(concealed, strength), left)
