"""What counts as right: grades of answers, and errors of estimates in their own intervals."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from studies.generator import Sealed
from studies.generator.world import TABLE
from studies.proof.cases import Task
from studies.proof.grade import (
    CLASS,
    EXACT,
    IN_CLASS,
    WRONG,
    Said,
    base_errors,
    effect_errors,
    grade,
    graded,
    group_error,
    noise_errors,
)

TASK = Task("full", "same", 0, 1, "demo")
CREEP = Sealed(
    effect="creep", parameters={"k_s": 400.0, "tau_s": 0.1}, base=dict(TABLE), strength_over_noise=4.0, noise=5e-8,
    quantisation=1e-8, seed=1, plan="demo", effects=("creep",), stratum="same", location=("mechanical",),
)  # fmt: skip
DRAWN = replace(CREEP, stated_mass=1.01 * TABLE["m"])
PAIR = replace(CREEP, effects=("creep", "delay"), stratum="pair", location=("mechanical", "amplifier"))
OUTSIDE = replace(CREEP, stratum="outside", withheld=("creep",))
NOTHING = replace(CREEP, effect="none", effects=(), parameters={}, stratum="none", location=())
BESIDE = replace(NOTHING, background_effects=("creep", "hysteresis_asymmetry"))
CREEP_BESIDE = replace(CREEP, background_effects=("hysteresis_asymmetry",))
FEWER, MORE = (replace(NOTHING, hysterons=h, stated_hysterons=s) for h, s in ((3, 2), (2, 3)))
WEN = {n: TABLE[n] for n in ("m", "k", "b", "alpha")} | {"c_bouc": 1e5, "z_bouc": 5e-5, "n_bouc": 1.5, "beta_bouc": 0.7}
OTHER = replace(NOTHING, base_family="bouc_wen", base=WEN)
OTHER_CREEP = replace(CREEP, base_family="bouc_wen", base=WEN)
OTHER_OUTSIDE = replace(OTHER_CREEP, stratum="outside", withheld=("creep",))


def said(
    verdict: str,
    *entries: tuple[str, ...],
    at: tuple[str, ...] = ("mechanical",),
    tied: tuple[str, ...] = (),
    held: tuple[float, float] = (2.0, 1.0),
) -> Said:
    """An answer; each entry is a name and those that are equivalent, ``at`` its location (the last for others)."""
    places = (*at, *[at[-1]] * len(entries))[: len(entries)]
    return Said(verdict, entries, places, at[0], tied, *held)


UNKNOWN = said("unknown", ("unknown",))
NAMELESS = ("unknown", "delay", "sensor_lag", "slew_limit", "base_motion")
HERE, LARGE = said("unknown", ("unknown",), at=("hysteron",)), said("equivalent", ("a", "b", "c", "d", "creep"))
ELSEWHERE = said("unknown", ("unknown",), at=("sensor",))


@pytest.mark.parametrize(
    ("sealed", "answer", "wanted"),
    [
        # One effect: by name, or in a class of at most four; an element without a name claims nothing beside names.
        (CREEP, said("named", ("creep",)), EXACT),
        (CREEP, said("equivalent", ("creep", "charge_leakage")), IN_CLASS),
        (CREEP, said("equivalent", ("charge_leakage", "creep")), IN_CLASS),
        (CREEP, LARGE, WRONG),
        (CREEP, said("named", ("charge_leakage",)), WRONG),
        (CREEP, said("named", ("creep",), ("delay",)), WRONG),
        (CREEP, UNKNOWN, WRONG),
        (CREEP, said("none"), WRONG),
        (CREEP, said("failed"), WRONG),
        (CREEP, said("named", ("creep",), NAMELESS), EXACT),
        (CREEP, said("equivalent", ("creep", "delay"), ("unknown",)), IN_CLASS),
        (CREEP, said("unknown", ("unknown", "creep")), WRONG),
        (CREEP, said("named", ("delay",), ("unknown", "creep")), WRONG),
        (PAIR, said("named", ("delay",), ("creep",)), EXACT),
        (PAIR, said("equivalent", ("amplifier_lowpass", "delay"), ("creep",)), IN_CLASS),
        (PAIR, said("named", ("delay",)), WRONG),
        (OUTSIDE, said("unknown", ("unknown",), at=("hysteron",), tied=("mechanical",)), EXACT),
        (OUTSIDE, ELSEWHERE, WRONG),
        (OUTSIDE, said("named", ("charge_leakage",)), WRONG),
        # Nothing but a background: it may be named, or unknown where the held-out error falls.
        (NOTHING, said("none"), EXACT),
        (NOTHING, UNKNOWN, WRONG),
        (NOTHING, said("named", ("creep",)), WRONG),
        (BESIDE, said("none"), EXACT),
        (BESIDE, said("named", ("creep",)), EXACT),
        (BESIDE, said("named", ("creep",), ("hysteresis_asymmetry",), at=("mechanical", "hysteron")), EXACT),
        (BESIDE, said("equivalent", ("charge_leakage", "creep"), at=("electrical",)), IN_CLASS),
        (BESIDE, LARGE, WRONG),
        (BESIDE, said("named", ("creep",), ("delay",)), WRONG),
        (BESIDE, said("named", ("delay",)), WRONG),
        (BESIDE, UNKNOWN, IN_CLASS),
        (BESIDE, said("unknown", ("unknown", "sensor"), held=(2.0, 1.99)), WRONG),
        (BESIDE, said("unknown", ("unknown",), held=(1.0, 1.2)), WRONG),
        (BESIDE, said("unknown", ("unknown",), held=(math.nan, math.nan)), WRONG),
        (BESIDE, said("failed"), WRONG),
        (CREEP_BESIDE, said("named", ("creep",), ("hysteresis_asymmetry",)), EXACT),
        (CREEP_BESIDE, said("named", ("hysteresis_asymmetry",)), WRONG),
        (CREEP_BESIDE, said("none"), WRONG),
        # A hysteron that the manifest leaves out is missing; one too many is not.
        (FEWER, said("named", ("extra_hysteron",)), EXACT),
        (FEWER, said("none"), WRONG),
        (MORE, said("none"), EXACT),
        (MORE, said("named", ("extra_hysteron",)), WRONG),
        # Another hysteresis: by place and held-out gain.
        (OTHER, HERE, EXACT),
        (OTHER, said("unknown", ("unknown",), at=("coupling",), tied=("hysteron",)), IN_CLASS),
        (OTHER, said("unknown", ("unknown",), at=("coupling",), tied=("hysteron", "sensor", "mechanical")), WRONG),
        (OTHER, UNKNOWN, WRONG),
        (OTHER, said("unknown", ("unknown",), at=("hysteron",), held=(2.0, 2.0)), WRONG),
        (OTHER, said("named", ("extra_hysteron",), at=("hysteron",)), EXACT),
        (OTHER, said("named", ("extra_hysteron",), ("hysteresis_asymmetry",), at=("hysteron", "hysteron")), EXACT),
        (OTHER, said("named", ("extra_hysteron",), ("creep",), at=("hysteron", "mechanical")), WRONG),
        (OTHER, said("named", ("creep",)), WRONG),
        (OTHER, said("none", held=(3.0, 3.0)), WRONG),
        (OTHER, said("none", held=(1.05, 1.05)), EXACT),
        (OTHER, said("failed"), WRONG),
        # Effects in another hysteresis: by name or place.
        (OTHER_CREEP, said("named", ("creep",)), EXACT),
        (OTHER_CREEP, said("named", ("creep",), ("extra_hysteron",), at=("mechanical", "hysteron")), EXACT),
        (OTHER_CREEP, said("equivalent", ("charge_leakage", "creep"), at=("electrical",)), IN_CLASS),
        (OTHER_CREEP, UNKNOWN, IN_CLASS),
        (OTHER_CREEP, HERE, IN_CLASS),
        (OTHER_CREEP, ELSEWHERE, WRONG),
        (OTHER_CREEP, said("named", ("extra_hysteron",), at=("hysteron",)), WRONG),
        (OTHER_CREEP, said("named", ("creep",), ("delay",), at=("mechanical", "amplifier")), WRONG),
        (OTHER_CREEP, said("none"), WRONG),
        (OTHER_OUTSIDE, HERE, EXACT),
    ],
)
def test_grades(sealed: Sealed, answer: Said, wanted: str) -> None:
    assert grade(sealed, answer) == wanted
    assert CLASS == 4


def entry(name: str, *others: str, **parameters: tuple[float, float | None]) -> dict[str, Any]:
    values = {n: {"value": v, "std": s} for n, (v, s) in parameters.items()}
    return {"effect": name, "location": "mechanical", "equivalent_to": list(others), "parameters": values}


def test_a_document_is_graded_with_its_scores_and_a_reason() -> None:
    document = {
        "verdict": "named",
        "missing": [entry("creep", tau_s=(0.12, 0.01))],
        "location": {"name": "mechanical", "tied": [], "dictionary": ["sensor"]},
        "test": {"statistic": 30.0, "p_value": 1e-5},
        "fit": {
            "before": {"a": {"residual_over_noise": 4.0}, "b": {"residual_over_noise": 3.0}},
            "after": {"a": {"residual_over_noise": 1.0}, "b": {"residual_over_noise": 1.1}},
            "held_out": ["b"],
        },
        "models": {"base": TABLE | {"d_2": 1.02 * TABLE["d_2"]}, "model": dict(TABLE)},
        "estimates": estimates(1.02),
        "seconds": 10.0,
    }
    outcome = graded(TASK, DRAWN, document)
    assert (outcome.base, outcome.held_before, outcome.held_after) == (4.0, 3.0, 1.1)
    assert (outcome.grade, outcome.reason, outcome.located, outcome.dictionary) == (EXACT, "", "alone", "sensor")
    assert (outcome.worst_before, outcome.worst_after) == (pytest.approx(0.02), 0.0)
    assert (len(outcome.base_errors), outcome.effect_errors) == (9, pytest.approx((2.0,)))
    assert outcome.row()["effect_errors"] == "2"
    # The score stage cannot tell members of a class apart.
    fast = replace(TASK, tier="fast")
    assert graded(fast, CREEP, {"verdict": "named", "missing": [entry("creep", "delay")]}).grade == IN_CLASS
    reasons = {
        "the diagnosis failed": {"failure": "it broke"},
        "not noticed": {"verdict": "none"},
        "noticed and located, not named": {"verdict": "unknown", "missing": [entry("unknown")]},
        "delay named besides": {"verdict": "named", "missing": [entry("creep"), entry("delay")]},
        "delay named instead of creep": {"verdict": "named", "missing": [entry("delay")]},
    }
    assert {graded(TASK, CREEP, answer).reason: answer for answer in reasons.values()} == reasons


def test_groups_of_parameters_ignore_the_common_factor_and_the_order_of_hysterons() -> None:
    scaled = {n: v * (1.0 if n.startswith("d") else 3.0) for n, v in TABLE.items()}
    assert group_error(scaled, TABLE) < 1e-12
    swapped = {n.translate(str.maketrans("12", "21")): v for n, v in TABLE.items()}
    assert group_error(swapped, TABLE) < 1e-12
    assert group_error(TABLE | {"d_2": 1.02 * TABLE["d_2"]}, TABLE) == pytest.approx(0.02)
    assert np.isnan(group_error({}, TABLE))
    one = {n: v for n, v in TABLE.items() if not n.endswith("_2")}
    assert group_error(one, one) < 1e-12
    # Of other hysterons only mass, stiffness and damping are left.
    assert group_error(TABLE | {"d_2": 1.0, "k": 1.1 * TABLE["k"]}, one) == pytest.approx(0.1)
    assert group_error(TABLE, WEN) < 1e-12


def estimates(factor: float = 1.0, part: float = 0.01) -> dict[str, dict[str, Any]]:
    return {n: {"value": factor * v, "std": part * v} for n, v in TABLE.items()}


def test_base_parameters_are_compared_hysteron_by_hysteron() -> None:
    found = base_errors(estimates(1.02), DRAWN)
    # Not the mass, which is the anchor itself.
    assert found == pytest.approx(dict.fromkeys(set(TABLE) - {"m"}, 2.0))
    swapped = {n.translate(str.maketrans("12", "21")): v for n, v in estimates(1.02).items()}
    assert sorted(base_errors(swapped, DRAWN).values()) == pytest.approx([2.0] * 9)
    unknown = estimates() | {"rho_1": {"value": 1.0, "std": None}, "b": {"value": 1.0, "std": float("inf")}}
    assert set(base_errors(unknown, DRAWN)) == set(TABLE) - {"m", "rho_1", "b"}
    assert base_errors({}, DRAWN) == {}
    fewer = {n: v for n, v in estimates().items() if not n.endswith("_2")}
    assert base_errors(fewer, DRAWN) == {}


def test_the_stated_interval_is_what_is_graded() -> None:
    wide = {n: e | {"interval_95": (0.5 * e["value"], 3.0 * e["value"])} for n, e in estimates(2.0).items()}
    # The truth is the lower end, whatever the standard error says.
    assert base_errors(wide, DRAWN) == pytest.approx(dict.fromkeys(set(TABLE) - {"m"}, 1.96), abs=1e-3)
    low = {n: e | {"interval_95": (0.25 * e["value"], 4.0 * e["value"])} for n, e in estimates(0.5).items()}
    assert base_errors(low, DRAWN) == pytest.approx(dict.fromkeys(set(TABLE) - {"m"}, -1.96 / 3.0), abs=1e-3)


def test_errors_by_noise_alone_leave_out_that_of_the_mass() -> None:
    # All that scales with the mass is wrong by its error, and by nothing else.
    right = {
        n: {"value": v, "std": 0.01 * v, "interval_95_anchors_exact": (0.99 * v, 1.01 * v)}
        for n, v in TABLE.items()
        for v in [v if n[0] == "d" else 1.01 * v]
    }
    said = [entry("creep", k_s=(1.01 * 404.0, 4.0), tau_s=(0.1, 0.01))]
    right |= {
        "k_s": {"value": 1.01 * 404.0, "std": 4.0, "interval_95_anchors_exact": (400.0, 416.0)},
        "tau_s": {"value": 0.1, "std": 0.01, "interval_95_anchors_exact": (0.08, 0.12)},
    }
    base, effect = noise_errors(right, said, DRAWN)
    assert base == pytest.approx(dict.fromkeys(set(TABLE) - {"m"}, 0.0), abs=1e-6)
    assert effect == pytest.approx({"k_s": 1.96 * 4.04 / 8.04, "tau_s": 0.0}, abs=1e-3)
    assert noise_errors(estimates(), said, DRAWN) == ({}, {})
    # An exact mass says nothing of its own interval, but all of the noise.
    exact, _ = noise_errors(right, said, replace(DRAWN, stated_mass=0.0))
    assert len(exact) == 9


def test_what_scales_with_an_exact_mass_is_left_out() -> None:
    exact = replace(DRAWN, stated_mass=0.0)
    assert set(base_errors(estimates(), exact)) == {"d_1", "d_2"}
    said = [entry("creep", k_s=(440.0, 20.0), tau_s=(0.12, 0.01))]
    assert effect_errors(said, exact) == pytest.approx({"tau_s": 2.0})
    assert effect_errors(said, DRAWN) == pytest.approx({"k_s": 2.0, "tau_s": 2.0})


def test_effects_are_compared_at_one_reference_displacement() -> None:
    cubic = replace(DRAWN, effects=("cubic_stiffness",), parameters={"kappa_3": 0.1, "q_0": 1e-4})
    # κ₃ (q/q₀)² with twice the reference: four times the strength.
    said = [entry("cubic_stiffness", kappa_3=(0.42, 0.01), q_0=(2e-4, None))]
    assert effect_errors(said, cubic) == pytest.approx({"kappa_3": 2.0})
    hysteron = replace(DRAWN, effects=("extra_hysteron",), parameters={"C_3": 1e-5, "rho_3": 0.1, "d_3": 3.0})
    assert effect_errors([entry("extra_hysteron", C_x=(1.1e-5, 1e-6))], hysteron) == pytest.approx({"C_x": 1.0})
