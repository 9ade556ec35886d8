"""Recordings that are objects in memory give the campaign that their csv files give."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import recordings_example as made
from numpy.typing import NDArray

import phnn
from phnn.errors import InputRefused
from phnn.recordings.recording import Campaign, digest

Columns = dict[str, NDArray[np.float64]]
# Two amplitudes and three frequencies: one is held out by choice.
DRIVES = {"low": (5.0, 70.0), "middle": (20.0, 40.0), "middle_too": (20.0, 70.0), "high": (80.0, 70.0)}


@pytest.fixture(scope="module")
def columns() -> dict[str, Columns]:
    """Time [s], voltage [V] and displacement [um] of four recordings."""
    found = {}
    for seed, (name, (frequency, amplitude)) in enumerate(DRIVES.items()):
        t, u = made.sine(frequency, amplitude)
        found[name] = {"time_s": t, "voltage_V": u, "displacement_um": 1e6 * made.output(u, seed=seed)}
    return found


@pytest.fixture(scope="module")
def folder(columns: dict[str, Columns], tmp_path_factory: pytest.TempPathFactory) -> Path:
    home = tmp_path_factory.mktemp("csv")
    for name, c in columns.items():
        made.write(home / f"{name}.csv", *c.values(), header=",".join(c))
    return home


def _as_read(found: Campaign, expected: Campaign) -> None:
    """Samples, starts, parts, noise floors and held-out recordings are the same to the last digit."""
    assert [r.name for r in found.recordings] == [r.name for r in expected.recordings]
    assert digest(found) == digest(expected)
    for ours, theirs in zip(found.recordings, expected.recordings, strict=True):
        assert (ours.parts, ours.noise, ours.noise_source, ours.noise_interval, ours.noise_found) == (
            theirs.parts, theirs.noise, theirs.noise_source, theirs.noise_interval, theirs.noise_found
        )  # fmt: skip
    assert (found.held_out, found.held_out_is_new) == (expected.held_out, expected.held_out_is_new)
    assert found.in_memory


def _bare(columns: Columns) -> tuple[dict[str, NDArray[np.float64]], dict[str, str]]:
    """The columns without units in their names, and the units."""
    pairs = {name: name.split("_") for name in columns}
    return {q: columns[n] for n, (q, _) in pairs.items()}, dict(pairs.values())


def _frames(columns: dict[str, Columns]) -> dict[str, Any]:
    return {name: pd.DataFrame(c) for name, c in columns.items()}


def _frames_with_attributes(columns: dict[str, Columns]) -> list[Any]:
    found = []
    for name, c in columns.items():
        bare, units = _bare(c)
        frame = pd.DataFrame(bare)
        frame.attrs |= {"name": name, "units": units}
        found.append(frame)
    return found


def _frames_with_index(columns: dict[str, Columns]) -> dict[str, Any]:
    return {name: pd.DataFrame(c).set_index("time_s") for name, c in columns.items()}


def _arrays(columns: dict[str, Columns]) -> dict[str, Any]:
    return {name: {key: list(values) for key, values in c.items()} for name, c in columns.items()}


def _datasets(columns: dict[str, Columns]) -> dict[str, Any]:
    xarray = pytest.importorskip("xarray")
    found = {}
    for name, c in columns.items():
        bare, units = _bare(c)
        time = bare.pop("time")
        variables = {q: ("time", values, {"units": units[q]}) for q, values in bare.items()}
        found[name] = xarray.Dataset(variables, coords={"time": ("time", time, {"units": "s"})})
    return found


def _data_arrays(columns: dict[str, Columns]) -> dict[str, Any]:
    xarray = pytest.importorskip("xarray")
    found = {}
    for name, c in columns.items():
        names = ["voltage_V", "displacement_um"]
        values = np.stack([c[n] for n in names])
        array = xarray.DataArray(values, dims=("channel", "time_s"), coords={"channel": names, "time_s": c["time_s"]})
        with pytest.raises(InputRefused, match=r"DataArray.*array\.to_dataset\(dim='channel'\)"):
            phnn.read(array)
        found[name] = array.to_dataset(dim="channel")
    return found


@pytest.fixture(scope="module")
def as_csv(columns: dict[str, Columns], folder: Path) -> Campaign:
    """What the files give in the order of the columns."""
    return phnn.read(folder, {"recordings": [{"file": f"{name}.csv"} for name in columns]})


@pytest.mark.parametrize(
    "given", [_frames, _frames_with_attributes, _frames_with_index, _arrays, _datasets, _data_arrays]
)
def test_it_is_read_as_its_csv(columns: dict[str, Columns], as_csv: Campaign, given: Any) -> None:
    manifest: Mapping[str, Any] = {"recordings": [{"file": name} for name in columns]}
    _as_read(phnn.read(given(columns), manifest), as_csv)
    # Without a list the order is that in which they are given, and the choice of held-out ones the same.
    found = phnn.read(given(columns))
    assert [r.name for r in found.recordings] == list(columns)
    assert {r.name: r.parts for r in found.recordings} == {r.name: r.parts for r in as_csv.recordings}


def test_a_manifest_says_of_objects_what_it_says_of_files(columns: dict[str, Columns], folder: Path) -> None:
    said = {
        "known": {"m": 1.0e-3},
        "voltage": "terminals",
        "offset": "shared",
        "setup": {"model": "hrc", "hysterons": 1},
    }
    entries = [{"file": "low", "slice": [100, 900]}, {"file": "high", "use": "confirmation", "name": "fast"}]
    files = [{**entry, "file": f"{entry['file']}.csv"} for entry in entries]
    found = phnn.read(_frames(columns), {**said, "recordings": entries})
    expected = phnn.read(folder, {**said, "recordings": files})
    _as_read(found, expected)
    assert (found.setup, found.known, found.voltage) == (expected.setup, expected.known, expected.voltage)
    assert found.held_out == {"fast"}
    assert found.notes[-1] == "Left alone: middle, middle_too."


def test_a_manifest_may_be_a_file(columns: dict[str, Columns], tmp_path: Path) -> None:
    (tmp_path / "said.yaml").write_text("recordings: [{file: low, use: confirmation}, {file: high}]\n")
    found = phnn.read(_frames(columns), tmp_path / "said.yaml")
    assert found.held_out == {"low"}


def test_attributes_hold_out_and_give_a_rate(columns: dict[str, Columns], folder: Path) -> None:
    frames = _frames(columns)
    frames["high"] = frames["high"].drop(columns="time_s")
    frames["high"].attrs |= {"use": "confirmation", "sample_rate_hz": np.float64(80.0 * 400.0)}
    found = phnn.read({name: frames[name] for name in ("low", "high")})
    files = [{"file": "low.csv"}, {"file": "high.csv", "use": "confirmation"}]
    expected = phnn.read(folder, {"recordings": files})
    assert found.held_out == {"high"}
    for ours, theirs in zip(found.recordings, expected.recordings, strict=True):
        assert ours.parts == theirs.parts
        np.testing.assert_allclose(ours.t, theirs.t, rtol=1e-12)
        np.testing.assert_array_equal(ours.y, theirs.y)


@pytest.mark.parametrize("kind", ["dates", "differences"])
def test_an_index_of_dates_is_a_time(columns: dict[str, Columns], kind: str) -> None:
    frame = pd.DataFrame(columns["low"]).drop(columns="time_s")
    # The step of 0.5 ms is a whole number of nanoseconds.
    steps = pd.to_timedelta(np.arange(len(frame)) * 500_000, unit="ns")
    frame.index = pd.Timestamp("2024-03-01 12:00") + steps if kind == "dates" else steps
    found = phnn.read(frame).recordings[0]
    assert found.dt == pytest.approx(5e-4, rel=1e-12)


def test_recordings_along_a_second_dimension(columns: dict[str, Columns], folder: Path) -> None:
    xarray = pytest.importorskip("xarray")
    names = ["middle", "middle_too"]
    both = {q: (("run", "time"), np.stack([columns[n][q] for n in names])) for q in ("voltage_V", "displacement_um")}
    data = xarray.Dataset(both, coords={"run": names, "time": ("time", columns["middle"]["time_s"], {"units": "s"})})
    found = phnn.read({"sine": data})
    expected = phnn.read(folder, {"recordings": [{"file": f"{n}.csv", "name": f"sine_{n}"} for n in names]})
    _as_read(found, expected)


def test_parts_of_a_benchmark_by_their_names(columns: dict[str, Columns], folder: Path) -> None:
    benchmarks = pytest.importorskip("nonlinear_benchmarks")
    train, test = (
        benchmarks.Input_output_data(c["voltage_V"], c["displacement_um"][:, None], 1.0 / (400.0 * DRIVES[name][0]))
        for name, c in ((n, columns[n]) for n in ("low", "high"))
    )
    units = {"columns": {"voltage": {"unit": "V"}, "displacement": {"unit": "um"}}}
    said = {**units, "recordings": ["train", {"file": "test", "use": "confirmation"}]}
    found = phnn.read({"train": train, "test": test}, said)
    files = [{"file": "low.csv", "name": "train"}, {"file": "high.csv", "name": "test", "use": "confirmation"}]
    expected = phnn.read(folder, {"recordings": files})
    assert found.held_out == {"test"}
    for ours, theirs in zip(found.recordings, expected.recordings, strict=True):
        assert (ours.name, ours.parts) == (theirs.name, theirs.parts)
        np.testing.assert_array_equal(ours.u, theirs.u)
        np.testing.assert_array_equal(ours.y, theirs.y)
        # The csv has times that were rounded when they were divided.
        np.testing.assert_allclose(ours.t, theirs.t, rtol=1e-12)
        assert ours.noise == pytest.approx(theirs.noise, rel=1e-9)
    with pytest.raises(InputRefused, match=r"no unit for the voltage.*second argument of phnn.read"):
        phnn.read(train)
    train.sampling_time = None
    with pytest.raises(InputRefused, match=r"train .Input_output_data.: sampling_time is None: set it"):
        phnn.read({"train": train}, said)


def test_several_channels_of_a_benchmark(columns: dict[str, Columns]) -> None:
    benchmarks = pytest.importorskip("nonlinear_benchmarks")
    u, y = columns["low"]["voltage_V"], columns["low"]["displacement_um"]
    data = benchmarks.Input_output_data(np.stack([u, 2 * u], axis=1), y, 1e-3, name="bench")
    said = {"setup": "linear", "columns": {"input": {"column": "u[1]", "unit": "V"}, "output": {"unit": "um"}}}
    found = phnn.read(data, said).recordings[0]
    np.testing.assert_array_equal(found.u, 2 * u)
    assert found.name == "bench"


@pytest.mark.parametrize(
    ("data", "said", "message"),
    [
        (3.0, None, "float is not known as a recording: give a folder, a pandas DataFrame"),
        ([], None, "list: it is empty"),
        ({"loops": "a.csv"}, None, r"a dict with loops .str. is not known as a recording"),
        ({"time_s": [0.0, 1.0], "voltage_V": [0.0, 1.0]}, None, "no displacement column"),
        ({"a": {"time_s": [0.0] * 60}}, {"recordings": [{"file": "b"}]}, "no recording is called 'b', there are a"),
        ({"voltage_V": [1.0]}, {"colums": {}}, "the manifest given: unknown key 'colums' .did you mean columns"),
        (
            {"time_s": np.arange(60.0), "voltage_V": np.ones(60), "displacement_m": np.ones(59)},
            None,
            r"unequal numbers of samples: time .column time_s. has 60,.*displacement .column displacement_m. has 59",
        ),
        ({"voltage_V": np.ones((2, 2, 2)), "time_s": []}, None, "no voltage column"),
    ],
)
def test_refusals_name_cause_and_remedy(data: Any, said: Any, message: str) -> None:
    with pytest.raises(InputRefused, match=message):
        phnn.read(data, said)


def test_frames_are_refused_with_the_place(columns: dict[str, Columns]) -> None:
    frame = pd.DataFrame(columns["low"])
    frame.loc[7, "displacement_um"] = np.nan
    with pytest.raises(InputRefused, match=r"loops \(DataFrame\): displacement .*row 8: the value is missing"):
        phnn.read({"loops": frame})
    bare, units = _bare(columns["low"])
    frame = pd.DataFrame(bare)
    with pytest.raises(InputRefused, match=r"no unit for the time.*second argument of phnn.read"):
        phnn.read(frame)
    frame.attrs["units"] = {**units, "displacement": "V"}
    with pytest.raises(InputRefused, match="displacement cannot be in V"):
        phnn.read(frame)
    frame.attrs["units"] = units
    frame.attrs["use"] = "test"
    with pytest.raises(InputRefused, match=r"attrs\['use'\]: 'test' is not known: accepted are identification"):
        phnn.read(frame)
    same = [pd.DataFrame(columns["low"]), pd.DataFrame(columns["low"])]
    for one in same:
        one.attrs["name"] = "a"
    with pytest.raises(InputRefused, match="two recordings are called 'a'"):
        phnn.read(same)


def test_results_may_be_written_beside_the_programme(
    columns: dict[str, Columns], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # No folder was read from, so none is protected: neither the current one nor one with the name of the campaign.
    monkeypatch.chdir(tmp_path)
    campaign = phnn.read(_frames(columns))
    assert campaign.inputs == []
    assert phnn.describe(campaign).startswith("recordings in memory: 4 recordings")


def test_no_library_is_loaded_for_what_was_not_given() -> None:
    code = (
        "import sys, json, numpy as np, phnn; t = np.arange(400) / 100; u = 50 * np.sin(2 * np.pi * t);"
        "rng = np.random.default_rng(0);"
        "phnn.read({'time_s': t, 'voltage_V': u, 'displacement_um': u + rng.normal(size=400)});"
        "print(json.dumps(sorted({'xarray', 'nonlinear_benchmarks', 'pandas', 'torch', 'h5py'} & set(sys.modules))))"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert json.loads(found.stdout) == []
