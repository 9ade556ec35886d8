"""The report of a diagnosis as a list of sections: the first screen, and what folds below it; the page of a check.

Every part is made by itself: one that fails is left out, and is among the warnings.
"""

from __future__ import annotations

import math
import shlex
from base64 import b64encode
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from phnn.check import Checked
from phnn.diagnose.diagnosis import Diagnosis
from phnn.diagnose.number import family
from phnn.diagnose.verdict import NAMED, UNKNOWN, Claim
from phnn.html import table, titled
from phnn.network.roles import auxiliary
from phnn.recordings import Campaign
from phnn.recordings.reader import facts
from phnn.recordings.recording import ACTUATOR, Recording, digest
from phnn.recordings.units import scales_with_forces
from phnn.report import statements as say
from phnn.report.figures import Trace, amplitude_density, draw_curve, draw_error, draw_recording, draw_trace
from phnn.report.figures.style import AFTER, BEFORE, FAINT, INK, RC, Drawing, finish, new_figure, png, svg
from phnn.report.formatting import (
    display_unit,
    finite,
    interval,
    likelihood,
    listing,
    number,
    p_value,
    percent,
    ratio,
    short,
    with_error,
    words,
)
from phnn.report.page import Bar, Bars, Block, Code, Formula, Link, Section, Table, page
from phnn.report.words import Picture, learned_picture, picture
from phnn.rescue import documents, needed, warnings
from phnn.results import Place, file_name, printable, sha256_of

# Recordings that are drawn beside that of the first screen; rows of models and of candidates.
_DRAWN, _ROWS = 3, 12
# Notes of parts that failed on the first screen.
_NOTES = 3


def sections(diagnosis: Diagnosis, document: dict[str, Any], made_of: Provenance | None) -> list[Section]:
    """Return the sections in their order, without those that have nothing to show.

    Args:
        document: the content of ``diagnosis.json``.
        made_of: how the run was started and what it read.
    """
    nothing: list[Trace] = []
    traces = needed("traces of the recordings", lambda: traces_of(diagnosis), nothing)
    parts: dict[str, Callable[[], list[Block]]] = {
        "What is missing": lambda: _missing(diagnosis, document),
        "Where it acts": lambda: _where(diagnosis, document),
        "How well the model predicts": lambda: _recordings(diagnosis, document, traces),
        "Parameters": lambda: _parameters(diagnosis),
        "What was tried": lambda: _tried(diagnosis),
        "What was understood of the recordings": lambda: _understood(diagnosis, document),
        "Use the model and repeat the run": lambda: _use(diagnosis, document, traces, made_of),
    }
    folded = [Section(title, needed(f"section “{title}”", work, [])) for title, work in parts.items()]
    # The first screen is made last, because it tells which parts failed.
    return [Section(None, _first(diagnosis, traces)), *(s for s in folded if s.blocks)]


def drawing(stem: str, title: str, alt: str, draw: Callable[[], Figure], lines: bool = True) -> list[Drawing]:
    """Return a picture; none where it cannot be drawn.

    Args:
        lines: the page shows it as SVG; otherwise as PNG, which is smaller where many points are drawn.
    """

    def drawn() -> list[Drawing]:
        with rc_context(RC):
            figure = draw()
            return [Drawing(file_name(stem, ".png"), title, alt, png(figure), svg(figure, stem) if lines else b"")]

    return needed(f"figure {stem}", drawn, [])


def traces_of(diagnosis: Diagnosis) -> list[Trace]:
    """Return all parts that were scored: held-out ones first, then those that the base model predicts worst."""
    scores = {p.name: p.residual_over_noise for p in diagnosis.before.parts}
    traces = []
    for r in diagnosis.campaign.recordings:
        for part in (p for p in r.parts if p.use != "nuisance" and r.name in diagnosis.before.outputs):
            rows = slice(part.first, part.last)
            before, after = (e.outputs[r.name][rows] for e in (diagnosis.before, diagnosis.after))
            noise = r.noise if r.noise_found else None
            traces.append(
                Trace(part.name, r.t[rows], r.u[rows], r.y[rows], before, after, noise, r.units.output,
                      part.use == "confirmation", scores.get(part.name, math.nan))
            )  # fmt: skip
    return sorted(traces, key=lambda t: (not t.held_out, -(finite(t.over_noise) or 0.0)))


