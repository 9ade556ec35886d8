"""Small campaigns from the independent generator, and what follows from them; each is made once a run."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from pathlib import Path
from unittest import mock

import numpy as np
import pandas as pd

from phnn.diagnose import diagnosis as path
from phnn.diagnose.diagnosis import Diagnosis
from phnn.diagnose.linearised import LinearisedFit, prepare
from phnn.diagnose.locations import GROUPS, Location, responses
from phnn.effects import catalogue
from phnn.identification.base import numerical_error
from phnn.identification.fit import Fit, Slopes
from phnn.identification.plan import Options, Plan
from phnn.identification.prepare import identification_plan
from phnn.identification.staged import fit_identified
from phnn.models.actuator import hrc
from phnn.recordings import Campaign, read
from phnn.recordings.recording import Part, Recording, Start
from phnn.setup import Setup
from phnn.trajectory import simulate
from studies.generator import Sealed, generate
from studies.generator import make as generator
from studies.generator.make import Ruler, ruler
from studies.generator.plans import Excitation

SEED = 5
# What keeps the numerical error of these recordings below the noise.
STEPS = {"sine_010Hz_75V": 2, "sine_100Hz_75V": 1, "step_75V": 4}
# One hysteron that slips slowly enough for explicit methods and for a training of few steps, and what is known of it.
GENTLE = {"m": 1.0e-3, "k": 2.0e4, "b": 6.0, "alpha": 0.04, "C_1": 5.0e-7, "rho_1": 1.0e-3, "d_1": 8.0}
KNOWN = "known: {m: {value: 1.0e-3, std: 1.0e-6}}\nsetup: {model: piezo_actuator, hysterons: 1}\n"


@cache
def home() -> Path:
    """A folder that is removed at the end of the run."""
    home = Path(tempfile.mkdtemp(prefix="phnn-tests-"))
    atexit.register(shutil.rmtree, home, ignore_errors=True)
    return home


@cache
def _ruler(base: tuple[tuple[str, float], ...], plan: tuple[Excitation, ...]) -> Ruler:
    return ruler(dict(base), plan)


@cache
def concealed(effect: str = "none", seed: int = SEED) -> tuple[Path, Sealed]:
    """A folder of four recordings and the answer."""
    folder = home() / f"{effect}-{seed}"
    # A seed has one base, whatever it is told to conceal: what its sensitivities span is computed once.
    with mock.patch.object(generator, "ruler", lambda base, plan: _ruler(tuple(base.items()), plan)):
        return folder, generate(seed, folder, effect, "short")


@cache
def campaign(effect: str = "none", seed: int = SEED) -> Campaign:
    """The folder as read."""
    return read(concealed(effect, seed)[0])


@cache
def base(effect: str = "none", seed: int = SEED) -> Fit:
    """The base model fitted from the true parameters: tests of a diagnosis do not hang on the search for starts."""
    plan = Plan(identification_plan(campaign(effect, seed), 2).recordings, STEPS, 2)
    true = concealed(effect, seed)[1].base
    held = {"m": f"held at the stated {true['m']:g}"}
    return fit_identified(Setup(hrc(2, dict(true)), name="phs"), plan, held)


@cache
def linearised(effect: str = "none", seed: int = SEED) -> LinearisedFit:
    """The linearised on that fit."""
    return prepare(base(effect, seed))


def with_residual(linearised: LinearisedFit, residual: np.ndarray) -> LinearisedFit:
    """The linearised with another residual, of which the base explains nothing."""
    nothing = Slopes(np.zeros((residual.size, 0)))
    return replace(linearised, fit=replace(linearised.fit, residual=residual, slopes=nothing))


@cache
def generic(effect: str = "none", seed: int = SEED) -> tuple[np.ndarray, np.ndarray]:
    """Responses to all local functions, and their groups."""
    return responses(linearised(effect, seed))


def location(index: int, linearised: LinearisedFit) -> Location:
    """A location whose group of functions, given by its index, has some strengths."""
    group = GROUPS[index]
    count = group.functions(linearised.trajectories[0], linearised.scales).shape[1]
    weights, covariance = 1e-3 * np.linspace(0.5, 1.0, count), 1e-8 * np.eye(count)
    return Location(group.kind.location, group.kind.name, (), {}, {}, {}, index, weights, covariance)


@cache
def diagnosis(effect: str, *names: str, seed: int = SEED) -> Diagnosis:
    """The diagnosis from that fit, with a few members of the catalogue or, if none is named, all."""
    chosen = [catalogue()[n] for n in names] or None
    fitted = base(effect, seed)
    with mock.patch.object(path, "identify_base", return_value=(fitted, numerical_error(fitted))):
        found = path.diagnose(campaign(effect, seed), Options(workers=2), effects=chosen)
    assert found.ended.warnings == (), "a part of the diagnosis has failed"
    return found


def recorded(
    setup: Setup, name: str, t: np.ndarray, u: np.ndarray, noise: float, seed: int = 0, interpolation: str = "cubic"
) -> Recording:
    """A setup's own output on an input, from rest, with white noise and a displacement zero."""
    parts, start = (Part(name, 0, t.size, "identification"),), Start("rest", 0.0)
    blank = Recording(name, t, u, np.zeros_like(t), start, interpolation, parts, noise, "stated", source=name)
    y = simulate(setup, blank, 4).y + 3e-6 + noise * np.random.default_rng(seed).standard_normal(t.size)
    return replace(blank, y=y)


def written(folder: Path, recordings: Iterable[Recording], manifest: str = KNOWN) -> Path:
    """Recordings of an actuator as the files of a folder."""
    folder.mkdir()
    for r in recordings:
        table = pd.DataFrame({"time_s": r.t, "voltage_V": r.u, "displacement_m": r.y})
        table.to_csv(folder / f"{r.name}.csv", index=False)
    (folder / "recordings.yaml").write_text(manifest)
    return folder
