"""Refits in other processes, and diagnoses of imposed motions."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import campaigns
import numpy as np
import pytest
from numpy.typing import NDArray

from phnn.criteria import Criteria
from phnn.diagnose.diagnosis import diagnose
from phnn.diagnose.number import Visited
from phnn.diagnose.search import _heat, begin, explore
from phnn.effects import catalogue
from phnn.identification.fit import Fit
from phnn.identification.plan import Options, Plan
from phnn.identification.staged import fit_identified
from phnn.models.actuator import hrc
from phnn.parallel import executor
from phnn.recordings import Campaign, read
from phnn.recordings.recording import Start
from phnn.report.result import missing_entries
from phnn.report.words import picture
from phnn.setup import Setup

HELD = {"m": "held at the stated value"}


@cache
def base() -> Fit:
    """A fit that misses creep, on a recording from rest and one with an unknown start."""
    t = np.arange(301) * 2e-4
    true = catalogue()["creep"].add_to(Setup(hrc(1)), {"k_s": 2e3, "tau_s": 5e-3})
    made = [campaigns.recorded(true, f"sine {f}", t, 80.0 * np.sin(2 * np.pi * f * t), 2e-8, seed=f) for f in (50, 150)]
    plan = Plan((made[0], replace(made[1], start=Start("unknown"))), {"sine 50": 2, "sine 150": 2}, workers=2)
    return fit_identified(Setup(hrc(1)), plan, HELD, max_evaluations=10)


def visited(choice: str) -> list[Visited]:
    """Short refits of three effects, and all models of a search, whose refits are done somewhere."""
    campaign = Campaign(base().plan.recordings, {}, {}, "command", (), True, "made up")
    effects = [catalogue()[n] for n in ("creep", "quadratic_drag", "cubic_stiffness")]
    search = begin(campaign, base(), effects, [], Criteria(), most=1, executor=executor(choice))
    heat = _heat(search, search.base, search.screen(search.screen.base))
    explore(search)
    return [*heat, *search.weighed.models]


def assert_same(found: Sequence[Visited], expected: Sequence[Visited]) -> None:
    """The same models to the last bit, on the same recordings."""
    assert [m.elements for m in found] == [m.elements for m in expected]
    for one, other in zip(found, expected, strict=True):
        assert one.fit.setup.values() == other.fit.setup.values()
        assert one.fit.held == other.fit.held
        assert one.fit.plan == other.fit.plan
        for name in ("z", "covariance", "residual", "jacobian"):
            np.testing.assert_array_equal(getattr(one.fit, name), getattr(other.fit, name))
        assert (one.fitted, one.held_out, one.converged) == (other.fitted, other.held_out, other.converged)


def test_a_fit_survives_pickling() -> None:
    fitted = base()
    again = pickle.loads(pickle.dumps(fitted))
    assert fitted.variables.unknown == ("sine 150",)
    np.testing.assert_array_equal(again.initial("sine 150"), fitted.initial("sine 150"))
    for name in ("z", "covariance", "residual", "jacobian"):
        np.testing.assert_array_equal(getattr(again, name), getattr(fitted, name))
    assert again.setup == fitted.setup
    assert again.std() == fitted.std()
    for one, other in zip(again.plan.recordings, fitted.plan.recordings, strict=True):
        np.testing.assert_array_equal(one.y, other.y)
        assert (one.name, one.start, one.parts) == (other.name, other.start, other.parts)
    # And is as good as the original to go on with.
    onwards = [fit_identified(f.setup, f.plan, HELD, 3, origin=f) for f in (again, fitted)]
    np.testing.assert_array_equal(onwards[0].z, onwards[1].z)


@pytest.mark.parametrize("choice", ["threads:2", pytest.param("processes:2", marks=pytest.mark.slow)])
def test_refits_are_the_same_wherever_they_are_done(choice: str) -> None:
    expected = visited("serial")
    assert expected[0].words == "creep"
    assert len(expected) >= 5
    assert_same(visited(choice), expected)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [5, 7])
def test_a_stop_that_no_catalogue_lists_is_unknown_and_learned(seed: int) -> None:
    others = [n for n in catalogue() if n != "contact_stop"]
    made = campaigns.diagnosis("contact_stop", *others, seed=seed)
    assert made.verdict == "unknown"
    assert made.location is not None
    assert made.location.name == "mechanical"
    assert any(c.learned for c in made.claims) and not any(c.claimed for c in made.claims)
    assert made.after.over_noise("confirmation") < made.before.over_noise("confirmation")
    drawn = picture(made.linearised[0], made.location)
    assert drawn is not None
    stop = campaigns.concealed("contact_stop", seed)[1].parameters["q_c"] * 1e6
    beyond = drawn.y[drawn.x > stop]
    inside = drawn.y[np.abs(drawn.x) < 0.8 * stop]
    # Relative to a line through what lies before it, the missing force turns sharply beyond the stop.
    line = np.polyfit(drawn.x[np.abs(drawn.x) < 0.8 * stop], inside, 1)
    turn = beyond - np.polyval(line, drawn.x[drawn.x > stop])
    assert abs(turn[-1]) > 3.0 * np.ptp(inside - np.polyval(line, drawn.x[np.abs(drawn.x) < 0.8 * stop]))


Array = NDArray[np.float64]

K, B, F_C, V_S, K_F, NOISE = 4.0e4, 2.0e3, 120.0, 4.0e-3, 3.0e5, 2.0
DT, SIZE, FINER = 5e-3, 1000, 20
# Amplitude [m] and frequency [Hz] of every recording; the last two are held out.
SINES = ((4e-3, 0.6), (2e-3, 1.1), (6e-3, 0.9), (3e-3, 1.5), (5e-3, 0.75), (1e-3, 1.3))

RIG = """
junctions: {rig: 1}
elements:
  q: {type: C, junction: rig, law: spring, parameters: [k], unit: m}
  damper: {type: R, junction: rig, law: linear, parameters: [b], direction: resistance}
  motion: {type: Sf, junction: rig, unit: m/s}
