"""What tests of the generator share: a plan that is simulated in a tenth of the time of the published ones."""

from __future__ import annotations

import numpy as np
import pytest

from studies.generator import plans
from studies.generator.plans import Excitation, sine


def _brief(rng: np.random.Generator) -> tuple[Excitation, ...]:
    return (sine(20.0, periods=3, samples=400),)


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch) -> str:
    """Name of a plan of one recording of 0.15 s."""
    monkeypatch.setitem(plans.VARIED, "brief", _brief)
    return "brief"
