"""Fingerprints of what the base model leaves: features, training, classifier, tool."""

from __future__ import annotations

import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pandas as pd
import pytest

from phnn.cli import main
from phnn.errors import InputRefused, SolverFailed
from phnn.identification.fit import Fit
from phnn.models.actuator import hrc
from phnn.results import claim
from studies.benchmark.cases import entries
from studies.benchmark.fingerprints import classifier, cycles, jumps, training
from studies.benchmark.fingerprints.actuators import Actuator, simulated, template
from studies.benchmark.fingerprints.cases import drawn
from studies.benchmark.fingerprints.classifier import LABELS, labels, platt, scaled, trained
from studies.benchmark.fingerprints.features import features, names
from studies.benchmark.fingerprints.fitting import fitted
from studies.benchmark.fingerprints.training import KEYS, TABLE, TRAINING, read_table, rows_of, variants
from studies.benchmark.fingerprints.validation import validated
from studies.benchmark.settings import GROUPS, Settings
from studies.benchmark.tools import fingerprints, tool
from studies.generator import generate
from studies.generator.listed import LISTED
from studies.generator.strata import choices

SIGMA = 5e-8


def left_of(plan: str, scale: float = 1.0) -> Fit:
    """A base model that leaves noise of ``scale`` deviations in the recordings of a plan."""
    recordings = tuple(replace(r, y=1e-6 * r.u, noise=SIGMA) for r in template(plan))
    residual = scale * np.random.default_rng(1).standard_normal(sum(r.t.size for r in recordings))
    values = {n: p.value for n, p in hrc(2).parameters.items()}
    plan_of_fit, setup = SimpleNamespace(recordings=recordings), SimpleNamespace(values=lambda: values)
    return cast(Fit, SimpleNamespace(plan=plan_of_fit, residual=residual, use="identification", setup=setup))


@pytest.mark.parametrize(("plan", "filled"), [("one", "sweep_2"), ("short", "jumps"), ("demo", "small_fast")])
def test_features_have_one_length_and_are_numbers_where_there_are_recordings(plan: str, filled: str) -> None:
    found = features(left_of(plan, 3.0))
    assert list(found) == names()
    assert not any(np.isinf(x) for x in found.values())
    assert found["all.level"] == pytest.approx(np.log(3.0), abs=0.03)
    # Noise alone: its size is found without the signal, it is white, its tails are those of a normal distribution.
    assert found["all.floor"] == pytest.approx(np.log(3.0), abs=0.05)
    assert found["all.heavy"] == pytest.approx(np.log(2.807 / 0.6745), abs=0.1)
    own = {name: x for name, x in found.items() if name.startswith(f"{filled}.")}
    missing = {name.partition(".")[2] for name, x in own.items() if np.isnan(x)}
    # A step of half a second has no window of seconds, a band of a sweep may have less than two cycles.
    assert missing <= {"repeat", "up_6", "up_7", "down_5", "down_6", "down_7"}
    if plan == "one":
        assert all(np.isnan(x) for name, x in found.items() if name.startswith(("sine_", "small_", "jumps.")))


def test_a_harmonic_is_found_with_its_phase_from_the_displacement() -> None:
    t = np.arange(3000) / 1e4
    u, lag = 75.0 * np.sin(2.0 * np.pi * 10.0 * t + 0.4), 0.3
    phase = cycles.sine_phase(t, u, 10.0)
    np.testing.assert_allclose(np.cos(phase), u / 75.0, atol=1e-6)
    y = 1e-5 * np.cos(phase - lag)
    left = 2e-7 * np.cos(2.0 * (phase - lag) + 1.0)
    found = cycles.window(phase, y, left, 1e-4, SIGMA, 2e-7)
    assert found["re_2"] == pytest.approx(np.cos(1.0), abs=1e-3)
    assert found["im_2"] == pytest.approx(np.sin(1.0), abs=1e-3)
    assert found["size_1"] < 1e-3
    assert found["rest"] < 1e-3
    assert found["repeat"] == pytest.approx(1.0, abs=1e-3)
    assert found["level"] == pytest.approx(np.log(2e-7 / np.sqrt(2.0) / SIGMA), abs=1e-3)
    # The other sign has the other phase and the same angle modulo π.
    other = cycles.window(phase, y, -left, 1e-4, SIGMA, 2e-7)
    assert other["re_2"] == pytest.approx(-found["re_2"])
    assert (other["cos2_2"], other["sin2_2"]) == pytest.approx((found["cos2_2"], found["sin2_2"]))


