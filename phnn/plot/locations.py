"""Plot of locations: the share of the explainable residual that each location predicts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes

from phnn.diagnosis.diagnosis import Diagnosis
from phnn.errors import InputRefused
from phnn.plot.panels import grid
from phnn.report.document import Location
from phnn.report.figures.locations import height_of, locations_into
from phnn.report.figures.style import RC, say

_NOTHING = "The residual as a whole is not significant: there is nothing to locate."


@dataclass(frozen=True)
class Locations:
    """Attributes:
    found: where the mismatch is; None where there is none.
    """

    found: Location | None

    def draw(self, axes: Any = None) -> Axes:
        """Draw the bars, or a sentence where nothing is located."""
        with rc_context(RC):
            height = 2.0 if self.found is None else height_of(self.found)
            panel: Axes = grid(axes, 1, 1, 7.2, height)[0, 0]
            if self.found is None:
                say(panel, _NOTHING)
                panel.set_xlabel("share of the explainable residual (1)")
            else:
                locations_into(panel, self.found)
        return panel

    def tables(self) -> dict[str, pd.DataFrame]:
        """Locations, their shares, and which is best or tied with the best."""
        scores = self.found.scores if self.found is not None else ()
        rows = [(name, score, _rank(self.found, name)) for name, score in scores]
        return {"": pd.DataFrame(rows, columns=["location", "share_of_explainable_residual_1", "rank"])}


def location(diagnosis: Diagnosis, *, ax: Axes | None = None) -> Axes:
    """Draw the share of the explainable residual that each location predicts on recordings left out.

        ax = phnn.plot.location(diagnosis)

    Args:
        diagnosis: a finished diagnosis.
        ax: axes to draw into.

    Returns:
        The axes; they hold a sentence where the diagnosis has located nothing.
    """
    return located(diagnosis).draw(ax)


def located(diagnosis: Diagnosis) -> Locations:
    """What `location` draws.

    Raises:
        InputRefused: it is no diagnosis.
    """
    if not hasattr(diagnosis, "judgement"):
        raise InputRefused(
            f"a {type(diagnosis).__name__} has no locations: give a diagnosis, what phnn.diagnose(folder) returns"
        )
    judged = diagnosis.judgement
    if judged.location is None:
        return Locations(None)
    name, *tied = judged.places
    scores = tuple(sorted(judged.location.scores.items(), key=lambda item: -item[1]))
    return Locations(Location(name, judged.detail, tuple(tied), scores, (), (), ()))


def _rank(found: Location | None, name: str) -> str:
    if found is None or name not in (found.name, *found.tied):
        return ""
    return "best" if name == found.name else "tied"
