"""Hostile manifests: values of every kind under every key, structures that multiply, and what others would execute."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest
from attack_tools import Attack, each, often, put
from hypothesis import given
from hypothesis import strategies as st

KEYS = (
    "setup", "known", "voltage", "columns", "variables", "sample_rate_hz", "start", "periodic", "input",
    "segments", "ports", "outputs", "axes", "recordings",
)  # fmt: skip
EACH = ("file", "name", "slice", "use", *KEYS[3:13])
VALUES = [
    "null", "''", "nonsense", "x" * 5000, "0", "-1", "9" * 18, "9" * 400, ".inf", "-.inf", ".nan", "1e308", "1e-320",
    "true", "[]", "[1, 2, 3]", "[[[[1]]]]", "{}", "{a: 1}", "{1: 2, 3: 4}", "{null: 1}", "{a: {b: {c: {d: 1}}}}",
    "'${oc.env:HOME}'", "${oc.env:HOME,none}", "'${voltage}'", '"\\e[31mred\\e[0m"', '"a\\0b"', '"\\u202egnp.exe"',
    "../../../../etc/passwd", "/etc/passwd", "/dev/zero", "!!python/object/apply:os.system ['true']",
    "!!binary aGFsbG8=", "!!set {a, b}", "2001-12-14t21:59:43.10-05:00", "190:20:30", "0o17", "1_000",
]  # fmt: skip
WHOLE: list[str | bytes] = [
    " \n\t\n", "3", "- a\n- b", "{[}", "voltage: command\n---\nvoltage: command", "voltage: command\nvoltage: command",
    "voltage: *nobody", "setup: &a {model: *a}", "recordings: &r [*r]", "a: &a {model: hrc}\nsetup: {<<: *a}",
    "setup: {<<: 3}", "? [a, b]\n: 1", "!include /etc/passwd", b"voltage: \xff\xfe\x80",
    "voltage: command".encode("utf-16"), "\ufeffvoltage: command", b"voltage: \x07\x1b[2J", b"a: \xed\xa0\x80",
    "recordings: " + "[" * 5000, "recordings: " + "[" * 900 + "]" * 900, "setup: " + "{a: " * 2000 + "1" + "}" * 2000,
    "\n".join(" " * i + "a:" for i in range(600)), "".join(f"k{i}: {i}\n" for i in range(20000)),
    "? " + "k" * 500_000 + "\n: 1", "#" * (2**20 + 1), "#\n" * 200_000, "recordings: [" + "a.csv, " * 20_000 + "]",
    "".join(f"k{i}: &a{i} {i}\n" for i in range(5000)), "voltage: '" + "x" * 900_000 + "'",
    "voltage: >\n" + "  x\n" * 100_000,
]  # fmt: skip


# The anchor at the bottom, and what stands for many aliases of the one below.
FORMS = {
    "list": ("x", lambda many: f"[{', '.join(many)}]"),
    "mapping": ("{k: 1}", lambda many: f"{{{', '.join(f'k{j}: {alias}' for j, alias in enumerate(many))}}}"),
    "merged": ("{k: 1}", lambda many: f"{{<<: [{', '.join(many)}]}}"),
}


def bomb(levels: int, form: str, width: int = 9) -> str:
    """Aliases of aliases: ``width ** levels`` values when written out."""
    last, several = FORMS[form]
    lines = [f"a{i}: &a{i} {several([f'*a{i - 1}'] * width)}" for i in range(1, levels + 1)]
    return "\n".join([f"a0: &a0 {last}", *lines, f"recordings: *a{levels}"])


@pytest.mark.parametrize("entry", [
    *(f"{key}: VALUE\n" for key in KEYS), "recordings: [{file: VALUE}]\n",
    *(f"recordings: [{{file: a.csv, {key}: VALUE}}]\n" for key in EACH[1:]),
])  # fmt: skip
def test_any_value_under_any_key(entry: str, attack: Attack, good: Path) -> None:
    def one(value: str) -> None:
        put(good / "recordings.yaml", entry.replace("VALUE", value))
        attack(good)

    each(VALUES, one)


@pytest.mark.parametrize("text", range(len(WHOLE)))
def test_any_text_as_a_manifest(text: int, attack: Attack, good: Path) -> None:
    put(good / "recordings.yaml", WHOLE[text])
    attack(good)


@pytest.mark.parametrize(("levels", "form"), [*itertools.product((2, 9, 30), ("list", "mapping", "merged"))])
def test_aliases_of_aliases(levels: int, form: str, attack: Attack, good: Path) -> None:
    put(good / "recordings.yaml", bomb(levels, form))
    assert attack(good).refused


ANCHORS = (
    *("{k: -1.0}", "{k: 0}", "{m: -1e-3}", "{m: .nan}", "{k: {value: 1, std: -1}}", "{k: {std: 1}}", "{k: 1e300}"),
    *("{nobody: 1}", "{'': 1}", "{C_1: -1}", "{C_9: 1}", "{alpha: -0.04}", "{b: 1e-320}", "{k: {value: {a: 1}}}"),
    *("{d_1: 0}", "{k: {value: 1, std: .inf}}", '{"\\e[31m": 1}', "[k, 1]", "{k: true}"),
)


@pytest.mark.parametrize("model", ["{}", "{model: linear}", "{model: bouc_wen}", "{hysterons: 0}"])
def test_check_refuses_anchors_that_identify_refuses(model: str, attack: Attack, good: Path) -> None:
    def one(value: str) -> None:
        put(good / "recordings.yaml", f"setup: {model}\nknown: {value}\n")
        checked = attack(good)
        assert checked.refused
        # All models prepare in the same way.
        assert model != "{}" or attack(good, "identify").err == checked.err

    each(ANCHORS, one)


def test_nothing_of_the_environment_reaches_an_answer(
    attack: Attack, good: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PHNN_SECRET", "swordfish")
    for text in (
        "recordings: [{file: a.csv, name: '${oc.env:PHNN_SECRET}'}]", "voltage: ${oc.env:PHNN_SECRET}",
        "known: {'${oc.env:PHNN_SECRET}': 1}", "setup: {network: '${oc.env:PHNN_SECRET}.yaml'}",
    ):  # fmt: skip
        put(good / "recordings.yaml", text)
        outcome = attack(good)
        assert outcome.refused
        assert "swordfish" not in outcome.out + outcome.err


SCALARS = st.one_of(
    st.none(), st.booleans(), st.integers(-(10**19), 10**19), st.floats(), st.text(max_size=8), st.sampled_from(KEYS),
    st.sampled_from(("a.csv", "voltage_V", "rest", "m", "s", "time", "command", "hrc", "cubic", "confirmation")),
)  # fmt: skip
INNER = ["model", "hysterons", "network", "column", "unit", "scale", "value", "std", "state", "input_before", "voltage"]
NAMES = st.sampled_from([*KEYS, *EACH, *INNER, "displacement"]) | st.text(max_size=5)
TREES = st.recursive(SCALARS, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(NAMES, inner, max_size=4))


@often(30)
@given(content=st.dictionaries(st.sampled_from(KEYS), TREES, max_size=3))
def test_manifests_at_random(content: dict[str, object], attack: Attack, good: Path) -> None:
    import yaml

    put(good / "recordings.yaml", yaml.safe_dump(content, allow_unicode=True))
    attack(good)


MANIFEST = """setup: {model: piezo_actuator, hysterons: 1}
known: {k: {value: 2.4e4, std: 10}}
columns: {voltage: {column: voltage_V, unit: V}}
start: {state: rest, input_before: 0.0}
recordings:
  - {file: a.csv, name: b, slice: [0, 110], use: identification, input: cubic}
"""


@often(30)
@given(at=st.integers(0, len(MANIFEST)), cut=st.integers(0, 12), piece=st.text(max_size=6))
def test_manifests_with_a_damaged_place(at: int, cut: int, piece: str, attack: Attack, good: Path) -> None:
    put(good / "recordings.yaml", MANIFEST[:at] + piece + MANIFEST[at + cut :])
    attack(good)
