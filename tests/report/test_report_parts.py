"""Pictures, numbers and commands of a report: nothing is lost, everything can be read and done again."""

from __future__ import annotations

import hashlib
import math
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import campaigns
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phnn.effects import Effect, catalogue
from phnn.recordings import read
from phnn.report import formatting as f
from phnn.report.figures import (
    Trace,
    amplitude_density,
    draw_curve,
    draw_error,
    draw_recording,
    envelope,
    telling_stretch,
)
from phnn.report.figures.style import Drawing, png, svg
from phnn.report.page import formula, image
from phnn.report.sections import command_line, provenance, traces_of, usage
from phnn.report.words import Picture

NOISE = 5e-8


def trace(count: int = 1000) -> Trace:
    """A sine of 100 µm; the base model misses 1 µm, the final model nothing."""
    t = np.arange(count) * 1e-3
    y = 1e-4 * np.sin(10.0 * t)
    measured = y + NOISE * np.random.default_rng(0).standard_normal(count)
    return Trace("a", t, 75.0 * np.sin(10.0 * t), measured, y + 1e-6 * np.cos(10.0 * t), y, NOISE, "m", True, 14.0)


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


def test_density_of_white_noise_is_that_of_its_variance() -> None:
    noise = 5e-8 * np.random.default_rng(1).standard_normal(100_000)
    _, density = amplitude_density(noise, 1e-4)
    assert np.sqrt(np.mean(density**2)) == pytest.approx(5e-8 * np.sqrt(2e-4), rel=0.03)


def test_the_error_is_drawn_before_and_after_against_the_noise() -> None:
    (axes,) = draw_error(trace()).axes
    assert [text.get_text() for text in axes.get_legend().get_texts()] == [
        "noise (± 2 σ)", "base model", "final model",
    ]  # fmt: skip
    assert axes.get_ylabel() == "error (nm)" and axes.get_xlabel() == "time (s)"
    before, after = (np.abs(line.get_ydata()).max() for line in axes.lines)
    assert before == pytest.approx(1e9 * np.abs(trace().measured - trace().before).max())
    assert after < 0.3 * before
    band = axes.patches[0].get_extents().transformed(axes.transData.inverted())
    assert (band.y0, band.y1) == pytest.approx((-100.0, 100.0))


def test_a_lone_spike_does_not_flatten_the_error() -> None:
    one = trace(5000)
    measured = one.measured.copy()
    measured[3000] += 1e-4
    (axes,) = draw_error(replace(one, measured=measured)).axes
    assert axes.get_ylim()[1] < 5000.0  # nm


@pytest.mark.parametrize(
    "changes",
    [
        {"after": np.full(1000, np.nan)},
        {"noise": None},
        {"measured": np.zeros(1000), "before": np.zeros(1000), "after": np.zeros(1000), "u": np.zeros(1000)},
        {"unit": "rad"},
    ],
)
def test_odd_recordings_are_drawn(changes: dict[str, object]) -> None:
    for draw in (draw_error, draw_recording):
        assert png(draw(replace(trace(), **changes))).startswith(b"\x89PNG")  # type: ignore[arg-type]


def test_without_a_second_model_there_is_one_error() -> None:
    one = trace()
    (axes,) = draw_error(replace(one, after=one.before)).axes
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["noise (± 2 σ)", "base model"]


def test_a_curve_with_labels_that_are_no_mathematics_is_drawn() -> None:
    odd = Picture(np.arange(3.0), np.arange(3.0), None, "$x", r"$\nonsense$", r"$\frac{$")
    assert png(draw_curve(odd)).startswith(b"\x89PNG")


def test_a_picture_on_the_page_has_an_alternative_text_and_the_colours_of_the_page() -> None:
    text = image(Drawing("a.png", "a", 'error of "a" <b>', b"", svg(draw_error(trace()), "a")))
    assert text.startswith('<svg role="img" aria-label="error of &#34;a&#34; &lt;b&gt;"')
    assert "var(--before)" in text and "#d55e00" not in text
    assert "<metadata" not in text and "http" not in text.replace("http://www.w3.org/", "")


@pytest.mark.parametrize("effect", catalogue().values(), ids=lambda effect: effect.name)
def test_equations_of_all_effects_become_drawings(effect: Effect) -> None:
    drawn = formula(effect.equation)
    assert drawn.count("<svg") == 1 and "<code>" not in drawn


@pytest.mark.parametrize("latex", [r"\notacommand{x}", r"\frac{a", "a$b", "<script>"])
def test_formulae_that_cannot_be_parsed_stay_text(latex: str) -> None:
    drawn = formula(latex)
    assert "<script" not in drawn
    assert ("<code>" in drawn) == (latex != "<script>")


