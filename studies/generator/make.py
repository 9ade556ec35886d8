"""Make the recordings of a case or of the demonstration, and their sealed answer.

The strength of an effect is the change of the output that refitted base parameters cannot explain.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from phnn.errors import InputRefused, SolverFailed
from studies.generator import seal
from studies.generator.cases import HYSTERONS, PLAIN, Case, Choice, acts_on, as_stated, draw_base, moving
from studies.generator.effects import EFFECTS, FORMS, LOCATIONS, ON_REQUEST, Concealed, Rng, described, draw
from studies.generator.noise import Noise, added_power, disturbed
from studies.generator.plans import EXAM, Array, Excitation, plan_of
from studies.generator.seal import Sealed, Writer
from studies.generator.world import Disturbance, simulate_all

Stack = Callable[[Sequence[Array]], Array]

_STEP = 1e-2  # relative step of the differences; the solver's error of 1e-8 is far below what they resolve
_AHEAD = 5e-4  # relative step of forward differences
_FAINT = {"rho_1": 3e-2}  # steps of parameters that move the output so little that the solver's error would show
_CLOSE = 0.02  # accepted relative distance from the target
_CLOSE_ENOUGH = 0.1  # the same of a case: the answer states what was reached
_SHAPES = 10  # drawn of one effect before another one takes its place
_WEAKER = (1.0, 0.5, 0.25)  # parts of what is wanted that are tried after each other
_TARGETS = (1.5, 10.0)  # residual over noise that an effect of the demonstration leaves
KINDS = ("creep", "hysteresis_asymmetry")  # of a background
_LEVELS = (0.3, 1.0)  # residual over noise that all of a background leaves
_CLOSE_BACKGROUND = 0.05


def _stacked(paths: Sequence[Array]) -> Array:
    """Return all recordings in one vector, (sum of samples,), each without its mean: its zero is free."""
    return np.concatenate([path - path.mean() for path in paths])


@dataclass(frozen=True)
class Ruler:
    """Measures effects against one base model.

    Attributes:
        base: parameters, SI.
        plan: the recordings.
        undisturbed: output of the base model, one array per recording, m.
        tangent: orthonormal basis of what the base parameters can change, (samples, rank).
        stacked: joins what changes in each recording, without what its zero can take.
    """

    base: Mapping[str, float]
    plan: tuple[Excitation, ...]
    undisturbed: tuple[Array, ...]
    tangent: Array
    stacked: Stack = _stacked

    def left(self, outputs: Sequence[Array]) -> Array:
        """Return what the linear refit of the base model leaves of ``outputs``, (samples,)."""
        change = self.stacked([q - q_0 for q, q_0 in zip(outputs, self.undisturbed, strict=True)])
        left: Array = change - self.tangent @ (self.tangent.T @ change)
        return left

    def residual(self, effect: Concealed, strength: float) -> float:
        """Return the root mean square [m] of the change that is left after the linear refit of the base model."""
        return float(np.sqrt(np.mean(self.left(concealing(self.base, self.plan, [(effect, strength)])) ** 2)))


def concealing(
    base: Mapping[str, float],
    plan: Sequence[Excitation],
    effects: Sequence[tuple[Concealed, float]],
    disturbances: Sequence[Disturbance] = (),
) -> tuple[Array, ...]:
    """Simulate effects of given strengths; one array per recording, m; ``disturbances`` as of ``simulate_all``."""
    values = dict(base)
    for effect, strength in effects:
        values.update(effect.law(strength))
    outputs = simulate_all(values, plan, disturbances)
    for effect, strength in effects:
        outputs = tuple(q + effect.added(strength, e) for q, e in zip(outputs, plan, strict=True))
    return outputs


def ruler(base: Mapping[str, float], plan: tuple[Excitation, ...]) -> Ruler:
    """Simulate the base model and its sensitivities (central differences in each of its parameters)."""
    columns = []
    for name in moving(base):
        above = simulate_all({**base, name: base[name] * (1.0 + _STEP)}, plan)
        below = simulate_all({**base, name: base[name] * (1.0 - _STEP)}, plan)
        columns.append(_stacked([(a - b) / (2.0 * _STEP) for a, b in zip(above, below, strict=True)]))
    # One direction, the common factor of all impedances, moves nothing: its singular value is rounding.
    return Ruler(base, plan, simulate_all(base, plan), _basis(columns))


def rulers(base: Mapping[str, float], plan: tuple[Excitation, ...], noise: Noise) -> tuple[Ruler, Ruler]:
    """Return rulers of displacement in m and of displacement whitened by the noise, from one set of differences.

    The mass is left alone: the others span all changes, for a common factor of all impedances moves
    nothing, and forward differences would turn that nothing into a direction of their own.
    """
    undisturbed = simulate_all(base, plan)
    changes = []
    for name in (n for n in moving(base) if n != "m"):
        part = _FAINT.get(name, _AHEAD)
        ahead = simulate_all({**base, name: base[name] * (1.0 + part)}, plan)
        changes.append([(a - q) / part for a, q in zip(ahead, undisturbed, strict=True)])

    def white(paths: Sequence[Array]) -> Array:
        return np.concatenate([_without_zero(path, noise) for path in paths])

    stacks: tuple[Stack, Stack] = (_stacked, white)
    first, second = (Ruler(base, plan, undisturbed, _basis([s(c) for c in changes]), s) for s in stacks)
    return first, second


def _without_zero(path: Array, noise: Noise) -> Array:
    """Return the whitened path without what the (whitened) zero of its recording can take."""
    zero, white = noise.whitened(np.ones_like(path)), noise.whitened(path)
    rest: Array = white - zero * ((zero @ white) / (zero @ zero))
    return rest


def _basis(columns: Sequence[Array]) -> Array:
    basis, sizes, _ = np.linalg.svd(np.stack(columns, axis=1), full_matrices=False)
    kept: Array = basis[:, sizes > 1e-6 * sizes[0]]
    return kept


def find_strength(
    residual: Callable[[float], float], guess: float, most: float, target: float, close: float = _CLOSE
) -> tuple[float, float]:
    """Find the strength whose residual is ``target`` by bracketed secants in logarithms.

    Args:
        residual: of a strength, in m or in units of the noise; called last with the strength that is returned.
        guess: a strength to begin with.
        most: largest strength.
        target: wanted residual.
        close: accepted relative distance from the target.

    Returns:
        The strength, and the residual it has.

    Raises:
        SolverFailed: even the largest strength stays below the target.
    """
    low, high = 0.0, math.inf  # strengths known to be too weak, too strong
    strength, slope = guess, 1.0
    last: tuple[float, float] | None = None
    for _ in range(40):
        value = residual(strength)
        if abs(value / target - 1.0) < close:
            return strength, value
        if value < target:
            low = max(low, strength)
        else:
            high = min(high, strength)
        if low >= most:
            break
        if last is not None and value > 0.0 and last[1] > 0.0 and strength != last[0]:
            slope = min(max(math.log(value / last[1]) / math.log(strength / last[0]), 0.3), 4.0)
        last = strength, value
        # A threshold can hide a weak effect altogether: then the strength has to grow before a secant exists.
        factor = min(max((target / value) ** (1.0 / slope), 0.05), 20.0) if value > 0.0 else 5.0
        strength = min(strength * factor, most)
        if not low < strength < high and math.isfinite(high):
            strength = math.sqrt(low * high) if low > 0.0 else 0.2 * high
    raise SolverFailed(f"no strength up to {most:g} leaves what is wanted, {target:g}: draw another seed")


@dataclass(frozen=True)
class Background:
    """A little creep and a little asymmetry of the hysteresis that act beside what is concealed.

    Attributes:
        parameters: for the simulation, SI.
        effects: canonical names.
        level: root mean square that it leaves beyond a refit of the base model, over the noise.
    """

    parameters: Mapping[str, float]
    effects: tuple[str, ...]
    level: float


def draw_background(
    rng: Rng, base: Mapping[str, float], plan: tuple[Excitation, ...], noise: float, without: Sequence[str]
) -> Background:
    """Draw creep and asymmetry that together leave 0.3 to 1 × the noise, in a drawn proportion.

    Args:
        rng: random numbers of the background alone.
        base: parameters of the actuator, SI.
        plan: the recordings.
        noise: standard deviation, m.
        without: takes no part in the background: what is concealed itself, or has no meaning in this actuator.
    """
    total, angle = float(rng.uniform(*_LEVELS)), float(rng.uniform(0.1, 0.4)) * math.pi
    other = "tau_V" in base
    effects = [FORMS["log_creep"][1](rng, base, plan)] if other else [draw(name, rng, base, plan) for name in KINDS]
    shares = zip(effects, (math.cos(angle), math.sin(angle)), strict=False)
    chosen = [(e, s) for e, s in shares if e.name not in without]
    measure = ruler(base, plan)
    parts: list[tuple[Concealed, float]] = []
    for effect, share in chosen:
        target = total * noise * (share if len(chosen) > 1 else 1.0)
        try:
            strength, _ = find_strength(
                lambda z, of=effect: measure.residual(of, z),  # type: ignore[misc]
                effect.guess,
                effect.most,
                target,
                _CLOSE_BACKGROUND,
            )
        except SolverFailed:
            continue  # it cannot be that strong on these recordings
        parts.append((effect, strength))
    left = measure.left(concealing(base, plan, parts))
    parameters = {n: v for effect, strength in parts for n, v in effect.law(strength).items()}
    return Background(parameters, tuple(e.name for e, _ in parts), float(np.sqrt(np.mean(left**2))) / noise)


@dataclass(frozen=True)
class _Part:
    """One effect with its strength, and the outputs with it alone."""

    effect: Concealed
    strength: float
    outputs: tuple[Array, ...]


@dataclass(frozen=True)
class _Gauges:
    """Rulers in m and in units of the noise."""

    metres: Ruler
    white: Ruler

    def of(self, outputs: Sequence[Array], case: Case) -> tuple[float, float]:
        """Return residual over noise, and noncentrality."""
        residual = np.sqrt(np.mean(self.metres.left(outputs) ** 2))
        return float(residual) / case.noise.deviation, float(np.linalg.norm(self.white.left(outputs)))


def make_case(case: Case, folder: Path, write: Writer = Path.write_bytes) -> Sealed:
    """Find shapes and strengths, simulate, add noise, write the recordings; nothing in the folder tells the answer.

    Where no strength of a drawn shape reaches what is wanted, the shape is drawn again, ten times, then the case's
    next choice takes the place; where none is left, half of it is wanted, and a quarter at last.

    Args:
        case: what to conceal.
        folder: made if need be; gets ``NAME.csv`` per recording and ``recordings.yaml``.
        write: puts each file on the disk.

    Returns:
        The answer: keep it with ``write_seal``, elsewhere.

    Raises:
        InputRefused: the folder holds files of others.
        SolverFailed: the simulation failed, or nothing can be made strong enough.
    """
    plan = case.recordings
    seal.refuse_strangers(folder, plan)
    case, background = _with_background(case, plan)
    # An effect is as strong as the recordings without the examination show it.
    seen = tuple(e for e in plan if not e.name.startswith(EXAM))
    gauges = _Gauges(*rulers(case.base, seen, case.noise)) if case.effects else None
    choice, parts, redrawn = (case.choices[0], [], 0) if gauges is None else _chosen(case, plan, gauges)

    def simulated(disturbances: Sequence[Disturbance] = ()) -> tuple[Array, ...]:
        return concealing(case.base, plan, [(part.effect, part.strength) for part in parts], disturbances)

    outputs = parts[0].outputs if len(parts) == 1 and seen == plan else simulated()
    moved = disturbed(case.noise, case.base, plan, outputs, simulated, case.stream)
    sensor = case.stream("sensor")
    reports = [seal.reported(q, case.noise, sensor) for q in moved]
    seal.write_folder(folder, case.stated_mass, plan, reports, hysterons=case.stated_hysterons, write=write)
    answer = _answer(case, choice, parts, redrawn, outputs, gauges)
    return replace(answer, **_on_request(case, background, outputs, moved, reports))


def _with_background(case: Case, plan: tuple[Excitation, ...]) -> tuple[Case, Background | None]:
    """Return the case with a background in its base, where one was asked for; nothing in it can be a later choice."""
    if not case.conditions.background:
        return case, None
    none = (*case.effects, *(name for name in KINDS if not acts_on(name, case.conditions.base)))
    background = draw_background(case.stream("background"), case.base, plan, case.noise.deviation, none)
    choices = tuple(c for c in case.choices if not set(c.effects) & set(background.effects))
    return replace(case, base={**case.base, **background.parameters}, choices=choices), background


def _chosen(case: Case, plan: tuple[Excitation, ...], gauges: _Gauges) -> tuple[Choice, list[_Part], int]:
    """Choose the effects with their strengths; also count the rejected shapes.

    Shapes are drawn for all recordings of the plan, also for those that are not gauged.
    """
    rejected = 0
    for number, (weaker, choice) in enumerate(product(_WEAKER, case.choices)):
        parts: list[_Part] = []
        for index, target in enumerate(weaker * np.array(case.targets)):
            for effect in _shapes(case, choice, (number, index), plan):
                part = _part(effect, case, target, gauges)
                if part is not None:
                    parts.append(part)
                    break
                rejected += 1
            if len(parts) <= index:
                break
        if len(parts) == len(case.targets):
            return choice, parts, rejected
    raise SolverFailed(f"seed {case.seed}: nothing can be made as strong as wanted, {case.targets}: ask for less")


def _shapes(case: Case, choice: Choice, at: tuple[int, int], plan: tuple[Excitation, ...]) -> Iterator[Concealed]:
    """Yield the effect with one shape after the other; only once where it has none to draw."""
    seen = []
    for attempt in range(_SHAPES):
        effect = choice.concealed(at[1], case.stream("shape", *at, attempt), case.base, plan)
        stated = described(effect, effect.guess)
        if stated not in seen:
            yield effect
        seen.append(stated)


def _part(effect: Concealed, case: Case, target: float, gauges: _Gauges) -> _Part | None:
    """Return the effect as strong as wanted; none where no strength makes it so."""
    last: list[tuple[Array, ...]] = []

    def residual(strength: float) -> float:
        last[:] = [concealing(case.base, gauges.metres.plan, [(effect, strength)])]
        return gauges.of(last[0], case)[1 if case.by_delta else 0]

    try:
        strength, _ = find_strength(residual, effect.guess, effect.most, target, _CLOSE_ENOUGH)
    except SolverFailed:
        return None
    return _Part(effect, strength, last[0])


def _answer(
    case: Case, choice: Choice, parts: list[_Part], redrawn: int, outputs: Sequence[Array], gauges: _Gauges | None
) -> Sealed:
    level, delta, alone, apart = 0.0, 0.0, [], []
    if gauges is not None:
        level, delta = gauges.of(outputs[: len(gauges.metres.plan)], case)
        alone = [gauges.of(part.outputs, case) for part in parts]
        apart = _apart([gauges.white.left(part.outputs) for part in parts])
    return Sealed(
        effect="+".join(choice.effects) or "none",
        parameters={n: v for part in parts for n, v in described(part.effect, part.strength).items()},
        base=as_stated(case.base),
        strength_over_noise=level,
        noise=case.noise.deviation,
        quantisation=case.noise.step,
        seed=case.seed,
        plan=case.plan,
        effects=choice.effects,
        stratum=case.stratum,
        form=choice.form,
        location=choice.location,
        withheld=choice.withheld,
        levels=tuple(a[0] for a in alone),
        delta=delta,
        deltas=tuple(a[1] for a in alone),
        apart=tuple(apart),
        colour=case.noise.colour,
        redrawn=redrawn,
    )


def _apart(left: Sequence[Array]) -> list[float]:
    """Return the norm of each signal without what the other one's direction can take."""
    if len(left) < 2:
        return [float(np.linalg.norm(signal)) for signal in left]
    rest = [own - other * ((other @ own) / (other @ other)) for own, other in zip(left, left[::-1], strict=True)]
    return [float(np.linalg.norm(signal)) for signal in rest]


