"""``phnn identify``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from phnn.commands.terminal import Config, doubt, status
from phnn.diagnose.diagnosis import score_on_all
from phnn.identification.base import identify_base
from phnn.identification.evaluate import Evaluation
from phnn.identification.identified import save_fit
from phnn.identification.options import Options
from phnn.integrate.cache import compile_ahead
from phnn.network.roles import auxiliary
from phnn.recordings import Campaign, read
from phnn.report.formatting import interval
from phnn.results import PROGRESS, Place, claim, finite, watched


def identify(
    folder: Path, out: Path, manifest: Path | None, config: Config, outside: bool = False, overwrite: bool = False
) -> None:
    """Fit the base model; writes ``base/`` and ``identify.json``."""
    options = Options.from_config(config)
    campaign = read(folder, manifest, allow_outside=outside)
    doubt(campaign)
    with claim(out, "identify", [folder], ("base", "identify.json", PROGRESS), overwrite=overwrite) as place:
        said, scores = _identify(campaign, options, place)
    table = Table("parameter", "value", "standard error", "95 % interval", "note", title=f"base model of {folder}")
    for name, row in said["parameters"].items():
        error_text = f"{row['std']:.2g}" if row["std"] is not None else "–"
        value = f"{row['value']:.5g} {row['unit']}"
        table.add_row(name, value, error_text, interval(row["interval_95"]), str(row["held"] or ""))
    Console().print(table)
    if said["nothing"]:
        Console().print(f"[bold]{escape(said['nothing'])}[/bold].")
    if said["open"]:
        known = [f"{n} = {r['value']:.5g} ± {r['std']:.2g}" for n, r in said["ratios"].items()]
        Console().print(f"[bold]{escape(said['open'])}[/bold]. {escape(', '.join(known))}")
    Console().print(_score_table(scores))


def _identify(campaign: Campaign, options: Options, place: Place) -> tuple[dict[str, Any], Evaluation]:
    """Fit the base model and write it; what `identify.json` says, and its scores."""
    with status() as tell, watched(place, "identify", tell) as progress:
        if compile_ahead():
            progress("compile the simulation, once on this machine")
        fitted, error = identify_base(campaign, options, progress)
        scores = score_on_all(fitted, campaign)
    save_fit(fitted, place / "base")
    std, hidden = fitted.std(), auxiliary(fitted.setup.network)
    parameters = {
        n: {"value": p.value, "unit": p.unit, "std": finite(std.get(n)), "interval_95": fitted.interval(n)}
        | {"held": fitted.note(n) or None}
        for n, p in fitted.setup.parameters.items()
        if n not in hidden
    }
    content = {
        "parameters": parameters,
        "nothing": fitted.nothing_statement(),
        "open": fitted.open_statement(),
        "ratios": {n: {"value": v, "std": finite(s)} for n, (v, s) in fitted.ratios().items()},
        "fit": scores.table(),
        "numerical_error_sigma": error.sigma,
        "seed": options.seed,
    }
    (place / "identify.json").write_json(content)
    return content, scores


def _score_table(scores: Evaluation) -> Table:
    table = Table("recording", "use", "base", title="fit %, and residual over noise")
    for part in scores.parts:
        use = "held out" if part.use == "confirmation" else "identified"
        table.add_row(escape(part.name), use, f"{part.fit_percent:.2f}  {part.residual_over_noise:.3g}")
    return table
