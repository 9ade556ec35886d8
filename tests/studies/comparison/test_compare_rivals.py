"""The rivals of the studies join a comparison through the same door as a user's."""

from __future__ import annotations

import json
from pathlib import Path

import compare_example as example
import pytest

from phnn.comparison import models
from phnn.comparison.run import compare
from phnn.errors import InputRefused
from phnn.recordings import read
from studies.comparison.rivals import HEADS, register_rivals
from studies.rival_models.names import NAMES


@pytest.fixture(autouse=True)
def _registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(models, "_RIVALS", {})
    register_rivals()


def test_rivals_are_scored_like_the_others(tmp_path: Path) -> None:
    campaign = read(example.written(tmp_path / "recordings"))
    results = compare(campaign, tmp_path / "out", example.settings("models=[dahl,subnet]"))
    facts = json.loads((tmp_path / "out" / "models.json").read_text())
    assert all(f["budget"] == 1.0 and f["processor_seconds"] < 5.0 and f["size"] for f in facts.values())
    over = {m: r.evaluation.over_noise("identification") for m, r in results.items()}
    assert over["dahl"] < over["subnet"]
    again = compare(campaign, tmp_path / "out", example.settings("models=[dahl]"))
    assert again["dahl"].evaluation.parts == results["dahl"].evaluation.parts
    with pytest.raises(InputRefused, match="budget"):
        compare(campaign, tmp_path / "out", example.settings("models=[dahl]", "budget=2.0"))


def test_every_rival_has_a_title() -> None:
    assert [models.title(name) for name in NAMES] == [HEADS[name] for name in NAMES]
