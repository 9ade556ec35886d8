"""Load a stored model of any kind, recognised by its file, and predict recordings with it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from phnn.errors import InputRefused
from phnn.model import Model
from phnn.models.store import setup_from, stored
from phnn.prediction import Predicted, predicted
from phnn.recordings import Campaign, campaign_of
from phnn.trajectory import check_names

if TYPE_CHECKING:
    from phnn.modal.model import ModalFit


def load(folder: str | Path, outside: bool = False) -> Model | ModalFit:
    """Load a model that a command or `Model.save` wrote.

        y = phnn.load("out/model").simulate(t, voltage)
        network = phnn.load("out/modes/model").to_network()  # of a model that phnn modes wrote

    Args:
        folder: ``model/`` or ``base/`` of a result, or the file of a model.
        outside: the file in the folder may be a link that leads out of it.

    Returns:
        A `Model`; of ``phnn modes`` the fit, a `phnn.modal.model.ModalFit`.

    Raises:
        InputRefused: there is no model, or a damaged one.
    """
    from phnn.modal.model import SCHEMA, model_from

    content, shown = stored(Path(folder), outside)
    if content.get("schema") != SCHEMA:
        return Model(*setup_from(content, shown))
    try:
        return model_from(content)
    except InputRefused as error:
        raise InputRefused(f"{shown}: {error}") from error


def predict(model: Any, campaign: Campaign | str | Path) -> tuple[Predicted, ...]:
    """Simulate the recordings of a campaign, in their order.

        for predicted in phnn.predict("out/model", phnn.read("other/")):
            print(predicted.recording.name, predicted.table)

    Where an output was recorded, the first samples of a recording give the zero and the initial state; they are not
    scored.

    Args:
        model: what `phnn.load`, `phnn.identify` or `phnn.diagnose` returned, or a model's folder; of modes too.
        campaign: recordings, or their folder. ``phnn.read(folder, need_output=False)`` reads one without outputs.

    Raises:
        InputRefused: there is no model, or a damaged one, or the recordings do not fit its ports and outputs.
        SolverFailed: a step has no solution.
    """
    known = campaign_of(campaign, need_output=False)
    return tuple(predictions(model_of(model), known))


def model_of(given: Any, outside: bool = False) -> Model | ModalFit:
    """Return the model that is given: itself, that of a fit, the final one of a diagnosis, or that in a folder.

    Args:
        outside: the file in the folder may be a link that leads out of it.

    Raises:
        InputRefused: there is no model, or a damaged one.
    """
    if isinstance(given, str | Path):
        return load(given, outside)
    model = getattr(given, "model", given)
    return model if isinstance(model, Model) else given


def predictions(model: Model | ModalFit, campaign: Campaign) -> Iterator[Predicted]:
    """Return the predictions of a campaign's recordings one by one; it is refused before the first is simulated.

    Raises:
        InputRefused: the recordings do not fit the ports and outputs of the model.
    """
    if not isinstance(model, Model):
        from phnn.modal.model import predicted_modes

        return iter(predicted_modes(model, campaign))
    check_names(model.setup.network, campaign.recordings)
    return (predicted(model.setup, r, model.substeps, r.name in campaign.held_out) for r in campaign.recordings)
