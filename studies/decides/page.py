"""Tables of docs/decides.md: the study of `studies.decides.compare`, halves against halves; rules and criteria."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phnn.criteria import Criteria
from phnn.diagnose.verdict import RULES, UNKNOWN
from phnn.report.formatting import markdown_table
from studies.decides.compare import RULES_ALONE, WAYS, answered, by_rules, numbered, tolerance
from studies.results import fill, stamped
from studies.sealed.grade import (
    CRITERIA,
    MISSED,
    OPEN,
    PARTLY,
    RIGHT,
    WRONG,
    Answer,
    Case,
    calibration_error,
    cases_in,
    is_learned_name,
    log_score,
)  # fmt: skip

Array = NDArray[np.float64]
Table = tuple[list[str], list[list[str]]]

HEAD = [
    "how models are weighed", "P(right), mean", "right, P ≥ 0.95", "in a class", "wrong name, P ≥ 0.95",
    "calibration error", "log score", "verdict right", "verdict wrong",
]  # fmt: skip
# What each half of the cases may choose.
PRICES, LEARNED, SLACKS, FACTORS = (1.0, 2.0, 3.4, 5.0, 7.0), (3.4, 6.0, 9.0), (1.05, 1.1, 1.2), (0.25, 0.5, 1.0, 2.0)
_RESAMPLED = 4000


@dataclass(frozen=True)
class Setting:
    """Values of what the number of a model is made of: prices in nats, slack in noise power, tolerated share of the
    misfit."""

    price_effect: float = CRITERIA.price_effect
    price_learned: float = CRITERIA.price_learned
    slack: float = CRITERIA.slack
    factor: float = 0.5

    @property
    def words(self) -> str:
        """The values in the order of the fields."""
        return f"{self.price_effect:g}, {self.price_learned:g}, {self.slack:g}, {self.factor:g}"

    def answer(self, case: Case) -> Answer:
        """Return what a case comes to with these values, without a verdict."""
        own = {n: getattr(self, n) for n in ("price_effect", "price_learned", "slack")}
        criteria = replace(CRITERIA, **own)
        weighed = numbered(case.models, tolerance(case.models, criteria, self.factor), criteria)
        return Answer(weighed.alternatives, weighed.probability, "", ())


# The defaults come first, then what differs least: of equally good ones the first is taken.
SETTINGS = tuple(
    sorted(
        (Setting(*values) for values in itertools.product(PRICES, LEARNED, SLACKS, FACTORS)),
        key=lambda s: sum(getattr(s, f.name) != f.default for f in fields(Setting)),
    )
)


def compared(cases: Sequence[Case]) -> Table:
    """Return a row for every way to weigh models, with what it says of all cases."""
    rows = []
    for name, way in WAYS.items():
        rows.append(_row(name, cases, [answered(c, way(c)) for c in cases]))
    rows.append(_row(RULES_ALONE, cases, [by_rules(c) for c in cases], probable=False))
    return HEAD, rows


def _row(name: str, cases: Sequence[Case], answers: Sequence[Answer], probable: bool = True) -> list[str]:
    pairs = list(zip(cases, answers, strict=True))
    right = np.array([c.right(a) for c, a in pairs])
    sure = right >= CRITERIA.proven
    classes = sum(c.in_class(a) for (c, a), s in zip(pairs, sure, strict=True) if not s)
    wrong = sum(any(p >= CRITERIA.proven and c.is_wrong(n) for n, p in a.probability.items()) for c, a in pairs)
    said = Counter(c.outcome(a) for c, a in pairs)
    error = calibration_error([s for c, a in pairs for s in c.statements(a)])
    score = float(np.mean([log_score(c, a) for c, a in pairs]))
    return [
        name, f"{right.mean():.3f}", f"{sure.sum()}", f"{classes}", f"{wrong}",
        f"{error:.3f}" if probable else "–", f"{score:.2f}" if probable else "–",
        f"{said[RIGHT]}", f"{said[WRONG]} + {said[MISSED]} `none`",
    ]  # fmt: skip


def by_group(cases: Sequence[Case]) -> Table:
    """Return what the product said of every group of cases."""
    head = [
        "concealed", "cases", "right model visited", "right", "partly", "no name", "wrong name", "`none`",
        "mean P(right)",
    ]  # fmt: skip
    rows = []
    for group in dict.fromkeys(c.row["group"] for c in cases):
        own = [c for c in cases if c.row["group"] == group]
        said = Counter(c.outcome(c.answer) for c in own)
        mean = np.mean([c.right(c.answer) for c in own])
        counts = [said[o] for o in (RIGHT, PARTLY, OPEN, WRONG, MISSED)]
        counts = [len(own), sum(c.visited for c in own), *counts]
        rows.append([group, *(f"{n}" for n in counts), f"{mean:.2f}"])
    return head, rows


def calibrated(cases: Sequence[Case]) -> Table:
    """Return how often effects are there to which the product gives a probability."""
    statements = [s for c in cases for s in c.statements(c.answer)]
    edges = (0.01, 0.05, 0.2, 0.5, 0.8, 0.95, 0.99, 1.0 + 1e-9)
    rows = []
    for low, high in itertools.pairwise(edges):
        inside = [(p, t) for p, t in statements if low <= p < high]
        mean, true = (f"{sum(s[i] for s in inside) / len(inside):.2f}" if inside else "–" for i in (0, 1))
        rows.append([f"{low:g} to {min(high, 1.0):g}", f"{len(inside)}", mean, true])
    return ["P(effect)", "statements", "mean P", "share that is true"], rows


def inside_unknown(cases: Sequence[Case]) -> Table:
    """Return how often effects with a proven probability act really where the whole is ``unknown``."""
    head = ["claims with P ≥ 0.95 in `unknown`", "claims", "concealed", "acts beside", "wrong"]
    unknown = [c for c in cases if c.row["verdict"] == UNKNOWN]
    claims = [
        (c, claim) for c in unknown for claim in c.row["claims"]
        if claim["probability"] >= CRITERIA.proven and not is_learned_name(claim["effect"])
    ]  # fmt: skip
    kinds = {"all": claims}
    for group in dict.fromkeys(c.row["group"] for c, _ in claims):
        kinds[group] = [k for k in claims if k[0].row["group"] == group]
    rows = []
    for name, own in kinds.items():
        true = sum(claim["effect"] in c.truth for c, claim in own)
        beside = sum(claim["effect"] in c.beside for c, claim in own)
        rows.append([name, f"{len(own)}", f"{true}", f"{beside}", f"{len(own) - true - beside}"])
    return head, rows


def halves(cases: Sequence[Case], settings: Sequence[Setting] | None = None) -> Table:
    """Return for each half of the cases, by parity of their seeds, the values that give it the best log score, and what
    they are worth on the other half; last, both together."""
    head = [
        "chosen on", "price, price learned, slack, share", "there", "defaults there", "on the other half", "defaults",
    ]  # fmt: skip
    settings = SETTINGS if settings is None else settings
    default = settings.index(Setting())
    scores = np.array([[log_score(c, s.answer(c)) for c in cases] for s in settings])
    odd = np.array([c.row["seed"] % 2 == 1 for c in cases])
    rows, gained = [], np.zeros(len(cases))
    for name, half in (("even seeds", ~odd), ("odd seeds", odd)):
        best = int(np.argmax(scores[:, half].mean(axis=1)))
        gained[~half] = scores[best, ~half] - scores[default, ~half]
        values = (scores[i, rows_].mean() for rows_ in (half, ~half) for i in (best, default))
        rows.append([name, settings[best].words, *(f"{v:.3f}" for v in values)])
    best = int(np.argmax(scores.mean(axis=1)))
    low, high = interval(gained)
    rows.append(["all", settings[best].words, f"{scores[best].mean():.3f}", f"{scores[default].mean():.3f}",
                 f"gain {gained.mean():+.3f} ({low:+.3f} to {high:+.3f})", "–"])  # fmt: skip
    return head, rows


def interval(values: Array) -> tuple[float, float]:
    """Return the 95 % interval of a mean, by resampling the cases."""
    rng = np.random.default_rng(0)
    means = rng.choice(values, (_RESAMPLED, values.size)).mean(axis=1)
    return float(np.quantile(means, 0.025)), float(np.quantile(means, 0.975))


def rules() -> Table:
    """Return the rules of a verdict in their order, with the case that each is needed for."""
    rows = [
        [f"{i}", f"`{r.name}`", f"`{r.word}`", ", ".join(f"`{n}`" for n in r.numbers), r.needed]
        for i, r in enumerate(RULES, 1)
    ]
    return ["", "rule", "verdict", "reads", "goes wrong without it"], rows


def criteria() -> Table:
    """Return every criterion of a diagnosis."""
    rows = [[f"`{r['name']}`", f"{r['default']:g}", r["unit"], r["meaning"], r["needed"]] for r in Criteria.table()]
    return ["criterion", "default", "unit", "meaning", "needs it"], rows


def study(cases: Sequence[Case]) -> dict[str, Table]:
    """Return all tables of a log by their titles."""
    return {
        "Ways to weigh models": compared(cases),
        "Answers by what was concealed": by_group(cases),
        "Probabilities against truth": calibrated(cases),
        "Values chosen on one half of the cases": halves(cases),
        "Proven elements of an unknown whole": inside_unknown(cases),
    }


def write(page: Path, log: Path | None = None) -> None:
    """Write rules and criteria of the page, and the tables of the study if there is a log.

    Raises:
        InputRefused: the page has no place for a table, or the log no case.
    """
    fill(page, "rules", markdown(rules()))
    fill(page, "criteria", markdown(criteria()))
    if log is not None:
        cases, failures = cases_in(log)
        seeds = [c.row["seed"] for c in cases]
        text = f"{len(cases)} cases, seeds {min(seeds)} to {max(seeds)}; {failures} without an answer."
        tables = (f"### {title}\n\n{markdown(table)}" for title, table in study(cases).items())
        commits = {c.row.get("commit", "unknown") for c in cases}
        fill(page, "study", stamped("\n\n".join([text, *tables]), commits))


def markdown(table: Table) -> str:
    """Return a table in markdown."""
    return "\n".join(markdown_table(*table))
