"""Simulated actuators with concealed effects, made faster than those of a benchmark.

The simulator, the draws and the noise are the benchmark's. Three things are cheaper:

* what a refit of the base model can take up comes from the derivatives of phnn's model, not from differences of
  further simulations;
* the strength is met within 30 %, not 10 %: strengths are spread over a decade anyway;
* of twelve recordings a strength is sought among the short ones first, and then met within 60 %.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from phnn.errors import SolverFailed
from phnn.identification.numerics import substeps_for
from phnn.identification.plan import Plan
from phnn.identification.problem import Problem
from phnn.identification.variables import variables_of
from phnn.models.actuator import hrc
from phnn.recordings import Recording, read
from phnn.recordings.excitation import excitation_of
from phnn.setup import Setup
from phnn.signals.noise import noise_floor
from studies.benchmark.tools.common import whole
from studies.generator import Case, generate
from studies.generator.cases import Choice
from studies.generator.effects import Concealed, draw
from studies.generator.make import KINDS, Ruler, concealing, find_strength
from studies.generator.noise import disturbed
from studies.generator.plans import Excitation
from studies.generator.seal import reported
from studies.generator.world import simulate_all

Array = NDArray[np.float64]
Part = tuple[Concealed, float]
Parts = list[Part]

# Accepted relative distance from the strength that is wanted, and where a guess from the short recordings stands;
# shapes of one effect; parts of the strength that are tried.
_CLOSE, _FAR, _SHAPES, _WEAKER = 0.3, 0.6, 3, (1.0, 0.5, 0.25)
# Residual over noise of a background, as studies.generator.background has it.
_BACKGROUND = (0.3, 1.0)
# Recordings up to this length [s] are short. Deviation [m] of noise that asks for accurate derivatives; directions with
# a smaller part of the largest singular value move nothing.
_SHORT, _FINE, _RANK = 0.5, 2e-8, 1e-6


@dataclass(frozen=True)
class Actuator:
    """A simulated actuator.

    Attributes:
        setup: its base model with the true parameters, SI; mass: kg.
        recordings: its noisy recordings; their noise is estimated from them, as `phnn.recordings.read` does it.
        effects: names of what is concealed; beside: of the background.
        level: root mean square that all of it leaves beyond a linear refit of the base model, over the noise.
    """

    setup: Setup
    mass: float
    recordings: tuple[Recording, ...]
    effects: tuple[str, ...]
    beside: tuple[str, ...]
    level: float


@dataclass(frozen=True)
class _Gauge:
    """Rulers of all recordings, and of the short ones where there are long ones beside them."""

    full: Ruler
    rough: Ruler | None

    def strength(self, effect: Concealed, target: float) -> float | None:
        """The strength that leaves ``target`` [m]; none where no strength does."""
        guess = effect.guess
        for ruler in filter(None, (self.rough, self.full)):
            close = _CLOSE if ruler is self.rough or self.rough is None else _FAR
            try:
                guess, _ = find_strength(partial(ruler.residual, effect), guess, effect.most, target, close)
            except SolverFailed:
                if ruler is self.full:
                    return None
        return guess


def simulated(case: Case) -> Actuator:
    """Find shapes and strengths, simulate, add noise.

    Raises:
        SolverFailed: the simulation failed, or nothing can be made as strong as wanted.
    """
    noise, plan, driven = case.noise, case.recordings, template(case.plan)
    base, beside = _with_background(case, driven)
    gauge = _gauge(base, plan, driven)
    allowed = tuple(c for c in case.choices if not set(c.effects) & set(beside))
    choice, parts = _concealed(replace(case, base=base, choices=allowed), gauge) if case.effects else (Choice(), [])
    outputs = concealing(base, plan, parts)
    moved = disturbed(noise, base, plan, outputs, lambda d: concealing(base, plan, parts, d), case.stream)
    sensor = case.stream("sensor")
    recordings = tuple(as_read(replace(r, y=reported(q, noise, sensor))) for r, q in zip(driven, moved, strict=True))
    level = float(np.sqrt(np.mean(gauge.full.left(outputs) ** 2))) / noise.deviation
    return Actuator(_setup(base), base["m"], recordings, choice.effects, beside, level)


def as_read(recording: Recording) -> Recording:
    """The recording with the noise floor that `phnn.recordings.read` finds in it."""
    excitation = excitation_of(recording.drive, recording.dt)
    floor = noise_floor(recording.drive, recording.y, recording.dt, excitation.period, excitation.span)
    return replace(recording, noise=floor.value)


def _with_background(case: Case, driven: Sequence[Recording]) -> tuple[dict[str, float], tuple[str, ...]]:
    """The base with a background, where one was asked for, and its names; see `studies.generator.background`."""
    base = dict(case.base)
    if not case.conditions.background:
        return base, ()
    rng, plan = case.stream("background"), case.recordings
    total, angle = float(rng.uniform(*_BACKGROUND)), float(rng.uniform(0.1, 0.4)) * np.pi
    shares = dict(zip(KINDS, (np.cos(angle), np.sin(angle)), strict=True))
    effects = [draw(name, rng, base, plan) for name in KINDS]
    acting, gauge = [e for e in effects if e.name not in case.effects], _gauge(base, plan, driven)
    found = {}
    for effect in acting:
        share = float(shares[effect.name]) if len(acting) > 1 else 1.0
        strength = gauge.strength(effect, total * share * case.noise.deviation)
        if strength is not None:
            found[effect.name] = effect.law(strength)
    return base | {n: v for law in found.values() for n, v in law.items()}, tuple(found)


def _concealed(case: Case, gauge: _Gauge) -> tuple[Choice, Parts]:
    """Effects with their strengths; where a strength cannot be reached another shape, another effect, a weaker one."""
    for number, (weaker, choice) in enumerate(product(_WEAKER, case.choices)):
        parts = [_part(case, choice, (number, i), weaker * target, gauge) for i, target in enumerate(case.targets)]
        reached = [p for p in parts if p is not None]
        if len(reached) == len(case.targets):
            return choice, reached
    raise SolverFailed(f"seed {case.seed}: nothing can be made as strong as wanted, {case.targets}: ask for less")


def _part(case: Case, choice: Choice, at: tuple[int, int], target: float, gauge: _Gauge) -> Part | None:
    """An effect as strong as wanted; none where no shape of it can be."""
    for attempt in range(_SHAPES):
        effect = choice.concealed(at[1], case.stream("shape", *at, attempt), case.base, case.recordings)
        strength = gauge.strength(effect, target * case.noise.deviation)
        if strength is not None:
            return effect, strength
    return None


def _gauge(base: dict[str, float], plan: tuple[Excitation, ...], driven: Sequence[Recording]) -> _Gauge:
    """What the base model's parameters can take up of a change of the outputs, from the derivatives of phnn's model."""
    setup = _setup(base)
    steps = substeps_for(setup, Plan(tuple(replace(r, noise=_FINE) for r in driven), {}, 1), 1.0)
    variables = variables_of(setup, steps, [n for n in setup.parameters if n != "m"])
    problem, z = Problem(setup, steps, variables), variables.start(setup)
    undisturbed, columns = tuple(t.y for t in problem.trajectories(z)), problem.jacobian(z)
    if set(base) - set(setup.parameters):
        undisturbed = simulate_all(base, plan)  # with a background, which phnn's model has not
    short = [e.pieces[-1].end < _SHORT for e in plan]
    full = Ruler(base, plan, undisturbed, _basis(columns))
    if all(short) or not any(short):
        return _Gauge(full, None)
    rows = np.repeat(short, [e.samples for e in plan])
    chosen = [(e, q) for e, q, is_short in zip(plan, undisturbed, short, strict=True) if is_short]
    return _Gauge(full, Ruler(base, tuple(e for e, _ in chosen), tuple(q for _, q in chosen), _basis(columns[rows])))


def _basis(columns: Array) -> Array:
    directions, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(directions[:, sizes > _RANK * sizes[0]])


def _setup(base: Mapping[str, float]) -> Setup:
    """The base model with the true parameters."""
    network = hrc(2)
    return Setup(network).with_values({n: base[n] for n in network.parameters})


@cache
def template(plan: str) -> tuple[Recording, ...]:
    """The recordings of a plan as they are read, all samples for identification; their outputs have no meaning."""
    with TemporaryDirectory() as folder:
        generate(0, Path(folder), "none", plan)
        return whole(read(folder)).recordings
