"""Hostile checkpoints: none is run, and each that is not one of the package is refused."""

from __future__ import annotations

import io
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from attack_tools import put, zipped

from phnn.errors import InputRefused
from phnn.learn import checkpoint


class _Runs:
    def __reduce__(self) -> Any:
        return (eval, ("__import__('pathlib').Path('ran').write_text('')",))


def _saved(content: Any) -> bytes:
    file = io.BytesIO()
    torch.save(content, file)
    return file.getvalue()


STATE = {"schema": "phnn.checkpoint/1", "random": torch.get_rng_state()}
CHECKPOINTS = {
    "empty": b"", "a text": b"checkpoint", "zeros": bytes(4096), "a list": _saved([1, 2]),
    "no schema": _saved({"random": 1}), "another schema": _saved({**STATE, "schema": "x"}),
    "no random state": _saved({"schema": STATE["schema"]}),
    "a random state that is none": _saved({**STATE, "random": 3}),
    "an empty one": _saved({**STATE, "random": torch.zeros(0)}),
    "of another type": _saved({**STATE, "random": torch.zeros(5056)}), "no keys": _saved(STATE),
    "a pickle": pickle.dumps(_Runs()),
    "a pickle in a zip": zipped({"archive/data.pkl": pickle.dumps(_Runs()), "archive/version": b"3"}),
    "an empty zip": zipped({}), "a zip bomb": zipped({"archive/data.pkl": b"\x80\x02}", "archive/version": b"3"}),
    "a tensor that is not there": _saved(STATE)[:-800], "a numpy array": _saved({**STATE, "x": np.zeros(3)}),
}  # fmt: skip


@pytest.mark.parametrize("case", CHECKPOINTS)
def test_a_checkpoint_that_is_none_is_refused_and_never_run(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    put(tmp_path / checkpoint.FILE, CHECKPOINTS[case])
    with pytest.raises(InputRefused, match="delete it to begin anew"):
        checkpoint.load(tmp_path / checkpoint.FILE, ("settings", "progress"))
    assert [p.name for p in tmp_path.iterdir()] == [checkpoint.FILE]
