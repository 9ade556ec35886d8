"""The text of the effect pages, from the declarations of the effects."""

from __future__ import annotations

import csv
import io
from collections import Counter
from contextlib import redirect_stdout
from functools import cache
from pathlib import Path
from string import Formatter

import numpy as np
from effect_scenes import SHOWN, Shown, scene_of, tank_scene

from phnn.effects import Declared, Effect, catalogue
from phnn.parameters import quantity
from phnn.setup import Setup

_CASES = Path(__file__).resolve().parents[1] / "proof-cases.csv"
_GRADES = {"exact": "named", "class": "in a class of equally good effects", "wrong": "missed"}

# The example of each page; it is run when the page is made, and its output stands below it.
_EXAMPLE = """\
import numpy as np
import phnn
from phnn.effects import effect
{imports}
base = phnn.Setup({network})
model = phnn.Model(effect("{name}").add_to(base, {values}))

t = np.linspace(0.0, {duration}, 1001)
u = {input}
print(f"{{np.abs(model.simulate(t, u)).max():.4g}} {unit}")
"""
_ACTUATOR = {
    "imports": "", "network": "phnn.models.from_paper()", "duration": 0.05,
    "input": "75.0 * np.sin(2.0 * np.pi * 20.0 * t)  # voltage [V]",
}  # fmt: skip
_TANKS = {
    "imports": "from phnn.configuration import config_folder\nfrom phnn.models.network_file import load_network\n",
    "network": 'load_network(config_folder() / "network" / "tanks.yaml")', "duration": 100.0,
    "input": "5e-5 * (1.0 - np.cos(2.0 * np.pi * 0.04 * t))  # inflow [m³/s]",
}  # fmt: skip


def title(effect: Effect) -> str:
    """The name of an effect as a heading."""
    words = effect.name.replace("_", " ")
    return words[0].upper() + words[1:]


def page(shown: Shown) -> str:
    """The page of one effect in MyST markdown."""
    effect = shown.effect
    parts = [
        f"# {title(effect)}",
        f"**Location:** {effect.location} — {effect.kind.name}. " + _nature(effect),
        f"## Symptom\n\n{effect.fingerprint}",
        _picture(shown),
        f"## Law\n\n$$\n{effect.equation}\n$$\n\n{_filled(shown)}",
        _parameters(effect, shown.setup),
        *_forms(effect),
        f"## What is confused with it\n\n{_confused(effect)}",
        f"## The recording that separates it\n\n{effect.separation}",
        _measured(effect),
        _example(shown),
        "## References\n\n" + "\n".join(f"* {r}" for r in effect.references),
    ]
    return "\n\n".join(p for p in parts if p) + "\n"


def index(effects: list[Effect]) -> str:
    """The page that lists all effects by location."""
    lines = [
        "# Effects that phnn can name",
        "Each page is made from the effect's own declaration: what it looks like in recordings, its law, its "
        "parameters, what is confused with it, and the recording that separates it. The pictures are simulated when "
        "this site is built. To add an effect of your own, see [](../write-your-own-effect.md).",
    ]
    for location in dict.fromkeys(e.location for e in effects):
        rows = [f"| [{title(e)}]({e.name}.md) | {e.fingerprint} |" for e in effects if e.location == location]
        lines.append(f"## {location.capitalize()}\n\n| effect | symptom |\n|---|---|\n" + "\n".join(rows))
    names = "\n".join(e.name for e in effects)
    return "\n\n".join(lines) + f"\n\n```{{toctree}}\n:hidden:\n:maxdepth: 1\n\n{names}\n```\n"


def _nature(effect: Effect) -> str:
    inside = "It is a passive part of the network." if effect.passive else "It lies outside the passive network."
    command = " It can be found only where the recorded voltage is the amplifier's command." * effect.needs_command
    return inside + command


def _picture(shown: Shown) -> str:
    share = np.sqrt(np.mean(shown.left**2) / np.mean(shown.change**2))
    return (
        f"![Loops and difference, {title(shown.effect)}](pictures/{shown.effect.name}.png)\n\n"
        "Simulated on a base model without (grey) and with the effect (blue), strong enough to be seen: "
        f"{_values(shown)}. Where the law has a strength, it is chosen to change the output by at most {SHOWN:.0%}. "
        f"Other parameters of the base model leave {share:.0%} of the change (root mean square, orange, to first order)"
        " unexplained: that is what a diagnosis sees."
    )


