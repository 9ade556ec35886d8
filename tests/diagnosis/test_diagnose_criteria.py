"""Every criterion is documented, read by the code, and can be overridden; settings stand once."""

from __future__ import annotations

import re
from dataclasses import asdict, fields
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import phnn.diagnosis
from phnn.configuration import compose
from phnn.criteria import CRITERIA, Criteria
from phnn.criteria.criterion import Criterion
from phnn.diagnosis import diagnose
from phnn.errors import InputRefused
from phnn.identification.options import Options

TABLE = Criteria.table()
HOME = Path(phnn.diagnosis.__file__).parent
PRIVATE_WORDS = ("vain", "nibble", "astray", "loud", "bold", "settled", "fake", "imitate", "akin")


@pytest.mark.parametrize("row", TABLE, ids=lambda r: r.name)
def test_every_criterion_says_unit_meaning_and_evidence(row: Criterion) -> None:
    assert row.unit and row.meaning.endswith(".") and row.evidence.endswith(".")
    assert row.evidence.split()[0].rstrip(":") in ("Calculation", "Measured", "Argument", "Choice")
    assert not set(re.findall(r"\w+", f"{row.name} {row.meaning} {row.evidence}".lower())) & set(PRIVATE_WORDS)


@pytest.mark.parametrize("row", TABLE, ids=lambda r: r.name)
def test_every_criterion_is_read_somewhere(row: Criterion) -> None:
    """A criterion that nothing reads decides nothing."""
    sources = [
        *HOME.glob("*.py"),
        *HOME.glob("rules/*.py"),
        HOME.parent / "identification" / "residual_noise.py",
        *(HOME.parent / "criteria" / f"{n}.py" for n in ("composition", "confirmation")),
    ]
    assert any(re.search(rf"\.{row.name}\b", p.read_text(encoding="utf-8")) for p in sources)


def test_names_are_unique_and_the_table_holds_all() -> None:
    names = [r.name for r in TABLE]
    assert len(set(names)) == len(names) == sum(len(fields(getattr(CRITERIA, f.name))) for f in fields(CRITERIA))
    assert CRITERIA.values() == {r.name: r.default for r in TABLE} and CRITERIA.changed() == {}


@given(st.sampled_from(TABLE), st.floats(0.1, 10.0))
def test_one_override_changes_one_criterion(row: Criterion, factor: float) -> None:
    value = row.times(factor)
    changed = CRITERIA.with_values({row.name: value})
    assert getattr(getattr(changed, row.group), row.name) == value
    others = {n: v for n, v in changed.values().items() if n != row.name}
    assert others == {n: v for n, v in CRITERIA.values().items() if n != row.name}
    assert changed.changed() == ({row.name: value} if value != row.default else {})


def test_an_override_on_the_command_line_reaches_the_options() -> None:
    given_ = compose("diagnose", ["criteria.material=0.2", "criteria.retested=2", "material_share=0.03"])
    options = Options.from_config(given_)
    changed = CRITERIA.with_values(options.criteria)
    assert (changed.confirmation.material, changed.confirmation.material_share) == (0.2, 0.03)
    assert changed.selection.retested == 2 and isinstance(changed.selection.retested, int)
    assert changed.changed() == {"material": 0.2, "material_share": 0.03, "retested": 2}


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("criteria.matter=0.2", "no criterion is called 'matter'"),
        ("criteria.material=-1", "criteria.material=-1 must be a positive number"),
        ("criteria.material=much", "criteria.material=much must be a positive number"),
        ("criteria.retested=1.5", "criteria.retested=1.5 must be a whole number"),
        ("criteria=3", "write criteria.NAME=value"),
    ],
)
def test_what_is_no_criterion_is_refused(override: str, words: str) -> None:
    with pytest.raises(InputRefused, match=words):
        compose("diagnose", [override])


def test_a_diagnosis_refuses_it_before_anything_is_fitted() -> None:
    with pytest.raises(InputRefused, match="no criterion is called"):
        diagnose(None, Options(criteria={"matter": 1.0}))  # type: ignore[arg-type]


@pytest.mark.parametrize("command", ["diagnose", "identify"])
def test_the_yaml_states_no_other_value_than_the_class(command: str) -> None:
    stated = compose(command)
    assert asdict(Options.from_config(stated)) == asdict(Options())
    own = asdict(Options())
    assert stated == {n: list(own[n]) if isinstance(own[n], tuple) else own[n] for n in stated}
