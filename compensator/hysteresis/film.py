"""The extended generalized Prandtl-Ishlinskii model of a film: parameters and memory as separate objects.

    u(t) = D(v(t)) + sum_j p_j F_rj^gamma[v](t)            paper eq (9)

v is the temperature in degC, u the output, for a film -log10(R / 1 ohm). `FilmModel` never changes; `Memory` is
what the film remembers: the last temperature and each operator's position. A step takes a memory and gives a new
one, so a trial step costs nothing and a record can be replayed exactly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike

from compensator.hysteresis import play
from compensator.hysteresis.functions import (
    ENVELOPE_CODES,
    MEMORYLESS_CODES,
    Array,
    envelope_limits,
    envelope_value,
    envelope_values,
)

Packed = tuple[Array, Array, Array, int, Array]  # (envelopes, radii, weights, code of D, parameters of D)
Initial = Literal["cooled", "heated"]
# Of the sum of the weights: far below any ohmmeter's noise. An identification looks for the least allowed radius where
# the transition is; far out in the tails of two tanh of unlike slope one wall may still be above the other by less.
LEAST_JUMP: Final = 1e-6
KINDS = ("extended_generalized_pi", "generalized_pi", "classical_pi", "mixed_envelopes")


def writable(values: ArrayLike) -> Array:
    """Return values as a contiguous, writable array: compiled loops take a read-only one for another type."""
    array = np.ascontiguousarray(values, dtype=np.float64)
    return array if array.flags.writeable else array.copy()


@dataclass(frozen=True)
class Envelope:
    """Envelope gamma(v) = f(a v + b) of play operators, increasing in v (degC): paper eqs (28), (29). `a`: 1/K, > 0."""

    function: str
    a: float
    b: float

    def __post_init__(self) -> None:
        if self.function not in ENVELOPE_CODES:
            raise ValueError(f"function: {self.function!r} is none of {', '.join(ENVELOPE_CODES)}")
        if not (self.a > 0.0 and np.isfinite(self.a) and np.isfinite(self.b)):
            raise ValueError(f"a: {self.a!r}, b: {self.b!r}: expected a finite and > 0 (increasing), b finite")

    def row(self) -> tuple[float, float, float]:
        """Return the envelope as the compiled loops take it: (code, a, b)."""
        return float(ENVELOPE_CODES[self.function]), self.a, self.b


IDENTITY = Envelope("linear", 1.0, 0.0)


@dataclass(frozen=True)
class Memoryless:
    """Memoryless part D(v), output's unit, in a form of `compensator.hysteresis.functions`: paper eqs (30), (31)."""

    function: str = "none"
    amplitude: float = 0.0
    a: float = 1.0
    b: float = 0.0
    offset: float = 0.0
    coefficients: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.function not in MEMORYLESS_CODES:
            raise ValueError(f"function: {self.function!r} is none of {', '.join(MEMORYLESS_CODES)}")
        if not np.all(np.isfinite([self.amplitude, self.a, self.b, self.offset, *self.coefficients])):
            raise ValueError("amplitude, a, b, offset, coefficients: expected finite numbers")

    @property
    def code(self) -> int:
        """Return the number of the function in the compiled loops."""
        return MEMORYLESS_CODES[self.function]

    def array(self) -> Array:
        """Return the parameters as the compiled loops take them: (amplitude, a, b, offset, c_0, c_1, ...)."""
        coefficients = self.coefficients
        if self.function == "polynomial" and not coefficients:
            coefficients = (0.0,)
        return np.array([self.amplitude, self.a, self.b, self.offset, *coefficients], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Memory:
    """Memory of a film: the last input (degC) and each play operator's output w_j, shape (operators,)."""

    input_degC: float
    plays: Array

    def __post_init__(self) -> None:
        plays = np.array(self.plays, dtype=np.float64)
        plays.setflags(write=False)
        object.__setattr__(self, "plays", plays)


def memory_owning(input_degC: float, plays: Array) -> Memory:
    """Return a memory around an array that nobody else keeps, without the copy that `Memory` makes."""
    plays.setflags(write=False)
    memory = object.__new__(Memory)
    memory.__dict__["input_degC"], memory.__dict__["plays"] = input_degC, plays
    return memory


@dataclass(frozen=True, eq=False)
class FilmModel:
    """Parameters of D(v) + sum_j p_j F_rj^gamma[v], paper eq (9).

    radii: r_j >= 0 in the unit of the envelopes' values, shape (operators,). weights: p_j >= 0 in the output's unit.
    rising, falling: one envelope for all operators, or (kind "mixed_envelopes") one for each.
    """

    radii: Array
    weights: Array
    rising: Envelope | tuple[Envelope, ...]
    falling: Envelope | tuple[Envelope, ...]
    memoryless: Memoryless = field(default_factory=Memoryless)
    kind: str = "extended_generalized_pi"
    output: str = "minus_log10_ohm"
    initial: Initial = "cooled"

    def __post_init__(self) -> None:
        for name in ("radii", "weights"):
            values = np.array(getattr(self, name), dtype=np.float64)
            if values.ndim != 1 or values.size == 0 or not np.all(np.isfinite(values)) or np.any(values < 0.0):
                raise ValueError(f"{name}: expected a list of finite numbers >= 0, at least one")
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        if self.radii.size != self.weights.size:
            raise ValueError(f"weights: {self.weights.size} numbers for {self.radii.size} radii")
        if self.kind not in KINDS:
            raise ValueError(f"kind: {self.kind!r} is none of {', '.join(KINDS)}")
        if self.initial not in ("cooled", "heated"):
            raise ValueError(f"initial: {self.initial!r}: expected 'cooled' or 'heated'")
        for name in ("rising", "falling"):
            envelopes = getattr(self, name)
            if isinstance(envelopes, tuple) and len(envelopes) != self.radii.size:
                raise ValueError(f"{name}: {len(envelopes)} envelopes for {self.radii.size} radii")
        if isinstance(self.rising, tuple) != isinstance(self.falling, tuple):
            raise ValueError("rising, falling: expected one envelope each for all operators, or one each for each")

    @property
    def operators(self) -> int:
        return int(self.radii.size)

    @cached_property
    def envelopes(self) -> Array:
        """Return rows (code_R, a_R, b_R, code_L, a_L, b_L): one for all operators, or one for each."""
        rising = self.rising if isinstance(self.rising, tuple) else (self.rising,)
        falling = self.falling if isinstance(self.falling, tuple) else (self.falling,)
        return np.array([r.row() + f.row() for r, f in zip(rising, falling, strict=True)], dtype=np.float64)

    @cached_property
    def memoryless_array(self) -> Array:
        """Return the parameters of D as the compiled loops take them."""
        return self.memoryless.array()

    @cached_property
    def packed(self) -> Packed:
        """Return the model as the compiled loops take it, always of the same array types: each compiles once."""
        return (
            self.envelopes,
            self.radii.copy(),
            self.weights.copy(),
            self.memoryless.code,
            self.memoryless_array,
        )

    def scaled(self, factor: float) -> FilmModel:
        """Return the same film with its output in a unit that is 1 / factor times as large; factor > 0."""
        if not 0.0 < factor < math.inf:
            raise ValueError(f"factor: {factor!r}: expected a finite number > 0")
        d = self.memoryless
        memoryless = replace(
            d,
            amplitude=factor * d.amplitude,
            offset=factor * d.offset,
            coefficients=tuple(factor * c for c in d.coefficients),
        )
        return replace(self, weights=factor * self.weights, memoryless=memoryless)

    def saturated(self, initial: Initial) -> Array:
        """Return each operator's output (may be infinite) after an input from +inf ("cooled") or -inf ("heated")."""
        rows = np.broadcast_to(self.envelopes, (self.operators, 6))
        if initial == "cooled":
            return np.array([envelope_limits(row[0], row[1])[1] for row in rows]) - self.radii
        return np.array([envelope_limits(row[3], row[4])[0] for row in rows]) + self.radii

    def initial_memory(self, input_degC: float, initial: Initial | None = None) -> Memory:
        """Return the memory at `input_degC` after cooling from the hot end or heating from the cold end."""
        initial = initial or self.initial
        rows = np.broadcast_to(self.envelopes, (self.operators, 6))
        saturated = self.saturated(initial)
        if initial == "cooled":
            gamma = np.array([envelope_value(row[3], row[4], row[5], input_degC) for row in rows])
            return Memory(input_degC, np.minimum(saturated, gamma + self.radii))
        gamma = np.array([envelope_value(row[0], row[1], row[2], input_degC) for row in rows])
        return Memory(input_degC, np.maximum(saturated, gamma - self.radii))

    def simulate(self, inputs_degC: ArrayLike, memory: Memory) -> tuple[Array, Memory]:
        """Return the outputs for a sequence of temperatures, shape (samples,), and the memory after the last.

        At a temperature of nan the output is nan and the film rests at the last known one.
        """
        inputs = writable(inputs_degC)
        outputs = np.empty(inputs.size)
        plays = memory.plays.copy()
        last_degC = play.run(inputs, memory.input_degC, plays, self.packed, outputs)
        return outputs, memory_owning(float(last_degC), plays)

    def step(self, input_degC: float, memory: Memory) -> tuple[float, Memory]:
        """Return the output and the memory after one sample: the same compiled loop as `simulate`, so the same bits."""
        outputs, memory = self.simulate(np.array([input_degC]), memory)
        return float(outputs[0]), memory

    def output_at(self, memory: Memory) -> float:
        """Return the output at the memory's own input."""
        return self.step(memory.input_degC, memory)[0]

    def play_outputs(self, inputs_degC: ArrayLike, memory: Memory) -> Array:
        """Return the output of each operator, shape (samples, operators)."""
        inputs = writable(inputs_degC)
        outputs = np.empty((inputs.size, self.operators))
        play.play_outputs(inputs, memory.input_degC, memory.plays.copy(), self.packed[0], self.packed[1], outputs)
        return outputs

    def order_margin(self, low_degC: float = -50.0, high_degC: float = 200.0) -> Array:
        """Return min over v of gamma_L(v) + r_j - (gamma_R(v) - r_j), shape (operators,).

        It is negative where the order condition (below paper eq (6)) fails and the output jumps at a reversal.
        """
        v = np.linspace(low_degC, high_degC, 20001)
        margins = np.empty(len(self.envelopes))
        for k, row in enumerate(self.envelopes):
            margins[k] = float(np.min(envelope_values(row[3:], v) - envelope_values(row[:3], v)))
        return np.broadcast_to(margins, (self.operators,)) + 2.0 * self.radii


def reversal_jumps(model: FilmModel, low_degC: float = -50.0, high_degC: float = 200.0) -> tuple[int, float]:
    """Return how many operators jump at a reversal, and the largest jump of the output, in its unit.

    Counted are operators of positive weight that violate gamma_R - r <= gamma_L + r between two temperatures; (0, 0.0)
    if the jump is too small to be measured.
    """
    by = model.weights * np.maximum(-model.order_margin(low_degC, high_degC), 0.0)
    jump = float(np.sum(by))
    if not jump > LEAST_JUMP * float(np.sum(model.weights)):
        return 0, 0.0
    return int(np.sum(by > 0.0)), jump
