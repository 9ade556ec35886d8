"""``phnn diagnose``, and the diagnosis inside ``phnn demo``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from phnn.commands.terminal import Config, doubt, status
from phnn.diagnosis.diagnosis import Diagnosis
from phnn.diagnosis.diagnosis import diagnose as run_diagnosis
from phnn.identification.identified import save_fit
from phnn.identification.options import Options
from phnn.integrate.cache import compile_ahead
from phnn.output import Place, claim, watched
from phnn.recordings import Campaign, read
from phnn.report import console_summary
from phnn.report.evidence import Provenance
from phnn.report.provenance import command_line, provenance
from phnn.report.result import RESULTS, evidence, write_into


def diagnose(
    folder: Path,
    out: Path,
    manifest: Path | None,
    config: Config,
    outside: bool = False,
    overwrite: bool = False,
    typed: Sequence[str] = (),
) -> None:
    """Diagnose a folder; writes ``diagnosis.json``, ``report.html``, ``model/``, ``base/`` and ``figures/``."""
    options = Options.from_config(config)
    campaign = read(folder, manifest, allow_outside=outside)
    doubt(campaign)
    with claim(out, "diagnose", [folder], RESULTS, overwrite=overwrite) as place:
        diagnose_into(campaign, place, options, out, provenance(campaign, command_line(typed), manifest))


def diagnose_into(
    campaign: Campaign, place: Place, options: Options, out: Path, made_of: Provenance | None = None
) -> Diagnosis:
    """Diagnose, write what `diagnose` writes, and print it; ``out`` is the place as the user calls it."""
    with status() as tell, watched(place, "diagnose", tell) as progress:
        if compile_ahead():
            progress("compile the simulation, once on this machine")
        diagnosis = run_diagnosis(campaign, options, progress, on_base=lambda fitted: save_fit(fitted, place / "base"))
        progress("write the report")
        shown = evidence(diagnosis, made_of)
        document = write_into(diagnosis, place, shown)
    Console().print(console_summary(document, shown))
    Console().print(f"report: {out / 'report.html'}   seed: {options.seed}")
    return diagnosis
