"""What predicts the recordings of a folder: a stored model of any kind, by what its file says it is."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from phnn.errors import InputRefused
from phnn.models.store import setup_from, stored
from phnn.prediction import Predicted, predicted
from phnn.recordings.recording import Campaign
from phnn.setup import Setup
from phnn.simulate import check_names

# Predictions of a campaign's recordings, in their order; the campaign is refused before the first is simulated.
Predictor = Callable[[Campaign], Iterable[Predicted]]


def predictor(model: Path, outside: bool = False) -> Predictor:
    """Load a model that any command wrote.

    Args:
        model: its folder or file; outside: the file in the folder may be a link that leads out of it.

    Raises:
        InputRefused: it is no model, or a damaged one.
    """
    from phnn.modal.store import MODEL_SCHEMA, model_from

    content, shown = stored(model, outside)
    if content.get("schema") != MODEL_SCHEMA:
        setup, substeps = setup_from(content, shown)
        return lambda campaign: of_network(setup, substeps, campaign)
    from phnn.modal.predicting import predicted_modes

    try:
        modes = model_from(content)
    except InputRefused as error:
        raise InputRefused(f"{shown}: {error}") from error
    return lambda campaign: predicted_modes(modes, campaign)


def of_network(setup: Setup, substeps: int, campaign: Campaign) -> Iterator[Predicted]:
    """Predictions of a network model.

    Raises:
        InputRefused: the recordings do not fit its ports and outputs.
    """
    check_names(setup.network, campaign.recordings)
    return (predicted(setup, r, substeps, r.name in campaign.held_out) for r in campaign.recordings)
