"""The verdict: named, equivalent, unknown or none, and the same question about the remainder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from phnn.diagnose.ground import Ground, prepare
from phnn.diagnose.learn import learn
from phnn.diagnose.locate import Location, Responses, locate, responses
from phnn.diagnose.name import Naming, score
from phnn.diagnose.refit import Trial, class_of, refit
from phnn.effects import Effect
from phnn.identify.fit import Fit
from phnn.identify.numerics import NumericalError

SIGNIFICANT = 0.01
_REFITS = 5
# Below this share of the excess residual explained, a catalogue entry imitates the truth rather than being it.
_EXPLAINS = 0.7
# What comes second explains what the first left, which in real recordings is itself a mixture.
_EXPLAINS_MORE = 0.4
# A second effect must matter: it is looked for only where the residual exceeds the noise by this much.
_MATERIAL = 1.1


@dataclass(frozen=True)
class Finding:
    """One effect that was added, with everything that was tried for it."""

    trial: Trial
    members: tuple[Trial, ...]
    trials: tuple[Trial, ...]
    naming: Naming


@dataclass(frozen=True)
class Judgement:
    """Attributes:
    verdict: ``named``, ``equivalent``, ``unknown`` or ``none``.
    ground, naming, location: of the base model; location is None for ``none``.
    findings: effects added, in order; empty for ``none`` and ``unknown``.
    tried: refits of a first effect, also where none was accepted.
    final: the last fit; the base fit for ``none``.
    remainder: scores on the final model's residual; None for ``none``.
    remainder_location: where what remains seems to be.
    learned: whether ``final`` contains a learned one-port.
    """

    verdict: str
    ground: Ground
    naming: Naming
    location: Location | None
    final: Fit
    final_ground: Ground
    findings: tuple[Finding, ...] = ()
    tried: tuple[Trial, ...] = ()
    remainder: Naming | None = None
    remainder_location: Location | None = None
    learned: bool = False
    generic: Responses | None = field(default=None, repr=False)


def excess(fit: Fit) -> float:
    """Sum of squares above what noise of the stated floor leaves."""
    return fit.cost - (fit.residual.size - fit.jacobian.shape[1])


def judge(
    base: Fit, effects: Sequence[Effect], seed: int, max_effects: int, new_in_held_out: bool, error: NumericalError
) -> Judgement:
    """Locate, name, refit and judge.

    Args:
        base: the fitted base model.
        effects: the catalogue entries that can exist in this setup.
        seed: of the null distribution.
        max_effects: how many effects may be added one after the other.
        new_in_held_out: whether confirmation brings something new; without it the word is ``equivalent`` at most.
        error: numerical error of the simulations.
    """
    ground = prepare(base)
    generic = responses(ground)
    naming = score(ground, effects, generic, seed, error.error)
    if naming.p_value >= SIGNIFICANT:
        return Judgement("none", ground, naming, None, base, ground, generic=generic)
    location = locate(ground, generic)
    findings: list[Finding] = []
    tried: tuple[Trial, ...] = ()
    current, here, scores = base, ground, naming
    while len(findings) < max_effects:
        left = [c for c in scores.candidates if c.p_value < SIGNIFICANT][:_REFITS]
        trials = refit(current, left)
        tried = tried or tuple(trials)
        if not trials or trials[0].fit is None:
            break
        fitted = trials[0].fit
        after = prepare(fitted)
        remainder = score(after, _others(effects, findings, trials[0]), responses(after), seed)
        share = 1.0 - max(excess(fitted), 0.0) / max(excess(current), 1e-300)
        enough = _EXPLAINS_MORE if findings else _EXPLAINS
        if share < enough and remainder.p_value < SIGNIFICANT and not _weak(current):
            break
        findings.append(
            Finding(trials[0], tuple(class_of(trials, remainder.p_value < SIGNIFICANT)), tuple(trials), scores)
        )
        current, here, scores = fitted, after, remainder
        if remainder.p_value >= SIGNIFICANT or fitted.chi2 < _MATERIAL**2:
            break
    if not findings:
        return _unknown(ground, naming, location, tried, effects, seed, generic)
    settled = new_in_held_out and all(len(f.members) == 1 for f in findings)
    remaining = locate(here) if scores.p_value < SIGNIFICANT else None
    verdict = "named" if settled else "equivalent"
    return Judgement(
        verdict, ground, naming, location, current, here, tuple(findings), tried, scores, remaining, False, generic
    )


def _weak(fit: Fit) -> bool:
    """Whether the excess is so small that its explained share is mostly noise."""
    return excess(fit) < 6.0 * (2.0 * fit.residual.size) ** 0.5


def _others(effects: Sequence[Effect], findings: Sequence[Finding], trial: Trial) -> list[Effect]:
    used = {f.trial.candidate.effect.name for f in findings} | {trial.candidate.effect.name}
    return [e for e in effects if e.name not in used]


def _unknown(
    ground: Ground, naming: Naming, location: Location, tried: tuple[Trial, ...], effects: Sequence[Effect], seed: int,
    generic: Responses,
) -> Judgement:  # fmt: skip
    """Real, and no element explains it: learn a passive one-port at the location."""
    learned = learn(ground, location.detail) if location.name == "mechanical" else None
    final = learned if learned is not None and learned.cost < ground.fit.cost else ground.fit
    after = prepare(final) if final is not ground.fit else ground
    remainder = naming if final is ground.fit else score(after, (), responses(after), seed)
    remaining = locate(after) if remainder.p_value < SIGNIFICANT else None
    return Judgement(
        "unknown", ground, naming, location, final, after, (), tried, remainder, remaining, final is not ground.fit,
        generic,
    )  # fmt: skip
