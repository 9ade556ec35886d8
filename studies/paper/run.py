"""One experiment from recordings to tables and figures."""

from __future__ import annotations

import time
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from phnn.identification.base import Progress, quiet
from phnn.identification.identified import save_fit
from phnn.identification.options import Options
from phnn.recordings import Campaign, read
from phnn.results import Place, claim
from studies.paper.document import cells, document, heads, markdown, table_csv
from studies.paper.figures import draw_all
from studies.paper.table import REFITTED, Comparison, compare
from studies.recordings import Conditions, Made, write_recordings
from studies.results import write_results

RESULTS = ("figures", *REFITTED, "table3.csv", "experiment.json", "experiment.md", "recordings")


def run_paper(out: Path, conditions: Conditions, options: Options, progress: Progress = quiet) -> Comparison:
    """Make the paper's recordings in ``out/recordings`` and run the experiment on them.

    Raises:
        InputRefused: settings, or a folder that holds files of others.
        SolverFailed: the second effect cannot be made as strong as asked.
    """
    began = time.monotonic()
    with claim(out, "experiment", (), RESULTS) as place:
        progress("make recordings")
        folder = (place / "recordings").own_folder()
        made = write_recordings(folder, conditions)
        return _run(read(folder), place, made, options, True, began, progress)


def run_folder(
    folder: Path, manifest: Path | None, out: Path, options: Options, published: bool, progress: Progress = quiet
) -> Comparison:
    """The experiment on a folder of recordings.

    Args:
        published: score the published parameters too; they are those of the paper's own actuator.

    Raises:
        InputRefused: the recordings cannot be used.
    """
    began = time.monotonic()
    campaign = read(folder, manifest)
    with claim(out, "experiment", [folder], RESULTS) as place:
        return _run(campaign, place, None, options, published, began, progress)


def _run(
    campaign: Campaign,
    place: Place,
    made: Made | None,
    options: Options,
    published: bool,
    began: float,
    progress: Progress,
) -> Comparison:
    comparison = compare(campaign, options, published, progress)
    rows = comparison.rows()
    progress("draw")
    drawings = draw_all(comparison)
    for model in REFITTED:
        save_fit(comparison.models[model].fit, place / model)
    found = document(comparison, made, campaign.folder, options.seed, time.monotonic() - began)
    page = markdown(comparison, made, campaign.folder, drawings)
    texts = {"table3.csv": table_csv(rows), "experiment.md": page}
    write_results(place, texts, {"experiment.json": found}, drawings)
    return comparison


def show(comparison: Comparison, console: Console) -> None:
    """Print Table 3 beside the paper's own figures."""
    rows = comparison.rows()
    head = heads(rows)
    table = Table(*head, title="Table 3: fit % (root mean square error in µm)")
    for row in rows:
        table.add_row(*(escape(cell) for cell in cells(row, len(head))))
    console.print(table)
