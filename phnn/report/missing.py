"""The verdict in words, what was tried, and the entries of ``missing``, one for every element beyond the base.

The fingerprint of an effect is what a model leaves against the variable on which the effect acts. The variable follows
from the location and kind of the effect: that of the generic functions there (`phnn.diagnose.locations`), the time
after a step for slow relaxation, or the frequency where nothing else is its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import periodogram

from phnn.diagnose.diagnosis import Diagnosis
from phnn.diagnose.formula import Distilled
from phnn.diagnose.locations import GROUPS
from phnn.diagnose.number import Visited, family, is_learned
from phnn.diagnose.screen import Candidate, chance
from phnn.diagnose.search import material
from phnn.diagnose.verdict import LEARNED, NAMED, NONE, UNKNOWN, Claim
from phnn.diagnose.words import fitted_in_words, is_effort, vocabulary_of
from phnn.effects import Effect
from phnn.effects.kinds import AFTER_A_STEP, ELAPSED
from phnn.effects.mechanical import growth_per_decade
from phnn.effects.places import place_of, values_by_role
from phnn.identification.evaluate import Evaluation
from phnn.identification.fit import Fit
from phnn.parameters import quantity
from phnn.recordings.units import scales_with_forces
from phnn.report.document import Immaterial
from phnn.report.evidence import CandidateRow, Fingerprint, ModelRow
from phnn.report.formatting import display_unit, likelihood, listing, percent, plain, ratio, words
from phnn.report.verdicts import MOVING, NETWORK, forces_known
from phnn.trajectory import Trajectory

Array = NDArray[np.float64]

_BINS, _DECADES = 24, 18
# Fewest visits of a bin whose spread is to be believed; a change of the input over its range that is a step.
_VISITS, _STEP = 3, 0.2
_FREQUENCY = "frequency"


# (N,) a variable and the residuals before and after over a recording; samples without a variable have NaN.
_Samples = tuple[Array, Array, Array]


def fingerprint(diagnosis: Diagnosis, effect: Effect) -> Fingerprint | None:
    """What the base and the final model leave, over the identification recordings; None where too little is seen."""
    variable = variable_of(effect)
    if variable == _FREQUENCY:
        return _over_frequency(diagnosis)
    found = [_samples(diagnosis, t, variable) for t in diagnosis.linearised[1].trajectories]
    picture = _over_variable(found, variable, diagnosis)
    # Without a hold there is no time after a step: the memory shows over frequency.
    return _over_frequency(diagnosis) if picture is None else picture


def variable_of(effect: Effect) -> str:
    """Name of the variable on which an effect acts."""
    axes = {g.kind: g.axis.partition(" [")[0] for g in GROUPS if g.axis}
    found = axes.get(effect.kind) or effect.kind.axis or _FREQUENCY
    # What an amplifier delays is over within samples of a step.
    return _FREQUENCY if effect.location == "amplifier" and found == AFTER_A_STEP else found


def _samples(diagnosis: Diagnosis, trajectory: Trajectory, variable: str) -> _Samples:
    r = trajectory.recording
    mask = r.mask("identification")
    steps = np.minimum(trajectory.nodes[trajectory.lead :], trajectory.h.size - 1)
    sign = np.ones(r.t.size)
    if variable == AFTER_A_STEP:
        x, sign = since_a_step(r.t, r.u)
    else:
        lengths, speeds = (1e6, 1e3) if vocabulary_of(trajectory.setup.network).mechanical else (1.0, 1.0)
        x = {
            "displacement": lengths * trajectory.mid_displacement[steps],
            "velocity": speeds * trajectory.velocity[steps],
            "voltage": r.u,
            ELAPSED: r.t,
        }[variable]
    before, after = (sign * (r.y - e.outputs[r.name]) for e in (diagnosis.before, diagnosis.after))
    return x[mask], before[mask], after[mask]


def since_a_step(t: Array, u: Array) -> tuple[Array, Array]:
    """(N,) time since the input last jumped, NaN where it has not or has moved since; and the sign of that jump."""
    change = np.diff(u, prepend=u[:1])
    reach = float(np.ptp(u)) or 1.0
    jumps = np.abs(change) > _STEP * reach
    last = np.maximum.accumulate(np.where(jumps, np.arange(t.size), -1))
    held = (last >= 0) & (np.abs(u - u[np.maximum(last, 0)]) < 0.01 * reach) & ~jumps
    return np.where(held, t - t[np.maximum(last, 0)], np.nan), np.sign(change[np.maximum(last, 0)])


def _over_variable(samples: list[_Samples], variable: str, diagnosis: Diagnosis) -> Fingerprint | None:
    x, before, after = map(np.concatenate, zip(*samples, strict=True))
    logarithmic = variable == AFTER_A_STEP
    usable = np.isfinite(x) & ((x > 0.0) if logarithmic else True)
    if usable.sum() < _BINS or np.ptp(x[usable]) == 0.0:
        return None
    low, high = float(x[usable].min()), float(x[usable].max())
    edges = np.geomspace(low, high, _DECADES + 1) if logarithmic else np.linspace(low, high, _BINS + 1)
    # A visit ends with its recording: bins of one are numbered apart from those of the next.
    place = np.where(usable, np.clip(np.searchsorted(edges, x, side="right") - 1, 0, edges.size - 2), -1)
    owner = np.repeat(np.arange(len(samples)), [s.size for s, _, _ in samples])
    (b, b_std), (a, a_std) = (binned(y, place, owner, edges.size - 1, logarithmic) for y in (before, after))
    kept = np.isfinite(b) & np.isfinite(b_std)
    if kept.sum() < 3:
        return None
    units = diagnosis.campaign.recordings[0].units
    unit = display_unit(float(np.abs(b[kept]).max()), units.output)
    middles = np.sqrt(edges[1:] * edges[:-1]) if logarithmic else 0.5 * (edges[1:] + edges[:-1])
    own = vocabulary_of(diagnosis.base.setup.network)
    small = ("µm", "mm/s") if own.mechanical else (own.output_unit, own.rate_unit)
    labels = {
        "displacement": f"{own.output} ({small[0]})",
        "velocity": f"{own.rate} ({small[1]})",
        "voltage": f"{own.source} ({units.input})",
    }
    sizes = [v[kept] / unit.scale for v in (b, b_std, a, a_std)]
    shown = "residual, in the direction of the step" if logarithmic else "residual"
    return Fingerprint(
        middles[kept], sizes[0], sizes[1], sizes[2], sizes[3], labels.get(variable, f"{variable} (s)"),
        f"{shown} ({unit.name})", logarithmic, 0.0,
    )  # fmt: skip


def binned(y: Array, place: NDArray[np.intp], owner: NDArray[np.intp], bins: int, single: bool) -> tuple[Array, Array]:
    """(B,) means over bins, and their standard errors from the spread between visits: samples of one visit follow each
    other, and are no repetitions. NaN where a bin was visited too seldom.

    Args:
        place: (N,) bin of every sample, −1 for none; owner: (N,) its recording.
        single: bins are visited once a recording, so that samples have to stand for repetitions.
    """
    starts = np.flatnonzero(np.diff(place, prepend=-2) | np.diff(owner, prepend=-1))
    if single:
        starts = np.arange(place.size)
    sizes = np.diff(np.append(starts, place.size))
    sums, at = np.add.reduceat(y, starts), place[starts]
    sums, sizes, at = sums[at >= 0], sizes[at >= 0], at[at >= 0]
    count, total = np.bincount(at, sizes, bins), np.bincount(at, sums, bins)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = total / count
        visits = np.bincount(at, minlength=bins)
        # Of a ratio of sums: visits of all lengths.
        rest = np.bincount(at, (sums - mean[at] * sizes) ** 2, bins)
        std = np.sqrt(rest * visits / np.maximum(visits - 1, 1)) / count
    seldom = visits < _VISITS
    return np.where(seldom, np.nan, mean), np.where(seldom, np.nan, std)


def _over_frequency(diagnosis: Diagnosis) -> Fingerprint | None:
    """Amplitude of the residuals over that of white noise, in bands of a constant ratio."""
    rows: list[_Samples] = []
    for r in diagnosis.base.plan.recordings:
        mask = r.mask("identification")
        before, after = ((r.y - e.outputs[r.name])[mask] / r.noise for e in (diagnosis.before, diagnosis.after))
        f, p_before = periodogram(before, 1.0 / r.dt, detrend="constant")
        _, p_after = periodogram(after, 1.0 / r.dt, detrend="constant")
        # One-sided: white noise of unit variance has the density 2 Δt.
        rows.append((f[1:], p_before[1:] / (2.0 * r.dt), p_after[1:] / (2.0 * r.dt)))
    f, before, after = map(np.concatenate, zip(*rows, strict=True))
    if f.size < _BINS:
        return None
    edges = np.geomspace(float(f.min()), float(f.max()) * (1.0 + 1e-9), _BINS + 1)
    place = np.clip(np.searchsorted(edges, f, side="right") - 1, 0, _BINS - 1)
    alone = np.arange(f.size)
    (b, b_std), (a, a_std) = (binned(p, place, alone, _BINS, True) for p in (before, after))
    kept = np.isfinite(b)
    if kept.sum() < 3:
        return None
    b, b_std, a, a_std = (v[kept] for v in (b, b_std, a, a_std))
    # Of a root: half the relative error.
    sizes = (np.sqrt(b), 0.5 * b_std / np.sqrt(b), np.sqrt(a), 0.5 * a_std / np.sqrt(a))
    middles = np.sqrt(edges[1:] * edges[:-1])[kept]
    return Fingerprint(middles, *sizes, "frequency (Hz)", "amplitude of the residual over white noise", True, 1.0)


# Models that are listed.
_MODELS = 25


def model_rows(diagnosis: Diagnosis) -> list[ModelRow]:
    """Return the models that were fitted, the most probable first."""
    pairs = zip(diagnosis.visited.models, diagnosis.visited.shares, strict=True)
    return [
        ModelRow(
            m.words, m.left, m.left_held_out, m.nuisances + sum(map(m.parameters_of, m.elements)), float(share),
            m.converged,
            m.key == diagnosis.chosen.key,
        )
        for m, share in list(pairs)[:_MODELS]
    ]  # fmt: skip


def candidate_rows(diagnosis: Diagnosis) -> list[CandidateRow]:
    """Return the candidates in the residual of the base model, the largest predicted fall of χ² first."""
    ended, samples = diagnosis.ended, diagnosis.base.residual.size
    failed = {f.candidate: f"{f.error}: {f.message}" for f in (*ended.failed, *ended.warnings) if f.candidate}
    fitted = {e.name for m in diagnosis.visited.models for e in m.elements}
    chosen = {c.effect.name for c in diagnosis.claims}

    def outcome(c: Candidate) -> str:
        if c.effect.name in chosen:
            return "in the final model"
        if c.effect.name in fitted:
            return "fitted"
        if c.effect.name in failed:
            return f"no candidate: {failed[c.effect.name]}"
        if material(c, diagnosis.base, diagnosis.criteria):
            return "not fitted: others promised more"
        significant = c.score > diagnosis.criteria.score
        return "significant, but immaterial" if significant else "not significant"

    return [
        CandidateRow(c.effect.name, c.effect.location, c.score, c.fall / samples, outcome(c))
        for c in diagnosis.screened[0]
    ]


def remains(diagnosis: Diagnosis) -> bool:
    """Return whether some candidate explains a part that matters of what the final model leaves."""
    if diagnosis.verdict == NONE:
        return False
    return any(material(c, diagnosis.final, diagnosis.criteria) for c in diagnosis.screened[1])


def immaterial(diagnosis: Diagnosis, after: bool = False) -> Immaterial | None:
    """Return what is significant in the residual of a model that lacks nothing that matters; None where nothing is.

    Args:
        after: of the final model, else of a base model that stands.
    """
    if remains(diagnosis) if after else diagnosis.verdict != NONE:
        return None
    best = max(diagnosis.screened[after], key=lambda c: c.score, default=None)
    if best is None or not best.score > diagnosis.criteria.score:
        return None
    fit = diagnosis.final if after else diagnosis.base
    share = math.sqrt(max(best.fall / fit.residual.size, 0.0))
    noise = [r.noise for r in fit.plan.recordings]
    return Immaterial(best.effect.name, share * math.sqrt(sum(n**2 for n in noise) / len(noise)), share)


# Share of the excess that is worth a word about what is not the answer.
_NEAR = 0.5
# Recordings that are listed by name.
_NAMED = 3
# Probability below which a name is preceded by "perhaps".
_PROVEN = 0.95
# Why no name is proven, by the rule that gave the verdict.
_WHY = {
    "the_search_ended_early": "because the search ended early",
    "something_is_left": "because the model still leaves more than the noise",
    "an_element_is_learned": "because a learned element is part of the model",
    "held_out_recordings_deny_it": "because not every element improves the prediction of held-out recordings",
}
_NOT_NEW = "held_out_recordings_are_not_new"


def sentence(diagnosis: Diagnosis) -> str:
    """Return the verdict in a sentence or two."""
    word, claims = diagnosis.verdict, diagnosis.claims
    bare = [r.name for r in diagnosis.campaign.recordings if not r.noise_found]
    if word == NONE:
        small = immaterial(diagnosis)
        if small is not None:
            size = quantity(small.rms or 0.0, diagnosis.campaign.recordings[0].units.output)
            return (
                f"Nothing that matters is missing: {words(small.candidate) or 'something'} is statistically "
                f"significant, but explains only {size} ({plain(small.share_of_noise, 2)} × noise). "
                "The base model stands."
            )
        stands = f"leaves {ratio(diagnosis.base.chi2**0.5)} × noise."
        if bare:
            stands = f"fits by {percent(mean_fit(diagnosis.before, 'identification'), 2)} %. {floorless(bare)}"
        return f"These recordings show nothing that is missing: the base model {stands}"
    held = diagnosis.before.over_noise("confirmation"), diagnosis.after.over_noise("confirmation")
    change = f"On held-out recordings the residual goes from {ratio(held[0])} to {ratio(held[1])} × noise."
    if math.isnan(held[0]):
        change = "No recording was held out to confirm it."
    elif bare:
        fits = (mean_fit(e, "confirmation") for e in (diagnosis.before, diagnosis.after))
        change = (
            f"On held-out recordings the fit goes from {' to '.join(percent(f, 2) for f in fits)} %. {floorless(bare)}"
        )
    if word == UNKNOWN:
        return f"{unknown_statement(diagnosis)} {_nearest_in_words(diagnosis)}{change}"
    names = listing(map(_name, claims))
    start = f"The model leaves out {names}."
    if diagnosis.outcome.rules and diagnosis.outcome.rules[-1].rule == _NOT_NEW:
        why = "do not exist, so that nothing confirms it" if math.isnan(held[0]) else "bring nothing new to confirm it"
        verb = "explains" if len(claims) == 1 else "explain"
        start = f"{names[0].upper()}{names[1:]} {verb} the mismatch, but the held-out samples {why}."
    elif any(c.alike for c in claims):
        start = f"The model leaves out {names}; these recordings cannot tell which."
    return f"{start} {change}{' A significant remainder is left.' if remains(diagnosis) else ''}"


def sure(probability: float) -> str:
    """Return a probability in words."""
    return f"{likelihood(probability).replace('>', 'more than').replace('<', 'less than')} sure"


def _name(claim: Claim) -> str:
    """Return the name of an element, or those of its class, with how sure it is."""
    names = list(dict.fromkeys(words(n) for n in (claim.name, *(e.title for e in claim.alike))))
    if claim.alike:
        return listing(names, "or")
    perhaps = "" if claim.status == NAMED or claim.probability >= _PROVEN else "perhaps "
    return f"{perhaps}{names[0]} ({sure(claim.probability)})"


def mean_fit(scores: Evaluation, use: str) -> float | None:
    """Return the mean fit % over the parts of one use; None where it is defined for none."""
    fits = [p.fit_percent for p in scores.parts if p.use == use and math.isfinite(p.fit_percent)]
    return sum(fits) / len(fits) if fits else None


def floorless(names: Sequence[str]) -> str:
    """Say that recordings have no noise floor, in place of a ratio to the noise."""
    more = " and others" if len(names) > _NAMED else ""
    return (
        f"No noise floor was found in {listing(names[:_NAMED])}{more}, so that no residual is compared with the noise."
    )


def nearest(diagnosis: Diagnosis) -> Visited | None:
    """Return the model with one effect that leaves least, if it leaves less than the base model."""
    models = [m for m in diagnosis.visited.models if len(m.elements) == 1 and not is_learned(m.elements[0])]
    best = min(models, key=lambda m: m.fit.cost, default=None)
    return best if best is not None and best.fit.cost < diagnosis.base.cost else None


def _nearest_in_words(diagnosis: Diagnosis) -> str:
    """Name the effect that explains most, if the model has none and it explains more than half."""
    model, excess = nearest(diagnosis), diagnosis.base.beyond_noise
    if diagnosis.claims or model is None or not excess > 0.0:
        return ""
    share = (diagnosis.base.cost - model.fit.cost) / excess
    if share < _NEAR:
        return ""
    known = all(r.noise_found for r in diagnosis.base.plan.recordings)
    left = f" and would leave {ratio(model.left**0.5)} × noise" if known else ""
    explained = f"{100.0 * min(share, 1.0):.0f} % of the excess over the noise"
    return f"The nearest effect is {words(model.elements[0].name)}: it would explain {explained}{left}. "


def unknown_statement(diagnosis: Diagnosis) -> str:
    """State where something is missing, what the model describes it by, and why no name is proven."""
    claims, early = diagnosis.claims, diagnosis.ended.early
    if early and not claims and not diagnosis.significance()[1] < 1.0:
        return (
            "Whether something is missing is not known, because the base model was not tested. The model is still the "
            "base model."
        )
    proven = [c for c in claims if c.claimed]
    names = f"The model leaves out {listing(map(_name, proven))}. " if proven else ""
    if claims and len(proven) == len(claims):
        rest = "More may be missing, because the search ended early."
        return names + (rest if early else "What is left is more than the noise, and no element describes it.")
    real = f"{names}Something {'else ' if proven else ''}is missing{_place(diagnosis)}."
    if early and not claims:
        return f"{real} The search ended before it accepted an element. The model is still the base model."
    nothing = diagnosis.base.nothing_statement()
    if not claims and nothing:
        return f"{nothing}. No effect describes it either, so the model is still the base model."
    if not claims:
        return f"{real} No effect or learned element describes it, so the model is still the base model."
    rule = diagnosis.outcome.rules[-1].rule if diagnosis.outcome.rules else ""
    why = _WHY.get(rule, "because several explanations are about as probable")
    rest = listing(_element(diagnosis, c) for c in claims if not c.claimed)
    return f"{real} No name for it is proven, {why}. The model describes it by {rest}."


def _place(diagnosis: Diagnosis) -> str:
    """Return where the mismatch is; the name of a claimed element says it already."""
    if not diagnosis.places or any(c.claimed for c in diagnosis.claims):
        return ""
    first, kind = diagnosis.places[0], f" ({diagnosis.detail})" if diagnosis.detail else ""
    moves = vocabulary_of(diagnosis.base.setup.network).output_unit in MOVING
    place = f"a location {NETWORK}" if first == "mechanical" and not moves else f"the {first} location"
    return f" at {place}{kind}"


def _element(diagnosis: Diagnosis, claim: Claim) -> str:
    """Return an element of a model whose name is not claimed, in words."""
    if not claim.learned:
        return f"an element that acts like {words(claim.effect.name)} ({sure(claim.probability)})"
    formula = diagnosis.formulas.get(claim.effect.name)
    return f"a {words(claim.effect.name)}" + ("" if formula is None else f" ({formula.words.removesuffix('.')})")


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
    shown = {n: quantity(parameters[n].value, parameters[n].unit) for n in effect.parameters}
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
    free = not forces_known(diagnosis) and any(scales_with_forces(parameters[n].unit) for n in effect.parameters)
    statement = effect.statement.format(**shown) if formula is None else formula.words
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
        "parameters": _estimates(diagnosis.final, effect.strengths if claim.learned else effect.parameters),
    }


def _estimates(final: Fit, names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return value, standard error and 95 % interval of parameters, SI; null where they were not estimated."""
    parameters, std = final.setup.parameters, final.std()
    return {
        n: {"value": p.value, "unit": p.unit, "std": std.get(n), "interval_95": final.interval(n)}
        for n, p in ((n, parameters[n]) for n in names)
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
    where, model = diagnosis.location, nearest(diagnosis)
    fitted = "" if where is None else fitted_in_words(diagnosis.linearised[0], where)
    free = where is not None and is_effort(where) and not forces_known(diagnosis)
    factor = _UP_TO_FACTOR if free and vocabulary_of(diagnosis.base.setup.network).mechanical else ""
    return {
        "effect": "unknown",
        "status": "provisional",
        "nearest": None if model is None else family(model.elements[0]),
        "probability": None,
        "held_out": None,
        "share_explained": None,
        "location": where.name if where else "mechanical",
        "place": None,
        "equivalent_to": [],
        "p_value": diagnosis.significance()[1],
        "statement": f"{unknown_statement(diagnosis)} {fitted}".strip() + factor,
        "equation": "",
        "passive": False,
        "parameters": {},
    }
