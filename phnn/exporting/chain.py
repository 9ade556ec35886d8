"""Amplifier and sensor blocks as functions of an exported program, a step at a time.

Blocks without a memory are translated from `phnn.chain` as they are. Of those with a state the package has the step of
half a sub-step, which is translated; only what carries it from point to point stands here.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from phnn.chain import AMPLIFIERS, MEMORYLESS, REMEMBERING, SENSORS, SOURCES
from phnn.chain.amplifiers import (
    bouc_wen_step,
    first_order_step,
    first_order_weights,
    parabola,
    second_order_step,
    second_order_weights,
    slew_step,
)
from phnn.exporting.laws import Elements, refuse
from phnn.setup import Block, Setup, Source

_LOOKS_AHEAD = "it needs the output after the instant that it is asked for"
_POINTS = ("u_start", "u_middle", "u_end")
# Longest delay in steps: the state holds as many rows of the input.
_LONGEST = 10000
# A delayed point this close to the end of a step, in steps, counts as on it.
_ROUNDED = 1e-9


class Chain:
    """Writes the lines by which an input becomes the voltage at the port, and a state the output.

    Attributes:
        begin: lines of ``init``: from the constant command ``u`` to the voltage at rest, in the same variable.
        step: lines of ``substep``: from the command at start, middle and end of the step to the voltage there.
        output: lines of ``output``: from the network's output ``y`` to the recorded one.
    """

    def __init__(self, elements: Elements, setup: Setup, h: float, hold: str) -> None:
        self.e, self.h, self.hold = elements, h, hold
        self.begin: list[str] = []
        self.step: list[str] = []
        self.output: list[str] = []
        dynamic: dict[str, Callable[[Block, str], None]] = {
            "lowpass": self._lowpass, "second_order_lowpass": self._second_order, "slew_limit": self._slew,
            "bouc_wen": self._bouc_wen, "delay": self._delay,
        }  # fmt: skip
        for k, block in enumerate(setup.amplifier):
            what = f"amplifier {block.kind}"
            if block.kind in MEMORYLESS:
                for lines, points in ((self.begin, ("u",)), (self.step, _POINTS)):
                    lines += [f"{u} = {self._static(AMPLIFIERS, block, what, u, '0.0', '0.0')}" for u in points]
            elif block.kind in dynamic:
                dynamic[block.kind](block, f"{block.kind}_{k + 1}")
            else:
                raise refuse(what, "it has no step of its own", "export a model without it")
        for block in setup.sensor:
            what = f"sensor {block.kind}"
            if block.kind in REMEMBERING:
                raise refuse(
                    what, _LOOKS_AHEAD, "leave the sensor out (--no-sensor), the output is then what it senses"
                )
            time = "s.count * H"
            self.e.program.state("count", "steps since the start")
            self.output.append(f"y = {self._static(SENSORS, block, what, 'y', time)}")

    def source(self, source: Source) -> str:
        """The mean of a source over a step, by Simpson's rule; it begins with the first step."""
        what = f"source {source.kind}"
        self.e.program.state("count", "steps since the start")
        values = [self._static(SOURCES, source, what, f"(s.count + {at}) * H") for at in ("0.0", "0.5", "1.0")]
        return f"({values[0]} + 4.0 * {values[1]} + {values[2]}) / 6.0"

    def _static(self, kinds: dict, block: Block | Source, what: str, *leading: str) -> str:
        return self.e.call(kinds[block.kind], what, *leading, *(self.e.parameter(n) for n in block.parameters))

    def _weights(self, key: str, names: tuple[str, ...], values: tuple[np.ndarray, ...]) -> list[str]:
        about = f"weight of {key.rpartition('_')[0]} over half a step"
        return [self.e.derived(f"{key}_{n}", float(v[0]), about) for n, v in zip(names, values, strict=True)]

    def _lowpass(self, block: Block, key: str) -> None:
        state = self.e.program.state(key, "output of the amplifier's low-pass")
        found = first_order_weights(np.array([self.h]), *self.e.values(block.parameters))
        weights = self._weights(key, ("keep", "old", "new"), found)
        self._follow(state, lambda a, b: self.e.call(first_order_step, key, state, a, b, *weights))

    def _slew(self, block: Block, key: str) -> None:
        state = self.e.program.state(key, "output of the slew-rate limit")
        reach = f"0.5 * H * {self.e.parameter(block.parameters[0])}"
        self._follow(state, lambda a, b: self.e.call(slew_step, key, state, b, reach))

    def _follow(self, state: str, stepped: Callable[[str, str], str]) -> None:
        """A block whose state is its output, in equilibrium equal to its input."""
        self.begin.append(f"{state} = u")
        self.step += [
            f"v_start = {state}",
            f"{state} = {stepped('u_start', 'u_middle')}",
            f"v_middle = {state}",
            f"{state} = {stepped('u_middle', 'u_end')}",
            "u_start = v_start",
            "u_middle = v_middle",
            f"u_end = {state}",
        ]

    def _second_order(self, block: Block, key: str) -> None:
        state = self.e.program.state(key, "output of the amplifier's low-pass")
        rate = self.e.program.state(f"{key}_rate", "and its derivative by the time in units of tau")
        tau, zeta = self.e.values(block.parameters)
        found = second_order_weights(np.array([self.h]), tau, zeta)
        s, *weights = self._weights(key, ("s", "even", "odd"), found)
        damping = self.e.parameter(block.parameters[1])
        self.begin += [f"{state} = u", f"{rate} = 0.0"]
        self.step.append(f"v_start = {state}")
        for a, b in (("u_start", "u_middle"), ("u_middle", "u_end")):
            slope = f"({b} - {a}) / {s}"
            moved = self.e.call(second_order_step, key, f"{state} - {a}", rate, slope, *weights, damping)
            self.step += [f"v_off, {rate} = {moved}", f"{state} = {b} + v_off"]
            self.step += [f"v_middle = {state}"] if b == "u_middle" else []
        self.step += ["u_start = v_start", "u_middle = v_middle", f"u_end = {state}"]

    def _bouc_wen(self, block: Block, key: str) -> None:
        last = self.e.program.state(f"{key}_last", "last input of the Bouc-Wen hysteresis")
        state = self.e.program.state(key, "state of the Bouc-Wen hysteresis")
        *shape, weight = (self.e.parameter(n) for n in block.parameters)
        self.begin += [f"{last} = u", f"{state} = 0.0"]
        for u in _POINTS:
            self.step += [
                f"{state} = {self.e.call(bouc_wen_step, key, state, f'{u} - {last}', *shape)}",
                f"{last} = {u}",
                f"{u} = {u} - {weight} * {state}",
            ]

    def _delay(self, block: Block, key: str) -> None:
        """A ring of rows, each the input at start, middle and end of a step, read at the point ``τ`` ago."""
        if self.hold == "zero_order":
            raise refuse(
                "amplifier delay",
                "an input that jumps at every sample has no parabola",
                "take --input linear and a target other than fmu",
            )
        steps = self.e.values(block.parameters)[0] / self.h
        whole = math.floor(steps)
        if whole > _LONGEST:
            raise refuse("amplifier delay", f"it lasts {whole} steps, at most {_LONGEST} are kept", "take larger steps")
        rows = whole + 2
        ring = self.e.program.state(f"{key}_rows", "input at start, middle and end of past steps", (rows, 3))
        at = self.e.program.state(f"{key}_at", "row of the present step", index=True)
        self.begin += [f"for i in range({rows}):", *(f"    {ring}[i][{k}] = u" for k in range(3)), f"{at} = 0"]
        self.step += [f"{ring}[{at}][{k}] = {u}" for k, u in enumerate(_POINTS)]
        for k, u in enumerate(_POINTS):
            # Points of the present step lie ``steps − k/2`` before its start.
            back = max(math.ceil(steps - 0.5 * k - _ROUNDED), 0)
            share = self.e.derived(
                f"{key}_share_{k}", back - (steps - 0.5 * k), "place within the delayed step, 0 to 1"
            )
            row = f"{key}_{k}"
            self.step += [f"{row} = {at} - {back}", f"if {row} < 0:", f"    {row} = {row} + {rows}"]
            entries = (f"{ring}[{row}][{i}]" for i in range(3))
            self.step.append(f"{u}, unused = {self.e.call(parabola, key, *entries, share)}")
        self.step += [f"{at} = {at} + 1", f"if {at} >= {rows}:", f"    {at} = 0"]
