"""How do time and memory grow?

    python -m benchmarks.growth

Time of a forward solve (the integration alone) and of a gradient by all parameters (torch autograd through the
compiled step) against the number of samples, hysterons, recordings and parameters, with the slopes in log–log. The
longest recording runs in a process of its own, whose peak memory is measured.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from benchmarks.case import Array, Prepared, Solve, sine
from benchmarks.table import RESULTS, Contender, machine, save, show, timed, write_csv
from phnn.integrate.differentiable import simulated
from phnn.models.actuator import hrc
from phnn.network import PortHamiltonianSystem
from phnn.network.elements import Coupling, Network, Resistor, Storage
from phnn.parameters import positive
from phnn.setup import Setup

FREQUENCY = 50.0  # Hz
SAMPLES = (1_000, 10_000, 100_000, 1_000_000)
LARGEST = 10_000_000
HYSTERONS = (1, 2, 4, 8, 16, 32, 64)
RECORDINGS = (1, 10, 100, 1000)
# Four of the linear actuator, two for every Maxwell cell: 4, 10, 20, 50, 100 parameters.
CELLS = (0, 3, 8, 23, 48)
USUAL, SHORT = 5_000, 500  # samples
FORWARD, GRADIENT = "forward", "gradient"
# Below this a call itself weighs as much as its samples.
ASYMPTOTIC = 10_000
GOAL_SAMPLES, GOAL_HYSTERONS, GOAL_MEMORY = 0.05, 1.0, 4.0  # slope, slope, GiB
# Rather an error than a machine without memory.
_LIMIT = 16 * 2**30
_BUDGET = 2.0  # s


def gradient(system: PortHamiltonianSystem, u: torch.Tensor, h: float, x0: torch.Tensor) -> None:
    """Add the gradient of ``Σ q²`` by all parameters to the system's: the one call that is timed."""
    path = simulated(system, x0, u, h)
    (path[:, system.state_names.index(system.network.output)] ** 2).sum().backward()


def forward_solve(network: Network, samples: int, recordings: int = 1) -> Solve:
    """The integration alone on so many recordings of so many samples."""
    return Prepared([sine(FREQUENCY, samples)] * recordings, [1] * recordings, Setup(network)).march


def gradient_solve(network: Network, samples: int, recordings: int = 1) -> Solve:
    """Gradients on so many recordings of so many samples."""
    system = PortHamiltonianSystem(network)
    recording = sine(FREQUENCY, samples)
    u = torch.zeros(samples - 1, len(network.ports), dtype=torch.float64)
    # The mean of a straight line is that of its ends.
    u[:, 0] = torch.from_numpy(0.5 * (recording.u[1:] + recording.u[:-1]))
    x0 = torch.zeros(len(network.storages), dtype=torch.float64)

    def solve() -> Array:
        system.zero_grad()
        for _ in range(recordings):
            gradient(system, u, recording.dt, x0)
        return np.array([system.free.gradient(name) for name in system.free.declared])

    return solve


def with_cells(count: int) -> Network:
    """The linear actuator with Maxwell cells, relaxation times spread over four decades."""
    names = [(f"s_{i}", f"k_{i}", f"tau_{i}") for i in range(count)]
    times = np.geomspace(1e-4, 1.0, count).tolist()
    return hrc(0).extend(
        storages=tuple(Storage(s, "spring", (k,), "m") for s, k, _ in names),
        resistors=tuple(Resistor(f"cell_{s}", "maxwell", {s: 1.0}, (k, tau)) for s, k, tau in names),
        couplings=tuple(Coupling(s, "p", 1.0) for s, _, _ in names),
        parameters=tuple(
            p
            for (_, k, tau), t in zip(names, times, strict=True)
            for p in (positive(k, 2000.0 / count, "N/m"), positive(tau, t, "s"))
        ),
    )


def contenders() -> Iterator[Contender]:
    """Every point of every sweep but the largest, forward and gradient; the sweep and its size stand for the case."""

    def both(sweep: str, size: int, *work: object) -> Iterator[Contender]:
        made: Sequence[tuple[str, Callable[..., Solve]]] = ((FORWARD, forward_solve), (GRADIENT, gradient_solve))
        for what, make in made:
            yield Contender(sweep, float(size), what, "", 0.0, make(*work))

    for n in SAMPLES:
        yield from both("samples", n, hrc(2), n)
    for n in HYSTERONS:
        yield from both("hysterons", n, hrc(n), USUAL)
    for n in RECORDINGS:
        yield from both("recordings", n, hrc(2), SHORT, n)
    for n in CELLS:
        network = with_cells(n)
        yield from both("parameters", len(network.parameters), network, USUAL)


