"""Every check refuses what it should, names the place and the remedy, and lets good recordings pass."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from recordings_example import output, play, refused, sine, write, write_sine

from phnn.recordings import read


def good() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    t, u = sine(10.0, 75.0)
    return t, u, output(u)


# Name of a changed header, or what is done to the rows of a good recording (none: nothing), and words of the refusal.
REFUSED: list[tuple[str | Callable[[list[str]], list[str]], tuple[str, ...]]] = [
    ("time_s,voltage_V,displacement", ("displacement", "no unit", "displacement_m")),
    ("time_s,voltage_V,displacement_umm", ("unknown unit 'umm'", "um")),
    ("time_s,voltage_V,displacement_Um", ("unknown unit 'Um'", "did you mean um?")),
    ("time_s,voltage_v,displacement_m", ("unknown unit 'v'", "did you mean V?")),
    ("time_m,voltage_V,displacement_m", ("time cannot be in m",)),
    (lambda rows: cell(rows, 42, 0, "nan"), ("time_s", "row 42 (line 43)", "slice")),
    (lambda rows: cell(rows, 42, 1, "9.9e37"), ("voltage_V", "row 42 (line 43)", "slice")),
    (lambda rows: cell(rows, 1, 1, "12.x"), ("line 2", "'12.x'", "not a number", "correct or delete")),
    (lambda rows: cell(rows, 5, 1, "12.x"), ("line 6", "'12.x'", "not a number", "correct or delete")),
    (lambda rows: [*rows[:20], rows[20] + ",7", *rows[21:]], ("line 21", "4 cells")),
    (lambda rows: rows[:2], ("1 sample", "at least 50")),
    (lambda rows: rows[:50], ("49 sample", "at least 50")),
    (
        lambda rows: [r.replace(",", ";").replace(".", ",") for r in cell(rows, 30, 1, "overrange")],
        ("row 30 (line 31)", "'overrange'", "not a number"),
    ),
]


def cell(rows: list[str], row: int, column: int, value: str) -> list[str]:
    cells = rows[row].split(",")
    return [*rows[:row], ",".join([*cells[:column], value, *cells[column + 1 :]]), *rows[row + 1 :]]


@pytest.mark.parametrize(("change", "words"), REFUSED)
def test_refused(tmp_path: Path, change: str | Callable[[list[str]], list[str]], words: tuple[str, ...]) -> None:
    rows = write(tmp_path / "a.csv", *good()).read_text().splitlines()
    rows = [change, *rows[1:]] if isinstance(change, str) else change(rows)
    (tmp_path / "a.csv").write_text("\n".join(rows))
    refused(tmp_path, "a.csv", *words)


def test_a_folder_that_holds_no_recordings_is_refused_with_what_it_is(tmp_path: Path) -> None:
    refused(tmp_path / "absent", "absent", "no such folder")
    refused(write_sine(tmp_path, "a", 1.0, 10.0), "this is a file", "folder")
    (tmp_path / "a.csv").rename(tmp_path / "README.md")
    refused(tmp_path, "no recordings", "README.md")


@pytest.mark.parametrize("level", [-0.95, -0.7, 0.8, 0.95])
def test_a_clipped_sensor_is_refused_at_either_end(tmp_path: Path, level: float) -> None:
    t, u, y = good()
    limited = np.minimum(y, level * y.max()) if level > 0.0 else np.maximum(y, -level * y.min())
    write(tmp_path / "a.csv", t, u, limited)
    refused(tmp_path, "displacement_m", "clipped", "largest" if level > 0.0 else "smallest", "row ", "range")


def flat() -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Recordings whose output stands still and is not clipped: coarse steps, holds and backlash."""
    t, u = sine(10.0, 75.0)
    many, fine = sine(10.0, 75.0, samples=2000)
    slow = np.arange(2000) * 1e-3
    hold = np.interp(slow, [0.3, 0.6, 1.4, 1.7], [0.0, 50.0, 50.0, 0.0])
    return (
        {f"steps of {step}": (many, fine, output(fine, noise=0.0, step=step)) for step in (20e-9, 0.2e-6, 1e-6)}
        | {f"backlash of {radius}": (t, u, 1e-6 * play(u, radius)) for radius in (2.0, 10.0, 40.0)}
        | {"holds and rests": (slow, hold, 1e-6 * play(hold, 5.0))}
    )


@pytest.mark.parametrize("case", flat())
def test_an_output_that_stands_still_is_not_clipped(tmp_path: Path, case: str) -> None:
    t, u, y = flat()[case]
    write(tmp_path / "a.csv", t, u, y)
    assert read(tmp_path).recordings[0].y.size == t.size


@pytest.mark.parametrize(
    ("level", "said"), [(20.0, "unknown"), (0.0, "unknown"), (20.0, "{state: rest, input_before: 0.0}")]
)
def test_a_constant_input_is_read_where_its_start_is_stated(tmp_path: Path, level: float, said: str) -> None:
    t, u, y = good()
    write(tmp_path / "a.csv", t, np.full_like(u, level), y)
    write_sine(tmp_path, "b", 5.0, 40.0)
    (tmp_path / "recordings.yaml").write_text(f"recordings: [{{file: a.csv, start: {said}}}, {{file: b.csv}}]")
    assert {r.name: r.start.state for r in read(tmp_path).recordings}["a"] in said


@pytest.mark.parametrize("byte", [145, 172, 184, 185])
def test_damaged_tags_in_a_mat_file_do_not_crash_the_reader(tmp_path: Path, byte: int) -> None:
    import scipy.io

    scipy.io.savemat(tmp_path / "a.mat", dict(zip(("time_s", "voltage_V", "displacement_m"), good(), strict=True)))
    raw = bytearray((tmp_path / "a.mat").read_bytes())
    raw[byte] = 255
    (tmp_path / "a.mat").write_bytes(bytes(raw))
    refused(tmp_path, "a.mat", "save it again")


def test_name_that_only_resembles_a_quantity_is_left_alone(tmp_path: Path) -> None:
    t, u, y = good()
    rows = "\n".join(f"{a!r},{b!r},{c!r},0" for a, b, c in zip(t.tolist(), u.tolist(), y.tolist(), strict=True))
    (tmp_path / "a.csv").write_text("time_s,voltage_V,displacement_m,voltage_monitor\n" + rows)
    campaign = read(tmp_path)
    assert any("voltage_monitor" in note for note in campaign.notes)


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


def test_rates_may_differ_between_files(tmp_path: Path) -> None:
    write_sine(tmp_path, "a", 1.0, 10.0)
    write_sine(tmp_path, "b", 10.0, 10.0)
    assert any("different rates" in note for note in read(tmp_path).notes)
