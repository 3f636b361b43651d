"""The chain one period at a time: what it has come to in a run.

    predicted   plate and thermometer over a period, from the currents that acted in it
    corrected   by whoever weighs the thermometer's reading: the film does not follow what is wrong of the plate
    followed    film and ohmmeter over the corrected course

`Observer` holds parameters, `ObserverState` everything that a run has come to: each method is a function of its
arguments alone, so that any period can be repeated from its state. The nodes are the periods' ends and the moments at
which commands act.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from compensator.hysteresis.functions import Array
from compensator.thermal.plate import PlateModel, drive_rate
from sim.effects.effect import Filter, Reading, Switched, Warming
from sim.model.chain import Chain, ChainModel, ChainState
from sim.model.film_side import Film
from sim.model.links import Effects, Links, shown_output, warmed
from sim.model.plate_balance import heat_flows, rate_K_per_s

LAG_PARAMETER = "tau_s"
COLDEST_DEGC, HOTTEST_DEGC = -50.0, 200.0  # between which films are used
SWEEP, PLACES = 2001, 8001  # temperatures; outputs of the table, 1e-3 dec apart over 8 decades
BEYOND_DEC = 1.0  # of what the film reaches, or what was shown: a disturbed estimate may lie outside
Past = tuple[tuple[float, float], ...]
Course = tuple[tuple[float, float], ...]


@dataclass(frozen=True, eq=False)
class ObserverState:
    """The chain at the end of a period.

    time_s: since the run began. plate_degC, film_degC: the estimates (film_degC is the plate's without a film).
    thermometer_degC: what an ideal thermometer would have shown, before the correction. output: -log10 of the film's
    own resistance; shown_output: of what the ohmmeter shows now, its filters, skew and readings included; both nan
    without a film. warming_K: of the film, above what its lags make of the plate. acting_A: current in the plate from
    now on; driven_K_per_s: what the model's drive gave of the plate's heating over the last period. on_the_way: (acts
    at, s; A) of those commanded that do not act yet. past: (s, -log10 R at the ohmmeter), as far back as a skew asks
    for. course: the plate's nodes, (s, degC), from the last one that film and ohmmeter have followed to.
    """

    time_s: float
    plate_degC: float
    film_degC: float
    thermometer_degC: float
    output: float
    shown_output: float
    warming_K: float
    acting_A: float
    driven_K_per_s: float
    on_the_way: tuple[tuple[float, float], ...]
    chain: ChainState
    past: Past
    course: Course

    @property
    def film_memory(self) -> Any:
        """What the film remembers; None without a film."""
        return self.chain.film.memory if self.chain.film is not None else None


class Observer:
    """See the module.

    thermometer_lag_s, film_lag_s: sums of the lags of thermometer and film. lead_s: by how much the ohmmeter is late,
    lags and skew together, at least 0. delay_s: of the driver.
    """

    def __init__(self, model: ChainModel, period_s: float) -> None:
        """Raises ValueError for effects that clash."""
        self.model, self.period_s, self.links = model, period_s, model.links
        self._numbers = model.plate.numbers
        self._chain = Chain(model)
        self._heat = heat_flows(self.links.plate)
        skew_s = -float(self.links.taken(np.zeros(1))[0])
        film = model.film is not None
        self.thermometer_lag_s = _lag_s(self.links.thermometer)
        self.film_lag_s = _lag_s(self.links.film_temperature) if film else 0.0
        self.lead_s = max(_lag_s(self.links.ohmmeter) + skew_s, 0.0) if film else 0.0
        self.delay_s = float(self.links.sent(np.zeros(1), np.ones(1))[0][0]) if self.links.commands else 0.0
        self._table = own_output_table(self.links, model.film)

    def start(self, plate_degC: float, memory: Any = None, test_current_A: float = 0.0) -> ObserverState:
        """As if all had been constant before, no current flowing in the plate, and the ohmmeter's in the film. memory:
        the film's; None: its default there."""
        at = self._chain.start(plate_degC, memory)
        state = ObserverState(
            0.0, plate_degC, plate_degC, plate_degC, math.nan, math.nan, 0.0, 0.0, 0.0, (), at, (), ((0.0, plate_degC),)
        )
        return self.followed(state, plate_degC, plate_degC, test_current_A)

    def sent(self, state: ObserverState, current_A: float) -> ObserverState:
        """Return the state after a current is commanded at its time."""
        acts, amounts = self.links.sent(np.array([state.time_s]), np.array([current_A]))
        pairs = tuple(zip(acts.tolist(), amounts.tolist(), strict=True))
        now = [pair for pair in pairs if pair[0] <= state.time_s]
        return replace(
            state,
            acting_A=now[-1][1] if now else state.acting_A,
            on_the_way=state.on_the_way + tuple(pair for pair in pairs if pair[0] > state.time_s),
        )

    def predicted(
        self,
        state: ObserverState,
        unknown_K_per_s: float = 0.0,
        elapsed_s: float = math.nan,
        drive_error: float = 0.0,
    ) -> ObserverState:
        """Return the state after some time in driver, plate and thermometer; film and ohmmeter stay where they were,
        until `followed`.

        unknown_K_per_s: heating of the plate that the model does not know of. elapsed_s: nan: a period. drive_error: by
        what share the drive heats and cools more than the model says.
        """
        passes_s = self.period_s if math.isnan(elapsed_s) else elapsed_s
        return self._predicted(state, state.time_s + passes_s, unknown_K_per_s, drive_error)

    def followed(
        self, state: ObserverState, plate_degC: float, thermometer_degC: float, test_current_A: float = 0.0
    ) -> ObserverState:
        """Return the state with plate and thermometer corrected to these, and film and ohmmeter brought up to them.
        test_current_A: of the ohmmeter, through the film."""
        chain, at = self._chain, state.chain
        off_K = thermometer_degC - state.thermometer_degC
        filters = tuple(f + off_K for f in at.thermometer) if off_K != 0.0 else at.thermometer
        at = replace(at, plate_degC=plate_degC, thermometer=filters)
        time, plate = (np.ascontiguousarray(values) for values in np.array(state.course).T)
        plate[-1] = plate_degC
        stretch, at = chain.read(at, time, plate, plate, np.full(time.size, test_current_A))
        output, own = float(stretch.output[-1]), float(stretch.own_output[-1])
        past: Past = ()
        if self.links.reading_times and self.model.film is not None:
            past, output = self._read_late(state.past, time, stretch.output)
        if self.links.readings:
            output = float(-np.log10(self.links.shown_ohm(np.array([10.0**-output]))[0]))
        state = replace(
            state,
            plate_degC=plate_degC,
            film_degC=float(stretch.film_degC[-1]),
            thermometer_degC=thermometer_degC,
            output=own,
            shown_output=output,
            chain=at,
            past=past,
            course=((state.time_s, plate_degC),),
        )
        return replace(state, warming_K=self.warming_K(state, own, test_current_A))

    def remembering(self, state: ObserverState, memory: Any) -> ObserverState:
        """Return the state in which the film has this memory, at its own temperature."""
        film = state.chain.film
        if film is None:
            return state
        return replace(state, chain=replace(state.chain, film=replace(film, memory=memory)))

    def ahead(
        self,
        state: ObserverState,
        test_current_A: float = 0.0,
        unknown_K_per_s: float = 0.0,
        drive_error: float = 0.0,
    ) -> ObserverState:
        """Return the state when a command of now acts, nothing else being sent and nothing read."""
        if self.delay_s <= 0.0:
            return state
        later = self._predicted(state, state.time_s + self.delay_s, unknown_K_per_s, drive_error)
        return self.followed(later, later.plate_degC, later.thermometer_degC, test_current_A)

    def plate_now(self, state: ObserverState) -> PlateModel:
        """Return the plate without effects, its ambient such that it loses now what it loses with them."""
        plate = self.model.plate
        g = plate.conductance_over_capacity_per_s
        if not self._heat.count or g == 0.0:
            return plate
        degC, current, chain = state.plate_degC, state.acting_A, state.chain
        rate = rate_K_per_s(plate.numbers, self._heat, state.time_s, degC, chain.own_degC, current)
        return replace(plate, ambient_degC=plate.ambient_degC + (rate - plate.rate_K_per_s(degC, current)) / g)

    def own(self, output: Array | float) -> Array:
        """Return the film's own output for what an ohmmeter without lags and skew shows: leads, shunt, ranges taken
        off."""
        if self._table is None:
            return np.asarray(output, dtype=np.float64)
        return np.asarray(np.interp(output, *self._table), dtype=np.float64)

    def warming_K(
        self, state: ObserverState, output: float, test_current_A: float = 0.0, later_s: float = 0.0
    ) -> float:
        """Return what drift and the ohmmeter's power add to the film's temperature, if its own output were this,
        later_s after the state's time."""
        adding: list[Switched] = [e for e in self.links.film_temperature if isinstance(e.effect.form, Warming)]
        if not adding or self.model.film is None:
            return 0.0
        time, total = np.array([state.time_s + later_s]), np.zeros(1)
        power = np.array([test_current_A**2 * 10.0**-output])
        for e in adding:
            total = warmed(e, time, total, power)
        return float(total[0])

    def _predicted(
        self, state: ObserverState, until_s: float, unknown_K_per_s: float, drive_error: float
    ) -> ObserverState:
        """Return the state after driver, plate and thermometer have come to that time."""
        there = until_s + 1e-9  # a command of this very moment, whatever its rounding, acts
        due = sorted(pair for pair in state.on_the_way if pair[0] <= there)
        steps = [(state.time_s, state.acting_A)]
        for when, amount in due:
            if when > steps[-1][0]:
                steps.append((min(when, until_s), amount))
            else:
                steps[-1] = (steps[-1][0], amount)
        if steps[-1][0] < until_s:
            steps.append((until_s, steps[-1][1]))
        time, current = (np.ascontiguousarray(values) for values in np.array(steps).T)
        plate, _, at = self._chain.heated(state.chain, time, current, unknown_K_per_s, drive_error)
        passed_s = until_s - state.time_s
        mean_A = float(current[:-1] @ np.diff(time)) / passed_s if passed_s > 0.0 else float(current[-1])
        shown, at = self._chain.thermometer(at, time, plate)
        return replace(
            state,
            time_s=until_s,
            plate_degC=float(plate[-1]),
            thermometer_degC=float(shown[-1]),
            film_degC=state.film_degC if self.model.film is not None else float(plate[-1]),
            acting_A=float(current[-1]),
            driven_K_per_s=drive_rate(self._numbers, state.plate_degC, mean_A),
            on_the_way=tuple(pair for pair in state.on_the_way if pair[0] > there),
            chain=at,
            course=state.course + tuple(zip(time[1:].tolist(), plate[1:].tolist(), strict=True)),
        )

    def _read_late(self, past: Past, time: Array, output: Array) -> tuple[Past, float]:
        """Return (what has to be kept of the past, what is stamped with the last of these times)."""
        taken = float(self.links.taken(time[-1:])[0])
        seen = [
            *past,
            *((float(t), float(y)) for t, y in zip(time, output, strict=True) if not past or t > past[-1][0]),
        ]
        before = max((k for k, (t, _) in enumerate(seen) if t <= taken - self.period_s), default=0)
        times, values = np.array(seen).T
        return tuple(seen[before:]), float(np.interp(taken, times, values))


def _lag_s(effects: Effects) -> float:
    """Return the sum of the lags' time constants."""
    return math.fsum(e.values().get(LAG_PARAMETER, 0.0) for e in effects if isinstance(e.effect.form, Filter))


def own_output_table(links: Links, film: Film | None) -> tuple[Array, Array] | None:
    """Return (what the ohmmeter shows, the film's own output), both -log10 R, increasing, shape (places,); None where
    they are the same, or there is no film."""
    readings = _readings(links)
    if film is None or not readings:
        return None
    up = np.linspace(COLDEST_DEGC, HOTTEST_DEGC, SWEEP)
    reach = np.concatenate([film.simulate(v, film.initial_memory(float(v[0])))[0] for v in (up, up[::-1])])
    return _table(readings, float(reach.min()), float(reach.max()))


def own_output(links: Links, shown: Array) -> Array:
    """Return the film's own output for what an ohmmeter without a lag showed, both -log10 R, shape (readings,)."""
    readings = _readings(links)
    if not readings or not shown.size:
        return shown
    return np.asarray(np.interp(shown, *_table(readings, float(shown.min()), float(shown.max()))), dtype=np.float64)


def _readings(links: Links) -> list[Switched]:
    return [e for e in (*links.ohmmeter, *links.readings) if isinstance(e.effect.form, Reading)]


def _table(readings: list[Switched], low: float, high: float) -> tuple[Array, Array]:
    own = np.linspace(low - BEYOND_DEC, high + BEYOND_DEC, PLACES)
    shown = own
    for e in readings:
        shown = shown_output(e, shown)
    return np.maximum.accumulate(shown), own
