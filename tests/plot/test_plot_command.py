"""``phnn plot``: figures and tables as files, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import campaigns
import numpy as np
import pandas as pd
import pytest
from plot_example import MODEL, campaign

import phnn
from phnn.cli import main
from phnn.models.store import save
from phnn.plot.signals import located
from phnn.report.result import write


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a model and recordings."""
    home = tmp_path_factory.mktemp("plots")
    save(MODEL.setup, home / "result" / "model", 2)
    (home / "recordings").mkdir()
    for r in campaign().recordings:
        frame = pd.DataFrame({"time_s": r.t, "voltage_V": r.u, "displacement_m": r.y})
        frame.to_csv(home / "recordings" / f"{r.name}.csv", index=False)
    return home


def test_the_command_writes_a_figure_and_its_table(stored: Path, tmp_path: Path) -> None:
    model, folder, out = str(stored / "result"), str(stored / "recordings"), tmp_path / "out"
    assert main(["plot", "loops", model, folder, "--out", str(out), "--recording", "fast"]) == 0
    assert (out / "loops.svg").read_bytes().startswith(b"<?xml")
    assert set(pd.read_csv(out / "loops.csv")["recording"]) == {"fast"}


@pytest.mark.slow
def test_the_command_draws_every_kind(stored: Path, tmp_path: Path) -> None:
    model, folder, out = str(stored / "result"), str(stored / "recordings"), tmp_path / "out"
    for kind in ("compare", "residuals", "loops", "bode", "energy"):
        assert main(["plot", kind, model, folder, "--out", str(out)]) == 0, kind
        assert (out / f"{kind}.svg").read_bytes().startswith(b"<?xml")
        assert len(pd.read_csv(out / f"{kind}.csv"))
    assert len(pd.read_csv(out / "residuals_spectrum.csv"))
    assert set(pd.read_csv(out / "bode_measured.csv")["recording"]) == {"large", "small", "fast"}
    sweep = ["--frequencies", "5", "50", "--amplitude", "60"]
    assert main(["plot", "bode", model, "--out", str(out), *sweep]) == 0
    assert pd.read_csv(out / "bode.csv")["frequency_Hz"].iloc[[0, -1]].tolist() == pytest.approx([5.0, 50.0])
    # Results of other kinds stay beside it; the table of measured points is not of this run.
    assert (out / "loops.svg").exists()
    assert not (out / "bode_measured.csv").exists()


@pytest.mark.slow
def test_a_diagnosis_is_drawn_as_its_folder_is(tmp_path: Path) -> None:
    found = campaigns.diagnosis("quadratic_drag", "quadratic_drag")
    write(found, tmp_path / "diagnosis")
    assert main(["plot", "location", str(tmp_path / "diagnosis"), "--out", str(tmp_path / "out")]) == 0
    table = pd.read_csv(tmp_path / "out" / "location.csv", keep_default_na=False)
    own = located(found).tables()[""]
    assert list(table["location"]) == list(own["location"])
    assert list(table["rank"]) == list(own["rank"])
    # The file has four digits.
    np.testing.assert_allclose(table.iloc[:, 1], own.iloc[:, 1], atol=6e-5)
    assert phnn.plot.residuals(found, recordings=["sine_010Hz_75V"]).shape == (1, 3)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["compare"], "no recordings: name their folder"),
        (["bode"], "give both, or recordings"),
        (["bode", "--frequencies", "0", "5"], "--frequencies 0 5"),
        (["location"], "diagnosis.json: there is no such file"),
        (["location", "--recording", "a"], "location does not take --recording"),
        (["bode", "--recording", "a"], "bode does not take --recording"),
        (["compare", "--amplitude", "1"], "compare does not take --amplitude"),
        (["energy", "--recording", "a", "--recording", "b"], "energy draws one recording"),
    ],
)
def test_the_command_refuses(
    given: list[str], message: str, stored: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["plot", given[0], str(stored / "result"), "--out", str(tmp_path / "out"), *given[1:]]) == 2
    assert message in capsys.readouterr().err
