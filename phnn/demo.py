"""Recordings of a simulated actuator that conceals one effect, for ``phnn demo``; the answer is sealed.

The actuator is the paper's, eqs. (2)–(6): two hysterons behind the coupling ``α`` of a mass, spring and damper,

    q̇ = v,    m v̇ = α (V − e_1 − e_2) − k q − b v,    Q̇_i = α v − h_i(e_i),    e_i = Q_i/C_i

with the dead zones ``h_i``. Nothing of the models that are to explain the recordings takes part: this file imports no
module of the package but its errors, has its own equations, and solves them with LSODA for inputs that are continuous
in time. Everything is SI, and everything follows from the seed.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from functools import partial
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.integrate import ODEintWarning, odeint

from phnn.errors import InputRefused, SolverFailed

__all__ = ["EFFECTS", "PLANS", "TABLE", "Drive", "Made", "Sealed", "generate", "make", "open_seal", "seal", "simulate"]

Array = NDArray[np.float64]
Rng = np.random.Generator
Values = Mapping[str, float]
Law = Callable[[float], dict[str, float]]  # parameters of an effect of a given strength
_Chosen = tuple[Values, Sequence[Array], float]  # these, the outputs [m] with it, and the residual [m] that it leaves

# Table 1 of the paper; rho_i is the conductance ϱ_i⁻¹.
TABLE = {
    "m": 1.0148e-3, "k": 24579.0, "b": 3.7356, "alpha": 0.046311, "C_1": 5.6425e-7, "C_2": 5.2125e-7,
    "rho_1": 0.6002, "rho_2": 1.1528e-4, "d_1": 14.7571, "d_2": 8.6838,
}  # fmt: skip
# The values at which every effect is absent; a time constant of 0 means that there is no lag.
NEUTRAL = {
    "k_s": 0.0, "tau_s": 1.0, "kappa_3": 0.0, "F_c": 0.0, "v_s": 1e-4, "c_2": 0.0, "G": 0.0, "kappa_d": 0.0,
    "epsilon": 0.0, "tau_V": 0.0, "V_max": math.inf, "tau_y": 0.0, "A_m": 0.0, "f_m": 50.0, "phi_m": 0.0,
}  # fmt: skip

_PEAK = 75.0  # V, largest voltage
_Q_0 = 100e-6  # m, displacement to which kappa_3 and kappa_d refer
_SPREAD = 0.2  # each parameter of Table 1 moves by up to this part of itself
_SLIPS = 1.1  # voltage of a hysteron that never slips, at the largest input, over its threshold: at least
_TARGETS = (3.0, 10.0)  # residual over noise that an effect leaves, drawn log-uniformly
_NOISES = (20e-9, 80e-9)  # m, standard deviation of the sensor's white noise
_STEPS_NM = (5, 20)  # nm, least step of the sensor
_ZERO = 5e-6  # m, largest displacement zero of a recording
_WEIGHED = 0.01  # standard deviation of the stated mass over the mass

_RELATIVE = 1e-7  # tolerance of LSODA; the displacement is then right within 0.1 nm
_SIZES = np.array([1e-4, 1e-2, 4e-6, 4e-6, 1e-4, 75.0, 1e-4])  # of q, v, Q_1, Q_2, s, V, y
_AHEAD = 1e-3  # relative step of the differences by which base parameters are refitted
_CLOSE, _ROUNDS, _POWER = 0.1, 20, 0.7  # how the strength is scaled, see `_scaled`
_GOLDEN = math.pi * (3.0 - math.sqrt(5.0))  # rad, by which the mains' phase moves from recording to recording


# ---- What drives the recordings


@dataclass(frozen=True)
class Drive:
    """One recording to be made.

    Attributes:
        name: of the recording.
        dt: sampling interval, s.
        samples: their number.
        pieces: first sample and voltage [V] over time [s] of every smooth stretch; the first one begins at sample 0.
    """

    name: str
    dt: float
    samples: int
    pieces: tuple[tuple[int, Callable[[float], float]], ...]

    @property
    def t(self) -> Array:
        """Return the sampling times, (samples,), s."""
        return np.arange(self.samples, dtype=np.float64) * self.dt

    @property
    def u(self) -> Array:
        """Return the voltages, (samples,), V; a sample at a jump belongs to what follows."""
        ends = (*(first for first, _ in self.pieces[1:]), self.samples)
        t = self.t.tolist()
        return np.array([f(x) for (first, f), end in zip(self.pieces, ends, strict=True) for x in t[first:end]])


def _oscillating(t: float, amplitude: float, frequency: float, rate: float = 0.0) -> float:
    """Return a sine whose frequency [Hz] grows by ``rate`` [Hz/s]."""
    return amplitude * math.sin(2.0 * math.pi * t * (frequency + 0.5 * rate * t))


def _constant(t: float, level: float) -> float:
    return level


def _sine(frequency: float, amplitude: float, samples: int) -> Drive:
    """Return three periods of a sine that starts from rest."""
    voltage = partial(_oscillating, amplitude=amplitude, frequency=frequency)
    return Drive(f"sine_{frequency:03.0f}Hz_{amplitude:.0f}V", 3.0 / frequency / samples, samples, ((0, voltage),))


def _step(hold: float, after: float) -> Drive:
    """Return rest, a voltage that is held [s], and release [s], at 2 kHz."""
    before, held, end = 100, 100 + round(2000 * hold), 100 + round(2000 * (hold + after))
    levels = (0, 0.0), (before, _PEAK), (held, 0.0)
    return Drive("step_75V", 5e-4, end, tuple((first, partial(_constant, level=level)) for first, level in levels))


def _chirp(amplitude: float, low: float, high: float, duration: float) -> Drive:
    """Return a sine whose frequency rises linearly, at 5 kHz."""
    voltage = partial(_oscillating, amplitude=amplitude, frequency=low, rate=(high - low) / duration)
    name = f"chirp_{low:.0f}-{high:.0f}Hz_{amplitude:.0f}V"
    return Drive(name, 2e-4, round(5000 * duration), ((0, voltage),))


_TONES = (1, _PEAK), (10, _PEAK), (25, _PEAK), (50, _PEAK), (100, _PEAK), (150, _PEAK), (10, 25), (10, 50), (50, 40)
PLANS: Mapping[str, tuple[Drive, ...]] = {
    "demo": (*(_sine(float(f), float(a), 1250) for f, a in _TONES), _step(1.0, 0.5), _chirp(60.0, 1.0, 100.0, 1.0)),
    "short": (_sine(10.0, _PEAK, 2500), _sine(100.0, _PEAK, 2500), _sine(10.0, 50.0, 2500), _step(0.3, 0.15)),
}


# ---- The actuator


def _rates(values: Values) -> Callable[..., tuple[float, ...]]:
    """Return the right-hand side: the rates of ``q, v, Q_1, Q_2, s, V, y`` at a time and a state.

    With the relaxing displacement ``s`` of creep, the amplifier's voltage ``V`` and the sensor's reading ``y``; the
    last two stay zero where there is no lag.
    """
    p = {**NEUTRAL, **values}
    m, k, b, alpha, c_1, c_2, rho_1, rho_2, d_1, d_2 = (p[n] for n in TABLE)
    k_s, tau_s, kappa_3, friction, v_s, drag, leak, kappa_d, epsilon, tau_v, v_max, tau_y, *_ = (p[n] for n in NEUTRAL)
    tanh = math.tanh

    def rates(t: float, x: Array, command: Callable[[float], float]) -> tuple[float, ...]:
        q, v, q_1, q_2, s, voltage, y = x.tolist()
        u = command(t)
        lagging = 0.0
        if tau_v > 0.0:
            lagging = (u - voltage) / tau_v
            u = voltage
        u = min(max(u, -v_max), v_max)
        e_1, e_2 = q_1 / c_1, q_2 / c_2
        # Dead zones of eq. (2); asymmetry: their width follows the displacement.
        half = 0.5 * max(0.0, 1.0 + kappa_d * q / _Q_0)
        over_1, over_2 = abs(e_1) - half * d_1, abs(e_2) - half * d_2
        slip_1 = math.copysign(rho_1 * over_1, e_1) if over_1 > 0.0 else 0.0
        slip_2 = math.copysign(rho_2 * over_2, e_2) if over_2 > 0.0 else 0.0
        force = alpha * (u * (1.0 + 0.5 * epsilon * u) - e_1 - e_2) - k * q * (1.0 + kappa_3 * (q / _Q_0) ** 2) - b * v
        force -= friction * tanh(v / v_s) + drag * abs(v) * v + k_s * s
        return (
            v, force / m, alpha * v - slip_1 - leak * e_1, alpha * v - slip_2 - leak * e_2, v - s / tau_s, lagging,
            (q - y) / tau_y if tau_y > 0.0 else 0.0,
        )  # fmt: skip

    return rates


def simulate(values: Values, drive: Drive) -> Array:
    """Simulate an actuator from rest; returns what an ideal sensor reads, (samples,), m.

    Args:
        values: the parameters of `TABLE`, and those of `NEUTRAL` that are not neutral.
        drive: the voltage; LSODA starts again where it jumps.

    Raises:
        SolverFailed: LSODA gave up.
    """
    rates, t, x = _rates(values), drive.t, np.zeros(_SIZES.size)
    paths = []
    ends = (*(first for first, _ in drive.pieces[1:]), drive.samples - 1)
    for (first, voltage), end in zip(drive.pieces, ends, strict=True):
        with warnings.catch_warnings():
            warnings.simplefilter("error", ODEintWarning)
            try:
                path = odeint(
                    rates, x, t[first : end + 1], args=(voltage,), rtol=_RELATIVE, atol=1e-2 * _RELATIVE * _SIZES,
                    mxstep=100_000, tfirst=True,
                )  # fmt: skip
            except ODEintWarning as warning:
                raise SolverFailed(f"{drive.name}: LSODA stopped ({warning}): choose another seed") from warning
        paths.append(path[:-1])
        x = path[-1]
    states: Array = np.concatenate([*paths, x[None]])
    return states[:, 6 if values.get("tau_y", 0.0) > 0.0 else 0]


def _simulate_all(values: Values, plan: Sequence[Drive]) -> list[Array]:
    """Simulate every recording; the mains, where they are picked up, stand at another phase in each."""
    p = {**NEUTRAL, **values}
    lines = [
        p["A_m"] * np.sin(2.0 * math.pi * p["f_m"] * drive.t + p["phi_m"] + _GOLDEN * i) for i, drive in enumerate(plan)
    ]
    return [simulate(values, drive) + line for drive, line in zip(plan, lines, strict=True)]


def _draw_base(rng: Rng) -> dict[str, float]:
    """Draw parameters around Table 1 such that both hysterons slip, so that slopes and widths can be identified."""
    while True:
        base = {name: value * float(rng.uniform(1.0 - _SPREAD, 1.0 + _SPREAD)) for name, value in TABLE.items()}
        stiffness = base["k"] + base["alpha"] ** 2 * (1.0 / base["C_1"] + 1.0 / base["C_2"])
        # At the largest voltage, if no hysteron slipped.
        charge = base["alpha"] * (base["alpha"] * _PEAK / stiffness)
        if all(charge / base[f"C_{i}"] > _SLIPS * 0.5 * base[f"d_{i}"] for i in (1, 2)):
            return base


# ---- The effects: each draws its shape and returns the law of its strength, which vanishes with it


def _log_uniform(rng: Rng, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def _creep(rng: Rng) -> Law:
    tau = _log_uniform(rng, 0.05, 0.5)
    return lambda z: {"k_s": z * TABLE["k"], "tau_s": tau}


def _mains_pickup(rng: Rng) -> Law:
    frequency, phase = float(rng.choice([50.0, 60.0])), float(rng.uniform(0.0, 2.0 * math.pi))
    return lambda z: {"A_m": z * _Q_0, "f_m": frequency, "phi_m": phase}


@dataclass(frozen=True)
class _Effect:
    """Attributes:
    location: where it acts, as a diagnosis calls it.
    law: draws a shape; the law's strength is a number without a unit.
    guess: strength with which the search begins.
    """

    location: str
    law: Callable[[Rng], Law]
    guess: float = 0.01


def _plain(name: str, unit: float = 1.0) -> Callable[[Rng], Law]:
    """Return the draw of an effect without a shape: one parameter in units of ``unit``."""
    return lambda rng: lambda z: {name: z * unit}


def _signed(name: str, unit: float = 1.0) -> Callable[[Rng], Law]:
    """Return the same with a sign that is drawn."""
    return lambda rng: _plain(name, float(rng.choice([-unit, unit])))(rng)


_EFFECTS = {
    "creep": _Effect("mechanical", _creep),
    "cubic_stiffness": _Effect("mechanical", _plain("kappa_3")),
    "coulomb_friction": _Effect("mechanical", _plain("F_c", TABLE["alpha"] * _PEAK)),
    "quadratic_drag": _Effect("mechanical", _plain("c_2", 1e3)),
    "charge_leakage": _Effect("electrical", _plain("G", 1e-4)),
    "hysteresis_asymmetry": _Effect("hysteron", _signed("kappa_d")),
    "electrostriction": _Effect("coupling", _signed("epsilon", 1.0 / _PEAK)),
    "amplifier_lowpass": _Effect("amplifier", _plain("tau_V", 1e-3)),
    "amplifier_saturation": _Effect("amplifier", lambda rng: lambda z: {"V_max": _PEAK * (1.0 - min(z, 0.6))}, 0.05),
    "sensor_lag": _Effect("sensor", _plain("tau_y", 1e-3)),
    "mains_pickup": _Effect("environment", _mains_pickup),
}
EFFECTS = tuple(_EFFECTS)


# ---- The strength


def _stacked(paths: Sequence[Array]) -> Array:
    """Join recordings, each without its mean: a refit moves the zero of each."""
    return np.concatenate([path - path.mean() for path in paths])


def _refit(base: Values, plan: Sequence[Drive]) -> Callable[[Sequence[Array]], float]:
    """Return what a refit of the base model to changed outputs would leave [m, root mean square], by one linear step.

    Each base parameter but the mass, which only scales the others, is moved by a thousandth: the differences span
    what a refit can take.
    """
    at_rest = _stacked(_simulate_all(base, plan))
    moved = [{**base, name: base[name] * (1.0 + _AHEAD)} for name in TABLE if name != "m"]
    columns = np.stack([_stacked(_simulate_all(p, plan)) - at_rest for p in moved], axis=1)
    basis = np.linalg.qr(columns / np.linalg.norm(columns, axis=0))[0]

    def residual(outputs: Sequence[Array]) -> float:
        change = _stacked(outputs) - at_rest
        rest = change - basis @ (basis.T @ change)
        return float(np.sqrt(np.mean(rest**2)))

    return residual


def _scaled(law: Law, guess: float, wanted: float, base: Values, plan: Sequence[Drive]) -> _Chosen:
    """Scale the strength until the residual is what is wanted [m], within a tenth.

    Each round multiplies it by (wanted/residual)^0.7: most effects grow linearly with their strength, those with a
    threshold up to quadratically, and this converges for both.

    Raises:
        SolverFailed: it did not converge.
    """
    strength, residual = guess, _refit(base, plan)
    for _ in range(_ROUNDS):
        parameters = law(strength)
        outputs = _simulate_all({**base, **parameters}, plan)
        misfit = residual(outputs)
        if abs(misfit / wanted - 1.0) < _CLOSE:
            return parameters, outputs, misfit
        strength *= min(max((wanted / max(misfit, 1e-12)) ** _POWER, 0.1), 10.0)
    raise SolverFailed(f"no strength of {law(guess)} leaves {1e9 * wanted:.3g} nm: choose another seed")


# ---- The recordings and the seal


@dataclass(frozen=True)
class Sealed:
    """The answer.

    Attributes:
        effect: name of what is concealed, or "none"; location: where it acts, empty for none.
        parameters: of the effect, SI.
        base: parameters of the actuator, SI.
        strength_over_noise: root mean square of what a linear refit of the base model leaves of the effect, over the
            standard deviation of the noise.
        noise: standard deviation of the added noise, m.
        quantisation: least step of the displacement, m.
        seed, plan: what everything follows from.
    """

    effect: str
    location: str
    parameters: Mapping[str, float]
    base: Mapping[str, float]
    strength_over_noise: float
    noise: float
    quantisation: float
    seed: int
    plan: str


@dataclass(frozen=True)
class Made:
    """Attributes:
    files: content of the files of a folder of recordings, by name; none of them tells the effect.
    sealed: the answer.
    """

    files: Mapping[str, bytes]
    sealed: Sealed


def make(seed: int, effect: str | None = None, plan: str = "demo") -> Made:
    """Draw an actuator, an effect and its strength, simulate, and add what a sensor adds.

    Args:
        seed: everything follows from it, 0 or more.
        effect: one of `EFFECTS`, or "none"; drawn if left out.
        plan: one of `PLANS`: "demo" has 11 recordings, "short" has 4.

    Raises:
        InputRefused: an unknown effect or plan, or a negative seed.
        SolverFailed: the simulation failed.
    """
    if effect not in (None, "none", *EFFECTS):
        raise InputRefused(f"no effect called {effect!r} to conceal: take none or one of {', '.join(EFFECTS)}")
    if plan not in PLANS:
        raise InputRefused(f"no plan called {plan!r}: take one of {', '.join(PLANS)}")
    if seed < 0:
        raise InputRefused(f"seed = {seed}: give a whole number, 0 or more")
    # The noise has a stream of its own: it stays the same whatever effect a seed is told to conceal.
    choices, sensor = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
    drawn, base, drives = str(choices.choice(EFFECTS)), _draw_base(choices), PLANS[plan]
    noise, step = float(choices.uniform(*_NOISES)), int(choices.integers(_STEPS_NM[0], _STEPS_NM[1] + 1)) * 1e-9
    wanted = _log_uniform(choices, *_TARGETS) * noise
    name, location = effect or drawn, ""
    if name == "none":
        chosen: _Chosen = {}, _simulate_all(base, drives), 0.0
    else:
        location, law = _EFFECTS[name].location, _EFFECTS[name].law(choices)
        chosen = _scaled(law, _EFFECTS[name].guess, wanted, base, drives)
    parameters, outputs, residual = chosen
    files = {
        f"{drive.name}.csv": _csv(drive, _read(q, noise, step, sensor))
        for drive, q in zip(drives, outputs, strict=True)
    }
    files["recordings.yaml"] = _manifest(base["m"], drives)
    return Made(files, Sealed(name, location, parameters, base, residual / noise, noise, step, seed, plan))


def generate(seed: int, folder: Path, effect: str | None = None, plan: str = "demo") -> Sealed:
    """Write the recordings of `make` into a folder; returns the answer.

    Raises:
        InputRefused: see `make`.
        SolverFailed: the simulation failed.
    """
    made = make(seed, effect, plan)
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in made.files.items():
        (folder / name).write_bytes(content)
    return made.sealed


def _read(q: Array, noise: float, step: float, rng: Rng) -> Array:
    """Return what the sensor reads: its zero, white noise, its least step."""
    y = q + rng.uniform(-_ZERO, _ZERO) + noise * rng.standard_normal(q.size)
    return np.asarray(np.round(y / step) * step)


def _csv(drive: Drive, y: Array) -> bytes:
    """Write times, voltages and displacements; the sensor's least step is a whole number of nanometres."""
    text = io.StringIO()
    table = np.column_stack([drive.t, drive.u, 1e6 * y])
    np.savetxt(text, table, ["%.12g", "%.12g", "%.3f"], ",", header="time_s,voltage_V,displacement_um", comments="")
    return text.getvalue().encode()


