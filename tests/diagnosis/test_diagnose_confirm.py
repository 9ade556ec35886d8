"""The held-out recordings have the last word on every element."""

from __future__ import annotations

from dataclasses import replace
from unittest import mock

import campaigns
import numpy as np
import pytest

from phnn.criteria import CRITERIA
from phnn.diagnosis import confirm
from phnn.diagnosis import tested as testing
from phnn.diagnosis.confirm import confirmed
from phnn.diagnosis.finding import Finding
from phnn.diagnosis.judge import Judgement
from phnn.diagnosis.name import Candidate
from phnn.diagnosis.trial import Trial
from phnn.effects import effect
from phnn.effects.learned import learned_elements
from phnn.identification.evaluate import Evaluation, score_part
from phnn.identification.fit import Fit
from phnn.identification.gain import Gain
from phnn.recordings.recording import Part, Recording, Start

NOISE = 4e-8
SIZE = 5000
TONE = np.sqrt(2.0) * np.sin(0.05 * np.arange(SIZE))
NAMES = ("creep", "amplifier_lowpass", "sensor_lag")


def a_gain(before: float, after: float, p: float | None = 1e-6) -> Gain:
    share = before**2 - after**2
    size = float(np.sign(share) * np.sqrt(abs(share)))
    return Gain(before, after, size * NOISE, size, 100 if p is not None else 3, p, p and 1.0 - p)


def recording(name: str, use: str) -> Recording:
    t = np.arange(SIZE) * 1e-4
    y = NOISE * np.random.default_rng(len(name)).standard_normal(SIZE)
    parts = (Part(name, 0, SIZE, use),)
    return Recording(name, t, t, y, Start("rest"), "cubic", parts, NOISE, "stated", np.array([1.0]), None, {}, name)


RECORDINGS = (recording("used", "identification"), recording("held out", "confirmation"))
CAMPAIGN = mock.Mock(recordings=RECORDINGS)


class World:
    """Fits whose errors on identification and held-out recordings are given; a judgement of some of them."""

    def __init__(self) -> None:
        self.known: list[tuple[Fit, Evaluation]] = []

    def fit(self, used: float, held: float) -> Fit:
        """A fit that leaves so much of a tone [× noise] beside the noise, on either kind of recording."""
        base = campaigns.base()
        unit = base.residual / np.sqrt(base.chi2)
        made = replace(base, residual=unit * np.sqrt(1.0 + used**2))
        outputs = {r.name: NOISE * a * TONE for r, a in zip(RECORDINGS, (used, held), strict=True)}
        parts = [score_part(r, outputs[r.name], 0, SIZE, r.name, r.parts[0].use) for r in RECORDINGS]
        self.known.append((made, Evaluation(outputs, tuple(parts))))
        return made

    def scores(self, fitted: Fit, _: object) -> Evaluation:
        return next(e for f, e in self.known if f is fitted)

    def judge(
        self, base: Fit, final: Fit, alone: tuple[Fit, ...] = (), statistic: float = 100.0, left: object = None
    ) -> tuple[Judgement, Evaluation, Evaluation]:
        """The verdict on as many elements as there are models without one, on one where there are none."""
        findings = tuple(finding(n, final) for n, _ in zip(NAMES, alone or (base,), strict=False))
        naming = mock.Mock(statistic=statistic, numerical=0.0, candidates=(), generic=0.0)
        linearised = mock.Mock(fit=base)
        linearised.scales.noise = NOISE
        judgement = Judgement(
            "named", linearised, naming, mock.sentinel.location, final, mock.Mock(), findings, remainder=naming,
            remainder_location=left,
        )  # fmt: skip
        return self.confirm(judgement, dict(zip(NAMES, alone, strict=False)))

    def confirm(self, judgement: Judgement, alone: dict[str, Fit]) -> tuple[Judgement, Evaluation, Evaluation]:
        def without(_: Fit, __: object, dropped: Finding, *___: object) -> Fit:
            return alone[dropped.effect.name]

        self.again = mock.Mock(fit=judgement.linearised.fit)
        self.again.scales.noise = NOISE
        here = mock.Mock(linearised=self.again, naming=judgement.naming, remaining=judgement.remainder_location)
        patched = {"score_on_all": self.scores, "without": without}
        with mock.patch.multiple(testing, **patched), mock.patch.object(confirm, "score_on_all", self.scores):
            return confirmed(judgement, judgement.linearised.fit, CAMPAIGN, CRITERIA, mock.Mock(return_value=here))


