"""Every check refuses what it should, names the place and the remedy, and lets good recordings pass."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recordings_example import output, play, refused, sine, write, write_sine

from phnn.errors import InputRefused
from phnn.recordings import read


def good() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    t, u = sine(10.0, 75.0)
    return t, u, output(u)


def test_missing_folder(tmp_path: Path) -> None:
    refused(tmp_path / "absent", "absent", "no such folder")


def test_file_instead_of_folder(tmp_path: Path) -> None:
    refused(write_sine(tmp_path, "a", 1.0, 10.0), "this is a file", "folder")


def test_empty_folder(tmp_path: Path) -> None:
    refused(tmp_path, "no recordings", "it is empty", "voltage_V")


def test_folder_without_recordings_names_what_it_holds(tmp_path: Path) -> None:
    (tmp_path / "README.md").write_text("hello")
    refused(tmp_path, "no recordings", "README.md")


def test_no_voltage_column(tmp_path: Path) -> None:
    write(tmp_path / "a.csv", *good(), header="time_s,tension_V,displacement_m")
    refused(tmp_path, "a.csv", "no voltage column", "tension_V", "recordings.yaml")


def test_no_displacement_column(tmp_path: Path) -> None:
    write(tmp_path / "a.csv", *good(), header="time_s,voltage_V,position_m")
    refused(tmp_path, "a.csv", "no displacement column", "position_m")


def test_no_time_and_no_rate(tmp_path: Path) -> None:
    write(tmp_path / "a.csv", *good(), header="when,voltage_V,displacement_m")
    refused(tmp_path, "a.csv", "no time column", "sample_rate_hz")


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ("time_s,voltage_V,displacement", ("displacement", "no unit", "displacement_m")),
        ("time_s,voltage_V,displacement_furlong", ("displacement_furlong", "correct the unit")),
        ("time_s,voltage_V,displacement_umm", ("unknown unit 'umm'", "um")),
        ("time_s,voltage_V,displacement_Um", ("unknown unit 'Um'", "did you mean um?")),
        ("time_s,voltage_v,displacement_m", ("unknown unit 'v'", "did you mean V?")),
        ("time_s,voltage_V,displacement_V", ("displacement cannot be in V",)),
        ("time_m,voltage_V,displacement_m", ("time cannot be in m",)),
    ],
)
def test_ambiguous_units(tmp_path: Path, header: str, words: tuple[str, ...]) -> None:
    write(tmp_path / "a.csv", *good(), header=header)
    refused(tmp_path, "a.csv", *words)


def test_two_columns_of_one_quantity(tmp_path: Path) -> None:
    write(tmp_path / "a.csv", *good(), header="time_s,displacement_um,displacement_m")
    refused(tmp_path, "displacement_um", "displacement_m", "keep one")


def test_name_that_only_resembles_a_quantity_is_left_alone(tmp_path: Path) -> None:
    t, u, y = good()
    rows = "\n".join(f"{a!r},{b!r},{c!r},0" for a, b, c in zip(t.tolist(), u.tolist(), y.tolist(), strict=True))
    (tmp_path / "a.csv").write_text("time_s,voltage_V,displacement_m,voltage_monitor\n" + rows)
    campaign = read(tmp_path)
    assert any("voltage_monitor" in note for note in campaign.notes)


@pytest.mark.parametrize("column", [0, 1, 2])
@pytest.mark.parametrize("value", [np.nan, np.inf, 9.9e37])
def test_nan_and_infinity(tmp_path: Path, column: int, value: float) -> None:
    columns = [c.copy() for c in good()]
    columns[column][41] = value
    write(tmp_path / "a.csv", *columns)
    refused(tmp_path, "a.csv", ("time_s", "voltage_V", "displacement_m")[column], "row 42 (line 43)", "slice")


def test_cell_that_is_no_number(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", *good())
    lines = path.read_text().splitlines()
    lines[10] = lines[10].rsplit(",", 1)[0] + ",overload"
    path.write_text("\n".join(lines))
    refused(tmp_path, "displacement_m", "row 10 (line 11)", "'overload'")


def test_gap(tmp_path: Path) -> None:
    t, u, y = good()
    keep = np.r_[0:500, 520 : t.size]
    write(tmp_path / "a.csv", t[keep], u[keep], y[keep])
    refused(tmp_path, "row 501 (line 502)", "gap", "split")


def test_time_going_back(tmp_path: Path) -> None:
    t, u, y = good()
    t = t.copy()
    t[300] = t[298] - 1e-6
    write(tmp_path / "a.csv", t, u, y)
    refused(tmp_path, "row 301", "time goes back", "sort")


def test_two_rows_with_one_time(tmp_path: Path) -> None:
    t, u, y = good()
    t = t.copy()
    t[300] = t[299]
    write(tmp_path / "a.csv", t, u, y)
    refused(tmp_path, "row 301", "two rows with one time", "digits")


def test_constant_output(tmp_path: Path) -> None:
    t, u, y = good()
    write(tmp_path / "a.csv", t, u, np.full_like(y, 2e-6))
    refused(tmp_path, "displacement_m", "constant", "2e-06")


def test_constant_input(tmp_path: Path) -> None:
    t, u, y = good()
    write(tmp_path / "a.csv", t, np.full_like(u, 20.0), y)
    refused(tmp_path, "voltage_V", "constant", "input_before")


def test_constant_input_after_a_stated_step_is_a_recording(tmp_path: Path) -> None:
    t, u, y = good()
    write(tmp_path / "a.csv", t, np.full_like(u, 20.0), y)
    (tmp_path / "recordings.yaml").write_text("start: {state: rest, input_before: 0.0}\n")
    assert read(tmp_path).recordings[0].start.state == "rest"


@pytest.mark.parametrize("level", [20.0, 0.0])
def test_a_slice_with_a_constant_input_is_read_where_its_start_is_said_to_be_unknown(
    tmp_path: Path, level: float
) -> None:
    t, u, y = good()
    write(tmp_path / "a.csv", t, np.full_like(u, level), y)
    write_sine(tmp_path, "b", 5.0, 40.0)
    (tmp_path / "recordings.yaml").write_text("recordings: [{file: a.csv, start: unknown}, {file: b.csv}]")
    assert {r.name: r.start.state for r in read(tmp_path).recordings}["a"] == "unknown"


@pytest.mark.parametrize("level", [0.8, 0.95])
def test_clipped_sensor(tmp_path: Path, level: float) -> None:
    t, u, y = good()
    write(tmp_path / "a.csv", t, u, np.minimum(y, level * y.max()))
    refused(tmp_path, "displacement_m", "clipped", "largest", "row ", "range")


def test_flat_bottom_is_refused_too(tmp_path: Path) -> None:
    t, u, y = good()
    write(tmp_path / "a.csv", t, u, np.maximum(y, 0.7 * y.min()))
    refused(tmp_path, "clipped", "smallest")


@pytest.mark.parametrize("step", [20e-9, 0.2e-6, 1e-6])
def test_quantised_reversals_are_not_clipping(tmp_path: Path, step: float) -> None:
    t, u = sine(10.0, 75.0, samples=2000)
    write(tmp_path / "a.csv", t, u, output(u, noise=0.0, step=step))
    assert read(tmp_path).recordings[0].y.size == t.size


def test_holds_and_rests_are_not_clipping(tmp_path: Path) -> None:
    t = np.arange(2000) * 1e-3
    u = np.interp(t, [0.3, 0.6, 1.4, 1.7], [0.0, 50.0, 50.0, 0.0])
    write(tmp_path / "a.csv", t, u, 1e-6 * play(u, 5.0))
    assert read(tmp_path).recordings[0].y.size == t.size


@pytest.mark.parametrize("radius", [2.0, 10.0, 40.0])
def test_backlash_is_not_clipping(tmp_path: Path, radius: float) -> None:
    t, u = sine(10.0, 75.0)
    write(tmp_path / "a.csv", t, u, 1e-6 * play(u, radius))
    assert read(tmp_path).recordings[0].y.size == t.size


@pytest.mark.parametrize("count", [1, 49])
def test_too_few_samples(tmp_path: Path, count: int) -> None:
    t, u, y = good()
    write(tmp_path / "a.csv", t[:count], u[:count], y[:count])
    refused(tmp_path, "a.csv", f"{count} sample", "at least 50")


def test_large_jitter(tmp_path: Path) -> None:
    t, u, y = good()
    jitter = np.random.default_rng(1).uniform(-0.05, 0.05, t.size) * t[1]
    write(tmp_path / "a.csv", t + jitter, u, y)
    refused(tmp_path, "jittered", "row ", "uniform")


def test_small_jitter_is_put_on_a_grid(tmp_path: Path) -> None:
    t, _ = sine(10.0, 75.0)
    jittered = t + np.random.default_rng(1).uniform(-0.009, 0.009, t.size) * t[1]
    u = 75.0 * np.sin(2.0 * np.pi * 10.0 * jittered)
    write(tmp_path / "a.csv", jittered, u, 1e-6 * u)
    campaign = read(tmp_path)
    r = campaign.recordings[0]
    assert any("jitters" in note for note in campaign.notes)
    assert np.allclose(np.diff(r.t), r.dt, rtol=1e-9)
    truth = 75.0 * np.sin(2.0 * np.pi * 10.0 * (r.t + jittered[0]))
    # the grid's phase is known to a hundredth of an interval
    assert np.abs(r.u - truth).max() < 75.0 * 2.0 * np.pi * 10.0 * 0.012 * t[1]


def test_rounded_times_are_no_jitter(tmp_path: Path) -> None:
    t = np.arange(900) / 30_000.0
    u = 50.0 * np.sin(2.0 * np.pi * 100.0 * t)
    rows = "\n".join(f"{a:.6f},{b!r},{c!r}" for a, b, c in zip(t, u.tolist(), (1e-6 * u).tolist(), strict=True))
    (tmp_path / "a.csv").write_text("time_s,voltage_V,displacement_m\n" + rows)
    campaign = read(tmp_path)
    assert campaign.recordings[0].dt == pytest.approx(1 / 30_000.0, rel=1e-5)
    assert any("rounded" in note for note in campaign.notes)
    assert np.array_equal(campaign.recordings[0].u, u)


def test_one_file_with_two_rates(tmp_path: Path) -> None:
    t = np.r_[np.arange(500) * 1e-3, 0.5 + np.arange(500) * 2e-3]
    u = np.sin(10.0 * t)
    write(tmp_path / "a.csv", t, u, 1e-6 * u)
    refused(tmp_path, "rate changes", "1000 Hz", "500 Hz", "row 502", "split")


def test_rates_may_differ_between_files(tmp_path: Path) -> None:
    write_sine(tmp_path, "a", 1.0, 10.0)
    write_sine(tmp_path, "b", 10.0, 10.0)
    assert any("different rates" in note for note in read(tmp_path).notes)


def test_decimal_commas(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", *good())
    head, body = path.read_text().split("\n", 1)
    path.write_text(head + "\n" + body.replace(".", ","))
    refused(tmp_path, "a.csv", "line 2", "comma as decimal sign")


@pytest.mark.parametrize("row", [1, 5])
def test_a_damaged_row_is_no_header(tmp_path: Path, row: int) -> None:
    path = write(tmp_path / "a.csv", *good())
    lines = path.read_text().splitlines()
    cells = lines[row].split(",")
    lines[row] = ",".join([cells[0], "12.x", cells[2]])
    path.write_text("\n".join(lines))
    refused(tmp_path, "a.csv", f"line {row + 1}", "'12.x'", "not a number", "correct or delete")


def test_a_text_among_decimal_commas_is_named_as_it_stands(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", *good())
    lines = path.read_text().replace(",", ";").replace(".", ",").splitlines()
    lines[30] = lines[30].replace(lines[30].split(";")[1], "overrange")
    path.write_text("\n".join(lines))
    refused(tmp_path, "a.csv", "row 30 (line 31)", "'overrange'", "not a number")


def test_ragged_rows(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", *good())
    lines = path.read_text().splitlines()
    lines[20] += ",7"
    path.write_text("\n".join(lines))
    refused(tmp_path, "a.csv", "line 21", "4 cells")


@pytest.mark.parametrize("suffix", [".csv", ".mat", ".npy"])
@pytest.mark.parametrize("seed", range(5))
def test_random_bytes(tmp_path: Path, suffix: str, seed: int) -> None:
    name = f"a{suffix}"
    (tmp_path / name).write_bytes(np.random.default_rng(seed).bytes(3000))
    refused(tmp_path, name)


@pytest.mark.parametrize("suffix", [".csv", ".mat", ".npy", ".dat"])
def test_empty_files(tmp_path: Path, suffix: str) -> None:
    (tmp_path / f"a{suffix}").write_bytes(b"")
    refused(tmp_path, f"a{suffix}")


def test_damaged_mat(tmp_path: Path) -> None:
    import scipy.io

    t, u, y = good()
    scipy.io.savemat(tmp_path / "a.mat", {"time_s": t, "voltage_V": u, "displacement_m": y})
    whole = (tmp_path / "a.mat").read_bytes()
    (tmp_path / "a.mat").write_bytes(whole[: len(whole) // 2])
    refused(tmp_path, "a.mat", "save it again")


@pytest.mark.parametrize("byte", [145, 172, 184, 185])
def test_damaged_tags_in_a_mat_file_do_not_crash_the_reader(tmp_path: Path, byte: int) -> None:
    import scipy.io

    t, u, y = good()
    scipy.io.savemat(tmp_path / "a.mat", {"time_s": t, "voltage_V": u, "displacement_m": y})
    raw = bytearray((tmp_path / "a.mat").read_bytes())
    raw[byte] = 255
    (tmp_path / "a.mat").write_bytes(bytes(raw))
    refused(tmp_path, "a.mat", "save it again")


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 10**6), st.integers(0, 255), st.sampled_from(["csv", "dat", "npy"]))
def test_one_wrong_byte_is_read_or_refused_in_words(position: int, value: int, suffix: str) -> None:
    t, u, y = good()
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / f"a.{suffix}"
        if suffix == "npy":
            kinds = np.dtype([("time_s", float), ("voltage_V", float), ("displacement_m", float)])
            np.save(path, np.array(list(zip(t, u, y, strict=True))[:80], dtype=kinds))
        else:
            write(path, t[:80], u[:80], y[:80])
            path.write_text(path.read_text().replace(",", "," if suffix == "csv" else " "))
        raw = bytearray(path.read_bytes())
        raw[position % len(raw)] = value
        path.write_bytes(bytes(raw))
        try:
            campaign = read(Path(name))
        except InputRefused as error:
            assert str(error)
        else:
            assert np.isfinite(campaign.recordings[0].noise)


def test_header_without_rows(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time_s,voltage_V,displacement_m\n")
    refused(tmp_path, "a.csv", "no rows")


def test_duplicate_names(tmp_path: Path) -> None:
    write_sine(tmp_path, "a", 1.0, 10.0)
    write_sine(tmp_path, "b", 1.0, 20.0)
    (tmp_path / "recordings.yaml").write_text("recordings: [{file: a.csv, name: x}, {file: b.csv, name: x}]")
    refused(tmp_path, "two recordings", "'x'", "a.csv", "b.csv")
