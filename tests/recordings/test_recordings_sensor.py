"""What the manifest says of the sensor."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recordings_example import output, refused, sine, write

from phnn.recordings import read
from phnn.recordings.describe import describe

LIMIT = 2e-5


def clipped(folder: Path, manifest: str = "") -> None:
    t, u = sine(10.0, 75.0)
    write(folder / "a.csv", t, u, np.clip(output(u), -LIMIT, LIMIT))
    if manifest:
        (folder / "recordings.yaml").write_text(manifest)


def test_a_clipped_output_is_refused_unless_the_sensor_is_known_to_saturate(tmp_path: Path) -> None:
    clipped(tmp_path)
    refused(tmp_path, "clipped", "saturates")
    clipped(tmp_path, "sensor: {saturates: [-20 um, 20 um]}\n")
    campaign = read(tmp_path)
    (r,) = campaign.recordings
    assert r.sensor.saturates == pytest.approx((-LIMIT, LIMIT))
    assert set(np.unique(r.sensor.at_limit(r.y))) == {-1, 0, 1}
    assert 30e-9 < r.noise < 80e-9
    assert "saturates at -20 µm and 20 µm" in describe(campaign)


def test_a_limit_on_one_side_leaves_the_other_one_clipped(tmp_path: Path) -> None:
    clipped(tmp_path, "sensor: {saturates: [null, 20 um]}\n")
    refused(tmp_path, "clipped", "smallest")


def test_every_recording_may_have_a_sensor_of_its_own(tmp_path: Path) -> None:
    for name in "ab":
        t, u = sine(10.0, 75.0)
        write(tmp_path / f"{name}.csv", t, u, output(u))
    (tmp_path / "recordings.yaml").write_text(
        "sensor: {lag: 2 ms}\nrecordings: [a.csv, {file: b.csv, sensor: {rectified: true, derivative: true}}]\n"
    )
    a, b = read(tmp_path).recordings
    assert a.sensor.lag == 2e-3
    assert b.sensor.rectified and b.sensor.derivative and b.sensor.lag == 0.0


@pytest.mark.parametrize(("said", "words"), [
    ("{saturates: [0, 10]}", ("has no unit", "10 V")), ("{saturates: [0 m]}", ("no pair of limits", "[0 V, 10 V]")),
    ("{saturates: [null, null]}", ("no pair of limits",)), ("{saturates: 10 m}", ("no pair of limits",)),
    ("{saturates: [10 um, -10 um]}", ("lower limit first",)), ("{saturates: [0 V, 1 m]}", ("in one unit",)),
    ("{saturates: [0 V, 10 V]}", ("units of m", "give them in the unit of the output")),
    ("{saturates: [.nan, 1 m]}", ("no number with a unit", "nan")),
    ("{saturates: [nan m, 1 m]}", ("no number with a unit",)),
    ("{saturates: [0 m**99999, 1 m]}", ("no number with a unit",)), ("{lag: 2}", ("has no unit", "2 ms")),
    ("{lag: 2 V}", ("no time constant",)), ("{lag: -2 ms}", ("no time constant",)),
    ("{rectified: 1}", ("neither true nor false",)), ("{saturate: [0 m, 1 m]}", ("did you mean saturates?",)),
    ("yes please", ("expected keys and values",)),
])  # fmt: skip
def test_what_is_not_understood_is_refused(tmp_path: Path, said: str, words: tuple[str, ...]) -> None:
    clipped(tmp_path, f"sensor: {said}\n")
    refused(tmp_path, "sensor", *words)
