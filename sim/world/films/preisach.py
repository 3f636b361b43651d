"""A Preisach film: relays with their own switching temperatures, none of which a play operator describes.

    y = offset + decades * (share of relays that are metallic) + D(T)
    relay i turns metallic when T >= mean_i + halfwidth_i, insulating when T <= mean_i - halfwidth_i

With means normal about the transition and half-widths lognormal the density on the Preisach plane is bell-shaped;
a (generalized) Prandtl-Ishlinskii model holds only densities that are products of one-sided functions.
Source: I. Mayergoyz, Mathematical Models of Hysteresis (Springer 1991), ch. 1. The sizes are a choice: VO2 films
switch near 61 .. 68 degC with loops some K wide.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from compensator.hysteresis.film import Memoryless
from compensator.hysteresis.functions import Array, memoryless

States = NDArray[np.uint8]


@njit(cache=True)
def _switch(v: float, up: Array, down: Array, states: States) -> int:
    """Move the relays to the temperature v, in place; returns how many are metallic."""
    total = 0
    for i in range(up.size):
        state = states[i]
        if v >= up[i]:
            state = 1
        elif v <= down[i]:
            state = 0
        states[i] = state
        total += state
    return total


@njit(cache=True)
def _run(
    inputs: Array, up: Array, down: Array, states: States, code: int, par: Array, decades: float, out: Array
) -> None:
    for k in range(inputs.size):
        total = _switch(inputs[k], up, down, states)
        out[k] = decades * total / up.size + memoryless(code, par, inputs[k])[0]


@dataclass(frozen=True, eq=False)
class PreisachFilm:
    """Relays' switching temperatures (degC), shape (relays,); decades they switch; D(T) with the offset in it."""

    up_degC: Array
    down_degC: Array
    decades: float
    memoryless: Memoryless

    @classmethod
    def bell_shaped(
        cls,
        seed: int,
        relays: int = 4000,
        mean_degC: float = 61.0,
        spread_K: float = 3.2,
        halfwidth_K: float = 2.8,
        halfwidth_sigma: float = 0.4,
        decades: float = 1.5,
        memoryless: Memoryless | None = None,
    ) -> PreisachFilm:
        """Means normal, half-widths lognormal (median halfwidth_K): a density that is bell-shaped."""
        random = np.random.default_rng(seed)
        mean = random.normal(mean_degC, spread_K, relays)
        half = random.lognormal(np.log(halfwidth_K), halfwidth_sigma, relays)
        return cls(mean + half, mean - half, decades, memoryless or Memoryless(offset=-5.0))

    def initial_memory(self, input_degC: float, initial: str = "cooled") -> States:
        """Relays at a temperature that was reached from the hot end ("cooled") or the cold end ("heated")."""
        threshold = self.down_degC if initial == "cooled" else self.up_degC
        return (input_degC >= threshold).astype(np.uint8)

    def simulate(self, inputs_degC: ArrayLike, memory: States) -> tuple[Array, States]:
        """Outputs -log10(R / 1 ohm) for a sequence of temperatures, and the relays after the last."""
        inputs = np.ascontiguousarray(inputs_degC, dtype=np.float64)
        outputs, states = np.empty(inputs.size), memory.copy()
        d = self.memoryless
        _run(inputs, self.up_degC, self.down_degC, states, d.code, d.array(), self.decades, outputs)
        return outputs, states

    def step(self, input_degC: float, memory: States) -> tuple[float, States]:
        """One sample."""
        outputs, memory = self.simulate(np.array([input_degC]), memory)
        return float(outputs[0]), memory
