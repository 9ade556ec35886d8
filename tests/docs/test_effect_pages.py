"""The pages of the effects say what the effects declare."""

from __future__ import annotations

import numpy as np
import pytest
from effect_scenes import SHOWN, scene_of, shown
from effect_text import index, page, title

from phnn.effects import catalogue, effect


@pytest.mark.parametrize("name", ["creep", "amplifier_saturation", "mains_pickup", "overflow"])
def test_a_page_has_symptom_law_parameters_relations_and_separation(name: str) -> None:
    declared, found = effect(name), shown(effect(name))
    text = page(found)
    assert all(part in text for part in (declared.fingerprint, declared.separation, declared.equation))
    assert all(f"| `{p.name}` | " in text for p in declared.declares)
    assert all(f"]({n}.md)" in text for n in declared.neighbours)
    assert f"pictures/{name}.png" in text and "{" not in text.split("## In Python")[0].split("$$")[2]


def test_a_picture_shows_a_strength_that_is_visible_and_what_the_base_model_cannot_explain() -> None:
    found = shown(effect("creep"))
    reach = np.abs(scene_of(found.effect).base.y).max()
    assert np.abs(found.change).max() == pytest.approx(SHOWN * reach, rel=0.15)
    assert 0.05 < np.linalg.norm(found.left) / np.linalg.norm(found.change) < 0.9
    # A constant load shifts the zero of the output and nothing else.
    load = shown(effect("constant_load"))
    assert np.linalg.norm(load.left) < 0.05 * np.linalg.norm(load.change)


def test_the_index_lists_every_effect_once() -> None:
    effects = list(catalogue().values())
    text = index(effects)
    assert all(text.count(f"| [{title(e)}]({e.name}.md) | {e.fingerprint} |") == 1 for e in effects)
