"""The manifest: what it may say of files, segments and the sensor, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.io
from recordings_example import output, refused, sine, write, write_sine

from phnn.recordings import read
from phnn.recordings.reader import describe

COLUMNS = "columns: {voltage: {column: 0, unit: V}, displacement: {column: 1, unit: um}}\nsample_rate_hz: 4000\n"


def loops(folder: Path, name: str = "loops.dat") -> tuple[np.ndarray, np.ndarray]:
    """A headerless text file: voltage in V, displacement in um, 4 kHz."""
    _, u = sine(10.0, 75.0, cycles=8)
    y = output(u)
    np.savetxt(folder / name, np.column_stack([u, 1e6 * y]), fmt="%.17g")
    return u, y


def manifest(folder: Path, text: str) -> Path:
    path = folder / "recordings.yaml"
    path.write_text(text)
    return path


def test_entries_override_common_keys(tmp_path: Path) -> None:
    u, y = loops(tmp_path)
    loops(tmp_path, "b.dat")
    manifest(
        tmp_path,
        COLUMNS + "start: unknown\nrecordings:\n"
        "  - {file: loops.dat, sample_rate_hz: 2000, start: rest, columns: {displacement: {unit: nm}}}\n  - b.dat\n",
    )
    a, b = read(tmp_path).recordings
    assert (a.dt, b.dt) == (pytest.approx(1 / 2000), pytest.approx(1 / 4000))
    assert (a.start.state, b.start.state) == ("rest", "unknown")
    assert np.allclose(a.y, 1e-3 * y, atol=1e-15)
    assert np.allclose(b.y, y)
    assert np.allclose(a.u, u)


def test_absent_manifest(tmp_path: Path) -> None:
    refused(tmp_path, "no.yaml", "--manifest", manifest=tmp_path / "no.yaml")


def test_files_that_are_not_listed_are_left_alone(tmp_path: Path) -> None:
    write_sine(tmp_path, "a", 1.0, 10.0)
    write_sine(tmp_path, "b", 2.0, 10.0)
    (tmp_path / "LICENSE").write_text("free")
    manifest(tmp_path, "recordings: [{file: a.csv}]")
    campaign = read(tmp_path)
    assert [r.name for r in campaign.recordings] == ["a"]
    assert any("LICENSE" in n and "b.csv" in n for n in campaign.notes)


def test_undescribed_numbers_are_left_alone_with_the_reason(tmp_path: Path) -> None:
    write_sine(tmp_path, "a", 1.0, 10.0)
    loops(tmp_path)
    assert any("loops.dat (numbers that nothing describes" in n for n in read(tmp_path).notes)
    (tmp_path / "a.csv").unlink()
    refused(tmp_path, "no recordings", "loops.dat", "recordings.yaml")


@pytest.mark.parametrize(("text", "words"), [
    ("recordings: [{file: loops.dat, usage: confirmation}]", ("recordings[0]", "'usage'", "use")),
    ("recordings: [{name: x}]", ("recordings[0]", "no `file`")), ("recordings: []", ("must be a list",)),
    ("offset: common", ("offset: 'common' is not known: accepted are own, shared",)),
    ("setup: {model: hrc, hysterons: 1.5}", ("hysterons", "1.5")),
    ("setup: {network: gone.yaml}", ("gone.yaml", "network file")),
    ("voltage: battery", ("'battery'", "command", "terminals")), ("known: {m: heavy}", ("known: m",)),
    ("known: {m: {value: 1, std: -1}}", ("negative",)),
    ("start: {state: moving}", ("'moving'", "rest", "unknown", "periodic")),
    ("start: {state: unknown, input_before: 3}", ("input_before", "rest")),
    ("input: spline", ("'spline'", "band_limited")), ("periodic: maybe", ("'maybe'", "true")),
    ("sample_rate_hz: -3", ("sample_rate_hz", "-3")),
    ("columns: {voltage: {column: 0, unit: um}}", ("voltage cannot be in um",)),
    ("columns: {volts: {column: 0, unit: V}}", ("'volts'", "voltage")),
    ("columns: {voltage: {column: -1, unit: V}}", ("-1",)),
    ("recordings: [{file: loops.dat, slice: [5, 3]}]", ("slice", "[5, 3]")),
    ("recordings: [{file: loops.dat, use: training}]", ("'training'", "identification")),
    ("a: [1, 2", ("not readable as yaml", "line")), ("- 1\n- 2", ("keys and values",)),
])  # fmt: skip
def test_refused(tmp_path: Path, text: str, words: tuple[str, ...]) -> None:
    loops(tmp_path)
    manifest(tmp_path, text)
    refused(tmp_path, "recordings.yaml", *words)


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("{file: loops.dat, slice: [0, 99999]}", ("slice", "99999", "3200 samples")),
        ("{file: loops.dat, columns: {displacement: {column: 9}}}", ("column 9", "2 columns", "0 to 1")),
        ("{file: loops.dat, columns: {displacement: {column: sensor}}}", ("'sensor'", "no names")),
        ("{file: loops.dat, variables: {voltage: V1}}", ("'V1'",)),
        ("{file: loops.dat, periodic: true, slice: [0, 500]}", ("periodic: true", "does not repeat")),
        ("{file: notes.md}", ("notes.md", "unknown format", ".csv")),
    ],
)
def test_entries_that_do_not_fit_the_file(tmp_path: Path, entry: str, words: tuple[str, ...]) -> None:
    loops(tmp_path)
    (tmp_path / "notes.md").write_text("x")
    manifest(tmp_path, COLUMNS + f"recordings: [{entry}]")
    refused(tmp_path, *words)


def test_start_defaults(tmp_path: Path) -> None:
    write_sine(tmp_path, "zero", 1.0, 10.0)
    text = (tmp_path / "zero.csv").read_text().splitlines()
    (tmp_path / "later.csv").write_text("\n".join([text[0], *text[60:]]))
    later, zero = read(tmp_path).recordings
    assert (zero.start.state, zero.start.input_before) == ("rest", 0.0)
    assert later.start.state == "unknown"
    assert zero.interpolation == "cubic"


def test_an_input_before_is_a_number_of_the_file(tmp_path: Path) -> None:
    """A heater that ran at 25 % before the first row, in a column of percent that begins at 40 %."""
    t, u = sine(0.1, 10.0)
    write(tmp_path / "oven.csv", t, 40.0 + u, 30.0 + output(u) * 1e5, "time_s,drive_percent,oven_degC")
    columns = "columns: {input: {column: drive_percent, unit: percent}, output: {column: oven_degC, unit: degC}}\n"
    manifest(tmp_path, f"setup: {{model: heated_body}}\n{columns}start: {{state: rest, input_before: 25}}\n")
    campaign = read(tmp_path)
    assert campaign.recordings[0].start.input_before == pytest.approx(0.25)
    assert "rest, input 0.25 before" in describe(campaign)


def test_a_force_drives_other_systems(tmp_path: Path) -> None:
    path = write_sine(tmp_path, "a", 1.0, 10.0)
    path.write_text(path.read_text().replace("voltage_V", "force_mN"))
    refused(tmp_path, "no voltage column")
    manifest(tmp_path, "setup: {model: linear}")
    assert np.ptp(read(tmp_path).recordings[0].u) == pytest.approx(0.02, rel=1e-3)


@pytest.mark.parametrize("unit", ["grams of lead", "", "degC"])
def test_a_known_value_in_no_unit_is_refused(unit: str, tmp_path: Path) -> None:
    write_sine(tmp_path, "a", 10.0, 60.0)
    manifest(tmp_path, f"known: {{m: {{value: 1.06, unit: '{unit}'}}}}\n")
    refused(tmp_path, "known: m: unit")


def test_a_heavy_mass_without_a_unit_is_doubted(tmp_path: Path) -> None:
    write_sine(tmp_path, "a", 10.0, 60.0)
    for said, doubts in (("1.06", 1), ("{value: 1.06, unit: kg}", 0), ("1.06e-3", 0)):
        manifest(tmp_path, f"known: {{m: {said}}}\n")
        assert sum("add unit: g" in note for note in read(tmp_path).notes) == doubts


@pytest.mark.parametrize(
    ("header", "stated"), [("pos [um]", "nm"), ("pos_um", "nm"), ("weg (nm)", "um"), ("displacement_um", "nm")]
)
def test_the_unit_of_the_manifest_wins_over_the_name_and_that_is_said(header: str, stated: str, tmp_path: Path) -> None:
    t, u, y = three()[0]
    write(tmp_path / "a.csv", t, u, 1e6 * y, f"time_s,voltage_V,{header}")
    manifest(tmp_path, f"columns: {{displacement: {{column: 2, unit: {stated}}}}}\n")
    campaign = read(tmp_path)
    assert np.allclose(campaign.recordings[0].y, {"nm": 1e-9, "um": 1e-6}[stated] * 1e6 * y)
    assert any("the file says" in note and f"recordings.yaml says {stated}" in note for note in campaign.notes)
    manifest(tmp_path, f"columns: {{displacement: {{column: 2, unit: {stated}, scale: 2}}}}\n")
    assert np.allclose(read(tmp_path).recordings[0].y, {"nm": 2e-9, "um": 2e-6}[stated] * 1e6 * y)
    manifest(tmp_path, "columns: {displacement: {column: 2}}\n")
    size = 1e-9 if "nm" in header else 1e-6
    assert np.allclose(read(tmp_path).recordings[0].y, size * 1e6 * y)


@pytest.mark.parametrize("header", ["pos_m", "pos_N", "monitor [a.u.]", "signal_mV"])
def test_a_last_word_that_is_no_unit_of_the_quantity_says_nothing(header: str, tmp_path: Path) -> None:
    t, u, y = three()[0]
    write(tmp_path / "a.csv", t, u, 1e6 * y, f"time_s,voltage_V,{header}")
    manifest(tmp_path, "columns: {displacement: {column: 2, unit: um}}\n")
    assert np.allclose(read(tmp_path).recordings[0].y, y)


def test_the_folder_of_a_result_is_refused(tmp_path: Path) -> None:
    (tmp_path / ".phnn").mkdir()
    (tmp_path / "diagnosis.json").write_text("{}")
    refused(tmp_path, "holds a result of phnn (diagnosis.json)")
    write_sine(tmp_path, "a", 10.0, 60.0)
    manifest(tmp_path, "voltage: command\n")
    assert len(read(tmp_path).recordings) == 1


def test_column_index_in_a_mat_file(tmp_path: Path) -> None:
    scipy.io.savemat(tmp_path / "a.mat", {"V1": np.arange(100.0)})
    manifest(tmp_path, COLUMNS)
    refused(tmp_path, "a.mat", "column 0", "variables", "V1")


def three() -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    drives = [sine(10.0, amplitude) for amplitude in (75.0, 50.0, 25.0)]
    return [(t, u, output(u, seed=i)) for i, (t, u) in enumerate(drives)]


def test_segments_of_a_number_of_samples_within_a_slice(tmp_path: Path) -> None:
    rows = np.concatenate([np.column_stack(columns) for columns in three()])
    np.save(tmp_path / "a.npy", rows)
    said = (
        "columns: {voltage: {column: 1, unit: V}, displacement: {column: 2, unit: m}}\nsample_rate_hz: 4000\n"
        "recordings: [{file: a.npy, name: run, slice: [1200, 3600], segments: SIZE}]"
    )
    (tmp_path / "recordings.yaml").write_text(said.replace("SIZE", "1200"))
    campaign = read(tmp_path)
    assert [r.name for r in campaign.recordings] == ["run_1", "run_2"]
    np.testing.assert_array_equal(campaign.recordings[0].u, three()[1][1])
    (tmp_path / "recordings.yaml").write_text(said.replace("SIZE", "1000"))
    refused(tmp_path, "a.npy", "2400 samples", "segments of 1000", "slice")
    (tmp_path / "recordings.yaml").write_text(said.replace("SIZE", "true"))
    refused(tmp_path, "a.npy", "no time column", "segments: 8192")
    (tmp_path / "recordings.yaml").write_text(said.replace("SIZE", "-3"))
    refused(tmp_path, "recordings[0]: segments", "-3", "number of samples")


def test_extremes_in_pairs_are_taken_by_their_means(tmp_path: Path) -> None:
    t, u, y = three()[0]
    spread = 3e-8 * np.tile([-1.0, 1.0], t.size)
    write(tmp_path / "a.csv", np.repeat(t, 2), np.repeat(u, 2), np.repeat(y, 2) + spread)
    campaign = read(tmp_path)
    r = campaign.recordings[0]
    np.testing.assert_allclose(r.t, t, atol=1e-12)
    np.testing.assert_array_equal(r.u, u)
    np.testing.assert_allclose(r.y, y, atol=1e-20)
    assert any("least and largest" in note for note in campaign.notes)


def test_a_record_that_begins_before_its_trigger_is_at_rest(tmp_path: Path) -> None:
    t, u, y = three()[0]
    quiet = np.arange(-100, 0) * t[1]
    write(
        tmp_path / "a.csv",
        np.concatenate([quiet, t]),
        np.concatenate([np.zeros(100), u]),
        np.concatenate([np.full(100, 1.2345e-6), y]),
    )
    r = read(tmp_path).recordings[0]
    assert r.start.state == "rest"
    assert r.t[0] == 0.0 and r.t.size == t.size + 100


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
    # A limit on one side leaves the other one clipped.
    clipped(tmp_path, "sensor: {saturates: [null, 20 um]}\n")
    refused(tmp_path, "clipped", "smallest")


def test_every_recording_may_have_a_sensor_of_its_own(tmp_path: Path) -> None:
    for name in "ab":
        write_sine(tmp_path, name, 10.0, 75.0)
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
