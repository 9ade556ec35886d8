"""Cases whose seals are published: what a seed and a stratum give never changes."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from studies.generator import draw_case, generate, make_case, write_seal

# SHA-256 of what drives the recordings (see `digest`) and of the seal. The seal of a case that conceals nothing holds
# drawn numbers only: its bytes are the same on every machine. Displacements are not, for the linear algebra of a
# processor decides on their last bits and with them on steps of the sensor: of each recording there is one sum (see
# `sums`), which other noise would change by many times its tolerance.
NOTHING = {
    (3, "few"): (
        "9edd3dd36764e1780c9440c27a1a02e3338eb59be4433fa51cdbbc3e34d44a0d",
        "0920fe9be4066fbbb39dc7b46e34148767c034185ebfac8f50b6ab7a668390ac",
        [-434.023, -1347.922],
    ),
    (4, "full"): (
        "3b1f3dc08b4bb240e5da99c75c33d0ba40b614b01146e710a532a5958062f049",
        "07ac120a7d894c9aae94599ca74033c17f3695bdde26fbb9dd4094dcedb889c5",
        [
            -5368.393,
            -5119.411,
            -9745.03,
            1477.383,
            -682.28,
            2141.799,
            2043.183,
            -2000.252,
            -6417.821,
            -634.168,
            -741.499,
            -93.888,
            -7202.717,
        ],
    ),
}
DEMONSTRATION = (
    "414fb69c4ed6f588da11547528849065cfd936fcb85a74530dab1749718f08c8",
    [1089.395, 1898.884, 1703.728, -742.087],
)
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
# Sums agree to so much [µm] on every processor, and strengths, which a search finds, to this share.
TOLERANCE, STRENGTH = 0.1, 3e-4
CREEP = {"k_s": 415.4522693491226, "tau_s": 0.06980558381314267}


def digest(folder: Path) -> str:
    """Hash of the manifest, of all times and voltages; these to a nanovolt, for the last bit of a sine depends on the
    processor."""
    found = hashlib.sha256((folder / "recordings.yaml").read_bytes())
    for path in sorted(folder.glob("*.csv")):
        table = pd.read_csv(path)[["time_s", "voltage_V"]]
        found.update(path.name.encode())
        found.update(table.round(9).to_csv(index=False, float_format="%.9f").encode())
    return found.hexdigest()


def sums(folder: Path) -> list[float]:
    """Of each recording the displacements, µm, with weights that no motion follows."""
    found = []
    for path in sorted(folder.glob("*.csv")):
        y = pd.read_csv(path)["displacement_um"].to_numpy()
        found.append(float(np.cos(0.7 * np.arange(y.size) ** 2 % (2.0 * np.pi)) @ y))
    return found


@pytest.mark.parametrize("chosen", list(NOTHING), ids=lambda chosen: "-".join(map(str, chosen)))
def test_a_case_that_conceals_nothing_stays_what_it_was(tmp_path: Path, chosen: tuple[int, str]) -> None:
    seed, plan = chosen
    sealed = make_case(draw_case(seed, "none", plan), tmp_path / "recordings")
    seal = write_seal(sealed, tmp_path / "sealed.json")
    driven, sealed_by, expected = NOTHING[chosen]
    assert (digest(tmp_path / "recordings"), seal) == (driven, sealed_by)
    assert sums(tmp_path / "recordings") == pytest.approx(expected, abs=TOLERANCE)


def test_a_concealed_effect_stays_what_it_was(tmp_path: Path) -> None:
    sealed = make_case(draw_case(21, "same", "few"), tmp_path / "recordings")
    write_seal(sealed, tmp_path / "sealed.json")
    content = json.loads((tmp_path / "sealed.json").read_text(encoding="utf-8"))
    assert set(content) == KEYS
    assert sealed.effect == "sensor_nonlinearity"
    assert sealed.parameters == pytest.approx(PARAMETERS, rel=STRENGTH)
    assert sealed.delta == pytest.approx(DELTA, rel=STRENGTH)


def test_the_demonstration_stays_what_it_was(tmp_path: Path) -> None:
    sealed = generate(5, tmp_path / "recordings", "creep", "short")
    driven, expected = DEMONSTRATION
    assert digest(tmp_path / "recordings") == driven
    assert sums(tmp_path / "recordings") == pytest.approx(expected, abs=TOLERANCE)
    assert sealed.parameters == pytest.approx(CREEP, rel=STRENGTH)
