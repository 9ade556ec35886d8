"""Cases whose seals are published: what a seed and a stratum give never changes."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pandas as pd
import pytest

from phnn.demo import draw_case, generate, make_case, write_seal

# SHA-256 of the recordings (see `digest`) and of the seal, as the generator wrote them before it had noise families and
# kinked inputs. The seal of a case that conceals nothing holds drawn numbers only: its bytes are the same on every
# machine.
NOTHING = {
    (3, "few"): (
        "89ebab1bc5dd3a7f99563c8bc66499d44d3935d5ec0ab0f282fdcdd85e4f3537",
        "0920fe9be4066fbbb39dc7b46e34148767c034185ebfac8f50b6ab7a668390ac",
    ),
    (4, "full"): (
        "2712fc53a4c4ecea778bf6acce1bad369bb0e5c2235272864eac8b58f4e514d1",
        "07ac120a7d894c9aae94599ca74033c17f3695bdde26fbb9dd4094dcedb889c5",
    ),
}
KEYS = {
    "apart",
    "base",
    "colour",
    "delta",
    "deltas",
    "effect",
    "effects",
    "form",
    "levels",
    "location",
    "noise",
    "parameters",
    "plan",
    "quantisation",
    "redrawn",
    "seed",
    "stratum",
    "strength_over_noise",
    "withheld",
}
PARAMETERS, DELTA = {"a_2": 181.23941968713712, "a_3": -480798.26460422185}, 519.9229033283128
CREEP = {"k_s": 415.4522693491226, "tau_s": 0.06980558381314267}


def digest(folder: Path) -> str:
    """Hash of all samples; voltages to a nanovolt, for the last bit of a sine depends on the processor."""
    found = hashlib.sha256((folder / "recordings.yaml").read_bytes())
    for path in sorted(folder.glob("*.csv")):
        table = pd.read_csv(path)
        found.update(path.name.encode())
        found.update(table.round(9).to_csv(index=False, float_format="%.9f").encode())
    return found.hexdigest()


@pytest.mark.parametrize("chosen", list(NOTHING), ids=lambda chosen: "-".join(map(str, chosen)))
def test_a_case_that_conceals_nothing_stays_what_it_was(tmp_path: Path, chosen: tuple[int, str]) -> None:
    seed, plan = chosen
    sealed = make_case(draw_case(seed, "none", plan), tmp_path / "recordings")
    seal = write_seal(sealed, tmp_path / "sealed.json")
    assert (digest(tmp_path / "recordings"), seal) == NOTHING[chosen]


def test_a_concealed_effect_stays_what_it_was(tmp_path: Path) -> None:
    sealed = make_case(draw_case(21, "same", "few"), tmp_path / "recordings")
    write_seal(sealed, tmp_path / "sealed.json")
    content = json.loads((tmp_path / "sealed.json").read_text(encoding="utf-8"))
    assert set(content) == KEYS
    assert sealed.effect == "sensor_nonlinearity"
    assert sealed.parameters == pytest.approx(PARAMETERS, rel=1e-9)
    assert sealed.delta == pytest.approx(DELTA, rel=1e-6)


def test_the_demonstration_stays_what_it_was(tmp_path: Path) -> None:
    sealed = generate(5, tmp_path / "recordings", "creep", "short")
    assert digest(tmp_path / "recordings") == "eeec39e11e95d9808ee89cd5b6f38e42007df5042cc42133a77c2d973a8b6f7b"
    assert sealed.parameters == pytest.approx(CREEP, rel=1e-9)
