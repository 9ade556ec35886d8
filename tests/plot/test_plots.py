"""Plots: axes, labels with units, tables of what is drawn; closed forms; files and refusals of ``phnn plot``."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from campaigns import GENTLE, written
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import phnn
from phnn.cli import main
from phnn.models.actuator import hrc
from phnn.models.store import save
from phnn.parameters import as_table, constant
from phnn.plot.frequency import residual_tests, response, whiteness
from phnn.plot.signals import balance, hysteresis, outputs
from phnn.recordings.recording import Campaign, Part, Recording, Start, unrecorded
from phnn.report.figures.style import svg
from phnn.setup import Block, Setup
from phnn.signals.first_order import correlation, cross_deviation, own_deviation
from phnn.trajectory import simulate

VALUES = GENTLE
NOISE, DT, SAMPLES = 50e-9, 1e-4, 2000
MODEL = phnn.Model(Setup(hrc(1, VALUES)), 2)
WRONG = phnn.Model(Setup(hrc(1, VALUES | {"d_1": 4.0, "C_1": 3.0e-7})), 2)
LINEAR = phnn.Model(Setup(hrc(0, {n: VALUES[n] for n in ("m", "k", "b", "alpha")})), 2)
T = DT * np.arange(SAMPLES)


def sine(frequency: float, amplitude: float) -> np.ndarray:
    """(N,) input, V."""
    return amplitude * np.sin(2.0 * np.pi * frequency * T)


def recording(
    name: str,
    u: np.ndarray,
    period: float | None = None,
    model: phnn.Model = MODEL,
    noise: float = NOISE,
    seed: int = 0,
) -> Recording:
    """What a model does under an input, with noise."""
    blank = unrecorded(name, T, u)
    y = simulate(model.setup, blank, 2).y + noise * np.random.default_rng(seed).standard_normal(SAMPLES)
    part = Part(name, 0, SAMPLES, "identification")
    return replace(
        blank, y=y, parts=(part,), noise=noise or 1e-12, noise_source="stated", period=period, start=Start("rest", 0.0)
    )  # fmt: skip


def campaign_of(*recordings: Recording) -> Campaign:
    """Recordings without a folder."""
    return Campaign(recordings, {}, {}, "command", (), False, "nowhere")


@cache
def campaign() -> Campaign:
    """Two amplitudes of one sine, another sine, and a broadband input."""
    smooth = np.convolve(np.random.default_rng(1).standard_normal(SAMPLES), np.hanning(25) / 6.0, "same")
    return campaign_of(
        recording("large", sine(20.0, 60.0), 0.05, seed=2),
        recording("small", sine(20.0, 30.0), 0.05, seed=3),
        recording("fast", sine(50.0, 60.0), 0.02, seed=4),
        recording("broad", 40.0 * smooth * np.minimum(1.0, T / 5e-3), seed=5),
    )


FREQUENCIES = np.array([5.0, 20.0, 50.0, 200.0])

# What each function draws, and the number of its panels.
PLOTS: dict[str, tuple[Callable[[], Any], int]] = {
    "compare": (lambda: outputs(MODEL, campaign()), 8),
    "residuals": (lambda: whiteness(residual_tests(MODEL, campaign(), ["large", "broad"])), 6),
    "loops": (lambda: hysteresis(MODEL, campaign()), 2),
    "bode": (lambda: response(MODEL, FREQUENCIES, 60.0, campaign=campaign()).plot(), 3),
    "energy": (lambda: balance(MODEL.trajectory(T, sine(20.0, 60.0))).plot(), 3),
}


@cache
def computed(kind: str) -> Any:
    """A plot, computed once."""
    return PLOTS[kind][0]()


# Columns of words.
_WORDS = {"recording", "with"}
_PREFIXES = {"f": -15, "p": -12, "n": -9, "µ": -6, "m": -3, "": 0, "k": 3, "M": 6, "G": 9}


def panels(kind: str) -> list[Axes]:
    return list(figure_of(kind).axes)


def figure_of(kind: str) -> Figure:
    found = computed(kind).figure()
    assert isinstance(found, Figure)
    return found


def size(label: str) -> float:
    """Size of the unit in a label, such as 1e-6 of ``displacement (µm)``."""
    found = re.search(r"\((.?)(?:m|s|V|J|W|Hz|m/V|m/√Hz)\)$", label)
    return 1.0 if found is None else 10.0 ** _PREFIXES[found[1]]


@pytest.mark.parametrize("kind", PLOTS)
def test_axes_have_labels_with_units(kind: str) -> None:
    found = panels(kind)
    assert len(found) == PLOTS[kind][1]
    for place, axes in enumerate(found):
        assert isinstance(axes, Axes)
        # Residuals stand below their outputs, with the same time.
        labels = [axes.get_ylabel(), common(found[place + 1] if kind == "compare" and place % 2 == 0 else axes)]
        for text in labels:
            assert re.search(r"\(.+\)", text), (kind, text)


@pytest.mark.parametrize("kind", PLOTS)
def test_no_text_covers_another(kind: str) -> None:
    figure = figure_of(kind)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    texts = []
    for axes in figure.axes:
        if axes.get_visible():
            ticks = [t.label1 for axis in axes._axis_map.values() for t in axis._update_ticks()]
            texts += [axes.xaxis.label, axes.yaxis.label, axes.title, axes._left_title, *ticks]
    boxes = [(t.get_text(), t.get_window_extent(renderer)) for t in texts if t.get_text() and t.get_visible()]
    for (one, a), (other, b) in itertools.combinations(boxes, 2):
        # A box is a little larger than its letters.
        across = min(a.x1, b.x1) - max(a.x0, b.x0), min(a.y1, b.y1) - max(a.y0, b.y0)
        assert min(across) < 2.0, f"{kind}: {one!r} and {other!r}"


@pytest.mark.slow
@pytest.mark.parametrize("kind", PLOTS)
def test_columns_have_units_and_the_drawing_is_the_same_twice(kind: str) -> None:
    for table in computed(kind).tables.values():
        assert len(table)
        for name in table.columns:
            assert name in _WORDS or re.search(r"_(s|V|m|J|W|Hz|deg|1|samples|m/V|m/sqrt\(Hz\))$", name), name
    first, second = (svg(figure_of(kind)) for _ in range(2))
    assert first == second
    assert b"<svg" in first


def common(axes: Axes) -> str:
    """Label of the x axis, which may stand below the panels that share it."""
    return next(filter(None, (a.get_xlabel() for a in axes.get_shared_x_axes().get_siblings(axes))), "")


def drawn(axes: Axes, line: int) -> tuple[np.ndarray, np.ndarray]:
    """Data of a line in SI units."""
    x, y = axes.lines[line].get_data()
    own = axes.get_xlabel() or common(axes)
    return np.asarray(x) * size(own), np.asarray(y) * size(axes.get_ylabel())


def equal(pair: tuple[np.ndarray, np.ndarray], x: Any, y: Any) -> None:
    np.testing.assert_allclose(pair[0], np.asarray(x), rtol=1e-12)
    np.testing.assert_allclose(pair[1], np.asarray(y), rtol=1e-12, atol=1e-30)


def test_outputs_are_drawn_as_in_the_table() -> None:
    table, found = computed("compare").tables[""], panels("compare")
    assert (table["residual_m"] == table["measured_m"] - table["simulated_m"]).all()
    for above, below, name in zip(found[::2], found[1::2], ("large", "small", "fast", "broad"), strict=True):
        rows = table[(table["recording"] == name) & (table["shown_1"] == 1)]
        above.set_xlabel(below.get_xlabel())
        equal(drawn(above, 0), rows["time_s"], rows["measured_m"])
        equal(drawn(above, 1), rows["time_s"], rows["simulated_m"])
        equal(drawn(below, 0), rows["time_s"], rows["residual_m"])


def test_a_stretch_is_shown_of_many_cycles_and_the_table_has_all() -> None:
    table = computed("compare").tables[""]
    shown = table[table["recording"] == "fast"]["shown_1"]
    assert 0 < shown.sum() < shown.size == T.size
    assert table[table["recording"] == "large"]["shown_1"].all()


def test_correlations_are_drawn_as_in_the_table() -> None:
    tables, found = computed("residuals").tables, panels("residuals")
    for row, name in zip((found[:3], found[3:]), ("large", "broad"), strict=True):
        for axes, other in zip(row[:2], ("residual", "input"), strict=True):
            rows = tables[""][(tables[""]["recording"] == name) & (tables[""]["with"] == other)]
            for line, outside in ((0, 0), (1, 1)):
                some = rows[rows["outside_1"] == outside]
                equal(axes.lines[line].get_data(), some["lag_samples"], some["correlation_1"])
            number = int(rows["outside_1"].sum())
            texts = [t.get_text() for t in axes.get_legend().get_texts()]
            assert any(t.startswith(f"{number} of ") and t.endswith("expected)") for t in texts)
        rows = tables["_spectrum"][tables["_spectrum"]["recording"] == name]
        equal(drawn(row[2], 0), rows["frequency_Hz"], rows["residual_m/sqrt(Hz)"])
        equal(drawn(row[2], 1), rows["frequency_Hz"], rows["noise_m/sqrt(Hz)"])
    lags = tables[""]
    np.testing.assert_allclose(lags["lag_s"], DT * lags["lag_samples"])


def test_loops_are_drawn_as_in_the_table_by_frequency() -> None:
    table, found = computed("loops").tables[""], panels("loops")
    assert [a.get_title(loc="left") for a in found] == ["20 Hz", "50 Hz"]
    for axes, line, name in ((found[0], 0, "large"), (found[0], 2, "small"), (found[1], 0, "fast")):
        rows = table[table["recording"] == name]
        equal(drawn(axes, line), rows["input_V"], rows["measured_m"])
        equal(drawn(axes, line + 1), rows["input_V"], rows["simulated_m"])
        period = 1.0 / rows["frequency_Hz"].iloc[0]
        assert rows["time_s"].iloc[-1] - rows["time_s"].iloc[0] == pytest.approx(period)


def test_responses_are_drawn_as_in_the_table() -> None:
    tables, found = computed("bode").tables, panels("bode")
    model = tables[""]
    f = model["frequency_Hz"]
    np.testing.assert_array_equal(f, FREQUENCIES)
    equal(drawn(found[0], 0), f, model["magnitude_m/V"])
    equal(drawn(found[0], 1), f, model["linear_magnitude_m/V"])
    equal(drawn(found[1], 0), f, model["phase_deg"])
    equal(drawn(found[1], 1), f, model["linear_phase_deg"])
    for k in range(4):
        equal(drawn(found[2], 3 * k), f, 100.0 * model[f"harmonic_{k + 2}_1"])
    measured = tables["_measured"].set_index("recording")
    assert list(measured.index) == ["large", "small", "fast"]
    equal(drawn(found[0], 2), *measured.loc[["large", "fast"], ["frequency_Hz", "magnitude_m/V"]].to_numpy().T)
    equal(drawn(found[0], 3), *measured.loc[["small"], ["frequency_Hz", "magnitude_m/V"]].to_numpy().T)


def test_energies_are_drawn_as_in_the_table() -> None:
    table, found = computed("energy").tables[""], panels("energy")
    t = table["time_s"]
    rows = ((0, 0, "stored_J"), (1, 0, "supplied_J"), (1, 1, "dissipated_J"))
    for panel, line, name in rows:
        x, y = drawn(found[panel], line)
        kept = np.isin(np.arange(t.size), np.searchsorted(t, x - 1e-9))
        equal((x, y), t[kept], table[name][kept])


def test_functions_return_figures() -> None:
    assert len(phnn.plot.compare(MODEL, campaign(), recordings=["large"]).axes) == 2
    assert len(phnn.plot.residuals(MODEL, campaign(), recordings=["broad"], lags=10).axes) == 3
    assert len(phnn.plot.loops(MODEL, campaign(), recordings=["broad"]).axes) == 1
    assert len(phnn.plot.energy(MODEL, T, sine(20.0, 60.0)).axes) == 3
    assert len(phnn.plot.bode(MODEL, [20.0], 60.0).axes) == 3


def test_what_cannot_be_drawn_is_refused() -> None:
    with pytest.raises(phnn.InputRefused, match=r"no recording 'none' .* large, small, fast and broad"):
        phnn.plot.compare(MODEL, campaign(), recordings=["none"])
    with pytest.raises(phnn.InputRefused, match="give both, or recordings"):
        phnn.plot.bode(MODEL, [1.0])
    with pytest.raises(phnn.InputRefused, match="row of positive numbers"):
        phnn.plot.bode(MODEL, [0.0, 1.0], 60.0)
    with pytest.raises(phnn.InputRefused, match="amplitude = -1"):
        phnn.plot.bode(MODEL, [1.0], -1.0)
    with pytest.raises(phnn.InputRefused, match="a model has no recordings"):
        phnn.plot.residuals(MODEL)
    with pytest.raises(phnn.InputRefused, match="give fewer lags"):
        phnn.plot.residuals(MODEL, campaign(), lags=5000)


def test_panels_of_the_same_title_stay_apart() -> None:
    names = [f"a recording of the {k} of all rigs that were ever built here" for k in ("first", "other")]
    both = [recording(name, sine(20.0, 5.0)) for name in names]
    assert len(hysteresis(MODEL, campaign_of(*both), names).figure().axes) == 2


F = np.array([1.0, 30.0, 400.0, 711.0, 3000.0])
_FAR = 2.5758293035489004  # half width of the band that holds 99 % of a normal variable


def transfer(f: np.ndarray, capacitance: float = np.inf) -> np.ndarray:
    """``α/(k + α²/C − mω² + iωb)``."""
    omega, alpha = 2.0 * np.pi * f, VALUES["alpha"]
    stiffness = VALUES["k"] + alpha**2 / capacitance
    return alpha / (stiffness - VALUES["m"] * omega**2 + 1j * omega * VALUES["b"])


def test_response_of_a_linear_model_is_its_transfer_function() -> None:
    found = response(LINEAR, F, 60.0)
    for gain in (found.gain, found.linear):
        np.testing.assert_allclose(gain, transfer(F), rtol=1e-6)
    assert found.harmonics.max() < 1e-9
    assert found.gain_unit == "m/V"
    assert replace(found, units=("m/s", "N")).gain_unit == "N/(m/s)"
    assert replace(found, units=("1", "N")).gain_unit == "N"


def test_a_small_amplitude_stays_within_the_dead_zone() -> None:
    found = response(MODEL, F, 60.0)
    np.testing.assert_allclose(found.linear, transfer(F, VALUES["C_1"]), rtol=1e-6)
    assert np.abs(found.gain[0] / found.linear[0] - 1.0) > 0.02
    # A loop that is symmetric has odd harmonics alone.
    assert found.harmonics[0, 1] > 1e-3
    assert found.harmonics[:, [0, 2]].max() < 1e-6


def test_harmonics_of_a_square_are_known() -> None:
    """``y = q + c q²`` with ``q = A sin ωt`` has the second harmonic ``c A²/2``."""
    offset, scale = 0.0, 60.0 * float(np.abs(transfer(F[:1]))[0])
    table = as_table((constant("c", 0.1 / scale, "1/m"), constant("d", 0.0, "1/m²")))
    setup = replace(LINEAR.setup, sensor=(Block("polynomial", ("c", "d")),), block_parameters=table)
    found = response(phnn.Model(setup), F[:1], 60.0, offset)
    np.testing.assert_allclose(found.harmonics[0], [0.05, 0.0, 0.0, 0.0], atol=1e-6)


@pytest.mark.slow
def test_frequencies_follow_from_the_recordings() -> None:
    found = response(LINEAR, campaign=campaign())
    np.testing.assert_allclose(found.frequencies[[0, -1]], [10.0, 100.0], rtol=1e-3)
    np.testing.assert_allclose(found.gain, transfer(found.frequencies), rtol=1e-6)


def test_measured_points_lie_on_the_response() -> None:
    clean = [recording(f"{f:g}", sine(f, 60.0), 1.0 / f, LINEAR, noise=0.0) for f in (20.0, 50.0)]
    found = response(LINEAR, [20.0, 50.0], None, campaign=campaign_of(*clean))
    assert found.amplitude == pytest.approx(60.0, rel=1e-3)
    for p in found.measured:
        assert p.gain == pytest.approx(complex(transfer(np.array([p.frequency]))[0]), rel=1e-4)
    noisy = response(MODEL, [20.0], 60.0, campaign=campaign()).measured
    samples = T.size - round(0.05 / 1e-4)
    # Cosine and sine of N samples are each known to σ √(2/N).
    assert noisy[0].std == pytest.approx(NOISE / 60.0 * np.sqrt(2.0 / samples), rel=0.05)


def test_correlation_is_the_sum_of_products() -> None:
    rng = np.random.default_rng(0)
    e, x = rng.standard_normal(50), rng.standard_normal(50)
    a, b = e - e.mean(), x - x.mean()
    expected = [sum(a[t] * b[t - k] for t in range(50) if 0 <= t - k < 50) for k in range(-7, 8)]
    np.testing.assert_allclose(correlation(e, x, 7), np.array(expected) / np.sqrt((a @ a) * (b @ b)), atol=1e-13)
    assert not correlation(np.ones(10), x[:10], 3).any()


def coloured(rng: np.random.Generator, a: float, size: int) -> np.ndarray:
    """First-order noise of unit variance."""
    n = np.sqrt(1.0 - a * a) * rng.standard_normal(size + 200)
    for k in range(1, n.size):
        n[k] += a * n[k - 1]
    return n[200:]


@pytest.mark.parametrize("a", [0.0, 0.7])
def test_noise_stays_within_its_bands_in_99_percent_of_the_lags(a: float) -> None:
    rng, size, lags, draws = np.random.default_rng(4), 3000, 40, 60
    rho = np.asarray(a ** np.arange(25.0) if a else np.ones(1), dtype=np.float64)
    u = coloured(rng, 0.9, size)
    centre = np.pad(rho, (0, lags + 1 - rho.size))
    own, cross = own_deviation(rho, size, lags), cross_deviation(rho, u, lags)
    within = np.zeros(2)
    for _ in range(draws):
        e = coloured(rng, a, size)
        within[0] += np.mean((np.abs(correlation(e, e, lags)[lags:] - centre) <= _FAR * own)[1:])
        within[1] += np.mean(np.abs(correlation(e, u, lags)) <= _FAR * cross)
    # Neighbouring lags follow each other: some 60 × 5 independent ones.
    np.testing.assert_allclose(within / draws, 0.99, atol=0.012)


def test_deviations_of_white_noise_are_those_of_the_number_of_pairs() -> None:
    u = np.random.default_rng(0).standard_normal(400)
    pairs = 400 - np.arange(21)
    np.testing.assert_allclose(own_deviation(np.ones(1), 400, 20)[1:], np.sqrt(pairs[1:]) / 400)
    np.testing.assert_allclose(cross_deviation(np.ones(1), u, 20)[20:], np.sqrt(pairs) / 400)


def test_the_true_model_leaves_noise_and_a_wrong_one_does_not() -> None:
    for one in residual_tests(MODEL, campaign()):
        assert one.autocorrelation.outside.sum() <= 5
        assert one.by_input.outside.mean() <= 0.1
        assert np.median(one.density / one.noise) == pytest.approx(1.0, abs=0.2)
    for one in residual_tests(WRONG, campaign()):
        assert one.autocorrelation.outside.mean() > 0.5
    broad = residual_tests(WRONG, campaign())[3]
    assert broad.by_input.outside.mean() > 0.3
    assert broad.density.max() > 10.0 * broad.noise.max()


def test_the_energy_balance_closes_and_dissipation_never_falls() -> None:
    found = balance(MODEL.trajectory(T, sine(20.0, 60.0)))
    assert np.abs(found.error).max() <= 1e-9 * found.turned_over
    assert np.diff(found.total("dissipated")).min() >= -1e-15 * found.turned_over
    # Passivity: no more is stored than was supplied.
    assert (
        found.total("stored") - found.total("stored")[0] <= found.total("supplied") + 1e-12 * found.turned_over
    ).all()
    q, energy = MODEL.trajectory(T, sine(20.0, 60.0)).states[:, 1], found.stored["q"]
    np.testing.assert_allclose(energy, 0.5 * VALUES["k"] * q**2, rtol=1e-12, atol=1e-25)
    assert found.t[-1] == pytest.approx(T[-1])


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a model and recordings."""
    home = tmp_path_factory.mktemp("plots")
    save(MODEL.setup, home / "result" / "model", 2)
    written(home / "recordings", campaign().recordings)
    return home


