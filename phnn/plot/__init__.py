"""The plots of system identification, each with its data as a table.

    axes = phnn.plot.compare(model, campaign)                # measured and simulated outputs
    axes[0, 0].figure.savefig("compare.svg")

Every function returns matplotlib axes and takes axes of yours; none needs pyplot. ``phnn plot`` writes the same into
files.
"""

from __future__ import annotations

from phnn.plot.frequency import bode, residuals
from phnn.plot.signals import compare, energy, location, loops

__all__ = ["bode", "compare", "energy", "location", "loops", "residuals"]
