"""The files of a comparison: ``compare.json``, ``models.json``, a table as csv, and a page of markdown."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from phnn.comparison.cycles import CycleErrors, cycle_errors
from phnn.comparison.result import Result
from phnn.comparison.uses import CONFIRMATION, IDENTIFICATION, OUTSIDE, uses
from phnn.recordings.recording import Campaign
from phnn.report.figures import Drawing
from phnn.report.formatting import DASH, markdown_table, number, percent, ratio
from studies.results import figure_lines

HEADS = {
    "phs": "PHS",
    "phs_neural": "PHS, learned hysterons",
    "phs_adjoint": "PHS, by adjoint",
    "phs_neural_adjoint": "PHS, learned hysterons, by adjoint",
    "neural_phs": "fully neural PHS",
    "bouc_wen": "Bouc–Wen",
    "linear": "linear",
    "neural_ode": "neural ODE",
    "prandtl_ishlinskii": "Prandtl–Ishlinskii",
    "preisach": "Preisach",
    "dahl": "Dahl",
    "hammerstein": "Hammerstein",
    "narx": "NARX",
    "gru": "GRU",
    "lstm": "LSTM",
    "subnet": "SUBNET",
}
USES = {IDENTIFICATION: "identified", CONFIRMATION: "held out, inside", OUTSIDE: "held out, outside"}
_COLUMNS = (
    *(
        "recording",
        "use",
        "model",
        "fit_percent",
        "rmse_m",
        "residual_over_noise",
        "loop_area_error",
        "loop_area_noise",
    ),
    *(f"harmonic_{k}_error_m" for k in range(1, 6)),
)


@dataclass(frozen=True)
class Entry:
    """One model on one part of a recording."""

    fit_percent: float
    rmse: float
    residual_over_noise: float
    cycles: CycleErrors | None


@dataclass(frozen=True)
class Table:
    """All models on all parts.

    Attributes:
        uses: by name of the part, in the order of the recordings.
        entries: by model, then by name of the part.
        facts: by model.
    """

    uses: Mapping[str, str]
    entries: Mapping[str, Mapping[str, Entry]]
    facts: Mapping[str, Mapping[str, Any]]

    @property
    def grouped(self) -> list[str]:
        """Names of the parts, by use."""
        return [name for use in USES for name, own in self.uses.items() if own == use]

    def over_noise(self, model: str, use: str) -> float:
        """Root mean square of the residual over noise over the parts of one use; NaN where there is none."""
        found = [e.residual_over_noise for n, e in self.entries[model].items() if self.uses[n] == use]
        return float(np.sqrt(np.mean(np.square(found)))) if found else float("nan")


def table_of(campaign: Campaign, results: Sequence[Result]) -> Table:
    """The scores of finished models with their errors in the cycle."""
    owner = {p.name: (r, p) for r in campaign.recordings for p in r.parts}
    entries = {}
    for result in results:
        entries[result.name] = {
            s.name: Entry(
                s.fit_percent, s.rmse, s.residual_over_noise,
                cycle_errors(*owner[s.name], result.evaluation.outputs[owner[s.name][0].name]),
            )
            for s in result.evaluation.parts
        }  # fmt: skip
    return Table(uses(campaign.recordings), entries, {r.name: r.facts for r in results})


def scores(table: Table) -> dict[str, dict[str, dict[str, Any]]]:
    """``compare.json`` as a mapping, lengths in m; null where an input does not repeat."""
    return {
        model: {name: _score(e, table.uses[name]) for name, e in rows.items()} for model, rows in table.entries.items()
    }


def _score(entry: Entry, use: str) -> dict[str, Any]:
    cycles, harmonics = entry.cycles, None
    if cycles is not None:
        harmonics = {
            "error": list(cycles.harmonics),
            "relative": [e / cycles.fundamental for e in cycles.harmonics],
            "noise": cycles.harmonic_noise,
        }
    return {
        "fit_percent": entry.fit_percent,
        "rmse": entry.rmse,
        "residual_over_noise": entry.residual_over_noise,
        "held_out": use != IDENTIFICATION,
        "use": use,
        "loop_area_error": None if cycles is None else cycles.area,
        "loop_area_noise": None if cycles is None else cycles.area_noise,
        "harmonics": harmonics,
    }


def table_csv(table: Table) -> str:
    """One line for each recording and model, SI."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for name in table.grouped:
        for model, rows in table.entries.items():
            e = rows[name]
            cycles = [""] * 7 if e.cycles is None else [e.cycles.area, e.cycles.area_noise, *e.cycles.harmonics]
            writer.writerow([name, table.uses[name], model, e.fit_percent, e.rmse, e.residual_over_noise, *cycles])
    return out.getvalue()


