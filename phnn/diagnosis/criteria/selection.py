"""Criteria for what is added to a model, what is kept, and which word the verdict is."""

from __future__ import annotations

from dataclasses import dataclass

from phnn.diagnosis.criteria.criterion import STUDIED, criterion


@dataclass(frozen=True)
class Selection:
    """When an effect explains a residual, and when two explain it equally well."""

    level: float = criterion(
        0.01,
        "probability",
        "A residual is significant below this p-value; the level of the whole search.",
        "Calculation: hypotheses are tested in a fixed order, so that each may use the whole level "
        "(Maurer, Hothorn & Lehmacher 1995).",
    )
    numerical_score: float = criterion(
        0.3,
        "noise standard deviations",
        "Sub-steps are halved while the numerical error alone scores more; where it still does, no name is proven.",
        "Calculation: a score of 2.33 that is 0.3 too large has p = 0.021 in place of 0.01.",
    )
    first_refits: int = criterion(
        14, "candidates", "Refitted for a first effect, at most.", "Choice: of cost; half of the catalogue."
    )
    further_refits: int = criterion(6, "candidates", "Refitted for a further effect, at most.", "Choice: of cost.")
    explains: float = criterion(0.5, "share of the excess", "A first effect that explains less is not kept.", STUDIED)
    explains_further: float = criterion(
        0.7,
        "share of the excess",
        "A further effect, or a first one where nothing is located, that explains less is not kept.",
        "Argument: above `explains`, for a further effect is chosen among more. " + STUDIED,
    )
    explains_some: float = criterion(
        0.25,
        "share of the excess",
        "An effect that explains less ends the search.",
        "Argument: of two effects of one size the first explains half, of three a third.",
    )
    explains_well: float = criterion(
        0.9,
        "share of the excess",
        "From here on an effect explains well: no learned element is compared with it, and it may be one of a class.",
        "Measured: the concealed effects of the demonstrations take 97 % or more of the held-out excess.",
    )
    noise_doubt: float = criterion(
        1.02,
        "noise rms",
        "A residual below it is not held against an effect.",
        "Calculation: a floor from 2,500 samples is known to 1.4 %.",
        origin=1.0,
    )
    small_residual: float = criterion(
        1.1,
        "noise rms",
        "A residual below it ends the search, and is told as immaterial where nothing predicts recordings better; "
        "above it, refits are compared with the remainder in mind.",
        "Calculation: what is left has a fifth of the noise's power. " + STUDIED,
        origin=1.0,
    )
    one_form: float = criterion(
        2.0,
        "noise rms",
        "An effect in another form that leaves more may as well be two effects: the search goes on.",
        STUDIED,
        origin=1.0,
    )
    compared_within: float = criterion(
        10.0,
        "ties",
        "Refits that end so near the best one are compared with their numerical error bounded.",
        STUDIED,
    )
    numerical_share: float = criterion(
        0.05,
        "share of the excess's norm",
        "Numerical error allowed beside what is left.",
        "Calculation: a fifth of the least share that counts (`explains_some`), and its square is 0.25 % of χ².",
    )
    tie: float = criterion(
        12.0,
        "residual variances",
        "Two refits whose χ² differ by less are equally good.",
        "Calculation: 3.5 standard deviations of one parameter, p = 5e-4.",
    )
    tie_of_remainder: float = criterion(
        0.2,
        "share of the remainder",
        "Where even the best refit leaves something significant, a smaller difference of χ² decides nothing.",
        "Argument: what is left over by all may favour either.",
    )
    retested: int = criterion(
        3,
        "candidates",
        "Refitted in the place of an earlier effect after another one has joined.",
        "Choice: of cost.",
    )
    learned_leaves: float = criterion(
        0.5,
        "ratio of the excesses",
        "A learned element that leaves less of what the named effects leave shows that these are not the cause.",
        "Argument: a dozen free strengths lower any χ², but do not halve what the right kind of effect has left.",
    )
    together: float = criterion(
        0.95,
        "share of the excess",
        "Several effects that explain less together, and leave more than `small_residual`, are no explanation.",
        "Argument: two effects can confound much that is neither of them. " + STUDIED,
    )
    nearly_all: float = criterion(
        0.95,
        "share of the excess",
        "Effects that explain more keep their names although what they leave lies elsewhere.",
        "Measured: in sealed cases with a small background the right effects explained 0.98 to 0.99, and left the "
        "background at its own place. " + STUDIED,
    )


SELECTION = Selection()
