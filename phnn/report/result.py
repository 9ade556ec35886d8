"""Write a finished diagnosis: ``diagnosis.json``, the report and the models."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from html import escape
from importlib.metadata import version
from pathlib import Path
from platform import python_version
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from phnn.diagnose.diagnosis import Diagnosis
from phnn.diagnose.formula import Distilled
from phnn.diagnose.locations import Location, where_and_when
from phnn.diagnose.number import family
from phnn.diagnose.proposal import NextExperiment
from phnn.diagnose.screen import chance
from phnn.diagnose.verdict import LEARNED, NONE, UNKNOWN, Claim
from phnn.effects import Effect
from phnn.effects.mechanical import growth_per_decade
from phnn.effects.places import place_of, values_by_role
from phnn.identification.covariance import difference
from phnn.identification.identified import save_fit
from phnn.parameters import quantity
from phnn.recordings.recording import Recording
from phnn.recordings.units import scales_with_forces
from phnn.report import statements as say
from phnn.report.formatting import listing, words
from phnn.report.sections import Provenance, provenance
from phnn.report.words import fitted_in_words, is_effort, vocabulary_of
from phnn.rescue import Failure, accounted, documents, needed, warnings
from phnn.results import PROGRESS, Place, claim, finite
from phnn.setup import Setup
from phnn.signals.noise_statement import NoiseStatement, Sample, noise_statement

Array = NDArray[np.float64]


SCHEMA = "phnn.diagnosis/1"
# What a diagnosis writes into its folder.
RESULTS = ("base", "model", "diagnosis.json", "figures", "report.html", say.WAVEFORM, PROGRESS)
# Least probability that is told; that of nothing missing always is.
_TOLD = 0.001
_PACKAGES = ("phnn", "torch", "numpy", "scipy", "numba")


def write(diagnosis: Diagnosis, out: Path | str, overwrite: bool = False) -> dict[str, Any]:
    """Write what `phnn.Diagnosis.write` writes into a folder and return the document."""
    with claim(Path(out), "diagnose", diagnosis.campaign.inputs, RESULTS, overwrite=overwrite) as place:
        return write_into(diagnosis, place)


def write_into(diagnosis: Diagnosis, place: Place, made_of: Provenance | None = None) -> dict[str, Any]:
    """Write the same into a folder that is claimed already, and return the document.

    A part of the report that fails is left out of it, and is among the warnings of the document.

    Args:
        made_of: how the run was started and what it read; hashed now if left out.

    Raises:
        KeyboardInterrupt: it was interrupted; all but the part at work is written.
    """
    with accounted(answers=True) as account:
        save_fit(diagnosis.base, place / "base")
        save_fit(diagnosis.final, place / "model")
        content = document(diagnosis)
        (place / "diagnosis.json").write_json(content)
        inputs = diagnosis.base.plan.recordings[0].units.input
        following = partial(write_waveform, diagnosis.proposal, diagnosis.base.setup, inputs, place / say.WAVEFORM)
        needed("waveform of the next recording", following, None)
        made_of = made_of or needed("provenance", lambda: provenance(diagnosis.campaign), None)
        text = needed("page of the report", lambda: _report(diagnosis, content, made_of, place), b"")
        (place / "report.html").write(text or _plain_page(content))
        if account.warnings:
            content |= _ending(diagnosis, account.warnings)
            (place / "diagnosis.json").write_json(content)
    if account.interruption is not None:
        raise account.interruption
    return content


def _report(diagnosis: Diagnosis, content: dict[str, Any], made_of: Provenance | None, place: Place) -> bytes:
    """Write the pictures and return the page."""
    # Drawing libraries take a third of a second to load: not before something is drawn.
    from phnn.report.figures.style import Drawing
    from phnn.report.page import page
    from phnn.report.sections import sections

    made = sections(diagnosis, content, made_of)
    for block in (block for section in made for block in section.blocks):
        if isinstance(block, Drawing):
            (place / "figures" / block.file).write(block.png)
    verdict = f"verdict: {diagnosis.verdict}"
    heading = content["summary"]["headline"] if content["summary"] else verdict
    return page(f"Diagnosis: {heading}", heading, made, verdict)


def _plain_page(content: dict[str, Any]) -> bytes:
    """Return the answer as text, where the page of the report cannot be made."""
    paragraphs = "".join(f"<p>{escape(say.failure(f))}</p>" for f in documents(warnings()))
    whole = escape(json.dumps(content, indent=1, ensure_ascii=False))
    head = f"<!doctype html><html lang=en><meta charset=utf-8><title>Diagnosis: {content['verdict']}</title>"
    return f"{head}<h1>Verdict: {content['verdict']}</h1>{paragraphs}<pre>{whole}</pre></html>\n".encode()


def _ending(diagnosis: Diagnosis, further: Sequence[Failure] = ()) -> dict[str, Any]:
    """Return how the search ended, and what failed."""
    ended = diagnosis.ended
    return {
        "ended": {
            "why": ended.why,
            "budget": ended.budget,
            "evaluations": ended.evaluations,
            "not_tried": list(ended.not_tried),
            "failed": documents(ended.failed),
        },
        "warnings": documents((*ended.warnings, *further)),
    }


def document(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return ``diagnosis.json`` as a mapping; numbers that are not finite become null, and so do parts that fail."""
    campaign = diagnosis.campaign
    measured = {r.name: r.noise_found for r in campaign.recordings}
    parts: dict[str, Callable[[], Any]] = {
        "summary": lambda: say.first_screen(diagnosis),
        "test": lambda: _test(diagnosis),
        "probability": lambda: {n: round(p, 4) for n, p in diagnosis.probability.items() if p >= _TOLD or n == NONE},
        "missing": lambda: missing_entries(diagnosis),
        "remainder": lambda: _remainder(diagnosis),
        "location": lambda: location_document(diagnosis),
        "noise": lambda: {
            n: s.document() | {"found": measured[n]}
            for n, s in statements(campaign.recordings, diagnosis.after.outputs, not say.remains(diagnosis)).items()
        },
        "noise_floor": lambda: {r.name: r.noise for r in campaign.recordings},
        "numerical_error_sigma": lambda: diagnosis.error.sigma,
        "kernel_residual": lambda: diagnosis.kernel_residual,
        "units": lambda: campaign.recordings[0].units._asdict(),
        "fit": lambda: {
            "before": diagnosis.before.table(),
            "after": diagnosis.after.table() if diagnosis.final is not diagnosis.base else {},
            "held_out": [p.name for p in diagnosis.before.parts if p.use == "confirmation"],
        },
        "next_experiment": lambda: next_experiment(diagnosis.proposal),
        "versions": lambda: {"python": python_version()} | {name: version(name) for name in _PACKAGES},
        "rules": lambda: [r.document() for r in diagnosis.outcome.rules],
        "criteria": lambda: diagnosis.criteria.changed(),
    }
    content: dict[str, Any] = {"schema": SCHEMA, "verdict": diagnosis.verdict}
    content |= {name: needed(f"{name} of diagnosis.json", made, None) for name, made in parts.items()}
    content |= {"seed": diagnosis.options.seed, "seconds": round(diagnosis.seconds, 2)}
    whole: dict[str, Any] = finite(content | _ending(diagnosis))
    return whole


