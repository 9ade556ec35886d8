"""An effect that a selection has added."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from phnn.criteria import SELECTION
from phnn.diagnose.formula import Distilled
from phnn.diagnosis.name import Naming
from phnn.diagnosis.trial import Trial
from phnn.effects import Effect
from phnn.identification.fit import Fit
from phnn.identification.gain import Gain


@dataclass(frozen=True)
class Finding:
    """One effect that was added, with everything that was tried for it.

    Attributes:
        trial: its refit; members: those that cannot be told from it, it among them; trials: all.
        naming: the scores that led to it.
        held_out: what it gains on held-out recordings; None before they were asked, and where there are none.
        provisional: part of the model, for the identification recordings ask for it, but not named.
        level: p-value below which its own score is significant.
        others_alone: the model with all other findings, fitted from the model that also has this one; None where it was
            not asked for, or cannot be fitted.
        gained: what it gains on identification recordings that were left out while it was found; None where none were.
        learned: it is a learned element, which has no name; description: the formula that stands for it, where there is
            one.
        laws: of a learned element: effects of the catalogue that take nearly all that it takes, in its place, the best
            one first; the element is one of these in another form.
        first: of an effect of the search in a model that was composed further: share of the excess, on identification
            recordings that were left out, that all effects of the search took before anything was added to them.
    """

    trial: Trial
    members: tuple[Trial, ...]
    trials: tuple[Trial, ...]
    naming: Naming
    held_out: Gain | None = None
    provisional: bool = False
    level: float = SELECTION.level
    others_alone: Fit | None = None
    gained: Gain | None = None
    learned: bool = False
    description: Distilled | None = None
    laws: tuple[Trial, ...] = ()
    first: float | None = None

    @property
    def effect(self) -> Effect:
        """The effect that was added."""
        return self.trial.candidate.effect

    @property
    def nameless(self) -> bool:
        """Whether it is a learned element that no effect of the catalogue can nearly replace."""
        return self.learned and not self.laws

    @property
    def alike(self) -> tuple[Trial, ...]:
        """The effects of which these recordings cannot tell it, the most probable one first."""
        return self.laws or self.members

    @property
    def named_as(self) -> Effect:
        """The effect whose name it has where its name is claimed."""
        return self.alike[0].candidate.effect

    @property
    def described(self) -> Distilled | None:
        """The formula of a learned element, if it explains as much as the element."""
        found = self.description
        return found if found is not None and found.as_good and found.first_order else None

    @property
    def takes(self) -> float:
        """Mean square [noise²] that it takes from identification recordings that were left out; 0 where none were."""
        return 0.0 if self.gained is None else self.gained.takes

    @property
    def share(self) -> float | None:
        """Share of the excess over the noise that it takes on identification recordings which took no part in finding
        it; None where none were left out for that."""
        return None if self.gained is None else self.gained.share

    @property
    def evidence(self) -> tuple[float, float]:
        """Statistic and p-value: of its own score, or the supremum's where only a refit has shown it."""
        own = self.trial.candidate
        if own.p_value < self.level:
            return own.score, own.p_value
        return self.naming.statistic, self.naming.p_value


def effects_of(findings: Sequence[Finding]) -> list[Effect]:
    """The effects themselves."""
    return [f.effect for f in findings]


def own_parameters(findings: Sequence[Finding]) -> list[str]:
    """Parameters of the effects that were found."""
    return [n for f in findings for n in f.effect.parameters]


def without_element(findings: Sequence[Finding], gone: Finding) -> tuple[Finding, ...]:
    """The others; where one of the search has gone, what all of these took says nothing of the others any more."""
    rest = (f for f in findings if f is not gone)
    return tuple(rest if gone.first is None else (replace(f, first=None) for f in rest))
