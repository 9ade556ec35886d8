"""``phnn diagnose``, and the diagnosis inside ``phnn demo``."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from rich.console import Console

from phnn.commands.terminal import Config, doubt, status
from phnn.diagnose.diagnosis import Diagnosis
from phnn.diagnose.diagnosis import diagnose as run_diagnosis
from phnn.identification.fit import Fit
from phnn.identification.identified import save_fit
from phnn.identification.options import Options
from phnn.integrate.cache import compile_ahead
from phnn.recordings import Campaign, read
from phnn.report.provenance import Provenance, command_line, provenance
from phnn.report.result import RESULTS, write_into
from phnn.report.statements import summary
from phnn.rescue import deadline
from phnn.results import Place, claim, watched


def diagnose(
    folder: Path,
    out: Path,
    manifest: Path | None,
    config: Config,
    outside: bool = False,
    overwrite: bool = False,
    typed: Sequence[str] = (),
    budget: float | None = None,
) -> None:
    """Diagnose a folder; writes ``diagnosis.json``, ``report.html``, ``model/``, ``base/`` and ``figures/``.

    Raises:
        KeyboardInterrupt: the search was interrupted; what it had come upon is written.
    """
    deadline(budget)
    options = Options.from_config(config)
    campaign = read(folder, manifest, allow_outside=outside)
    doubt(campaign)
    with claim(out, "diagnose", [folder], RESULTS, overwrite=overwrite) as place:
        made_of = provenance(campaign, command_line(typed), manifest)
        diagnosis = diagnose_into(campaign, place, options, out, made_of, budget)
    if diagnosis.ended.interruption is not None:
        raise diagnosis.ended.interruption


def diagnose_into(
    campaign: Campaign,
    place: Place,
    options: Options,
    out: Path,
    made_of: Provenance | None = None,
    budget: float | None = None,
) -> Diagnosis:
    """Diagnose, write what `diagnose` writes, and print it; ``out`` is the place as the user calls it."""

    def on_base(fitted: Fit) -> None:
        save_fit(fitted, place / "base")

    # What draws the report is loaded now: an interruption in the middle of an import would leave half a module.
    import_module("phnn.report.sections")
    with status() as tell, watched(place, "diagnose", tell) as progress:
        if compile_ahead():
            progress("compile the simulation, once on this machine")
        diagnosis = run_diagnosis(campaign, options, progress, on_base=on_base, budget=budget, answers=True)
        progress("write the report")
        write_into(diagnosis, place, made_of)
    Console(highlight=False).print(summary(diagnosis), markup=False)
    Console().print(f"report: {out / 'report.html'}   seed: {options.seed}")
    return diagnosis
