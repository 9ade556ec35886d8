"""Criteria for adding effects to a model, keeping them, and choosing the verdict."""

from __future__ import annotations

from dataclasses import dataclass

from phnn.criteria.criterion import STUDIED, criterion


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
        "Sub-steps are halved while the numerical error alone has a larger score, and one above `numerical_share` of "
        "the largest score; if it still has, no name is proven.",
        "Calculation: a score of 2.33 that is 0.3 too large has p = 0.021 in place of 0.01.",
    )
    first_refits: int = criterion(
        14, "candidates", "Largest number of refits for a first effect.", "Choice: of cost; half of the catalogue."
    )
    further_refits: int = criterion(
        6, "candidates", "Largest number of refits for a further effect.", "Choice: of cost."
    )
    explains: float = criterion(0.5, "share of the excess", "A first effect that explains less is withdrawn.", STUDIED)
    explains_further: float = criterion(
        0.7,
        "share of the excess",
        "A further effect, or a first effect without a location, that explains less is withdrawn.",
        "Argument: above `explains`, because a further effect is chosen among more alternatives. " + STUDIED,
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
        "An effect that explains more is compared with no learned element, and may be one of an equivalent class.",
        "Measured: the concealed effects of the demonstrations take 97 % or more of the held-out excess.",
    )
    noise_doubt: float = criterion(
        1.02,
        "noise rms",
        "A residual below it does not count against an effect.",
        "Calculation: a noise floor from 2,500 samples has a standard error of 1.4 %.",
        origin=1.0,
    )
    small_residual: float = criterion(
        1.1,
        "noise rms",
        "A residual below it ends the search and is immaterial if no element improves predictions; "
        "above it, the remainder widens the tie of refits.",
        "Calculation: the excess is then a fifth of the noise power. " + STUDIED,
        origin=1.0,
    )
    one_form: float = criterion(
        2.0,
        "noise rms",
        "If an effect in another form leaves more, the mismatch may be two effects: the search continues.",
        STUDIED,
        origin=1.0,
    )
    compared_within: float = criterion(
        10.0,
        "ties",
        "The numerical error of refits that end this close to the best one is bounded before they are compared.",
        STUDIED,
    )
    numerical_share: float = criterion(
        0.05,
        "share of the excess's norm",
        "Largest numerical error relative to the remaining residual.",
        "Calculation: a fifth of the least share that counts (`explains_some`), and its square is 0.25 % of χ².",
    )
    base_numerical_share: float = criterion(
        0.001,
        "share of the excess's norm",
        "Largest numerical error of the base model relative to its residual, where that is more than its bound.",
        "Argument: an effect that leaves a hundredth of the residual still leaves ten times the error.",
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
        "If even the best refit leaves a significant remainder, a smaller difference of χ² decides nothing.",
        "Argument: the remainder that no refit explains may favour either.",
    )
    retested: int = criterion(
        3,
        "candidates",
        "Number of candidates refitted in place of an earlier effect after another effect was added.",
        "Choice: of cost.",
    )
    learned_leaves: float = criterion(
        0.5,
        "ratio of the excesses",
        "If a learned element leaves less of what the named effects leave, these effects are not the cause.",
        "Argument: a dozen free strengths lower any χ², but do not halve the remainder of the right kind of effect.",
    )
    together: float = criterion(
        0.95,
        "share of the excess",
        "Several effects that together explain less, and leave more than `small_residual`, are withdrawn.",
        "Argument: two wrong effects can confound many true ones. " + STUDIED,
    )
    nearly_all: float = criterion(
        0.95,
        "share of the excess",
        "Effects that explain more keep their names although the remainder has another location.",
        "Measured: in sealed cases with a small background the right effects explained 0.98 to 0.99, and left the "
        "background at its own place. " + STUDIED,
    )

    def beyond_doubt(self, chi2: float) -> float:
        """What a mean square [noise²] exceeds the noise power by beyond any doubt about its level, 0 at least."""
        return max(chi2 / self.noise_doubt**2 - 1.0, 0.0)


SELECTION = Selection()