@pytest.mark.parametrize(("form", "values", "text"), [
    (f.number, (None,), "–"), (f.number, (math.nan,), "–"), (f.number, (0.0,), "0"), (f.number, (1.03,), "1.03"),
    (f.number, (0.0012345,), "0.00123"), (f.number, (1.11e-5,), "1.11 × 10⁻⁵"), (f.number, (9.999,), "10.0"),
    (f.number, (-3.02e5,), "−3.02 × 10⁵"), (f.number, (99999.0,), "1.00 × 10⁵"),
    (f.with_error, (0.31, 0.02), "0.310 ± 0.020"), (f.with_error, (3.11e5, 2.1e3), "(3.110 ± 0.021) × 10⁵"),
    (f.with_error, (9210.0, 330.0), "9210 ± 330"), (f.with_error, (1.11e-3, None), "0.00111"),
    (f.with_error, (0.5, 4.0), "0.5 ± 4.0"), (f.with_error, (None, 1.0), "–"),
    (f.with_error, (1e-7, 9.96e-9), "(1.00 ± 0.10) × 10⁻⁷"),
    (f.p_value, (0.4,), "p = 0.4"), (f.p_value, (0.0412,), "p = 0.04"), (f.p_value, (1e-5,), "p < 2 × 10⁻⁵"),
    (f.p_value, (2.0 / 100_001.0,), "p < 2 × 10⁻⁵"), (f.p_value, (1e-9,), "p < 2 × 10⁻⁵"),
    (f.p_value, (2.1e-5,), "p = 2 × 10⁻⁵"), (f.p_value, (3.2e-4,), "p = 3 × 10⁻⁴"), (f.p_value, (0.0,), "p < 2 × 10⁻⁵"),
    (f.p_value, (9.7e-5,), "p = 1 × 10⁻⁴"), (f.p_value, (None,), "p not computed"),
])  # fmt: skip
def test_numbers_are_written_with_the_digits_that_count(form: Callable[..., str], values: Any, text: str) -> None:
    assert form(*values) == text


@given(st.floats(1e-12, 1e12))
def test_number_keeps_three_digits(value: float) -> None:
    text = f.number(value)
    mantissa, _, power = text.partition(" × 10")
    exponent = int(power.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789"))) if power else 0
    assert float(mantissa) * 10.0**exponent == pytest.approx(value, rel=0.0051)


@given(st.floats(allow_nan=True, allow_infinity=True), st.floats(allow_nan=True, allow_infinity=True))
def test_every_float_has_a_text(value: float, std: float) -> None:
    for text in (f.number(value), f.with_error(value, std), f.p_value(value), f.plain(value)):
        assert text
        assert not {"nan", "inf"} & set(text.split())


def test_what_a_run_was_made_of_changes_with_its_files(tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    shutil.copytree(campaigns.campaign().folder, folder)
    before = provenance(read(folder), command_line(["diagnose", "my recordings", "--out", "o"]))
    assert before.command == "phnn diagnose 'my recordings' --out o"
    assert set(before.files) == {"recordings.yaml", *(p.name for p in folder.glob("*.csv"))}
    assert all(hashlib.sha256((folder / n).read_bytes()).hexdigest() == h for n, h in before.files.items())
    first = next(folder / n for n in before.files if n.endswith(".csv"))
    lines = first.read_text().splitlines()
    lines[5] = lines[5].replace("1", "2")
    first.write_text("\n".join(lines))
    after = provenance(read(folder))
    changed = [n for n in before.files if before.files[n] != after.files[n]]
    assert changed == [first.name] and after.understood != before.understood and after.command == ""
    manifest = tmp_path / "other.yaml"
    manifest.write_text("voltage: command\n")
    told = provenance(read(folder, manifest), manifest=manifest).files
    assert told[str(manifest)] == hashlib.sha256(manifest.read_bytes()).hexdigest()


@pytest.mark.slow
def test_code_of_a_page_loads_the_model_and_simulates(tmp_path: Path) -> None:
    found = campaigns.diagnosis("quadratic_drag")
    found.model.save(tmp_path / "model")
    code = usage(traces_of(found), *found.campaign.recordings[0].units)
    (tmp_path / "use.py").write_text(f"{code}\nprint(y.min(), y.max())\n")
    done = subprocess.run([sys.executable, "use.py"], cwd=tmp_path, capture_output=True, text=True, check=True)
    low, high = map(float, done.stdout.split())
    largest = max(float(np.abs(r.y).max()) for r in found.campaign.recordings)
    assert low < 0.0 < high and 0.3 * largest < high - low < 4.0 * largest
