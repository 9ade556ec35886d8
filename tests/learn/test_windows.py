"""Windows cover every sample once, share their ends, and see the input of the whole recording."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import learn_example as example
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from phnn.learn.windows import starts_at_zero, thinned, windows_of
from phnn.recordings.recording import Part, Start


@settings(max_examples=25, deadline=None)
@given(st.integers(2, 100), st.integers(1, 3))
def test_windows_follow_each_other_over_the_whole_recording(length: int, substeps: int) -> None:
    recordings = example.recordings()
    found = windows_of(recordings, length, substeps)
    (whole,) = windows_of(recordings[:1], 0, substeps)
    first = [w for w in found if w.recording == 0]
    assert {w.recording for w in found} == {0, 1}
    assert (first[0].first, first[-1].last) == (0, recordings[0].t.size - 1)
    for a, b in pairwise(first):
        assert a.last == b.first
        assert b.continues and not b.known
    assert first[0].known and not first[0].continues
    assert torch.equal(torch.cat([w.fine for w in first]), whole.fine)
    assert torch.equal(torch.cat([w.h for w in first]), whole.h)
    for w in first:
        assert w.nodes.tolist() == [substeps * k for k in range(w.last - w.first + 1)]
        # No window is much longer than asked for.
        assert w.last - w.first <= 1.6 * (length - 1) + 1


def test_mean_input_is_that_of_the_sine() -> None:
    r = example.recording()
    (w,) = windows_of([r], 0, 1)
    omega = 2 * np.pi * 50.0
    exact = 75.0 * -np.diff(np.cos(omega * r.t)) / (omega * r.dt)
    np.testing.assert_allclose(w.mean.numpy(), exact, atol=1e-3)


@pytest.mark.parametrize("stride", [1, 2, 5])
def test_thinning_keeps_samples_and_parts(stride: int) -> None:
    r = replace(example.recording(), parts=(Part("head", 0, 50, "nuisance"), Part("tail", 50, 81, "confirmation")))
    less = thinned(r, stride)
    assert less.dt == pytest.approx(stride * r.dt)
    np.testing.assert_array_equal(less.y, r.y[::stride])
    kept = np.zeros(81, dtype=bool)
    kept[::stride] = True
    for use in ("nuisance", "confirmation"):
        np.testing.assert_array_equal(less.mask(use), r.mask(use)[kept])
    assert less.noise == r.noise


def test_only_rest_without_input_is_a_known_start() -> None:
    r = example.recording()
    assert starts_at_zero(r)
    for start in (Start("rest", 2.0), Start("unknown"), Start("periodic")):
        assert not starts_at_zero(replace(r, start=start))
