"""Write a finished diagnosis: ``diagnosis.json``, the report and the models."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from platform import python_version
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from phnn.check import check
from phnn.check.quality import doubts_of_units
from phnn.diagnose.diagnosis import Diagnosis
from phnn.diagnose.locations import where_and_when
from phnn.diagnose.number import family, uid
from phnn.diagnose.proposal import NextExperiment
from phnn.diagnose.screen import chance
from phnn.diagnose.verdict import NONE, UNKNOWN, Claim
from phnn.diagnose.words import Picture, is_effort, learned_picture, missing_force, picture
from phnn.effects import Plausible
from phnn.effects.places import values_by_role
from phnn.identification.covariance import difference
from phnn.identification.identified import save_fit
from phnn.integrate.equations import power_balance
from phnn.network.roles import auxiliary, capacitances
from phnn.parameters import FORCE_UNITS, Parameter, quantity
from phnn.recordings.recording import ACTUATOR, Recording
from phnn.report.evidence import Evidence, LedgerRow, ParameterRow, PlausibleRow, Provenance, RivalRow, Support, Trace
from phnn.report.formatting import likelihood, listing, number, words
from phnn.report.methods import methods, provenance
from phnn.report.missing import candidate_rows, fingerprint, immaterial, missing_entries, model_rows, remains, sentence
from phnn.report.verdicts import forces_known
from phnn.report.write import write_report
from phnn.rescue import Failure, accounted, documents, needed
from phnn.results import PROGRESS, Place, claim, finite
from phnn.setup import Setup
from phnn.signals.noise_statement import NoiseStatement, Sample, noise_statement
from phnn.signals.sampling import quantisation_step
from phnn.trajectory import Trajectory

# Rivals that are shown.
_RIVALS = 8


def supports(diagnosis: Diagnosis) -> tuple[Support, ...]:
    """Return one entry for each element, in the order of ``missing``."""
    known, anchored = diagnosis.final.setup.parameters, forces_known(diagnosis)
    actuator = diagnosis.campaign.recordings[0].units == ACTUATOR

    def support(claim: Claim) -> Support:
        effect = claim.effect
        free = [n for n in effect.parameters if not known[n].fixed]
        plausible = tuple(plausible_row(known[n], effect.plausible[n], known, anchored, actuator) for n in free)
        return Support(
            effect.name, effect.fingerprint, fingerprint(diagnosis, effect), math.sqrt(diagnosis.chosen.left),
            _rivals(diagnosis, claim), effect.separation, effect.references, plausible,
        )  # fmt: skip

    return tuple(map(support, diagnosis.claims))


def _rivals(diagnosis: Diagnosis, claim: Claim) -> tuple[RivalRow, ...]:
    """List the visited models with another element in the place of one, and neighbours that were not fitted there."""
    others, alike = diagnosis.chosen.key - {uid(claim.effect)}, {family(e) for e in claim.alike}
    pairs = zip(diagnosis.visited.models, diagnosis.visited.shares, strict=True)
    rows: dict[str, RivalRow] = {}
    for model, share in sorted(pairs, key=lambda p: p[0].fit.cost):
        instead = [e for e in model.elements if uid(e) not in others]
        if not others <= model.key or len(instead) != 1 or family(instead[0]) == claim.name:
            continue
        more = model.fit.cost - diagnosis.final.cost
        excluded = "not excluded: " if family(instead[0]) in alike else ""
        excluded = excluded or ("" if model.converged else "not fitted to its end: ")
        outcome = f"sum of squares {number(abs(more))} {'larger' if more > 0.0 else 'smaller'}"
        told = f"{excluded}{outcome}, probability {likelihood(float(share))}"
        rows.setdefault(instead[0].name, RivalRow(instead[0].name, math.sqrt(model.left), told))
    scores = {c.effect.name: c.score for c in diagnosis.screened[0]}
    unfitted = [n for n in claim.effect.neighbours if n in scores and n not in rows]
    texts = [(n, f"not fitted: its score at the base model is {number(scores[n])}") for n in unfitted]
    return (*list(rows.values())[:_RIVALS], *(RivalRow(n, None, text) for n, text in texts))


def plausible_row(
    parameter: Parameter, known: Plausible, base: Mapping[str, Parameter], anchored: bool, actuator: bool
) -> PlausibleRow:
    """A parameter compared with its plausible range.

    Args:
        base: parameters of the model, of which the range may name one to divide by.
        anchored: something fixes the common factor of all forces.
        actuator: the recordings are those of a piezo actuator, for which the ranges hold.
    """
    name, value, unit = parameter.name, parameter.value, parameter.unit
    said = quantity(value, unit)
    if not known.source or not actuator or (known.over and known.over not in base):
        return PlausibleRow(name, f"{said}: no range known.", None)
    if known.over:
        other = base[known.over]
        value, unit = value / other.value, f"× {known.over}" if other.unit == unit else f"{unit}/{other.unit}"
        unit = "1/s" if unit == "S/F" else unit
        said = f"{said}, that is {value:.3g} {unit}"
    elif not anchored and unit in FORCE_UNITS:
        return PlausibleRow(
            name, f"{said}: known up to one common factor only, hence not comparable with a range.", None
        )
    lower = "0" if known.lower == 0.0 else quantity(known.lower, unit)
    limits = f"{lower} to {quantity(known.upper, unit)}"
    if known.lower <= value <= known.upper:
        return PlausibleRow(name, f"{said} is plausible: {limits} ({known.source}).", True)
    beyond = f" If it is real, {known.outside}." if known.outside and value > known.upper else ""
    side = "above" if value > known.upper else "below"
    return PlausibleRow(
        name, f"{said} is not plausible: it is {side} the range {limits} ({known.source}).{beyond}", False
    )


WAVEFORM = "next_experiment.csv"
# Recordings that are asked for at a time.
_LACKS = 3


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


def no_proposal(diagnosis: Diagnosis) -> str:
    """Say why no recording is proposed, which experiment would decide in principle, and what was not recorded."""
    if diagnosis.proposal is not None or diagnosis.verdict == NONE:
        return ""
    tied = next((c for c in diagnosis.claims if c.alike), None)
    places = not diagnosis.claims and diagnosis.location is not None and diagnosis.location.tied
    if tied is None and not places and diagnosis.verdict != UNKNOWN:
        return ""
    # Recordings whose absence `phnn check` reports.
    lacks = [a.record for a in check(diagnosis.campaign).abilities if not a.able][:_LACKS]
    if tied is None and not places:
        if not lacks:
            return ""
        return (
            "No two models are left between which a recording could be computed to decide, and yet no name is proven. "
            f"Recordings that these lack would narrow it down: {'; '.join(lacks)}."
        )
    members = () if tied is None else (tied.effect, *tied.alike)
    if members:
        start = (
            f"No recording is proposed for what is tied: on none of the menu do the refitted models of "
            f"{listing(words(e.name) for e in members)} differ once their parameters adapt, or none of it can be "
            "simulated."
        )
    else:
        start = (
            "No recording is proposed for what is tied: it takes two refitted models to compute where they differ, and "
            "the places that are tied have not two that fit better than the base model."
        )
    told = [f"For {words(e.name)}: {e.separation}" for e in members[:2]]
    also = f"These recordings also lack: {'; '.join(lacks)}." if lacks else ""
    return " ".join(x for x in (start, *told, also) if x)


def write_waveform(proposal: NextExperiment | None, setup: Setup, unit: str, place: Place) -> None:
    """Time and input of the proposed recording, where there is one; ``unit`` is that of the recorded inputs."""
    if proposal is None:
        return
    port = setup.network.ports[0]
    table = pd.DataFrame({"time_s": proposal.experiment.t, f"{port.name}_{unit}": proposal.experiment.u})
    place.write(table.to_csv(index=False, float_format="%.9g").encode())


Array = NDArray[np.float64]


def noise_statements(diagnosis: Diagnosis) -> dict[str, NoiseStatement]:
    """Return the noise by recording, held-out ones included: it decides nothing. Recordings that could not be simulated
    have none."""
    outputs, setup = diagnosis.after.outputs, diagnosis.final.setup
    shown = [r for r in diagnosis.campaign.recordings if r.name in outputs]
    return statements(shown, outputs, setup, not remains(diagnosis))


def statements(
    recordings: Sequence[Recording], outputs: Mapping[str, Array], setup: Setup, complete: bool
) -> dict[str, NoiseStatement]:
    """The same from the outputs of a model.

    Args:
        complete: the model leaves nothing that matters.
    """
    plant, found = plant_gain(setup), {}
    for r in recordings:
        chosen = [r.mask(use) for use in ("identification", "confirmation")]
        mask = max(chosen, key=np.count_nonzero)
        residual = ((r.y - outputs[r.name]) / r.noise)[mask]
        speed = (np.gradient(outputs[r.name], r.dt) / r.noise)[mask]
        # The residual if it is not significant, else the part that does not repeat, where there is one.
        shown = residual if complete else difference(residual, r)
        sample = None
        if shown is not None:
            step = quantisation_step(r.y) / r.noise
            sample = Sample(shown, r.dt, speed[-shown.size :], step, plant, r.noise)
        found[r.name] = noise_statement(r.noise, r.noise_source, r.units.output, sample)
    return found


def plant_gain(setup: Setup) -> Callable[[Array], Array] | None:
    """Power gain from a force on the moving mass to the displacement, hysterons at rest.

        |G|² = 1/|k + α² Σ 1/C_i − m ω² + i ω b|²

    None where the model has no such parameters.
    """
    network, values = setup.network, values_by_role(setup.network)
    if not {"m", "k", "b"} <= set(values):
        return None
    alpha = values.get("alpha", 0.0)
    stiffness = values["k"] + alpha**2 * sum(1.0 / network.parameters[n].value for n in capacitances(network))

    def gain(f: Array) -> Array:
        omega = 2.0 * np.pi * f
        return np.asarray(1.0 / ((stiffness - values["m"] * omega**2) ** 2 + (omega * values["b"]) ** 2))

    return gain


SCHEMA = "phnn.diagnosis/1"
# What a diagnosis writes into its folder.
RESULTS = ("base", "model", "diagnosis.json", "figures", "report.html", WAVEFORM, PROGRESS)
# Least probability that is told; that of nothing missing always is.
_TOLD = 0.001
_PACKAGES = ("phnn", "torch", "numpy", "scipy", "numba")


def write(diagnosis: Diagnosis, out: Path | str, overwrite: bool = False) -> dict[str, Any]:
    """Write models, ``diagnosis.json`` and ``report.html`` into a folder; returns the document.

    Args:
        out: apart from the recordings; results of an earlier diagnosis in it are replaced.
        overwrite: also where they were changed since.

    Raises:
        InputRefused: the folder belongs to the recordings or to another run, holds files of others with the names of
            results, or cannot be written to.
    """
    with claim(Path(out), "diagnose", diagnosis.campaign.inputs, RESULTS, overwrite=overwrite) as place:
        return write_into(diagnosis, place)[0]


def write_into(
    diagnosis: Diagnosis, place: Place, made_of: Provenance | None = None
) -> tuple[dict[str, Any], Evidence]:
    """The same into a folder that is claimed already; returns the document, and what the report shows besides.

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
        following = partial(write_waveform, diagnosis.proposal, diagnosis.base.setup, inputs, place / WAVEFORM)
        needed("waveform of the next recording", following, None)
        shown = evidence(diagnosis, made_of)
        write_report(content, shown, place)
        if account.warnings:
            content |= _told(diagnosis, account.warnings)
            (place / "diagnosis.json").write_json(content)
    if account.interruption is not None:
        raise account.interruption
    return content, shown


