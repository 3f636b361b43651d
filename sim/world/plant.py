"""The simulated world that two instruments share: current -> plate -> thermometer and film -> ohmmeter; and a whole
record from a current over time, without instruments.

Time is a parameter: `advance_to` runs the events scheduled until then; the physics is computed when something is read
or changed. With the current held, and without most effects, the plate's temperature is monotone between two events and
the film does not depend on the rate, so that a node at every event is exact.

A reading taken later than its time stamp (timestamp_skew below 0) lies in the future: the present one is returned, and
the writer of the record corrects its time stamp (`stamp_s`).
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from compensator.hysteresis.functions import Array
from compensator.thermal.plate import PlateModel
from sim.effects.effect import Switched
from sim.model.chain import Chain, ChainModel, ChainState
from sim.model.film_side import Film
from sim.model.inputs import NOTHING, Inputs
from sim.model.links import links_of
from sim.model.meter_power import since_the_row_before
from sim.model.record_own import FilmStart, RecordOwn
from sim.model.record_run import RecordRun
from sim.model.recorded import Rows

KEPT_S = 1.0  # of the past, beyond what a reading reaches back


@dataclass(frozen=True)
class Detector:
    """A detector between the film and a voltmeter: a position-sensitive diode that watches a cantilever bend. Linear:
    what a real one adds at the ends of its range is not simulated.

        voltage_V = offset_V + volts_per_unit * u        u: the film's output, in its own unit (1/m of a curvature)

    noise_V: standard deviation of a reading.
    """

    volts_per_unit: float
    offset_V: float = 0.0
    noise_V: float = 0.0

    def voltage_V(self, output: float, standard_normal: float = 0.0) -> float:
        """Return what the voltmeter reads, V."""
        return self.offset_V + self.volts_per_unit * output + self.noise_V * standard_normal


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

    def __post_init__(self) -> None:
        for name in ("thermometer_noise_K", "ohmmeter_noise_dec"):
            value = getattr(self, name)
            if not 0.0 <= value < math.inf:
                raise ValueError(f"{name}: {value}: expected a finite number >= 0")

    @property
    def model(self) -> ChainModel:
        return ChainModel(self.plate, self.film, self.effects)


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


class SimulatedPlant:
    """The state of the simulated rig: temperatures, film memory, currents, and what is due.

    current_A: the command; effects on the driver may change or delay it.
    """

    def __init__(self, world: World, start_s: float = 0.0) -> None:
        self.world = world
        self.time_s = start_s
        self.current_A = 0.0
        self.test_current_A = 0.0
        self._start_s = start_s
        self._chain = Chain(world.model)
        self._state: ChainState = self._chain.start(world.first_degC, None, world.film_initial)
        self._links = self._chain.links
        self._sink = self._links.own_number("heat_sink_warmup")
        self._plate_current_A = 0.0
        self._solved_s = -math.inf  # of the chain's last node, in its own time
        self._thermometer_degC = world.first_degC
        self._past: tuple[Array, Array] = (np.zeros(0), np.zeros(0))
        self._thermometer_noise, self._ohmmeter_noise = noises(world.seed)
        self._due: list[tuple[float, int, Callable[[float], None]]] = []
        self._scheduled = 0

    @property
    def temperature_degC(self) -> float:
        self._solve()
        return self._state.plate_degC

    def schedule(self, time_s: float, callback: Callable[[float], None]) -> None:
        """Call `callback(time_s)` when the plant has reached that time (at once, if it has)."""
        self._scheduled += 1
        heapq.heappush(self._due, (max(time_s, self.time_s), self._scheduled, callback))

    def advance_to(self, time_s: float) -> None:
        """Advance the time, and run the callbacks due until then; a time in the past changes nothing."""
        while self._due and self._due[0][0] <= time_s:
            due_s, _, callback = heapq.heappop(self._due)
            self.time_s = max(self.time_s, due_s)
            callback(due_s)
        self.time_s = max(self.time_s, time_s)

    def set_current_A(self, current: float) -> None:
        """Current through the Peltier from now on; the driver holds it within its limit."""
        limit = self.world.current_limit_A
        self.current_A = min(max(current, -limit), limit)
        if not self._links.commands:
            self._drive(self.current_A)
            return
        acts, amounts = self._links.sent(np.array([self.time_s]), np.array([self.current_A]))
        for when, amount in zip(acts.tolist(), amounts.tolist(), strict=True):
            if when <= self.time_s:
                self._drive(amount)
            else:
                self.schedule(when, lambda _, amount=amount: self._drive(amount))  # type: ignore[misc]

    def set_test_current_A(self, current: float) -> None:
        if current == self.test_current_A:
            return
        if self._links.heated and self._solved_s > -math.inf:
            self._solve()
            self._solved_s = math.nextafter(self._solved_s, -math.inf)  # the film jumps here
        self.test_current_A = current

    def read_temperature_degC(self) -> float:
        self._solve()
        value = self._thermometer_degC + self.world.thermometer_noise_K * self._thermometer_noise.draw()
        if not self._links.temperature_readings:
            return value
        return float(self._links.shown_degC(np.array([value]))[0])

    def sink_temperature_degC(self) -> float:
        """Return the far side's temperature: the sink's where it has one, else the ambient."""
        if self._sink is None:
            return self.world.plate.ambient_degC
        self._solve()
        return float(self._state.own_degC[self._sink])

    def read_voltage_V(self) -> float:
        """Return the detector's voltage at a voltmeter now; 0 where there is none."""
        detector = self.world.detector
        if detector is None:
            return 0.0
        self._solve()
        return detector.voltage_V(float(self._past[1][-1]), self._ohmmeter_noise.draw())

    def read_resistance_ohm(self, test_current_A: float) -> float:
        self.set_test_current_A(test_current_A)
        self._solve()
        time, output = self._past
        value = output[-1]
        if self._links.reading_times:
            taken = self._links.taken(np.array([self.time_s - self._start_s]))[0]
            value = np.interp(taken, time, output)
        noise = self.world.ohmmeter_noise_dec * self._ohmmeter_noise.draw()
        if not self._links.readings:
            return float(10.0 ** (noise - value))
        return float(self._links.shown_ohm(np.array([10.0**-value]))[0] * 10.0**noise)

    def _drive(self, current: float) -> None:
        self._solve()  # the temperature may turn round here
        self._plate_current_A = current

    def _solve(self) -> None:
        """Bring temperatures and film up to now."""
        now = self.time_s - self._start_s
        if now <= self._solved_s:
            return
        time = self._chain.nodes(max(self._solved_s, 0.0), now)
        current, test_current = np.empty(time.size), np.empty(time.size)
        current.fill(self._plate_current_A)
        test_current.fill(self.test_current_A)
        stretch, self._state = self._chain.advance(self._state, time, current, test_current)
        self._thermometer_degC = float(stretch.thermometer_degC[-1])
        self._solved_s = now
        if self._links.reading_times:
            earliest = min(float(self._links.taken(time[-1:])[0]), now) - KEPT_S
            kept = max(int(np.searchsorted(self._past[0], earliest)) - 1, 0)
            past = np.concatenate((self._past[0][kept:], time)), np.concatenate((self._past[1][kept:], stretch.output))
            self._past = past
        else:
            self._past = time, stretch.output


