"""The chain one period at a time: what it has come to in a run, corrected by the thermometer's readings.

    predicted   plate, thermometer over the period, from the currents that acted in it
    corrected   T_p <- T_p + gain (reading - predicted thermometer)
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

from compensator.functions import Array
from compensator.plate import PlateModel
from sim.effects.effect import Filter, Switched, Warming
from sim.model.chain import Chain, ChainModel, ChainState
from sim.model.links import Effects, warmed
from sim.model.own_output import own_output_table
from sim.model.plate_balance import heat_flows, rate_K_per_s

LAG_PARAMETER = "tau_s"
OBSERVER_GAIN = 0.3  # a reading's noise reaches the plate by a third, and an error is halved in two periods
SLOWER_THAN_LAG = 4.0  # times a thermometer's lag is the correction's time constant: faster, it would ring with the lag
Past = tuple[tuple[float, float], ...]


@dataclass(frozen=True, eq=False)
class ObserverState:
    """The chain at the end of a period.

    time_s: since the run began. plate_degC, film_degC: the estimates (film_degC is the plate's without a film).
    thermometer_degC: what an ideal thermometer would have shown, before the correction. output: -log10 of the film's
    own resistance; shown_output: of what the ohmmeter shows now, its filters, skew and readings included; both nan
    without a film. warming_K: of the film, above what its lags make of the plate. acting_A: current in the plate from
    now on; on_the_way: (acts at, s; A) of those commanded that do not act yet. past: (s, -log10 R at the ohmmeter), as
    far back as a skew asks for.
    """

    time_s: float
    plate_degC: float
    film_degC: float
    thermometer_degC: float
    output: float
    shown_output: float
    warming_K: float
    acting_A: float
    on_the_way: tuple[tuple[float, float], ...]
    chain: ChainState
    past: Past

    @property
    def film_memory(self) -> Any:
        """What the film remembers; None without a film."""
        return self.chain.film.memory if self.chain.film is not None else None


class Observer:
    """See the module.

    film_lag_s: sum of the lags of the film's temperature. lead_s: by how much the ohmmeter is late, lags and skew
    together, at least 0. delay_s: of the driver.
    """

    def __init__(self, model: ChainModel, period_s: float, gain: float | None = None) -> None:
        """gain: share of a reading's innovation taken into the plate; None: `OBSERVER_GAIN`, less behind a slow
        thermometer. Raises ValueError for effects that clash."""
        self.model, self.period_s, self.links = model, period_s, model.links
        self._chain = Chain(model)
        self._heat = heat_flows(self.links.plate)
        behind = _lag_s(self.links.thermometer)
        share = min(OBSERVER_GAIN, period_s / (SLOWER_THAN_LAG * behind) if behind > 0.0 else 1.0)
        self.gain = share if gain is None else gain
        skew_s = -float(self.links.taken(np.zeros(1))[0])
        film = model.film is not None
        self.film_lag_s = _lag_s(self.links.film_temperature) if film else 0.0
        self.lead_s = max(_lag_s(self.links.ohmmeter) + skew_s, 0.0) if film else 0.0
        self.delay_s = float(self.links.sent(np.zeros(1), np.ones(1))[0][0]) if self.links.commands else 0.0
        self._table = own_output_table(self.links, model.film)

    def start(self, plate_degC: float, memory: Any = None) -> ObserverState:
        """As if all had been constant before, no current flowing. memory: the film's; None: its default there."""
        state = self._chain.start(plate_degC, memory)
        nothing = ObserverState(0.0, plate_degC, plate_degC, plate_degC, math.nan, math.nan, 0.0, 0.0, (), state, ())
        return self._at(nothing, np.zeros(1), np.zeros(1), math.nan, 0.0)

    def sent(self, state: ObserverState, current_A: float) -> ObserverState:
        """A current is commanded at the state's time."""
        acts, amounts = self.links.sent(np.array([state.time_s]), np.array([current_A]))
        pairs = tuple(zip(acts.tolist(), amounts.tolist(), strict=True))
        now = [pair for pair in pairs if pair[0] <= state.time_s]
        return replace(
            state,
            acting_A=now[-1][1] if now else state.acting_A,
            on_the_way=state.on_the_way + tuple(pair for pair in pairs if pair[0] > state.time_s),
        )

    def step(self, state: ObserverState, reading_degC: float = math.nan, test_current_A: float = 0.0) -> ObserverState:
        """A period passes. reading_degC: the thermometer's at its end, nan: none; test_current_A: through the film."""
        return self._advanced(state, state.time_s + self.period_s, reading_degC, test_current_A)

    def ahead(self, state: ObserverState, test_current_A: float = 0.0) -> ObserverState:
        """The state when a command of now acts, nothing else being sent and nothing read."""
        if self.delay_s <= 0.0:
            return state
        return self._advanced(state, state.time_s + self.delay_s, math.nan, test_current_A)

    def plate_now(self, state: ObserverState) -> PlateModel:
        """The plate without effects, its ambient such that it loses now what it loses with them."""
        plate = self.model.plate
        g = plate.conductance_over_capacity_per_s
        if not self._heat.count or g == 0.0:
            return plate
        degC, current, chain = state.plate_degC, state.acting_A, state.chain
        rate = rate_K_per_s(plate.array(), self._heat, state.time_s, degC, chain.own_degC, current)
        return replace(plate, ambient_degC=plate.ambient_degC + (rate - plate.rate_K_per_s(degC, current)) / g)

    def own(self, output: Array | float) -> Array:
        """The film's own output for what an ohmmeter without lags and skew shows: leads, shunt, ranges taken off."""
        if self._table is None:
            return np.asarray(output, dtype=np.float64)
        return np.asarray(np.interp(output, *self._table), dtype=np.float64)

    def _advanced(self, state: ObserverState, until_s: float, reading_degC: float, test_A: float) -> ObserverState:
        """The state at that time."""
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
        time, current = np.array(steps).T
        later = tuple(pair for pair in state.on_the_way if pair[0] > there)
        state = replace(state, acting_A=float(current[-1]), on_the_way=later)
        return self._at(state, np.ascontiguousarray(time), np.ascontiguousarray(current), reading_degC, test_A)

    def _at(
        self, state: ObserverState, time: Array, current: Array, reading_degC: float, test_A: float
    ) -> ObserverState:
        """The state at the last of some nodes."""
        chain = self._chain
        plate, _, at = chain.heated(state.chain, time, current)
        shown, at = chain.thermometer(at, time, plate)
        if math.isfinite(reading_degC):
            plate[-1] += self.gain * (reading_degC - float(shown[-1]))
            at = replace(at, plate_degC=float(plate[-1]))
        stretch, at = chain.read(at, time, plate, shown, np.full(time.size, test_A))
        now, output, own = float(time[-1]), float(stretch.output[-1]), float(stretch.own_output[-1])
        past: Past = ()
        if self.links.reading_times and self.model.film is not None:
            past, output = self._read_late(state.past, time, stretch.output)
        if self.links.readings:
            output = float(-np.log10(self.links.shown_ohm(np.array([10.0**-output]))[0]))
        return ObserverState(
            now,
            float(plate[-1]),
            float(stretch.film_degC[-1]),
            float(shown[-1]),
            own,
            output,
            self._warming_K(now, own, test_A),
            state.acting_A,
            state.on_the_way,
            at,
            past,
        )

    def _read_late(self, past: Past, time: Array, output: Array) -> tuple[Past, float]:
        """(what has to be kept of the past, what is stamped with the last of these times)."""
        taken = float(self.links.taken(time[-1:])[0])
        seen = [
            *past,
            *((float(t), float(y)) for t, y in zip(time, output, strict=True) if not past or t > past[-1][0]),
        ]
        before = max((k for k, (t, _) in enumerate(seen) if t <= taken - self.period_s), default=0)
        times, values = np.array(seen).T
        return tuple(seen[before:]), float(np.interp(taken, times, values))

    def _warming_K(self, time_s: float, own_output: float, test_A: float) -> float:
        adding: list[Switched] = [e for e in self.links.film_temperature if isinstance(e.effect.form, Warming)]
        if not adding or self.model.film is None:
            return 0.0
        time, power, total = np.array([time_s]), np.array([test_A**2 * 10.0**-own_output]), np.zeros(1)
        for e in adding:
            total = warmed(e, time, total, power)
        return float(total[0])


def _lag_s(effects: Effects) -> float:
    """Sum of the lags' time constants."""
    return sum(e.values().get(LAG_PARAMETER, 0.0) for e in effects if isinstance(e.effect.form, Filter))