def finding(name: str, fitted: Fit) -> Finding:
    trial = Trial(Candidate(effect(name), {}, (), 10.0, 1e-3), fitted)
    return Finding(trial, (trial,), (trial,), mock.Mock())


def learned_finding(name: str, fitted: Fit) -> Finding:
    trial = Trial(Candidate(learned_elements()[name], {}, (), 10.0, 1e-3), fitted)
    return Finding(trial, (trial,), (trial,), mock.Mock(), learned=True, provisional=True)


def named(judgement: Judgement) -> list[str]:
    return [f.effect.name for f in judgement.findings]


@pytest.mark.parametrize(
    ("used", "held", "verdict"),
    [
        ((3.0, 0.0), (3.0, 0.2), "named"),
        ((3.0, 1.0), (3.0, 1.5), "named"),  # most of it confirmed
        ((3.0, 0.0), (3.0, 3.1), "unknown"),  # of no help there: a name is not proven by the identification alone
        ((3.0, 0.0), (0.05, 0.0), "unknown"),  # large, and nothing to confirm there
        ((0.1, 0.0), (0.05, 0.0), "none"),
        ((0.1, 0.0), (0.05, 0.06), "none"),
    ],
)
def test_a_single_element(used: tuple[float, float], held: tuple[float, float], verdict: str) -> None:
    world = World()
    base, final = (world.fit(u, h) for u, h in zip(used, held, strict=True))
    found, before, after = world.judge(base, final)
    assert found.verdict == verdict
    assert (found.immaterial is not None) == (verdict == "none")
    if verdict == "named":
        assert found.final is final and after is not before
        assert found.findings[0].held_out is not None and found.findings[0].held_out.falls < 1e-6
        return
    assert found.findings == () and found.final is base and after is before
    if verdict == "unknown":
        assert found.remainder_location is mock.sentinel.location
    else:
        assert found.location is None and found.immaterial is not None
        assert found.immaterial.candidate == "creep"
        assert found.immaterial.rms == pytest.approx(NOISE * found.immaterial.share_of_noise)
        assert found.immaterial.share_of_noise < 0.1


def test_every_element_of_a_chain_needs_a_gain_of_its_own() -> None:
    world = World()
    base, final = world.fit(5.0, 5.0), world.fit(0.0, 0.1)
    found, *_ = world.judge(base, final, (world.fit(2.0, 2.0), world.fit(1.0, 1.0)))
    assert found.verdict == "named" and named(found) == ["creep", "amplifier_lowpass"] and found.final is final
    assert [round(f.held_out.before, 1) for f in found.findings if f.held_out] == [2.2, 1.4]

    # Without the second the held-out error is as good: it goes, and the first is held against the base model.
    alone = world.fit(0.05, 0.05)
    found, _, after = world.judge(base, world.fit(0.0, 0.06), (world.fit(2.0, 2.0), alone))
    assert found.verdict == "named" and named(found) == ["creep"]
    assert found.final is alone and found.final_linearised is world.again
    assert after is world.scores(alone, None)


def test_an_element_without_which_the_others_cannot_be_fitted_is_not_proven() -> None:
    world = World()
    base, final = world.fit(5.0, 5.0), world.fit(0.0, 0.1)
    found, *_ = world.judge(base, final, (None, world.fit(1.0, 1.0)))  # type: ignore[arg-type]
    assert found.final is final
    assert [f.provisional for f in found.findings] == [True, False]


def test_what_stands_alone_after_others_fell_must_explain_what_there_was_to_have_a_name() -> None:
    world = World()
    base, little = world.fit(5.0, 5.0), world.fit(4.5, 4.5)
    found, *_ = world.judge(base, world.fit(0.0, 6.0), (base, little), left=mock.sentinel.left)
    # It helps, so that it stays in the model.
    assert found.verdict == "unknown" and found.claimed == () and named(found) == ["creep"]
    assert found.final is little


