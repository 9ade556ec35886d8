"""Criteria for composing a model of several elements, named or not."""

from __future__ import annotations

from dataclasses import dataclass

from phnn.diagnosis.criteria.criterion import STUDIED, criterion


@dataclass(frozen=True)
class Composition:
    """What is added to a model because recordings that were left out are predicted better with it."""

    most_elements: int = criterion(
        5,
        "elements",
        "A composed model has at most so many beyond the base model.",
        "Choice: of cost; every further element has to explain part of a smaller rest.",
    )
    composed_refits: int = criterion(
        6, "candidates", "Effects of the catalogue that are refitted for one further element.", "Choice: of cost."
    )
    learned_refits: int = criterion(
        9,
        "candidates",
        "Learned elements that are refitted beside them, those at the places that explain most.",
        "Argument: there are nine, and where the residual is large the place is not sure before a refit.",
    )
    asked_of_selection: int = criterion(
        4,
        "candidates",
        "The best refits that the selection recordings choose from.",
        "Choice: a refit that fits clearly worse where it was made predicts no better.",
    )
    composed_beyond: float = criterion(
        2.0,
        "noise rms",
        "A model that leaves more is composed further even where what it leaves may be chance.",
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
        "Besides, the p-value of the fall has to be below it.",
        "Calculation: three standard errors of a normal distribution, one-sided.",
    )
    composed_far: float = criterion(
        0.2,
        "share of the excess",
        "A fall by more is far: `composed_far_level` is enough, or no test where the recordings are too short.",
        "Argument: four times what counts else.",
    )
    composed_far_level: float = criterion(
        0.05,
        "probability",
        "Largest p-value of a fall that is far.",
        "Argument: what is left by a wrong model scatters more than noise does, so that a test of it is weak.",
    )
    far_above: float = criterion(
        1.05,
        "noise rms",
        "A fall from less is never far.",
        "Calculation: what lies below is a tenth of the noise's power, as little as the noise floor may be wrong by.",
        origin=1.0,
    )
    claim_leaves: float = criterion(
        0.05,
        "share of what it takes",
        "An element of a composed model has a name only if what has no name is less.",
        "Argument: what remains may be an effect of its own, for which the element stands in part. " + STUDIED,
    )

    asked_elements: int = criterion(
        3,
        "elements",
        "Elements, those that take most, of which a proposed recording is asked; each has rivals of its own.",
        "Choice: of cost; one recording hardly answers more.",
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
