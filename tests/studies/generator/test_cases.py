"""Cases of the benchmark: what is drawn, what is written, and the answer."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from omegaconf import OmegaConf

from phnn.errors import InputRefused, SolverFailed
from studies.generator import STRATA, Case, Sealed, draw_case, make_case, open_seal, write_seal
from studies.generator.listed import LISTED, LOCATIONS
from studies.generator.noise import Noise
from studies.generator.strata import choices
from studies.generator.strength import concealing, rulers

SENSOR_NONLINEARITY = LISTED.index("sensor_nonlinearity")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Case, Path, Sealed]:
    case = draw_case(SENSOR_NONLINEARITY, "same", "few")
    folder = tmp_path_factory.mktemp("case") / "recordings"
    return case, folder, make_case(case, folder)


@pytest.mark.slow
def test_same_seed_same_bytes(tmp_path: Path, made: tuple[Case, Path, Sealed]) -> None:
    case, folder, sealed = made
    again = draw_case(SENSOR_NONLINEARITY, "same", "few")
    assert again == case
    assert make_case(again, tmp_path) == sealed
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    assert draw_case(SENSOR_NONLINEARITY + len(LISTED), "same", "few").base != case.base


def test_the_answer_says_what_the_case_says_and_survives_the_seal(
    tmp_path: Path, made: tuple[Case, Path, Sealed]
) -> None:
    case, _, sealed = made
    assert (sealed.effect, sealed.effects) == ("sensor_nonlinearity", case.effects)
    assert (sealed.location, sealed.withheld, sealed.form) == (("sensor",), (), "canonical")
    assert (sealed.seed, sealed.stratum, sealed.plan, sealed.base) == (case.seed, "same", "few", case.base)
    assert set(sealed.parameters) == {"a_2", "a_3"}
    assert sealed.strength_over_noise == pytest.approx(case.targets[0], rel=0.1)
    assert (sealed.levels, sealed.deltas) == ((sealed.strength_over_noise,), (sealed.delta,))
    write_seal(sealed, tmp_path / "sealed.json")
    assert open_seal(tmp_path / "sealed.json") == sealed


def test_recordings_have_true_names_and_nothing_betrays_the_answer(made: tuple[Case, Path, Sealed]) -> None:
    case, folder, _ = made
    manifest = OmegaConf.load(folder / "recordings.yaml")
    assert {e["file"] for e in manifest["recordings"]} == {p.name for p in folder.glob("*.csv")}
    for excitation in case.recordings:
        table = pd.read_csv(folder / f"{excitation.name}.csv")
        assert len(table) == excitation.samples
        frequency, amplitude = (float(part.rstrip("HzV")) for part in excitation.name.split("_")[1:])
        expected = amplitude * np.sin(2.0 * np.pi * frequency * table["time_s"])
        np.testing.assert_allclose(table["voltage_V"], expected, atol=1e-9)
    written = "".join(p.read_text() for p in folder.iterdir())
    assert not any(name in written for name in LISTED)


def test_a_noncentrality_can_be_asked_for(tmp_path: Path) -> None:
    case = draw_case(SENSOR_NONLINEARITY, "same", "few", deltas=(3.0, 3.0))
    sealed = make_case(case, tmp_path)
    assert sealed.delta == pytest.approx(3.0, rel=0.1)
    assert sealed.strength_over_noise < 0.2


@pytest.mark.slow
def test_what_cannot_be_made_strong_enough_gives_way_to_the_next_choice(tmp_path: Path) -> None:
    # A play changes the output by no more than its half-width, 20 µm at most.
    case = draw_case(LISTED.index("output_backlash"), "same", "few")
    alone = replace(case, choices=case.choices[:1], targets=(1.2e-4 / case.noise.deviation,))
    with pytest.raises(SolverFailed, match="ask for less"):
        make_case(alone, tmp_path)
    drift = next(c for c in case.choices if c.effects == ("sensor_drift",))
    sealed = make_case(replace(alone, choices=(case.choices[0], drift)), tmp_path)
    # A drift can be as fast as half of what is wanted asks for.
    assert sealed.effects == ("sensor_drift",)
    assert sealed.strength_over_noise == pytest.approx(0.5 * alone.targets[0], rel=0.1)
    assert sealed.redrawn >= 3


def test_a_pair_is_measured_apart_and_together(tmp_path: Path) -> None:
    first = next(i for i, c in enumerate(choices("pair")) if c.effects == ("sensor_drift", "mains_pickup"))
    case = draw_case(first, "pair", "few", levels=(1.0, 10.0))
    assert all(2.0 <= target <= 10.0 for target in case.targets)
    sealed = make_case(case, tmp_path)
    assert (sealed.effects, sealed.location) == (("sensor_drift", "mains_pickup"), ("sensor", "environment"))
    assert sealed.levels == pytest.approx(case.targets, rel=0.1)
    # A ramp and a line are nearly orthogonal: their squares add up, and neither hides in the other.
    assert sealed.delta == pytest.approx(np.hypot(*sealed.deltas), rel=0.02)
    assert sealed.apart == pytest.approx(sealed.deltas, rel=0.02)
    assert sealed.strength_over_noise == pytest.approx(np.hypot(*sealed.levels), rel=0.02)


def test_noncentrality_is_the_deviation_of_the_best_test(tmp_path: Path) -> None:
    # The best test projects the whitened recordings on the whitened effect: of noise alone it has unit variance, and
    # the effect shifts it by δ. Noise is drawn here, the direction is that of the ruler.
    case = draw_case(LISTED.index("mains_pickup"), "same", "few", deltas=(5.0, 5.0))
    case = replace(case, noise=Noise(50e-9, 10e-9, 0.7))
    effect = case.choices[0].concealed(0, np.random.default_rng(0), case.base, case.recordings)
    _, white = rulers(case.base, case.recordings, case.noise)
    signal = white.left(concealing(case.base, case.recordings, [(effect, 1e-8)]))
    delta = np.linalg.norm(signal)
    rng, scores = np.random.default_rng(1), []
    for _ in range(300):
        drawn = [case.noise.drawn(q.size, rng) for q in white.undisturbed]
        noisy = [q + np.round(n / 10e-9) * 10e-9 for q, n in zip(white.undisturbed, drawn, strict=True)]
        scores.append(white.left(noisy) @ signal / delta)
    assert np.std(scores) == pytest.approx(1.0, abs=0.12)
    assert abs(np.mean(scores)) < 0.2


def test_nothing_concealed_leaves_the_base_model(tmp_path: Path) -> None:
    sealed = make_case(draw_case(1, "none", "few"), tmp_path)
    assert (sealed.effect, sealed.effects, sealed.location, sealed.parameters) == ("none", (), (), {})
    assert (sealed.strength_over_noise, sealed.delta) == (0.0, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("stratum", STRATA)
def test_cases_of_a_stratum_conceal_everything_it_can(stratum: str) -> None:
    count = len(choices(stratum))
    seen = Counter(draw_case(seed, stratum, "short").choices[0] for seed in range(2 * count))
    assert seen == dict.fromkeys(choices(stratum), 2)
    for choice in choices(stratum):
        assert len(choice.location) == len(choice.effects)
        assert set(choice.withheld) <= set(LISTED)


def test_nothing_takes_the_place_of_what_is_withheld() -> None:
    for seed, choice in enumerate(choices("outside")):
        case = draw_case(seed, "outside", "short")
        assert (case.effects, case.withheld, case.form) == (choice.effects, choice.withheld, choice.form)
        assert case.withheld == (case.effects if case.form == "canonical" else ())
        assert all(other.withheld == case.withheld for other in case.choices)
        assert (case.effects[0] in LISTED) == bool(case.withheld)


def test_the_same_effects_are_all_listed_and_none_is_withheld() -> None:
    assert [c.effects for c in choices("same")] == [(name,) for name in LOCATIONS]
    assert not any(c.withheld for c in choices("same"))


def test_a_third_of_the_cases_has_coloured_noise() -> None:
    colours = [draw_case(seed, "none").noise.colour for seed in range(600)]
    assert 0.27 < np.mean(np.array(colours) > 0.0) < 0.40
    assert all(c == 0.0 or 0.3 <= c <= 0.8 for c in colours)


@pytest.mark.parametrize(
    ("arguments", "needle"),
    [
        ((0, "odd"), "stratum = 'odd'"),
        ((0, "none", "grand"), "no plan called 'grand'"),
        ((-1, "none"), "seed = -1"),
        ((0, "none", "few", (2.0, 1.0)), "the smaller one first"),
        ((0, "none", "few", (1.0, 2.0), (0.0, 1.0)), "positive"),
    ],
)
def test_what_cannot_be_drawn_is_refused(arguments: tuple[object, ...], needle: str) -> None:
    with pytest.raises(InputRefused, match=needle):
        draw_case(*arguments)  # type: ignore[arg-type]
