"""One comparison from recordings to a table and a figure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import rc_context
from rich.console import Console
from rich.markup import escape
from rich.table import Table as Printed

from phnn.comparison.models import Bench, Result, Settings, title
from phnn.configuration import compose
from phnn.identification.base import Progress, quiet
from phnn.identification.evaluate import PartScore
from phnn.identification.prepare import own_zeros, single
from phnn.recordings import Campaign, campaign_of
from phnn.report.figures.style import CATEGORIES, RC, literal, log_axis, new_figure, png, quiet_grid
from phnn.report.formatting import markdown_table, number, percent, ratio
from phnn.results import Origin, claim

Results = Mapping[str, Result]

RESULTS = ("compare.json", "models.json", "compare.csv", "compare.md", "compare.png")
USES = {"identification": "identified", "confirmation": "held out"}
_MARKS = "DoXsv^P<>phd8"


def compare(
    campaign: Campaign | str | Path,
    out: str | Path,
    settings: Settings | Sequence[str] = (),
    progress: Progress = quiet,
    overwrite: bool = False,
) -> dict[str, Result]:
    """Fit several kinds of model to the identification recordings; return them, scored on all, by name.

        results = phnn.compare(phnn.read("recordings/"), "compared/", ["models=[phs,linear]"])
        results["linear"].evaluation.over_noise("confirmation")  # held-out residual over noise

    Writes ``compare.json`` and ``models.json`` after every model, ``compare.csv``, ``compare.md`` and ``compare.png``
    at the end, and each model into a folder of its own. Models that were finished before are read back.

    Args:
        campaign: recordings with their uses, or their folder.
        out: where the results go.
        settings: which models, and how they are fitted: ``key=value``, as for ``phnn compare``,
            see ``configs/compare.yaml``.
        progress: called with a line of text at every stage.
        overwrite: replace results that were changed since.

    Raises:
        InputRefused: a setting is unknown or out of range, recordings cannot be used, or results of other settings lie
            in ``out``.
    """
    if not isinstance(settings, Settings):
        settings = Settings.from_config(compose("compare", settings))
    campaign, out = campaign_of(campaign), Path(out)
    # Models know themselves what they were made of, so that one can be added to those that were fitted before.
    origin = Origin(resume=settings.resume, anew="resume=false")
    with claim(out, "compare", campaign.inputs, (*RESULTS, *settings.models), origin, overwrite) as place:
        single(campaign.recordings, "a comparison follows one input to one output")
        # Not every model that is compared has a parameter for a shared zero.
        bench = Bench(replace(campaign, recordings=own_zeros(campaign.recordings)), settings, place, progress)
        results: dict[str, Result] = {}
        for model in settings.models:
            results[model] = bench.result(model)
            (place / "compare.json").write_json(scores(results))
            (place / "models.json").write_json({m: r.facts for m, r in results.items()})
        progress("draw")
        (place / "compare.png").write(draw(results))
        (place / "compare.csv").write(table_csv(results).encode())
        (place / "compare.md").write(page(results, campaign.folder).encode())
    return results


def scores(results: Results) -> dict[str, dict[str, dict[str, Any]]]:
    """Return ``compare.json`` as a mapping, lengths in m."""
    return {
        model: {p.name: {**p.numbers, "held_out": p.use != "identification"} for p in result.evaluation.parts}
        for model, result in results.items()
    }


def _rows(results: Results) -> Iterator[tuple[str, str, dict[str, PartScore]]]:
    """Yield name, use and the scores of all models of every recording or part, identified ones first."""
    entries = {model: {p.name: p for p in result.evaluation.parts} for model, result in results.items()}
    first = next(iter(entries.values()))
    for use in USES:
        yield from ((n, use, {m: parts[n] for m, parts in entries.items()}) for n, p in first.items() if p.use == use)


def table_csv(results: Results) -> str:
    """Return one line for each recording and model, SI."""
    head = ["recording", "use", "model", "fit_percent", "rmse_m", "residual_over_noise"]
    rows = [[name, use, m, *p.numbers.values()] for name, use, parts in _rows(results) for m, p in parts.items()]
    return pd.DataFrame(rows, columns=head).to_csv(index=False, na_rep="nan", lineterminator="\n")


def _table(results: Results) -> tuple[list[str], list[list[str]]]:
    """Return heads and cells of the table of fits: fit percentage, and the residual over noise in brackets."""
    cells = [
        [n, USES[use], *(f"{percent(p.fit_percent, 2)}  ({ratio(p.residual_over_noise)})" for p in parts.values())]
        for n, use, parts in _rows(results)
    ]
    return ["recording", "use", *map(title, results)], cells


def page(results: Results, folder: str) -> str:
    """Return the comparison as markdown."""
    over = [
        [words, *(ratio(r.evaluation.over_noise(use)) for r in results.values())]
        for use, words in USES.items()
        if np.isfinite(next(iter(results.values())).evaluation.over_noise(use))
    ]
    models = [
        [title(m), *(str(r.facts[n]) for n in ("kind", "parameters")), number(r.facts["seconds"]), r.facts["gradient"]]
        for m, r in results.items()
    ]
    lines = [f"# All models on {folder}", "", "Fitted to the identification recordings, scored on all.", ""]
    lines += ["## Fit in percent, and residual over noise in brackets", "", *markdown_table(*_table(results)), ""]
    lines += markdown_table(["residual over noise, root mean square", *map(title, results)], over)
    lines += ["", "![Residual over noise, by recording and model](compare.png)", "", "## Models", ""]
    return "\n".join([*lines, *markdown_table(["model", "kind", "parameters", "seconds", "fitted by"], models), ""])


def draw(results: Results) -> bytes:
    """Return a picture with one dot a model and recording on a logarithmic axis of the residual over noise."""
    rows = list(_rows(results))
    with rc_context(RC):
        figure = new_figure(9.2, 1.5 + 0.31 * len(rows))
        axes = figure.subplots()
        for k, model in enumerate(results):
            known = [(parts[model].residual_over_noise, at) for at, (_, _, parts) in enumerate(rows)]
            known = [(x, at) for x, at in known if 0.0 < x < np.inf]
            axes.scatter(
                [x for x, _ in known], [at for _, at in known], s=34, color=CATEGORIES[k % len(CATEGORIES)],
                marker=_MARKS[k % len(_MARKS)], label=literal(title(model)), zorder=3, alpha=0.9,
            )  # fmt: skip
        log_axis(axes)
        axes.axvline(1.0, color="#4d555c", linewidth=1.0, dashes=(3, 2), zorder=0, label="noise floor")
        axes.set_yticks(range(len(rows)), [f"{literal(n, 34)}  ({USES[use]})" for n, use, _ in rows])
        axes.set_ylim(len(rows) - 0.4, -0.6)
        quiet_grid(axes)
        axes.set_xlabel("residual over noise (logarithmic)")
        figure.legend(loc="outside upper right", ncols=4)
        return png(figure)


def show(results: Results, console: Console) -> None:
    """Print fit and residual over noise, recordings grouped by use."""
    heads, cells = _table(results)
    printed = Printed(*heads, title="fit % (residual over noise)")
    for row, after in zip(cells, [*cells[1:], cells[-1]], strict=True):
        printed.add_row(*(escape(cell) for cell in row), end_section=row[1] != after[1])
    console.print(printed)
