"""Folders that conceal an effect: reproducible, readable, sealed, and as strong as intended."""

from __future__ import annotations

import ast
import hashlib
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from omegaconf import OmegaConf

import studies.generator
from phnn.errors import InputRefused, SolverFailed
from studies.generator import EFFECTS, ON_REQUEST, Sealed, generate, open_seal, write_seal
from studies.generator.actuator import NEUTRAL, TABLE, simulate_all
from studies.generator.base import draw_base
from studies.generator.concealed import described, draw, drifts
from studies.generator.plans import plan_of
from studies.generator.strength import find_strength


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Sealed]:
    folder = tmp_path_factory.mktemp("demo") / "recordings"
    return folder, generate(5, folder, "creep", "short")


def _outputs(folder: Path) -> dict[str, np.ndarray]:
    return {path.stem: pd.read_csv(path)["displacement_um"].to_numpy() * 1e-6 for path in sorted(folder.glob("*.csv"))}


def test_same_seed_same_bytes_other_seed_other_bytes(tmp_path: Path, made: tuple[Path, Sealed]) -> None:
    folder, sealed = made
    again = tmp_path / "again"
    assert generate(5, again, "creep", "short") == sealed
    files = sorted(p.name for p in folder.iterdir())
    assert files == sorted(p.name for p in again.iterdir())
    assert all((folder / name).read_bytes() == (again / name).read_bytes() for name in files)
    other = tmp_path / "other"
    assert generate(6, other, "none", "short").base != sealed.base


def test_csv_and_manifest_say_what_they_must_and_no_more(made: tuple[Path, Sealed]) -> None:
    folder, sealed = made
    manifest = OmegaConf.to_container(OmegaConf.load(folder / "recordings.yaml"))
    assert isinstance(manifest, dict)
    assert manifest["setup"] == {"model": "piezo_actuator", "hysterons": 2}
    assert manifest["known"]["m"]["value"] == sealed.base["m"]
    assert manifest["voltage"] == "command"
    entries = {entry["file"]: entry for entry in manifest["recordings"]}
    assert set(entries) == {p.name for p in folder.glob("*.csv")}
    for excitation in plan_of("short"):
        table = pd.read_csv(folder / f"{excitation.name}.csv")
        assert list(table.columns) == ["time_s", "voltage_V", "displacement_um"]
        np.testing.assert_array_equal(table["time_s"], excitation.t)
        np.testing.assert_array_equal(table["voltage_V"], excitation.voltage(excitation.t))
        entry = entries[f"{excitation.name}.csv"]
        assert entry["start"] == {"state": "rest", "input_before": 0.0}
        assert entry.get("input") == ("zero_order" if excitation.held else None)
        steps = table["displacement_um"] / (sealed.quantisation * 1e6)
        assert np.max(np.abs(steps - np.round(steps))) < 1e-3 / (sealed.quantisation * 1e6)
    written = "".join(p.read_text() for p in folder.iterdir())
    assert not any(name in written for name in (*EFFECTS, *ON_REQUEST))


def test_recordings_are_the_simulation_plus_noise(made: tuple[Path, Sealed]) -> None:
    folder, sealed = made
    paths = simulate_all({**sealed.base, **sealed.parameters}, plan_of("short"))
    outputs = _outputs(folder)
    for excitation, q in zip(plan_of("short"), paths, strict=True):
        error = outputs[excitation.name] - q
        assert abs(error.mean()) < 6e-6
        assert error.std() == pytest.approx(np.hypot(sealed.noise, sealed.quantisation / 12**0.5), rel=0.1)


def test_strength_is_what_a_refit_of_the_base_cannot_take(made: tuple[Path, Sealed]) -> None:
    # Measured again in another way: one-sided sensitivities, the zeros as explicit columns, least squares.
    _, sealed = made
    plan = plan_of("short")
    base = simulate_all(sealed.base, plan)
    moved = simulate_all({**sealed.base, **sealed.parameters}, plan)
    columns = []
    for name in TABLE:
        ahead = simulate_all({**sealed.base, name: sealed.base[name] * 1.003}, plan)
        columns.append(np.concatenate([(a - b) / 0.003 for a, b in zip(ahead, base, strict=True)]))
    sizes = [len(b) for b in base]
    columns += list(np.repeat(np.eye(len(sizes)), sizes, axis=1) * 1e-5)
    change = np.concatenate([a - b for a, b in zip(moved, base, strict=True)])
    matrix = np.stack(columns, axis=1)
    fitted, *_ = np.linalg.lstsq(matrix, change, rcond=1e-6)
    left = np.sqrt(np.mean((change - matrix @ fitted) ** 2)) / sealed.noise
    assert left == pytest.approx(sealed.strength_over_noise, rel=0.1)
    assert 1.4 < sealed.strength_over_noise < 10.3


def test_each_effect_changes_the_output_and_vanishes_with_its_strength() -> None:
    plan = plan_of("short")
    base = dict(TABLE)
    undisturbed = simulate_all(base, plan)
    for name in (*EFFECTS, "contact_stop"):
        effect = draw(name, np.random.default_rng(1), base, plan)
        assert effect.name == name

        def change(strength: float) -> float:
            moved = simulate_all({**base, **effect.law(strength)}, plan)  # noqa: B023
            ramps = drifts(effect, strength, plan)  # noqa: B023
            return max(float(np.ptp(a + r - b)) for a, r, b in zip(moved, ramps, undisturbed, strict=True))

        seen = change(effect.guess)
        assert seen > 1e-8, name
        assert change(effect.guess * 1e-3) < 0.05 * seen, name
        stated = described(effect, effect.guess)
        assert stated, name
        assert set(effect.law(effect.guess)) <= set(NEUTRAL), name


