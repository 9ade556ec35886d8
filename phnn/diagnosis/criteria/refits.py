"""Criteria for the refits of candidate effects: how long each lasts, and which go on."""

from __future__ import annotations

from dataclasses import dataclass

from phnn.diagnosis.criteria.criterion import STUDIED, criterion


@dataclass(frozen=True)
class Refits:
    """How long a refit lasts, and where it begins."""

    first_evaluations: int = criterion(
        5,
        "evaluations",
        "Length of a refit in the first round.",
        STUDIED,
    )
    second_evaluations: int = criterion(8, "evaluations", "Length of a further stretch of a refit.", STUDIED)
    last_evaluations: int = criterion(
        40,
        "evaluations",
        "Greatest length of a refit that is carried to convergence.",
        STUDIED,
    )
    loose_tolerance: float = criterion(
        1e-5,
        "relative change of χ²",
        "Where a refit that leaves much more than the noise stops.",
        "Argument: 1e-5 of χ² is below the tie of two refits wherever the residual exceeds the noise.",
    )
    other_starts: int = criterion(
        2,
        "starts",
        "Further grid points of an effect from which a refit begins.",
        STUDIED,
    )
    longest_step: float = criterion(
        2.0,
        "estimation coordinate",
        "Base parameters move no further to make room for an effect before its refit begins.",
        "Calculation: coordinates of positive parameters are logarithms; 2 is a factor of seven.",
    )
    large_starts: int = criterion(
        4,
        "starts",
        "Large-step starts of an effect whose score has led nowhere.",
        "Choice: of cost; two signs of two shapes.",
    )
    large_start_share: float = criterion(
        0.5,
        "share of the squares left",
        "A large-step start changes the output by about this much.",
        "Argument: an effect that explains the residual changes it by 1; base parameters will take part of that over.",
    )
    large_start_most: float = criterion(
        3.0,
        "share of the squares left",
        "A large-step start changes the output by no more.",
        "Argument: beyond it, even the best base parameters leave more than there was.",
    )


@dataclass(frozen=True)
class Race:
    """Which candidates go on to the next round of refits."""

    large_residual: float = criterion(
        3.0,
        "noise rms",
        "A residual above it is no noise, whatever the doubt about the noise level.",
        "Calculation: more than the greatest doubt about the level (a factor of two) can explain.",
        origin=1.0,
    )
    enter_large: int = criterion(
        6, "candidates", "How many go on from large-step starts.", "Choice: of cost; the catalogue has some thirty."
    )
    enter_second: int = criterion(
        6, "candidates", "How many enter the second round.", "Choice: of cost; larger than a class that helps anybody."
    )
    enter_last: int = criterion(
        4, "candidates", "How many are carried to convergence.", "Choice: a larger class than four helps nobody."
    )
    least_saving: float = criterion(
        0.35,
        "share of the best saving",
        "A candidate that saves less in the first round goes no further.",
        STUDIED,
    )
    near_moving: float = criterion(
        2.0,
        "ratio to the best χ²",
        "A refit above it cannot win, even if it was still moving or its effect is a neighbour of the best.",
        STUDIED,
        origin=1.0,
    )
    near_at_rest: float = criterion(
        1.3,
        "ratio to the best χ²",
        "A refit above it that has converged cannot win.",
        "Argument: finer sub-steps and released parameters move a converged refit little.",
        origin=1.0,
    )
    least_score: float = criterion(
        0.25,
        "share of the best score",
        "A candidate that scores less is not refitted.",
        "Calculation: a squared score is the χ² that a refit saves to first order: a sixteenth of the best.",
    )
    explained_left: float = criterion(
        0.05,
        "share of the excess",
        "Once a refit leaves less, only candidates that score nearly as high can tie with it.",
        "Argument: another candidate would have to explain more than 95 % too, so that its score must show it.",
    )
    rival_score: float = criterion(
        0.75,
        "share of the best score",
        "Score from which a candidate can still tie with a refit that explains nearly everything.",
        "Calculation: it saves 56 % of the best χ² to first order.",
    )
    unexplained_left: float = criterion(
        0.1,
        "share of the excess",
        "Where the best refit leaves more, all effects start again at finite strengths.",
        "Argument: the score is a derivative at strength zero and may not show an effect that would explain more.",
    )
    failed_left: float = criterion(
        0.5,
        "share of the excess",
        "A refit that leaves more starts again at finite strengths.",
        STUDIED,
    )
    incomparable_left: float = criterion(
        0.85,
        "share of the excess",
        "Where all leave more of a residual above `large_residual`, only the best is carried to convergence.",
        "Argument: the best explains < 15 % of the excess; to compare such refits costs minutes and tells nothing.",
    )


REFITS, RACE = Refits(), Race()
