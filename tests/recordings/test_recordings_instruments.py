"""Exports of instruments: headers of ``name: value``, tables one below the other, and json."""

from __future__ import annotations

import json
import struct
import time
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from recordings_example import output, refused, sine

from phnn.errors import InputRefused
from phnn.intake import named_file
from phnn.recordings import read
from phnn.recordings.array_files import read_mat
from phnn.recordings.text_files import read_text
from phnn.template import look

T, U = sine(10.0, 75.0, samples=120)
Y = output(U)
PREAMBLE = ("Instrument: Interferometer 7, serial: 12", "Date: 2024-05-01 12:30:00", "Range: 10 V", "Averages: 4", "")


def table(number: int = 1, separator: str = ",", units: bool = True, decimal: str = ".") -> list[str]:
    """A header and the rows of one segment; amplitudes differ."""
    names = [separator.join(("Time", "Voltage", "Displacement")), separator.join(("(ms)", "(V)", "(um)"))]
    if not units:
        names = [separator.join(("time_ms", "voltage_V", "displacement_um"))]
    rows = zip(1e3 * T, number * U, 1e6 * number * Y, strict=True)
    cells = (separator.join(f"{v:.12g}".replace(".", decimal) for v in row) for row in rows)
    return [*PREAMBLE[:1], f"Segment: {number} of 3", *PREAMBLE[1:], *names, *cells]


def written(folder: Path, lines: list[str], name: str = "a.csv", end: str = "\n") -> Path:
    (folder / name).write_bytes((end.join(lines) + end).encode("utf-8"))
    return folder


