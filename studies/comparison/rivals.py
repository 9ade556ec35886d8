"""The rivals of `studies.rival_models` in the comparisons of ``phnn compare``."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.comparison.models import MODELS, register_rival
from phnn.recordings.recording import Campaign
from studies.rival_models.names import TITLES, rival

HEADS = {**{name: kind.title for name, kind in MODELS.items()}, **TITLES}


def register_rivals() -> None:
    """Let ``models=`` of a comparison name every rival."""
    for name, title in TITLES.items():
        register_rival(name, partial(_fit, name), title)


def _fit(
    name: str, campaign: Campaign, seed: int, budget: float
) -> tuple[dict[str, NDArray[np.float64]], Mapping[str, Any]]:
    """Fit a rival within its budget; return outputs by recording, and facts."""
    chosen = rival(name)
    fitted = chosen.fit(campaign.recordings, budget, seed)
    outputs = zip((r.name for r in campaign.recordings), fitted.outputs(campaign.recordings), strict=True)
    about = {"kind": f"{chosen.words} ({chosen.source})", "parameters": fitted.parameters, "gradient": chosen.how}
    return dict(outputs), about | dict(fitted.facts)
