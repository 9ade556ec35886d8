"""Excitations are recognised, the held-out recordings are well chosen, and all of it is said in words."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from junctions import recording
from recordings_example import output, sine, write, write_sine
from scipy.signal import chirp

from phnn.recordings import describe, read
from phnn.recordings.excitation import Excitation, excitation_of, find_period
from phnn.recordings.partition import Candidate, candidate_of, choose, divide
from phnn.recordings.recording import Recording, Start, unrecorded


@settings(max_examples=60, deadline=None)
@given(
    samples=st.floats(12.0, 900.0), cycles=st.floats(2.05, 9.0), phase=st.floats(0.0, 6.28), third=st.floats(0.0, 0.3)
)
def test_period_of_periodic_inputs(samples: float, cycles: float, phase: float, third: float) -> None:
    k = np.arange(int(samples * cycles) + 1)
    angle = 2.0 * np.pi * k / samples + phase
    found = find_period(np.sin(angle) + third * np.sin(3.0 * angle) + 0.2)
    assert found == pytest.approx(samples, rel=1e-3)


@pytest.mark.parametrize(("kind", "u"), [
    ("sine", sine(5.0, 10.0, cycles=3)[1]), ("sine", sine(5.0, 10.0, cycles=1.3)[1]),
    ("periodic", np.abs(np.arange(900) % 300 - 150.0)), ("periodic", np.where(np.arange(1000) % 200 < 60, 5.0, 0.0)),
    ("steps", np.where(np.arange(1000) > 30, 5.0, 0.0)),
    ("steps", np.interp(np.arange(1000), [100, 120, 700, 720], [0.0, 5.0, 5.0, 2.0])),
    ("chirp", chirp(np.arange(5000) / 1000.0, 1.0, 5.0, 40.0)),
    ("broadband", np.random.default_rng(0).normal(size=4000)),
    ("broadband", np.exp(-np.arange(4000) / 900.0) * np.sin(np.arange(4000) / 25.0)), ("constant", np.ones(100)),
    ("broadband", np.sin(np.arange(4000) / 100.0) + np.sin(57.0 * np.arange(4000) / 4000.0)),
    ("broadband", np.sin(np.arange(4000) / 20.0) * (1.0 + np.arange(4000) / 8000.0)),
])  # fmt: skip
def test_kinds(kind: str, u: np.ndarray) -> None:
    assert excitation_of(u, 1e-3).kind == kind


def test_a_sweep_that_is_recorded_in_coarse_steps_has_its_own_frequencies() -> None:
    t = np.arange(5000) * 2e-3
    u = np.round(200.0 * chirp(t, 2.0, 10.0, 20.0) + np.random.default_rng(3).normal(size=t.size))
    found = excitation_of(u, 2e-3)
    assert (found.kind, found.low_Hz < 3.0, found.high_Hz < 25.0) == ("chirp", True, True)


@pytest.mark.parametrize(("interpolation", "period", "strides"), [
    ("cubic", 1000, {8}), ("cubic", 100, {2, 3}), ("cubic", 20, {1}), ("zero_order", 1000, {1}),
])  # fmt: skip
def test_a_stride_is_as_long_as_the_input_is_slow(interpolation: str, period: int, strides: set[int]) -> None:
    t = np.arange(3001) * 1e-4
    recording = unrecorded("sine", t, 60.0 * np.sin(2e4 * np.pi * t / period), interpolation)
    assert recording.stride in strides
    back = recording.from_sparse(recording.sparse.u)[: 3001 - 3001 % recording.stride]
    assert np.abs(back - recording.u[: back.size]).max() < 0.01 * 60.0
    assert recording.sparse.t[1] == pytest.approx(recording.stride * 1e-4)


def test_a_jump_is_in_no_stride() -> None:
    t = np.arange(3000) * 1e-4
    assert unrecorded("step", t, np.where(t < 0.1, 0.0, 60.0)).stride == 1


def test_a_noisy_measured_voltage_still_has_its_period() -> None:
    _, u = sine(5.0, 75.0, cycles=6)
    u = u + np.random.default_rng(0).normal(0.0, 0.3, u.size)
    assert excitation_of(u, 1e-3).period == pytest.approx(0.4, rel=1e-3)


def test_rests_around_a_sine_are_left_out() -> None:
    _, u = sine(5.0, 75.0, cycles=4)
    e = excitation_of(np.concatenate([np.zeros(500), u, np.zeros(300)]), 1e-3)
    assert (e.kind, e.period) == ("sine", pytest.approx(0.4))
    assert e.span[0] == pytest.approx(500, abs=2)


def tone(name: str, frequency: float, amplitude: float, use: str | None = None) -> Candidate:
    e = Excitation("sine", frequency, frequency, amplitude, 1.0 / frequency, 3.0, (0, 2500))
    return Candidate(name, 2500, 1.0 / (frequency * 833.0), e, use)


def other(name: str, kind: str, amplitude: float, use: str | None = None) -> Candidate:
    low, high = (1.0, 100.0) if kind == "chirp" else (0.0, 0.0)
    return Candidate(name, 5000, 1e-3, Excitation(kind, low, high, amplitude, None, 0.0, (0, 5000)), use)


def plan() -> list[Candidate]:
    tones = [tone(f"f{f}_a75", f, 75.0) for f in (1, 10, 25, 50, 75, 100, 150)]
    tones += [tone("f10_a25", 10, 25.0), tone("f10_a50", 10, 50.0), tone("f50_a40", 50, 40.0)]
    return [*tones, other("step", "steps", 37.5), other("sweep", "chirp", 60.0)]


def test_confirmation_interpolates() -> None:
    held = choose(plan())
    assert 3 <= len(held) <= 4
    assert not held & {"f1_a75", "f150_a75", "f10_a25", "step", "sweep"}
    assert len({n[-3:] for n in held}) > 1


def test_the_choice_does_not_depend_on_order() -> None:
    assert choose(plan()) == choose(plan()[::-1])


@pytest.mark.parametrize("count", range(2, 9))
def test_something_is_held_out_and_something_kept(count: int) -> None:
    candidates = [tone(f"r{i}", 2.0**i, 10.0) for i in range(count)]
    held = choose(candidates)
    assert 1 <= len(held) < count
    if count > 2:
        assert not held & {"r0", f"r{count - 1}"}


def test_of_two_the_larger_amplitude_identifies() -> None:
    assert choose([tone("small", 5.0, 10.0), tone("large", 5.0, 50.0)]) == {"small"}


def test_repetitions_are_nothing_new() -> None:
    parts, new, notes = divide([tone(f"r{i}", 5.0, 10.0) for i in range(4)])
    assert not new
    assert "no amplitude or frequency" in notes[0]
    assert parts["r0"][0].use == "identification"


def test_manifest_use_wins() -> None:
    candidates = [tone("a", 1.0, 10.0, "confirmation"), tone("b", 5.0, 10.0), tone("c", 9.0, 10.0)]
    parts, new, notes = divide(candidates)
    assert [p.use for p in parts["a"]] == ["nuisance", "confirmation"]
    assert parts["b"][0].use == parts["c"][0].use == "identification"
    assert new
    assert "as recordings.yaml says: a" in notes[0]


def test_partly_stated_identification_leaves_a_choice() -> None:
    candidates = [tone("a", 1.0, 10.0), tone("b", 5.0, 10.0, "identification"), tone("c", 9.0, 10.0)]
    parts, _, _ = divide(candidates)
    uses = {name: p[-1].use for name, p in parts.items()}
    assert uses["b"] == "identification"
    assert list(uses.values()).count("confirmation") == 1


@pytest.mark.parametrize(("size", "head"), [(2500, 50), (5000, 100), (60, 30)])
def test_the_start_of_a_confirmation_recording_is_not_scored(size: int, head: int) -> None:
    e = Excitation("sine", 1.0, 1.0, 1.0, None, 1.0, (0, size))
    a = Candidate("a", size, 1e-3, e, "confirmation")
    parts, _, _ = divide([a, tone("b", 5.0, 10.0)])
    start, scored = parts["a"]
    assert (start.name, start.first, start.last, start.use) == ("a[start]", 0, head, "nuisance")
    assert (scored.name, scored.first, scored.last, scored.use) == ("a", head, size, "confirmation")


@pytest.mark.parametrize("cycles", [1.5, 2.0, 3.0, 4.0, 7.3, 40.2])
def test_a_single_recording_is_split_with_a_gap(tmp_path: Path, cycles: float) -> None:
    write_sine(tmp_path, "loops", 5.0, 40.0, cycles)
    campaign = read(tmp_path)
    r = campaign.recordings[0]
    first, second = r.parts
    assert (first.name, second.name) == ("loops[identification]", "loops[confirmation]")
    assert not campaign.held_out_is_new
    assert first.first == 0
    assert second.last <= r.t.size
    assert second.first - first.last >= (400 if cycles >= 4 else 0.04 * r.t.size)
    assert 0.2 * r.t.size < second.last - second.first < 0.4 * r.t.size
    if cycles >= 4:
        assert (second.last - second.first) % 400 == 0
    assert not (r.mask("identification") & r.mask("confirmation")).any()


def test_describe_says_it_in_words(tmp_path: Path) -> None:
    write_sine(tmp_path, "slow", 1.0, 75.0)
    write_sine(tmp_path, "middle", 10.0, 50.0, cycles=6)
    write_sine(tmp_path, "fast", 100.0, 75.0)
    t = np.arange(3000) * 1e-3
    u = np.where((t > 0.05) & (t < 2.0), 60.0, 0.0)
    write(tmp_path / "hold.csv", t, u, output(u))
    (tmp_path / "notes.md").write_text("bench 3")
    (tmp_path / "recordings.yaml").write_text("known: {m: {value: 1.1e-3, std: 1e-5}}\n")
    text = describe(read(tmp_path))
    for words in (
        "4 recordings", "middle (middle.csv)", "sine of 10 Hz, amplitude 50, 6 periods", "steps and holds", "4000 Hz",
        "period-to-period differences over 5 cycles", "rest, input 0 V before", "m = 0.0011 ± 1e-05",
        "Left alone: notes.md", "start, not scored",
    ):  # fmt: skip
        assert words in text


@pytest.mark.parametrize(
    ("frequency", "size", "head"),
    [(1.0, 5000, 1000), (0.1, 5000, 2500), (100.0, 5000, 100), (0.0, 5000, 1000), (1.0, 60, 30)],
)
def test_an_unknown_start_takes_a_swing_of_the_input_from_what_is_scored(
    frequency: float, size: int, head: int
) -> None:
    kind = "sine" if frequency else "steps"
    e = Excitation(kind, frequency, frequency, 1.0, None, 1.0, (0, size))
    assert Candidate("a", size, 1e-3, e, None, begun=True).head == head


def test_a_slice_whose_first_samples_tell_nothing_of_its_start_is_not_held_out() -> None:
    size = 4000
    step = Excitation("steps", 0.0, 0.0, 37.5, None, 0.0, (0, size))
    late, early = (
        recorded_input(75.0 * (np.arange(size) < size * share), "late" if share > 0.5 else "early")
        for share in (0.7, 0.02)
    )
    assert candidate_of(late, step).untold
    assert not candidate_of(early, step).untold
    assert not candidate_of(replace(late, start=Start("rest", 0.0)), step).untold
    others = [replace(candidate_of(early, step), name=name) for name in ("a", "b", "c")]
    parts, _, (note,) = divide([candidate_of(late, step), *others])
    assert [p.use for p in parts["late"]] == ["identification"]
    assert "Not held out, because nobody knows how they start: late; in the first samples" in note
    assert "nobody knows how" not in divide(others)[2][0]


@pytest.mark.parametrize(("periods", "first", "untold"), [(0.7, 0.2, True), (2.5, 0.2, False), (0.6, 0.25, True)])
def test_a_slice_confirms_only_if_its_head_covers_the_range_of_its_input(
    periods: float, first: float, untold: bool
) -> None:
    """A dead zone that only the rest of the range crosses has not been met in the head."""
    size = 2000
    u = np.sin(2 * np.pi * (first + periods * np.arange(size) / size))
    sine = Excitation("sine", periods / (1e-3 * size), periods / (1e-3 * size), 1.0, None, 0.0, (0, size))
    assert candidate_of(recorded_input(u, "sine"), sine).untold is untold


def test_a_recording_of_known_start_always_identifies() -> None:
    def sine(name: str, frequency: float, **more: bool) -> Candidate:
        return Candidate(
            name, 2000, 1e-3, Excitation("sine", frequency, frequency, 40.0, None, 9.0, (0, 2000)), None, **more
        )

    slices = [sine(f"slice_{i}", 20.0 + i, begun=True, untold=True) for i in range(6)]
    known = [sine("slow", 5.0), sine("fast", 200.0)]
    kept = {c.name for c in known} - choose([*known, *slices])
    assert kept
    assert choose([sine("one", 5.0), *slices]) <= {c.name for c in slices}


def recorded_input(u: np.ndarray, name: str) -> Recording:
    return recording(1e-3 * np.arange(u.size), u, Start("unknown"), "identification", name=name, y=1e-6 * u)
