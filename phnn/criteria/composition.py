"""Criteria for composing a model of several elements, named or not."""

from __future__ import annotations

from dataclasses import dataclass

from phnn.criteria.criterion import STUDIED, criterion


@dataclass(frozen=True)
class Composition:
    """When an element is added to a model because it improves the prediction of left-out recordings."""

    most_elements: int = criterion(
        5,
        "elements",
        "Largest number of elements that a composed model has beyond the base model.",
        "Choice: of cost; every further element explains part of a smaller remainder.",
    )
    composed_refits: int = criterion(
        6, "candidates", "Effects of the catalogue that are refitted for one further element.", "Choice: of cost."
    )
    learned_refits: int = criterion(
        9,
        "candidates",
        "Learned elements that are refitted as well, those at the places that explain most.",
        "Argument: there are nine, and with a large residual the place is uncertain before a refit.",
    )
    asked_of_selection: int = criterion(
        16,
        "candidates",
        "The best refits that the selection recordings choose from.",
        "Measured: of a piezo stack's refits, which differ by 4 % in fit, the eighth predicted best.",
    )
    composed_beyond: float = criterion(
        2.0,
        "noise rms",
        "A model that leaves more is composed further even if its remainder is not significant.",
        "Calculation: no doubt about the noise level is greater than a factor of two, and a remainder that is coherent "
        "over short recordings has no small p-value.",
        origin=1.0,
    )
    composed_share: float = criterion(
        0.05,
        "share of the excess",
        "An element is added if the selection error's excess over the noise falls by a larger share.",
        "Argument: a smaller fall does not repay a further element. " + STUDIED,
    )
    composed_level: float = criterion(
        0.00135,
        "probability",
        "The p-value of the fall must also be below it.",
        "Calculation: three standard errors of a normal distribution, one-sided.",
    )
    composed_far: float = criterion(
        0.2,
        "share of the excess",
        "A larger fall is large: it needs only `composed_far_level`, or no test if the recordings are too short.",
        "Argument: four times `composed_share`.",
    )
    composed_far_level: float = criterion(
        0.05,
        "probability",
        "Largest p-value of a large fall.",
        "Argument: the residual of a wrong model scatters more than noise, so that its test has little power.",
    )
    far_above: float = criterion(
        1.05,
        "noise rms",
        "A fall from a smaller error is never large.",
        "Calculation: below it the excess is a tenth of the noise power, within the uncertainty of the noise floor.",
        origin=1.0,
    )
    claim_leaves: float = criterion(
        0.05,
        "share of what it takes",
        "An element of a composed model has a name only if the nameless part of the mismatch is smaller.",
        "Argument: the rest may be another effect, which the element represents in part. " + STUDIED,
    )
    first_takes: float = criterion(
        0.9,
        "share of the excess",
        "Effects of the search that took more before anything was added keep their names in the larger model.",
        "Argument: what was added is a tenth at most. Measured: with it, none of seven sealed cases with an effect "
        "outside the catalogue got a name. " + STUDIED,
    )
    law_takes: float = criterion(
        0.95,
        "share of what it takes",
        "A learned element has the name of a law of the catalogue that takes more of what it takes, in its place.",
        "Argument: as for `claim_leaves`, for what the law does not take has no name. Measured: of four actuators with "
        "a contact stop that the catalogue was without, a cubic spring took 0.29, 0.47, 0.88 and 0.949. " + STUDIED,
    )

    exchange: float = criterion(
        6.0,
        "residual variances",
        "A neighbour takes the place of an element of a composed model if it lowers Schwarz's criterion by more; a "
        "special case of the element has only to lower it.",
        "Calculation: twice the logarithm of a Bayes factor of 20, strong evidence by Kass & Raftery (1995, JASA).",
    )
    asked_elements: int = criterion(
        3,
        "elements",
        "Number of elements, those that explain most, that a proposed recording is to test; each has its own rivals.",
        "Choice: of cost; one recording rarely answers more questions.",
    )

    def falls(self, before: float, after: float, p_value: float | None) -> bool:
        """Whether an error on selection recordings falls enough.

        Args:
            before, after: residual over noise without and with the element.
            p_value: that chance made it fall; None where there are too few blocks.
        """
        taken = before**2 - after**2
        excess = max(before**2 - 1.0, 0.0)
        # Near the noise floor, which is not known better, no fall is far.
        if before > self.far_above and taken > self.composed_far * excess:
            return p_value is None or p_value < self.composed_far_level
        return p_value is not None and taken > self.composed_share * excess and p_value < self.composed_level


COMPOSITION = Composition()
