"""The comparison of trainers on paper: one table, the loss curves as csv and as a figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

from phnn.errors import InputRefused
from phnn.identification.base import Progress
from phnn.report.figures.style import CATEGORIES, RC, literal, new_figure, png, quiet_grid
from phnn.report.formatting import markdown_table
from phnn.results import Place
from studies.results import write_results
from studies.trainers.run import Case, Outcome, Way, compare_trainers, plain

# What is written into the folder of results.
RESULTS = ("recordings", "trainers.json", "trainers.md", "curves.csv", "curves.png")
_LEAST_SECONDS = 1e-2


def run(place: Place, config: Mapping[str, Any], progress: Progress) -> str:
    """Compare trainers as configured; write ``trainers.json``, ``trainers.md``, ``curves.csv`` and ``curves.png``.

    Returns:
        The table, as markdown.

    Raises:
        InputRefused: a case or a trainer that does not exist, or a key that they do not have.
    """
    ways = {name: Way(**given) for name, given in config["ways"].items()}
    chosen = list(config["only"] or config["cases"])
    for name in chosen:
        if name not in config["cases"]:
            raise InputRefused(f"only: no case {name!r}: choose from {', '.join(config['cases'])}")
        for way in config["cases"][name]["ways"]:
            if way not in ways:
                raise InputRefused(f"{name}: no trainer {way!r}: choose from {', '.join(ways)}")
    cases = {n: Case(**{**config["cases"][n], "ways": tuple(config["cases"][n]["ways"])}) for n in chosen}
    outcomes = compare_trainers(place, cases, ways, float(config["noise_um"]), int(config["seed"]), progress)
    text = table(outcomes, cases, ways)
    with rc_context(RC):
        (place / "curves.png").write(png(figure(outcomes, cases, ways)))
    documents = {"trainers.json": {"seed": config["seed"], "outcomes": plain(outcomes)}}
    write_results(place, {"curves.csv": curves(outcomes), "trainers.md": text}, documents)
    return text


def table(outcomes: Sequence[Outcome], cases: Mapping[str, Case], ways: Mapping[str, Way]) -> str:
    """One row a trainer; times as multiples of that of the first trainer of the case."""
    head = (
        "model", "trainer", "loss at the end", "held out, inside", "held out, beyond", "solved", "ms each",
        "time over Gauss–Newton",
    )  # fmt: skip
    first = {o.case: o.seconds for o in reversed(outcomes)}
    rows = []
    for o in outcomes:
        ratio = f"{o.seconds / first[o.case]:.1f}" if o.stopped else f"> {o.seconds / first[o.case]:.0f}, stopped"
        rows.append([
            cases[o.case].words, ways[o.way].words, f"{o.loss:.4g}", _number(o.inside), _number(o.beyond),
            str(o.gradients), f"{1e3 * o.seconds / o.gradients:.0f}", ratio,
        ])  # fmt: skip
    return "\n".join([*markdown_table(head, rows), ""])


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}"


def curves(outcomes: Sequence[Outcome]) -> str:
    """All curves as csv."""
    rows = [f"{o.case},{o.way},{s:.4f},{loss:.9g}\n" for o in outcomes for s, loss in o.curve]
    return "case,trainer,seconds,loss\n" + "".join(rows)


def figure(outcomes: Sequence[Outcome], cases: Mapping[str, Case], ways: Mapping[str, Way]) -> Figure:
    """Loss against seconds, one panel a case."""
    drawn = new_figure(3.4 * len(cases), 3.2)
    colours = dict(zip(ways, CATEGORIES, strict=False))
    for number, (name, case) in enumerate(cases.items(), start=1):
        axes = drawn.add_subplot(1, len(cases), number)
        for o in (o for o in outcomes if o.case == name):
            seconds = [max(s, _LEAST_SECONDS) for s, _ in o.curve]
            axes.loglog(seconds, [loss for _, loss in o.curve], color=colours[o.way], label=literal(ways[o.way].words))
        axes.axhline(1.0, color="0.6", linewidth=0.8)
        axes.set_title(literal(case.words), fontsize="small")
        axes.set_xlabel("seconds of one processor")
        axes.set_ylabel("loss (1: noise)" if number == 1 else "")
        axes.legend(fontsize="x-small")
        quiet_grid(axes)
    return drawn
