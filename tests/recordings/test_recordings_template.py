"""`phnn template`: a first manifest for folders of several layouts, and that the reader takes it."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import yaml
from recordings_example import NOISE, sine, write_sine

from phnn.cli import main
from phnn.errors import InputRefused
from phnn.recordings import Campaign, read
from phnn.recordings.manifest import TOP_KEYS
from phnn.template import _WANTED, look


def written(folder: Path, tmp_path: Path) -> tuple[str, Campaign]:
    """The template of a folder, and what the reader makes of it."""
    out = tmp_path / "first.yaml"
    out.write_text(look(folder).text(), encoding="utf-8")
    return out.read_text(encoding="utf-8"), read(folder, out)


def rows(frequency: float, amplitude: float = 60.0, seed: int = 0) -> np.ndarray:
    """(N, 3) time in s, voltage in V, displacement in µm."""
    t, u = sine(frequency, amplitude)
    return np.column_stack([t, u, 0.9 * u + 1e6 * NOISE * np.random.default_rng(seed).normal(size=t.size)])


def save(path: Path, table: np.ndarray, header: str = "", separator: str = ",") -> None:
    lines = [separator.join(repr(float(v)) for v in row) for row in table]
    path.write_text("\n".join([*([header] if header else []), *lines]) + "\n", encoding="utf-8")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "data").mkdir()
    return tmp_path / "data"


def test_a_folder_that_needs_no_manifest_gets_one(folder: Path, tmp_path: Path) -> None:
    for i in range(5):
        write_sine(folder, f"sine_{i}", 1.0 + i, 40.0 + 5.0 * i)
    text, campaign = written(folder, tmp_path)
    assert "left out, phnn chooses" in text and not campaign.held_out
    assert campaign.setup["model"] == "piezo_actuator"
    assert text.count("columns:") == 1
    assert "guessed: the" not in text


@pytest.mark.parametrize(("header", "order", "separator"), [
    ("", (0, 1, 2), ","), ("Time [ms];Vin;Sensor (um)", (0, 1, 2), ";"), ("displacement,voltage,t", (2, 1, 0), ","),
    ("# t u y", (0, 1, 2), " "), ("sample,zeit,Spannung [V],Weg [um]", (3, 0, 1, 2), ","),
    ("time,voltage,displacement,temperature", (0, 1, 2, 3), ","),
])  # fmt: skip
def test_columns_are_found_by_name_unit_or_place(
    header: str, order: tuple[int, ...], separator: str, folder: Path, tmp_path: Path
) -> None:
    for name, frequency in (("a", 5.0), ("b", 8.0)):
        table = rows(frequency)
        if "[ms]" in header:
            table[:, 0] *= 1e3
        table = np.column_stack([table, np.arange(len(table))])
        save(folder / f"{name}.txt", table[:, order], header, separator)
    _, campaign = written(folder, tmp_path)
    assert [r.name for r in campaign.recordings] == ["a", "b"]
    for r, frequency in zip(campaign.recordings, (5.0, 8.0), strict=True):
        assert r.dt == pytest.approx(1.0 / (400.0 * frequency))
        np.testing.assert_allclose(r.u, rows(frequency)[:, 1])
        np.testing.assert_allclose(r.y, 1e-6 * rows(frequency)[:, 2])


@pytest.mark.parametrize(("header", "scale", "line"), [
    ("x-axis,1,2\nsecond,Volt,Volt", 1.0, 'time: {column: "x-axis [second]", unit: s}'), ("", 2e3, "the true rate"),
    ("t_s,Left (C),Right Last (C)", 1.0, 'output: {column: "Right Last (C)", unit: degC}   # Right Last (C); guessed'),
    ("time_s,Voltage_0,Voltage_1,Temperature_0", 1.0, "not used: Temperature_0"),
])  # fmt: skip
def test_units_and_counters_say_which_column_is_what(
    header: str, scale: float, line: str, folder: Path, tmp_path: Path
) -> None:
    table = rows(5.0)[:, [0, 1, 2, 0][: max(header.split("\n")[0].count(",") + 1, 3)]]
    table[:, 0] = np.rint(2e3 * table[:, 0]) * (scale / 2e3)
    save(folder / "a.csv", table, header)
    assert line in written(folder, tmp_path)[0]


def test_without_a_time_a_rate_is_written_to_be_corrected(folder: Path, tmp_path: Path) -> None:
    save(folder / "a.dat", rows(5.0)[:, 1:])
    text, campaign = written(folder, tmp_path)
    assert campaign.recordings[0].dt == 1e-3
    assert "write the true rate" in text


def test_another_system_is_no_actuator(folder: Path, tmp_path: Path) -> None:
    save(folder / "a.csv", rows(5.0), "time,torque,angle")
    text, campaign = written(folder, tmp_path)
    assert campaign.setup["model"] == "linear"
    assert campaign.recordings[0].units == ("1", "1")
    assert 'input: {column: "torque"' in text


@pytest.mark.parametrize(
    ("header", "model", "more"),
    [
        ("time_s,force_N,position_mm", "mass_spring_damper", "mass_damper if no spring"),
        ("time_s,voltage_V,speed [rad/s]", "motor", "derivative: true"),
        ("Time(s),Voltage(V),Current(A)", "battery", 'input: {column: "Current(A)"'),
        ("time_s,temperature_degC,power_W", "heated_body", 'output: {column: "temperature_degC"'),
        ("time_s,inflow [L/min],level_cm", "tank", "a flow fills"),
    ],
)
def test_units_propose_a_ready_model_and_say_why(
    folder: Path, tmp_path: Path, header: str, model: str, more: str
) -> None:
    save(folder / "a.csv", rows(5.0) * [1.0, 1.0, 30.0], header)
    text, campaign = written(folder, tmp_path)
    assert campaign.setup["model"] == model
    assert "guessed from" in text and more in text


def test_numbers_that_no_actuator_gives_are_those_of_another_system(folder: Path, tmp_path: Path) -> None:
    save(folder / "a.csv", rows(5.0) * [1.0, 1e6, 1.0])
    assert written(folder, tmp_path)[1].setup["model"] == "voice_coil"


def test_variables_without_an_order_are_found_by_name(folder: Path, tmp_path: Path) -> None:
    t, u, y = rows(5.0).T
    np.savez(folder / "a.npz", t=t, u=u, y=y, config=np.arange(3))
    _, campaign = written(folder, tmp_path)
    np.testing.assert_allclose(campaign.recordings[0].y, 1e-6 * y)


def test_files_that_cannot_be_used_are_told_in_comments(folder: Path, tmp_path: Path) -> None:
    write_sine(folder, "good", 5.0, 60.0)
    save(folder / "narrow.csv", rows(5.0)[:, :1], "time_s")
    (folder / "broken.csv").write_text("no numbers at all\n")
    (folder / "notes.pdf").write_bytes(b"%PDF")
    text, campaign = written(folder, tmp_path)
    assert [r.name for r in campaign.recordings] == ["good"]
    for word in ("# ", "narrow.csv", "broken.csv", "notes.pdf"):
        assert word in text


def test_jumps_of_time_and_empty_cells_get_their_keys(folder: Path, tmp_path: Path) -> None:
    values = rows(5.0)
    values[values.shape[0] // 2 :, 0] += 1.0
    values[7, 2] = np.nan
    save(folder / "a.csv", values, "t / s,Kraft in N,Weg in mm")
    text, campaign = written(folder, tmp_path)
    assert "segments: true   # guessed" in text and "missing: empty}   # Weg in mm; 1 cells are empty" in text
    assert campaign.setup["model"] == "mass_spring_damper" and len(campaign.recordings) == 2


def test_numbers_with_a_unit_behind_them_are_read(folder: Path, tmp_path: Path) -> None:
    lines = [f"{t:.9g} sec,{u:.9g},{y:.9g}\n" for t, u, y in rows(5.0)]
    (folder / "a.csv").write_text("Time,voltage_V,displacement_um\n" + "".join(lines))
    np.testing.assert_allclose(read(folder).recordings[0].t, rows(5.0)[:, 0], rtol=1e-8, atol=1e-12)
    assert 'time: {column: "Time", unit: s}' in written(folder, tmp_path)[0]


def test_channels_along_the_first_axis_are_found(folder: Path, tmp_path: Path) -> None:
    np.savez(folder / "a.npz", data=rows(5.0).T)
    text, campaign = written(folder, tmp_path)
    assert 'output: {column: "data[2]"' in text and campaign.recordings[0].t.size == rows(5.0).shape[0]


def test_files_of_one_name_and_several_endings_are_told_apart(folder: Path, tmp_path: Path) -> None:
    for kind in ("csv", "txt"):
        save(folder / f"a.{kind}", rows(5.0), "time_s,voltage_V,displacement_um")
    assert len({r.name for r in written(folder, tmp_path)[1].recordings}) == 2


HOSTILE = (
    "\x1b[31mred", "two\nlines", "- {file: x}", "a: b", "# comment", "true", "007", '"', "'", "\u202egnp", "\ufffe",
    os.fsdecode(b"\xff\xfe"), "${oc.env:HOME}", "\U0001f600", "&a *a", "a\u2028setup: evil",
)  # fmt: skip


@pytest.mark.slow
def test_hostile_names_of_files_and_columns_stay_names(folder: Path, tmp_path: Path) -> None:
    made = []
    for i, name in enumerate(HOSTILE):
        try:
            write_sine(folder, name, 2.0 + i, 60.0)
        except OSError:
            continue
        made.append(f"{name}.csv")
    for i, name in enumerate(HOSTILE):
        if "\n" not in name and not any("\ud800" <= c <= "\udfff" for c in name):
            save(folder / f"column{i}.csv", rows(5.0), f"{name};b;c".replace(",", ""), ";")
    text, campaign = written(folder, tmp_path)
    assert all(c.isprintable() or c == "\n" for c in text)
    content = yaml.safe_load(text)
    assert set(content) <= {"setup", "columns", "sample_rate_hz", "recordings"}
    files = {entry["file"] for entry in content["recordings"]}
    assert files <= set(os.listdir(folder))
    # What is refused, for its name or for a column that is a number, stands in a comment with the reason.
    assert len(files) == len(campaign.recordings) == len(os.listdir(folder)) - text.count("#   - file:")
    assert len(files) >= 2 * len(HOSTILE) - 7


def test_it_is_printed_or_written_anew_and_never_over_anything(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_sine(folder, "a", 5.0, 60.0)
    before = sorted(os.listdir(folder))
    assert main(["template", str(folder)]) == 0
    printed = capsys.readouterr().out
    assert "recordings:" in printed
    assert sorted(os.listdir(folder)) == before
    out = folder / "recordings.yaml"
    assert main(["template", str(folder), "--out", str(out)]) == 0
    assert out.read_text().rstrip() == printed.rstrip()
    assert main(["check", str(folder)]) == 0
    assert main(["template", str(folder), "--out", str(out)]) == 2
    link = tmp_path / "link.yaml"
    link.symlink_to(tmp_path / "elsewhere.yaml")
    assert main(["template", str(folder), "--out", str(link)]) == 2
    assert main(["template", str(folder), "--out", str(tmp_path)]) == 2
    assert main(["template", str(folder), "--out", str(tmp_path / "absent" / "a.yaml")]) == 2
    assert "Traceback" not in capsys.readouterr().err
    assert not (tmp_path / "elsewhere.yaml").exists()


def test_a_folder_without_anything_to_read_is_refused(folder: Path) -> None:
    (folder / "notes.pdf").write_bytes(b"%PDF")
    with pytest.raises(InputRefused, match="no recordings"):
        look(folder)


def test_every_key_that_is_shown_is_one_of_the_manifest(folder: Path) -> None:
    write_sine(folder, "a", 5.0, 60.0)
    shown = [line[2:].partition(":")[0] for line in look(folder).text().splitlines() if line.startswith("# ")]
    keys = [key for key, _, _ in _WANTED if key in TOP_KEYS]
    assert [key for key in shown if key in TOP_KEYS] == keys
    for key, value, _ in _WANTED:
        assert isinstance(yaml.safe_load(f"{key}: {value}"), dict)
