"""One comparison from recordings to tables and figures."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table as Printed

from phnn.comparison.document import Table, cells, heads, markdown, scores, table_csv, table_of
from phnn.comparison.figures import draw_all
from phnn.comparison.models import Bench
from phnn.comparison.settings import Settings
from phnn.identification.base import Progress, quiet
from phnn.identification.prepare import single
from phnn.identification.zero import own_zeros
from phnn.recordings import Campaign, read
from phnn.results import Origin, Place, claim
from studies.recordings import Conditions, comparison_plan, write_recordings
from studies.results import write_results

_SIGNALS = "sines from rest, three periods of 2500 samples"
RESULTS = ("compare.json", "models.json", "compare.csv", "compare.md", "figures", "recordings")


def compare(
    campaign: Campaign, out: Path, settings: Settings, progress: Progress = quiet, overwrite: bool = False
) -> Table:
    """Fit all models that are asked for to the identification recordings and score them on all.

    Writes ``compare.json`` and ``models.json`` after every model, ``compare.csv``, ``compare.md`` and ``figures/`` at
    the end, and each model into a folder of its own. Models that were finished before are read back.

    Args:
        campaign: recordings with their uses.
        out: where the results go.
        settings: which models, and how they are fitted.
        progress: told what is done.
        overwrite: replace results that were changed since.

    Raises:
        InputRefused: recordings that cannot be used, or results of other settings lie in ``out``.
    """
    with _claimed(out, campaign.inputs, settings, overwrite) as place:
        return _compare(campaign, place, settings, progress)


def _claimed(
    out: Path, inputs: Sequence[Path], settings: Settings, overwrite: bool = False
) -> AbstractContextManager[Place]:
    """Models know themselves what they were made of, so that one can be added to those that were fitted before."""
    origin = Origin(resume=settings.resume, anew="resume=false")
    return claim(out, "compare", inputs, (*RESULTS, *settings.models), origin, overwrite)


def _compare(campaign: Campaign, place: Place, settings: Settings, progress: Progress, origin: str = "") -> Table:
    """The comparison in a claimed folder; the origin of the recordings is for the page of markdown."""
    single(campaign.recordings, "a comparison follows one input to one output")
    # Not every model that is compared has a parameter for a shared zero.
    campaign = replace(campaign, recordings=own_zeros(campaign.recordings))
    bench = Bench(campaign, settings, place, progress)
    results = []
    for model in settings.models:
        results.append(bench.result(model))
        table = table_of(campaign, results)
        (place / "compare.json").write_json(scores(table))
        (place / "models.json").write_json(table.facts)
    progress("draw")
    drawings = draw_all(table, campaign, results)
    words = origin or "Fitted to the identification recordings of the folder named above."
    page = markdown(table, f"All models on {campaign.folder}", words, drawings) + "\n"
    write_results(place, {"compare.csv": table_csv(table), "compare.md": page}, drawings=drawings)
    return table


def compare_on_made(out: Path, conditions: Conditions, settings: Settings, progress: Progress = quiet) -> Table:
    """Make recordings in ``out/recordings`` that also go beyond the identified range, and compare on them.

    Raises:
        InputRefused: settings, or a folder that holds files of others.
        SolverFailed: the second effect cannot be made as strong as asked.
    """
    with _claimed(out, (), settings) as place:
        progress("make recordings")
        folder = (place / "recordings").own_folder()
        made = write_recordings(folder, conditions, comparison_plan())
        return _compare(read(folder), place, settings, progress, made.words(_SIGNALS))


def show(table: Table, console: Console) -> None:
    """Print fit and residual over noise, recordings grouped by use."""
    printed = Printed(*heads(table), title="fit % (residual over noise)")
    last = ""
    for name in table.grouped:
        if last and table.uses[name] != last:
            printed.add_section()
        last = table.uses[name]
        printed.add_row(*(escape(cell) for cell in cells(table, name)))
    console.print(printed)