def _test(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the score of the first element of the model in the residual of the base model, else the largest one; what
    is significant and immaterial has its size."""
    statistic, p_value, name = diagnosis.significance()
    screened = diagnosis.screened[0]
    first = next((c for c in screened if any(c.effect == claim.effect for claim in diagnosis.claims[:1])), None)
    if first is not None:
        statistic, p_value, name = first.score, chance(first.score, screened), first.effect.canonical
    small = say.immaterial(diagnosis)
    test = {"statistic": statistic, "p_value": p_value, "candidate": name or None}
    return test if small is None else test | {"immaterial": small}


def _remainder(diagnosis: Diagnosis) -> dict[str, Any]:
    remaining, small, where = say.remains(diagnosis), say.immaterial(diagnosis, after=True), diagnosis.remaining
    remainder = {
        "verdict": UNKNOWN if remaining else NONE,
        "residual_over_noise": math.sqrt(diagnosis.final.chi2),
        "p_value": diagnosis.significance(after=True)[1],
        "location": where.name if remaining and where is not None else None,
    }
    return remainder if small is None else remainder | {"immaterial": small}


def location_document(diagnosis: Diagnosis) -> dict[str, Any] | None:
    """Return where the mismatch is; None where nothing was located."""
    where, base = diagnosis.location, diagnosis.linearised[0]
    if where is None:
        return None
    name, *tied = diagnosis.places
    scores, frequencies, times = where_and_when(base)
    return {
        "name": name,
        "detail": diagnosis.detail,
        "tied": tied,
        "dictionary": [where.name, *where.tied],
        "scores": {n: round(s, 4) for n, s in where.scores.items()},
        "ranks": {n: round(where.ranks[n], 4) for n in where.scores},
        "recordings": {n: {"residual_over_noise": v} for n, v in scores.items()},
        "frequencies_Hz": frequencies,
        "times_s": times,
        "reasons": reasons(diagnosis, where),
    }


def reasons(diagnosis: Diagnosis, where: Location) -> dict[str, str]:
    """Say of each location that explains more than the winner, or as much, why it is not the winner."""
    first, tied = diagnosis.places[0], diagnosis.places[1:]
    best = where.scores.get(first, 0.0)
    refitted = [c.effect for c in diagnosis.claims if c.effect.location == first]
    why = {}
    for name, score in where.scores.items():
        if name == first:
            continue
        if name in tied:
            why[name] = "cannot be told apart from the first on these recordings"
        elif score > best and refitted:
            why[name] = f"longer bar, but of the fitted models the one with {words(refitted[0].name)} fits best"
        elif score > best:
            tested = f"{where.ranks[name]:.2f}"
            why[name] = f"longer bar, but only {tested} of it is confirmed by another recording"
    return why


_UP_TO_FACTOR = " Absolute values are known up to one common factor, because nothing anchors them."
# A delay is that of one row where it differs from the sampling interval by less than this share.
_SAME_ROW = 0.1
_NOT_PROVEN = " It is part of the model because it improves predictions; nothing proves that it is the physical cause."


def missing_entries(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Return the entries: empty for ``none``, one without a name if no element explains the mismatch."""
    if diagnosis.verdict == "none":
        return []
    return [_entry(diagnosis, c) for c in diagnosis.claims] or [_nameless(diagnosis)]


def _entry(diagnosis: Diagnosis, claim: Claim) -> dict[str, Any]:
    effect, parameters = claim.effect, diagnosis.final.setup.parameters
    shown = {n: quantity(parameters[n].value, parameters[n].unit) for n in claim.parameters}
    names = list(dict.fromkeys(e.title for e in claim.alike))
    # An element whose name is not claimed belongs to the model all the same.
    entry: dict[str, Any] = {"effect": claim.name, "status": claim.status}
    if not claim.claimed:
        entry["effect"] = "unknown"
        entry["nearest"] = next(iter(names), None) if claim.learned else claim.name
    formula = diagnosis.formulas.get(effect.name)
    if formula is not None:
        status = "described" if claim.status == LEARNED else claim.status
        entry |= {"status": status, "description": _description(formula, effect)}
    free = not say.forces_known(diagnosis) and any(scales_with_forces(parameters[n].unit) for n in claim.parameters)
    statement = effect.statement.format(**shown) if formula is None else formula.words
    for copy in claim.copies:
        statement += f" It acts once more, with {listing(f'{n} = {shown[n]}' for n in copy.parameters)}."
    network, scales = diagnosis.final.setup.network, diagnosis.linearised[0].scales
    stiffness, first, last = values_by_role(network).get("k"), 1.0 / scales.fastest, scales.duration
    # Neither a motion without a spring grows under a force, nor one that was recorded for less than a period.
    if effect.title == "creep" and stiffness and first < last:
        growth = growth_per_decade(network, stiffness, first, last)
        entry["percent_per_decade"] = growth
        statement += (
            f" From {quantity(first, 's')} to {quantity(last, 's')} it grows by {growth:.2g} % in every decade."
        )
    if effect.title == "delay":
        rows = parameters[effect.parameters[0]].value / min(r.dt for r in diagnosis.campaign.recordings)
        late = " It is one row: the data acquisition writes one of the two channels a row late."
        statement += late if abs(rows - 1.0) <= _SAME_ROW else ""
    # An effect's own score in the residual of the base model; its p-value is that times the number of candidates.
    candidates = diagnosis.screened[0]
    score = max((c.score for c in candidates if family(c.effect) == claim.name), default=0.0)
    gain, held_out = diagnosis.gains[diagnosis.claims.index(claim)], None
    if gain is not None:
        held_out = {"before": gain.before, "after": gain.after, "p_value": gain.falls, "rms": gain.rms}
    return entry | {
        "probability": round(claim.probability, 4),
        "held_out": held_out,
        "share_explained": claim.share,
        "location": effect.location,
        "place": place_of(effect, diagnosis.base.setup.network),
        "equivalent_to": names,
        "p_value": chance(score, candidates) if candidates else 1.0,
        "statement": statement + (_UP_TO_FACTOR if free else "") + ("" if claim.claimed else _NOT_PROVEN),
        "equation": effect.equation if formula is None else formula.equation,
        "passive": effect.passive,
        "parameters": diagnosis.final.estimates(effect.all_strengths if claim.learned else claim.parameters),
    }


def _description(formula: Distilled, effect: Effect) -> dict[str, Any]:
    """Return the formula of a learned element; exponents by their symbols, each with its 95 % interval."""
    return {
        "kind": effect.kind.name,
        "formula": formula.equation,
        "words": formula.words,
        "parameters": {n: {"value": value, "unit": unit} for n, (value, unit) in formula.parameters.items()},
        "exponents": {n: list(interval) for n, (_, interval) in formula.exponents.items()},
        "passive": effect.passive,
        "others": list(formula.others),
    }


def _nameless(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the entry of a mismatch that no element describes."""
    where, alike = diagnosis.location, say.likenesses(diagnosis)
    fitted = "" if where is None else fitted_in_words(diagnosis.linearised[0], where)
    free = where is not None and is_effort(where) and not say.forces_known(diagnosis)
    factor = _UP_TO_FACTOR if free and vocabulary_of(diagnosis.base.setup.network).mechanical else ""
    return {
        "effect": "unknown",
        "status": "provisional",
        "nearest": family(alike[0][0]) if alike else None,
        "probability": None,
        "held_out": None,
        "share_explained": None,
        "location": where.name if where else "mechanical",
        "place": None,
        "equivalent_to": [],
        "p_value": diagnosis.significance()[1],
        "statement": f"{say.headline(diagnosis)}. {say.acts_like(diagnosis)} {fitted}".strip() + factor,
        "equation": "",
        "passive": False,
        "parameters": {},
    }


def next_experiment(proposal: NextExperiment | None) -> dict[str, Any] | None:
    """Describe the proposed recording: words, stretches of its input, separation by each recording of the menu."""
    if proposal is None:
        return None
    e = proposal.experiment
    return {
        "recording": e.words,
        "separates": list(proposal.separates),
        "why": proposal.why,
        "separation": proposal.separation,
        "needed": proposal.needed,
        "menu": dict(proposal.menu),
        "aim": proposal.aim,
        "groups": [list(g) for g in proposal.groups],
        "kind": e.kind,
        "duration_s": e.duration,
        "sample_rate_hz": e.rate,
        "input": e.interpolation,
        "stretches": [
            {
                "start_s": s.start,
                "end_s": s.end,
                "level": s.level,
                "lines": [{"amplitude": a, "frequency_Hz": f, "phase_rad": phase} for a, f, phase in s.lines],
            }
            for s in e.stretches
        ],
    }


def write_waveform(proposal: NextExperiment | None, setup: Setup, unit: str, place: Place) -> None:
    """Time and input of the proposed recording, where there is one; ``unit`` is that of the recorded inputs."""
    if proposal is None:
        return
    port = setup.network.ports[0]
    table = pd.DataFrame({"time_s": proposal.experiment.t, f"{port.name}_{unit}": proposal.experiment.u})
    place.write(table.to_csv(index=False, float_format="%.9g").encode())


def statements(
    recordings: Sequence[Recording], outputs: Mapping[str, Array], complete: bool
) -> dict[str, NoiseStatement]:
    """Return the noise by recording, held-out ones included: it decides nothing. Recordings that could not be simulated
    have none.

    Args:
        outputs: of a model, by recording.
        complete: the model leaves nothing that matters.
    """
    noise = {}
    for r in (r for r in recordings if r.name in outputs):
        chosen = [r.mask(use) for use in ("identification", "confirmation")]
        mask = max(chosen, key=np.count_nonzero)
        residual = ((r.y - outputs[r.name]) / r.noise)[mask]
        speed = (np.gradient(outputs[r.name], r.dt) / r.noise)[mask]
        # The residual if it is not significant, else the part that does not repeat, where there is one.
        shown = residual if complete else difference(residual, r)
        sample = None
        if shown is not None:
            sample = Sample(shown, r.dt, speed[-shown.size :], r.step / r.noise, r.noise)
        noise[r.name] = noise_statement(r.noise, r.noise_source, r.units.output, sample)
    return noise