def test_a_chain_that_held_out_recordings_cannot_test_keeps_its_model_but_not_its_names() -> None:
    world = World()
    base, final = world.fit(90.0, 90.0), world.fit(5.0, 9.0)
    found, _, after = world.judge(base, final, (base, world.fit(20.0, 9.01)))
    assert found.verdict == "equivalent" and found.final is final and after is world.scores(final, None)
    assert [f.provisional for f in found.findings] == [False, True]
    assert all(f.held_out is not None and f.held_out.falls is None for f in found.findings)


def nameless(base: Fit, final: Fit, names: tuple[str, ...] = NAMES[:1]) -> Judgement:
    """A model whose elements have no proven names."""
    linearised = mock.Mock(fit=base)
    linearised.scales.noise = NOISE
    naming = mock.Mock(statistic=100.0, candidates=(), generic=0.0)
    return Judgement(
        "unknown", linearised, naming, mock.sentinel.location, final, mock.Mock(),
        tuple(replace(finding(n, final), provisional=True) for n in names), remainder=naming,
    )  # fmt: skip


@pytest.mark.parametrize(("held", "stays"), [(3.1, False), (1.5, True)])
def test_an_element_without_a_name_stays_where_it_helps_held_out_recordings(held: float, stays: bool) -> None:
    world = World()
    base, final = world.fit(3.0, 3.0), world.fit(1.0, held)
    judgement = nameless(base, final)
    found, before, after = world.confirm(judgement, {})
    assert found.verdict == "unknown" and found.claimed == () and (after is not before) is stays
    assert found.final is (final if stays else base) and named(found) == ["creep"] * stays
    if not stays:
        assert found.final_linearised is judgement.linearised
        assert found.remainder is judgement.naming and found.remainder_location is judgement.location


@pytest.mark.parametrize(("left", "claimed"), [(1.0, ["creep"]), (0.3, ["creep", "amplifier_lowpass"])])
def test_an_element_that_takes_less_than_the_model_leaves_keeps_no_name(left: float, claimed: list[str]) -> None:
    """The lowpass takes 0.44 of the noise power, and is proven; the model leaves 1.0, or 0.09."""
    world = World()
    base, final = world.fit(5.0, 5.0), world.fit(0.0, left)
    others = world.fit(4.0, 4.0), world.fit(1.0, float(np.sqrt(left**2 + 0.44)))
    found, *_ = world.judge(base, final, others)
    assert named(found) == ["creep", "amplifier_lowpass"] and found.final is final
    assert found.verdict == "named" and [f.effect.name for f in found.claimed] == claimed


def test_of_several_elements_without_a_name_those_that_help_stay() -> None:
    world = World()
    base, final, alone = world.fit(5.0, 5.0), world.fit(1.0, 2.0), world.fit(1.1, 1.9)
    judgement = nameless(base, final, NAMES[:2])
    found, *_ = world.confirm(judgement, {"creep": world.fit(4.0, 4.0), "amplifier_lowpass": alone})
    assert found.verdict == "unknown" and named(found) == ["creep"] and found.final is alone


def test_a_gain_that_chance_might_make_is_not_told_beside_a_residual_hardly_above_the_noise() -> None:
    world = World()
    base, final = world.fit(0.3, 0.41), world.fit(0.1, 0.38)
    for after, verdict in ((1.07, "none"), (0.96, "unknown")):  # from 1.085: 0.18 and half of the noise
        with mock.patch.object(testing, "gain", side_effect=lambda *_, to=after: a_gain(1.085, to, 0.09)):
            found, *_ = world.judge(base, final)
        assert found.verdict == verdict
        assert found.final is (base if verdict == "none" else final)


@pytest.mark.parametrize(("level", "statistic", "verdict"), [(0.0, 6.0, "none"), (2.0, 6.0, "unknown")])
def test_a_mismatch_without_a_name_is_told_only_where_it_matters(level: float, statistic: float, verdict: str) -> None:
    world = World()
    base = world.fit(level, 0.0)
    linearised = mock.Mock(fit=base)
    linearised.scales.noise = NOISE
    naming = mock.Mock(statistic=statistic, candidates=(), generic=statistic)
    nameless = Judgement("unknown", linearised, naming, mock.sentinel.location, base, linearised)
    found, *_ = world.confirm(nameless, {})
    assert found.verdict == verdict
    if found.immaterial is not None:
        assert found.immaterial.candidate is None
        assert found.immaterial.share_of_noise == pytest.approx(statistic / np.sqrt(base.residual.size))