def largest() -> None:
    """Print seconds of the march and of the gradient on the longest record, and the peak memory of the gradient [GiB].

    NaN for a gradient that does not fit into `_LIMIT`.
    """
    resource.setrlimit(resource.RLIMIT_DATA, (_LIMIT, _LIMIT))
    small, solve = gradient_solve(hrc(2), 1000), gradient_solve(hrc(2), LARGEST)
    small()
    try:
        slope = _seconds(solve)
        # In KiB. The gradient makes its own march, so that this is the memory of a forward solve as well.
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    except (MemoryError, RuntimeError) as error:
        print(f"{LARGEST:,} samples within {_LIMIT / 2**30:g} GiB: {error}", file=sys.stderr)
        slope = peak = float("nan")
    del solve
    march = forward_solve(hrc(2), LARGEST)
    march()
    print(_seconds(march), slope, peak)


def _seconds(solve: Solve) -> float:
    begin = time.perf_counter()
    solve()
    return time.perf_counter() - begin


def longest_record() -> tuple[float, float, float]:
    """What `largest` prints, from a fresh process; NaN where it did not come to its end."""
    command = [sys.executable, "-m", "benchmarks.growth", "--largest"]
    done = subprocess.run(command, cwd=Path(__file__).parent.parent, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        return float("nan"), float("nan"), float("nan")
    march, slope, peak = map(float, done.stdout.split())
    return march, slope, peak


def slopes(table: pd.DataFrame) -> pd.DataFrame:
    """Slopes of log time against log size: over all sizes, and for samples without the shortest."""
    lines = []
    for (sweep, what), own in table.dropna().groupby(["sweep", "what"], sort=False):
        least = ASYMPTOTIC if sweep == "samples" else 0
        lines.append((sweep, what, _slope(own), _slope(own[own["size"] >= least])))
    return pd.DataFrame(lines, columns=["sweep", "what", "slope", "slope_of_the_large"])


def _slope(table: pd.DataFrame) -> float:
    return float(np.polyfit(np.log(table["size"]), np.log(table["seconds"]), 1)[0])


def picture(table: pd.DataFrame, path: Path) -> None:
    """Time against size, a panel for every sweep."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 6.5), layout="constrained")
    panels = figure.subplots(2, 2).ravel()
    for axes, (sweep, own) in zip(panels, table.groupby("sweep", sort=False), strict=True):
        for what, line in own.groupby("what", sort=False):
            axes.loglog(line["size"], line["seconds"], marker="o", label=what)
        axes.set(xlabel=sweep, ylabel="median time [s]")
        axes.grid(True, which="both", alpha=0.25)
        axes.legend(fontsize=8)
    save(figure, path)


def print_goals(found: pd.DataFrame, peak: float) -> None:
    """Slopes and memory beside their goals."""
    for _, line in found.iterrows():
        what, slope = f"{line['what']} against {line['sweep']}", line["slope_of_the_large"]
        if line["sweep"] == "samples":
            met = abs(slope - 1.0) <= GOAL_SAMPLES
            print(f"{what}, from {ASYMPTOTIC:,} up: slope {slope:.3f} (goal 1 ± {GOAL_SAMPLES}: {_verdict(met)})")
        if line["sweep"] == "hysterons":
            print(f"{what}: slope {slope:.3f} (goal {GOAL_HYSTERONS:g} or less: {_verdict(slope <= GOAL_HYSTERONS)})")
    print(
        f"peak memory of forward and gradient at {LARGEST:,} samples: {peak:.2f} GiB (goal below {GOAL_MEMORY:g}: "
        f"{_verdict(peak < GOAL_MEMORY)})"
    )


def _verdict(met: bool) -> str:
    return "met" if met else "NOT met"


def main() -> int:
    """Measure, print, write ``growth.csv``, ``slopes.csv``, ``memory.csv`` and ``growth.png``."""
    if sys.argv[1:] == ["--largest"]:
        largest()
        return 0
    print(machine())
    march, slope, peak = longest_record()
    points = list(contenders())
    seconds, _ = timed(points, _BUDGET)
    lines = [(c.case, int(c.target), c.solver, s) for c, s in zip(points, seconds, strict=True)]
    lines += [("samples", LARGEST, FORWARD, march), ("samples", LARGEST, GRADIENT, slope)]
    table = pd.DataFrame(lines, columns=["sweep", "size", "what", "seconds"])
    order = list(dict.fromkeys(table["sweep"]))
    table = table.sort_values(["sweep", "what", "size"], key=lambda c: c.map(order.index) if c.name == "sweep" else c)
    show(table, "growth: median times, one thread")
    found = slopes(table)
    show(found, "slopes of log time against log size")
    write_csv(table, RESULTS / "growth.csv")
    write_csv(found, RESULTS / "slopes.csv")
    write_csv(pd.DataFrame({"samples": [LARGEST], "peak_GiB": [peak]}), RESULTS / "memory.csv")
    picture(table, RESULTS / "growth.png")
    print_goals(found, peak)
    return 0


if __name__ == "__main__":
    sys.exit(main())
