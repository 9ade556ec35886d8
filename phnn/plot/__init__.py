"""The plots of system identification, each with its data as a table.

    axes = phnn.plot.compare(model, campaign)                # measured and simulated outputs
    axes[0, 0].figure.savefig("compare.svg")

Every function returns matplotlib axes and takes axes of yours; none needs pyplot. ``phnn plot`` writes the same into
files.
"""

from __future__ import annotations

from phnn.plot.balance import energy
from phnn.plot.correlations import residuals
from phnn.plot.hysteresis import loops
from phnn.plot.locations import location
from phnn.plot.outputs import compare
from phnn.plot.response import bode

__all__ = ["bode", "compare", "energy", "location", "loops", "residuals"]