def error_figure(diagnosis: Diagnosis) -> Figure:
    """Return a figure of the error before and after against the noise, on the worst held-out recording."""
    with rc_context(RC):
        return draw_error(traces_of(diagnosis)[0])


def notebook(diagnosis: Diagnosis) -> str:
    """Return the first screen for a notebook."""
    heading = say.headline(diagnosis)
    drawn = b64encode(svg(error_figure(diagnosis))).decode("ascii")
    picture = f'<img alt="{escape(heading)}: error before and after" src="data:image/svg+xml;base64,{drawn}">'
    likely = table(("cause", "probability"), ((name, likelihood(p)) for name, p in say.causes(diagnosis)))
    return titled(heading, f"<p>{escape(say.consequence(diagnosis))}</p>", picture, likely)


def _first(diagnosis: Diagnosis, traces: Sequence[Trace]) -> list[Block]:
    nothing: list[Any] = []
    answer = needed("sentence of the verdict", lambda: [say.consequence(diagnosis)], nothing)
    open_name = diagnosis.verdict == UNKNOWN
    like = needed("what it acts like", lambda: [say.acts_like(diagnosis)], nothing) if open_name else []
    shown: list[Drawing] = []
    for trace in traces[:1]:
        use = "held-out recording" if trace.held_out else "recording"
        whole = trace.stretch == slice(0, trace.t.size)
        title = f"Error on the {use} {trace.name}" + ("." if whole else ", where the base model is worst.")
        title += " A model that misses nothing leaves 1 × noise." if finite(trace.over_noise) else ""
        both = "of base model and final model" if trace.changed else "of the base model"
        alt = f"Error {both} over time, on {trace.name}, with the band of the noise"
        shown = drawing(f"error-{trace.name}", title, alt, partial(draw_error, trace))
    bars = needed("probabilities", lambda: [Bar(name, p, likelihood(p)) for name, p in say.causes(diagnosis)], nothing)
    alike = needed("effects that explain most", lambda: say.likenesses(diagnosis), nothing) if open_name else []
    rows = [Bar(words(family(e)), share, f"{100.0 * share:.0f} %") for e, share in alike]
    others = [Bars("Share of the excess over the noise that one effect alone explains", rows)] if rows else []
    proposed = needed("next recording", lambda: say.next_recording(diagnosis), "")
    link: list[Block] = [proposed] if diagnosis.proposal is None else [Link(proposed, say.WAVEFORM)]
    following = link if proposed else []
    limits = say.notes(diagnosis)
    more = [f"{len(limits) - _NOTES} more parts failed: see “What was tried”."] if len(limits) > _NOTES else []
    return [*answer, *limits[:_NOTES], *more, *like, *shown, Bars("Probabilities", bars), *others, *following]


def _missing(diagnosis: Diagnosis, document: dict[str, Any]) -> list[Block]:
    blocks: list[Block] = []
    entries = document["missing"] or []
    for claim, entry in zip(diagnosis.claims, entries, strict=False):
        name = words(claim.name) if claim.claimed or claim.learned else f"acts like {words(claim.name)}"
        blocks.append(f"{say.capital(name)}: {entry['statement']}")
        if entry["equation"]:
            blocks.append(Formula(entry["equation"]))
        rows = [
            [n, with_error(p["value"], p["std"]), say.shown_unit(p["unit"]), interval(p["interval_95"])]
            for n, p in ({} if claim.learned else entry["parameters"]).items()
        ]
        if rows:
            blocks.append(Table(["parameter", "value", "unit", "95 % interval"], rows))
        if claim.alike:
            others = listing((words(e.title) for e in claim.alike), "or")
            blocks.append(f"These recordings cannot tell it from {others}. What would: {claim.effect.separation}")
        curve = needed(f"curve of {claim.effect.name}", partial(curve_of, diagnosis, claim), None)
        if curve is not None:
            title = f"What was learned where {words(claim.effect.name)} acts: {curve.y_label} over {curve.x_label}."
            blocks += drawing(f"curve-{claim.effect.name}", title, title, partial(draw_curve, curve))
        blocks.append(f"How it shows in recordings: {claim.effect.fingerprint}")
        blocks += _plausible(diagnosis, claim)
        passive = "The model with it stays passive." if entry["passive"] else "It is no part of the passive network."
        blocks.append(f"{passive} References: {'; '.join(claim.effect.references)}.")
    proposal = None if diagnosis.verdict == NAMED else diagnosis.proposal
    why = [] if proposal is None else [f"Why the next recording: {proposal.why}"]
    return [*(blocks or [e["statement"] for e in entries]), *why]


