"""The table of the training runs below a folder: ``python scripts/gather.py out/sweep``; writes runs.csv there.

One row a folder that a training has written into, whatever became of the run.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from rich.markup import escape
from rich.table import Table

from phnn.commands import console, refusals
from phnn.errors import InputRefused
from phnn.learn import trainer
from phnn.learn.run import CONFIG, METRICS
from phnn.learn.settings import FREE_TO_CHANGE, settings_in
from phnn.multirun import ERROR
from phnn.results import Place

SCORES = ("epochs", "best_validation", "held_out_over_noise", "parameters", "seconds")


def gathered(folder: Path) -> pd.DataFrame:
    """Return one row for every run in a folder or below it, in the order of their names.

    Columns: ``run``, the folder's name; every setting in which the runs differ, nested ones with dots; ``seed``;
    ``state``: finished, failed or interrupted; `SCORES`, empty where the run has not got so far; ``reason``, why it
    failed.

    Raises:
        InputRefused: there is no run.
    """
    paths = (path.relative_to(folder) for name in (CONFIG, ERROR) for path in folder.rglob(name))
    homes = sorted({path.parent for path in paths if not any(part.startswith(".") for part in path.parts)})
    if not homes:
        raise InputRefused(f"{folder}: no run in it ({CONFIG} or {ERROR}): give the folder of a sweep")
    # A run may have failed before it had any settings.
    files = [folder / home / CONFIG for home in homes]
    settings = [dict(_flat(settings_in(path))) if path.exists() else {} for path in files]
    shown = _differing(settings)
    table = pd.DataFrame(
        {"run": home.as_posix(), **{key: given.get(key) for key in shown}, **_result(folder / home)}
        for home, given in zip(homes, settings, strict=True)
    )
    # Half-filled columns of whole numbers would become 3.0 of 3.
    whole = ["epochs", "parameters", *(key for key in shown if _are_whole(table[key]))]
    return table.astype(dict.fromkeys(whole, "Int64"))


def _are_whole(column: pd.Series) -> bool:
    return all(isinstance(v, int) and not isinstance(v, bool) for v in column.dropna().tolist())


def _flat(content: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    """Return settings with dotted keys."""
    pairs = []
    for key, value in content.items():
        pairs += _flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else [(f"{prefix}{key}", value)]
    return pairs


def _differing(settings: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the keys with more than one value among the runs that have them, and the seed."""
    keys = dict.fromkeys(key for given in settings for key in given if key not in (*FREE_TO_CHANGE, "seed"))
    several = [key for key in keys if len({repr(given[key]) for given in settings if key in given}) > 1]
    return [*several, "seed"]


def _result(home: Path) -> dict[str, Any]:
    """Return state and scores of one run."""
    empty = dict.fromkeys(SCORES)
    if (home / ERROR).exists():
        reason = (home / ERROR).read_text(encoding="utf-8").partition("\n")[0]
        return {"state": "failed", **empty, **_so_far(home), "reason": reason}
    if not (home / METRICS).exists():
        return {"state": "interrupted", **empty, **_so_far(home), "reason": ""}
    try:
        content = json.loads((home / METRICS).read_text(encoding="utf-8"))
        scores = {key: content[key] for key in ("epochs", "best_validation", "held_out_over_noise")}
        scores |= {"parameters": content["parameters_trained"], "seconds": content["seconds"]}
    except (ValueError, KeyError, TypeError) as error:
        raise InputRefused(f"{home / METRICS}: cannot be read ({error}): delete it and repeat the run") from error
    return {"state": "finished", **scores, "reason": ""}


def _so_far(home: Path) -> dict[str, Any]:
    """Return what the log of a run that has not ended tells."""
    path = home / trainer.LOG
    if not (home / trainer.FILE).exists() or not path.exists():
        return {}
    log = pd.read_csv(path)
    if log.empty:
        return {"epochs": 0}
    best, last = log["validation"].min(), float(log["seconds"].iloc[-1])
    return {"epochs": len(log), "best_validation": None if pd.isna(best) else float(best), "seconds": last}


def gather(folder: Path) -> bool:
    """Print the table of the training runs in a folder and write ``runs.csv`` there; tell whether a run has failed."""
    runs = gathered(folder)
    (Place(folder.resolve()) / "runs.csv").write(runs.to_csv(index=False).encode())
    columns = [c for c in runs.columns if c not in ("run", "reason")]
    table = Table(*columns, title=f"runs in {folder}")
    for row in runs[columns].astype(object).to_numpy().tolist():
        table.add_row(*("–" if pd.isna(v) else f"{v:.4g}" if isinstance(v, float) else escape(str(v)) for v in row))
    console(160).print(table)
    failed = runs.loc[runs["state"] == "failed", ["run", "reason"]].to_numpy().tolist()
    for name, reason in failed:
        print(f"{name}: {reason}")
    print(f"results: {folder / 'runs.csv'}")
    return bool(failed)


def main() -> None:
    """Gather, and refuse bad input in one line."""
    parser = argparse.ArgumentParser(description="Print and write the table of the training runs below a folder.")
    parser.add_argument("folder", type=Path, nargs="?", default=Path("out/sweep"), help="default: %(default)s")
    with refusals("gather"):
        gather(parser.parse_args().folder)


if __name__ == "__main__":
    main()