def _values(shown: Shown) -> str:
    parameters = shown.setup.parameters
    told = [f"`{n}` = {quantity(parameters[n].value, parameters[n].unit)}" for n in shown.values]
    return ", ".join(told) or "it has no parameters"


def _filled(shown: Shown) -> str:
    """The statement with the values of the picture."""
    parameters, text = shown.setup.parameters, shown.effect.statement
    names = {name for _, name, _, _ in Formatter().parse(text) if name}
    told = {n: quantity(parameters[n].value, parameters[n].unit) for n in names}
    return "A report says it like this, here with the values of the picture:\n\n> " + text.format(**told)


def _parameters(effect: Effect, setup: Setup) -> str:
    """The table of the parameters, as they are placed in a setup that has the effect."""
    if not effect.declares:
        return "It has no parameters."
    rows = (f"| `{d.name}` | {_unit(d)} | {d.description} | {_role(d, setup)} | {_range(d)} |" for d in effect.declares)
    head = "| parameter | unit | meaning | role | range in real actuators |\n|---|---|---|---|---|\n"
    return head + "\n".join(rows)


def _unit(declared: Declared) -> str:
    return declared.unit.replace("{sensed}", "m")


def _role(declared: Declared, setup: Setup) -> str:
    if declared.strength:
        return "strength: zero when the effect is absent"
    return "constant, not estimated" if setup.parameters[declared.name].fixed else "shape, estimated"


def _range(declared: Declared) -> str:
    known = declared.plausible
    if not known.source:
        return "–"
    unit = _unit(declared) if not known.over else f"of `{known.over}`"
    ends = (quantity(v, _unit(declared)) if not known.over else f"{v:.3g}" for v in (known.lower, known.upper))
    return " to ".join(ends) + (f" {unit}" if known.over else "") + f": {known.source}"


def _forms(effect: Effect) -> list[str]:
    """The other forms of the law, under the same name."""
    found, scene = [], scene_of(effect)
    for number, form in enumerate(effect.forms, start=2):
        setup = form.add_to(scene.setup, form.grid(scene.scales)[0])
        statement = form.statement.replace("{", "`").replace("}", "`")
        found.append(f"## Form {number} of the law\n\n$$\n{form.equation}\n$$\n\n{statement}")
        found.append(_parameters(form, setup) if form.declares else "")
    return found


def _links(names: list[str]) -> str:
    return ", ".join(f"[{title(catalogue()[n])}]({n}.md)" for n in names)


def _confused(effect: Effect) -> str:
    others = [e for e in catalogue().values() if e.name != effect.name]
    near = list(dict.fromkeys([*effect.neighbours, *(e.name for e in others if effect.name in e.neighbours)]))
    same = [e.name for e in others if e.kind == effect.kind and scene_of(e) is scene_of(effect)]
    lines = [
        f"* Ordinary recordings cannot always tell it from {_links(near)}." if near else "",
        f"* The same kind, because it acts through the same variables: {_links(same)}." if same else "",
    ]
    return "\n".join(line for line in lines if line) or "No other effect of the catalogue."


@cache
def _cases() -> list[dict[str, str]]:
    with _CASES.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def _measured(effect: Effect) -> str:
    """How often the recorded proof found the effect where it was concealed alone; empty where it never was."""
    grades = Counter(row["grade"] for row in _cases() if row["truth"] == effect.name)
    if not grades:
        return ""
    told = ", ".join(f"{words}: {grades[g]}" for g, words in _GRADES.items())
    cases = (
        f"Cases of the recorded [proof](../proof.md) that conceal it alone: {grades.total()}; {told}. So few cases "
        "give no rate; how certain a diagnosis of your recordings is, its own p-value and held-out error say."
    )
    return f"## Found in tests\n\n{cases}"


def _example(shown: Shown) -> str:
    """Code that adds the effect to the base model, with its output; none for a motion that is imposed by recordings."""
    if shown.setup.network.senses:
        return ""
    network = shown.setup.network
    unit = next(s.unit for s in network.storages if s.name == network.output)
    values = {name: float(f"{value:.3g}") for name, value in shown.values.items()}
    words = _TANKS if scene_of(shown.effect) is tank_scene() else _ACTUATOR
    code = _EXAMPLE.format(name=shown.effect.name, values=values, unit=unit, **words)
    with redirect_stdout(io.StringIO()) as out:
        exec(compile(code, shown.effect.name, "exec"), {})
    return f"## In Python\n\n```python\n{code}```\n\n```text\n{out.getvalue()}```"
