"""Write the figures and the page of a report, and the verdict for a terminal."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from html import escape
from typing import TYPE_CHECKING, Any

from rich.console import Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from phnn.report import formatting, verdicts
from phnn.report.document import Document, Missing, Score, lost_parts, read_document
from phnn.report.evidence import Evidence, ledger_shares
from phnn.rescue import documents, needed, warnings
from phnn.results import Place

if TYPE_CHECKING:
    from phnn.report.figures.style import Drawing

_STYLES = {"named": "bold green", "equivalent": "bold yellow", "unknown": "bold magenta", "none": "bold cyan"}
_MOST_ROWS = 12


def _missing_lines(missing: Missing) -> list[Text]:
    place = f" ({formatting.words(missing.location)})" if missing.location else ""
    chance = f", {formatting.likelihood(missing.probability)} probable" if missing.probability is not None else ""
    chance += f", {formatting.p_value(missing.p_value)}" if missing.p_value is not None else ""
    lines = [Text.assemble("missing: ", (formatting.words(missing.effect), "bold"), f"{place}{chance}")]
    lines += [Text(f"  {missing.statement}")] if missing.statement else []
    for parameter in missing.parameters:
        value = formatting.with_error(parameter.value, parameter.std)
        text = f"  {parameter.name} = {value} {parameter.shown_unit}".rstrip()
        lines.append(Text(text + (f"  (95 %: {formatting.interval(ends)})" if (ends := parameter.interval_95) else "")))
    sentence = verdicts.equivalence_sentence(missing)
    lines += [Text(f"  {sentence}")] if sentence else []
    return lines


def _location_line(document: Document) -> list[Text]:
    location = document.location
    if location is None or not location.name:
        return []
    scores = dict(location.scores)
    parts = [formatting.words(location.name)]
    if location.detail:
        parts.append(f"– {formatting.words(location.detail)}")
    if (share := scores.get(location.name)) is not None:
        parts.append(f"(its functions predict {100.0 * share:.0f} % of the explainable residual)")
    if location.tied:
        parts.append(f"tied with {formatting.listing(formatting.words(name) for name in location.tied)}")
    return [Text(f"location: {' '.join(parts)}")]


def _cells(score: Score, unit: formatting.Unit) -> list[str]:
    return [
        formatting.percent(score.fit_percent, 2),
        unit.show(score.rmse),
        formatting.ratio(score.residual_over_noise),
    ]


def _fit_table(document: Document) -> list[RenderableType]:
    rows = document.fits
    if not rows:
        return []
    unit = document.rmse_unit
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column("recording", no_wrap=True, overflow="ellipsis", max_width=30)
    for arrow in ("", "→ ") if document.has_after else ("",):
        for heading in (f"{arrow}fit %", f"RMSE {unit.name}", "× noise"):
            table.add_column(heading, justify="right", no_wrap=True)
    for row in rows[:_MOST_ROWS]:
        cells = _cells(row.before, unit) + (_cells(row.after, unit) if document.has_after else [])
        style = "bold" if row.held_out else ""
        table.add_row(Text(row.name + (" *" if row.held_out else "")), *cells, style=style)
    caption = "* held out" if any(row.held_out for row in rows) else ""
    if len(rows) > _MOST_ROWS:
        caption += f"{'; ' if caption else ''}{len(rows) - _MOST_ROWS} more recordings in the report"
    return [Padding(table, (1, 0, 0, 0)), *([Text(caption, style="dim")] if caption else [])]


def console_summary(document: Mapping[str, Any], evidence: Evidence) -> RenderableType:
    """A summary to be printed with :class:`rich.console.Console`; plain text when piped.

    Raises:
        InputRefused: the verdict is not one of the four.
    """
    content = verdicts.in_own_words(read_document(document))
    chance = f"  {formatting.p_value(content.p_value)}" if content.p_value is not None else ""
    verdict = Text.assemble("verdict: ", (content.verdict, _STYLES[content.verdict]), chance)
    parts: list[RenderableType] = [Text(verdicts.headline(content, evidence.verdict_sentence), style="bold"), verdict]
    parts += [Text(line, style="bold") for line in (verdicts.ended_sentence(content),) if line]
    parts += [Text(f"warning: {verdicts.lost_sentence(part)}") for part in content.warnings]
    for missing in content.missing:
        parts += _missing_lines(missing)
    parts += _location_line(content)
    parts += _fit_table(content)
    left = verdicts.remainder_sentence(content.remainder, content.immaterial is not None)
    parts.append(Padding(Text(f"remainder: {left}"), (1, 0, 0, 0)))
    following = content.next_experiment
    if following is not None:
        why = f" – {following.why}" if following.why else ""
        parts.append(Text(f"record next: {following.recording}{why}"))
    elif verdicts.tied(content) or evidence.no_proposal:
        parts.append(Text(f"record next: {verdicts.no_proposal_sentence(content, evidence.no_proposal)}"))
    return Group(*parts)


def write_report(document: Mapping[str, Any], evidence: Evidence, place: Place) -> None:
    """Write ``figures/*.png`` and ``report.html`` into a claimed folder, one self-contained page that opens offline.

    The page is written last: where it exists, the report is complete. The same input gives the same bytes.

    Args:
        document: the content of ``diagnosis.json``; entries that are null or absent are shown as absent.
        evidence: traces, curves and tables.
        place: where to write.

    Raises:
        InputRefused: the verdict is not one of the four, or the folder cannot be written to.
    """
    # drawing libraries take a third of a second to load: not before something is drawn
    from phnn.report.gallery import draw_gallery
    from phnn.report.page import render_page

    content = verdicts.in_own_words(read_document(document))

    def page() -> tuple[Sequence[Drawing], str]:
        shares, unsupplied = ledger_shares(evidence.ledger)
        gallery = draw_gallery(content, evidence, shares)
        told = replace(content, warnings=(*content.warnings, *lost_parts(documents(warnings()))))
        return gallery.drawings, render_page(told, evidence, gallery, shares, unsupplied)

    plain: tuple[Sequence[Drawing], str] = (), ""
    drawings, text = needed("page of the report", page, plain)
    for drawing in drawings:
        (place / "figures" / drawing.file).write(drawing.png)
    (place / "report.html").write((text or _plain_page(document, content, evidence)).encode("utf-8"))


def _plain_page(document: Mapping[str, Any], content: Document, evidence: Evidence) -> str:
    """The answer without figures and tables, where the page of the report cannot be made."""
    lost = [verdicts.lost_sentence(part) for part in (*content.warnings, *lost_parts(documents(warnings())))]
    lines = [verdicts.headline(content, evidence.verdict_sentence), verdicts.ended_sentence(content), *lost]
    paragraphs = "".join(f"<p>{escape(line)}</p>" for line in lines if line)
    whole = escape(json.dumps(document, indent=1, ensure_ascii=False))
    head = f"<!doctype html><html lang=en><meta charset=utf-8><title>Diagnosis: {content.verdict}</title>"
    return f"{head}<h1>Verdict: {content.verdict}</h1>{paragraphs}<pre>{whole}</pre></html>\n"
