"""Criteria and options: each is read and can be overridden; words and units of what is told are those of the system."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import campaigns
import numpy as np
import pytest

from phnn.cli import main
from phnn.configuration import compose, config_folder
from phnn.criteria import Criteria
from phnn.diagnose import diagnosis as path
from phnn.diagnose.diagnosis import diagnose
from phnn.diagnose.linearised import LinearisedFit
from phnn.diagnose.locations import GROUPS, locate
from phnn.diagnose.refit import converged, short
from phnn.effects.learned import learned_elements
from phnn.errors import InputRefused
from phnn.identification.plan import Options
from phnn.models.network_file import load_network
from phnn.report.statements import location_name
from phnn.report.words import fitted_in_words, picture, vocabulary_of

HOME = Path(path.__file__).parent


@pytest.mark.parametrize("name", [row["name"] for row in Criteria.table()])
def test_every_criterion_is_read_somewhere(name: str) -> None:
    """A criterion that nothing reads decides nothing."""
    sources = list(HOME.glob("*.py"))
    assert any(re.search(rf"criteria\.{name}\b", p.read_text(encoding="utf-8")) for p in sources)


def test_an_override_on_the_command_line_reaches_the_options() -> None:
    given_ = compose("diagnose", ["criteria.material=0.2", "criteria.refits=2", "material_share=0.03"])
    changed = Criteria().with_values(Options.from_config(given_).criteria)
    assert (changed.material, changed.material_share) == (0.2, 0.03)
    assert changed.refits == 2 and isinstance(changed.refits, int)
    assert changed.changed() == {"material": 0.2, "material_share": 0.03, "refits": 2}


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("criteria.matter=0.2", "no criterion is called 'matter'"),
        ("criteria.material=-1", "criteria.material=-1 must be a positive number"),
        ("criteria.material=much", "criteria.material=much must be a positive number"),
        ("criteria.refits=1.5", "criteria.refits=1.5 must be a whole number"),
        ("criteria.beam=true", "criteria.beam=True must be a positive number"),
        ("criteria=3", "write criteria.NAME=value"),
    ],
)
def test_what_is_no_criterion_is_refused(
    override: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # Before the recordings are looked for.
    assert main(["diagnose", str(tmp_path / "nowhere"), "--out", str(tmp_path / "out"), override]) == 2
    assert words in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("options", "budget", "words"),
    [
        (Options(criteria={"matter": 1.0}), None, "no criterion is called"),
        (Options(executor="fork"), None, "executor=fork is not known"),
        (Options(without=("crep",)), None, "crep"),
        (Options(), 0.0, "budget: 0 s: give a positive number of seconds"),
    ],
)
def test_what_is_wrong_is_refused_before_anything_is_fitted(options: Options, budget: float | None, words: str) -> None:
    nothing: Any = mock.sentinel.campaign
    with (
        mock.patch.object(path, "identify_base", side_effect=AssertionError("fitted")),
        pytest.raises(InputRefused, match=words),
    ):
        diagnose(nothing, options, budget=budget)


@pytest.mark.parametrize(
    ("effect", "words"),
    [
        ("cubic_stiffness", ("missing force", "the displacement")),
        pytest.param("coulomb_friction", ("missing",), marks=pytest.mark.slow),
    ],
)
def test_what_was_fitted_at_the_location_in_words(effect: str, words: tuple[str, ...]) -> None:
    linearised = campaigns.linearised(effect)
    found = fitted_in_words(linearised, locate(linearised))
    assert all(w in found for w in words), found


@pytest.mark.slow
def test_springs_beyond_the_recorded_motion_stay_as_weak_as_they_begin() -> None:
    linearised = campaigns.linearised("creep")
    wide = replace(linearised, scales=replace(linearised.scales, displacement=2.0 * linearised.scales.displacement))
    element, base = learned_elements()["learned_spring"], linearised.fit
    values = element.grid(wide.scales)[0]
    began = short(base, base.plan.coarse(), element, [values], 12)
    assert began is not None and began.cost < base.cost
    ended = converged(began, base.plan, base.held, element.parameters)
    assert ended is not None
    reached = max(float(np.abs(t.states[:, t.program.output]).max()) for t in linearised.trajectories)
    for found in (began, ended):
        fitted, stops = found.setup.values(), [f"{side}{i}" for i in range(1, 5) for side in "RL"]
        beyond = [i for i in stops if fitted[f"g_L{i[1]}"] > 1.01 * reached]
        assert len(beyond) >= 4
        assert not {f"k_{i}" for i in beyond} & set(found.variables.names)
        assert [fitted[f"k_{i}"] for i in beyond] == pytest.approx([values[f"k_{i}"] for i in beyond])
        assert any(f"k_{i}" in found.variables.names for i in stops)


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


@pytest.mark.parametrize(
    "group", [i for i, g in enumerate(GROUPS) if g.kind.name in ("elastic", "dissipative", "shape")]
)
def test_tanks_in_volts_are_told_in_volts(group: int) -> None:
    linearised = in_unit("V", "V")
    told = fitted_in_words(linearised, campaigns.location(group, linearised))
    assert not any(word in told for word in MECHANICAL), told
    assert "effort" in told
    drawn = picture(linearised, campaigns.location(group, linearised))
    assert (drawn is None) == (GROUPS[group].static is None)
    if drawn is None:
        return
    assert not any(word in f"{drawn.x_label} {drawn.y_label}" for word in MECHANICAL)
    if GROUPS[group].kind.name == "dissipative":
        assert drawn.x_label == "rate of the output [V/s]"


@pytest.mark.parametrize(("unit", "shown"), [("m", "mechanical"), ("V", "inside the network")])
def test_a_place_where_nothing_moves_is_not_called_mechanical(unit: str, shown: str) -> None:
    found = SimpleNamespace(base=in_unit(unit, "V").fit)
    assert location_name(found, "mechanical") == shown  # type: ignore[arg-type]
    assert location_name(found, "sensor") == "sensor"  # type: ignore[arg-type]


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
