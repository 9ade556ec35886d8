"""Free runs over many samples: verdicts on models whose answer is known."""

from __future__ import annotations

import csv
import io
from dataclasses import replace

import numpy as np
import pytest

from phnn.comparison.models import Settings
from phnn.configuration import compose
from phnn.errors import InputRefused, SolverFailed
from studies.rival_models import long_runs
from studies.rival_models.long import Row, Runs, page, table
from studies.rival_models.long_runs import Drive, Kept, LongRun, drawn_drive, long_run
from studies.rival_models.rival import State, Stepper

DT, GAIN, SAMPLES, PERIOD = 1e-3, 1e-6, 2500, 100
SILENT = Drive(np.zeros(3), np.zeros(3), 50.0)


class Lag(Stepper):
    """``x ← pole x + (1 − pole) gain u``; the output's gain grows by ``slope`` a sample."""

    def __init__(self, pole: float, slope: float = 0.0) -> None:
        self.dt, self._pole, self._slope = DT, pole, slope

    def rest(self, u: float) -> State:
        return GAIN * u, 0

    def step(self, state: State, u: float) -> tuple[State, float]:
        x, n = state
        x = self._pole * x + (1.0 - self._pole) * GAIN * u
        return (x, n + 1), x * (1.0 + self._slope * n)


def test_a_stable_model_repeats_itself_and_comes_to_rest() -> None:
    for number in range(3):
        found = long_run(Lag(0.8), drawn_drive(75.0, 1, number), GAIN, SAMPLES)
        assert (found.samples, found.diverged, found.gained, found.drifted) == (SAMPLES, False, False, False)
        assert found.drift < 1e-9
        assert found.motion < 1e-9
        assert found.seconds >= 0.0


def test_drift_is_the_difference_of_two_periods() -> None:
    drive, slope = drawn_drive(75.0, 1, 0), 1e-4
    found = long_run(Lag(0.0, slope), drive, GAIN, SAMPLES)
    # The last driven period is the 22nd, the first that is compared the second one.
    u, n = drive.period(DT), np.arange(PERIOD)
    early = u * (1.0 + slope * (PERIOD + n))
    late = u * (1.0 + slope * (21 * PERIOD + n))
    assert found.drift == pytest.approx(np.sqrt(np.mean((late - early) ** 2) / np.mean(early**2)))
    middle = u * (1.0 + slope * (11 * PERIOD + n))
    assert found.late == pytest.approx(np.sqrt(np.mean((late - middle) ** 2) / np.mean(middle**2)))
    assert found.drifted


def test_motion_that_grows_without_drive_is_gained() -> None:
    found = long_run(Lag(1.0005), SILENT, GAIN, SAMPLES)
    # A rest of 300 samples: the last quarter is 225 samples behind the first.
    rest = SAMPLES - 2200
    assert found.motion == pytest.approx(1.0005 ** (0.75 * rest))
    assert found.gained and not found.diverged


def test_growth_that_is_small_beside_the_largest_output_is_not_counted() -> None:
    for size, gained in ((1e-8, False), (1e-5, True)):
        kept = Kept(PERIOD, SAMPLES)
        kept.take(0, np.concatenate([np.ones(2200), size * np.arange(300.0) ** 2]))
        assert kept.motion > 5.0
        assert kept.gained is gained


def test_a_model_that_leaves_the_range_has_diverged() -> None:
    found = long_run(Lag(1.01), SILENT, GAIN, SAMPLES)
    assert found.diverged and not found.gained and np.isnan(found.motion) and np.isnan(found.drift)
    # 1.01^n reaches 10 at n = 232, which is the sample 231.
    assert found.samples == 231


@pytest.mark.parametrize("error", [SolverFailed("no root"), ArithmeticError("no root")])
def test_a_step_without_a_solution_ends_a_run(error: Exception) -> None:
    class Fails(Lag):
        def step(self, state: State, u: float) -> tuple[State, float]:
            raise error

    assert long_run(Fails(0.5), SILENT, GAIN, SAMPLES).diverged

    class Endless(Lag):
        def step(self, state: State, u: float) -> tuple[State, float]:
            return state, float("nan")

    found = long_run(Endless(0.5), SILENT, GAIN, SAMPLES)
    assert found.diverged and found.samples == 0


def test_chunks_leave_the_result_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    drive = drawn_drive(75.0, 3, 1)
    whole = long_run(Lag(0.9, 1e-4), drive, GAIN, SAMPLES)
    monkeypatch.setattr(long_runs, "CHUNK", 137)
    parts = long_run(Lag(0.9, 1e-4), drive, GAIN, SAMPLES)
    assert parts.drift == pytest.approx(whole.drift, rel=1e-12)
    assert parts.motion == pytest.approx(whole.motion, rel=1e-9)


def test_drives_follow_the_seed_and_their_bounds() -> None:
    first, again, other = (drawn_drive(75.0, 0, n) for n in (0, 0, 1))
    assert np.array_equal(first.period(DT), again.period(DT))
    assert not np.array_equal(first.period(DT), other.period(DT))
    for number in range(20):
        drive = drawn_drive(75.0, 5, number)
        u = drive.period(1e-4)
        assert u.size == 1000
        assert 0.299 * 75.0 <= float(np.abs(u).max()) <= 0.951 * 75.0
        assert drive.before * u[0] <= 0.0 and 7.5 <= abs(drive.before) <= 75.0
        # Another interval samples the same voltage.
        assert np.allclose(drive.period(5e-4), u[::5], atol=1e-9)
        assert drive.peak == pytest.approx(max(np.abs(u).max(), abs(drive.before)), rel=1e-3)


def test_short_runs_are_refused() -> None:
    with pytest.raises(InputRefused, match="samples = 1999"):
        long_run(Lag(0.5), SILENT, GAIN, 1999)
    for samples, drives, needle in ((19_999, 1, "samples"), (20_000, 0, "drives")):
        with pytest.raises(InputRefused, match=needle):
            Runs(samples, drives)


def test_table_and_page_count_runs() -> None:
    good = LongRun(20_000, False, 1e-12, 1e-13, 0.0, False, 0.02)
    lost = LongRun(1234, True, float("nan"), float("nan"), float("nan"), False, 0.01)
    moved = replace(good, drift=0.5, late=0.2, motion=2.0, gained=True)
    rows = [Row(0, "phs", 1e-4, n, good) for n in range(2)]
    rows += [Row(0, "narx", 2e-4, 0, lost), Row(0, "narx", 2e-4, 1, moved), Row(0, "gru", float("nan"), 0, None, "no")]
    settings = Settings.from_config(compose("compare", ["models=[phs]"]))
    lines = page(rows, settings, Runs(20_000, 2), "9 processor seconds").splitlines()
    assert "| PHS | 0.1 | 2 | 0 | – | 0 | 1e-12 | 1e-13 | 0 | 0 | 0.04 | 1 |" in lines
    assert "| NARX | 0.2 | 2 | 1 | 1,234 | 1 | 0.5 | 0.2 | 1 | 2 | 0.03 | 1 |" in lines
    assert "| GRU | – | 0 | 0 | – | 0 | – | – | 0 | – | 0 | – |" in lines
    written = list(csv.DictReader(io.StringIO(table(rows))))
    assert [r["samples"] for r in written] == ["20000", "20000", "1234", "20000", ""]
    assert written[-1]["why"] == "no"
