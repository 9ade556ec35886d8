"""Vary every criterion by half and double: ``python scripts/criteria.py --seed 1 --cases 2 --minutes 8 [--out DIR]``.

Sealed cases of every kind are diagnosed with the default criteria and with each criterion changed alone, each
time anew. Writes ``criteria.json`` and ``criteria.md``; cases that were finished in the time that was given are
counted.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # studies/ is not installed

from phnn.criteria import Criteria
from phnn.diagnosis.diagnosis import available, diagnose
from phnn.effects import Effect, effect
from phnn.errors import PhnnError
from phnn.identification.base import identify_base
from phnn.identification.options import Options
from phnn.recordings import Campaign, read
from phnn.report.result import document
from phnn.results import Place
from studies.generator import Sealed, draw_case, make_case
from studies.proof.cases import FULL, LEVELS, STRATA, Task
from studies.proof.grade import WRONG, graded
from studies.proof.prove import containing

FACTORS = (0.5, 2.0)
DEFAULT = "default"
Row = dict[str, Any]


def variants() -> dict[str, dict[str, float]]:
    """The criteria of every run, by its name; the defaults come first."""
    found: dict[str, dict[str, float]] = {DEFAULT: {}}
    for criterion in Criteria.table():
        for factor in FACTORS:
            value = criterion.times(factor)
            if value != criterion.default:
                found[f"{criterion.name} × {factor:g}"] = {criterion.name: value}
    return found


def answer(campaign: Campaign, effects: list[Effect], options: Options, task: Task, sealed: Sealed) -> Row:
    """One diagnosis, graded."""
    try:
        content: Mapping[str, Any] = document(diagnose(campaign, options, effects=effects))
    except PhnnError as error:
        content = {"failure": str(error)}
    found = graded(task, sealed, content)
    rules = [r["rule"] for r in content.get("rules", ()) if r["applies"]]
    return {"verdict": found.verdict, "named": list(found.named), "right": found.grade != WRONG, "rules": rules}


def vary(seed: int, stratum: str, number: int, plan: str, until: float) -> list[Row]:
    """All runs of one case; none where the time does not last for them."""
    task = Task(FULL, stratum, number, seed + number, plan)
    rows: list[Row] = []
    with TemporaryDirectory() as folder:
        sealed = make_case(draw_case(task.seed, stratum, plan, levels=LEVELS), Path(folder))
        campaign = read(Path(folder))
        base, _ = identify_base(campaign, Options(workers=1))
        effects = available(campaign, base.setup, [effect(n) for n in containing(sealed.withheld)])
        for name, criteria in variants().items():
            if time.monotonic() > until:
                return []
            row = answer(campaign, effects, Options(workers=1, criteria=criteria), task, sealed)
            rows.append({"case": task.name, "truth": list(sealed.effects), "run": name} | row)
    return rows


def table(rows: list[Row]) -> list[Row]:
    """By run: right and wrong answers, false alarms (names or mismatches where nothing is missing), changed answers."""
    default = {r["case"]: r for r in rows if r["run"] == DEFAULT}
    found = []
    for name in dict.fromkeys(r["run"] for r in rows):
        mine = [r for r in rows if r["run"] == name]
        changed = [r["case"] for r in mine if any(r[k] != default[r["case"]][k] for k in ("verdict", "named"))]
        found.append(
            {
                "run": name,
                "right": sum(r["right"] for r in mine),
                "wrong": sum(not r["right"] for r in mine),
                "false_alarms": sum(not r["right"] and not r["truth"] for r in mine),
                "changed": changed,
            }
        )
    return found


def decided(rows: list[Row]) -> Counter[str]:
    """In how many cases each rule applied, with the default criteria."""
    return Counter(rule for r in rows if r["run"] == DEFAULT for rule in dict.fromkeys(r["rules"]))


def page(rows: list[Row], command: str) -> str:
    """The result as markdown."""
    cases = [r for r in rows if r["run"] == DEFAULT]
    found = table(rows)
    lines = [
        f"Command: `{command}`. {len(cases)} cases: "
        + ", ".join(f"{r['case']} ({'+'.join(r['truth']) or 'nothing'}: {r['verdict']})" for r in cases) + ".",
        "", "| run | right | wrong | false alarms | answers changed |", "|---|---:|---:|---:|---|",
    ]  # fmt: skip
    lines += [
        f"| {r['run']} | {r['right']} | {r['wrong']} | {r['false_alarms']} | {', '.join(r['changed']) or '–'} |"
        for r in found
        if r["changed"] or r["run"] == DEFAULT
    ]
    same = [
        c.name for c in Criteria.table() if not any(r["changed"] for r in found if r["run"].startswith(c.name + " "))
    ]
    lines += ["", f"Neither half nor double of these changes an answer: {', '.join(same)}.", ""]
    lines += ["| rule | cases in which it applies |", "|---|---:|"]
    lines += [f"| {rule} | {count} |" for rule, count in decided(rows).most_common()]
    return "\n".join(lines) + "\n"


def listing() -> str:
    """All criteria as a markdown table."""
    lines = ["| criterion | stage | default | unit | meaning | evidence |", "|---|---|---:|---|---|---|"]
    lines += [
        f"| `{c.name}` | {c.group} | {c.default:g} | {c.unit} | {c.meaning} | {c.evidence} |" for c in Criteria.table()
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Vary the criteria case by case, round by round through the strata, until the time is over."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cases", type=int, default=1, help="of every stratum")
    parser.add_argument("--strata", nargs="+", choices=STRATA, default=STRATA)
    parser.add_argument("--plan", default="short")
    parser.add_argument("--minutes", type=float, default=60.0, help="cases unfinished by then do not count")
    parser.add_argument("--out", type=Path, default=Path("out/criteria"))
    parser.add_argument("--list", action="store_true", help="print the table of criteria and stop")
    given = parser.parse_args()
    if given.list:
        print(listing(), end="")
        return
    began, rows = time.monotonic(), []
    until = began + 60.0 * given.minutes
    for number in range(given.cases):
        for stratum in given.strata:
            if time.monotonic() > until:
                break
            found = vary(given.seed, stratum, number, given.plan, until)
            rows += found
            seconds = time.monotonic() - began
            print(f"{stratum} {number}: {len(found)} runs, {seconds:.0f} s", file=sys.stderr, flush=True)
    if not rows:
        sys.exit("criteria: no case was finished: give more --minutes")
    place = Place(given.out.resolve())
    (place / "criteria.json").write_json({"rows": rows, "table": table(rows)})
    command = f"python scripts/criteria.py --seed {given.seed} --cases {given.cases} --plan {given.plan}"
    command += f" --strata {' '.join(given.strata)}"
    (place / "criteria.md").write(page(rows, command).encode())
    print(page(rows, command))


if __name__ == "__main__":
    main()