@pytest.mark.parametrize("units", [True, False])
@pytest.mark.parametrize(("separator", "decimal"), [(",", "."), (";", ","), ("\t", ".")])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_tables_below_headers_of_their_own_are_recordings(
    tmp_path: Path, separator: str, decimal: str, units: bool, end: str
) -> None:
    lines = [line for k in (1, 2, 3) for line in [*table(k, separator, units, decimal), ""]][:-1]
    campaign = read(written(tmp_path, lines, end=end))
    assert [r.name for r in campaign.recordings] == ["a_1", "a_2", "a_3"]
    for k, r in enumerate(campaign.recordings, start=1):
        np.testing.assert_allclose(r.t, T, atol=1e-12)
        np.testing.assert_allclose(r.u, k * U, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(r.y, k * Y, rtol=1e-9, atol=1e-16)
    assert any("3 tables" in note for note in campaign.notes)


@pytest.mark.parametrize(("text", "names", "row"), [
    ("Time (s),Load (kN)\n(s),(kN)\n0,1\n1,2", "Time (s)|Load (kN)", (0, 1)),
    ("Time (s),Load (kN)\n(s),(N)\n0,1\n1,2", "says N of 'Load (kN)'", ()),
    ("t;a;;b;\n0;1;;2;\n1;3;;4;", "t|a||b|", (0, 1, np.nan, 2, np.nan)), ("0;;2\n1;;4", "||", (0, np.nan, 2)),
    ("t;mW;K\n0;20.000;0,1\n1;7;0,25\n2;3;0,5", "mW, row 1.*thousands", ()),
    ("a\tb\tNote\n0\t1\ton it\n1\t2\t\n2\t3\t", "a|b|Note", (0, 1)), ("a\tb\n\tW\n0\t1\n1\t2", "a|b [W]", (0, 1)),
    ("a;b\n%;K\n0;1\n1;2", "a [%]|b [K]", (0, 1)), ("a;b;c\n-;mm;RPM\n0;1;2\n1;2;3", "a|b [mm]|c [RPM]", (0, 1, 2)),
    ("a;b\n0.5D+01;1\n\n1;2\n# open\n2;-", "b, row 3 .line 6", ()), ("a;b\n.5D+01;1\n\n1;2\n# 2\n2;3", "a|b", (5, 1)),
    ("X,CH1,CH2,Start,Increment,\nSequence,Volt,V,-3e-3,2e-3\n0,5,6,\n1,7,8,", "X|CH1 [Volt]|CH2 [V]||time_s", (0, 5)),
    ("CH1,Start,Increment\nVolt,-3e-3,2e-3\n5,\n6,", "CH1 [Volt]||time_s", (5, np.nan, -3e-3)),
    ("X_Value\ta\tb\tComment\n0\t1\t2\n1\t3\t4", "X_Value|a|b", (0, 1, 2)), ("a;b\n0;1,234.5\n1;2", "a|b", (0, 1234.5)),
    ("T,N,P\nTS,RN,W\n,,Avg\n2031-02-03 04:05,5,7\n2031-02-03 04:06,6,8", "T [TS]|N [RN]|P [W]", (0, 5, 7)),
    ("when;a;b\n2031-02-03 04:05;null;N/A\n2031-02-03 04:06;1;2", "when|a|b", (0, np.nan, np.nan)),
    (",,mean,4\nDate,Time,Site,a\n3/2/2031,4:05,x,1\n3/2/2031,4:06,x,2\n3/2/2031,4:07,x,3", "Date|Time|Site|a", (0, 0)),
    (".5,1,0,\n1,2,3\n2,3,4", "line 1 has 4 cells, the rows below it 3", ()),
    ("a;b;c\nV;mm;Frobs\n0;1;2\n1;2;3", "a [V]|b [mm]|c [Frobs]", (0, 1, 2)),
])  # fmt: skip
def test_headers_columns_and_numbers_are_read_as_they_stand(tmp_path: Path, text: str, names: str, row: Any) -> None:
    (tmp_path / "a.txt").write_text(text + "\n")
    if row:
        found = read_text(named_file(tmp_path / "a.txt"))
        assert "|".join(found.names) == names
        np.testing.assert_array_equal([found.numbers(i)[0] for i in range(len(found.names)) if i < len(row)], row)
        return
    with pytest.raises(InputRefused, match=names.replace("(kN)", ".kN.")):
        found = read_text(named_file(tmp_path / "a.txt"))
        found.numbers(1)


def test_a_slice_lies_in_one_of_several_tables(tmp_path: Path) -> None:
    written(tmp_path, table(1) + table(2))
    (tmp_path / "recordings.yaml").write_text(f"recordings: [{{file: a.csv, slice: [{T.size}, {2 * T.size}]}}]")
    (recording,) = read(tmp_path).recordings
    np.testing.assert_allclose(recording.u, 2 * U, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(("old", "new", "words"), [
    (table(2)[-10][-6:], "0.1.2", ("(line LINE)", "0.1.2'", "not a number")),
    ("(um)", "(nm)", ("line LINE", "(nm)", "split the file")), ("Displacement", "Force", ()),
])  # fmt: skip
def test_what_is_wrong_in_a_later_table_is_named_by_its_line(
    tmp_path: Path, old: str, new: str, words: tuple[str, ...]
) -> None:
    lines = table(1) + [line.replace(old, new) for line in table(2)]
    at = next(i for i, line in enumerate(lines, start=1) if new in line)
    refused(written(tmp_path, lines), "a.csv", *(word.replace("LINE", str(at)) for word in words))


def test_a_last_table_that_breaks_off_loses_its_last_line(tmp_path: Path) -> None:
    text = "\n".join([*table(1, units=False), *table(2, units=False)])
    (tmp_path / "a.csv").write_text(text[:-60])
    second = read(tmp_path).recordings[1]
    assert second.t.size < T.size
    np.testing.assert_allclose(second.u, 2 * U[: second.t.size], rtol=1e-9, atol=1e-9)


def test_a_header_at_the_end_is_no_table(tmp_path: Path) -> None:
    (recording,) = read(written(tmp_path, [*table(1), *table(2)[:8]])).recordings
    assert recording.t.size == T.size


def test_more_tables_than_recordings_are_refused_in_time(tmp_path: Path) -> None:
    written(tmp_path, ["time_s,voltage_V,displacement_m"] + ["time_s,voltage_V,displacement_m", "0,1,2"] * 20_000)
    begin = time.perf_counter()
    refused(tmp_path, "a.csv", "10000 tables")
    assert time.perf_counter() - begin < 5.0


ARRAYS: dict[str, Any] = {"time_s": T.tolist(), "voltage_V": U.tolist(), "displacement_m": Y.tolist()}
RECORDS = [dict(zip(ARRAYS, row, strict=True)) for row in zip(*ARRAYS.values(), strict=True)]
JSON: dict[str, str] = {
    "arrays": json.dumps(ARRAYS),
    "indented": json.dumps(ARRAYS, indent=1),
    "records": json.dumps(RECORDS),
    "a record in each line": "".join(json.dumps(r) + "\n" for r in RECORDS),
    "names and rows of a frame": json.dumps({"columns": [*ARRAYS], "data": [list(r.values()) for r in RECORDS]}),
    "numbered rows of a frame": json.dumps({n: dict(enumerate(column)) for n, column in ARRAYS.items()}),
    "beside numbered channels": json.dumps({**ARRAYS, "channels": {"1": [1.0] * T.size, "2": {"x": [2.0] * T.size}}}),
    "keys in any order": json.dumps([dict(reversed(r.items())) if i % 2 else r for i, r in enumerate(RECORDS)]),
    "with settings": json.dumps({"rate": 5e3, "by": "me", "range": [[0, 1], [2]], "of": {"x": None}, **ARRAYS}),
    "records with texts": json.dumps([{"at": "12:30", **r} for r in RECORDS]),
}


@pytest.mark.parametrize("form", JSON)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_json_gives_the_recording(tmp_path: Path, form: str, encoding: str) -> None:
    (tmp_path / ("a.jsonl" if "line" in form else "a.json")).write_bytes(JSON[form].encode(encoding))
    (recording,) = read(tmp_path).recordings
    np.testing.assert_allclose(recording.t, T, atol=1e-15)
    np.testing.assert_array_equal(recording.u, U)
    np.testing.assert_array_equal(recording.y, Y)


@pytest.mark.parametrize("of", [ARRAYS, RECORDS])
def test_arrays_of_a_group_are_found_by_name(tmp_path: Path, of: Any) -> None:
    (tmp_path / "a.json").write_text(json.dumps({"bench": 3, "scope": of}))
    (tmp_path / "recordings.yaml").write_text(
        "recordings: [{file: a.json, variables: {time: scope.time_s, voltage: scope.voltage_V, "
        "displacement: scope.displacement_m}}]\n"
        "columns: {time: {unit: s}, voltage: {unit: V}, displacement: {unit: m}}\n"
    )
    np.testing.assert_array_equal(read(tmp_path).recordings[0].y, Y)


def test_settings_beside_recordings_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(JSON["arrays"])
    (tmp_path / "settings.json").write_text('{"bench": 3, "by": ["x", "y"]}')
    (tmp_path / "result.json").write_text('{"cost": [1, 2, 3]}')
    (tmp_path / "list.json").write_text("[1, 2, 3]")
    campaign = read(tmp_path)
    assert [r.name for r in campaign.recordings] == ["a"]
    left = next(note for note in campaign.notes if note.startswith("Left alone"))
    assert all(name in left for name in ("settings.json", "result.json", "list.json"))


def with_value(value: str) -> str:
    """The arrays with another 8th voltage."""
    return json.dumps({**ARRAYS, "voltage_V": [*U.tolist()[:7], "@", *U.tolist()[8:]]}).replace('"@"', value)


def with_record(value: str) -> str:
    """The records, one on each line, with another 8th voltage."""
    rows = [json.dumps({**r, "voltage_V": "@"} if i == 7 else r) for i, r in enumerate(RECORDS)]
    return ("[\n" + ",\n".join(rows) + "\n]").replace('"@"', value)


NO_JSON = ("0x1p3", "1_0", "01", ".5", "1.", "+1", "1,5.5.5")


@pytest.mark.parametrize("value", ['"1.5"', '"1,5"', "true", "[1]", "{}", *NO_JSON])
def test_a_sample_that_is_no_number_is_named(tmp_path: Path, value: str) -> None:
    (tmp_path / "a.json").write_text(with_value(value))
    refused(tmp_path, "a.json", "line 1, column" if value in NO_JSON else "row 8")
    (tmp_path / "a.json").write_text(with_record(value))
    refused(tmp_path, "a.json", "line 9" if value in NO_JSON else "row 8")


@pytest.mark.parametrize("value", ["null", "NaN", "Infinity", "1e999", "9" * 400])
@pytest.mark.parametrize("form", [with_value, with_record])
def test_a_missing_sample_is_refused_with_its_row(tmp_path: Path, value: str, form: Any) -> None:
    (tmp_path / "a.json").write_text(form(value))
    refused(tmp_path, "a.json", "row 8", "voltage")


WRONG = {
    "unequal": (json.dumps({**ARRAYS, "voltage_V": U.tolist()[1:]}), "unequal"),
    "a key twice": (JSON["arrays"].replace("displacement_m", "voltage_V"), "twice"),
    "a key twice in a record": (JSON["records"].replace("displacement_m", "voltage_V", 1), "twice"),
    "a record without a key": (json.dumps([*RECORDS[:5], {"time_s": 1.0, "voltage_V": 0.0}]), "record 6"),
    "a record with one more": (json.dumps([*RECORDS[:5], {**RECORDS[5], "x": 1}]), "'x'"),
    "two documents": (JSON["arrays"] * 2, "Extra data"),
    "no value": ('{"a": }', "not json"),
    "no colon": ('{"a" [1]}', "not json"),
    "a text": ('"abc"', "without arrays of numbers"),
    "prose": ("not json at all", "not json"),
    "no end": (JSON["arrays"][:-1], "not json"),
    "no end of an array": (JSON["arrays"][:-2], "not json"),
    "no end of a text": ('{"a', "not json"),
    "deep": ('{"a":' * 10_000 + "1" + "}" * 10_000, "deep"),
    "deep lists": ('{"a":' + "[" * 10**6 + "]" * 10**6 + "}", "deep"),
    "a huge other value": ('{"a": ["' + "x" * 3_000_000 + '"]}', "without arrays of numbers"),
    "a huge record": ('[{"a": "' + "x" * 3_000_000 + '"}]', "without arrays of numbers"),
    "many keys": ("{" + ",".join(f'"k{i}": 1' for i in range(20_000)) + "}", "10000"),
    "brackets": ("[" * 10**6, "a.json"),
    "empty object": ("{}", "a.json"),
    "empty list": ("[]", "a.json"),
    "empty": ("", "empty"),
    "NUL": ('{"a": [1, 2\0]}', "not a text file"),
}


@pytest.mark.parametrize("fault", WRONG)
def test_damaged_json_is_refused_in_time(tmp_path: Path, fault: str) -> None:
    content, words = WRONG[fault]
    (tmp_path / "a.json").write_text(content)
    begin = time.perf_counter()
    refused(tmp_path, "a.json", words)
    assert time.perf_counter() - begin < 5.0


def test_json_recordings_are_bounded_in_size(tmp_path: Path) -> None:
    with (tmp_path / "a.json").open("wb") as file:
        file.truncate(70 * 2**20)
    refused(tmp_path, "a.json", "json recording", "67.1 MB")


def object_of_version_5(path: Path) -> None:
    def element(kind: int, content: bytes) -> bytes:
        return struct.pack("<II", kind, len(content)) + content + b"\0" * (-len(content) % 8)

    numbers = element(6, struct.pack("<II", 13, 0)) + element(5, struct.pack("<ii", 6, 1)) + element(1, b"")
    numbers += element(6, struct.pack("<6I", 0xDD000000, 2, 1, 1, 1, 1))
    names = b"".join(element(1, name) for name in (b"z", b"MCOS", b"iddata"))
    body = element(6, struct.pack("<II", 17, 0)) + names + element(14, numbers)
    path.write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<HH", 0x100, 0x4D49) + element(14, body))


def object_of_version_73(path: Path) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        made = file.create_dataset("z", data=np.array([[0xDD000000], [2], [1], [1], [1], [1]], dtype=np.uint32))
        made.attrs["MATLAB_class"] = np.bytes_("iddata")
        made.attrs["MATLAB_object_decode"] = 3


@pytest.mark.parametrize("write", [object_of_version_5, object_of_version_73])
def test_an_object_of_matlab_is_refused_with_the_lines_that_save_its_numbers(tmp_path: Path, write: Any) -> None:
    write(tmp_path / "a.mat")
    refused(tmp_path, "a.mat: z is an object of class iddata", "output_m = z.OutputData; save('z.mat', 'time_s'")


def test_an_object_within_a_structure_of_matlab_is_left_alone_with_a_note(tmp_path: Path) -> None:
    import h5py

    with h5py.File(tmp_path / "a.mat", "w") as file:
        group = file.create_group("run")
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, kind in (("when", "datetime"), ("force", "double")):
            group.create_dataset(name, data=np.ones((1, 6))).attrs["MATLAB_class"] = np.bytes_(kind)
        group["when"].attrs["MATLAB_object_decode"] = 3
    found = read_mat(named_file(tmp_path / "a.mat"))
    assert found.names == ("run.force",) and found.notes[0].startswith("run.when (datetime): left alone")


@pytest.mark.parametrize("ending", ["mpt", "xlsx"])
def test_tables_of_any_ending_and_the_sheet_that_is_asked_for_are_read(tmp_path: Path, ending: str) -> None:
    columns = {"clock": np.arange(60) / 100.0, "drive": DRIVE[:60], "moved": SWING[:60]}
    said = "drive, unit: N}, output: {column: moved, unit: mm}, time: {column: clock, unit: s}}"
    (tmp_path / "recordings.yaml").write_text(
        f"setup: {{model: linear}}\ncolumns: {{input: {{column: {said}\nrecordings: [a.{ending}]"
    )
    frame = pd.DataFrame(columns)
    if ending == "xlsx":
        pytest.importorskip("openpyxl")
        with pd.ExcelWriter(tmp_path / "a.xlsx") as book:
            pd.DataFrame({"a": np.arange(90), "b": 1.0}).to_excel(book, sheet_name="Plan", index=False)
            frame.to_excel(book, sheet_name="Log", index=False)
        assert any("of its sheets Log is read, not Plan" in note for note in read(tmp_path).notes)
    else:
        frame.to_csv(tmp_path / "a.mpt", sep="\t", index=False)
        assert [f.file for f in look(tmp_path).files] == ["a.mpt"]
    (r,) = read(tmp_path).recordings
    np.testing.assert_allclose(r.u, DRIVE[:60])


def logged(folder: Path, stamps: list[str], manifest: str, head: str = "", **columns: np.ndarray) -> Path:
    """A csv of stamps and columns of numbers, with its manifest."""
    rows = zip(stamps, *columns.values(), strict=True)
    lines = [",".join([s, *(f"{v:.12g}" for v in values)]) for s, *values in rows]
    (folder / "recordings.yaml").write_text(f"setup: {{model: mass_spring_damper}}\n{manifest}")
    return written(folder, [",".join([head or ("time_s" if "." in stamps[1] else "when"), *columns]), *lines])


SWING = 12.0 * np.sin(0.11 * np.arange(400))
DRIVE = np.sin(0.05 * np.arange(400))


@pytest.mark.parametrize(("stamps", "step"), [
    ([f"0{4 + (s > 299)}/03/2024 {'23:5' + str(5 + s // 60) if s < 300 else '00:0' + str(s // 60 - 5)}:{s % 60:02d}"
      for s in range(400)], 1.0),
    ([f"{12 + (s > 299)}-04-2024 {'23:5' + str(5 + s // 60) if s < 300 else '00:0' + str(s // 60 - 5)}:{s % 60:02d}"
      for s in range(400)], 1.0),
    ([f"{20 + s // 60}:{s % 60:02d}:00" for s in range(400)], 60.0),
    ([f"07-Feb-2025 10:{s // 60:02d}:{s % 60:02d}" for s in range(400)], 1.0),
])  # fmt: skip
def test_stamps_that_can_be_read_in_two_ways_go_on_steadily(tmp_path: Path, stamps: list[str], step: float) -> None:
    (r,) = read(logged(tmp_path, stamps, "input: zero_order", force_N=DRIVE, displacement_mm=SWING)).recordings
    np.testing.assert_allclose(np.diff(r.t), step)


@pytest.mark.parametrize(("head", "stamp", "column"), [
    ("Date,Time", "{d:%-m/%-d/%Y},{d:%X}", ""), ("Date,Time (HH:mm:ss),Time (frac)", "{d:%d.%m.%Y},{d:%X},0", ""),
    ("when", "{d:%d/%m/%Y} {d:%X}", ""), ("Step Time,Total Time", "00:00:{s:02d},0d 00:{m}:{s}", "Total Time"),
])  # fmt: skip
def test_dates_times_of_day_and_durations_are_clocks(tmp_path: Path, head: str, stamp: str, column: str) -> None:
    dates = [datetime(2031, 5, 6, 23, 57) + timedelta(seconds=s) for s in range(400)]
    stamps = [stamp.format(d=d, m=s // 60, s=s % 60) for s, d in enumerate(dates)]
    stamps = [s.replace("07/05/2031 00:00:00", "06/05/2031 24:00:00") for s in stamps]
    manifest = f"columns: {{time: {{column: {column}}}}}" if column else ""
    (r,) = read(logged(tmp_path, stamps, manifest, head, force_N=DRIVE, displacement_mm=SWING)).recordings
    np.testing.assert_allclose(np.diff(r.t), 1.0)
    for cell, words in (("", "row 20 (line 21): "), ("9:99:99", "row 20 (line 21): '"))[: 0 if column else 2]:
        stamps[19] = stamp.format(d=dates[19], m=0, s=0).replace(f"{dates[19]:%X}", cell)
        with pytest.raises(InputRefused) as error:
            read(logged(tmp_path, stamps, manifest, head, force_N=DRIVE, displacement_mm=SWING))
        assert words in str(error.value) and "missing: " not in str(error.value)


def test_a_stated_rate_counts_where_a_clock_is_coarser_than_the_rows(tmp_path: Path) -> None:
    stamps = [f"{0.015 * np.floor(k / 800 / 0.015):.3f}" for k in range(400)]
    with pytest.raises(InputRefused, match=r"two rows with one time .*sample_rate_hz"):
        read(logged(tmp_path, stamps, "", force_N=DRIVE, displacement_mm=SWING))
    (r,) = read(logged(tmp_path, stamps, "sample_rate_hz: 800", force_N=DRIVE, displacement_mm=SWING)).recordings
    np.testing.assert_allclose(r.t, np.arange(400) / 800)


def test_segments_a_slice_and_a_spare_channel_do_as_messages_say(tmp_path: Path) -> None:
    k, y = np.arange(400), SWING.copy()
    stamps = [f"{t:.3f}" for t in 0.01 * k + 0.05 * (k >= 120) + 2.0 * (k >= 200) + 3.0 * (k >= 220)]
    y[395], warm = np.nan, np.full(400, np.nan)
    for said, words in (("", "slice"), ("slice: [0, 390]", "segments: true"), ("slice: [0, 390], segments: true", "")):
        columns = {"force_N": DRIVE, "displacement_mm": y, "temperature_K": warm}
        logged(tmp_path, stamps, f"recordings: [{{file: a.csv, {said}}}]", **columns)
        if words:
            refused(tmp_path, words)
    campaign = read(tmp_path)
    assert [(r.name, r.t.size) for r in campaign.recordings] == [("a_1", 200), ("a_2", 170)]
    for words in ("1 segments of fewer than 50 samples were left out: row 201", "the temperature was left out"):
        assert any(words in note for note in campaign.notes)


@pytest.mark.parametrize("turn", [360.0, 2.0 * np.pi, 4096.0])
def test_a_swing_about_the_seam_of_an_angle_is_unwrapped_not_taken_for_glitches(tmp_path: Path, turn: float) -> None:
    stamps, moved = [f"{0.01 * k:.2f}" for k in range(400)], 0.08 * turn * np.sin(0.11 * np.arange(400))
    manifest = "columns: {output: {column: angle, unit: mm%s}, input: {column: force_N, unit: N}}"
    with pytest.raises(InputRefused, match="say unwrap: "):
        read(logged(tmp_path, stamps, manifest % "", force_N=DRIVE, angle=moved % turn))
    unwrapped = logged(tmp_path, stamps, manifest % f", unwrap: {turn!r}", force_N=DRIVE, angle=moved % turn)
    (r,) = read(unwrapped).recordings
    np.testing.assert_allclose(1e3 * (r.y - r.y[0]), moved - moved[0], atol=1e-8)


def test_masked_rows_of_an_input_are_interpolated_over_time(tmp_path: Path) -> None:
    # Two rasters, one of them seven thirds of the other, on the union of their stamps.
    t = np.unique(np.concatenate([0.03 * np.arange(300), 0.07 * np.arange(128)]).round(9))
    force, motion = np.sin(0.9 * t), np.sin(0.7 * t + 0.4)
    lines = [f"{s:.4f},{u:.9f}," if k else f"{s:.4f},,{y:.9f}" for s, u, y, k in
             zip(t, force, motion, np.isclose(t / 0.07, np.rint(t / 0.07)), strict=True)]  # fmt: skip
    (tmp_path / "recordings.yaml").write_text(
        "setup: {model: mass_spring_damper}\nstart: unknown\n"
        "columns: {input: {column: force_N, unit: N, missing: empty}, "
        "output: {column: motion_mm, unit: mm, missing: empty}}"
    )
    (r,) = read(written(tmp_path, ["time_s,force_N,motion_mm", *lines])).recordings
    np.testing.assert_allclose(r.u[9:-9], np.sin(0.9 * (r.t + t[0]))[9:-9], atol=2e-5)


def test_a_number_far_off_all_others_that_comes_again_is_a_mark(tmp_path: Path) -> None:
    stamps, y = [f"{0.01 * k:.2f}" for k in range(400)], SWING + 0.01 * DRIVE
    for mark, words in ((-765.4321, "missing: [-765.4321]"), (9.9e37, "missing: [9.9e+37]")):
        y[[50, 51, 52, 170, 171]] = mark
        with pytest.raises(InputRefused) as error:
            read(logged(tmp_path, stamps, "", force_N=DRIVE, displacement_mm=y))
        assert words in str(error.value)
    manifest = "columns: {displacement: {column: displacement_mm, missing: empty}}"
    (r,) = read(logged(tmp_path, stamps, manifest, force_N=DRIVE, displacement_mm=y)).recordings
    assert r.seen is not None and int((~r.seen).sum()) == 5


def test_two_files_with_two_clocks_are_not_put_side_by_side(tmp_path: Path) -> None:
    for name, late, header, values in (("a", 0.0, "time_s,force_N", DRIVE), ("b", 0.37, "time_s,position_mm", SWING)):
        rows = [f"{late + 0.01 * k:.3f},{v:.9g}" for k, v in enumerate(values)]
        written(tmp_path, [header, *rows], f"{name}.csv")
    (tmp_path / "recordings.yaml").write_text(
        "setup: {model: mass_spring_damper}\nrecordings: [{file: [a.csv, b.csv]}]\n"
        "columns: {time: {column: 0, unit: s}, input: {column: 1, unit: N}, output: {column: 3, unit: mm}}"
    )
    with pytest.raises(InputRefused, match=r"times that differ \(0 to 3.99; 0.37 to 4.36\)"):
        read(tmp_path)