def _plausible(diagnosis: Diagnosis, claim: Claim) -> list[str]:
    known, anchored = diagnosis.final.setup.parameters, say.forces_known(diagnosis)
    if diagnosis.campaign.recordings[0].units != ACTUATOR:
        return []
    free = [n for n in claim.effect.parameters if not known[n].fixed]
    sentences = (say.plausibility(known[n], claim.effect.plausible[n], dict(known), anchored) for n in free)
    return [t for t in sentences if t]


def curve_of(diagnosis: Diagnosis, claim: Claim) -> Picture | None:
    """Return what was learned without the catalogue where an element acts, or the law of a learned element.

    None where the best functions belong to another location or kind than the element, or have no static picture.
    """
    where, base, effect = diagnosis.location, diagnosis.linearised[0], claim.effect
    if where is None or (where.name, where.detail) != (effect.location, effect.kind.name):
        return None
    if claim.learned and where.name == "mechanical":
        return learned_picture(base, where, diagnosis.final.setup, effect.strengths)
    return picture(base, where)


def _where(diagnosis: Diagnosis, document: dict[str, Any]) -> list[Block]:
    location = document["location"]
    if location is None:
        return []
    # The winner stands first, then the longest bars.
    ranked = sorted(location["scores"].items(), key=lambda item: (item[0] != location["name"], -item[1]))
    shown = [(say.location_name(diagnosis, name), score, location["reasons"].get(name, "")) for name, score in ranked]
    rows = [Bar(name, score, f"{score:.2f}".replace("-", "−"), reason) for name, score, reason in shown]
    strongest = sorted(location["recordings"].items(), key=lambda item: -(item[1]["residual_over_noise"] or 0.0))[:3]
    seen = [f"{name} ({ratio(v['residual_over_noise'])} × noise)" for name, v in strongest]
    place = f"The mismatch is strongest in {listing(seen)}"
    frequencies = [short(f) for f in location["frequencies_Hz"][:6]]
    return [
        Bars("Share of the explainable residual, predicted on recordings left out", rows),
        f"{place}, at {', '.join(frequencies)} Hz." if frequencies else f"{place}.",
    ]


def _recordings(diagnosis: Diagnosis, document: dict[str, Any], traces: Sequence[Trace]) -> list[Block]:
    fit = document["fit"]
    if not fit or not fit["before"]:
        return []
    rmse = [s["rmse"] for which in ("before", "after") for s in fit[which].values() if s["rmse"] is not None]
    unit = display_unit(max(rmse, default=None), diagnosis.campaign.recordings[0].units.output)
    bare = {r.name for r in diagnosis.campaign.recordings if not r.noise_found}

    def cells(name: str) -> list[str]:
        floorless = name.partition("[")[0] in bare
        scores = [fit[which][name] for which in ("before", "after") if name in fit[which]]
        scored = (
            (percent(s["fit_percent"], 2), unit.show(s["rmse"]), "–" if floorless else ratio(s["residual_over_noise"]))
            for s in scores
        )
        return [" → ".join(both) for both in zip(*scored, strict=True)]

    names = sorted(fit["before"], key=lambda n: n not in fit["held_out"])
    rows = [[n, "held out" if n in fit["held_out"] else "", *cells(n)] for n in names]
    scores_table = Table(["recording", "", "fit (%)", f"RMSE ({unit.name})", "error (× noise)"], rows, 2)
    blocks: list[Block] = [say.remainder_in_words(diagnosis), scores_table]
    for trace in traces[:_DRAWN]:
        alt = f"Measured and modelled output of {trace.name} over time, and the errors below"
        title = f"{trace.name}, held out" if trace.held_out else trace.name
        blocks += drawing(f"recording-{trace.name}", title, alt, partial(draw_recording, trace))
    return blocks