def test_a_second_run_replaces_the_first(tmp_path: Path) -> None:
    generate(3, tmp_path, "none", "short")
    first = _outputs(tmp_path)
    generate(4, tmp_path, "none", "short")
    assert all(np.any(first[name] != y) for name, y in _outputs(tmp_path).items())


def test_none_is_the_base_model(tmp_path: Path) -> None:
    sealed = generate(3, tmp_path / "r", "none", "short")
    assert (sealed.effect, sealed.parameters, sealed.strength_over_noise) == ("none", {}, 0.0)


def test_bases_stay_near_the_table_and_spread() -> None:
    bases = [draw_base(np.random.default_rng(seed)) for seed in range(200)]
    for base in bases:
        assert all(abs(base[name] / value - 1.0) <= 0.2 for name, value in TABLE.items())
    spread = np.std([base["d_1"] / TABLE["d_1"] for base in bases])
    assert spread > 0.05


def test_seal_survives_the_round_trip_and_betrays_a_change(tmp_path: Path, made: tuple[Path, Sealed]) -> None:
    _, sealed = made
    path = tmp_path / "kept" / "sealed.json"
    digest = write_seal(sealed, path)
    assert open_seal(path) == sealed
    assert digest == hashlib.sha256(path.read_bytes()).hexdigest()
    # What a case was not asked for is left out: the bytes of a seal are those that it had before there was a choice.
    names = list(asdict(sealed))
    stated = {n: asdict(sealed)[n] for n in names[: names.index("redrawn") + 1]}
    assert json.loads(path.read_text()) == json.loads(json.dumps(stated))
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize(("content", "needle"), [(None, "cannot be read"), (b"\xff{", "json"), (b"{}", "no sealed")])
def test_what_is_no_seal_is_refused(tmp_path: Path, content: bytes | None, needle: str) -> None:
    path = tmp_path / "sealed.json"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputRefused, match=needle):
        open_seal(path)


def test_what_cannot_be_made_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputRefused, match="telepathy"):
        generate(0, tmp_path / "r", "telepathy")
    with pytest.raises(InputRefused, match="no plan called 'grand'"):
        generate(0, tmp_path / "r", "none", "grand")
    with pytest.raises(InputRefused, match="seed = -1"):
        generate(-1, tmp_path / "r")
    (tmp_path / "old.csv").touch()
    with pytest.raises(InputRefused, match=r"holds old\.csv"):
        generate(0, tmp_path, "none", "short")
    with pytest.raises(InputRefused, match="is a file"):
        generate(0, tmp_path / "old.csv", "none", "short")
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
def test_the_search_finds_the_strength_of_a_power_law(power: float) -> None:
    calls = []

    def residual(strength: float) -> float:
        calls.append(strength)
        return 7.0 * strength**power

    strength, left = find_strength(residual, 1e-3, 1e6, 3.0)
    assert left == pytest.approx(3.0, rel=0.02)
    assert 7.0 * strength**power == left
    assert len(calls) < 12


def test_the_search_crosses_a_threshold_and_a_plateau_and_gives_up_in_the_open() -> None:
    strength, _ = find_strength(lambda z: max(z - 2.0, 0.0), 1e-2, 1e3, 0.5)
    assert strength == pytest.approx(2.5, rel=0.01)
    strength, _ = find_strength(lambda z: 1.0 / (1.0 + np.exp(-40.0 * (z - 1.0))), 0.1, 10.0, 0.5)
    assert strength == pytest.approx(1.0, rel=0.01)
    with pytest.raises(SolverFailed, match="draw another seed"):
        find_strength(lambda z: z / (1.0 + z), 0.1, 10.0, 2.0)


def test_the_generator_imports_nothing_of_the_package_but_its_errors() -> None:
    folder = Path(studies.generator.__file__).parent
    for path in folder.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{path.name}: write imports in full"
                names = [node.module or ""]
            for name in names:
                allowed = name == "phnn.errors" or name.startswith("studies.generator")
                assert allowed or not name.startswith("phnn"), f"{path.name} imports {name}"
                assert name != "torch", path.name


@pytest.mark.slow
def test_any_seed_can_be_made(tmp_path: Path) -> None:
    # Seed 105 once made the solver stop within rounding of the end of a recording.
    drawn = {generate(seed, tmp_path / str(seed)).effect for seed in (102, 103, 104, 105)}
    assert drawn <= set(EFFECTS)
    assert len(drawn) > 1


@pytest.mark.slow
@pytest.mark.parametrize("effect", [*EFFECTS, "contact_stop"])
def test_full_plan_reaches_its_target(tmp_path: Path, effect: str) -> None:
    sealed = generate(11, tmp_path / "r", effect)
    assert sealed.effect == effect
    assert 1.4 < sealed.strength_over_noise < 10.3
    assert len(list((tmp_path / "r").glob("*.csv"))) == 12
