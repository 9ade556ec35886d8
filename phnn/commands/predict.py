"""``phnn predict``."""

from __future__ import annotations

from pathlib import Path

from phnn.commands.terminal import console
from phnn.prediction import document
from phnn.predictor import predictor
from phnn.recordings import read
from phnn.report.predicted import score_table
from phnn.results import claim, printable, unique_names


def predict(
    model: Path, folder: Path, out: Path, manifest: Path | None, outside: bool = False, overwrite: bool = False
) -> None:
    """Simulate the recordings of a folder with a stored model; writes one ``NAME.csv`` per recording and
    ``predict.json`` with fit %, RMSE and residual over noise wherever the output was recorded.

    Where the input jumps between two samples, a further column says how uncertain that makes the output.
    """
    simulator = predictor(model, outside)
    campaign = read(folder, manifest, need_output=False, allow_outside=outside)
    predictions = simulator(campaign)
    files, found = unique_names((r.name for r in campaign.recordings), ".csv"), []
    results = (*files.values(), "predict.json")
    with claim(out, "predict", [model, folder], results, overwrite=overwrite) as place:
        for one in predictions:
            name = files[one.recording.name]
            (place / name).write(one.table.to_csv(index=False).encode())
            found.append(one)
            print(out / name)
        content = document(found, files, printable(str(model)))
        (place / "predict.json").write_json(content)
    table = score_table(content)
    if table is not None:
        console().print(table)
    print(f"results: {out / 'predict.json'}")
