"""The signal chain from the current in the plate to what both instruments show, taken from node to node.

    commanded current -> driver -> plate -> thermometer
                                   plate -> film -> ohmmeter

Parameters (`ChainModel`) and state (`ChainState`) are apart: a stretch of nodes takes a state and returns the next one.
Times are seconds since what drifts began to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from compensator.hysteresis.functions import Array
from compensator.thermal.plate import PlateModel, with_drive
from sim.effects.effect import Switched
from sim.model.film_side import Film, FilmSide, FilmState
from sim.model.links import Links, followed, links_of
from sim.model.plate_balance import heat_flows, run

NO_PLATE = PlateModel(1.0, 0.0, 0.0, 25.0)  # stands where the temperature is given
LONGEST_NODE_S = 0.02  # between nodes: what a lag makes of a plate's curved course is right to 1e-6 K


@dataclass(frozen=True, eq=False)
class ChainModel:
    """What is true of a rig, or believed: plate, film (None: no film is asked for) and effects, in any order."""

    plate: PlateModel
    film: Film | None = None
    effects: tuple[Switched, ...] = ()

    @cached_property
    def links(self) -> Links:
        """The effects in the chain's order. Raises ValueError for effects that clash."""
        return links_of(self.effects)


@dataclass(frozen=True, eq=False)
class Stretch:
    """The course over nodes, each of shape (nodes,): true temperatures in degC; own_output: -log10 of the film's own
    resistance (or whatever its output is); output: the same as it reaches the ohmmeter. nan without a film."""

    time_s: Array
    plate_degC: Array
    thermometer_degC: Array
    film_degC: Array
    own_output: Array
    output: Array


@dataclass(frozen=True, eq=False)
class ChainState:
    """The chain at a node. own_degC: temperatures of bodies on the plate's balance, (effects on the plate,);
    thermometer: where each of its filters is, (1,) each, nan: at rest; film: None without a film."""

    plate_degC: float
    own_degC: Array
    thermometer: tuple[Array, ...]
    film: FilmState | None


class Chain:
    """The equations of a `ChainModel`. It remembers nothing: see `ChainState`."""

    def __init__(self, model: ChainModel) -> None:
        """Raises ValueError for effects that clash."""
        self.model, self.links = model, model.links
        self._heat = heat_flows(self.links.plate)
        self._par = model.plate.numbers
        self._film = FilmSide(model.film, self.links) if model.film is not None else None

    def start(self, plate_degC: float, memory: Any = None, initial: str | None = None) -> ChainState:
        """Return the state as if all had been constant before, bodies on the plate's balance at the ambient. memory:
        the film's; None: the one that `initial` says (None: the film's default) at that temperature."""
        film = None
        if self._film is not None and self.model.film is not None:
            if memory is None:
                film_memory = self.model.film.initial_memory
                memory = film_memory(plate_degC) if initial is None else film_memory(plate_degC, initial)
            film = self._film.start(memory)
        own = np.full(self._heat.count, self.model.plate.ambient_degC)
        return ChainState(plate_degC, own, tuple(np.full(1, math.nan) for _ in self.links.thermometer), film)

    def nodes(self, from_s: float, to_s: float) -> Array:
        """Return times between which the course may be taken as straight."""
        count = math.ceil((to_s - from_s) / LONGEST_NODE_S - 1e-9) if self.links.fine else 1
        if count <= 1:
            return np.array((from_s, to_s))
        time = np.asarray(np.arange(count + 1), dtype=np.float64) * ((to_s - from_s) / count) + from_s
        time[-1] = to_s
        return time

    def advance(
        self, state: ChainState, time_s: Array, current_A: Array, test_current_A: Array
    ) -> tuple[Stretch, ChainState]:
        """Return the course from the state's node, time_s[0], to time_s[-1], and the state there.

        current_A: through the plate from each node on. test_current_A: through the film up to each node.
        """
        plate, _, state = self.heated(state, time_s, current_A)
        return self.measure(state, time_s, plate, test_current_A)

    def heated(
        self,
        state: ChainState,
        time_s: Array,
        current_A: Array,
        unknown_K_per_s: float = 0.0,
        drive_error: float = 0.0,
    ) -> tuple[Array, Array, ChainState]:
        """Return (plate's temperature at the nodes, its rates after and before each node in K/s, shape (nodes, 2),
        state with plate and bodies at the last node). unknown_K_per_s: heating of the plate that the model does not
        know of; drive_error: by what share its drive heats and cools more than the model says."""
        count = time_s.size
        reset, plate, slopes = np.empty(count), np.empty(count), np.empty((count, 2))
        reset.fill(math.nan)
        reset[0] = state.plate_degC
        heat, own, bodies = self._heat, state.own_degC.copy(), self._heat.count
        if unknown_K_per_s != 0.0:
            heat, own = heat.also(unknown_K_per_s), np.append(own, 0.0)
        par = with_drive(self._par, 1.0 + drive_error) if drive_error != 0.0 else self._par
        run(par, heat.terms, heat.values, time_s, current_A, np.zeros(count), reset, own, plate, slopes)
        return plate, slopes, replace(state, plate_degC=float(plate[-1]), own_degC=own[:bodies])

    def measure(
        self, state: ChainState, time_s: Array, plate_degC: Array, test_current_A: Array
    ) -> tuple[Stretch, ChainState]:
        """Return the stretch of thermometer, film and ohmmeter over a course of the plate, and the state there."""
        shown, state = self.thermometer(state, time_s, plate_degC)
        return self.read(state, time_s, plate_degC, shown, test_current_A)

    def thermometer(self, state: ChainState, time_s: Array, plate_degC: Array) -> tuple[Array, ChainState]:
        """Return what an ideal thermometer behind the thermometer's filters shows."""
        shown, filters = plate_degC, []
        for e, before in zip(self.links.thermometer, state.thermometer, strict=True):
            shown, after = followed(e, time_s, shown, before)
            filters.append(after)
        return shown, replace(state, thermometer=tuple(filters)) if filters else state

    def read(
        self, state: ChainState, time_s: Array, plate_degC: Array, shown_degC: Array, test_current_A: Array
    ) -> tuple[Stretch, ChainState]:
        """Return the stretch of film and ohmmeter over a given course of the plate, and the state there."""
        if self._film is None or state.film is None:
            none = np.full(time_s.size, math.nan)
            return Stretch(time_s, plate_degC, shown_degC, plate_degC, none, none), state
        film_degC, own, output, film = self._film.advance(state.film, time_s, plate_degC, test_current_A)
        return Stretch(time_s, plate_degC, shown_degC, film_degC, own, output), replace(state, film=film)
