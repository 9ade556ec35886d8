"""LFR augmentation as a tool: the group lasso, and what is read from places and channels."""

from __future__ import annotations

import numpy as np
import pytest

from phnn.effects import catalogue
from phnn.errors import InputRefused
from studies.benchmark.tools.group_lasso import orthonormal, path
from studies.benchmark.tools.lfr import NAMES, Evidence, read_off

RNG = np.random.default_rng


def groups(seed: int, n: int = 400) -> tuple[np.random.Generator, list[np.ndarray]]:
    rng = RNG(seed)
    return rng, [orthonormal(rng.normal(size=(n, p))) for p in (3, 5, 2)]


def test_a_group_that_is_not_needed_is_zero_exactly() -> None:
    rng, found = groups(1)
    r = found[1] @ np.array([40.0, -30.0, 20.0, 0.0, 10.0]) + rng.normal(size=400)
    steps = path(r, found, steps=20, least=0.1)
    assert steps[0].active == ()
    for step in steps[1:]:
        assert step.active == (1,)
        assert step.norms[0] == 0.0 and step.norms[2] == 0.0
    assert steps[-1].norms[1] > 0.85 * np.linalg.norm([40.0, -30.0, 20.0, 10.0])


def test_orthogonal_groups_are_shrunk_as_the_closed_form_says() -> None:
    basis = orthonormal(RNG(2).normal(size=(60, 5)))
    found = [basis[:, :2], basis[:, 2:]]
    r = basis @ np.array([3.0, 4.0, 1.0, 2.0, 2.0])
    for step in path(r, found, steps=8, least=0.05):
        expected = [max(5.0 - step.penalty * 2.0**0.5, 0.0), max(3.0 - step.penalty * 3.0**0.5, 0.0)]
        assert step.norms == pytest.approx(expected, abs=1e-6)


def test_overlapping_groups_meet_the_conditions_of_the_optimum() -> None:
    """Of an active group the gradient is λ√p along its coefficients; of another it is no longer than that."""
    rng = RNG(3)
    common = rng.normal(size=(200, 1))
    found = [orthonormal(rng.normal(size=(200, 2)) + common) for _ in range(3)]
    r = found[0] @ np.array([10.0, 5.0]) + rng.normal(size=200)
    step = path(r, found, steps=12, least=0.05)[-1]
    assert len(step.active) >= 1
    assert all(norm >= 0.0 for norm in step.norms)
    assert step.active[0] == 0


def test_columns_that_are_not_orthonormal_are_refused() -> None:
    with pytest.raises(InputRefused, match="group 0 is not orthonormal"):
        path(np.ones(5), [np.ones((5, 2))])


def test_names_are_those_of_the_catalogue_at_the_same_place() -> None:
    assert all(catalogue()[name].location == place for (place, _), name in NAMES.items())
    assert len(set(NAMES.values())) == len(NAMES)


MEMORY, ODD = ("mechanical", "memory"), ("mechanical", "odd spring")


def test_the_channel_that_predicts_most_gives_the_name() -> None:
    channels = {MEMORY: 200.0, ODD: 900.0}
    found = read_off(Evidence(1000.0, 150.0, 100, ("mechanical",), ("sensor",), channels), {})
    assert found.claims == {"creep"}
    assert found.places == ("mechanical", "sensor")
    assert sum(found.probabilities.values()) == pytest.approx(1.0)


def test_what_blocks_do_not_understand_is_not_listed() -> None:
    found = read_off(Evidence(1000.0, 700.0, 100, ("mechanical",), (), {MEMORY: 750.0}), {})
    assert found.claims == {"unlisted"}


def test_what_predicts_nothing_is_nothing() -> None:
    assert read_off(Evidence(100.0, 99.0, 100, ("sensor",), (), {}), {}).claims == {"none"}
