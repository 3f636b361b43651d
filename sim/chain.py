"""The signal chain from the current in the plate to what both instruments show, a stretch of nodes at a time.

`SimulatedPlant` takes it from event to event, `sim.open_loop` over a whole record; both give the same course. Times
count from the moment at which what drifts begins to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from compensator.hysteresis.functions import Array
from compensator.thermal.plate import PlateModel
from sim.detector import Detector
from sim.effects.effect import Filter, Switched
from sim.film_side import Film, FilmSide, FilmState
from sim.links import LONGEST_NODE_S, links_of
from sim.plate_balance import heat_flows, run


@dataclass(frozen=True)
class World:
    """What is true of the simulated rig.

    effects: what is switched on. current_limit_A: of the driver. detector: where a voltmeter reads the film.
    thermometer_noise_K, ohmmeter_noise_dec: standard deviation of a reading.
    """

    plate: PlateModel
    film: Film
    first_degC: float = 25.0
    film_initial: str = "cooled"
    thermometer_noise_K: float = 0.005
    ohmmeter_noise_dec: float = 0.001
    current_limit_A: float = 16.0
    seed: int = 0
    effects: tuple[Switched, ...] = ()
    detector: Detector | None = None


@dataclass(frozen=True, eq=False)
class Stretch:
    """The course over nodes, each of shape (nodes,): true temperatures, and -log10 R as it reaches the ohmmeter."""

    time_s: Array
    plate_degC: Array
    thermometer_degC: Array
    film_degC: Array
    output: Array


@dataclass
class Noise:
    """Standard normal numbers, drawn in blocks."""

    random: np.random.Generator
    block: list[float] = field(default_factory=list)

    def draw(self) -> float:
        if not self.block:
            self.block = self.random.standard_normal(4096).tolist()
        return self.block.pop()


def noises(seed: int) -> tuple[Noise, Noise]:
    """Of the thermometer and of the ohmmeter, independent."""
    thermometer, ohmmeter = np.random.default_rng(seed).spawn(2)
    return Noise(thermometer), Noise(ohmmeter)


class Chain:
    """The state of plate, thermometer and film at the last node."""

    def __init__(self, world: World, memory: Any = None) -> None:
        """memory: the film's at the first node; None: as the world says. Raises ValueError for effects that clash."""
        self.world = world
        self.links = links_of(world.effects)
        self._heat = heat_flows(self.links.plate)
        self._par = world.plate.array()
        self._film = FilmSide(world.film, self.links)
        if memory is None:
            memory = world.film.initial_memory(world.first_degC, world.film_initial)
        self._film_state: FilmState = self._film.start(memory)
        self.plate_degC = world.first_degC
        self.own_degC = np.full(self._heat.count, world.plate.ambient_degC)
        self._thermometer = [np.full(1, math.nan) for _ in self.links.thermometer]

    @property
    def film_memory(self) -> Any:
        """What the film remembers at the last node."""
        return self._film_state.memory

    def restart(self, plate_degC: float) -> None:
        """After a gap: the plate begins anew, and what lags begins there too; sink and film keep what they have."""
        self.plate_degC = plate_degC
        self._thermometer = [np.full(1, math.nan) for _ in self.links.thermometer]
        self._film_state = self._film.start(self._film_state.memory)

    def nodes(self, from_s: float, to_s: float) -> Array:
        """Times between which the course may be taken as straight."""
        count = math.ceil((to_s - from_s) / LONGEST_NODE_S - 1e-9) if self.links.fine else 1
        if count <= 1:
            return np.array((from_s, to_s))
        time = np.asarray(np.arange(count + 1), dtype=np.float64) * ((to_s - from_s) / count) + from_s
        time[-1] = to_s
        return time

    def advance(self, time_s: Array, current_A: Array, test_current_A: Array) -> Stretch:
        """The course from the last node, time_s[0], to time_s[-1].

        current_A: through the plate from each node on. test_current_A: through the film up to each node.
        """
        count = time_s.size
        reset, plate, slopes = np.empty(count), np.empty(count), np.empty((count, 2))
        reset.fill(math.nan)
        reset[0] = self.plate_degC
        heat = self._heat
        run(self._par, heat.terms, heat.values, time_s, current_A, reset, self.own_degC, plate, slopes)
        self.plate_degC = float(plate[-1])
        return self.measure(time_s, plate, test_current_A)

    def measure(self, time_s: Array, plate_degC: Array, test_current_A: Array) -> Stretch:
        """Thermometer, film and ohmmeter over a given course of the plate."""
        shown = plate_degC
        for k, e in enumerate(self.links.thermometer):
            assert isinstance(e.effect.form, Filter)
            out = np.empty(time_s.size)
            e.effect.form.run(e.par, time_s, shown, self._thermometer[k], out)
            shown = out
        film, output, self._film_state = self._film.advance(self._film_state, time_s, plate_degC, test_current_A)
        return Stretch(time_s, plate_degC, shown, film, output)
