"""Films of a simulated rig that are no sum of play operators, or whose resistance rises.

A Preisach film is made of relays with their own switching temperatures, none of which a play operator describes.

    y = offset + decades * (share of relays that are metallic) + D(T)
    relay i turns metallic when T >= mean_i + halfwidth_i, insulating when T <= mean_i - halfwidth_i

With means normal about the transition and half-widths lognormal the density on the Preisach plane is bell-shaped;
a (generalized) Prandtl-Ishlinskii model holds only densities that are products of one-sided functions.
Source: I. Mayergoyz, Mathematical Models of Hysteresis (Springer 1991), ch. 1. The sizes are a choice: VO2 films
switch near 61 .. 68 degC with loops some K wide.

A film has some 1e8 grains, and its loop is smooth. Relays drawn at random have gaps and heaps: 4,000 of them over two
decades are 5e-3 decades off the smooth loop, which a diagnosis rightly finds in a record with a noise of 1e-3. So they
stand on a sequence of low discrepancy, the seed shifts it: 16,000 relays are 4e-4 decades off.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri

from compensator.compiled import njit
from compensator.hysteresis.film import FilmModel, Memoryless
from compensator.hysteresis.functions import Array, memoryless

States = NDArray[np.uint8]
RELAYS = 16_000  # a loop over two decades is then smooth to 4e-4 decades, below the noise of a usual meter
PLASTIC = 1.324717957244746  # x^3 = x + 1: its powers are the two steps of the sequence that cover a square most evenly


class RelayMemory(NamedTuple):
    """metallic: which relays are, in the order of `PreisachFilm.up_degC`, (relays,); input_degC: where they are so."""

    metallic: States
    input_degC: float


@njit
def _run(
    inputs: Array,
    up: Array,
    down: Array,
    places: NDArray[np.int64],
    states: States,
    before: float,
    code: int,
    par: Array,
    decades: float,
    out: Array,
) -> None:
    """Outputs, and the states in place. up, down: thresholds in rising order, places: of those going down among those
    going up. before: the temperature at which the states are so; only relays between two temperatures are looked at."""
    total = 0
    for i in range(states.size):
        total += states[i]
    for k in range(inputs.size):
        v = inputs[k]
        if v > before:
            for i in range(np.searchsorted(up, before, side="right"), np.searchsorted(up, v, side="right")):
                total += 1 - states[i]
                states[i] = 1
        elif v < before:
            for i in range(np.searchsorted(down, v, side="left"), np.searchsorted(down, before, side="left")):
                total -= states[places[i]]
                states[places[i]] = 0
        before = v
        out[k] = decades * total / up.size + memoryless(code, par, v)[0]


@dataclass(frozen=True, eq=False)
class PreisachFilm:
    """Relays' switching temperatures (degC), shape (relays,), those going up in rising order; decades that they switch;
    D(T) with the offset in it."""

    up_degC: Array
    down_degC: Array
    decades: float
    memoryless: Memoryless
    _order: NDArray[np.int64] = field(init=False, repr=False)
    _falling: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if np.any(np.diff(self.up_degC) < 0.0):
            order = np.argsort(self.up_degC, kind="stable")
            object.__setattr__(self, "up_degC", self.up_degC[order])
            object.__setattr__(self, "down_degC", self.down_degC[order])
        object.__setattr__(self, "_order", np.argsort(self.down_degC, kind="stable"))
        object.__setattr__(self, "_falling", self.down_degC[self._order])

    @classmethod
    def bell_shaped(
        cls,
        seed: int,
        relays: int = RELAYS,
        mean_degC: float = 61.0,
        spread_K: float = 3.2,
        halfwidth_K: float = 2.8,
        halfwidth_sigma: float = 0.4,
        decades: float = 1.5,
        memoryless: Memoryless | None = None,
    ) -> PreisachFilm:
        """Return a film whose means are normal, half-widths lognormal (median halfwidth_K): a bell-shaped density.
        seed: of the places of the relays (an additive recurrence of two steps, its shift drawn)."""
        first, second = np.random.default_rng(seed).random(2)
        steps = np.arange(relays) + 0.5
        mean = mean_degC + spread_K * ndtri((first + steps / PLASTIC) % 1.0)
        half = halfwidth_K * np.exp(halfwidth_sigma * ndtri((second + steps / PLASTIC**2) % 1.0))
        return cls(mean + half, mean - half, decades, memoryless or Memoryless(offset=-5.0))

    def initial_memory(self, input_degC: float, initial: str = "cooled") -> RelayMemory:
        """Return relays at a temperature that was reached from the hot end ("cooled") or the cold end ("heated")."""
        metallic = input_degC > self.down_degC if initial == "cooled" else input_degC >= self.up_degC
        return RelayMemory(metallic.astype(np.uint8), float(input_degC))

    def simulate(self, inputs_degC: ArrayLike, memory: RelayMemory) -> tuple[Array, RelayMemory]:
        """Return outputs -log10(R / 1 ohm) for a sequence of temperatures, and the relays after the last."""
        inputs = np.ascontiguousarray(inputs_degC, dtype=np.float64)
        outputs, states = np.empty(inputs.size), memory.metallic.copy()
        d = self.memoryless
        own = (self.up_degC, self._falling, self._order, states, memory.input_degC)
        _run(inputs, *own, d.code, d.array(), self.decades, outputs)
        return outputs, RelayMemory(states, float(inputs[-1]) if inputs.size else memory.input_degC)

    def step(self, input_degC: float, memory: RelayMemory) -> tuple[float, RelayMemory]:
        outputs, memory = self.simulate(np.array([input_degC]), memory)
        return float(outputs[0]), memory


@dataclass(frozen=True, eq=False)
class RisingFilm:
    """A film whose resistance rises as it is heated: -log10(R / 1 ohm) of a model of log10(R / 1 ohm), as
    `sim.model.film_side.Film` asks for it."""

    model: FilmModel

    @property
    def memoryless(self) -> Memoryless:
        """Its D(T) in -log10(R / 1 ohm)."""
        d = self.model.memoryless
        coefficients = tuple(-c for c in d.coefficients)
        return replace(d, amplitude=-d.amplitude, offset=-d.offset, coefficients=coefficients)

    def simulate(self, inputs_degC: Any, memory: Any) -> tuple[Any, Any]:
        """Return -log10 R over temperatures, and the memory after the last."""
        outputs, after = self.model.simulate(inputs_degC, memory)
        return -outputs, after

    def step(self, input_degC: float, memory: Any) -> tuple[float, Any]:
        output, after = self.model.step(input_degC, memory)
        return -output, after

    def initial_memory(self, input_degC: float, initial: Any = None) -> Any:
        return self.model.initial_memory(input_degC, initial)


def film_of_world(model: FilmModel) -> FilmModel | RisingFilm:
    """Return the film whose output a simulated meter reads: -log10 of a resistance, or any other quantity as it is."""
    return RisingFilm(model) if model.output == "log10_ohm" else model
