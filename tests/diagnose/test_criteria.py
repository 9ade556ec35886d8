"""Criteria and options: each is read and can be overridden, and what is wrong is refused before anything is fitted."""

from __future__ import annotations

import re
from dataclasses import asdict
from pathlib import Path
from typing import Any
from unittest import mock

import pytest

from phnn.configuration import compose
from phnn.diagnose import diagnosis as path
from phnn.diagnose.criteria import Criteria
from phnn.diagnose.diagnosis import diagnose
from phnn.errors import InputRefused
from phnn.identification.options import Options

HOME = Path(path.__file__).parent


@pytest.mark.parametrize("name", [row["name"] for row in Criteria.table()])
def test_every_criterion_is_read_somewhere(name: str) -> None:
    """A criterion that nothing reads decides nothing."""
    sources = [p for p in HOME.glob("*.py") if p.name != "criteria.py"]
    assert any(re.search(rf"criteria\.{name}\b", p.read_text(encoding="utf-8")) for p in sources)


def test_an_override_on_the_command_line_reaches_the_options() -> None:
    given_ = compose("diagnose", ["criteria.material=0.2", "criteria.refits=2", "material_share=0.03"])
    changed = Criteria().with_values(Options.from_config(given_).criteria)
    assert (changed.material, changed.material_share) == (0.2, 0.03)
    assert changed.refits == 2 and isinstance(changed.refits, int)
    assert changed.changed() == {"material": 0.2, "material_share": 0.03, "refits": 2}


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("criteria.matter=0.2", "no criterion is called 'matter'"),
        ("criteria.material=-1", "criteria.material=-1 must be a positive number"),
        ("criteria.material=much", "criteria.material=much must be a positive number"),
        ("criteria.refits=1.5", "criteria.refits=1.5 must be a whole number"),
        ("criteria=3", "write criteria.NAME=value"),
    ],
)
def test_what_is_no_criterion_is_refused(override: str, words: str) -> None:
    with pytest.raises(InputRefused, match=words):
        compose("diagnose", [override])


@pytest.mark.parametrize(
    ("options", "budget", "words"),
    [
        (Options(criteria={"matter": 1.0}), None, "no criterion is called"),
        (Options(executor="fork"), None, "executor=fork is not known"),
        (Options(without=("crep",)), None, "crep"),
        (Options(), 0.0, "budget: 0 s: give a positive number of seconds"),
    ],
)
def test_what_is_wrong_is_refused_before_anything_is_fitted(options: Options, budget: float | None, words: str) -> None:
    nothing: Any = mock.sentinel.campaign
    with (
        mock.patch.object(path, "identify_base", side_effect=AssertionError("fitted")),
        pytest.raises(InputRefused, match=words),
    ):
        diagnose(nothing, options, budget=budget)


@pytest.mark.parametrize("command", ["diagnose", "identify"])
def test_the_yaml_states_no_other_value_than_the_class(command: str) -> None:
    stated = compose(command)
    assert asdict(Options.from_config(stated)) == asdict(Options())
    own = asdict(Options())
    assert stated == {n: list(own[n]) if isinstance(own[n], tuple) else own[n] for n in stated}
