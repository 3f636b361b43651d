"""What a model's effects have come to in a run: currents on their way, a sink's temperature, lagging readings.

One object for a whole run, which is told of every period's reading and command; `rig.experiment.extended_model` makes
the law's inputs and outputs of it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from compensator.hysteresis.film import FilmModel
from compensator.hysteresis.functions import Array
from compensator.thermal.plate import PlateModel
from sim.effects.effect import Filter, Switched, Warming
from sim.model.film_side import FilmSide, FilmState
from sim.model.links import Effects, Links, followed, links_of, warmed
from sim.model.own_output import own_output_table
from sim.model.plate_balance import heat_flows, run

LAG_PARAMETER = "tau_s"
OBSERVER_GAIN = 0.3  # share of a reading's innovation taken into the temperature; less behind a slow thermometer


class Extension:
    """See the module. test_current_A: asks for the ohmmeter's test current.

    plate_degC, film_degC: the estimates. warming_K: of the film above what its lag makes of the plate. plate_now: the
    plate with the ambient that gives it the loss that it has with the effects.
    """

    def __init__(
        self,
        effects: Sequence[Switched],
        plate: PlateModel,
        film: FilmModel | None,
        period_s: float,
        test_current_A: Callable[[], float],
    ) -> None:
        self.links: Links = links_of(effects)
        self.period_s = period_s
        self.plate_now = plate
        self.plate_degC = self.film_degC = math.nan
        self.warming_K = 0.0
        self._plate, self._film_model = plate, film
        self._film = FilmSide(film, self.links) if film is not None else None
        self._film_state: FilmState | None = None
        self._test_current_A = test_current_A
        self._heat = heat_flows(self.links.plate)
        self._own_degC = np.full(self._heat.count, plate.ambient_degC)
        self._thermometer = [np.full(1, math.nan) for _ in self.links.thermometer]
        self._time_s = 0.0
        self._sent: deque[tuple[float, float]] = deque()
        self._acting_A = 0.0
        self._past: deque[tuple[float, float]] = deque(maxlen=4096)
        self._table = own_output_table(self.links, film)
        behind = _lag_s(self.links.thermometer)
        self._gain = min(OBSERVER_GAIN, period_s / (4.0 * behind) if behind > 0.0 else 1.0)
        self.film_lag_s = _lag_s(self.links.film_temperature) if film is not None else 0.0
        skew = -float(self.links.taken(np.zeros(1))[0])
        self.lead_s = max(_lag_s(self.links.ohmmeter) + skew, 0.0) if film is not None else 0.0
        self.delay_s = float(self.links.sent(np.zeros(1), np.ones(1))[0][0]) if self.links.commands else 0.0
        self._shown_own = math.nan

    def own(self, output: Array | float) -> Array:
        """The film's own output for what the ohmmeter shows."""
        if self._table is None:
            return np.asarray(output, dtype=np.float64)
        return np.asarray(np.interp(output, *self._table), dtype=np.float64)

    def sent(self, current_A: float) -> None:
        """A current is commanded now."""
        acts, amounts = self.links.sent(np.array([self._time_s]), np.array([current_A]))
        self._sent.append((float(acts[0]), float(amounts[0])))

    def observe(self, first_degC: float, reading_degC: float) -> None:
        """A period has passed, and the thermometer shows this (nan: nothing); first_degC where nothing is known yet."""
        if math.isnan(self.plate_degC):
            self.plate_degC = first_degC
        before = self.plate_degC
        course = self._course(self._time_s + self.period_s)
        self._time_s += self.period_s
        self._sent = deque(pair for pair in self._sent if pair[0] > self._time_s - 1e-9)
        self._acting_A = course[-1][2]
        self.plate_degC = course[-1][1]
        time, plate = np.array([self._time_s - self.period_s, self._time_s]), np.array([before, self.plate_degC])
        self._lose(time, plate)
        shown = plate
        for k, e in enumerate(self.links.thermometer):
            shown, self._thermometer[k] = followed(e, time, shown, self._thermometer[k])
        if math.isfinite(reading_degC):
            self.plate_degC += self._gain * (reading_degC - float(shown[-1]))
        self.film_degC = self.plate_degC
        if self._film is not None:
            self._follow(self._film, time, np.array([before, self.plate_degC]))

    def ahead_degC(self) -> tuple[float, float]:
        """Temperatures of film and plate when a command of now acts."""
        if self.delay_s == 0.0:
            return self.film_degC, self.plate_degC
        course = self._course(self._time_s + self.delay_s)
        time = np.array([self._time_s, *(when for when, _, _ in course)])
        plate = np.array([self.plate_degC, *(degC for _, degC, _ in course)])
        if self._film is None or self._film_state is None:
            return float(plate[-1]), float(plate[-1])
        film, _, _, _ = self._film.advance(self._film_state, time, plate, np.full(time.size, self._test()))
        return float(film[-1]), float(plate[-1])

    def shown_own(self) -> float:
        """The film's own output that the ohmmeter's reading is to stand for now, as the model has it."""
        return self._shown_own

    def _test(self) -> float:
        test = self._test_current_A()
        return test if math.isfinite(test) else 0.0

    def _course(self, until_s: float) -> list[tuple[float, float, float]]:
        """(time, plate's temperature, current from there on) at each change of the acting current, and at the end."""
        now, degC, current = self._time_s, self.plate_degC, self._acting_A
        found = []
        for when, amount in [*self._sent, (until_s, math.nan)]:
            if when > until_s + 1e-9:
                continue
            degC = self.plate_now.step(degC, current, max(when - now, 0.0))
            now, current = max(when, now), current if math.isnan(amount) else amount
            found.append((now, degC, current))
        return found

    def _lose(self, time: Array, plate: Array) -> None:
        """The loss to what the effects put around the plate."""
        g = self._plate.conductance_over_capacity_per_s
        if not self._heat.count or g == 0.0:
            return
        reset, out, slopes = np.array([plate[0], math.nan]), np.empty(2), np.empty((2, 2))
        heat, current = self._heat, np.full(2, self._acting_A)
        run(self._plate.array(), heat.terms, heat.values, time, current, reset, self._own_degC, out, slopes)
        extra = float(slopes[1, 1]) - self._plate.rate_K_per_s(float(out[1]), self._acting_A)
        self.plate_now = replace(self._plate, ambient_degC=self._plate.ambient_degC + extra / g)

    def _follow(self, film: FilmSide, time: Array, plate: Array) -> None:
        """Film and ohmmeter to now."""
        assert self._film_model is not None
        if self._film_state is None:
            self._film_state = film.start(self._film_model.initial_memory(float(plate[-1])))
        test = self._test()
        degC, _, output, self._film_state = film.advance(self._film_state, time, plate, np.full(2, test))
        self._past.append((float(time[-1]), float(output[-1])))
        shown = output[-1:]
        if self.links.reading_times:
            times, values = np.array(self._past).T
            shown = np.interp(self.links.taken(time[-1:]), times, values)
        self._shown_own = float(self.own(-np.log10(self.links.shown_ohm(10.0**-shown)))[0])
        self.film_degC = float(degC[-1])
        power = np.array([test**2 * 10.0**-self._shown_own])
        warming = [e for e in self.links.film_temperature if isinstance(e.effect.form, Warming)]
        self.warming_K = sum(float(warmed(e, time[-1:], np.zeros(1), power)[0]) for e in warming)


def _lag_s(effects: Effects) -> float:
    """Sum of the lags' time constants."""
    return sum(e.values().get(LAG_PARAMETER, 0.0) for e in effects if isinstance(e.effect.form, Filter))