def _told(diagnosis: Diagnosis, further: Sequence[Failure] = ()) -> dict[str, Any]:
    """How the search ended, and what failed."""
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
    """``diagnosis.json`` as a mapping; numbers that are not finite become null, and so do parts that fail."""
    campaign = diagnosis.campaign
    found = {r.name: r.noise_found for r in campaign.recordings}
    parts: dict[str, Callable[[], Any]] = {
        "test": lambda: _test(diagnosis),
        "probability": lambda: {n: round(p, 4) for n, p in diagnosis.probability.items() if p >= _TOLD or n == NONE},
        "missing": lambda: missing_entries(diagnosis),
        "remainder": lambda: _remainder(diagnosis),
        "location": lambda: _location(diagnosis),
        "noise": lambda: {n: s.document() | {"found": found[n]} for n, s in noise_statements(diagnosis).items()},
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
    whole: dict[str, Any] = finite(content | _told(diagnosis))
    return whole


def _test(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the score of the first element of the model in the residual of the base model, else the largest one; what
    is significant and immaterial has its size."""
    statistic, p_value, name = diagnosis.significance()
    screened = diagnosis.screened[0]
    first = next((c for c in screened if any(c.effect == claim.effect for claim in diagnosis.claims[:1])), None)
    if first is not None:
        statistic, p_value, name = first.score, chance(first.score, screened), first.effect.canonical
    small = immaterial(diagnosis)
    test = {"statistic": statistic, "p_value": p_value, "candidate": name or None}
    return test if small is None else test | {"immaterial": asdict(small)}


def _remainder(diagnosis: Diagnosis) -> dict[str, Any]:
    left, small, where = remains(diagnosis), immaterial(diagnosis, after=True), diagnosis.remaining
    remainder = {
        "verdict": UNKNOWN if left else NONE,
        "residual_over_noise": math.sqrt(diagnosis.final.chi2),
        "p_value": diagnosis.significance(after=True)[1],
        "location": where.name if left and where is not None else None,
    }
    return remainder if small is None else remainder | {"immaterial": asdict(small)}


def _location(diagnosis: Diagnosis) -> dict[str, Any] | None:
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
    }


def evidence(diagnosis: Diagnosis, made_of: Provenance | None = None) -> Evidence:
    """Traces, curves and tables of the report; a part that fails is empty.

    Args:
        made_of: how the run was started and what it read; hashed now if left out.
    """
    return Evidence(
        traces=needed("traces of the recordings", lambda: tuple(_traces(diagnosis)), ()),
        curves=needed("curves at the location", lambda: _curves(diagnosis), ()),
        parameters=needed("table of parameters", lambda: tuple(_parameters(diagnosis)), ()),
        models=needed("table of models", lambda: tuple(model_rows(diagnosis)), ()),
        candidates=needed("table of candidates", lambda: tuple(candidate_rows(diagnosis)), ()),
        ledger=needed("energy ledger", lambda: tuple(_ledger(diagnosis)), ()),
        notes=needed("notes", lambda: (*doubts_of_units(diagnosis.campaign), *diagnosis.campaign.notes), ()),
        verdict_sentence=needed("sentence of the verdict", lambda: sentence(diagnosis), ""),
        no_proposal=needed("reason why nothing is proposed", lambda: no_proposal(diagnosis), ""),
        supports=needed("support of the elements", lambda: supports(diagnosis), ()),
        rules=diagnosis.outcome.rules,
        methods=needed("methods", lambda: methods(diagnosis), None),
        provenance=made_of or needed("provenance", lambda: provenance(diagnosis.campaign), None),
    )


def _curves(diagnosis: Diagnosis) -> tuple[Picture, ...]:
    (base, final), located = diagnosis.linearised, diagnosis.location
    # A refit knows the place better than local functions did before it.
    located = located if located is not None and located.name in diagnosis.places else None
    curves = []
    for linearised, where in ((base, located), (final, diagnosis.remaining)):
        drawn = picture(linearised, where) if where is not None else None
        if where is not None and drawn is not None:
            free = is_effort(where) and not forces_known(diagnosis)
            title = drawn.title + ("" if linearised is base else " (what remains)")
            label = drawn.y_label + (", up to one common factor" if free else "")
            curves.append(replace(drawn, title=title, y_label=label))
    curves[1:1] = _learned_laws(diagnosis)
    return tuple(curves[:2] if diagnosis.claims else curves[:1])


def _learned_laws(diagnosis: Diagnosis) -> list[Picture]:
    """The laws of learned one-ports of the kind that the location shows, on the axis of its functions."""
    where, base, values = diagnosis.location, diagnosis.linearised[0], diagnosis.final.setup.values()
    if where is None or where.name != "mechanical":
        return []
    effects = [c.effect for c in diagnosis.claims if c.learned]
    there = [e for e in effects if (e.location, e.kind.name) == (where.name, where.detail)]
    alone = [e.add_to(base.fit.setup, {n: values[n] for n in e.parameters}) for e in there]
    return [learned_picture(base, where, setup) for setup in alone]


def _traces(diagnosis: Diagnosis) -> list[Trace]:
    found = []
    for r in diagnosis.campaign.recordings:
        for part in r.parts:
            if part.use == "nuisance" or r.name not in diagnosis.before.outputs:
                continue
            rows = slice(part.first, part.last)
            before, after = diagnosis.before.outputs[r.name][rows], diagnosis.after.outputs[r.name][rows]
            scored = np.ones(part.last - part.first, dtype=bool)
            held = part.use == "confirmation"
            found.append(Trace(part.name, r.t[rows], r.u[rows], r.y[rows], before, after, r.noise, held, scored))
    return found


def _parameters(diagnosis: Diagnosis) -> list[ParameterRow]:
    final = diagnosis.final
    before, after = diagnosis.base.setup.parameters, final.setup.parameters
    std = final.std()
    anchored = forces_known(diagnosis)
    rows = []
    hidden = auxiliary(final.setup.network)
    for name, p in ((n, p) for n, p in after.items() if n not in hidden):
        note = final.note(name) or ("constant" if p.fixed else "")
        if not note and not anchored and p.unit in FORCE_UNITS:
            note = "up to one common factor"
        note = note or (f"base model: {unknown}" if (unknown := diagnosis.base.note(name)) else "")
        old = before[name].value if name in before else None
        ends = final.interval(name)
        rows.append(ParameterRow(name, p.description, p.unit, old, p.value, finite(std.get(name)), note, ends))
    return rows


def _ledger(diagnosis: Diagnosis) -> list[LedgerRow]:
    base, where = diagnosis.linearised[0], diagnosis.location
    forces = [missing_force(base, where, i) if where is not None else None for i in range(len(base.trajectories))]
    return [energy_ledger(t, f) for t, f in zip(base.trajectories, forces, strict=True)]


def energy_ledger(trajectory: Trajectory, missing_force: NDArray[np.float64] | None = None) -> LedgerRow:
    """Return the energies [J] of a simulated recording, on stage values; up to one common factor without an anchor.

    They balance to rounding: supplied by the ports, stored at the end beyond the start, dissipated by each element. The
    unexplained work of the missing effort, ``Σ h |f v̄|``, is 0 where none was located.

    Args:
        missing_force: (n,) effort that a located mismatch asks for [N].
    """
    balance = power_balance(trajectory)
    names = [r.name for r in trajectory.setup.network.resistors]
    losses = balance.dissipated.detach().sum(dim=0).tolist()
    work = 0.0 if missing_force is None else np.sum(trajectory.h * np.abs(missing_force * trajectory.velocity))
    return LedgerRow(
        recording=trajectory.recording.name,
        supplied=float(balance.supplied.detach().sum()),
        stored=float(balance.stored.detach().sum()),
        dissipated=dict(zip(names, losses, strict=True)),
        unexplained=float(work),
    )
