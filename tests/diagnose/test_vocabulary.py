"""Words and units of what is told belong to the system that was recorded."""

from __future__ import annotations

from dataclasses import replace

import campaigns
import numpy as np
import pytest

from phnn.configuration import config_folder
from phnn.diagnose.linearised import LinearisedFit
from phnn.diagnose.locations import GROUPS, Location
from phnn.diagnose.words import fitted_in_words, picture, vocabulary_of
from phnn.models.network_file import load_network
from phnn.report.domain_words import in_own_words
from phnn.report.reading import read_document

MECHANICAL = ("force", "displacement", "velocity", " N", "µm", " nm", "m/s", "motion", "acceleration")


def in_unit(unit: str, source: str) -> LinearisedFit:
    """A linearised whose network has other units of its output and its input."""
    linearised = campaigns.linearised("none")
    network = linearised.fit.setup.network
    other = replace(
        network,
        storages=tuple(replace(s, unit=unit) if s.name == network.output else s for s in network.storages),
        ports=tuple(replace(p, unit=source) for p in network.ports),
    )
    return replace(linearised, fit=replace(linearised.fit, setup=replace(linearised.fit.setup, network=other)))


def at(group: int, linearised: LinearisedFit) -> Location:
    """A location whose group of functions has some strengths."""
    count = GROUPS[group].functions(linearised.trajectories[0], linearised.scales).shape[1]
    weights = np.random.default_rng(group).normal(size=count)
    return Location(
        GROUPS[group].kind.location,
        GROUPS[group].kind.name,
        (),
        {},
        {},
        {},
        group,
        weights,
        np.diag(1e-4 * np.ones(count)),
    )


@pytest.mark.parametrize(
    "group", [i for i, g in enumerate(GROUPS) if g.kind.name in ("elastic", "dissipative", "shape")]
)
def test_tanks_in_volts_are_told_in_volts(group: int) -> None:
    linearised = in_unit("V", "V")
    told = fitted_in_words(linearised, at(group, linearised))
    assert not any(word in told for word in MECHANICAL), told
    assert "effort" in told
    drawn = picture(linearised, at(group, linearised))
    assert drawn is not None
    assert not any(word in f"{drawn.x_label} {drawn.y_label}" for word in MECHANICAL)
    if GROUPS[group].kind.name == "dissipative":
        assert drawn.x_label == "rate of the output [V/s]"


def test_a_place_where_nothing_moves_is_not_called_mechanical() -> None:
    told = {
        "verdict": "unknown",
        "location": {"name": "mechanical", "scores": {"mechanical": 0.9, "sensor": 0.1}, "tied": ["sensor"]},
        "missing": [{"effect": "unknown", "location": "mechanical"}],
        "remainder": {"verdict": "unknown", "location": "mechanical"},
    }
    for units, shown in (({"output": "m"}, "mechanical"), ({"output": "V"}, "inside the network")):
        found = in_own_words(read_document(told | {"units": units}))
        assert found.location is not None and found.remainder is not None
        assert found.location.name == found.location.scores[0][0] == shown
        assert found.missing[0].location == found.remainder.location == shown


@pytest.mark.parametrize(
    ("unit", "source", "words"),
    [
        ("m", "V", ("displacement", "velocity", "force", "voltage")),
        ("rad", "N m", ("angle", "angular velocity", "torque", "torque")),
        ("C", "V", ("charge", "current", "voltage", "voltage")),
        ("m3", "m3/s", ("volume", "flow", "pressure", "flow")),
        ("m³", "Pa", ("volume", "flow", "pressure", "pressure")),
        ("1", "1", ("output", "rate of the output", "effort", "input")),
    ],
)
def test_words_of_the_domains(unit: str, source: str, words: tuple[str, ...]) -> None:
    found = vocabulary_of(in_unit(unit, source).fit.setup.network)
    assert (found.output, found.rate, found.effort, found.source) == words
    assert found.mechanical is (unit == "m")


def test_an_imposed_motion_is_told_in_the_words_of_the_motion() -> None:
    words = vocabulary_of(load_network(config_folder() / "network" / "friction_rig.yaml"))
    assert (words.output, words.rate, words.effort, words.source) == ("displacement", "velocity", "force", "velocity")
    assert words.mechanical and words.output_unit == "m"