def stamp_s(world: World, time_s: Array) -> Array:
    """Return what a record calls the times at which a simulated rig took its resistances, where that is earlier."""
    ahead = links_of(world.effects).taken(time_s) - time_s
    return time_s - np.maximum(ahead, 0.0)


# ---- a record without instruments ---------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Readings:
    """What the instruments show, one of each a row: degC and ohm; and the memory of the film at the end.

    output: -log10 of the resistance, or whatever else the film's output is.
    """

    temperature_degC: Array
    resistance_ohm: Array
    output: Array
    film_memory: Any


@dataclass(frozen=True, eq=False)
class Commanded:
    """Rows without gaps, as `sim.model.recorded.Recorded`."""

    time_s: Array
    current_A: Array
    taken_s: Array
    test_current_A: Array
    inputs: Inputs = NOTHING

    @property
    def first_rows(self) -> Rows:
        """One stretch."""
        return np.zeros(1, dtype=np.int64)

    @property
    def test_on_s(self) -> Array:
        """Since the row before."""
        return since_the_row_before(self.time_s)

    @property
    def commands(self) -> tuple[Array, Array]:
        """A current a row."""
        return self.time_s, self.current_A


def simulate_record(
    world: World,
    time_s: Array,
    current_A: Array,
    *,
    meter_current_A: ArrayLike = 0.0,
    resistance_time_s: Array | None = None,
    memory: Any = None,
) -> Readings:
    """Return readings of the rows, with the world's noise.

    The current of a row holds from its time to the next row's; before the first it was 0. The ohmmeter's test current
    of a row flows since the row before.

    resistance_time_s: what the resistances are stamped with, by default the rows' times. memory: the film's at the
    first row, by default the world's. Raises ValueError for effects that clash.
    """
    sent_A = np.clip(current_A, -world.current_limit_A, world.current_limit_A)
    record = commanded(time_s, sent_A, meter_current_A, resistance_time_s)
    chain, own = RecordRun(world.model), at_rest(world, world.first_degC)
    plate = chain.plate(record, own)
    film = chain.film(record, plate.path, own, memory)
    thermometer, ohmmeter = np.random.default_rng(world.seed).spawn(2)  # with the noise of `SimulatedPlant`'s seed
    noise_K = world.thermometer_noise_K * thermometer.standard_normal(record.time_s.size)
    output = film.output - world.ohmmeter_noise_dec * ohmmeter.standard_normal(record.time_s.size)
    return Readings(chain.links.shown_degC(plate.shown_degC + noise_K), 10.0**-output, output, film.memory)


def commanded(
    time_s: Array, current_A: Array, meter_current_A: ArrayLike = 0.0, stamps_s: Array | None = None
) -> Commanded:
    """Return rows whose times count from the first. stamps_s: of the resistances, by default the rows' times."""
    rows = np.asarray(time_s, dtype=np.float64) - float(time_s[0])
    taken = rows if stamps_s is None else np.where(np.isfinite(stamps_s), stamps_s - float(time_s[0]), rows)
    test = np.broadcast_to(np.asarray(meter_current_A, dtype=np.float64), rows.shape)
    return Commanded(rows, np.asarray(current_A, dtype=np.float64), taken, test)


def at_rest(world: World, first_degC: float) -> RecordOwn:
    """Return the beginning of a record with all at rest."""
    initial = "heated" if world.film_initial == "heated" else "cooled"
    film = FilmStart(initial, (first_degC,))  # type: ignore[arg-type]
    return RecordOwn(world.plate.ambient_degC, np.array([first_degC]), film=film)
