"""Cases of a benchmark: what is drawn, what a tool sees, and what is sealed."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from phnn.cli import main
from phnn.errors import InputRefused
from phnn.recordings import read
from studies.benchmark.cases import NOISES, PLANS, STRENGTHS, Entry, entries
from studies.benchmark.folders import OUTPUT, card_of, digest_of, opened
from studies.benchmark.settings import GROUPS, Settings
from studies.generator import draw_case, make_case
from studies.generator.effects import LISTED
from studies.generator.make import concealing
from studies.generator.plans import EXAM

SMALL = {"none": 9, "same": 9, "other": 4, "outside": 4, "pair": 4, "background": 4}
NOTHING = ["none=2", *(f"{group}=0" for group in GROUPS if group != "none")]


def test_names_and_order_do_not_tell_the_group() -> None:
    found = entries(Settings(seed=3, **SMALL))
    assert [e.name for e in found] == [f"case_{i:03d}" for i in range(len(found))]
    assert Counter(e.group for e in found) == SMALL
    groups = [e.group for e in found]
    # As many neighbours are alike as chance gives, not nearly all.
    assert sum(a == b for a, b in pairwise(groups)) < len(groups) // 2


def test_strengths_plans_and_noises_take_turns() -> None:
    found = entries(Settings(**SMALL))
    same = [e for e in found if e.group == "same"]
    assert {(e.strength, e.plan) for e in same} == {(s, p) for s in STRENGTHS for p in PLANS}
    assert {e.noise for e in found if e.group == "none"} == set(NOISES)
    # With another seed an effect is met in another strength or plan.
    orders = [[(e.strength, e.plan) for e in sorted(of, key=lambda e: e.seed)] for of in (same, others("same", 2))]
    assert orders[0] != orders[1]


def others(group: str, seed: int) -> list[Entry]:
    return [e for e in entries(Settings(seed=seed, **SMALL)) if e.group == group]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_pairs_share_no_effect_more_often_than_chance(seed: int) -> None:
    (pairs,) = ([e.case().effects for e in entries(Settings(seed=seed, pair=9)) if e.group == "pair"],)
    counts = Counter(name for pair in pairs for name in pair)
    assert max(counts.values()) <= 4
    assert len(set(pairs)) == 9


def test_each_effect_has_its_turn() -> None:
    found = [e.case().effects for e in entries(Settings(seed=5, same=len(LISTED))) if e.group == "same"]
    assert len(set(found)) == len(LISTED)


def test_strength_is_what_can_be_seen(tmp_path: Path) -> None:
    """The examination takes no part: another one leaves the strength of the concealed effect as it is."""
    case = draw_case(11, "same", "one_exam", (3.0, 6.0))
    alone = make_case(replace(case, plan="one"), tmp_path / "alone")
    beside = make_case(case, tmp_path / "beside")
    assert beside.effects == alone.effects
    assert beside.strength_over_noise == pytest.approx(alone.strength_over_noise, rel=1e-9)
    assert beside.parameters == pytest.approx(alone.parameters)


@pytest.mark.parametrize("effect", ["sensor_drift", "mains_pickup"])
def test_what_acts_on_each_recording_acts_in_the_examination_too(effect: str, tmp_path: Path) -> None:
    seeds = (s for s in range(1000) if draw_case(s, "same", "one_exam").effects == (effect,))
    case = draw_case(next(seeds), "same", "one_exam", (6.0, 6.0))
    sealed = make_case(case, tmp_path / "case")
    exam = [e for e in case.recordings if e.name.startswith(EXAM)]
    tables = (pd.read_csv(tmp_path / "case" / f"{excitation.name}.csv") for excitation in exam)
    left = [
        1e-6 * table[OUTPUT].to_numpy() - y for table, y in zip(tables, concealing(case.base, exam, []), strict=True)
    ]
    # A drift shows in the longest of them.
    assert max(np.std(rest) for rest in left) > 2.0 * sealed.noise


@pytest.mark.parametrize("group", GROUPS)
def test_a_case_is_what_its_group_says(group: str) -> None:
    (entry,) = entries(Settings(**{g: int(g == group) for g in GROUPS}))
    case = entry.case()
    assert len(case.effects) == {"none": 0, "pair": 2}.get(group, 1)
    assert case.conditions.background is (group == "background")
    assert case.withheld == ()
    assert case.form == ("unlisted" if group == "outside" else case.form)


def test_another_seed_gives_other_cases() -> None:
    first, second = ({e.seed for e in entries(Settings(seed=s))} for s in (1, 2))
    assert not first & second


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("bench") / "b"
    assert main(["bench", "write", "--executor", "serial", "--out", str(out), *NOTHING]) == 0
    return out


def test_a_tool_sees_inputs_of_the_examination_alone(folder: Path) -> None:
    for name in card_of(folder)["cases"]:
        home = folder / "cases" / name
        known, exam = read(home), read(home / "exam", need_output=False)
        assert all(np.isfinite(r.y).all() for r in known.recordings)
        assert all(np.isnan(r.y).all() for r in exam.recordings)
        assert not {r.name for r in known.recordings} & {r.name for r in exam.recordings}
        assert known.known == exam.known
        _, sealed, tables = opened(folder, name)
        assert sealed.effects == ()
        assert set(tables) == {r.name for r in exam.recordings}
        for r in exam.recordings:
            np.testing.assert_allclose(tables[r.name]["voltage_V"], r.u)
            assert "displacement_um" in tables[r.name]


def test_what_was_made_is_not_made_again(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = {p: p.stat().st_mtime_ns for p in (folder / "sealed").rglob("*")}
    assert main(["bench", "write", "--executor", "serial", "--out", str(folder), *NOTHING]) == 0
    assert before == {p: p.stat().st_mtime_ns for p in (folder / "sealed").rglob("*")}
    assert card_of(folder)["sha256"] in capsys.readouterr().out


def test_the_hash_covers_seals_and_outputs(folder: Path) -> None:
    names = card_of(folder)["cases"]
    digest = digest_of(folder, names)
    assert digest == card_of(folder)["sha256"]
    for kind in ("sealed", "cases"):
        path = next((folder / kind / names[-1]).glob("*.csv"))
        content = path.read_bytes()
        table = pd.read_csv(path)
        table.loc[3, "displacement_um"] += 0.001
        path.write_text(table.to_csv(index=False))
        assert digest_of(folder, names) != digest
        path.write_bytes(content)


def test_other_settings_are_other_cases(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    more = ["none=3", *NOTHING[1:]]
    assert main(["bench", "write", "--executor", "serial", "--out", str(folder), *more]) == 2
    assert len(card_of(folder)["cases"]) == 2
    capsys.readouterr()


def test_what_a_tool_sees_tells_no_seed(folder: Path) -> None:
    seed = json.loads((folder / "sealed" / "settings.json").read_text())["seed"]
    assert seed == 1
    assert "settings" not in card_of(folder)


def test_another_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bench.json").write_text(json.dumps({"schema": "phnn.predict/1"}))
    with pytest.raises(InputRefused, match=r"is no phnn\.bench/1 file"):
        card_of(tmp_path)
    with pytest.raises(InputRefused, match="give the folder that phnn bench write has written"):
        card_of(tmp_path / "nowhere")
