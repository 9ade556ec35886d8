"""The next experiment: what it asks for, how well it is foreseen to separate, and that it does."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import campaigns
import numpy as np
import pytest
from junctions import recording

from phnn.diagnose.diagnosis import Diagnosis, diagnose
from phnn.diagnose.linearised import LinearisedFit, prepare
from phnn.diagnose.proposal import Experiment, Question, Stretch, left, menu, propose, refitted_rival, resonance
from phnn.diagnose.refit import short
from phnn.effects import effect
from phnn.identification.plan import Options, Plan
from phnn.identification.staged import fit_identified
from phnn.models.actuator import hrc
from phnn.recordings import Campaign, read
from phnn.recordings.recording import ACTUATOR, Recording, Start
from phnn.setup import Setup
from studies.generator import Case, Sealed, draw_case, make_case
from studies.generator.plans import Excitation, Piece, sine
from studies.generator.seal import MANIFEST, reported, write_manifest, write_recording
from studies.generator.world import NEUTRAL, TABLE
from studies.generator.world import simulate as by_the_world

NOISE = 5e-8
HELD = {"m": "held at the stated mass"}


def excitation(proposed: Experiment, name: str = "next") -> Excitation:
    """The same input for the generator; of several lines at once its converter holds every sample."""
    t = proposed.t
    if all(len(s.lines) < 2 for s in proposed.stretches):
        pieces = []
        for s in proposed.stretches:
            a, f, phase = s.lines[0] if s.lines else (0.0, 0.0, 0.0)
            back = phase / (2.0 * math.pi * f) if f else 0.0
            pieces.append(Piece(s.start, s.end, s.level, a, f, 0.0, s.start - back))
        return Excitation(name, tuple(pieces), 1.0 / proposed.rate, t.size, proposed.interpolation == "zero_order")
    ends = np.arange(1, t.size + 1) / proposed.rate
    held = [Piece(*piece) for piece in zip(t.tolist(), ends.tolist(), proposed.u.tolist(), strict=True)]
    return Excitation(name, tuple(held), 1.0 / proposed.rate, t.size, True)


def made(answer: Sealed, driven: Excitation) -> np.ndarray:
    """(N,) displacement [m] of the concealed actuator; its effect is stated in the generator's own parameters."""
    assert set(answer.parameters) <= {*NEUTRAL, "q_0"}
    law = {n: v for n, v in answer.parameters.items() if n in NEUTRAL}
    return by_the_world({**answer.base, **law}, driven)


def add(case: Case, answer: Sealed, campaign: Campaign, proposed: Experiment) -> None:
    """Record it into the folder of the case, for identification; the others keep their use."""
    folder = Path(campaign.folder)
    driven = excitation(proposed)
    y = reported(made(answer, driven), case.noise, case.stream("next"))
    write_recording(folder / f"{driven.name}.csv", driven, y)
    held = {r.name for r in campaign.recordings if r.mask("confirmation").any()}
    plan = (*case.recordings, driven)
    uses = {e.name: "confirmation" if e.name in held else "identification" for e in plan}
    write_manifest(folder / MANIFEST, case.base["m"], plan, uses)


def recorded(proposed: Experiment, law: dict[str, float], seed: int) -> Recording:
    """What the independent generator reports of Table 1's actuator with something concealed."""
    driven = excitation(proposed, proposed.kind)
    answer = Sealed("", law, dict(TABLE), 0.0, NOISE, 0.0, seed, "", (), "same")
    y = made(answer, driven) + 2e-6
    y += NOISE * np.random.default_rng(seed).standard_normal(y.size)
    start, between = Start("rest", 0.0), "zero_order" if driven.held else "cubic"
    return recording(
        driven.t, driven.voltage(driven.t), start, "identification", name=driven.name, y=y, interpolation=between,
        noise=NOISE,
    )  # fmt: skip


def at_hand(name: str, frequency: float, amplitude: float, periods: int) -> Experiment:
    made = sine(frequency, amplitude, periods)
    duration = made.pieces[0].end
    stretch = Stretch(0.0, duration, lines=((amplitude, frequency, 0.0),))
    return Experiment(name, name, (stretch,), 1.0 / made.dt, ACTUATOR)


@cache
def linearised(**law: float) -> LinearisedFit:
    plan = (at_hand("slow", 10.0, 75.0, 3), at_hand("fast", 60.0, 40.0, 6))
    recordings = tuple(recorded(e, law, i) for i, e in enumerate(plan))
    base = Setup(hrc(2, dict(TABLE)), name="phs")
    return prepare(fit_identified(base, Plan(recordings, {r.name: 2 for r in recordings}, 2), HELD))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 36, 45])
