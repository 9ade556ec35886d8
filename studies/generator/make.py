"""Make the recordings of a case, and its answer."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from phnn.errors import SolverFailed
from studies.generator.background import KINDS, NOTHING, Background, draw_background
from studies.generator.base import as_stated
from studies.generator.case import Case
from studies.generator.concealed import Concealed, described
from studies.generator.conditions import PLAIN
from studies.generator.disturbance import Disturbance
from studies.generator.excitation import Excitation
from studies.generator.folder import MANIFEST, Writer, refuse_strangers, reported, write_manifest, write_recording
from studies.generator.other_base import HYSTERONS, acts_on
from studies.generator.parameters import Array
from studies.generator.plans import EXAM
from studies.generator.sealed import Sealed
from studies.generator.strata import Choice
from studies.generator.strength import Ruler, concealing, find_strength, rulers
from studies.generator.unrecorded import disturbed

_SHAPES = 10  # drawn of one effect before another one takes its place
_WEAKER = (1.0, 0.5, 0.25)  # parts of what is wanted that are tried after each other

_CLOSE = 0.1  # accepted relative distance from what is wanted: the answer states what was reached


@dataclass(frozen=True)
class _Part:
    """One effect with its strength, and the outputs with it alone."""

    effect: Concealed
    strength: float
    outputs: tuple[Array, ...]


Parts = list[_Part]


@dataclass(frozen=True)
class _Gauges:
    """Rulers in m and in units of the noise."""

    metres: Ruler
    white: Ruler

    def of(self, outputs: Sequence[Array], case: Case) -> tuple[float, float]:
        """Residual over noise, and noncentrality."""
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
    refuse_strangers(folder, plan)
    case, background = _with_background(case, plan)
    # An effect is as strong as the recordings without the examination show it.
    seen = tuple(e for e in plan if not e.name.startswith(EXAM))
    gauges = _Gauges(*rulers(case.base, seen, case.noise)) if case.effects else None
    choice, parts, redrawn = (case.choices[0], [], 0) if gauges is None else _chosen(case, plan, gauges)
    outputs = parts[0].outputs if len(parts) == 1 and seen == plan else _together(case, plan, parts)
    final = disturbed(
        case.noise, case.base, plan, outputs, lambda d: _together(case, plan, parts, d), case.stream
    )  # fmt: skip
    sensor = case.stream("sensor")
    reports = [reported(q, case.noise, sensor) for q in final.outputs]
    folder.mkdir(parents=True, exist_ok=True)
    for excitation, y in zip(plan, reports, strict=True):
        write_recording(folder / f"{excitation.name}.csv", excitation, y, write)
    write_manifest(folder / MANIFEST, case.stated_mass, plan, hysterons=case.stated_hysterons, write=write)
    answer = _answer(case, choice, parts, redrawn, outputs, gauges)
    if case.family:
        answer = replace(answer, **_noise_as_made(case, reports, outputs, final.power))
    return replace(answer, **_conditions_as_made(case, background))


def _with_background(case: Case, plan: tuple[Excitation, ...]) -> tuple[Case, Background]:
    """The case with a background in its base, where one was asked for; nothing in it can be a later choice."""
    if not case.conditions.background:
        return case, NOTHING
    none = (*case.effects, *(name for name in KINDS if not acts_on(name, case.conditions.base)))
    found = draw_background(case.stream("background"), case.base, plan, case.noise.deviation, none)
    choices = tuple(c for c in case.choices if not set(c.effects) & set(found.effects))
    return replace(case, base={**case.base, **found.parameters}, choices=choices), found


def _conditions_as_made(case: Case, background: Background) -> dict[str, Any]:
    """What a seal says of conditions that were asked for."""
    asked: dict[str, Any] = {}
    if case.conditions.background:
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


def _chosen(case: Case, plan: tuple[Excitation, ...], gauges: _Gauges) -> tuple[Choice, Parts, int]:
    """Choose the effects with their strengths; also count the rejected shapes.

    Shapes are drawn for all recordings of the plan, also for those that are not gauged.
    """
    rejected = 0
    for number, (weaker, choice) in enumerate(product(_WEAKER, case.choices)):
        parts: Parts = []
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
    """The effect with one shape after the other; only once where it has none to draw."""
    seen = []
    for attempt in range(_SHAPES):
        effect = choice.concealed(at[1], case.stream("shape", *at, attempt), case.base, plan)
        stated = described(effect, effect.guess)
        if stated not in seen:
            yield effect
        seen.append(stated)


def _part(effect: Concealed, case: Case, target: float, gauges: _Gauges) -> _Part | None:
    """The effect as strong as wanted; none where no strength makes it so."""
    last: list[tuple[Array, ...]] = []

    def residual(strength: float) -> float:
        last[:] = [concealing(case.base, gauges.metres.plan, [(effect, strength)])]
        return gauges.of(last[0], case)[1 if case.by_delta else 0]

    try:
        strength, _ = find_strength(residual, effect.guess, effect.most, target, _CLOSE)
    except SolverFailed:
        return None
    return _Part(effect, strength, last[0])


def _together(
    case: Case, plan: tuple[Excitation, ...], parts: Parts, disturbances: Sequence[Disturbance] = ()
) -> tuple[Array, ...]:
    return concealing(case.base, plan, [(part.effect, part.strength) for part in parts], disturbances)


def _noise_as_made(case: Case, reports: Sequence[Array], outputs: Sequence[Array], unrecorded: float) -> dict[str, Any]:
    """What a seal says of noise of a family that was asked for."""
    added = [y - q for y, q in zip(reports, outputs, strict=True)]
    power = [float(np.var(n)) for n in added]
    total = float(np.average(power, weights=[n.size for n in added]))
    names = [excitation.name for excitation in case.recordings]
    return {
        "noise_family": case.family,
        "noise_amount": case.noise.amount or case.noise.colour,
        "noise_total": total**0.5,
        "noise_rms": {name: p**0.5 for name, p in zip(names, power, strict=True)},
        "noise_unrecorded": unrecorded / total,
    }


def _answer(
    case: Case, choice: Choice, parts: Parts, redrawn: int, outputs: Sequence[Array], gauges: _Gauges | None
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
    """Norm of each signal without what the other one's direction can take."""
    if len(left) < 2:
        return [float(np.linalg.norm(signal)) for signal in left]
    rest = [own - other * ((other @ own) / (other @ other)) for own, other in zip(left, left[::-1], strict=True)]
    return [float(np.linalg.norm(signal)) for signal in rest]