def parameter_rows(diagnosis: Diagnosis) -> Iterator[list[str]]:
    """Yield the rows of the table of parameters."""
    final = diagnosis.final
    before, after, std = diagnosis.base.setup.parameters, final.setup.parameters, final.std()
    anchored, hidden = say.forces_known(diagnosis), auxiliary(final.setup.network)
    for name, p in ((n, p) for n, p in after.items() if n not in hidden):
        note = final.note(name) or ("constant" if p.fixed else "")
        if not note and not anchored and scales_with_forces(p.unit):
            note = "up to one common factor"
        note = note or (f"base model: {unknown}" if (unknown := diagnosis.base.note(name)) else "")
        old = before[name].value if name in before else None
        value, ends = with_error(p.value, finite(std.get(name))), interval(final.interval(name))
        label = name if p.unit == "1" else f"{name} ({say.shown_unit(p.unit)})"
        yield [label, "; ".join(filter(None, (p.description, note))), number(old), value, ends]


def _parameters(diagnosis: Diagnosis) -> list[Block]:
    head = ["parameter", "meaning", "before", "after ± standard error", "95 % interval"]
    return [Table(head, list(parameter_rows(diagnosis)), 2)]


def _tried(diagnosis: Diagnosis) -> list[Block]:
    models = list(zip(diagnosis.visited.models, diagnosis.visited.shares, strict=True))[:_ROWS]
    fitted = [
        [m.words + (" (final model)" if m.key == diagnosis.chosen.key else ""), number(m.left), number(m.left_held_out),
         likelihood(float(share)), "yes" if m.converged else "no"]
        for m, share in models
    ]  # fmt: skip
    samples = diagnosis.base.residual.size
    best = sorted(diagnosis.screened[0], key=lambda c: -c.score)[:_ROWS]
    at = partial(say.location_name, diagnosis)
    scored = [[words(c.effect.name), at(c.effect.location), number(c.score), number(c.fall / samples)] for c in best]
    _, p, name = diagnosis.significance()
    failed = documents((*diagnosis.ended.failed, *diagnosis.ended.warnings, *warnings()))
    blocks: list[Block] = [say.failure(f) for f in failed]
    if name:
        blocks.append(f"The largest score in the residual of the base model is that of {words(name)} ({p_value(p)}).")
    blocks.append(
        f"{len(diagnosis.visited.models)} models were fitted; χ²/N is the mean square of the residual over the noise's."
    )
    blocks.append(Table(["base model and", "χ²/N fitted", "χ²/N held out", "probability", "converged"], fitted))
    if scored:
        blocks.append(Table(["candidate", "location", "score", "predicted fall of χ²/N"], scored, 2))
    return blocks


def _understood(diagnosis: Diagnosis, document: dict[str, Any]) -> list[Block]:
    unit = diagnosis.campaign.recordings[0].units.output
    noise = document["noise"] or {}
    size = display_unit(max((n["rms"] for n in noise.values() if n["rms"]), default=None), unit)
    rows = [
        [n, v["source"] if v["found"] else "none was found", v["colour"], "; ".join(v["notes"]), size.show(v["rms"])]
        for n, v in noise.items()
    ]
    floors = [Table(["noise of", "from", "colour", "remark", f"rms ({size.name})"], rows, 4)] if rows else []
    return [*diagnosis.campaign.notes, *floors]


