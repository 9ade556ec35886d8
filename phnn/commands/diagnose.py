"""``phnn diagnose``, and the diagnosis inside ``phnn demo``."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from phnn.commands.identify import keep
from phnn.commands.terminal import Config, status
from phnn.diagnosis.diagnosis import Diagnosis
from phnn.diagnosis.diagnosis import diagnose as run_diagnosis
from phnn.identification.options import Options
from phnn.output import Place, claim
from phnn.recordings import Campaign, read
from phnn.report import console_summary
from phnn.report.result import RESULTS, evidence, write_into
from phnn.warm import compile_later_kernels


def diagnose(
    folder: Path, out: Path, manifest: Path | None, config: Config, outside: bool = False, overwrite: bool = False
) -> None:
    """Diagnose a folder; writes ``diagnosis.json``, ``report.html``, ``model/``, ``base/`` and ``figures/``."""
    options = Options.from_config(config)
    campaign = read(folder, manifest, allow_outside=outside)
    with claim(out, "diagnose", [folder], RESULTS, overwrite=overwrite) as place:
        diagnose_into(campaign, place, options, out)


def diagnose_into(campaign: Campaign, place: Place, options: Options, out: Path) -> Diagnosis:
    """Diagnose, write what `diagnose` writes, and print it; ``out`` is the place as the user calls it."""
    compile_later_kernels()
    with status() as progress:
        diagnosis = run_diagnosis(campaign, options, progress, on_base=lambda fitted: keep(fitted, place / "base"))
        progress("write the report")
        shown = evidence(diagnosis)
        document = write_into(diagnosis, place, shown)
    Console().print(console_summary(document, shown))
    Console().print(f"report: {out / 'report.html'}   seed: {options.seed}")
    return diagnosis