def _on_request(
    case: Case,
    background: Background | None,
    outputs: Sequence[Array],
    moved: Sequence[Array],
    reports: Sequence[Array],
) -> dict[str, Any]:
    """Return what a seal says of noise and conditions that were asked for.

    Args:
        outputs: without noise; moved: with what acts before the sensor; reports: of the sensor.
    """
    asked: dict[str, Any] = {}
    if case.family:
        power = [float(np.var(y - q)) for y, q in zip(reports, outputs, strict=True)]
        total = float(np.average(power, weights=[q.size for q in outputs]))
        asked |= {
            "noise_family": case.family,
            "noise_amount": case.noise.amount or case.noise.colour,
            "noise_total": total**0.5,
            "noise_rms": {e.name: p**0.5 for e, p in zip(case.recordings, power, strict=True)},
            "noise_unrecorded": added_power(moved, outputs) / total,
        }
    if background is not None:
        asked |= {
            "background": dict(background.parameters),
            "background_effects": background.effects,
            "background_level": background.level,
        }
    if case.conditions.base != HYSTERONS:
        asked |= {"base_family": case.conditions.base, "stated_hysterons": case.stated_hysterons}
    elif case.conditions.hysterons != PLAIN.hysterons or case.conditions.wrong_order:
        asked |= {"hysterons": case.hysterons, "stated_hysterons": case.stated_hysterons}
    if case.conditions.anchor_error:
        asked["stated_mass"] = case.stated_mass
    return asked


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
    known = (*EFFECTS, *ON_REQUEST)
    if effect is not None and effect not in known:
        raise InputRefused(f"no effect called {effect!r} to conceal: take one of {', '.join(known)}")
    if seed < 0:
        raise InputRefused(f"seed = {seed}: give a whole number, 0 or more")
    seal.refuse_strangers(folder, excitations)
    # The noise has a stream of its own: it stays the same whatever effect a seed is told to conceal.
    choices, sensor = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
    drawn = str(choices.choice(EFFECTS))
    base = draw_base(choices)
    noise = Noise(float(choices.uniform(20e-9, 80e-9)), int(choices.integers(5, 21)) * 1e-9)
    target = float(np.exp(choices.uniform(*np.log(_TARGETS))))

    name = effect or drawn
    parameters: Mapping[str, float] = {}
    parts: list[tuple[Concealed, float]] = []
    left = 0.0
    if name != "none":
        concealed, measure = draw(name, choices, base, excitations), ruler(base, excitations)
        strength, left = find_strength(
            lambda z: measure.residual(concealed, z), concealed.guess, concealed.most, target * noise.deviation
        )
        parts, parameters = [(concealed, strength)], described(concealed, strength)
    reports = [seal.reported(q, noise, sensor) for q in concealing(base, excitations, parts)]
    seal.write_folder(folder, base["m"], excitations, reports, write=write)
    effects = tuple(e.name for e, _ in parts)
    return Sealed(
        effect=name,
        parameters=parameters,
        base=base,
        strength_over_noise=left / noise.deviation,
        noise=noise.deviation,
        quantisation=noise.step,
        seed=seed,
        plan=plan,
        effects=effects,
        stratum="same" if effects else "none",
        location=tuple(LOCATIONS[n] for n in effects),
    )
