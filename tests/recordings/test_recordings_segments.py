"""Several recordings in one file, extremes in pairs, and records that begin before a trigger."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recordings_example import output, refused, sine, write

from phnn.recordings import read


def three() -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    drives = [sine(10.0, amplitude) for amplitude in (75.0, 50.0, 25.0)]
    return [(t, u, output(u, seed=i)) for i, (t, u) in enumerate(drives)]


def joined(path: Path, restart: bool) -> None:
    """The three after one another: time begins anew with each, or goes on after a pause."""
    pauses = np.zeros(3) if restart else 2.0 * np.arange(3)
    write(
        path,
        *(
            np.concatenate(c)
            for c in zip(*((t + p, u, y) for (t, u, y), p in zip(three(), pauses, strict=True)), strict=True)
        ),
    )


@pytest.mark.parametrize("restart", [True, False])
def test_jumps_of_time_separate_segments(tmp_path: Path, restart: bool) -> None:
    joined(tmp_path / "a.csv", restart)
    refused(tmp_path, "a.csv", "row 1201", "segments: true")
    (tmp_path / "recordings.yaml").write_text("segments: true")
    campaign = read(tmp_path)
    assert [r.name for r in campaign.recordings] == ["a_1", "a_2", "a_3"]
    for r, (_, u, y) in zip(campaign.recordings, three(), strict=True):
        np.testing.assert_array_equal(r.u, u)
        np.testing.assert_array_equal(r.y, y)
        assert (r.source, r.start.state) == ("a.csv", "rest")


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


def test_one_repeated_time_is_no_pair(tmp_path: Path) -> None:
    t, u, y = three()[0]
    write(tmp_path / "a.csv", np.insert(t, 300, t[300]), np.insert(u, 300, u[300]), np.insert(y, 300, y[300]))
    refused(tmp_path, "a.csv", "row 302", "two rows with one time")


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