def test_the_command_writes_a_figure_and_its_table(stored: Path, tmp_path: Path) -> None:
    model, folder, out = str(stored / "result"), str(stored / "recordings"), tmp_path / "out"
    assert main(["plot", "loops", model, folder, "--out", str(out), "--recording", "fast"]) == 0
    assert (out / "loops.svg").read_bytes().startswith(b"<?xml")
    assert set(pd.read_csv(out / "loops.csv")["recording"]) == {"fast"}


@pytest.mark.slow
def test_the_command_draws_every_kind(stored: Path, tmp_path: Path) -> None:
    model, folder, out = str(stored / "result"), str(stored / "recordings"), tmp_path / "out"
    for kind in ("compare", "residuals", "loops", "bode", "energy"):
        assert main(["plot", kind, model, folder, "--out", str(out)]) == 0, kind
        assert (out / f"{kind}.svg").read_bytes().startswith(b"<?xml")
        assert len(pd.read_csv(out / f"{kind}.csv"))
    assert len(pd.read_csv(out / "residuals_spectrum.csv"))
    assert set(pd.read_csv(out / "bode_measured.csv")["recording"]) == {"large", "small", "fast"}
    sweep = ["--frequencies", "5", "50", "--amplitude", "60"]
    assert main(["plot", "bode", model, "--out", str(out), *sweep]) == 0
    assert pd.read_csv(out / "bode.csv")["frequency_Hz"].iloc[[0, -1]].tolist() == pytest.approx([5.0, 50.0])
    # Results of other kinds stay beside it; the table of measured points is not of this run.
    assert (out / "loops.svg").exists()
    assert not (out / "bode_measured.csv").exists()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["compare"], "no recordings: name their folder"),
        (["bode"], "give both, or recordings"),
        (["bode", "--frequencies", "0", "5"], "--frequencies 0 5"),
        (["bode", "--recording", "a"], "bode does not take --recording"),
        (["compare", "--amplitude", "1"], "compare does not take --amplitude"),
        (["energy", "--recording", "a", "--recording", "b"], "energy draws one recording"),
    ],
)
def test_the_command_refuses(
    given: list[str], message: str, stored: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["plot", given[0], str(stored / "result"), "--out", str(tmp_path / "out"), *given[1:]]) == 2
    assert message in capsys.readouterr().err