def cells(table: Table, name: str) -> list[str]:
    """One line of the table of fits: recording, use, and fit percentage with the residual over noise by model."""
    found = [name, USES[table.uses[name]]]
    for rows in table.entries.values():
        e = rows[name]
        found.append(f"{percent(e.fit_percent, 2)}  ({ratio(e.residual_over_noise)})")
    return found


def heads(table: Table) -> list[str]:
    """Column titles of that table."""
    return ["recording", "use", *(HEADS[m] for m in table.entries)]


def markdown(table: Table, title: str, origin: str, drawings: Sequence[Drawing]) -> str:
    """The comparison for a person."""
    lines = [f"# {title}", "", origin, "", "## Fit in percent, and residual over noise in brackets", ""]
    lines += [*markdown_table(heads(table), [cells(table, n) for n in table.grouped]), "", *_groups(table), ""]
    lines += ["## Steady cycles", "", _CYCLES, "", *_cycles(table), ""]
    lines += ["## Models", "", *_models(table), "", _SUPPLY, ""]
    return "\n".join([*lines, *figure_lines(drawings)])


_CYCLES = (
    "Relative error of the hysteresis loop's signed area, in percent, and error of the harmonics 1, 2 and 3 of the "
    "displacement, in nm; what the noise alone does to either stands in its column."
)
_SUPPLY = (
    "Power balance: at how many random states and inputs storage grows faster than energy is supplied at the "
    "model's own port. Supply: under how many random voltages from rest ∫ V q̇ dt falls below zero by more "
    "than a thousandth of ∫ |V q̇| dt, which no passive actuator with the paper's port allows."
)


def _groups(table: Table) -> list[str]:
    """Residual over noise by use."""
    body = []
    for use, words in USES.items():
        found = [table.over_noise(m, use) for m in table.entries]
        if np.isfinite(found).any():
            body.append([words, *(ratio(v) for v in found)])
    return markdown_table(["residual over noise, root mean square", *(HEADS[m] for m in table.entries)], body)


def _cycles(table: Table) -> list[str]:
    body = []
    for name in table.grouped:
        found = [rows[name].cycles for rows in table.entries.values()]
        first = next((c for c in found if c is not None), None)
        if first is not None:
            noise = f"±{number(100 * first.area_noise, 2)} %; ±{number(1e9 * first.harmonic_noise, 2)} nm"
            body.append([name, noise, *(_cycle(c) for c in found)])
    return (
        markdown_table(["recording", "noise", *(HEADS[m] for m in table.entries)], body)
        if body
        else ["None was recorded."]
    )


def _cycle(cycles: CycleErrors | None) -> str:
    if cycles is None:
        return DASH
    harmonics = ", ".join(number(1e9 * e, 2) for e in cycles.harmonics[:3])
    return f"{number(100 * cycles.area, 2)} %; {harmonics} nm"


def _models(table: Table) -> list[str]:
    body = []
    for model, facts in table.facts.items():
        balance, supplied = facts["passivity"]["power_balance"], facts["passivity"]["supply"]
        counted = balance["violations"]
        body.append([
            HEADS[model], facts["kind"], str(facts["parameters"]), number(facts["seconds"]),
            f"{counted} of {balance['states']}" if counted is not None else balance["reason"],
            f"{supplied['violations']} of {supplied['inputs']}", facts["gradient"],
        ])  # fmt: skip
    return markdown_table(["model", "kind", "parameters", "seconds", "power balance", "supply", "fitted by"], body)
