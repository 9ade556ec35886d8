"""The table of many runs: one row a folder that `phnn.learn.run.train` has written into, whatever became of the run."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from phnn.errors import InputRefused
from phnn.learn import checkpoint, logs
from phnn.learn.run import CONFIG, METRICS
from phnn.learn.settings import FREE_TO_CHANGE, settings_in

# Why a run has failed, in its folder: the first line for the table, a traceback below it where there is one.
ERROR = "error.txt"
STATES = ("finished", "failed", "interrupted")
SCORES = ("epochs", "best_validation", "held_out_over_noise", "violations", "parameters", "seconds")


def gather(folder: Path) -> pd.DataFrame:
    """One row for every run in a folder or below it, in the order of their names.

    Columns: ``run``, the folder's name; every setting in which the runs differ, nested ones with dots; ``seed``;
    ``state``, one of `STATES`; `SCORES`, empty where the run has not got so far; ``reason``, why it failed.

    Raises:
        InputRefused: there is no run.
    """
    homes = sorted(
        {path.parent for name in (CONFIG, ERROR) for path in folder.rglob(name) if not _hidden(path, folder)}
    )
    if not homes:
        raise InputRefused(f"{folder}: no run in it ({CONFIG} or {ERROR}): give the folder of a sweep")
    settings = [_settings(home) for home in homes]
    shown = _differing(settings)
    rows = []
    for home, given in zip(homes, settings, strict=True):
        chosen = {key: given.get(key) for key in shown}
        rows.append({"run": home.relative_to(folder).as_posix(), **chosen, **_result(home)})
    table = pd.DataFrame(rows)
    # Half-filled columns of whole numbers would become 3.0 of 3.
    whole = ["epochs", "violations", "parameters", *(key for key in shown if _are_whole(table[key]))]
    return table.astype(dict.fromkeys(whole, "Int64"))


def _hidden(path: Path, folder: Path) -> bool:
    return any(part.startswith(".") for part in path.relative_to(folder).parts)


def _are_whole(column: pd.Series) -> bool:
    return all(isinstance(v, int) and not isinstance(v, bool) for v in column.dropna().tolist())


def _settings(home: Path) -> dict[str, Any]:
    """A run's settings with dotted keys; empty where it failed before it had any."""
    path = home / CONFIG
    if not path.exists():
        return {}
    return dict(_flat(settings_in(path)))


def _flat(content: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    found = []
    for key, value in content.items():
        found += _flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else [(f"{prefix}{key}", value)]
    return found


def _differing(settings: Sequence[Mapping[str, Any]]) -> list[str]:
    """Keys with more than one value among the runs that have them, and the seed."""
    keys = dict.fromkeys(key for given in settings for key in given if key not in (*FREE_TO_CHANGE, "seed"))
    several = [key for key in keys if len({repr(given[key]) for given in settings if key in given}) > 1]
    return [*several, "seed"]


def _result(home: Path) -> dict[str, Any]:
    """State and scores of one run."""
    empty = dict.fromkeys(SCORES)
    if (home / ERROR).exists():
        reason = (home / ERROR).read_text(encoding="utf-8").partition("\n")[0]
        return {"state": "failed", **empty, **_so_far(home), "reason": reason}
    if not (home / METRICS).exists():
        return {"state": "interrupted", **empty, **_so_far(home), "reason": ""}
    try:
        content = json.loads((home / METRICS).read_text(encoding="utf-8"))
        scores = {
            "epochs": content["epochs"],
            "best_validation": content["best_validation"],
            "held_out_over_noise": content["held_out_over_noise"],
            "violations": content["passivity"]["violations"],
            "parameters": content["parameters_trained"],
            "seconds": content["seconds"],
        }
    except (ValueError, KeyError, TypeError) as error:
        raise InputRefused(f"{home / METRICS}: cannot be read ({error}): delete it and repeat the run") from error
    return {"state": "finished", **scores, "reason": ""}


def _so_far(home: Path) -> dict[str, Any]:
    """What the log of a run that has not ended tells."""
    path = home / logs.FILE
    if not (home / checkpoint.FILE).exists() or not path.exists():
        return {}
    log = pd.read_csv(path)
    if log.empty:
        return {"epochs": 0}
    best = log["validation"].min()
    return {
        "epochs": len(log),
        "best_validation": None if pd.isna(best) else float(best),
        "seconds": float(log["seconds"].iloc[-1]),
    }