@pytest.mark.parametrize(("takes", "names"), [(2.0, []), (0.3, ["quadratic_drag"])])
def test_a_name_falls_beside_a_learned_element_at_its_place_that_takes_as_much(takes: float, names: list[str]) -> None:
    world = World()
    base, final = world.fit(5.0, 5.0), world.fit(0.0, 0.0)
    beside = learned_finding("learned_damper", final)
    judgement = nameless(base, final, ())
    judgement = replace(judgement, verdict="named", findings=(finding("quadratic_drag", final), beside))
    alone = {"quadratic_drag": world.fit(4.0, 4.0), "learned_damper": world.fit(takes, takes)}
    found, *_ = world.confirm(judgement, alone)
    assert found.final is final
    assert [f.effect.name for f in found.claimed] == names
    assert found.verdict == ("named" if names else "unknown")


@pytest.mark.parametrize(
    ("first", "learned", "names"),
    [
        (0.95, "learned_spring", ["cubic_stiffness"]),
        (0.85, "learned_spring", []),
        (None, "learned_spring", []),
        (0.95, "learned_damper", []),
    ],
)
def test_a_name_that_took_nearly_all_stands_beside_learned_elements_of_its_kind(
    first: float | None, learned: str, names: list[str]
) -> None:
    world = World()
    base, final = world.fit(5.0, 5.0), world.fit(0.0, 0.0)
    beside = learned_finding(learned, final)
    judgement = nameless(base, final, ())
    claims = replace(finding("cubic_stiffness", final), first=first)
    judgement = replace(judgement, verdict="named", findings=(claims, beside))
    found, *_ = world.confirm(judgement, {"cubic_stiffness": world.fit(1.0, 1.0), learned: world.fit(2.0, 2.0)})
    assert [f.effect.name for f in found.claimed] == names


Levels = tuple[float, float]


@pytest.mark.parametrize(
    ("both", "spring", "cubic", "first", "stay", "claimed"),
    [
        # Beside a learned spring the cubic one gains nothing: it is asked without it.
        ((0.0, 0.0), (0.2, 0.0), (0.6, 0.6), 0.95, ["cubic_stiffness", "learned_spring"], ["cubic_stiffness"]),
        ((0.0, 0.0), (0.2, 0.0), (0.6, 0.6), 0.85, ["learned_spring"], []),
        # Alone it takes 3.7 and leaves 5.3 of the noise power; both together leave nothing.
        ((0.0, 0.0), (0.2, 0.0), (0.6, 2.3), 0.95, ["cubic_stiffness", "learned_spring"], ["cubic_stiffness"]),
        # It harms.
        ((0.0, 1.5), (0.2, 0.2), (0.6, 4.0), 0.95, ["learned_spring"], []),
        ((0.0, 3.2), (0.2, 0.2), (0.6, 4.0), 0.95, ["learned_spring"], []),
        # It gains nothing of its own.
        ((0.0, 0.2), (0.2, 0.2), (0.6, 3.0), 0.95, ["learned_spring"], []),
    ],
)
def test_the_name_of_an_effect_in_another_form(
    both: Levels, spring: Levels, cubic: Levels, first: float, stay: list[str], claimed: list[str]
) -> None:
    """What a cubic and a learned spring leave, both and each alone, of what was 3 × noise."""
    world = World()
    base, final = world.fit(3.0, 3.0), world.fit(*both)
    claims = replace(finding("cubic_stiffness", final), first=first)
    judgement = replace(
        nameless(base, final, ()), verdict="equivalent", findings=(claims, learned_finding("learned_spring", final))
    )
    found, *_ = world.confirm(judgement, {"cubic_stiffness": world.fit(*spring), "learned_spring": world.fit(*cubic)})
    assert named(found) == stay and [f.effect.name for f in found.claimed] == claimed
    assert found.verdict == ("equivalent" if claimed else "unknown")