def test_creep_after_a_jump_grows_from_window_to_window() -> None:
    t = np.arange(4000) * 5e-4
    u = np.where((t >= 0.1) & (t < 1.5), 75.0, 0.0)
    left = np.where(u > 0.0, 1.0 - np.exp(-(t - 0.1) / 0.2), 0.0)
    found = jumps.jumps(t, u, left, SIGMA, 1.0)
    rising = [found[f"up_{i}"] for i in range(1, 7)]
    assert rising == sorted(rising)
    assert rising[-1] - rising[0] > 1.0


def test_cases_of_a_training_are_balanced_and_none_is_of_a_benchmark() -> None:
    cases = [drawn(3, n) for n in range(400)]
    assert cases == [drawn(3, n) for n in range(400)]
    assert Counter(c.group for c in cases) == {**dict.fromkeys(GROUPS, 50), "same": 150}
    assert Counter(c.plan for c in cases) == {"one": 160, "four": 160, "twelve": 80}
    same = Counter(c.case().effects for c in cases if c.group == "same")
    assert set(same) == {(name,) for name in LISTED}
    assert max(same.values()) - min(same.values()) == 0
    outside = [c.case() for c in cases if c.group == "outside"]
    assert all(c.form == "unlisted" and not c.withheld for c in outside)
    assert {c.effects for c in outside} == {c.effects for c in choices("outside") if not c.withheld}
    largest = max(e.seed for seed in range(50) for e in entries(Settings(seed=seed)))
    assert min(c.seed for c in cases) > largest
    assert len({c.seed for c in cases}) == 400


def first(group: str, plan: str) -> int:
    return next(n for n in range(1000) if (drawn(5, n).group, drawn(5, n).plan) == (group, plan))


def test_a_row_is_the_same_each_time_and_as_strong_as_wanted() -> None:
    case = next(
        c
        for c in (drawn(5, n) for n in range(999))
        if c.case().effects == ("cubic_stiffness",) and c.plan == "four" and c.group == "same"
    )
    actuator = simulated(case.case())
    rows = rows_of(case, actuator)
    assert rows == rows_of(case, simulated(case.case()))
    (row,) = rows
    assert (row["effects"], row["variant"]) == ("cubic_stiffness", "four")
    (target,) = case.case().targets
    assert row["level"] == pytest.approx(target, rel=0.31)
    # Root of the sum of what is missing and of the noise.
    assert np.exp(row["all.level"]) == pytest.approx(np.hypot(1.0, row["level"]), rel=0.25)


def test_twelve_recordings_contain_four_and_one() -> None:
    whole = Actuator(cast(Any, None), 1e-3, template("demo"), (), (), 0.0)
    found = {name: [r.name for r in part.recordings] for name, part in variants("twelve", whole)}
    assert [len(found[name]) for name in ("twelve", "four", "one")] == [12, 4, 1]
    assert set(found["four"]) == {r.name for r in template("short")}
    assert [name for name, _ in variants("four", whole)] == ["four"]


def made_up(number: int, group: str, effects: str, rng: np.random.Generator) -> dict[str, Any]:
    """A row in which each label has features of its own."""
    values = dict(zip(names(), rng.normal(size=len(names())), strict=True))
    shown = {"none": ["none"], "outside": ["unlisted"]}.get(group) or effects.split("+")
    for label in shown:
        for k in range(15):
            values[names()[15 * LABELS.index(label) + k]] += 20.0
    return {**dict(zip(KEYS, (number, "four", group, "four", "weak", effects, "", 2.0), strict=True)), **values}


