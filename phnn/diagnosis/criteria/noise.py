"""Criteria for the noise that scores are judged with."""

from __future__ import annotations

from dataclasses import dataclass

from phnn.diagnosis.criteria.criterion import STUDIED, criterion


@dataclass(frozen=True)
class Noise:
    """When the residual is believed to show what the noise is."""

    outlier: float = criterion(
        4.0,
        "robust standard deviations",
        "Residuals beyond it are cut off before a score is judged.",
        "Calculation: Gaussian noise exceeds it once in 16,000 samples, so that white noise keeps its scores.",
    )
    blocks: int = criterion(
        20,
        "blocks",
        "A recording is divided into at most so many blocks to see how much a score spreads.",
        "Calculation: 19 degrees of freedom know a standard deviation to 16 %.",
    )
    block_samples: int = criterion(
        50,
        "samples",
        "A block has at least so many samples.",
        "Calculation: first-order noise with coefficient 0.9 is correlated over 19 samples.",
    )
    block_freedom: float = criterion(
        10.0,
        "degrees of freedom",
        "The spread over blocks replaces that of stationary noise only from so many degrees of freedom on.",
        "Calculation: with ten, Student's 1 % quantile is 2.8 where it is 2.3 for many.",
    )
    uneven: float = criterion(
        3.0,
        "1",
        "Uneven noise spreads a score by at most this factor; more is taken for a mismatch.",
        STUDIED,
        origin=1.0,
    )
    least_density: float = criterion(
        0.1,
        "power of the stated noise",
        "An estimated noise density is never below it.",
        "Argument: a band of four ordinates falls by chance alone to a tenth once in a thousand times.",
    )
    greatest_excess: float = criterion(
        2.0,
        "rms of the stated noise",
        "Where nothing tells noise from mismatch, noise exceeds what is stated by at most this factor.",
        "Argument: a larger excess is rather what the model misses.",
        origin=1.0,
    )
    difference_samples: int = criterion(
        128,
        "samples",
        "A difference of two halves of a recording shows a spectrum only from so many samples on.",
        "Calculation: 64 ordinates, which fill some seven bands.",
    )


NOISE = Noise()