def _manifest(mass: float, plan: Sequence[Drive]) -> bytes:
    """State what a person would know of the recordings: their starts, and the weighed mass."""
    recordings = [
        {"file": f"{drive.name}.csv", "name": drive.name, "start": {"state": "rest", "input_before": 0.0}}
        | ({"input": "zero_order"} if len(drive.pieces) > 1 else {})
        for drive in plan
    ]
    stated = {
        "setup": {"model": "piezo_actuator", "hysterons": 2},
        "known": {"m": {"value": mass, "std": float(f"{_WEIGHED * mass:.3g}")}},
        "voltage": "command",
        "recordings": recordings,
    }
    return yaml.safe_dump(stated, sort_keys=False).encode()


def seal(sealed: Sealed) -> tuple[bytes, str]:
    """Return the answer as json, and its SHA-256: printed now, it proves later that the answer was not changed."""
    data = (json.dumps(asdict(sealed), indent=2, sort_keys=True, allow_nan=False) + "\n").encode()
    return data, hashlib.sha256(data).hexdigest()


def open_seal(path: Path, digest: str) -> Sealed:
    """Read the answer back.

    Args:
        path: a file with what `seal` returned.
        digest: its SHA-256.

    Raises:
        InputRefused: the file is absent, was changed, or is no sealed answer.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputRefused(f"{path}: cannot be read ({error.strerror}): run the demonstration again") from error
    if hashlib.sha256(data).hexdigest() != digest:
        raise InputRefused(f"{path}: was changed after it was sealed: run the demonstration again")
    content = json.loads(data)
    if not isinstance(content, dict) or set(content) != {f.name for f in fields(Sealed)}:
        raise InputRefused(f"{path}: is no sealed answer, which has {', '.join(f.name for f in fields(Sealed))}")
    return Sealed(**content)
