"""The predictor of a folder's recordings: a stored model of any kind, recognised by its file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from phnn.errors import InputRefused
from phnn.model import Model
from phnn.models.store import inputs_of, setup_from, stored
from phnn.prediction import Predicted, predicted
from phnn.recordings.recording import Campaign
from phnn.setup import Setup
from phnn.trajectory import check_names

if TYPE_CHECKING:
    from phnn.modal.fit import ModalFit

# Predictions of a campaign's recordings, in their order; the campaign is refused before the first is simulated.
Predictor = Callable[[Campaign], Iterable[Predicted]]


def loaded(folder: Path, outside: bool = False) -> Model | ModalFit:
    """Load a model that any command wrote.

    Args:
        folder: of the model, or its file; outside: the file in the folder may be a link that leads out of it.

    Returns:
        The model of a network; of ``phnn modes``, the fit.

    Raises:
        InputRefused: there is no model, or a damaged one.
    """
    from phnn.modal.store import SCHEMA, model_from

    content, shown = stored(folder, outside)
    if content.get("schema") != SCHEMA:
        return Model(*setup_from(content, shown), inputs_of(content, shown))
    try:
        return model_from(content)
    except InputRefused as error:
        raise InputRefused(f"{shown}: {error}") from error


def predictor(model: Path | Model | ModalFit, outside: bool = False) -> Predictor:
    """What predicts with a model, or with the model in a folder or file.

    Args:
        outside: the file in the folder may be a link that leads out of it.

    Raises:
        InputRefused: there is no model, or a damaged one.
    """
    found = loaded(model, outside) if isinstance(model, Path) else model
    if isinstance(found, Model):
        return partial(of_network, found.setup, found.substeps)
    from phnn.modal.store import predicted_modes

    return partial(predicted_modes, found)


def of_network(setup: Setup, substeps: int, campaign: Campaign) -> Iterator[Predicted]:
    """Predictions of a network model.

    Raises:
        InputRefused: the recordings do not fit its ports and outputs.
    """
    check_names(setup.network, campaign.recordings)
    return (predicted(setup, r, substeps, r.name in campaign.held_out) for r in campaign.recordings)
