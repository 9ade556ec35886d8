"""``phnn modes``."""

from __future__ import annotations

from pathlib import Path

from phnn.commands.terminal import Config, console, status
from phnn.modal.experiment import study_of
from phnn.modal.store import channels_of, model_document
from phnn.modal.study import Settings, study_modes
from phnn.recordings import read
from phnn.report.pages import RESULTS, show, write_modes
from phnn.results import claim


def modes(
    folder: Path, out: Path, manifest: Path | None, config: Config, outside: bool = False, overwrite: bool = False
) -> None:
    """Find the modes of a structure and what moves with amplitude; see `phnn.report.pages` for what it writes."""
    settings = Settings.from_config(config)
    study = study_of(read(folder, manifest, allow_outside=outside))
    channels = channels_of(study)
    with (
        claim(out, "modes", [folder], RESULTS, overwrite=overwrite) as place,
        status() as progress,
    ):
        result = study_modes(
            study,
            settings,
            progress,
            lambda name, fit: (place / "models" / f"{name}.json").write_json(model_document(fit, channels)),
        )
        progress("write the report")
        write_modes(result, str(folder), place)
    show(result, console())
    print(f"report: {out / 'report.html'}")
