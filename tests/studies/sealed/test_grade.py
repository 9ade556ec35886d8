"""What counts as right, errors of estimates in their own intervals, and the figures of docs/proof.md."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phnn.criteria import Criteria
from phnn.results import Place
from studies.generator import Sealed
from studies.generator.world import TABLE
from studies.proof.cases import Settings
from studies.proof.page import detection, half_point, nulls, rates, write_proof
from studies.sealed.grade import Case, share_interval
from studies.sealed.run import all_errors, truth_of

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
BOUC_WEN = replace(NOTHING, effects=("extra_hysteron",), form="bouc_wen_hysteron")
OTHER = replace(NOTHING, base_family="bouc_wen", base=WEN)
OTHER_CREEP = replace(CREEP, base_family="bouc_wen", base=WEN)
OTHER_OUTSIDE = replace(OTHER_CREEP, stratum="outside", withheld=("creep",))


def said(
    verdict: str,
    *entries: tuple[str, ...],
    at: tuple[str, ...] = ("mechanical",),
    tied: tuple[str, ...] = (),
    held: tuple[float, float] = (2.0, 1.0),
) -> dict[str, Any]:
    """What a row says; each entry is a name and its equivalents, ``at`` its location (the last for others)."""
    places = (*at, *[at[-1]] * len(entries))[: len(entries)]
    claims = [
        {
            "effect": name, "alike": list(alike), "location": where,
            "status": "learned" if name == "learned_spring" else "equivalent" if alike else verdict,
        }
        for (name, *alike), where in zip(entries, places, strict=True)
    ]  # fmt: skip
    return {"verdict": verdict, "claims": claims, "places": [at[0], *tied], "held_out": list(held)}


def case(sealed: Sealed, answer: dict[str, Any], **changes: Any) -> Case:
    """A row of the log."""
    return Case({"group": sealed.stratum, "seed": 1, "family": "", **truth_of(sealed), **answer, **changes})


UNKNOWN = said("unknown", ("learned_spring",))
HERE, LARGE = said("unknown", at=("hysteron",)), said("equivalent", ("a", "b", "c", "d", "creep"))
ELSEWHERE = said("unknown", at=("sensor",))
FAILED = {"failure": "it broke"}


@pytest.mark.parametrize(
    ("sealed", "answer", "outcome", "grade"),
    [
        # One effect: by name, or in a class of at most four; an element without a name claims nothing beside names.
        (CREEP, said("named", ("creep",)), "right", "exact"),
        (CREEP, said("equivalent", ("creep", "charge_leakage")), "right", "class"),
        (CREEP, LARGE, "wrong", "wrong"),
        (CREEP, said("named", ("charge_leakage",)), "wrong", "wrong"),
        (CREEP, said("named", ("creep",), ("delay",)), "wrong", "wrong"),
        (CREEP, UNKNOWN, "open", "wrong"),
        (CREEP, said("none"), "missed", "wrong"),
        (CREEP, FAILED, "open", "wrong"),
        (CREEP, said("named", ("creep",), ("learned_spring",)), "right", "exact"),
        (PAIR, said("named", ("delay",), ("creep",)), "right", "exact"),
        (PAIR, said("named", ("delay",)), "partly", "wrong"),
        (OUTSIDE, ELSEWHERE, "right", "exact"),
        (OUTSIDE, said("named", ("charge_leakage",)), "wrong", "wrong"),
        # Nothing but a background: it may be named, or unknown where the held-out error falls.
        (NOTHING, said("none"), "right", "exact"),
        (NOTHING, UNKNOWN, "open", "wrong"),
        (NOTHING, said("named", ("creep",)), "wrong", "wrong"),
        (BESIDE, said("none"), "right", "exact"),
        (BESIDE, said("named", ("creep",)), "right", "exact"),
        (BESIDE, said("named", ("creep",), ("hysteresis_asymmetry",), at=("mechanical", "hysteron")), "right", "exact"),
        (BESIDE, said("equivalent", ("charge_leakage", "creep"), at=("electrical",)), "right", "class"),
        (BESIDE, LARGE, "wrong", "wrong"),
        (BESIDE, said("named", ("creep",), ("delay",)), "wrong", "wrong"),
        (BESIDE, UNKNOWN, "right", "class"),
        (BESIDE, said("unknown", held=(2.0, 1.99)), "open", "wrong"),
        (BESIDE, said("unknown", held=(math.nan, math.nan)), "open", "wrong"),
        (CREEP_BESIDE, said("named", ("creep",), ("hysteresis_asymmetry",)), "right", "exact"),
        (CREEP_BESIDE, said("named", ("hysteresis_asymmetry",)), "partly", "wrong"),
        (CREEP_BESIDE, said("equivalent", ("hysteresis_asymmetry", "creep")), "right", "class"),
        # A hysteron that the manifest leaves out is missing; one too many is not.
        (FEWER, said("named", ("extra_hysteron",)), "right", "exact"),
        (FEWER, said("none"), "missed", "wrong"),
        (MORE, said("none"), "right", "exact"),
        (MORE, said("named", ("extra_hysteron",)), "wrong", "wrong"),
        # A further hysteron of Bouc and Wen has two names.
        (BOUC_WEN, said("named", ("bouc_wen_hysteresis",)), "right", "exact"),
        (BOUC_WEN, said("named", ("extra_hysteron",)), "right", "exact"),
        (NOTHING, said("named", ("bouc_wen_hysteresis",)), "wrong", "wrong"),
        # Another hysteresis: by place and held-out gain.
        (OTHER, HERE, "right", "exact"),
        (OTHER, said("unknown", at=("coupling",), tied=("hysteron",)), "right", "class"),
        (OTHER, said("unknown", at=("coupling",), tied=("hysteron", "sensor", "mechanical")), "open", "wrong"),
        (OTHER, UNKNOWN, "open", "wrong"),
        (OTHER, said("unknown", at=("hysteron",), held=(2.0, 2.0)), "open", "wrong"),
        (OTHER, said("named", ("extra_hysteron",), at=("hysteron",)), "right", "exact"),
        (OTHER, said("named", ("extra_hysteron",), at=("hysteron",), held=(2.0, 2.0)), "wrong", "wrong"),
        (OTHER, said("named", ("extra_hysteron",), ("creep",), at=("hysteron", "mechanical")), "wrong", "wrong"),
        (OTHER, said("named", ("creep",)), "wrong", "wrong"),
        (OTHER, said("none", held=(3.0, 3.0)), "missed", "wrong"),
        (OTHER, said("none", held=(1.05, 1.05)), "right", "exact"),
        # Effects in another hysteresis: by name alone.
        (OTHER_CREEP, said("named", ("creep",)), "right", "exact"),
        (OTHER_CREEP, said("named", ("creep",), ("extra_hysteron",), at=("mechanical", "hysteron")), "right", "exact"),
        (OTHER_CREEP, said("equivalent", ("charge_leakage", "creep"), at=("electrical",)), "right", "class"),
        (OTHER_CREEP, HERE, "open", "wrong"),
        (OTHER_CREEP, said("named", ("extra_hysteron",), at=("hysteron",)), "partly", "wrong"),
        (OTHER_CREEP, said("named", ("creep",), ("delay",), at=("mechanical", "amplifier")), "wrong", "wrong"),
        (OTHER_OUTSIDE, HERE, "right", "exact"),
    ],
)
def test_grades(sealed: Sealed, answer: dict[str, Any], outcome: str, grade: str) -> None:
    own = case(sealed, answer)
    assert (own.outcome(own.answer), own.grade) == (outcome, grade)


def test_a_location_is_right_alone_or_with_two_others() -> None:
    places = [("mechanical",), ("sensor", "mechanical"), ("a", "b", "c", "mechanical"), ("sensor",)]
    rows = [case(CREEP, said("unknown", at=p[:1], tied=p[1:])) for p in places]
    assert [c.located for c in rows] == ["alone", "tied", "no", "no"]
    assert case(OTHER_CREEP, HERE).located == "alone"


def estimates(factor: float = 1.0, part: float = 0.01) -> dict[str, dict[str, Any]]:
    ends = dict.fromkeys(TABLE, (factor - 1.96 * part, factor + 1.96 * part))
    return {n: {"value": factor * v, "interval": (ends[n][0] * v, ends[n][1] * v)} for n, v in TABLE.items()}


def base_errors(found: dict[str, dict[str, Any]], sealed: Sealed = DRAWN) -> dict[str, float]:
    return all_errors(found, (), sealed)["base"]


def test_base_parameters_are_compared_hysteron_by_hysteron() -> None:
    found = base_errors(estimates(1.02))
    # Not the mass, which is the anchor itself.
    assert found == pytest.approx(dict.fromkeys(set(TABLE) - {"m"}, 2.0), rel=1e-4)
    swapped = {n.translate(str.maketrans("12", "21")): v for n, v in estimates(1.02).items()}
    assert sorted(base_errors(swapped).values()) == pytest.approx([2.0] * 9, rel=1e-4)
    unknown = estimates() | {"rho_1": {"value": 1.0}, "b": {"value": 1.0, "interval": None}}
    assert set(base_errors(unknown)) == set(TABLE) - {"m", "rho_1", "b"}
    assert base_errors({}) == {}
    fewer = {n: v for n, v in estimates().items() if not n.endswith("_2")}
    assert base_errors(fewer) == {}


def of_effects(sealed: Sealed, *names: str, **parameters: tuple[float, float | None]) -> dict[str, float]:
    """Errors of the parameters of named effects, given as value and standard error."""
    own = {n: {"value": v, "interval": s and (v - 1.96 * s, v + 1.96 * s)} for n, (v, s) in parameters.items()}
    return all_errors(estimates() | own, names, sealed)["effect"]


def test_what_scales_with_an_exact_mass_is_left_out() -> None:
    exact = replace(DRAWN, stated_mass=0.0)
    assert set(base_errors(estimates(), exact)) == {"d_1", "d_2"}
    creep = {"k_s": (440.0, 20.0), "tau_s": (0.12, 0.01)}
    assert of_effects(exact, "creep", **creep) == pytest.approx({"tau_s": 2.0}, rel=1e-4)
    assert of_effects(DRAWN, "creep", **creep) == pytest.approx({"k_s": 2.0, "tau_s": 2.0}, rel=1e-4)
    # No model of another hysteresis is right, and no other name.
    assert of_effects(OTHER_CREEP, "creep", **creep) == of_effects(DRAWN, "delay", **creep) == {}


DOCS = Path(__file__).resolve().parents[3] / "docs"
PAGE = (DOCS / "proof.md").read_text(encoding="utf-8")
NULLS = pd.read_csv(DOCS / "proof-nulls.csv", keep_default_na=False)
CASES = pd.read_csv(DOCS / "proof-cases.csv", keep_default_na=False)
FALSE = "nothing missing: false alarms, whole command"


def named(*names: str) -> dict[str, Any]:
    """An answer with names, in which the held-out error falls from three times the noise to it."""
    answer = said("named" if names else "none", *((n,) for n in names), held=(3.0, 1.0))
    return answer | {"base": 3.0, "p_value": 0.01, "seconds": 1.0}


def by_label(cases: list[Case]) -> dict[str, Any]:
    return {r.what: r for r in rates(cases).itertuples()}


def test_rates_have_exact_intervals() -> None:
    assert share_interval(0, 400) == pytest.approx((0.0, 0.00918), abs=1e-4)
    found = by_label([case(CREEP, named(n)) for n in ("creep", "creep", "delay", "creep")])
    exactly, pairs = found["same form: exactly right"], found["pairs: right, or in a stated class of at most 4"]
    assert (exactly.share, exactly.low) == (0.75, pytest.approx(0.194, abs=1e-3))
    assert pairs.cases == 0 and np.isnan(pairs.share)


def test_false_alarms_are_counted_by_grade() -> None:
    answers = [named(), named("creep"), UNKNOWN, named("delay")]
    assert by_label([case(BESIDE, a) for a in answers])[FALSE].hits == 1
    # A hysteron too few in the manifest is missing, so that to name it is no false alarm either.
    assert by_label([case(FEWER, named("extra_hysteron"))])[FALSE].cases == 0
    (count,) = nulls([case(BESIDE, a, group="nulls", family="white") for a in answers]).itertuples()
    assert (count.cases, count.right, count.named, count.unknown, count.false) == (4, 3, 1, 0, "delay (1)")


@settings(deadline=None, max_examples=15)
@given(st.floats(2.0, 30.0), st.integers(0, 2**31))
def test_half_point_is_where_half_the_hits_are(half: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    delta = np.exp(rng.uniform(np.log(half / 8.0), np.log(half * 8.0), 4000))
    hit = rng.random(delta.size) < 1.0 / (1.0 + (half / delta) ** 6)
    assert half_point(delta, hit.astype(float)) == pytest.approx(half, rel=0.1)
    assert np.isnan(half_point(delta, np.ones_like(delta)))


def test_detection_of_the_limit_itself_has_ratio_one() -> None:
    rng = np.random.default_rng(0)
    cases = []
    for delta in np.exp(rng.uniform(0.0, np.log(30.0), 3000)):
        noticed = bool(rng.standard_normal() + delta > Criteria().score)
        cases.append(case(replace(CREEP, delta=float(delta)), named(*["creep"] * noticed), group="fast_weak"))
    assert detection(cases) == pytest.approx((1.0, 1.0), abs=0.12)
    assert detection([]) is None


def test_the_page_lists_what_is_wrong(tmp_path: Path) -> None:
    cases = [case(CREEP, named("creep")), case(CREEP, named("delay"), seed=2), case(CREEP, {"failure": "no"}, seed=3)]
    page = write_proof(cases, Settings(), "abc", Place(tmp_path))
    assert "from the seed 2026. The SHA-256" in page
    assert "1 diagnoses ended without an answer" in page
    wrong = page.partition("## Wrong answers")[2]
    assert "| same | 1 |" not in wrong
    assert "| same | 2 | creep | 4.00 | named | delay | mechanical | mechanical | wrong |  |" in wrong
    table = pd.read_csv(tmp_path / "cases.csv", keep_default_na=False)
    assert table["grade"].tolist() == ["exact", "wrong", "wrong"]
    assert float(table["held_before"][0]) == 3.0
    assert page.strip() == (tmp_path / "report.md").read_text(encoding="utf-8").strip()


def test_the_documentation_states_the_proof_that_is_stored_beside_it() -> None:
    for row in NULLS.itertuples():
        assert f"| {row.family} | {row.cases} | {row.named} | {row.unknown} |" in PAGE
    for group in ("same", "other", "outside"):
        mine = CASES[CASES["group"] == group]
        assert re.search(rf"^\| {group} \|.*\| {sum(mine['grade'] != 'wrong')} of {len(mine)} \|", PAGE, re.MULTILINE)
    listed = next(line for line in PAGE.split("\n\n") if line.startswith("Wrong answers"))
    for truth in CASES[CASES["grade"] == "wrong"]["truth"]:
        assert truth.replace("+", " and ").replace("_", " ") in listed.replace("\n", " ")
