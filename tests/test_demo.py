"""The demonstration: recordings that conceal one effect, the seal, and the whole command."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from phnn import demo
from phnn.demo import EFFECTS, PLANS, TABLE, Drive, Made, generate, make, open_seal, seal, simulate
from phnn.errors import InputRefused
from phnn.recordings import read

SHORT = PLANS["short"]


_REFIT = demo._refit


@cache
def _refit(base: tuple[tuple[str, float], ...]) -> Callable[..., float]:
    return _REFIT(dict(base), SHORT)


@pytest.fixture(autouse=True)
def _one_refit(monkeypatch: pytest.MonkeyPatch) -> None:
    """A seed has one base, whatever it conceals: what a refit of it can take is computed once."""

    def refit(base: dict[str, float], plan: tuple[Drive, ...]) -> Callable[..., float]:
        return _refit(tuple(base.items())) if len(plan) == len(SHORT) else _REFIT(base, plan)

    monkeypatch.setattr(demo, "_refit", refit)


@cache
def made(effect: str = "none", seed: int = 5) -> Made:
    return make(seed, effect, "short")


def displacements(found: Made) -> list[np.ndarray]:
    """(N,) m of every recording, without its zero."""
    tables = [pd.read_csv(io.BytesIO(found.files[f"{drive.name}.csv"])) for drive in SHORT]
    return [1e-6 * (t["displacement_um"] - t["displacement_um"].mean()).to_numpy() for t in tables]


def test_a_seed_is_one_folder_and_another_seed_is_another(tmp_path: Path) -> None:
    sealed = generate(5, tmp_path / "a", "creep", "short")
    again = made("creep")
    assert sealed == again.sealed
    assert {p.name: p.read_bytes() for p in (tmp_path / "a").iterdir()} == again.files
    other = make(6, "creep", "short")
    assert set(other.files) == set(again.files)
    assert all(other.files[name] != content for name, content in again.files.items())


def test_a_seed_draws_its_effect_and_keeps_base_and_noise_whatever_it_conceals() -> None:
    assert make(5, None, "short").sealed.effect in EFFECTS
    plain, other = made().sealed, made("cubic_stiffness").sealed
    assert (plain.base, plain.noise, plain.quantisation) == (other.base, other.noise, other.quantisation)
    assert plain.strength_over_noise == 0.0 and plain.parameters == {}


def test_recordings_can_be_read_and_tell_nothing(tmp_path: Path) -> None:
    sealed = generate(5, tmp_path, "electrostriction", "short")
    campaign = read(tmp_path)
    assert [r.name for r in campaign.recordings] == [drive.name for drive in SHORT]
    assert {p.name for p in tmp_path.iterdir()} == {"recordings.yaml", *(f"{d.name}.csv" for d in SHORT)}
    for r, drive in zip(campaign.recordings, SHORT, strict=True):
        assert r.dt == pytest.approx(drive.dt, rel=1e-9)
        np.testing.assert_allclose(r.u, drive.u, atol=1e-9)
        assert r.interpolation == ("zero_order" if "step" in r.name else "cubic")
        # The noise floor is that of the sensor with its rounding.
        wanted = np.hypot(sealed.noise, sealed.quantisation / np.sqrt(12.0))
        assert r.noise == pytest.approx(wanted, rel=0.2)
    assert all(b"electrostriction" not in content and b"epsilon" not in content for content in made().files.values())


def test_the_actuator_is_that_of_the_paper() -> None:
    """A spring balances the held voltage, a slow loop takes energy, and without losses a step rings as it must."""
    step = SHORT[-1]
    held = simulate(TABLE, step)[step.pieces[2][0] - 1]
    # Both hysterons hold half a dead zone at most while the voltage is held.
    holding = 0.5 * (TABLE["d_1"] + TABLE["d_2"])
    least, most = (TABLE["alpha"] * v / TABLE["k"] for v in (75.0 - holding, 75.0))
    assert least < held < most
    slow = SHORT[0]
    q, u = simulate(TABLE, slow), slow.u
    period = slice(-slow.samples // 3, None)
    assert float(np.sum(u[period][1:] * np.diff(q[period]))) > 0.0
    linear = {**TABLE, "rho_1": 0.0, "rho_2": 0.0, "b": 0.0}
    stiffness = TABLE["k"] + TABLE["alpha"] ** 2 * (1.0 / TABLE["C_1"] + 1.0 / TABLE["C_2"])
    blow = replace(step, dt=1e-5, samples=1000, pieces=((0, lambda t: 1.0),))
    t = blow.t
    wanted = TABLE["alpha"] / stiffness * (1.0 - np.cos(np.sqrt(stiffness / TABLE["m"]) * t))
    np.testing.assert_allclose(simulate(linear, blow), wanted, atol=1e-10)


@pytest.mark.parametrize("effect", EFFECTS)
def test_an_effect_stands_out_of_the_noise_by_what_the_seal_says(effect: str) -> None:
    found, plain = made(effect), made()
    s = found.sealed
    assert 2.5 < s.strength_over_noise < 11.5
    assert s.location in ("mechanical", "electrical", "hysteron", "coupling", "amplifier", "sensor", "environment")
    assert all(np.isfinite(v) and v != 0.0 for v in s.parameters.values())
    # The noise is the same: what differs is the effect, and no refit makes it larger than it is.
    change = np.concatenate([a - b for a, b in zip(displacements(found), displacements(plain), strict=True)])
    assert np.sqrt(np.mean(change**2)) > 0.9 * s.strength_over_noise * s.noise
    assert np.sqrt(np.mean(change**2)) < 0.1 * max(float(np.ptp(q)) for q in displacements(plain))


def test_the_seal_opens_with_its_digest_only(tmp_path: Path) -> None:
    answer = made("creep").sealed
    data, digest = seal(answer)
    path = tmp_path / "sealed.json"
    path.write_bytes(data)
    assert open_seal(path, digest) == answer
    path.write_bytes(seal(replace(answer, effect="quadratic_drag"))[0])
    with pytest.raises(InputRefused, match="was changed after it was sealed"):
        open_seal(path, digest)
    with pytest.raises(InputRefused, match="cannot be read"):
        open_seal(tmp_path / "absent.json", digest)


@pytest.mark.parametrize(
    ("seed", "effect", "plan", "words"),
    [(-1, None, "short", "seed = -1"), (1, "gravity", "short", "gravity"), (1, None, "long", "no plan called 'long'")],
)
def test_what_cannot_be_made_is_refused(seed: int, effect: str | None, plan: str, words: str) -> None:
    with pytest.raises(InputRefused, match=words):
        make(seed, effect, plan)


@pytest.mark.slow
def test_the_command_ends_with_the_line_of_the_contract(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "phnn.cli", "demo", "--seed", "7", "--out", str(tmp_path / "out")]
    found = subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path)
    digest = found.stdout.partition("SHA-256 ")[2].split()[0]
    sealed = open_seal(tmp_path / "out" / "seal" / "sealed.json", digest)
    name = sealed.effect
    assert found.stdout.splitlines()[-1] == f"sealed: {name}  verdict: named  named: {name}  class: {name}"
    assert json.loads((tmp_path / "out" / "diagnosis" / "diagnosis.json").read_text())["verdict"] == "named"
    assert make(7).files == {p.name: p.read_bytes() for p in (tmp_path / "out" / "recordings").iterdir()}