def test_the_recording_that_is_proposed_resolves_the_class(seed: int, tmp_path: Path) -> None:
    case = draw_case(seed, "same", "few", (1.1, 1.6))
    answer = make_case(case, tmp_path / "recordings")
    campaign = read(tmp_path / "recordings")
    first = diagnose(campaign, Options(workers=2))
    assert first.verdict == "equivalent"
    before = alternatives(first)
    assert answer.effect in before
    assert len(before) > 1
    assert first.proposal is not None
    assert first.proposal.separation > first.proposal.needed
    add(case, answer, campaign, first.proposal.experiment)
    second = diagnose(read(tmp_path / "recordings"), Options(workers=2))
    assert alternatives(second) == [answer.effect]
    assert second.verdict == "named"


def alternatives(made: Diagnosis) -> list[str]:
    """Names of the effects of a model, and of those that may stand in their place."""
    return [e.canonical for c in made.claims for e in (c.effect, *c.alike)]


def test_what_old_recordings_allow_to_move_does_not_count() -> None:
    rng = np.random.default_rng(0)
    moved = rng.standard_normal((200, 3))
    other = rng.standard_normal(200)
    basis = np.linalg.qr(moved)[0]
    across = other - basis @ (basis.T @ other)
    difference = 5.0 * moved[:, 0] + across
    free, fixed = 1e-9 * np.eye(3), 1e9 * np.eye(3)
    assert left(difference, moved, free) == pytest.approx(np.linalg.norm(across), rel=1e-6)
    assert left(difference, moved, fixed) == pytest.approx(np.linalg.norm(difference), rel=1e-6)
    # One parameter, one direction: ‖S‖² a² / (1 + ‖S‖² P).
    s, p, a = moved[:, :1], 0.04, 2.0
    expected = a * np.linalg.norm(s) / math.sqrt(1.0 + float(np.sum(s**2)) * p)
    assert left(a * s[:, 0], s, np.array([[1.0 / math.sqrt(p)]])) == pytest.approx(expected)


def test_the_menu_stays_within_what_is_in_use_and_says_all_that_is_needed() -> None:
    g = linearised(tau_d=2e-5)
    made = menu(g)
    kinds = ["hold", "slow sine", "near-resonance sine", "amplitude sweep", "multisine", "offset sine"]
    assert [e.kind for e in made] == kinds
    highest = max(1.0 / r.dt for r in g.plan.recordings)
    for e in made:
        assert np.abs(e.u).max() <= 75.0 + 1e-9
        assert 1_000 < e.t.size <= 20_000
        assert e.rate <= 2.0 * highest
        assert e.words.startswith(e.kind)
        assert " V" in e.words
        assert " s" in e.words
        assert f"{e.rate:.6g} samples/s" in e.words
        for s in e.stretches:
            assert all(f"{f:.6g}" in e.words for _, f, _ in s.lines)
        assert e.u[0] == pytest.approx(e.stretches[0].level, abs=0.05)
        driven = excitation(e)
        assert driven.t == pytest.approx(e.t)
        assert driven.voltage(driven.t) == pytest.approx(e.u, abs=1e-9)
    slow = next(e for e in made if e.kind == "slow sine")
    near = next(e for e in made if e.kind == "near-resonance sine")
    assert slow.stretches[0].lines[0][1] == pytest.approx(2.0)
    at = resonance(g.fit.setup)
    assert at is not None
    assert 0.5 * at <= near.stretches[0].lines[0][1] < at


def test_no_class_no_proposal() -> None:
    g = campaigns.linearised("quadratic_drag")
    drag = effect("quadratic_drag")
    fitted = short(g.fit, g.fit.plan.coarse(), drag, drag.grid(g.scales)[:1], 12)
    assert fitted is not None
    models = (refitted_rival("creep", g.fit), refitted_rival("quadratic_drag", fitted, drag.parameters))
    found = propose([Question(models)], g)
    assert found is not None
    assert found.experiment.words in [e.words for e in menu(g)]
    assert found.menu[found.experiment.kind] == max(found.menu.values())
    # Drag needs speed to show itself.
    assert found.experiment.kind == "near-resonance sine"
    assert found.separates == ("creep", "quadratic_drag")
    assert propose([], g) is None
    assert propose([Question((models[0], models[0]))], g) is None
