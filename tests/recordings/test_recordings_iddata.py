"""MATLAB's iddata as a structure in a .mat file of either version, and the object, which is refused with the remedy."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recordings_example import output, refused, sine

from phnn.recordings import read
from phnn.template import template

STEP = 1.0 / 4000.0
T, U = sine(10.0, 70.0)
Y = output(U)


def fields(**changes: Any) -> dict[str, Any]:
    """What ``get(iddata(y, u, Ts))`` says of volts and micrometres."""
    said = {
        "Domain": "Time", "Name": "",
        "OutputData": 1e6 * Y[:, None], "OutputName": cells("y1"), "OutputUnit": cells("um"),
        "InputData": U[:, None], "InputName": cells("u1"), "InputUnit": cells("V"), "Period": np.inf,
        "InterSample": cells("zoh"), "Ts": STEP, "Tstart": np.empty((0, 0)), "SamplingInstants": np.empty((0, 0)),
        "TimeUnit": "seconds", "ExperimentName": cells("Exp1"), "Notes": np.empty((0, 0)),
    }  # fmt: skip
    return said | changes


def cells(*values: Any) -> np.ndarray:
    found = np.empty((len(values), 1), dtype=object)
    found[:, 0] = values
    return found


def v5(path: Path, said: Mapping[str, Any]) -> None:
    import scipy.io

    scipy.io.savemat(path, {"data": dict(said)})


def v73(path: Path, said: Mapping[str, Any]) -> None:
    """As MATLAB writes it: arrays transposed, texts as numbers, cells as references."""
    import h5py

    with h5py.File(path, "w") as file:
        group = file.create_group("data")
        group.attrs["MATLAB_class"] = np.bytes_("struct")

        def put(home: Any, name: str, value: Any) -> Any:
            if isinstance(value, str):
                made = home.create_dataset(name, data=np.array([[ord(c)] for c in value] or [[0]], dtype=np.uint16))
                made.attrs["MATLAB_class"] = np.bytes_("char")
            elif isinstance(value, np.ndarray) and value.dtype == object:
                made = home.create_dataset(name, value.shape[::-1], dtype=h5py.ref_dtype)
                for i, cell in enumerate(value[:, 0]):
                    made[0, i] = put(file.require_group("#refs#"), f"{name}{i}", cell).ref
                made.attrs["MATLAB_class"] = np.bytes_("cell")
            elif np.size(value) == 0:
                made = home.create_dataset(name, data=np.zeros(2, dtype=np.uint64))
                made.attrs["MATLAB_empty"] = 1
            else:
                made = home.create_dataset(name, data=np.atleast_2d(np.asarray(value)).T)
            return made

        for name, value in said.items():
            put(group, name, value)


Writer = Callable[[Path, Mapping[str, Any]], None]
versions = pytest.mark.parametrize("write", [v5, v73])


@versions
def test_voltage_and_displacement_are_found(tmp_path: Path, write: Writer) -> None:
    write(tmp_path / "a.mat", fields())
    campaign = read(tmp_path)
    (found,) = campaign.recordings
    np.testing.assert_array_equal(found.u, U)
    np.testing.assert_allclose(found.y, Y, rtol=1e-14)
    assert found.dt == pytest.approx(STEP, rel=1e-9)
    assert any("write `input: zero_order`" in note for note in campaign.notes)

    # The first manifest of such a folder finds the same columns.
    (tmp_path / "recordings.yaml").write_text(template(tmp_path))
    (again,) = read(tmp_path).recordings
    np.testing.assert_array_equal(again.y, found.y)


@versions
def test_other_units_are_input_and_output(tmp_path: Path, write: Writer) -> None:
    (tmp_path / "recordings.yaml").write_text("setup: linear\n")
    said = fields(InputUnit=cells("N"), OutputUnit=cells("mm"), TimeUnit="milliseconds", Ts=1e3 * STEP, Tstart=5.0)
    write(tmp_path / "a.mat", said)
    (found,) = read(tmp_path).recordings
    assert found.units == ("N", "m")
    assert found.dt == pytest.approx(STEP, rel=1e-9)


@versions
def test_experiments_are_recordings_with_their_own_times(tmp_path: Path, write: Writer) -> None:
    first, second = 500, 700
    parts = [slice(0, first), slice(first, first + second)]
    said = fields(
        OutputData=cells(*(1e6 * Y[p, None] for p in parts)),
        InputData=cells(*(U[p, None] for p in parts)),
        Ts=cells(STEP, np.empty((0, 0))),
        Tstart=cells(0.0, np.empty((0, 0))),
        SamplingInstants=cells(np.empty((0, 0)), STEP * np.arange(second)[:, None]),
        ExperimentName=cells("slow", "fast"),
    )
    write(tmp_path / "a.mat", said)
    campaign = read(tmp_path)
    assert [r.t.size for r in campaign.recordings] == [first, second]
    np.testing.assert_array_equal(campaign.recordings[1].u, U[parts[1]])
    assert any("experiments of the iddata in order: slow, fast" in note for note in campaign.notes)


@versions
def test_several_channels_keep_their_names(tmp_path: Path, write: Writer) -> None:
    said = fields(InputData=np.column_stack([U, 2 * U]), InputName=cells("left", "right"), InputUnit=cells("V", "V"))
    write(tmp_path / "a.mat", said)
    (tmp_path / "recordings.yaml").write_text(
        "columns: {voltage: {column: 'right [V]', unit: V}, displacement: {column: 'y1 [um]', unit: um}}\n"
    )
    (found,) = read(tmp_path).recordings
    np.testing.assert_array_equal(found.u, 2 * U)


@versions
def test_fields_are_still_found_by_name(tmp_path: Path, write: Writer) -> None:
    write(tmp_path / "a.mat", fields())
    (tmp_path / "recordings.yaml").write_text(
        "recordings: [{file: a.mat, variables: {voltage: {column: data.InputData, unit: mV},"
        " displacement: {column: data.OutputData, unit: um}}}]"
    )
    (found,) = read(tmp_path).recordings
    np.testing.assert_allclose(found.u, 1e-3 * U, rtol=1e-14)


@versions
@pytest.mark.parametrize(("changes", "words"), [
    ({"Ts": np.empty((0, 0))}, ("neither Ts nor SamplingInstants", "set data.Ts")),
    ({"Domain": "Frequency"}, ("frequency domain",)),
    ({"InputData": U[:-1, None]}, (f"{U.size - 1} samples of the input, {U.size} of the output",)),
])  # fmt: skip
def test_refusals(tmp_path: Path, write: Writer, changes: dict[str, Any], words: tuple[str, ...]) -> None:
    write(tmp_path / "a.mat", fields(**changes))
    refused(tmp_path, "a.mat", *words)


def test_an_object_of_version_5_is_refused_with_the_line_that_converts_it(tmp_path: Path) -> None:
    def element(kind: int, content: bytes) -> bytes:
        return struct.pack("<II", kind, len(content)) + content + b"\0" * (-len(content) % 8)

    numbers = element(6, struct.pack("<II", 13, 0)) + element(5, struct.pack("<ii", 6, 1)) + element(1, b"")
    numbers += element(6, struct.pack("<6I", 0xDD000000, 2, 1, 1, 1, 1))
    names = b"".join(element(1, name) for name in (b"z", b"MCOS", b"iddata"))
    body = element(6, struct.pack("<II", 17, 0)) + names + element(14, numbers)
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<HH", 0x100, 0x4D49)
    (tmp_path / "a.mat").write_bytes(head + element(14, body))
    refused(tmp_path, "a.mat: z is an iddata object", "s = get(z); save('z.mat', 's')")


def test_an_object_of_version_73_is_refused_with_the_line_that_converts_it(tmp_path: Path) -> None:
    import h5py

    with h5py.File(tmp_path / "a.mat", "w") as file:
        made = file.create_dataset("z", data=np.array([[0xDD000000], [2], [1], [1], [1], [1]], dtype=np.uint32))
        made.attrs["MATLAB_class"] = np.bytes_("iddata")
        made.attrs["MATLAB_object_decode"] = 3
    refused(tmp_path, "a.mat: z is an iddata object", "s = get(z); save('z.mat', 's')")