def usage(traces: Sequence[Trace], input_unit: str, output_unit: str) -> str:
    """Return a short program: a sine over the range and the time of the first recording, simulated with the model."""
    middle, amplitude, seconds = 0.0, 1.0, 1.0
    if traces and np.isfinite(traces[0].u).any():
        low, high = float(np.nanmin(traces[0].u)), float(np.nanmax(traces[0].u))
        middle, amplitude = 0.5 * (low + high), 0.5 * (high - low) or 1.0
        seconds = float(np.ptp(traces[0].t)) or 1.0
    wave = f"{amplitude:.4g} * np.sin({6.0 * math.pi / seconds:.4g} * t)"
    if abs(middle) > 0.1 * amplitude:
        wave = f"{middle:.4g} - {wave.replace('sin', 'cos')}"
    return (
        "import numpy as np\nimport phnn\n\n"
        'model = phnn.load("model")  # the folder beside this page\n'
        f"t = np.linspace(0.0, {seconds:.4g}, 2001)  # [s]\n"
        f"u = {wave}  # [{input_unit}]\n"
        f"y = model.simulate(t, u)  # [{output_unit}]"
    )


def _use(
    diagnosis: Diagnosis, document: dict[str, Any], traces: Sequence[Trace], made_of: Provenance | None
) -> list[Block]:
    units = diagnosis.campaign.recordings[0].units
    versions = ", ".join(f"{n} {v}" for n, v in (document["versions"] or {}).items())
    blocks: list[Block] = [Code(usage(traces, units.input, units.output))]
    if made_of is not None:
        blocks.append(Code(made_of.command or "started from Python"))
        files = "\n".join(f"{digest}  {name}" for name, digest in made_of.files.items())
        blocks.append(f"Recordings: {made_of.folder}. SHA-256 of the files, and of all samples as understood:")
        blocks.append(Code(f"{files}\n{made_of.understood}  as understood".lstrip()))
    q = say.quality(diagnosis)
    scored = f"Errors are root mean squares over {q.on}; " if q.held_out else ""
    blocks.append(f"{scored}{versions}; seed {diagnosis.options.seed}; {document['seconds']} s.")
    return blocks


@dataclass(frozen=True)
class Provenance:
    """What a reader needs to do a run again.

    Attributes:
        command: as it was typed, quoted for a shell; empty where the run was started from Python.
        folder: of the recordings.
        files: SHA-256 of the manifest and of the recordings, by name; files that are gone have none.
        understood: SHA-256 of all samples, uses and starts as they were understood; the same for the same result.
    """

    command: str
    folder: str
    files: Mapping[str, str]
    understood: str


def command_line(typed: Sequence[str]) -> str:
    """Return a command as one line for a shell; empty where nothing was typed."""
    return printable(shlex.join(["phnn", *typed])) if typed else ""


def provenance(campaign: Campaign, command: str = "", manifest: Path | None = None) -> Provenance:
    """Hash the files of a campaign; call it soon after they were read.

    Args:
        command: how the run was started, see `command_line`.
        manifest: where the manifest lies, if not in the folder.
    """
    folder = Path(campaign.folder)
    stated = "recordings.yaml" if manifest is None else printable(str(manifest))
    paths = {stated: manifest or folder / stated}
    paths |= {name: folder / name for r in campaign.recordings for name in r.source.split(", ") if name}
    hashes = ((name, _hash(path)) for name, path in paths.items())
    return Provenance(command, campaign.folder, {n: h for n, h in hashes if h}, digest(campaign))


def _hash(path: Path) -> str:
    try:
        return sha256_of(path) if path.is_file() else ""
    except (OSError, ValueError):
        return ""


# ---- The page of `phnn check`

Array = NDArray[np.float64]

# Decades below the highest line that are worth drawing.
_DECADES = 7.0


def draw_recorded(recording: Recording) -> Figure:
    """Draw input, output (held-out samples on grey), loop and spectra of a recording; without an output its input."""
    r, u_label = recording, f"input ({recording.units.input})"
    if not np.isfinite(r.y).all():
        figure = new_figure(10.1, 2.5)
        _in_time(figure.subplots(), r, r.u, u_label, BEFORE)
        return figure
    figure = new_figure(10.1, 4.9)
    (u_axes, loop), (y_axes, spectrum) = figure.subplots(2, 2, width_ratios=[1.75, 1.0])
    scale = display_unit(float(np.abs(r.y).max()), r.units.output)
    y, y_label = r.y / scale.scale, f"output ({scale.name})"
    _in_time(u_axes, r, r.u, u_label, BEFORE)
    _in_time(y_axes, r, y, y_label, AFTER)
    loop.plot(r.u, y, color=AFTER, linewidth=0.5)
    loop.locator_params(nbins=5)
    finish(loop, u_label, y_label, None)
    _spectra(spectrum, r)
    return figure


