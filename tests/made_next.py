"""A proposed recording made with the independent generator, and added to the folder that it was proposed for."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from phnn.diagnose.menu import Experiment
from phnn.recordings import Campaign
from studies.generator import Case, Sealed
from studies.generator.plans import Excitation, Piece
from studies.generator.seal import MANIFEST, reported, write_manifest, write_recording
from studies.generator.world import NEUTRAL, simulate


def excitation(proposed: Experiment, name: str = "next") -> Excitation:
    """The same input for the generator; of several lines at once its converter holds every sample."""
    t = proposed.t
    if all(len(s.lines) < 2 for s in proposed.stretches):
        pieces = []
        for s in proposed.stretches:
            a, f, phase = s.lines[0] if s.lines else (0.0, 0.0, 0.0)
            back = phase / (2.0 * math.pi * f) if f else 0.0
            pieces.append(Piece(s.start, s.end, s.level, a, f, 0.0, s.start - back))
        return Excitation(name, tuple(pieces), 1.0 / proposed.rate, t.size, proposed.interpolation == "zero_order")
    ends = np.arange(1, t.size + 1) / proposed.rate
    held = [Piece(*piece) for piece in zip(t.tolist(), ends.tolist(), proposed.u.tolist(), strict=True)]
    return Excitation(name, tuple(held), 1.0 / proposed.rate, t.size, True)


def output(answer: Sealed, driven: Excitation) -> np.ndarray:
    """(N,) displacement [m] of the concealed actuator; its effect is stated in the generator's own parameters."""
    assert set(answer.parameters) <= {*NEUTRAL, "q_0"}
    law = {n: v for n, v in answer.parameters.items() if n in NEUTRAL}
    return simulate({**answer.base, **law}, driven)


def add(case: Case, answer: Sealed, campaign: Campaign, proposed: Experiment) -> None:
    """Record it into the folder of the case, for identification; the others keep their use."""
    folder = Path(campaign.folder)
    driven = excitation(proposed)
    y = reported(output(answer, driven), case.noise, case.stream("next"))
    write_recording(folder / f"{driven.name}.csv", driven, y)
    held = {r.name for r in campaign.recordings if r.mask("confirmation").any()}
    plan = (*case.recordings, driven)
    uses = {e.name: "confirmation" if e.name in held else "identification" for e in plan}
    write_manifest(folder / MANIFEST, case.base["m"], plan, uses)
