"""What is drawn: envelopes that lose nothing, the right stretch, honest spectra, honest shares, readable formulae."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from report_example import make_trace

from phnn.report.document import FitRow, Location, Score
from phnn.report.evidence import MISSING, LedgerRow, base_note, ledger_shares
from phnn.report.figures import (
    draw_locations,
    draw_overview,
    draw_recording,
    envelope,
    residual_spectrum,
    telling_stretch,
)
from phnn.report.page import formula, symbol
from phnn.signals.sampling import longest_run


@given(st.integers(1, 3000), st.integers(1, 60), st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_envelope_keeps_the_extremes_of_every_stretch(count: int, bins: int, seed: int) -> None:
    y = np.random.default_rng(seed).standard_normal(count)
    index = envelope(y, bins)
    assert np.all(np.diff(index) > 0)
    assert index[0] == 0
    assert index[-1] == count - 1
    assert len(index) <= 2 * bins + 2
    if count > 2 * bins:
        width = -(-count // bins)
        kept = set(index.tolist())
        for start in range(0, count, width):
            block = y[start : start + width]
            assert start + int(np.argmin(block)) in kept
            assert start + int(np.argmax(block)) in kept


def test_the_stretch_shown_is_where_the_error_is_largest() -> None:
    t = np.arange(10_000) * 1e-4
    u = np.sin(2.0 * np.pi * 100.0 * t)
    error = np.where((t > 0.6) & (t < 0.63), 1.0, 0.01)
    part = telling_stretch(u, error, np.ones(10_000, dtype=bool))
    assert part.start <= 6001
    assert part.stop >= 6299
    assert part.stop - part.start == pytest.approx(400, rel=0.05)
    ignored = telling_stretch(u, error, (t < 0.5))
    assert ignored.stop <= 5400
    assert telling_stretch(u[:200], error[:200], t[:200] >= 0.0) == slice(0, 200)


def test_spectrum_of_white_noise_lies_on_the_noise_floor() -> None:
    t = np.arange(100_000) * 1e-4
    noise = 5e-8 * np.random.default_rng(1).standard_normal(t.size)
    spectrum = residual_spectrum(t, noise, noise, np.ones(t.size, dtype=bool), 5e-8)
    assert spectrum is not None
    assert np.sqrt(np.mean(spectrum.before**2)) == pytest.approx(spectrum.noise, rel=0.03)


def test_spectrum_leaves_out_what_is_not_scored() -> None:
    t = np.arange(2000) * 1e-3
    error = np.where(t < 0.1, 1e3, 1e-6)
    usable = t >= 0.2
    spectrum = residual_spectrum(t, error, error, usable, 1.0)
    assert spectrum is not None
    assert spectrum.before.max() < 1e-3
    assert longest_run(usable) == slice(200, 2000)
    assert residual_spectrum(t, error, error, t < 0.01, 1.0) is None


def _row(name: str, supplied: float, **losses: float) -> LedgerRow:
    return LedgerRow(name, supplied, 0.1 * supplied, losses, 0.2 * supplied)


def test_no_share_exceeds_the_largest_flow() -> None:
    row = LedgerRow("free decay", 1e-9, -0.8, {"viscous": 1.0}, 0.1)
    (shares,), skipped = ledger_shares([row])
    assert skipped == ()
    assert shares.base == "viscous"
    assert shares.parts == pytest.approx({"viscous": 1.0, "stored": -0.8, MISSING: 0.1})
    assert "free decay (viscous)" in base_note([shares])
    assert base_note(ledger_shares([_row("a", 2.0, h1=1.0)])[0]) == ""


def test_small_losses_are_joined_and_nothing_is_lost() -> None:
    losses = {f"h{i}": 0.01 * (i + 1) for i in range(9)}
    shares, _ = ledger_shares([_row("a", 1.0, **losses), _row("b", 1.0, h0=0.5)])
    assert "other losses" in shares[0].kinds
    assert shares[0].kinds == shares[1].kinds
    assert len(shares[0].kinds) == 8
    assert "h0" in shares[0].kinds
    assert sum(shares[0].parts.values()) == pytest.approx(sum(losses.values()) + 0.3)


def test_recording_figure_has_four_labelled_panels_in_matching_units() -> None:
    trace = make_trace("sine_10Hz_75V")
    figure = draw_recording(trace, None)
    labels = [(axes.get_xlabel(), axes.get_ylabel()) for axes in figure.axes]
    assert labels[0] == ("time (s)", "displacement (µm)")
    assert labels[1] == ("voltage (V)", "displacement (µm)")
    assert labels[2][1] == "error (nm)"
    assert labels[3] == ("frequency (Hz)", "error (nm/√Hz)")
    drawn = figure.axes[2].lines
    largest = max(float(np.nanmax(np.abs(line.get_ydata()))) for line in drawn if len(line.get_ydata()) > 10)
    assert largest == pytest.approx(1e9 * float(np.abs(trace.measured - trace.before).max()))
    force = draw_recording(trace, None, input_unit="N")
    assert force.axes[1].get_xlabel() == "force (N)"


def test_a_lone_spike_is_named_and_does_not_flatten_the_error() -> None:
    trace = make_trace("sine_10Hz_75V")
    measured = trace.measured.copy()
    measured[3000] += 1e-4
    axes = draw_recording(replace(trace, measured=measured), None).axes[2]
    assert axes.get_ylim()[1] < 5000.0  # nm
    assert "1 sample beyond, up to 100 µm" in axes.get_xlabel()
    assert "beyond" not in draw_recording(trace, None).axes[2].get_xlabel()


def test_location_bars_mark_the_best_and_its_ties() -> None:
    scores = (("mechanical", 0.9), ("electrical", 0.89), ("sensor", -0.1), ("thermal", None))
    figure = draw_locations(Location("mechanical", "", ("electrical",), scores, (), (), ()))
    bars = figure.axes[0].patches
    assert [bar.get_width() for bar in bars] == [0.9, 0.89, -0.1, 0.0]
    assert [bool(bar.get_hatch()) for bar in bars] == [False, True, False, False]
    assert bars[0].get_facecolor() != bars[2].get_facecolor()
    assert [text.get_text() for text in figure.axes[0].texts] == ["0.90", "0.89", "−0.10", "not tried"]
    assert "longer" not in figure.axes[0].get_xlabel()
    longer = (("sensor", 0.95), *scores)
    assert "longer" in draw_locations(Location("mechanical", "", (), longer, (), (), ())).axes[0].get_xlabel()


def test_overview_shows_before_and_after_of_every_recording() -> None:
    rows = [FitRow("a", True, Score(None, None, 5.0), Score(None, None, 1.0)), FitRow("b", False, Score(), Score())]
    axes = draw_overview(rows).axes[0]
    points = [tuple(c.get_offsets()[0]) for c in axes.collections if len(c.get_offsets())]
    assert points == [(5.0, 0.0), (1.0, 0.0)]


CATALOGUE = (
    r"\tau \dot V = u - V",
    r"V(t) = u(t - \tau)",
    r"|\dot V| \le S",
    r"F = k q \left(1 + \kappa_2 s + \tfrac{1}{3} \kappa_2^2 s^2\right), \quad s = q / q_0",
    r"F_c \tanh\!\left(\frac{v}{v_s}\right)",
    r"k_c \max(q - q_c, 0)^{3/2}",
    r"C_T \dot T = P_{\mathrm{diss}} - \frac{T - T_a}{R_T}",
    r"V = \operatorname{clip}(u, \pm V_{\max})",
    r"$$\ddot q = \sum_{i=1}^{n} e_i$$",
    r"\begin{aligned} F &= k_s s \\ \dot s &= v - s/\tau \end{aligned}",
)


@pytest.mark.parametrize("latex", CATALOGUE)
def test_formulae_become_drawings(latex: str) -> None:
    drawn = formula(latex)
    assert "<svg" in drawn
    assert "<code>" not in drawn
    assert drawn.count("<svg") == (2 if "aligned" in latex else 1)


@pytest.mark.parametrize("latex", [r"\notacommand{x}", r"\frac{a", "a$b", "<script>"])
def test_formulae_that_cannot_be_parsed_stay_text(latex: str) -> None:
    drawn = formula(latex)
    assert "<script" not in drawn
    assert ("<code>" in drawn) == (latex != "<script>")
    assert formula("") == ""


def test_symbols_are_printed_as_in_the_equations() -> None:
    assert symbol("rho_1") == "<i>ρ</i><sub>1</sub>"
    assert symbol("C_p") == "<i>C</i><sub>p</sub>"
    assert symbol("relaxation_time") == "<code>relaxation_time</code>"
    assert symbol("<b>_1") == "<code>&lt;b&gt;_1</code>"