def _in_time(axes: Axes, recording: Recording, x: Array, label: str, colour: str) -> None:
    draw_trace(axes, recording.t, x, color=colour, linewidth=0.9)
    for part in (p for p in recording.parts if p.use == "confirmation"):
        ends = recording.t[[part.first, part.last - 1]]
        axes.axvspan(*ends, color=FAINT, alpha=0.5, linewidth=0, zorder=0)
    axes.margins(x=0.01)
    finish(axes, "time (s)", label, None)


def _spectra(axes: Axes, recording: Recording) -> None:
    """Draw amplitude densities, the input's over its largest so that both have one axis."""
    unit = display_unit(recording.noise, recording.units.output)
    f, drive = amplitude_density(recording.u, recording.dt)
    _, output = amplitude_density(recording.y, recording.dt)
    floor = recording.noise * float(np.sqrt(2.0 * recording.dt)) / unit.scale
    output /= unit.scale
    highest = float(output.max())
    drive *= highest / max(float(drive.max()), 1e-300)
    axes.loglog(*_drawn(f, output), color=AFTER, linewidth=0.8, label="output")
    axes.loglog(*_drawn(f, drive), color=BEFORE, linewidth=0.6, label="input")
    axes.axhline(floor, color=INK, linewidth=1.0, dashes=(4, 2), label="noise floor")
    axes.set_ylim(max(0.1 * floor, highest * 10.0**-_DECADES), 3.0 * highest)
    finish(axes, "frequency (Hz)", f"output ({unit.name}/√Hz)", "upper right", ncols=3, columnspacing=1.0)


def _drawn(f: Array, density: Array) -> tuple[Array, Array]:
    """Return evenly many points a decade, the highest of each stretch, so that no line is lost."""
    edges = np.unique(np.searchsorted(f, np.geomspace(f[0], f[-1], 1200)))
    return f[edges], np.maximum.reduceat(density, edges)


def write_check(checked: Checked, place: Place) -> None:
    """Write ``check.json`` and ``check.html`` into a folder."""
    (place / "check.json").write_json(checked.document())
    campaign = checked.campaign
    noticed = [[name, f.severity, f.text] for name, findings in checked.findings.items() for f in findings]
    noise = [[name, n.colour, "; ".join(n.notes)] for name, n in checked.noise.items()]
    able = [[a.shows, "yes" if a.able else "no", "" if a.able else a.record] for a in checked.abilities]
    first: list[Block] = [campaign.folder]
    first.append(Table(["recording", "", "what was noticed"], noticed, 3) if noticed else "Nothing suspicious.")
    sections = [
        Section(None, first),
        Section("What these recordings can show", [Table(["effects", "", "to record for them"], able, 3)], open=True),
        Section("Noise", [Table(["recording", "colour", "what else"], noise, 3)]),
        *(Section(f"{r.name} ({r.source})", _recorded(r)) for r in campaign.recordings),
        Section("What was understood", list(campaign.notes)),
    ]
    count = len(campaign.recordings)
    heading = f"What was understood of {count} recording{'s' if count != 1 else ''}"
    (place / "check.html").write(page(f"Recordings: {campaign.folder}", heading, sections))


def _recorded(recording: Recording) -> list[Block]:
    """Return the facts and the picture of a recording."""
    rows = [list(fact) for fact in facts(recording)]
    title = f"{recording.name}: input and output in time (held-out samples on grey), as a loop, and their spectra."
    return [
        Table(["", ""], rows, 2),
        *drawing(recording.name, title, title, partial(draw_recorded, recording), lines=False),
    ]
