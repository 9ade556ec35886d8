"""Diagnose sealed cases and keep a row for each in a log, from which every study is told.

A row is a line of json: what was concealed, what the diagnosis says, and for each model that it visited its elements,
their free parameters, and the weighted sum of squares and the number of samples of every recording, fitted and held
out. How the models would be weighed can then be compared without a further fit. A case that the log holds is not
diagnosed again.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from scipy.stats import norm

from phnn.criteria import Criteria
from phnn.diagnose.diagnosis import Diagnosis, available, diagnose
from phnn.diagnose.linearised import TIE, prepare
from phnn.diagnose.number import Visited, family, is_learned, uid
from phnn.diagnose.screen import Screen, chance
from phnn.diagnose.verdict import EQUIVALENT, NAMED, NONE
from phnn.errors import PhnnError
from phnn.identification.base import with_bounded_error
from phnn.identification.plan import Options
from phnn.identification.prepare import identification_plan
from phnn.identification.staged import fit_identified, held_by_statement
from phnn.models.actuator import from_paper
from phnn.parallel import executor
from phnn.recordings import Campaign, read
from phnn.setup import Setup
from studies.generator import Case, Conditions, Sealed, draw_case, make_case
from studies.generator.cases import CANONICAL, PLAIN
from studies.results import commit

Row = dict[str, Any]
Say = Callable[[str], None]
# Least probability that is logged.
_LEAST = 1e-4
_EVALUATIONS = 30  # of the fit that is scored only


@dataclass(frozen=True)
class Task:
    """One case to diagnose.

    Attributes:
        group: which cases of a study it belongs to; seed: of the case, one of its own in the group.
        stratum, plan, levels, deltas, noise, conditions: see `draw_case`; noise is empty for that of the seed.
        family: of a case with nothing concealed, its noise or input; empty elsewhere.
        fast: it ends with the score of the base model.
    """

    group: str
    seed: int
    stratum: str
    plan: str = "full"
    levels: tuple[float, float] = (1.5, 10.0)
    deltas: tuple[float, float] | None = None
    noise: str = ""
    conditions: Conditions = PLAIN
    family: str = ""
    fast: bool = False

    def case(self) -> Case:
        """Return what is concealed; everything follows from the seed."""
        return draw_case(
            self.seed, self.stratum, self.plan, self.levels, self.deltas, self.noise or None, self.conditions
        )


def rows_of(log: Path) -> list[Row]:
    """Return the rows of a log; a last line that was not written to its end is left out."""
    lines = log.read_text(encoding="utf-8").split("\n")[:-1] if log.exists() else []
    return [json.loads(line) for line in lines]


def run(tasks: Sequence[Task], log: Path, options: Options, where: str, say: Say) -> list[Row]:
    """Diagnose the cases that a log does not hold, and return the rows of all, in order.

    Args:
        log: gets a line for each case as it ends; options: of every diagnosis.
        where: see `phnn.parallel.executor`; say: called with a line of progress.
    """
    known = {(row["group"], row["seed"]): row for row in rows_of(log)}
    todo = [t for t in tasks if (t.group, t.seed) not in known]
    if log.exists():
        content = log.read_bytes()
        with log.open("r+b") as file:
            file.truncate(content.rfind(b"\n") + 1)
    for count, (_, row) in enumerate(executor(where).each(partial(diagnosed, options), todo), start=1):
        known[row["group"], row["seed"]] = row
        with log.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        said = row.get("verdict", row.get("failure"))
        names = "+".join(c["effect"] for c in row.get("claims", ()))
        truth = "+".join(row.get("effects", ())) or "nothing"
        say(f"diagnosed {count} of {len(todo)}: {row['group']} {row['seed']}: {truth} -> {said} {names}".rstrip())
    return [known[t.group, t.seed] for t in tasks]


def diagnosed(options: Options, task: Task) -> Row:
    """Make a case, diagnose it without a look at what was concealed, and return its row.

    The catalogue lacks what the case withholds, and what contains that: it says the same.
    """
    row: Row = {"group": task.group, "seed": task.seed, "plan": task.plan, "family": task.family, "fast": task.fast}
    try:
        with TemporaryDirectory() as folder:
            sealed = make_case(task.case(), Path(folder))
            row |= truth_of(sealed) | {"commit": commit()}
            campaign, began = read(Path(folder)), time.process_time()
            if task.fast:
                return row | scored(campaign, options.seed) | {"seconds": time.process_time() - began}
            found = diagnose(campaign, replace(options, without=containing(sealed.withheld)))
            return row | logged(found, time.process_time() - began) | _errors(found, sealed)
    except PhnnError as error:
        return row | {"failure": str(error)}


def containing(names: Sequence[str]) -> tuple[str, ...]:
    """Return effects, and with creep the hysteron that is one without its dead zone."""
    return (*names, "extra_hysteron") if "creep" in names else tuple(names)


def truth_of(sealed: Sealed) -> Row:
    """Return what the base model lacks: what was concealed, and a hysteron where the manifest states too few."""
    lacks = sealed.hysterons > sealed.stated_hysterons and not sealed.base_family
    return {
        "effects": list(dict.fromkeys((*sealed.effects, *(["extra_hysteron"] if lacks else [])))),
        "withheld": list(sealed.withheld), "form": sealed.form, "locations": list(sealed.location),
        "level": sealed.strength_over_noise, "stratum": sealed.stratum, "delta": sealed.delta,
        "background": list(sealed.background_effects), "base_family": sealed.base_family,
    }  # fmt: skip


def logged(found: Diagnosis, seconds: float) -> Row:
    """Return what a diagnosis says and all models that it visited."""
    score, p_value, _ = found.significance()
    return {
        "verdict": found.verdict,
        "probability": {n: p for n, p in found.probability.items() if p > _LEAST},
        "claims": [
            {
                "effect": c.name, "status": c.status, "probability": c.probability, "location": c.effect.location,
                "alike": [e.canonical for e in c.alike],
            }
            for c in found.claims
        ],
        "places": list(found.places),
        "located": [] if found.location is None else [found.location.name, *found.location.tied],
        "rule": found.outcome.rules[-1].rule,
        "facts": {n: v for r in found.outcome.rules for n, v in r.numbers.items()},
        "score": score, "p_value": p_value, "base": found.before.over_noise("identification"),
        "held_out": [found.before.over_noise("confirmation"), found.after.over_noise("confirmation")],
        "seconds": seconds, "evaluations": found.ended.evaluations, "ended": found.ended.why,
        "models": [_model(m) for m in found.visited.models],
    }  # fmt: skip


def _model(model: Visited) -> Row:
    return {
        "elements": [
            {
                "name": family(e), "form": uid(e), "learned": is_learned(e), "location": e.location,
                "parameters": model.parameters_of(e),
            }
            for e in model.elements
        ],
        "nuisances": model.nuisances,
        "converged": model.converged,
        "fitted": {n: list(m) for n, m in model.fitted.items()},
        "held_out": {n: list(m) for n, m in model.held_out.items()},
    }  # fmt: skip


def _errors(found: Diagnosis, sealed: Sealed) -> Row:
    """Return the errors of all parameters that can be compared with what was sealed."""
    final, names = found.final, [c.name for c in found.claims if c.claimed]
    # What was not estimated belongs to the comparison too: reference displacements of effects.
    estimates: dict[str, Row] = {n: {"value": v} for n, v in final.setup.values().items()}
    for n in final.std():
        estimates[n] |= {"interval": final.interval(n), "exact": final.interval(n, anchored=False)}
    return {"errors": all_errors(estimates, names, sealed)}


def scored(campaign: Campaign, seed: int) -> Row:
    """Fit the base model from the published values and score all candidates; return as much of a row as that gives."""
    options, criteria = Options(seed=seed, workers=1), Criteria()
    network = from_paper().with_values({n: a.value for n, a in campaign.known.items()})
    held = held_by_statement(campaign.known)
    first = fit_identified(Setup(network), identification_plan(campaign, 1), held, max_evaluations=_EVALUATIONS)
    base, _ = with_bounded_error(first, options.error_bound_sigma)
    linearised = prepare(base)
    candidates = Screen(linearised, available(campaign, base.setup), criteria)(linearised)
    best = max(candidates, key=lambda c: c.score)
    members = [c.effect for c in candidates if candidates[0].fall - c.fall < TIE and c.fall > 0.0]
    missing = members if best.score > criteria.score else []
    word = NONE if not missing else NAMED if len(missing) == 1 else EQUIVALENT
    claims = [
        {"effect": e.canonical, "status": word, "alike": [o.canonical for o in missing[1:]], "location": e.location}
        for e in missing[:1]
    ]
    return {
        "verdict": word, "claims": claims, "places": [e.location for e in missing[:1]], "score": best.score,
        "p_value": chance(best.score, candidates), "base": base.chi2**0.5,
    }  # fmt: skip


_DEVIATE = float(norm.ppf(0.975))  # of the ends of the intervals that are stated
_REFERENCE = 100e-6  # m, displacement that strengths of a seal refer to

# The parameters of the catalogue that are compared, by effect. What the recordings know in products only, as of
# self-heating, is not.
_COMPARED = {
    "creep": ("k_s", "tau_s"), "extra_hysteron": ("C_x", "rho_x", "d_x"), "cubic_stiffness": ("kappa_3",),
    "coulomb_friction": ("F_c",), "quadratic_drag": ("c_2",), "hysteresis_asymmetry": ("kappa_d",),
    "electrostriction": ("epsilon",), "amplifier_lowpass": ("tau_a",), "amplifier_saturation": ("V_max",),
    "sensor_drift": ("drift_rate",), "contact_stop": ("k_c", "g_c"), "quadratic_stiffness": ("kappa_2",),
    "charge_leakage": ("G",), "rate_dependent_threshold": ("kappa_v",), "displacement_coupling": ("kappa_a",),
    "depolarisation": ("delta_z", "tau_z", "V_c"), "second_mode": ("m_2", "k_2", "b_2"), "delay": ("tau_d",),
    "slew_limit": ("S",), "sensor_lag": ("tau_y",), "sensor_nonlinearity": ("a_2", "a_3"),
    "output_backlash": ("delta_b",), "mains_pickup": ("f_m",), "base_motion": ("f_b",),
}  # fmt: skip
# Their names in a seal, where these are others.
_IN_SEAL = {"C_x": "C_3", "rho_x": "rho_3", "d_x": "d_3", "tau_a": "tau_V", "drift_rate": "rate", "g_c": "q_c"}
# The parameter that holds the reference displacement, and its power.
_REFERRED = {"kappa_3": ("q_0", 2), "kappa_d": ("q_d", 1), "kappa_2": ("q_2", 1), "kappa_a": ("q_a", 1)}
# Impedances, admittances and forces per volt: they scale with the common factor.
_SCALED = {"k", "b", "alpha", "k_s", "F_c", "c_2", "k_c", "m_2", "k_2", "b_2", "G", "C_x", "rho_x"}

# By name: value, and as far as known the 95 % interval, and exact: the interval that takes anchors as exact.
Estimates = Mapping[str, Mapping[str, Any]]


def all_errors(estimates: Estimates, named: Iterable[str], sealed: Sealed) -> dict[str, dict[str, float]]:
    """Return the errors of base and effect parameters as normal deviates, by name; of both also by the noise alone.

    Args:
        estimates: of the final model; named: the effects whose names are given.
    """
    pairs = {"base": _base_pairs(estimates, sealed), "effect": _effect_pairs(estimates, named, sealed)}
    factor = sealed.stated_mass / sealed.base["m"] if sealed.stated_mass > 0.0 else 1.0
    errors: dict[str, dict[str, float]] = {}
    for kind, own in pairs.items():
        stated = {n: t for n, t in own.items() if sealed.stated_mass > 0.0 or not _scaled(n)}
        errors[kind] = _deviates(estimates, "interval", stated)
        exact = {n: t * factor if _scaled(n) else t for n, t in own.items()}
        errors[f"{kind}_by_noise"] = _deviates(estimates, "exact", exact)
    return errors


def _deviates(estimates: Estimates, kind: str, truth: Mapping[str, float]) -> dict[str, float]:
    """Return errors over the part of an interval on the side of the truth, times 1.96, where there is one."""
    errors = {}
    for name, true in truth.items():
        if (ends := estimates[name].get(kind)) is not None:
            value = float(estimates[name]["value"])
            errors[name] = _DEVIATE * (value - true) / abs(value - float(ends[0 if true < value else 1]))
    return errors


def _base_pairs(estimates: Estimates, sealed: Sealed) -> dict[str, float]:
    """Return the truth by the name of the estimate; hysterons have no order, they are compared in that of their dead
    zones, and nothing is compared where their numbers differ."""
    own = _in_order({n: float(e["value"]) for n, e in estimates.items()})
    true = _in_order(sealed.base)
    if len(own) != len(true):
        return {}
    names = {n: n for n in ("k", "b", "alpha")}
    names |= {f"{n}_{i}": f"{n}_{j}" for i, j in zip(own, true, strict=True) for n in ("C", "rho", "d")}
    return {n: sealed.base[of] for n, of in names.items() if n in estimates}


def _in_order(table: Mapping[str, float]) -> list[str]:
    """Return the numbers of the hysterons among the names of parameters, in the order of their dead zones."""
    return sorted(sorted(n[2:] for n in table if n.startswith("d_") and n[2:].isdigit()), key=lambda i: table[f"d_{i}"])


def _effect_pairs(estimates: Estimates, named: Iterable[str], sealed: Sealed) -> dict[str, float]:
    """Return the same of each rightly named effect whose law has the form of the catalogue.

    Nothing where the actuator has another hysteresis: no model is right then, no interval has to hold.
    """
    canonical = sealed.form == CANONICAL
    truth = {**sealed.background, **(sealed.parameters if canonical else {})}
    concealed = (*(sealed.effects if canonical else ()), *sealed.background_effects)
    pairs = {}
    for effect in named if not sealed.base_family else ():
        for name in _COMPARED.get(effect, ()) if effect in concealed else ():
            of, (reference, power) = _IN_SEAL.get(name, name), _REFERRED.get(name, ("", 0))
            if of in truth and name in estimates:
                scale = (float(estimates[reference]["value"]) / _REFERENCE) ** power if power else 1.0
                pairs[name] = truth[of] * scale
    return pairs


def _scaled(name: str) -> bool:
    """Tell whether the common factor moves a parameter; hysterons are numbered."""
    kind, _, number = name.partition("_")
    return name in _SCALED or (kind in ("C", "rho") and number.isdigit())
