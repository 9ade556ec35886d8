"""Settings that would run without bound, and the limits as the documentation states them."""

from __future__ import annotations

from pathlib import Path

import pytest
from attack_tools import Attack

from phnn.cli import main
from phnn.intake.limits import LIMITS, Limits, available_memory

DOCUMENT = Path(__file__).parents[2] / "docs" / "limits.md"
COUNTS = (
    "starts=1001", "workers=257", "workers=0", "starts=1e9", "starts=" + "9" * 400, "seed=" + "9" * 400, "seed=-1",
)  # fmt: skip
TRAINING = ("substeps=1025", "model.hysterons=21", "model.hysterons=-1", "model.hysterons=two", "model.width=4097",
            "model.width=[1]", "model.spring_width=1e9", "seed=" + "9" * 30, "stride=0", "folder=/dev/zero",
            "manifest=/dev/zero", "manifest=/etc/passwd", "base=/dev/zero", "base=/etc/passwd")  # fmt: skip


@pytest.mark.parametrize("setting", COUNTS)
@pytest.mark.parametrize("command", ["identify", "diagnose", "compare"])
def test_counts_beyond_the_limits(command: str, setting: str, attack: Attack, good: Path) -> None:
    assert attack(good, command, more=(setting,)).refused


@pytest.mark.parametrize("setting", TRAINING)
def test_training_beyond_the_limits(
    setting: str, good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", f"folder={good}", f"out={tmp_path / 'out'}", setting]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert "internal error" not in message


def test_every_limit_stands_in_the_documentation() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    for name, value, unit, reason in LIMITS.table():
        assert f"| `{name}` | {value:,} | {unit} | {reason} |" in text


def test_limits_are_positive_and_memory_is_known() -> None:
    assert all(value > 0 for _, value, _, _ in Limits().table())
    assert 0 < LIMITS.memory_for_a_file() < available_memory()
