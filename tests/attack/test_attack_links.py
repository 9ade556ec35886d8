"""Recordings whose numbers lie in other files."""

from __future__ import annotations

from pathlib import Path

import h5py
import pytest
from arrays import SIZE, T, U, Y, columns
from attack_tools import Attack, put


def external(folder: Path, form: str) -> None:
    """An HDF5 file whose numbers lie in a file beside the folder."""
    secret = folder.parent / "secret.h5"
    with h5py.File(secret, "w") as f:
        columns(f)
    raw = folder.parent / "secret.bin"
    raw.write_bytes(U.tobytes())
    with h5py.File(folder / "a.h5", "w") as f:
        f["time_s"], f["displacement_m"] = T, Y
        if form == "link":
            f["voltage_V"] = h5py.ExternalLink(str(secret), "/voltage_V")
        elif form == "soft link through it":
            f["other"] = h5py.ExternalLink(str(secret), "/")
            f["voltage_V"] = h5py.SoftLink("/other/voltage_V")
        elif form == "soft link to a link":
            f["g/other"] = h5py.ExternalLink(str(secret), "/")
            f["g/near"] = h5py.SoftLink("other/voltage_V")
            f["voltage_V"] = h5py.SoftLink("/g/near")
        elif form == "group":
            f["g"] = h5py.ExternalLink(str(secret), "/")
        elif form == "storage":
            f.create_dataset("voltage_V", (SIZE,), "f8", external=[(str(raw), 0, U.nbytes)])
        else:
            layout = h5py.VirtualLayout((SIZE,), "f8")
            layout[:] = h5py.VirtualSource(str(secret), "voltage_V", (SIZE,))
            f.create_virtual_dataset("voltage_V", layout)


@pytest.mark.parametrize("suffix", [".h5", ".mat"])
@pytest.mark.parametrize("form", ["link", "soft link through it", "soft link to a link", "group", "storage", "virtual"])
def test_numbers_in_other_files_are_refused_unless_allowed(
    form: str, suffix: str, attack: Attack, tmp_path: Path
) -> None:
    folder = tmp_path / "data"
    folder.mkdir()
    external(folder, form)
    (folder / "a.h5").rename(folder / f"a{suffix}")
    if form == "group":
        put(folder / "recordings.yaml", "columns: {voltage: {column: g.voltage_V, unit: V}}\n")
    outcome = attack(folder)
    assert outcome.refused
    assert "--allow-outside" in outcome.err
    assert attack(folder, more=("--allow-outside",)).status == 0


def test_a_virtual_dataset_of_its_own_file_is_read(attack: Attack, tmp_path: Path) -> None:
    folder = tmp_path / "data"
    folder.mkdir()
    with h5py.File(folder / "a.h5", "w") as f:
        f["time_s"], f["displacement_m"], f["raw"] = T, Y, U
        layout = h5py.VirtualLayout((SIZE,), "f8")
        layout[:] = h5py.VirtualSource(f["raw"])
        f.create_virtual_dataset("voltage_V", layout)
    assert attack(folder).status == 0
