"""Every rival: the contract that all keep, and the truth that each can find."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np
import pytest
from rival_example import DT, linear_recordings, recording, second_order, sweep

from phnn.errors import InputRefused
from phnn.recordings.recording import Recording
from studies import rivals
from studies.rival_models.names import NAMES, rival
from studies.rival_models.operators import Dahl, Plays, Preisach, Static
from studies.rival_models.samples import split

FEW = 3  # evaluations or updates of each candidate


def error(found: list[np.ndarray], recordings: list[Recording]) -> float:
    """Residual over noise."""
    return float(
        np.sqrt(np.mean([np.mean(((r.y - y) / r.noise) ** 2) for r, y in zip(recordings, found, strict=True)]))
    )


@pytest.mark.parametrize("name", NAMES)
def test_contract(name: str) -> None:
    recordings = linear_recordings()
    fitted = rival(name).fit(recordings, math.inf, 1, most=FEW)
    outputs = fitted.outputs(recordings)
    assert [y.shape for y in outputs] == [r.y.shape for r in recordings]
    assert all(np.isfinite(y).all() for y in outputs)
    assert fitted.parameters > 0
    again = rival(name).fit(recordings, math.inf, 1, most=FEW).outputs(recordings)
    # Rounding in linear algebra depends on where arrays lie in storage.
    assert all(np.allclose(a, b, rtol=0.0, atol=1e-9) for a, b in zip(outputs, again, strict=True))
    # Nothing but the input and the start may shape the response: another output moves it by a constant only.
    other = replace(recordings[0], y=np.cos(np.arange(recordings[0].y.size)))
    assert np.ptp(fitted.outputs([other])[0] - outputs[0]) < 1e-9


@pytest.mark.parametrize("name", NAMES)
def test_a_sample_at_a_time_is_the_whole_recording(name: str) -> None:
    recordings = linear_recordings()
    fitted = rival(name).fit(recordings, math.inf, 0, most=FEW)
    dt = fitted.dt or DT
    u = sweep(1.5, 3.0, 9.0, 200)
    blind = replace(recording("blind", u, np.zeros(u.size), dt=dt), y=np.full(u.size, np.nan))
    whole = fitted.outputs([blind])[0]
    stepper = fitted.stepper(dt)
    state, single = stepper.rest(0.0), []
    for x in u:
        state, y = stepper.step(state, float(x))
        single.append(y)
    assert np.allclose(single, whole, atol=1e-8)
    if fitted.dt is not None:
        with pytest.raises(InputRefused, match="close the loop"):
            fitted.stepper(2.0 * fitted.dt)


@pytest.mark.parametrize("name", NAMES)
def test_refusals(name: str) -> None:
    first = linear_recordings()[0]
    with pytest.raises(InputRefused, match="one input"):
        rival(name).fit([replace(first, further={"second": first.u})], 1.0, 0)
    with pytest.raises(InputRefused, match="identification"):
        rival(name).fit([replace(first, parts=())], 1.0, 0)
    with pytest.raises(InputRefused, match="budget"):
        rival(name).fit([first], 0.0, 0)


@pytest.mark.parametrize("name", ["prandtl_ishlinskii", "preisach", "narx", "gru", "subnet"])
def test_the_budget_is_kept(name: str) -> None:
    recordings, chosen = linear_recordings(), rival(name)
    chosen.warm()
    began = time.process_time()
    fitted = chosen.fit(recordings, 1.5, 0)
    assert time.process_time() - began < 3.0
    assert fitted.facts["processor_seconds"] < 3.0


def test_an_unknown_rival_is_refused() -> None:
    with pytest.raises(InputRefused, match="transformer"):
        rival("transformer")


def test_an_absent_package_is_named() -> None:
    with pytest.raises(InputRefused, match=r"phnn\[rivals\]"):
        rivals.needed("a_package_that_nobody_has")


def test_what_chooses_the_size_is_a_recording_or_the_end_of_each() -> None:
    recordings = linear_recordings()
    three, one = split(recordings), split(recordings[:1])
    assert sorted(int(m.sum()) for m in three.check) == [0, 0, 600]
    assert [bool(m.any()) for m in three.fit] == [not m.any() for m in three.check]
    assert one.check[0].sum() == 180 and one.check[0][-180:].all() and not (one.check[0] & one.fit[0]).any()
    assert all(m.all() for m in three.both)


def test_hammerstein_recovers_its_own_truth() -> None:
    made = [recording(r.name, r.u, second_order(r.u + 0.2 * r.u**2 - 0.1 * r.u**3)) for r in linear_recordings()]
    held = recording("held", u := sweep(1.7, 3.0, 15.0), second_order(u + 0.2 * u**2 - 0.1 * u**3), "confirmation")
    fitted = rival("hammerstein").fit(made, 20.0, 0)
    assert error(fitted.outputs([*made, held]), [*made, held]) < 1.1


HYSTERETIC = {
    "prandtl_ishlinskii": (Plays(6), np.array([0.3, 0.2, 0.0, 0.3, 0.0, 0.0, 0.2, 0.1])),
    "preisach": (Preisach(4, 6), np.linspace(0.5, 0.1, 16)),
    "dahl": (Dahl(1, 1), np.array([1.0, -0.4])),
}


@pytest.mark.parametrize("name", HYSTERETIC)
def test_hysteresis_recovers_its_own_truth(name: str) -> None:
    operator, weights = HYSTERETIC[name]

    def made(key: str, u: np.ndarray, use: str = "identification") -> Recording:
        x = u / 2.0
        columns, _ = operator.run(operator.start, operator.rest(operator.start, 0.0), x, np.zeros(x.size))
        force = columns @ weights[: columns.shape[1]]
        return recording(key, u, second_order(force - force[0]), use)

    made_of = [made(r.name, r.u) for r in linear_recordings()]
    # The largest input is the scale: the first sweep reaches 2 within a per mille.
    held = made("held", sweep(1.7, 3.0, 15.0), "confirmation")
    fitted = rival(name).fit(made_of, 20.0, 0)
    assert error(fitted.outputs([*made_of, held]), [*made_of, held]) < 1.5
    assert error(rival("hammerstein").fit(made_of, 5.0, 0).outputs(made_of), made_of) > 10.0


def difference_equation(u: np.ndarray) -> np.ndarray:
    """``y_k = y_{k−1} + 0.1 (u_k − y_{k−1}) + 0.05 u_k y_{k−1} − 0.2 |Δu_k| y_{k−1}``."""
    y, now, last = np.zeros(u.size), 0.0, 0.0
    for k, x in enumerate(u):
        now = now + 0.1 * (x - now) + 0.05 * x * now - 0.2 * abs(x - last) * now
        y[k], last = now, x
    return y


def test_narx_recovers_a_difference_equation() -> None:
    rng = np.random.default_rng(3)
    inputs = [np.concatenate([[0.0], rng.uniform(-1.0, 1.0, 500)]) for _ in range(4)]
    made = [recording(f"r{k}", u, difference_equation(u)) for k, u in enumerate(inputs[:3])]
    held = recording("held", inputs[3], difference_equation(inputs[3]), "confirmation")
    fitted = rival("narx").fit(made, 20.0, 0)
    assert fitted.dt == pytest.approx(DT)
    assert error(fitted.outputs([*made, held]), [*made, held]) < 1.2


@pytest.mark.parametrize("name", ["gru", "lstm", "subnet"])
def test_networks_learn_a_linear_system(name: str) -> None:
    recordings = linear_recordings()
    untrained = rival(name).fit(recordings, math.inf, 0, most=1)
    trained = rival(name).fit(recordings, math.inf, 0, most=60)
    before, after = (error(f.outputs(recordings), recordings) for f in (untrained, trained))
    assert after < 0.5 * before
    other = rival(name).fit(recordings, math.inf, 7, most=1)
    assert not np.allclose(other.outputs(recordings)[0], untrained.outputs(recordings)[0])


def test_the_static_operator_has_no_hysteresis() -> None:
    operator, u = Static(3), np.array([0.0, 0.5, 1.0, 0.5, 0.0])
    columns, _ = operator.run(operator.start, operator.rest(operator.start, 0.0), u, np.zeros(5))
    assert np.array_equal(columns[1], columns[3])