def separable() -> pd.DataFrame:
    rng, few = np.random.default_rng(0), ("creep", "delay", "second_mode")
    kinds = [("none", ""), ("outside", "wear"), *(("same", e) for e in few), ("pair", "creep+delay")] * 12
    return pd.DataFrame([made_up(n, *kind, rng) for n, kind in enumerate(kinds)])


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(classifier, "_TREES", 60)


@pytest.mark.parametrize("kind", ["trees", "nearest"])
@pytest.mark.usefixtures("small")
def test_separable_features_are_named_rightly(kind: str) -> None:
    found, rng = trained(separable(), kind, 0), np.random.default_rng(9)
    for group, effects in (("none", ""), ("outside", "leak"), ("same", "second_mode"), ("pair", "creep+delay")):
        stated = found.probabilities(made_up(999, group, effects, rng))
        wanted = {"none": {"none"}, "outside": {"unlisted"}}.get(group) or set(effects.split("+"))
        assert {name for name, p in stated.items() if p >= 0.5} == wanted
    assert set(stated) == {*LISTED, "none", "unlisted"}


@pytest.mark.usefixtures("small")
def test_validation_holds_out_what_it_counts() -> None:
    table = separable()
    found = validated(table, 0, ("trees",))
    every = found[found["of"] == "all"]
    assert list(every["trained_on"]) == [18, 36, 72]
    assert every.iloc[-1]["right"] > 0.9
    # Labels that features do not tell are not learned by heart.
    shuffled = table.copy()
    order = np.random.default_rng(1).permutation(len(table))
    shuffled[["group", "effects"]] = table[["group", "effects"]].to_numpy()[order]
    last = validated(shuffled, 0, ("trees",)).query("of == 'all'").iloc[-1]
    assert last["right"] < 0.2


def test_platts_scaling_makes_probabilities_of_votes() -> None:
    rng = np.random.default_rng(2)
    true = rng.uniform(0.05, 0.95, (4000, 2))
    y = rng.uniform(size=true.shape) < true
    # Votes whose logits are half as large.
    votes = 1.0 / (1.0 + np.sqrt(1.0 / true - 1.0))
    slope, offset = platt(votes, y)
    assert slope == pytest.approx(2.0, abs=0.1)
    np.testing.assert_allclose(scaled(votes, slope, offset), true, atol=0.03)


def test_labels_leave_the_background_out() -> None:
    table = separable().iloc[[0, 1, 2, 5]].assign(beside="creep")
    found = [{LABELS[j] for j in np.flatnonzero(row)} for row in labels(table)]
    assert found == [{"none"}, {"unlisted"}, {"creep"}, {"creep", "delay"}]


def test_training_goes_on_where_it_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []

    def quick(case: Any, actuator: Any) -> list[dict[str, Any]]:
        made.append(case.number)
        if case.number == 2:
            raise SolverFailed("no step")
        if case.number == 4 and len(made) == 5:
            raise KeyboardInterrupt
        return [made_up(case.number, case.group, "creep", np.random.default_rng(case.number))]

    monkeypatch.setattr(training, "simulated", lambda case: None)
    monkeypatch.setattr(training, "rows_of", quick)
    said: list[str] = []
    with claim(tmp_path / "t", "bench", (), TRAINING) as place:
        with pytest.raises(KeyboardInterrupt):
            training.train(5, 6, place, "serial", said.append)
        table = training.train(5, 6, place, "serial", said.append)
        assert made == [0, 1, 2, 3, 4, 4, 5]
        assert list(table["number"]) == [0, 1, 3, 4, 5]
        # A larger training keeps the cases of a smaller one.
        assert list(training.train(5, 8, place, "serial", said.append)["number"]) == [0, 1, 3, 4, 5, 6, 7]
        assert made[-2:] == [6, 7]
    again = read_table(tmp_path / "t")
    assert list(again["group"]) == [drawn(5, n).group for n in again["number"]]
    np.testing.assert_allclose(again[names()].iloc[0], [table[n].iloc[0] for n in names()])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda table: table.drop(columns=names()[3]), "has other columns than this version writes: train anew"),
        (lambda table: table.astype({names()[3]: object}).assign(**{names()[3]: "much"}), "holds words"),
        (lambda table: table.iloc[:0], "has no rows: train with a larger size"),
        (lambda table: table.assign(effects="crepe"), "a group or an effect 'crepe' that nobody conceals"),
        (lambda table: table.assign(group="sane"), "a group or an effect 'sane' that nobody conceals"),
    ],
)
def test_a_table_that_cannot_be_used_is_refused(tmp_path: Path, change: Any, words: str) -> None:
    change(separable()).to_csv(tmp_path / TABLE, index=False)
    with pytest.raises(InputRefused, match=words):
        read_table(tmp_path)


