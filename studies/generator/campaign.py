"""Make a folder of recordings that conceals one effect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from phnn.errors import InputRefused
from studies.generator.actuator import Array, simulate_all
from studies.generator.base import draw_base
from studies.generator.concealed import EFFECTS, ON_REQUEST, Concealed, described, draw
from studies.generator.excitation import Excitation
from studies.generator.folder import MANIFEST, Writer, measured, refuse_strangers, write_manifest, write_recording
from studies.generator.listed import LOCATIONS
from studies.generator.plans import plan_of
from studies.generator.sealed import Sealed
from studies.generator.strength import concealing, find_strength, ruler

_TARGETS = (1.5, 10.0)  # residual over noise that an effect leaves


def generate(
    seed: int, folder: Path, effect: str | None = None, plan: str = "demo", write: Writer = Path.write_bytes
) -> Sealed:
    """Draw an actuator, an effect and its strength; simulate, add noise, write the recordings.

    Nothing in the folder tells the effect. The answer is returned: keep it with ``write_seal``, elsewhere.

    Args:
        seed: everything follows from it.
        folder: made if need be; gets ``NAME.csv`` per recording and ``recordings.yaml``.
        effect: one of ``EFFECTS`` or ``ON_REQUEST``; drawn if left out.
        plan: "demo" (12 recordings) or "short" (4).
        write: puts each file on the disk.

    Raises:
        InputRefused: an unknown effect or plan, a negative seed, or a folder that holds files of others.
        SolverFailed: the simulation failed, or the effect cannot be made strong enough.
    """
    excitations = plan_of(plan)
    _check(seed, effect, folder, excitations)
    # The noise has a stream of its own: it stays the same whatever effect a seed is told to conceal.
    choices, sensor = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
    drawn = str(choices.choice(EFFECTS))
    base = draw_base(choices)
    noise = float(choices.uniform(20e-9, 80e-9))
    quantisation = int(choices.integers(5, 21)) * 1e-9
    target = float(np.exp(choices.uniform(*np.log(_TARGETS))))

    name = effect or drawn
    outputs: Sequence[Array]
    parameters: Mapping[str, float] = {}
    left = 0.0
    if name == "none":
        outputs = simulate_all(base, excitations)
    else:
        concealed = draw(name, choices, base, excitations)
        outputs, parameters, left = _with_effect(concealed, base, excitations, target * noise)

    folder.mkdir(parents=True, exist_ok=True)
    for excitation, q in zip(excitations, outputs, strict=True):
        write_recording(folder / f"{excitation.name}.csv", excitation, measured(q, noise, quantisation, sensor), write)
    write_manifest(folder / MANIFEST, base["m"], excitations, write=write)
    effects = () if name == "none" else (name,)
    location, stratum = tuple(LOCATIONS[n] for n in effects), "same" if effects else "none"
    return Sealed(
        name, parameters, base, left / noise, noise, quantisation, seed, plan, effects, stratum, location=location
    )  # fmt: skip


def _with_effect(
    effect: Concealed, base: Mapping[str, float], excitations: tuple[Excitation, ...], wanted: float
) -> tuple[Sequence[Array], Mapping[str, float], float]:
    """Outputs of an actuator with an effect, the effect's parameters, and the residual that it leaves [m].

    Args:
        wanted: residual that it should leave [m].
    """
    measure = ruler(base, excitations)
    strength, left = find_strength(lambda z: measure.residual(effect, z), effect.guess, effect.most, wanted)
    return concealing(base, excitations, [(effect, strength)]), described(effect, strength), left


def _check(seed: int, effect: str | None, folder: Path, plan: Sequence[Excitation]) -> None:
    known = (*EFFECTS, *ON_REQUEST)
    if effect is not None and effect not in known:
        raise InputRefused(f"no effect called {effect!r} to conceal: take one of {', '.join(known)}")
    if seed < 0:
        raise InputRefused(f"seed = {seed}: give a whole number, 0 or more")
    refuse_strangers(folder, plan)
