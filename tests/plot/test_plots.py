"""What all plots promise: axes, labels with units, room for every text, and tables of what is drawn."""

from __future__ import annotations

import itertools
import re
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from plot_example import (
    DT,
    FREQUENCIES,
    MODEL,
    PLOTS,
    SCORES,
    T,
    campaign,
    campaign_of,
    computed,
    diagnosis,
    recording,
    sine,
)

import phnn
from phnn.plot.signals import hysteresis
from phnn.report.figures.style import svg

# Columns of words.
_WORDS = {"recording", "with", "location", "rank"}
_PREFIXES = {"f": -15, "p": -12, "n": -9, "µ": -6, "m": -3, "": 0, "k": 3, "M": 6, "G": 9}


def panels(kind: str) -> list[Axes]:
    return list(np.ravel(np.array(computed(kind).draw(), dtype=object)))


def figure_of(kind: str) -> Figure:
    found = panels(kind)[0].figure
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
        if kind == "location":
            labels = labels[1:]
            assert [t.get_text() for t in axes.get_yticklabels()] == ["mechanical", "amplifier", "sensor", "thermal"]
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
    for table in computed(kind).tables().values():
        assert len(table)
        for name in table.columns:
            assert name in _WORDS or re.search(r"_(s|V|m|J|W|Hz|deg|1|samples|m/V|m/sqrt\(Hz\))$", name), name
    first, second = (svg(figure_of(kind)) for _ in range(2))
    assert first == second
    assert b"<svg" in first


@pytest.mark.parametrize("kind", PLOTS)
def test_axes_of_the_caller_are_drawn_into(kind: str) -> None:
    count = PLOTS[kind][1]
    own = Figure().subplots(count, 1, squeeze=False)[:, 0]
    found = np.ravel(np.array(computed(kind).draw(own), dtype=object))
    assert [id(a) for a in found] == [id(a) for a in own]
    assert all(a.lines or a.patches or a.collections for a in own)
    with pytest.raises(phnn.InputRefused, match=f"axes: {count + 1} given"):
        computed(kind).draw(Figure().subplots(count + 1, 1))


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
    table, found = computed("compare").tables()[""], computed("compare").draw()
    assert (table["residual_m"] == table["measured_m"] - table["simulated_m"]).all()
    for (above, below), name in zip(found, ("large", "small", "fast", "broad"), strict=True):
        rows = table[(table["recording"] == name) & (table["shown_1"] == 1)]
        above.set_xlabel(below.get_xlabel())
        equal(drawn(above, 0), rows["time_s"], rows["measured_m"])
        equal(drawn(above, 1), rows["time_s"], rows["simulated_m"])
        equal(drawn(below, 0), rows["time_s"], rows["residual_m"])


def test_a_stretch_is_shown_of_many_cycles_and_the_table_has_all() -> None:
    table = computed("compare").tables()[""]
    shown = table[table["recording"] == "fast"]["shown_1"]
    assert 0 < shown.sum() < shown.size == T.size
    assert table[table["recording"] == "large"]["shown_1"].all()


def test_correlations_are_drawn_as_in_the_table() -> None:
    tables, found = computed("residuals").tables(), computed("residuals").draw()
    for row, name in zip(found, ("large", "broad"), strict=True):
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
    table, found = computed("loops").tables()[""], computed("loops").draw()
    assert [a.get_title(loc="left") for a in found] == ["20 Hz", "50 Hz"]
    for axes, line, name in ((found[0], 0, "large"), (found[0], 2, "small"), (found[1], 0, "fast")):
        rows = table[table["recording"] == name]
        equal(drawn(axes, line), rows["input_V"], rows["measured_m"])
        equal(drawn(axes, line + 1), rows["input_V"], rows["simulated_m"])
        period = 1.0 / rows["frequency_Hz"].iloc[0]
        assert rows["time_s"].iloc[-1] - rows["time_s"].iloc[0] == pytest.approx(period)


def test_responses_are_drawn_as_in_the_table() -> None:
    tables, found = computed("bode").tables(), computed("bode").draw()
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
    table, found = computed("energy").tables()[""], computed("energy").draw()
    t = table["time_s"]
    rows = (
        (0, 0, "stored_J"),
        (1, 0, "supplied_W"),
        (1, 1, "dissipated_W"),
        (2, 0, "supplied_J"),
        (2, 1, "dissipated_J"),
    )
    for panel, line, name in rows:
        x, y = drawn(found[panel], line)
        kept = np.isin(np.arange(t.size), np.searchsorted(t, x - 1e-9))
        equal((x, y), t[kept], table[name][kept])


def test_locations_are_drawn_as_in_the_table() -> None:
    table, axes = computed("location").tables()[""], computed("location").draw()
    assert dict(zip(table["location"], table["share_of_explainable_residual_1"], strict=True)) == SCORES
    assert list(table["rank"]) == ["best", "tied", "", ""]
    assert [bar.get_width() for bar in axes.patches] == list(table["share_of_explainable_residual_1"])


def test_nothing_located_is_said() -> None:
    axes = phnn.plot.location(diagnosis())
    assert "nothing to locate" in axes.texts[0].get_text()


def test_functions_return_what_they_compute() -> None:
    assert phnn.plot.compare(MODEL, campaign(), recordings=["large"]).shape == (1, 2)
    assert phnn.plot.residuals(MODEL, campaign(), recordings=["broad"], lags=10).shape == (1, 3)
    assert phnn.plot.loops(MODEL, campaign(), recordings=["broad"]).shape == (1,)
    assert phnn.plot.energy(MODEL, T, sine(20.0, 60.0)).shape == (4,)
    assert phnn.plot.bode(MODEL, [20.0], 60.0).shape == (3,)


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


@pytest.mark.slow
def test_pyplot_is_not_needed() -> None:
    code = "import sys, phnn; phnn.plot.compare; print('matplotlib.pyplot' in sys.modules)"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "False"


def test_panels_of_the_same_title_stay_apart() -> None:
    names = [f"a recording of the {k} of all rigs that were ever built here" for k in ("first", "other")]
    both = [recording(name, sine(20.0, 5.0)) for name in names]
    assert len(hysteresis(MODEL, campaign_of(*both), names).found) == 2