def test_a_training_that_is_absent_or_too_small_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputRefused, match="give the folder that phnn bench train has written"):
        read_table(tmp_path)
    with pytest.raises(InputRefused, match="a training needs 5 cases at least"):
        trained(separable().iloc[:4], "trees", 0)
    with pytest.raises(InputRefused, match="tool fingerprints needs --training"):
        tool("fingerprints")


@pytest.mark.slow
def test_a_tool_sees_the_features_that_its_training_has(tmp_path: Path) -> None:
    case = drawn(5, first("same", "four"))
    actuator = simulated(case.case())
    generate(0, tmp_path / "case", "none", "short")
    for r in actuator.recordings:
        path = tmp_path / "case" / f"{r.name}.csv"
        pd.read_csv(path).assign(displacement_um=np.round(1e6 * r.y, 3)).to_csv(path, index=False)
    manifest = tmp_path / "case" / "recordings.yaml"
    text = manifest.read_text()
    stated = text[text.index("value: ") :].partition("\n")[0]
    manifest.write_text(text.replace(stated, f"value: {actuator.mass}"))
    read = features(fingerprints.base_of(tmp_path / "case", 0, everything=True).fit)
    known = features(fitted(actuator))
    np.testing.assert_allclose(list(read.values()), list(known.values()), rtol=0.05, atol=0.05)


@pytest.mark.slow
def test_a_claimed_effect_serves_the_prediction(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    case, name = tmp_path / "case", "sine_100Hz_75V"
    generate(7, case, "quadratic_drag", "short")
    (case / "exam").mkdir()
    shutil.copy(case / f"{name}.csv", case / "exam")
    (case / "exam" / "recordings.yaml").write_text("setup: {model: piezo_actuator, hysterons: 2}\n")
    measured = 1e-6 * pd.read_csv(case / f"{name}.csv")["displacement_um"].to_numpy()
    errors = {}
    for claimed in ("quadratic_drag", "none"):
        stated = {label: 0.9 if label == claimed else 0.01 for label in LABELS}
        fake = SimpleNamespace(probabilities=lambda found, of=stated: of)
        monkeypatch.setattr(fingerprints, "classifier", lambda training, kind, of=fake: of)
        answer = fingerprints.answer(case, 0, tmp_path)
        assert answer.claims == {claimed}
        errors[claimed] = float(np.std(answer.predictions[name] - measured))
        assert answer.places[0] == "mechanical"
    assert errors["quadratic_drag"] < 0.7 * errors["none"]


def test_the_command_trains(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(classifier, "_TREES", 20)
    monkeypatch.setattr(training, "simulated", lambda case: None)

    def quick(case: Any, actuator: Any) -> list[dict[str, Any]]:
        return [made_up(case.number, "same", "creep", np.random.default_rng(case.number))]

    monkeypatch.setattr(training, "rows_of", quick)
    out = tmp_path / "t"
    run = ["bench", "train", "--executor", "serial", "--out", str(out), "seed=4", "size=20"]
    assert main(run) == 0
    assert "training: " in capsys.readouterr().out
    assert len(read_table(out)) == 20
    assert set(pd.read_csv(out / "validation.csv")["kind"]) == {"trees", "nearest"}
    # Another seed has other cases: it needs another folder.
    assert main([*run[:-2], "seed=5", "size=20"]) == 2
    capsys.readouterr()