parameters:
  k: {value: 1.0e+4, unit: N/m, positive: true}
  b: {value: 1.0e+3, unit: N s/m, positive: true}
output: motion
"""


def dry(x: Array, v: Array) -> Array:
    """Dry friction that turns round with the velocity [N]."""
    return np.asarray(F_C * np.tanh(v / V_S))


def bristles(x: Array, v: Array) -> Array:
    """A spring that slips: elastic before it slides [N]."""
    force, most = np.zeros_like(x), 0.5 * F_C
    for n in range(1, x.size):
        force[n] = min(max(force[n - 1] + K_F * (x[n] - x[n - 1]), -most), most)
    return force


def folder(home: Path, withheld: object) -> Path:
    """Recordings of a rig, from closed formulas alone."""
    rng, fine = np.random.default_rng(3), DT / FINER * np.arange((SIZE - 1) * FINER + 1)
    fade = np.minimum(fine / 0.8, 1.0) ** 3
    fade *= 10.0 - fade ** (1 / 3) * (15.0 - 6.0 * fade ** (1 / 3))
    for i, (size, frequency) in enumerate(SINES):
        x = size * fade * np.sin(2 * np.pi * frequency * fine)
        v = np.gradient(x, fine)
        force = (K * x + B * v + withheld(x, v))[::FINER] + NOISE * rng.standard_normal(SIZE)  # type: ignore[operator]
        rows = np.column_stack([fine[::FINER], 1e3 * x[::FINER], force])
        np.savetxt(home / f"r{i}.csv", rows, delimiter=",", header="time_s,input_mm,output_N", comments="")
    held = len(SINES) - 2
    uses = "\n".join(f"  - {{file: r{i}.csv, use: confirmation}}" for i in range(held, len(SINES)))
    others = "\n".join(f"  - {{file: r{i}.csv, use: identification}}" for i in range(held))
    (home / "rig.yaml").write_text(RIG)
    (home / "recordings.yaml").write_text(f"setup: {{network: rig.yaml}}\nstart: rest\nrecordings:\n{others}\n{uses}\n")
    return home


@pytest.mark.slow
@pytest.mark.parametrize(
    ("withheld", "known"),
    [(dry, {"F_c": F_C, "v_s": V_S}), (bristles, {"k_f": K_F, "F_c": 0.5 * F_C})],
    ids=["dry friction", "bristles"],
)
def test_friction_that_was_withheld_is_named(tmp_path: Path, withheld: object, known: dict[str, float]) -> None:
    found = diagnose(read(folder(tmp_path, withheld)), Options(workers=1))
    assert found.verdict == "named"
    (entry,) = missing_entries(found)
    assert entry["effect"] == "coulomb_friction" and entry["location"] == "mechanical" and entry["place"] == "q"
    assert found.after.over_noise("confirmation") < 1.05
    for name, value in known.items():
        assert entry["parameters"][name]["value"] == pytest.approx(value, rel=0.02)
    # A measured force is an anchor.
    assert "common factor" not in entry["statement"]
