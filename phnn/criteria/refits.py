"""Criteria for the refits of candidate effects: how long each lasts, and which continue."""

from __future__ import annotations

from dataclasses import dataclass

from phnn.criteria.criterion import STUDIED, criterion


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
        "Tolerance of a refit whose residual is much above the noise.",
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
        "Largest change of a base parameter before the refit of an effect begins.",
        "Calculation: coordinates of positive parameters are logarithms; 2 is a factor of seven.",
    )
    large_starts: int = criterion(
        4,
        "starts",
        "Number of large-step starts of an effect that explains little from the start that its score gives.",
        "Choice: of cost; two signs of two shapes.",
    )
    large_start_share: float = criterion(
        0.5,
        "share of the squares left",
        "Change of the output by a large-step start.",
        "Argument: an effect that explains the residual changes it by 1, of which base parameters absorb a part.",
    )
    large_start_most: float = criterion(
        3.0,
        "share of the squares left",
        "Largest change of the output by a large-step start.",
        "Argument: beyond it, even the best base parameters leave a larger residual than before.",
    )


@dataclass(frozen=True)
class Race:
    """Which candidates enter the next round of refits."""

    large_residual: float = criterion(
        3.0,
        "noise rms",
        "A residual above it is not noise, however uncertain the noise level is.",
        "Calculation: more than the largest uncertainty of the noise level (a factor of two).",
        origin=1.0,
    )
    enter_large: int = criterion(
        6,
        "candidates",
        "Number of candidates that continue from large-step starts.",
        "Choice: of cost; the catalogue has some thirty.",
    )
    enter_second: int = criterion(
        6,
        "candidates",
        "Number of candidates in the second round.",
        "Choice: of cost; larger than a class of equivalent effects that is still useful.",
    )
    enter_last: int = criterion(
        4,
        "candidates",
        "Number of candidates that are refitted until they converge.",
        "Choice: a class of more than four equivalent effects is not useful.",
    )
    least_saving: float = criterion(
        0.35,
        "share of the best saving",
        "A candidate that reduces χ² less in the first round is dropped.",
        STUDIED,
    )
    near_moving: float = criterion(
        2.0,
        "ratio to the best χ²",
        "A refit above it is dropped, even if it has not converged or its effect is of the best one's kind.",
        STUDIED,
        origin=1.0,
    )
    near_at_rest: float = criterion(
        1.3,
        "ratio to the best χ²",
        "A converged refit above it is dropped.",
        "Argument: finer sub-steps and released parameters change a converged refit little.",
        origin=1.0,
    )
    least_score: float = criterion(
        0.25,
        "share of the best score",
        "A candidate that scores less is not refitted.",
        "Calculation: a squared score is the reduction of χ² to first order: a sixteenth of the best.",
    )
    explained_left: float = criterion(
        0.05,
        "share of the excess",
        "Once a refit leaves less, only candidates with nearly as high a score are refitted.",
        "Argument: another candidate would have to explain more than 95 % too, and its score would show this.",
    )
    rival_score: float = criterion(
        0.75,
        "share of the best score",
        "Smallest score with which a candidate can tie with a refit that explains nearly everything.",
        "Calculation: to first order it reduces χ² by 56 % of the best reduction.",
    )
    unexplained_left: float = criterion(
        0.1,
        "share of the excess",
        "If the best refit leaves more, all effects start again at finite strengths.",
        "Argument: the score is a derivative at strength zero and may miss an effect that would explain more.",
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
        "If all refits leave more of a residual above `large_residual`, only the best is refitted until it converges.",
        "Argument: the best explains < 15 % of the excess; comparing such refits costs minutes without a decision.",
    )


REFITS, RACE = Refits(), Race()
