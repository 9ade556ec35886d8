"""Criteria for the noise estimate that scores are compared with."""

from __future__ import annotations

from dataclasses import dataclass

from phnn.criteria.criterion import STUDIED, criterion


@dataclass(frozen=True)
class Noise:
    """When the residual determines the noise estimate."""

    outlier: float = criterion(
        4.0,
        "robust standard deviations",
        "Residuals beyond it are clipped before a score is computed.",
        "Calculation: Gaussian noise exceeds it once in 16,000 samples, so that white noise keeps its scores.",
    )
    blocks: int = criterion(
        20,
        "blocks",
        "Largest number of blocks into which a recording is divided to measure the spread of a score.",
        "Calculation: 19 degrees of freedom determine a standard deviation to 16 %.",
    )
    block_samples: int = criterion(
        50,
        "samples",
        "Smallest number of samples of a block.",
        "Calculation: first-order noise with coefficient 0.9 is correlated over 19 samples.",
    )
    block_freedom: float = criterion(
        10.0,
        "degrees of freedom",
        "Fewest degrees of freedom at which the spread over blocks replaces that of stationary noise.",
        "Calculation: with ten, Student's 1 % quantile is 2.8; for many it is 2.3.",
    )
    uneven: float = criterion(
        3.0,
        "1",
        "Largest factor by which uneven noise spreads a score; a larger spread counts as a mismatch.",
        STUDIED,
        origin=1.0,
    )
    least_density: float = criterion(
        0.1,
        "power of the stated noise",
        "Lower bound of an estimated noise density.",
        "Argument: by chance alone, a band of four ordinates falls to a tenth once in a thousand times.",
    )
    greatest_excess: float = criterion(
        2.0,
        "rms of the stated noise",
        "Largest ratio of noise to stated noise where noise and mismatch cannot be separated.",
        "Argument: a larger excess is more likely a mismatch.",
        origin=1.0,
    )
    unseen_excess: float = criterion(
        9.0,
        "rms of the stated noise",
        "The same where the noise is stated from its highest frequencies and nothing shows its colour.",
        "Calculation: first-order noise with coefficient 0.8 has at the lowest frequencies 81 times the density of the "
        "highest ones. With 2, seven of sixteen single sweeps in first-order noise were taken for physics.",
        origin=1.0,
    )
    difference_samples: int = criterion(
        128,
        "samples",
        "Fewest samples for a spectrum from the difference of two halves of a recording.",
        "Calculation: 64 ordinates, which fill some seven bands.",
    )


NOISE = Noise()
