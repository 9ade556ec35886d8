"""The plots of system identification, each with its data as a table.

    phnn.plot.compare(model, campaign).savefig("compare.svg")  # measured and simulated outputs

Every function returns a matplotlib figure; none needs pyplot. ``phnn plot`` writes the same into
files.
"""

from __future__ import annotations

from phnn.plot.frequency import bode, residuals
from phnn.plot.signals import compare, energy, loops

__all__ = ["bode", "compare", "energy", "loops", "residuals"]
