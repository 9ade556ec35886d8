"""A proposed recording, and in words why it is proposed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from string import ascii_uppercase

import numpy as np
from numpy.typing import NDArray

from phnn.diagnosis.menu import Experiment
from phnn.diagnosis.questions import Question
from phnn.diagnosis.rival import Rival

Array = NDArray[np.float64]

# A recording is not asked for more often.
_OFTEN = 100


@dataclass(frozen=True)
class NextExperiment:
    """A recording to make.

    Attributes:
        recording: all that is needed to make it, in words; experiment: the same for a program.
        separates: models that it tells from another one, by the name of what each has beyond the others; all where it
            tells none apart, and none where it measures.
        why: a sentence with the figures.
        separation: the smallest between models that it tells apart, in noise units over the whole recording; where it
            measures, the factor by which the standard errors of an element's numbers shrink.
        needed: the separation from which two models are told apart; where it measures, the factor that a repetition of
            all recordings at hand would give.
        menu: the smallest separation between any two, or that factor, by recording of the menu.
        aim: ``separate`` or ``measure``.
        groups: ``separates`` by question: a class of effects or places, or one element and what may stand in its place.
    """

    recording: str
    separates: tuple[str, ...]
    why: str
    separation: float
    needed: float
    experiment: Experiment
    menu: Mapping[str, float]
    aim: str = "separate"
    groups: tuple[tuple[str, ...], ...] = ()


def why_it_separates(questions: Sequence[Question], apart: Array, needed: float) -> str:
    """Which models compete, how far the recording moves them apart, and which it does not tell apart.

    Args:
        apart: (P,) separations of all pairs of models, question by question.
        needed: from where on they are told apart.
    """
    short = _short([m for q in questions for m in q.models])
    competing = "".join(f"{_competing(q, short)} " for q in questions if q.element)
    pairs = [f"{short[id(a)]} and {short[id(b)]}" for q in questions for a, b in combinations(q.models, 2)]
    told = [(pair, s) for pair, s in zip(pairs, apart, strict=True) if s >= needed]
    start = f"{competing}With their parameters refitted as far as the recordings at hand allow, the models of "
    end = f"× noise over the whole recording; {_two(needed)} are needed to tell two models apart"
    if not told:
        pair, s = min(zip(pairs, apart, strict=True), key=lambda item: item[1])
        times = math.ceil((needed / s) ** 2) if s > 0.0 else 0
        often = f": make it {times} times" if 0 < times < _OFTEN else ""
        return f"{start}{pair} differ there by {_two(s)} {end}{often}."
    pair, s = min(told, key=lambda item: item[1])
    rest = [pair for pair, value in zip(pairs, apart, strict=True) if value < needed]
    but = f" It does not tell apart {'; '.join(rest)}." if rest else ""
    least = " least: by" if len(told) > 1 else " by"
    return f"{start}{pair} differ there{least} {_two(s)} {end}.{but}"


def _short(models: Sequence[Rival]) -> dict[int, str]:
    """What a model is called after it was introduced, by its id: a formula by a letter."""
    letters = iter(ascii_uppercase)
    return {id(m): f"formula {next(letters)}" if m.is_formula else m.words for m in models}


def _competing(question: Question, short: Mapping[int, str]) -> str:
    """What may stand in the place of an element without a name."""
    first, *others = [m.words + f" ({short[id(m)]})" * m.is_formula for m in question.models]
    own = question.element.replace("_", " ")
    element = f"The element {own}" if first == own else f"The element {own}, described as {first},"
    return f"{element} has no proven name: in its place {_listed(others)} explains these recordings nearly as well."


def why_it_measures(question: Question, times: float, needed: float) -> str:
    """That an element has no rival, and how much the recording says of its numbers.

    Args:
        times: the factor by which their standard errors shrink; needed: what a repetition of all recordings gives.
    """
    model, own = question.models[0], question.element.replace("_", " ")
    element = own if model.words == own else f"{own}, described as {model.words}"
    small = " only" if times < needed else ""
    return (
        f"Nothing else that was tried explains these recordings nearly as well as the element {element}. No two models "
        f"are left to be told apart, so this recording measures the element itself: beside the recordings at hand it "
        f"makes the standard errors of its numbers smaller by a factor of{small} {_two(times)} (geometric mean). To "
        f"repeat all recordings at hand would give {_two(needed)}."
    )


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} or {names[-1]}"


def _two(value: float) -> str:
    """Two digits, and no exponent."""
    return f"{float(f'{value:.2g}'):.10g}"
