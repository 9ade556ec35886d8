"""A made-up diagnosis: an actuator whose creep was left out, with noise of 50 nm."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np

from phnn.diagnose.words import Picture
from phnn.report.evidence import CandidateRow, Evidence, LedgerRow, ModelRow, ParameterRow, Trace

NOISE = 5e-8
NAMES = ("sine_1Hz_75V", "sine_10Hz_75V", "step_50V", "sine_150Hz_75V", "triangle_2Hz_40V")
HELD_OUT = ("sine_10Hz_75V", "step_50V")
_SHAPES = {"sine_1Hz_75V": (1.0, 3.0), "sine_10Hz_75V": (10.0, 1.0), "sine_150Hz_75V": (150.0, 0.4)}


def _play(u: np.ndarray, width: float) -> np.ndarray:
    out = np.empty_like(u)
    state = 0.0
    for i, value in enumerate(u):
        state = min(max(state, value - width), value + width)
        out[i] = state
    return out


def _excitation(name: str, t: np.ndarray) -> np.ndarray:
    if name == "step_50V":
        return np.where(t > 0.2, 50.0, 0.0)
    if name == "triangle_2Hz_40V":
        return 40.0 * (1.0 - np.abs(1.0 - 2.0 * ((2.0 * t) % 1.0)))
    frequency, _ = _SHAPES[name]
    return 37.5 * (1.0 - np.cos(2.0 * np.pi * frequency * t))


@cache
def make_trace(name: str, count: int | None = None, creeps: bool = True) -> Trace:
    """A trace whose base model misses a slow memory of 3 % of the displacement (or nothing)."""
    seconds = _SHAPES.get(name, (0.0, 2.0))[1]
    count = count or round(seconds * 5000)
    t = np.arange(count) * (seconds / count)
    u = _excitation(name, t)
    base = 0.3e-6 * u + 0.12e-6 * _play(u, 9.0)
    slow = np.empty_like(u)
    state = 0.0
    rate = seconds / count / 0.08
    for i, value in enumerate(base):
        state += rate * (value - state)
        slow[i] = value - state
    rng = np.random.default_rng(len(name))
    truth = base - 0.03 * slow if creeps else base
    measured = truth + NOISE * rng.standard_normal(count)
    scored = np.ones(count, dtype=bool)
    scored[: max(50, count // 50)] = False
    return Trace(name, t, u, measured, base, truth, NOISE, name in HELD_OUT, scored)


def _score(trace: Trace, model: np.ndarray) -> dict[str, float]:
    y, error = trace.measured[trace.scored], (trace.measured - model)[trace.scored]
    rmse = float(np.sqrt(np.mean(error**2)))
    fit = 100.0 * (1.0 - float(np.linalg.norm(error) / np.linalg.norm(y - y.mean())))
    return {"fit_percent": fit, "rmse": rmse, "residual_over_noise": rmse / NOISE}


def make_curves() -> tuple[Picture, ...]:
    """A learned spring force against the fading memory of the displacement, and a decay."""
    x = np.linspace(-6.0, 6.0, 121)
    learned = 0.9 * x + 0.22 * np.sin(x) + 0.004 * x**2
    lag = np.geomspace(0.002, 2.0, 80)
    relax = np.exp(-lag / 0.31)
    return (
        Picture(
            x,
            learned,
            0.15 + 0.03 * np.abs(x),
            "q − low-passed q (µm)",
            "missing force (N, up to one common factor)",
            "Missing force against memory",
        ),
        Picture(
            lag,
            relax + 0.03 * np.sin(9.0 * lag),
            np.full(80, 0.03),
            "time after a step (s)",
            "relative force",
            "How the memory fades",
        ),
    )


def make_evidence(names: tuple[str, ...] = NAMES, creeps: bool = True, sentence: str = "") -> Evidence:
    """Everything a report can show."""
    return Evidence(
        traces=tuple(make_trace(name, creeps=creeps) for name in names),
        curves=make_curves() if creeps else (),
        parameters=(
            ParameterRow("m", "moving mass", "kg", 1.11e-3, 1.11e-3, None, "held: known to within 1 %"),
            ParameterRow("b", "viscous damping", "N·s/m", 41.2, 38.94, 0.6, "up to one common factor"),
            ParameterRow("k", "stiffness", "N/m", 3.02e5, 3.11e5, 2.1e3, "up to one common factor"),
            ParameterRow("alpha", "coupling", "N/V", 0.1201, 0.1187, 0.0009, "up to one common factor"),
            ParameterRow("rho_1", "conductance of hysteron 1 beyond its threshold", "S", 3.3e-3, 2.1e-3, 9e-4, ""),
            ParameterRow("d_1", "threshold of hysteron 1", "V", 3.92, 4.114, 0.031, ""),
            ParameterRow("d_2", "threshold of hysteron 2", "V", 19.5, 30.0, None, "at its bound"),
            ParameterRow("tau", "relaxation time of the creep cell", "s", None, 0.312, 0.021, "new"),
            ParameterRow("k_s", "stiffness of the creep cell", "N/m", None, 9.21e3, 3.3e2, "new"),
        ),
        candidates=(
            CandidateRow("creep", "mechanical", 41.2, 15.1, "in the final model" if creeps else "not significant"),
            CandidateRow("charge_leakage", "electrical", 38.7, 14.0, "fitted"),
            CandidateRow("extra_hysteron", "hysteron", 22.1, 9.3, "fitted"),
            CandidateRow("cubic_stiffness", "mechanical", 1.1, 0.01, "not significant"),
        ),
        models=(
            ModelRow("creep", 1.01, 1.02, 2, 0.97, True, True),
            ModelRow("charge leakage", 1.42, 1.61, 1, 0.03, True, False),
            ModelRow("extra hysteron", 1.95, math.nan, 2, 0.0, False, False),
            ModelRow("base model", 16.0, 17.2, 0, 0.0, True, False),
        ),
        ledger=tuple(
            LedgerRow(
                name,
                2.1e-3 + 0.3e-3 * (i == 1),
                0.3e-3 * (i == 1),
                {"hysteron 1": 0.6e-3, "hysteron 2": 1.1e-3 + 0.1e-3 * i, "mechanical damping": 2e-4, "creep": 1e-4},
                1e-4 * (1 - i),
            )
            for i, name in enumerate(names[:3])
        ),
        notes=(
            "5 CSV files were read; time in s, voltage in V, displacement in µm; 5000 samples per second.",
            "sine_10Hz_75V and step_50V were held out: a new frequency and a new wave form.",
            "The voltage is the command to the amplifier, not the voltage at the terminals.",
            "readme.txt is no recording and was left alone.",
        ),
        verdict_sentence=sentence,
    )


def _location(verdict: str) -> dict[str, Any] | None:
    if verdict == "none":
        return None
    scores = {"mechanical": 0.93, "electrical": 0.91, "hysteron": 0.55, "coupling": 0.31, "thermal": 0.28}
    scores |= {"sensor": 0.12, "amplifier": 0.1, "environment": -0.02}
    return {
        "name": "mechanical",
        "detail": "memory",
        "tied": ["electrical"],
        "scores": scores,
        "recordings": {"step_50V": {"residual_over_noise": 8.4}, "sine_1Hz_75V": {"residual_over_noise": 4.1}},
        "frequencies_Hz": [1.0, 2.0, 3.0],
        "times_s": [0.2, 0.25],
    }


def _missing(verdict: str) -> list[dict[str, Any]]:
    if verdict == "none":
        return []
    entry: dict[str, Any] = {
        "effect": "creep",
        "location": "mechanical",
        "equivalent_to": ["charge_leakage"] if verdict == "equivalent" else [],
        "p_value": 1e-3,
        "statement": "The displacement keeps growing after the voltage has come to rest: a spring in series with a "
        "damper pulls beside the main spring, and lets go within a third of a second.",
        "equation": r"F_c = k_s\, s, \qquad \dot s = v - \frac{s}{\tau}",
        "passive": True,
        "parameters": {
            "tau": {"value": 0.312, "unit": "s", "std": 0.021},
            "k_s": {"value": 9.21e3, "unit": "N/m", "std": 330.0},
        },
    }
    if verdict == "unknown":
        entry |= {"effect": "unknown", "parameters": {}, "equation": r"F = \varphi_\theta(q - q_\tau)"}
        entry["statement"] = "A force that remembers the displacement; no element of the catalogue has its shape."
    return [entry]


def make_document(verdict: str, evidence: Evidence) -> dict[str, Any]:
    """A document that fits the evidence."""
    none = verdict == "none"
    before = {trace.name: _score(trace, trace.before) for trace in evidence.traces}
    after = {} if none else {trace.name: _score(trace, trace.after) for trace in evidence.traces}
    remainder = {"verdict": "none", "residual_over_noise": 1.01, "p_value": 0.4, "location": None}
    following = {
        "recording": "hold at 60 V for 30 s, then at 0 V for 30 s",
        "separates": ["creep", "charge_leakage"],
        "groups": [["creep", "charge_leakage"]],
        "why": "Leakage is bounded by the thresholds and stops; creep goes on for a decade of time longer.",
    }
    return {
        "schema": "phnn.diagnosis/1",
        "verdict": verdict,
        "test": {"statistic": 2.1 if none else 41.2, "p_value": 0.44 if none else 1e-5, "candidate": "creep"},
        "probability": {"none": 1.0} if none else {"creep": 0.97, "charge_leakage": 0.03, "delay": 0.004, "none": 0.0},
        "missing": _missing(verdict),
        "remainder": remainder,
        "location": _location(verdict),
        "noise_floor": {trace.name: trace.noise for trace in evidence.traces},
        "numerical_error_sigma": 0.3,
        "fit": {"before": before, "after": after, "held_out": [t.name for t in evidence.traces if t.held_out]},
        "next_experiment": following if verdict in ("equivalent", "unknown") else None,
        "versions": {"phnn": "0.1.0", "torch": "2.13.0", "numpy": "2.4.6"},
        "seed": 0,
        "seconds": 41.0,
    }
